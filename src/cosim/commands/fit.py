"""``cosim fit``: fits parameters of a system to records of the real machine."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .console import Bar, check_files, check_page, common_arguments, print_note, show, write_files
from .parser import RUN_LIMIT, count, timeout_argument
from .systems import base_argument

if TYPE_CHECKING:
    from ..design.fit import Fitted


def add(commands: Any) -> None:
    """Add ``fit``."""
    fit = commands.add_parser(
        "fit",
        help="fit parameters of a system to records of the real machine",
        description="Fit start values of a system, and delay, gain and bias of its sensors, to records; say how well "
        "the records tell them, and how the system then agrees with records that were not fitted.",
    )
    fit.examples = (
        "cosim fit docs/examples/your_machine/motor_fit.toml --dry-run",
        "cosim fit docs/examples/your_machine/motor_fit.toml --output results/motor",
    )
    fit.add_argument("file", type=Path, metavar="FIT", help="a fit file (.toml)")
    fit.add_argument("--dry-run", action="store_true", help="show what the records would tell; fit and write nothing")
    fit.add_argument(
        "--output", type=Path, metavar="DIR", help="folder for start.toml, fit.json and a .csv for each record"
    )
    fit.add_argument("--report", type=Path, metavar="FILE", help="write a page (.html) with everything")
    base_argument(fit, "start.toml", "that of FIT")
    fit.add_argument("--workers", type=count, metavar="N", help="processes (default: one a core)")
    timeout_argument(fit, "a run", f"timeout in FIT, else {RUN_LIMIT}")
    common_arguments(fit, _fit)


def _fit(options: argparse.Namespace) -> int:
    from ..design import fit
    from ..fmu.places import base_name, shipped_file

    if options.dry_run and (options.output or options.report):
        print_note("note: --dry-run writes nothing: --output and --report are left out.")
        options.output = options.report = None
    check_page(options.report)
    start = None if options.output is None else options.output / "start.toml"
    check_files(start)
    problem = fit.read_fit(options.file, fmus=options.fmus)
    problem = replace(problem, timeout=options.timeout or problem.timeout)
    base = None
    if start is not None:
        base = base_name(options.base or shipped_file(problem.system, problem.folder), start)
    for note in problem.notes:
        print_note(f"note: {note}")
    with Bar("Runs") as bar:

        def advance(loops: int, cost: float) -> None:
            bar.update(loops, None, f"rms {cost**0.5:.4g} x noise" if cost < 1e300 else "")

        look = fit.sensitivities if options.dry_run else fit.fit
        fitted = look(problem, workers=options.workers, progress=advance)
    _show(options, fitted)

    def write_values(path: Path) -> None:
        for written in fit.write_fit(fitted, path.parent, base=base):
            print_note(f"Written: {written}")

    def write_report(path: Path) -> None:
        from ..design.fit_report import write_page

        print_note(f"Written: {write_page(fitted, path)}")

    return 0 if write_files((start, write_values), (options.report, write_report)) else 1


def _show(options: argparse.Namespace, fitted: Fitted) -> None:
    from ..design.fit import summary

    if options.json:
        show(options, summary(fitted), [], "")
        return
    title = f"{options.file}: {'nothing fitted' if options.dry_run else fitted.message}"
    title += f"; {fitted.loops} runs of a record in {fitted.seconds:.3g} s"
    rows: list[tuple[str, ...]] = [("", "Start" if options.dry_run else "Value", "+- 95 %", "Unit")]
    for e in fitted.estimates:
        half = f"{0.5 * (e.high - e.low):.2g}" if e.told else "not told"
        rows.append((e.name + (" (at its bound)" if e.at_bound else ""), f"{e.value:.7g}", half, e.unit))
    show(options, {}, rows, title)
    outputs = list(fitted.fit.outputs)
    rows = [("1 % more of", *(f"{o.name} / {o.unit} rms" for o in outputs))]
    rows += [(e.name, *(f"{e.effects[o.name]:.3g}" for o in outputs)) for e in fitted.estimates]
    rows.append(("(noise)", *(f"{o.noise:.3g}" for o in outputs)))
    if options.dry_run:
        show(options, {}, rows, "Change of the outputs")
    _show_comparisons(options, fitted)
    for sentence in fitted.findings:
        print_note(f"note: {sentence}")


def _show_comparisons(options: argparse.Namespace, fitted: Fitted) -> None:
    from ..result.plots import display_unit

    rows: list[tuple[str, ...]] = [("Record", "rms", "largest", "Unit", "rms / %", "fit / %", "lap to lap")]
    for c in fitted.comparisons:
        unit, factor = display_unit(c.unit, c.largest)
        laps = f"{factor * c.repeatability:.3g}" if c.repeatability == c.repeatability else "-"
        name = f"{c.record} {c.output}{' (not fitted)' if c.validates else ''}"
        figures = f"{factor * c.rms:.4g}", f"{factor * c.largest:.3g}", unit
        rows.append((name, *figures, f"{c.relative:.3g}", f"{c.fit:.4g}", laps))
    show(options, {}, rows, "Record minus system")
