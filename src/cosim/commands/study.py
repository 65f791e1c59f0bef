"""``cosim study``: runs a study, writes its report and shows the verdicts."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.markup import escape

from ..extras import require
from .console import Bar, check_files, fmus_argument, make_table, print_error, print_note, standard_output, write_files
from .parser import EXIT_CODES, count, timeout_argument

if TYPE_CHECKING:
    from ..study import Outcomes, Status, Study, Verdict

COLOURS: Mapping[Status, str] = {
    "reproduced": "green",
    "agrees": "green",
    "fitted": "cyan",
    "transferred": "magenta",
    "order only": "yellow",
    "not reproduced": "red",
    "differs": "red",
    "finding": "dim",
    "not checkable": "dim",
    "not run": "dim",
}
"""The colour of each verdict in the table."""


def add(commands: Any) -> None:
    """Add ``study``."""
    study = commands.add_parser(
        "study",
        help="run a study and write its report",
        description="Run all systems of a study and write its report: what was published, what was measured.",
    )
    study.examples = ("cosim study purtojo2015 --runs '*_step*' --output results/purtojo2015",)
    study.exit_codes = {
        **EXIT_CODES,
        0: "every run is complete, whatever the verdicts: a claim that does not hold is a finding",
        1: "a run failed, or a file could not be written",
    }
    study.add_argument("name", metavar="NAME", help="a study, such as shams2010; cosim list shows all")
    study.add_argument("--output", type=Path, metavar="DIR", help="folder of the report (default: results/NAME)")
    study.add_argument(
        "--runs", default="*", metavar="PATTERN", help="only the runs that match, such as 'fsmc_*' (default: all)"
    )
    study.add_argument("--jobs", type=count, default=2, metavar="N", help="runs carried out at a time (default: 2)")
    study.add_argument(
        "--data", type=Path, metavar="DIR", help="folder of the files that the study reads (emps); they stay yours"
    )
    timeout_argument(study)
    fmus_argument(study)
    study.set_defaults(command=_run)


def _run(options: argparse.Namespace) -> int:
    return main(
        options.name,
        options.output,
        runs=options.runs,
        jobs=options.jobs,
        fmus=options.fmus,
        data=options.data,
        timeout=options.timeout,
    )


def main(
    name: str,
    output: Path | None = None,
    *,
    runs: str = "*",
    jobs: int = 1,
    fmus: Path | None = None,
    data: Path | None = None,
    timeout: float | None = None,
) -> int:
    """Run a study, write its report into ``output`` (default: results/NAME) and show the verdicts.

    ``runs`` is a pattern of run names, ``jobs`` the number of runs at a time, ``data`` the folder of measured files,
    ``timeout`` the limit in s for a call of an FMU.
    Returns 0, or 1 if a run failed. A claim that does not hold is a finding, not a failure.
    """
    from ..study import Outcome, Outcomes, find_study, load_study, matching_runs, run_study
    from ..study.report import write_report

    require("matplotlib", "the report of a study")
    folder = find_study(name)
    target = (output or Path("results") / folder.name) / "report.html"
    check_files(target)
    study = load_study(folder)
    total = len(matching_runs(study, runs))
    done: list[Outcome] = []
    with Bar("Runs") as bar:

        def advance(outcome: Outcome) -> None:
            done.append(outcome)
            bar.update(len(done), total, outcome.name)

        try:
            outcomes = run_study(
                folder, pattern=runs, jobs=jobs, fmus=fmus, data=data, timeout=timeout, progress=advance
            )
        except KeyboardInterrupt:
            if done:
                _show(study, Outcomes(done))
                print_note(f"{len(done)} of {total} runs were done. The report was not written.")
            raise
    verdicts = _show(study, outcomes)
    written = write_files((target, lambda path: write_report(path.parent, folder.name, study, outcomes, verdicts)))
    if written:
        standard_output().print(f"Written: {escape(str(target))}")
    failed = [outcome for outcome in outcomes.all() if outcome.failure]
    for outcome in failed:
        print_error(f"run {outcome.name}: {outcome.failure}")
    return 1 if failed or not written else 0


def _show(study: Study, outcomes: Outcomes) -> list[Verdict]:
    """Print the verdicts on the claims of a study; returns them."""
    from ..study import judge
    from ..study.report import KINDS, counts, values

    verdicts = [judge(claim, outcomes) for claim in study.claims]
    console = standard_output()
    for kind, (title, text) in KINDS.items():
        found = [verdict for verdict in verdicts if verdict.claim.kind == kind]
        if not found:
            continue
        heading = "Figure" if kind == "check" else "Claim"
        table = make_table("", heading, "Measured", "Verdict", title=f"{study.title}: {title}")
        for verdict in found:
            if verdict.status == "not run":
                continue  # the line below counts them; the report has them all
            claim = verdict.claim
            measured = values(verdict.measured, claim) if verdict.measured else verdict.reason
            status = f"[{COLOURS[verdict.status]}]{verdict.status}[/]"
            table.add_row(claim.id, escape(claim.text), escape(measured), status)
        console.print(table)
        said = ", ".join(f"{count} {status}" for status, count in counts(verdicts, kind).items())
        console.print(f"{title}: {said}. {text}")
    return verdicts
