"""``cosim verify``: replays reference results inside FMUs. Large packages are imported only when it runs."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.markup import escape

from ..errors import DescriptionError
from .console import (
    Bar,
    check_plot,
    fmus_argument,
    make_table,
    print_error,
    print_json,
    print_note,
    standard_output,
    write_files,
)
from .parser import EXIT_CODES, timeout_argument

if TYPE_CHECKING:
    from ..reference.replay import Replay, Report


def add(commands: Any) -> None:
    """Add ``verify`` to the subparsers of ``cosim``."""
    parser = commands.add_parser(
        "verify",
        help="replay the reference results inside FMUs",
        description="Replay the reference results that FMUs carry (fmi-ls-ref), ours or foreign, and compare.",
    )
    parser.examples = ("cosim verify BallscrewStage --plot stage.png",)
    parser.exit_codes = {
        **EXIT_CODES,
        0: "all signals lie within their tolerances",
        1: "a signal differs, or a run failed",
        2: "an FMU or its references are wrong or missing, or an option is wrong; the highest code of all FMUs counts",
    }
    parser.add_argument(
        "fmu",
        nargs="+",
        metavar="FMU",
        help="an .fmu file, a name in the FMU folder, or a folder: all FMUs in it",
    )
    parser.add_argument(
        "--interface", choices=["cs", "me"], help="co-simulation or model exchange (default: cs where an FMU has it)"
    )
    parser.add_argument(
        "--tolerance",
        type=float,
        default=1e-3,
        metavar="SHARE",
        help="tolerance as a share of the largest value of a reference, where the FMU states none (default: 1e-3)",
    )
    timeout_argument(parser, "a run", "60", kind=float)
    parser.add_argument("--plot", type=Path, metavar="FILE", help="draw references and replay, one file an FMU")
    parser.add_argument("--json", action="store_true", help="print every signal as JSON, for scripts")
    fmus_argument(parser)
    parser.set_defaults(command=_run)


def _run(options: argparse.Namespace) -> int:
    from ..reference.replay import DEFAULT_TIMEOUT, verify_all

    timeout = DEFAULT_TIMEOUT if options.timeout is None else options.timeout
    problems: list[str] = []
    for name, low in (("tolerance", options.tolerance), ("timeout", timeout)):
        if not (math.isfinite(low) and low > 0.0):
            problems.append(f"--{name} {low:g}: give a number above 0.")
    paths: list[Path] = []
    for text in options.fmu:
        try:
            paths += _paths(text, options.fmus)
        except DescriptionError as error:
            problems += error.problems
    if problems:
        raise DescriptionError(problems)
    check_plot(options.plot)
    reports: list[Report] = []
    found = verify_all(paths, interface=options.interface, tolerance=options.tolerance, timeout=timeout)
    try:
        with Bar("Replaying") as bar:
            for report in found:
                reports.append(report)
                bar.update(len(reports), len(paths), report.path.name)
    except KeyboardInterrupt:
        _print(reports, options)
        print_note(f"{len(reports)} of {len(paths)} FMUs were replayed.")
        raise
    _print(reports, options)
    drawn = write_files(
        *(
            (options.plot, partial(_draw, report, number=len(paths)))
            for report in reports
            if any(outcome.signals for outcome in report.outcomes)
        )
    )
    return max(0 if drawn else 1, *(report.code for report in reports))


def _print(reports: Sequence[Report], options: argparse.Namespace) -> None:
    if options.json:
        print_json([_facts(report) for report in reports])
    elif reports:
        _show(reports)


def _paths(text: str, folder: Path | None) -> list[Path]:
    from ..fmu.places import find_fmu, fmus_in
    from ..fmu.text import no_such_file

    if Path(text).is_dir():
        found = list(fmus_in(Path(text)).values())
        if not found:
            raise DescriptionError(f"{text}: no .fmu file in this folder.")
        return found
    path = find_fmu(text, folder)
    if not path.is_file():
        raise no_such_file(path)
    return [path]


def _draw(report: Report, target: Path, *, number: int) -> None:
    from ..reference.picture import draw

    draw(report, target if number == 1 else target.with_stem(f"{target.stem}_{report.path.stem}"))


def _show(reports: Sequence[Report]) -> None:
    console = standard_output()
    headings = ("FMU", "Experiment", "Signals", "Worst signal", "Share", "Verdict")
    whole = ("FMU", "Signals", "Share", "Verdict")
    table = make_table(*headings, right=("Signals", "Share"), whole=whole)
    for report in reports:
        title = escape(report.path.stem)
        for outcome in report.outcomes:
            table.add_row(title, *_row(outcome))
            title = ""
        if not report.outcomes:
            table.add_row(title, "", "", "", "", "[red]no replay[/]")
    console.print(table)
    console.print("Share: the largest difference as a part of the tolerance; 1 and below is within.")
    if any(not signal.stated for report in reports for outcome in report.outcomes for signal in outcome.signals):
        console.print("* of the default tolerance, as the FMU states none")
    for report in reports:
        for problem in report.problems:
            print_error(problem)
        for outcome in report.outcomes:
            said = f"{report.path.name}: experiment '{outcome.experiment.name}': "
            if outcome.failure:
                print_error(said + outcome.failure)
            for note in outcome.notes:
                print_note(said + note)


def _row(outcome: Replay) -> tuple[str, ...]:
    """A row of the table: experiment, number of signals, worst signal, its share of the tolerance, verdict."""
    worst = outcome.worst
    name = escape(outcome.experiment.name)
    if worst is None:
        return (name, "", "", "", "[red]failed[/]")
    outside = sum(not signal.within for signal in outcome.signals)
    stated = "" if worst.stated else "*"
    return (
        name,
        str(len(outcome.signals)),
        escape(worst.name),
        f"{worst.share:.2g}{stated}",
        "[green]within[/]" if outcome.within else f"[red]{outside} of {len(outcome.signals)} outside[/]",
    )


def _facts(report: Report) -> dict[str, Any]:
    return {
        "fmu": str(report.path),
        "name": report.name,
        "fmi_version": report.fmi,
        "interface": report.interface,
        "exit_code": report.code,
        "problems": list(report.problems),
        "experiments": [
            {
                "name": outcome.experiment.name,
                "description": outcome.experiment.description,
                "rows": outcome.rows,
                "step_size": outcome.experiment.step_size,
                "within": outcome.within,
                "failure": outcome.failure or None,
                "notes": list(outcome.notes),
                "signals": [
                    {
                        "name": signal.name,
                        "unit": signal.unit,
                        "largest_difference": signal.largest,
                        "time": signal.at,
                        "tolerance": signal.limit,
                        "tolerance_stated": signal.stated,
                        "within": signal.within,
                    }
                    for signal in outcome.signals
                ],
            }
            for outcome in report.outcomes
        ],
    }
