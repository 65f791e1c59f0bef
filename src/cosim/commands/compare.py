"""``cosim compare``: compares two runs, two records, or one of each."""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.markup import escape

from ..errors import DescriptionError
from .console import (
    Bar,
    check_page,
    check_plot,
    fmus_argument,
    make_table,
    print_json,
    print_note,
    problems_of,
    set_argument,
    standard_output,
    write_files,
)
from .parser import EXIT_CODES, timeout_argument
from .systems import given_values, stated_units, units_argument

if TYPE_CHECKING:
    from ..record.read import Record
    from ..result.compare import Comparison, Difference, Tolerance
    from ..result.result import Result
    from ..system.system import System


def add(commands: Any) -> None:
    """Add ``compare``."""
    compare = commands.add_parser(
        "compare",
        help="compare two runs or records, or a run with a record",
        description="Compare B with the reference A: each is a system or an FMU, which is run, or a record "
        "(.csv, .tsv, .txt, .dat, .parquet, .mat). Units are converted, the delay is estimated and said, the side "
        "with longer steps keeps its samples.",
    )
    compare.examples = (
        "cosim compare docs/examples/your_machine/motor.csv docs/examples/your_machine/motor.toml "
        "--signals position=plant.position --plot motor.png",
        "cosim compare maeda2008/step maeda2008/step --set-b plant.tolerance=1e-7 --signals plant.position "
        "--tolerance 10nm",
    )
    compare.exit_codes = {
        **EXIT_CODES,
        0: "within the tolerances, or no tolerance was given",
        1: "outside the tolerances, a run failed, or a file could not be written",
    }
    compare.add_argument("a", metavar="A", help="the reference: a system, an FMU or a record")
    compare.add_argument("b", metavar="B", help="what is compared with it")
    signals_argument(compare)
    compare.add_argument(
        "--tolerance",
        action="extend",
        nargs="+",
        default=[],
        metavar="[NAME=]VALUE",
        help="tolerance of all signals, or of one: 1e-6 (its unit), 2um, or 1%% of the range of A; both kinds add up",
    )
    compare.add_argument(
        "--time-tolerance", metavar="SECONDS", help="B may be this early or late within the tolerances (default: 0)"
    )
    compare.add_argument(
        "--delay", default="0", metavar="SECONDS", help="move B back by this, or by its 'estimate' (default: 0)"
    )
    compare.add_argument(
        "--interpolation",
        choices=("linear", "hold"),
        default="linear",
        help="how values between samples are found (default: linear)",
    )
    compare.add_argument("--from", dest="start", metavar="SECONDS", help="compare from this time of A on")
    compare.add_argument("--to", dest="stop", metavar="SECONDS", help="compare up to this time of A")
    set_argument(compare)
    compare.add_argument(
        "--set-b", action="append", default=[], metavar="INST.VAR=VALUE", help="start values of B only; may be repeated"
    )
    compare.add_argument("--stop-time", metavar="SECONDS", help="end of the runs")
    compare.add_argument("--time", metavar="COLUMN", help="the column of time of records (default: time or t)")
    compare.add_argument("--sampling-time", metavar="SECONDS", help="step of records that have no time column")
    units_argument(compare)
    compare.add_argument("--plot", type=Path, metavar="FILE", help="draw both and their difference")
    compare.add_argument("--report", type=Path, metavar="FILE", help="write a page, such as both.html (extra report)")
    compare.add_argument("--json", action="store_true", help="print the comparison as JSON, for scripts")
    timeout_argument(compare)
    fmus_argument(compare)
    compare.set_defaults(command=_compare)


def signals_argument(parser: argparse.ArgumentParser) -> None:
    """Add ``--signals``."""
    parser.add_argument(
        "--signals",
        action="extend",
        nargs="+",
        metavar="NAME[=OTHER]",
        help="what to compare: a name of both, or that of A and that of B (default: all names that both have)",
    )


def given_signals(items: Sequence[str] | None) -> dict[str, str] | None:
    """The pairs of ``--signals``; None if there are none."""
    if not items:
        return None
    return {name: other or name for name, _, other in (item.partition("=") for item in items)}


def _compare(options: argparse.Namespace) -> int:
    from ..result.compare import compare

    problems: list[str] = []
    numbers, tolerances = _check(options, problems)
    sides = _opened(options, numbers, problems)
    labels = _labels(options)
    sources = _source(sides[0], options.timeout), _source(sides[1], options.timeout)
    signals = given_signals(options.signals)
    shown = _tolerances(tolerances, signals, sources, numbers["time_tolerance"])
    found = compare(
        sources[0],
        sources[1],
        signals,
        tolerance=shown,
        delay="estimate" if options.delay == "estimate" else numbers["delay"],
        interpolation=options.interpolation,
        start=numbers["start"],
        stop=numbers["stop"],
        labels=labels,
    )
    given = {"plot": options.plot, "report": options.report}
    if options.json:
        files = {name: None if file is None else str(file) for name, file in given.items()}
        print_json({**comparison_content(found), **files})
    else:
        show_comparison(found)
    well = _write(found, options, sources)
    for file in given.values() if well and not options.json else ():
        if file is not None:
            standard_output().print(f"Written: {escape(str(file))}", soft_wrap=True)
    return 0 if well and found.within else 1


# Options.


def _check(options: argparse.Namespace, problems: list[str]) -> tuple[dict[str, float], list[tuple[str, Tolerance]]]:
    """The numbers among the options, and the tolerances by name. Wrong options are appended to ``problems``."""
    numbers: dict[str, float] = {}
    given = (
        ("time_tolerance", options.time_tolerance, 0.0, 0.0),
        ("sampling_time", options.sampling_time, 0.0, 0.0),
        ("start", options.start, -math.inf, -math.inf),
        ("stop", options.stop, math.inf, -math.inf),
        ("delay", None if options.delay == "estimate" else options.delay, 0.0, -math.inf),
    )
    words = {"start": "--from", "stop": "--to"}
    for name, text, default, least in given:
        numbers[name] = default
        if text is None:
            continue
        try:
            numbers[name] = float(text)
        except ValueError:
            numbers[name] = math.nan
        if not (math.isfinite(numbers[name]) and numbers[name] >= least):
            said = words.get(name, f"--{name.replace('_', '-')}")
            problems.append(f"{said} {text}: give a number of seconds{' from 0 on' if least == 0.0 else ''}.")
    if numbers["start"] > numbers["stop"]:
        problems.append(f"--from {options.start} is after --to {options.stop}.")
    tolerances: list[tuple[str, Tolerance]] = []
    for item in options.tolerance:
        try:
            tolerances.append(_tolerance(item))
        except DescriptionError as error:
            problems += error.problems
    problems += problems_of(lambda: check_plot(options.plot), lambda: check_page(options.report))
    return numbers, tolerances


_VALUE = re.compile(r"(?P<number>[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?)\s*(?P<unit>\S*)")


def _tolerance(item: str) -> tuple[str, Tolerance]:
    """Name and tolerance of ``NAME=VALUE`` or ``VALUE``. Without a name (""), it holds for all signals.

    Raises DescriptionError if the value cannot be read.
    """
    from ..result.compare import Tolerance
    from ..units import parse_unit

    name, _, text = item.rpartition("=")
    match = _VALUE.fullmatch(text.strip())
    if match is None:
        raise DescriptionError(f"--tolerance {item}: give a number, such as 1e-6, 2um or 1%.")
    number, unit = float(match["number"]), match["unit"]
    if number < 0.0 or not math.isfinite(number):
        raise DescriptionError(f"--tolerance {item}: must be a finite number that is not negative.")
    if unit == "%":
        return name, Tolerance(relative=number / 100.0)
    if unit:
        parse_unit(unit)
    return name, Tolerance(absolute=number, unit=unit)


def _tolerances(
    given: Sequence[tuple[str, Tolerance]],
    signals: Mapping[str, str] | None,
    sources: Sequence[Result | Record],
    time: float,
) -> dict[str, Tolerance] | None:
    """The tolerances by name; None if there are none.

    A tolerance for all signals holds for each signal without its own tolerance.
    """
    from ..result.align import common_names, side_of
    from ..result.compare import Tolerance

    if not given and not time:
        return None
    every: list[Tolerance] = [entry for name, entry in given if not name]
    own: dict[str, list[Tolerance]] = {}
    for name, entry in given:
        if name:
            own.setdefault(name, []).append(entry)
    a, b = (side_of(source, "") for source in sources)
    names = list(signals) if signals is not None else common_names(a, b)
    chosen = {name: own.get(name, every) for name in (*names, *own)}
    if every or not own:
        chosen = {name: entries or [Tolerance()] for name, entries in chosen.items()}
    return {name: replace(_sum(entries), time=time) for name, entries in chosen.items() if entries}


def _sum(entries: Sequence[Tolerance]) -> Tolerance:
    """The absolute and the relative tolerance of a signal in one Tolerance. Of several of one kind, the last counts."""
    from ..result.compare import Tolerance

    found = Tolerance()
    for entry in entries:
        if entry.relative:
            found = replace(found, relative=entry.relative)
        else:
            found = replace(found, absolute=entry.absolute, unit=entry.unit)
    return found


# Sides.


def _opened(
    options: argparse.Namespace, numbers: Mapping[str, float], problems: list[str]
) -> list[System | Result | Record]:
    """Read and check both sides without running them. Raises DescriptionError with ``problems`` and all others."""
    sides: list[System | Result | Record] = []
    both: dict[str, object] = {}
    only_b: dict[str, object] = {}
    problems += problems_of(lambda: both.update(given_values(options.values)))
    wrong = problems_of(lambda: only_b.update(given_values(options.set_b)))
    problems += [text.replace("--set ", "--set-b ", 1) for text in wrong]
    for text, values in ((options.a, both), (options.b, {**both, **only_b})):
        try:
            sides.append(_side(text, values, options, numbers["sampling_time"]))
        except DescriptionError as error:
            problems += [problem for problem in error.problems if problem not in problems]
    if len(sides) == 2:
        records = [_is_record(text) for text in (options.a, options.b)]
        if all(records) and (options.values or options.stop_time is not None):
            problems.append("--set and --stop-time apply to runs, and both sides are records. Leave them out.")
        if records[1] and options.set_b:
            problems.append(f"--set-b is of a run, and {options.b} is a record. Leave it out.")
    if problems:
        raise DescriptionError(problems)
    return sides


def _is_record(text: str) -> bool:
    from ..record.tables import TEXT

    return Path(text).suffix.lower() in (*TEXT, ".parquet", ".mat")


def _side(
    text: str, values: Mapping[str, object], options: argparse.Namespace, sampling_time: float
) -> System | Result | Record:
    if _is_record(text):
        return open_record(text, options.time, sampling_time or None, options.units)
    from ..system.system import read_system

    return read_system(text, values, fmus=options.fmus, stop_time=options.stop_time)


def open_record(
    text: str | Path, time: str | None, sampling_time: float | None, units: Sequence[str]
) -> Result | Record:
    """Read a record, or the result of a run, from a file; ``sampling_time`` in s. Raises DescriptionError."""
    from ..record.read import read_record

    stated = stated_units(units)
    if time is None and sampling_time is None and not stated:
        from ..result.read import holds_result, read_result

        if holds_result(Path(text)):
            return read_result(text)
    return read_record(text, time=time, sampling_time=sampling_time, units=stated)


def _labels(options: argparse.Namespace) -> tuple[str, str]:
    """Short names of both sides. They are never equal."""
    names = [Path(text).name or text for text in (options.a, options.b)]
    if options.set_b:
        names[1] += f" ({', '.join(options.set_b)})"
    if names[0] == names[1]:
        names = [options.a, options.b]
    if names[0] == names[1]:
        names = [f"A: {names[0]}", f"B: {names[1]}"]
    return names[0], names[1]


def _source(side: System | Result | Record, timeout: float | None) -> Result | Record:
    """The record or result of a side. A system is run first. Raises RunError if the run fails."""
    from ..system.system import System

    if not isinstance(side, System):
        return side
    from ..master.isolation import simulate_isolated

    length = float(side.stop_time - side.start_time)
    for note in side.notes:
        print_note(f"note: {side.name}: {note}")
    with Bar(side.name) as bar:
        return simulate_isolated(side, progress=lambda share: bar.update(share * length, length), timeout=timeout)


# Output.


def _write(found: Comparison, options: argparse.Namespace, sources: Sequence[Result | Record]) -> bool:
    """Write the picture and the page. Returns whether both could be written."""
    from ..result.compare_report import plot_comparison, report_comparison

    return write_files(
        (options.plot, lambda path: plot_comparison(found, path)),
        (options.report, lambda path: report_comparison(found, path, (sources[0], sources[1]))),
    )


def show_comparison(found: Comparison) -> None:
    """Print a comparison, each signal in a unit that suits the size of its difference."""
    from ..result.plots import display_unit

    console = standard_output()
    for note in (f"Compared: {found.how}.", *found.notes):
        console.print(escape(note), soft_wrap=True)
    headings = ("Signal", "Unit", "Largest", "at [s]", "rms", "rms [%]", "Fit [%]")
    table = make_table(*headings, right=headings[2:], whole=headings[2:], title=f"{found.b} minus {found.a}")
    for entry in found.differences:
        unit, factor = display_unit(entry.unit, entry.maximum)
        numbers = [_number(factor * entry.maximum, 3), f"{entry.at:.7g}", _number(factor * entry.rms, 3)]
        numbers.append(_number(100.0 * entry.relative, 3))
        numbers.append(f"{entry.fit:.6g}" if math.isfinite(entry.fit) else "none")
        table.add_row(escape(_name(entry)), escape(unit), *numbers)
    console.print(table)
    if found.tracking:
        table = make_table("", "", "", right=("1",), whole=("1",), title="Tracking errors")
        for entry in found.tracking:
            unit, factor = display_unit(entry.unit, max(entry.rms_a, entry.rms_b))
            for said, value in (
                (f"{entry.loop}: rms of {found.a}", entry.rms_a),
                (f"{entry.loop}: rms of {found.b}", entry.rms_b),
                (f"{entry.loop}: difference, largest", entry.maximum),
                (f"{entry.loop}: difference, rms", entry.rms),
            ):
                table.add_row(escape(said), _number(factor * value), escape(unit))
        console.print(table)
    for line in _verdicts(found):
        console.print(line, soft_wrap=True)


def _number(value: float, digits: int = 4) -> str:
    return f"{value:.{digits}g}" if math.isfinite(value) else "none"


def _name(entry: Difference) -> str:
    return entry.name if entry.name == entry.other else f"{entry.name} / {entry.other}"


def _verdicts(found: Comparison) -> list[str]:
    """One line for each signal outside its tolerance, and a line with the number of signals within."""
    judged = [entry for entry in found.differences if entry.tube is not None]
    lines: list[str] = []
    for entry in judged:
        if (out := entry.outside) is not None:
            beyond = f"by up to {out.excess:.4g} {entry.unit}" if math.isfinite(out.excess) else "not finite"
            share = f"{out.count} samples ({100.0 * out.share:.3g} %)"
            lines.append(
                f"[bold red]{escape(_name(entry))}: outside its tolerance[/] in {share}, from {out.first:.6g} s on, "
                f"{escape(beyond)}"
            )
    within = len(judged) - len(lines)
    return [*lines, f"Within their tolerances: {within} of {len(judged)} signals."] if judged else []


def comparison_content(found: Comparison) -> dict[str, Any]:
    """A comparison as a table for JSON."""
    return {
        "a": found.a,
        "b": found.b,
        "within": found.within,
        "compared": found.how,
        "delay_seconds": found.delay,
        "estimated_delay_seconds": found.estimated_delay,
        "signals": [
            {
                "name": entry.name,
                "other": entry.other,
                "unit": entry.unit,
                "max": entry.maximum,
                "at_seconds": entry.at,
                "rms": entry.rms,
                "mean": entry.mean,
                "relative": entry.relative,
                "fit_percent": entry.fit,
                "peak_hertz": None if entry.spectrum is None else entry.spectrum.peak_frequency,
                "peak_amplitude": None if entry.spectrum is None else entry.spectrum.peak_amplitude,
                "within": None if entry.tube is None else entry.outside is None,
                "outside": None if entry.outside is None else asdict(entry.outside),
            }
            for entry in found.differences
        ],
        "tracking": [asdict(entry) for entry in found.tracking],
        "notes": list(found.notes),
    }
