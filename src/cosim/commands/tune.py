"""``cosim tune``: optimizes parameters of a system."""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

from .console import Bar, check_files, common_arguments, print_note, show, write_files
from .parser import EXIT_CODES, RUN_LIMIT, count, timeout_argument
from .systems import base_argument


def add(commands: Any) -> None:
    """Add ``tune``."""
    tune = commands.add_parser(
        "tune",
        help="optimize parameters of a system",
        description="Look for the parameters with the least objective that keep all limits.",
    )
    tune.examples = ("cosim tune maeda2008/tunings/step_1mm --start tuned.toml",)
    tune.exit_codes = {**EXIT_CODES, 0: "the search has ended; the table says whether all limits are kept"}
    tune.add_argument("file", type=Path, metavar="TUNING", help="a tuning file (.toml)")
    tune.add_argument("--workers", type=count, default=2, metavar="N", help="threads (default: 2)")
    tune.add_argument("--start", type=Path, metavar="FILE", help="write a system file with the values found")
    base_argument(tune, "the start file", "that of TUNING")
    timeout_argument(tune, "a run", f"timeout in TUNING, else {RUN_LIMIT}")
    common_arguments(tune, _tune)


def _tune(options: argparse.Namespace) -> int:
    from ..design.plan import figure_units, variable_of
    from ..design.tune import Trial, read_tuning, tune, write_start
    from ..fmu.places import base_name, has_ending

    check_files(options.start)
    tuning = read_tuning(options.file, fmus=options.fmus)
    tuning = replace(tuning, timeout=options.timeout or tuning.timeout)
    base = None
    if options.start is not None:
        system = options.base or tuning.system.folder / tuning.system.name
        base = base_name(system, options.start) if has_ending(system, ".toml") or options.base else None
    with Bar("Runs") as bar:

        def advance(done: int, best: Trial | None) -> None:
            value = math.nan if best is None else best.figures.get(tuning.objective, math.nan)
            bar.update(done, None, f"best {tuning.objective} {value:.4g}")

        tuned = tune(tuning, workers=options.workers, progress=advance)
    content = {
        "parameters": dict(tuned.parameters),
        "figures": dict(tuned.best.figures),
        "feasible": tuned.feasible,
        "excess": tuned.best.excess,
        "runs": len(tuned.trials),
        "generations": tuned.generations,
        "message": tuned.message,
        "notes": tuned.notes,
    }
    units = {name: variable_of(tuning.system, name).unit or "" for name in tuned.parameters}
    units |= figure_units(tuning.system, tuning.metrics)
    values = {**tuned.parameters, **tuned.best.figures}
    rows = [(name, f"{value:.6g}", units.get(name, "")) for name, value in values.items()]
    kept = "all limits kept" if tuned.feasible else f"limits NOT kept, excess {tuned.best.excess:.3g}"
    show(options, content, [("", "Best", "Unit"), *rows], f"{options.file}: {len(tuned.trials)} runs, {kept}")
    for note in tuned.notes:
        print_note(f"note: {note}")
    return 0 if write_files((options.start, lambda path: write_start(tuned, path, base=base))) else 1
