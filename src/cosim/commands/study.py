"""``cosim study``: run a study, write its report, show the verdicts."""

from __future__ import annotations

from pathlib import Path

from ..study import find_study, judge, load_study, matching_runs, run_study


def main(name: str, output: Path | None = None, *, runs: str = "*", jobs: int = 1, fmus: Path | None = None) -> int:
    """``cosim study``: run a study, write its report into ``output`` (results/NAME), show the verdicts.

    Returns 0, or 1 if a run failed; a claim that does not hold is a finding, not a failure.
    """
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
    from rich.table import Table

    from ..study.report import STYLES, counts, values, write_report

    folder = find_study(name)
    study = load_study(folder)
    console, errors = Console(highlight=False), Console(stderr=True, highlight=False)
    if not console.is_terminal:
        console.width = max(console.width, 160)
    columns = BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("{task.description}")
    with Progress(*columns, console=errors, transient=True) as bar:
        names = matching_runs(study, runs)
        task = bar.add_task("", total=len(names))
        outcomes = run_study(
            folder,
            pattern=runs,
            jobs=jobs,
            fmus=fmus,
            progress=lambda outcome: bar.update(task, advance=1, description=escape(outcome.name)),
        )
    verdicts = [judge(claim, outcomes) for claim in study.claims]
    report = write_report(output or Path("results") / folder.name, folder.name, study, outcomes, verdicts)
    table = Table(title=escape(study.title), title_justify="left", box=SIMPLE_HEAD)
    for heading in ("", "Claim", "Measured", "Verdict"):
        table.add_column(heading)
    for verdict in verdicts:
        claim = verdict.claim
        measured = values(verdict.measured, claim.unit) or verdict.reason
        style = STYLES[verdict.status]
        table.add_row(claim.id, escape(claim.text), escape(measured), f"[{style}]{verdict.status}[/]")
    console.print(table)
    console.print(", ".join(f"{count} {status}" for status, count in counts(verdicts).items()))
    console.print(f"Written: {escape(str(report))}")
    failed = [outcome for outcome in outcomes.all() if outcome.failure]
    for outcome in failed:
        errors.print(f"[bold red]error:[/] run {escape(outcome.name)}: {escape(outcome.failure)}", soft_wrap=True)
    return 1 if failed else 0
