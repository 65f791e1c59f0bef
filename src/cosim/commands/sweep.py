"""``cosim sweep``: runs a system with many start values."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..extras import require
from .console import Bar, common_arguments, print_note, show, write_files
from .parser import EXIT_CODES, RUN_LIMIT, timeout_argument


def add(commands: Any) -> None:
    """Add ``sweep``."""
    sweep = commands.add_parser(
        "sweep",
        help="run a system over many start values",
        description="Run a system over a grid, list, Latin hypercube or Sobol design of start values. "
        "The same command goes on where an interrupted sweep was.",
    )
    sweep.examples = ("cosim sweep maeda2008/sweeps/gain_friction --output results/gains",)
    sweep.exit_codes = {
        **EXIT_CODES,
        0: "every run of the design has a row; a run that failed is a row with its reason",
        1: "the data set or the report could not be written, or the workers were lost",
    }
    sweep.add_argument("file", type=Path, metavar="SWEEP", help="a sweep file (.toml)")
    sweep.add_argument(
        "--output", type=Path, metavar="DIR", help="folder of the data set (default: results/sweeps/NAME)"
    )
    sweep.add_argument(
        "--workers", type=int, metavar="N", help="processes (default: one a core; 0: this one, unprotected)"
    )
    sweep.add_argument("--scheduler", metavar="ADDRESS", help="a dask scheduler, such as tcp://host:8786")
    sweep.add_argument("--restart", action="store_true", help="delete the runs that are there and start anew")
    timeout_argument(sweep, "a run", f"timeout in SWEEP, else {RUN_LIMIT}")
    common_arguments(sweep, _sweep)


def _sweep(options: argparse.Namespace) -> int:
    from ..design import sweep as sweeps
    from ..design.sweep_report import REPORT, read_runs, write_report

    require("matplotlib", "the report of a sweep")
    plan = sweeps.read_sweep(options.file, fmus=options.fmus)
    plan = replace(plan, timeout=options.timeout or plan.timeout)
    with Bar("Runs") as bar:

        def advance(progress: sweeps.SweepProgress) -> None:
            bar.update(progress.done, progress.total, f"{progress.failed} failed" if progress.failed else "")

        outcome = sweeps.sweep(
            plan,
            options.output,
            workers=options.workers,
            scheduler=options.scheduler,
            restart=options.restart,
            progress=advance,
        )
    for note in outcome.notes:
        print_note(note)
    runs = read_runs(outcome.folder)
    page = outcome.folder / REPORT
    content: dict[str, Any] = {
        "data": str(outcome.folder / "runs"),
        "report": str(page),
        "runs": outcome.runs,
        "new": outcome.new,
        "failed": outcome.failed,
        "elapsed_seconds": outcome.elapsed,
        "run_seconds": outcome.run_seconds,
        "workers": outcome.workers,
        "figures": {spread.name: vars(spread) for spread in runs.spreads},
    }
    rows = [("Runs", f"{outcome.runs}"), ("of these now", f"{outcome.new}"), ("failed", f"{outcome.failed}")]
    rows += [("Elapsed", f"{outcome.elapsed:.3g} s"), ("Data set", content["data"]), ("Report", content["report"])]
    show(options, content, [("Sweep", ""), *rows], plan.description or plan.name)
    if runs.spreads and not options.json:
        ends = [
            (s.name, *(f"{x:.5g}" for x in (s.least, s.median, s.largest)), s.unit, f"{s.run}") for s in runs.spreads
        ]
        show(options, {}, [("Figure", "Least", "Median", "Largest", "Unit", "in run"), *ends], "")
    return 0 if write_files((page, lambda path: write_report(runs))) else 1
