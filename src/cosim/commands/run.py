"""``cosim run``, ``check`` and ``export``: commands that take a system."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from math import isfinite
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Self

from rich.box import SIMPLE, SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from ..errors import CosimError, DescriptionError, suggest
from .console import complain, fmus_argument, remark, standard_output

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from rich.progress import Progress

    from ..master.instance import RunError
    from ..result.record import RecordWriter
    from ..result.result import Result
    from ..result.summary import Row
    from ..system.system import System


MAX_SHOWN_MESSAGES = 20


MAX_SHOWN_TEXT = 1000


_GRAVITY = {"OK": 0, "Warning": 1, "Discard": 2}
"""How bad the status of a message is; all others are worse."""


def system_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of every command that takes a system."""
    parser.add_argument("system", metavar="SYSTEM", help="a system file, or one of 'cosim list' (shams2010/fsmc_5sin)")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="INST.VAR=VALUE",
        dest="values",
        help="a start value, such as plant.m=70, controller.T_s=2e-4 or trajectory.kind=sine; may be repeated",
    )
    parser.add_argument("--stop-time", metavar="SECONDS", help="end of the run, such as 2.5")
    parser.add_argument("--step-size", metavar="SECONDS", help="communication step, such as 1e-4")
    parser.add_argument(
        "--order", metavar="ORDER", help="sequential, parallel, or instances such as trajectory,controller,plant"
    )
    parser.add_argument(
        "--record",
        action="append",
        metavar="PATTERN",
        help="what to record, such as plant.position or 'controller.*'; may be repeated (default: as in the file)",
    )
    parser.add_argument("--decimation", type=int, metavar="N", help="record every N-th communication point")
    fmus_argument(parser)


# Systems


def _system(options: argparse.Namespace) -> System:
    from ..system.system import read_system
    from ..system.values import parse_value

    values: dict[str, object] = {}
    problems: list[str] = []
    for item in options.values:
        name, equals, value = item.partition("=")
        if not equals:
            problems.append(f"--set {item}: write INSTANCE.VARIABLE=VALUE, such as plant.m=70.")
        else:
            values[name.strip()] = parse_value(value.strip())
    if problems:
        raise DescriptionError(problems)
    order = options.order
    if order is not None and order not in ("sequential", "parallel"):
        order = [name.strip() for name in order.split(",")]
    return read_system(
        _system_path(options.system),
        values,
        fmus=options.fmus,
        stop_time=options.stop_time,
        step_size=options.step_size,
        order=order,
        record=options.record,
        decimation=options.decimation,
    )


def _system_path(text: str) -> Path:
    from ..fmu.places import shipped_file, shipped_systems

    path = shipped_file(text)
    if path.exists() or text.endswith((".toml", ".ssp", ".ssd")):
        return path
    raise DescriptionError(f"{text}: neither a file nor a system shipped.{suggest(text, shipped_systems())}")


def check_command(options: argparse.Namespace) -> int:
    """Check a system and say how it will run."""
    system = _system(options)
    console = standard_output()
    console.print(f"[bold]{escape(system.description or system.name)}[/]", soft_wrap=True)
    table = Table(box=SIMPLE_HEAD)
    for heading in ("Instance", "FMU", "Start values", "Steps over"):
        table.add_column(heading)
    for instance in system.instances:
        values = ", ".join(f"{name} = {value}" for name, value in list(instance.start.items())[:8])
        more = f" and {len(instance.start) - 8} more" if len(instance.start) > 8 else ""
        over = f"{system.step_size * instance.step_multiple} s"
        table.add_row(escape(instance.name), escape(instance.fmu.name), escape(values + more), over)
    console.print(table)
    for connection in system.connections:
        scaled = "" if connection.factor == 1.0 else f" * {connection.factor:g}"
        shifted = "" if connection.offset == 0.0 else f" + {connection.offset:g}"
        source, target = (".".join(end) for end in (connection.source, connection.target))
        console.print(f"  {escape(source)}{scaled}{shifted} -> {escape(target)}")
    how = "parallel, one step of delay" if system.parallel else ", ".join(system.visits)
    console.print(f"Order: {escape(how)}")
    console.print(
        f"{system.steps} steps of {system.step_size} s from {system.start_time} s to {system.stop_time} s, "
        f"{len(system.record)} variables recorded, {system.steps // system.decimation + 1} rows"
    )
    for note in system.notes:
        console.print(f"[yellow]note:[/] {escape(note)}")
    console.print("No problems.")
    return 0


def export_command(options: argparse.Namespace) -> int:
    """Write a system as SSP or TOML."""
    from ..system.ssp_write import write_ssp
    from ..system.toml_write import write_toml

    writers = {".ssp": write_ssp, ".toml": write_toml}
    suffix = options.output.suffix.lower()
    if suffix not in writers:
        raise DescriptionError(f"{options.output}: write to a file that ends in .ssp or .toml.")
    system = _system(options)
    path = writers[suffix](system, options.output)
    standard_output().print(
        f"{escape(str(path))}: {len(system.instances)} instances, {len(system.connections)} connections."
    )
    return 0


MOST_BYTES = 2**28
"""Rows of a run that stay in memory: longer records go to the file as they come, figures are of every n-th row then."""


def run_command(options: argparse.Namespace) -> int:
    """Run a system and show what came out."""
    begun = time.perf_counter()
    _check(options)
    system = _system(options)
    from ..master.instance import RunError
    from ..master.run import Interrupted

    if not options.json:
        for note in system.notes:
            remark(f"note: {note}")
    record = _RecordFile(system, options.output)
    try:
        with _Bar(system) as bar:
            result = _simulate(system, options, bar, record)
    except RunError as error:
        return _failed(error, options, record)
    except Interrupted as interruption:
        _finish(interruption.result, options, record, begun, interrupted=True)
        return 128 + interruption.number
    finally:
        record.discard()
    return _finish(result, options, record, begun)


def _check(options: argparse.Namespace) -> None:
    """Raise DescriptionError for all options that cannot work, before anything runs."""
    problems: list[str] = []
    checks: list[tuple[Path, Callable[[Path], None]]] = []
    if options.output is not None:
        from ..result.record import check_output

        checks.append((options.output, check_output))
    if options.plot is not None:
        from ..result.plots import check_picture

        checks.append((options.plot, check_picture))
    for path, check in checks:
        try:
            check(path)
        except DescriptionError as error:
            problems += error.problems
    try:
        limit = None if options.timeout is None else float(options.timeout)
    except ValueError:
        limit = 0.0
    if limit is not None and not 0.0 < limit < float("inf"):
        problems.append(f"--timeout {options.timeout}: give a positive number of seconds, such as 30.")
    elif limit is not None and options.in_process:
        problems.append("--timeout: only works for FMUs in a process of their own. Leave --in-process out.")
    if problems:
        raise DescriptionError(problems)
    options.timeout = limit


def _simulate(system: System, options: argparse.Namespace, bar: _Bar, record: _RecordFile) -> Result:
    if options.in_process:
        from ..master.simulation import simulate

        return simulate(system, progress=bar.update, debug=options.debug)
    from ..master.isolation import simulate_isolated

    return simulate_isolated(
        system,
        progress=bar.update,
        debug=options.debug,
        timeout=options.timeout,
        sink=record,
        most_bytes=MOST_BYTES,
    )


class _RecordFile:
    """The file of ``--output``, if there is one: written at the end, or as rows come if they are too many."""

    def __init__(self, system: System, path: Path | None) -> None:
        self._system = system
        self._path = path
        self._writer: RecordWriter | None = None
        self._rows = 0

    def write(self, times: NDArray[np.float64], rows: NDArray[np.float64]) -> None:
        """Take rows while the run goes on."""
        self._rows += len(rows)
        if self._path is None:
            return
        if self._writer is None:
            from ..master.run import result_columns, system_metadata
            from ..result.record import RecordWriter

            self._writer = RecordWriter(self._path, result_columns(self._system), system_metadata(self._system))
        self._writer.write(times, rows)

    def thinned(self, result: Result) -> int:
        """Of how many rows the result holds one; 1 if it holds all."""
        return int(result.metadata["decimation"]) // self._system.decimation

    def save(self, result: Result) -> None:
        """Complete the file. Raises FileError."""
        if self._writer is not None:
            late = ("steps", "warnings", "total_seconds", "stepping_seconds")
            solver = {instance: dict(counts) for instance, counts in result.solver.items()}
            known = {name: result.metadata[name] for name in late}
            writer, self._writer = self._writer, None
            writer.finish({**known, "partial": result.partial, "solver": solver})
        elif self._path is not None:
            result.save(self._path)

    def discard(self) -> None:
        """Remove a file that is not complete."""
        if self._writer is not None:
            self._writer.discard()

    def count(self, result: Result) -> int:
        """Rows of the run, all of them."""
        return self._rows or len(result.time)


def _failed(error: RunError, options: argparse.Namespace, record: _RecordFile) -> int:
    """Tell of a run that failed and keep what it computed; returns the exit code."""
    from ..master.isolation import RecordError

    result = error.result
    if result is not None:
        _show_messages(result, but=error.message)
    complain(str(error))
    if result is not None and result.time.size:
        if isinstance(error, RecordError):
            remark(f"Computed up to {result.time[-1]:.9g} s.")
        else:
            _save(result, options, record)
    return 1


def _save(result: Result, options: argparse.Namespace, record: _RecordFile) -> bool:
    """Write the files of a run; whether that went well. Tells of what was not written, and of a run that ended early.

    An error in one file does not keep the other from being written.
    """
    well = True
    kept = "; name a file with --output to keep them" if options.output is None else f", kept in {options.output}"
    if options.output is not None and result.time.size:
        try:
            record.save(result)
        except CosimError as error:
            complain(str(error))
            well, kept = False, ""
    if result.partial and not result.time.size:
        remark("Nothing had been computed.")
    elif result.partial:
        remark(f"Computed up to {result.time[-1]:.9g} s ({record.count(result)} rows){kept}.")
    if options.plot is not None and result.time.size > 1:
        from ..result.plots import plot_run

        try:
            plot_run(result, options.plot)
        except CosimError as error:
            complain(str(error))
            well = False
    return well


def _finish(
    result: Result, options: argparse.Namespace, record: _RecordFile, begun: float, *, interrupted: bool = False
) -> int:
    """Messages, files and the summary that end a run; returns the exit code."""
    _show_messages(result)
    if interrupted:
        complain("Interrupted.")
    well = _save(result, options, record)
    every = record.thinned(result)
    if every > 1:
        remark(f"note: {record.count(result)} rows; figures and pictures are of every {every}th.")
    figures = _figures(result)
    facts = result.metadata
    simulated = facts["steps"] * facts["step_size"]
    factor = simulated / facts["stepping_seconds"] if facts["stepping_seconds"] > 0.0 else float("inf")
    if options.json:
        summary = {
            "system": facts["system"],
            "system_hash": facts["system_hash"],
            "partial": result.partial,
            "steps": facts["steps"],
            "step_size": facts["step_size"],
            "simulated_seconds": simulated,
            "stepping_seconds": facts["stepping_seconds"],
            "elapsed_seconds": time.perf_counter() - begun,
            "real_time_factor": factor,
            "warnings": facts["warnings"],
            "solver": {name: dict(counts) for name, counts in result.solver.items()},
            "figures": [
                {"name": row.name, "value": row.value if isfinite(row.value) else None, "unit": row.unit}
                for row in figures
            ],
            "output": None if options.output is None else str(options.output),
            "plot": None if options.plot is None else str(options.plot),
        }
        sys.stdout.write(json.dumps(summary, indent=2) + "\n")
        return 0 if well else 1
    table = Table(
        title=escape(str(facts["description"] or facts["system"])), title_justify="left", show_header=False, box=SIMPLE
    )
    table.add_column()
    table.add_column(justify="right")
    table.add_column()
    table.add_row("Simulated", f"{simulated:.9g}", "s")
    table.add_row("Steps", f"{facts['steps']}", f"of {facts['step_size']:g} s")
    table.add_row("Time of the steps", f"{facts['stepping_seconds']:.3g}", f"s, {factor:.3g} times real time")
    for instance, counts in result.solver.items():
        if "rhs_evaluations" in counts and facts["steps"]:
            per_step = counts["rhs_evaluations"] / facts["steps"]
            rejected = f", {counts['rejected']:.0f} rejected" if counts.get("rejected") else ""
            steps = f"{counts.get('steps', 0.0):.0f} steps{rejected}"
            table.add_row(f"{escape(instance)}: equations evaluated", f"{per_step:.3g}", f"times a step ({steps})")
    if figures:
        table.add_section()
    for row in figures:
        value, unit = (f"{row.value:.4g}", row.unit) if isfinite(row.value) else ("never", "")
        table.add_row(escape(row.name), value, escape(unit))
    console = standard_output()
    console.print(table)
    for file in (options.output, options.plot):
        if file is not None and well:
            console.print(f"Written: {escape(str(file))}", soft_wrap=True)
    return 0 if well else 1


def _figures(result: Result) -> list[Row]:
    """Tracking figures, none for a run too short to have them."""
    from ..result.summary import summary

    try:
        return summary(result)
    except DescriptionError:
        return []


def _show_messages(result: Result, but: str = "") -> None:
    """What FMUs logged, without the message ``but``, which is told elsewhere."""
    messages = [message for message in result.messages if message.text != but]
    # The worst of them first, so that many harmless ones do not hide it; then in the order of time again.
    worst = sorted(messages, key=lambda message: _GRAVITY.get(message.status, 3), reverse=True)[:MAX_SHOWN_MESSAGES]
    for message in sorted(worst, key=lambda message: message.time):
        text = str(message)
        remark(text if len(text) <= MAX_SHOWN_TEXT else f"{text[:MAX_SHOWN_TEXT]} ... ({len(text)} characters)")
    more = len(messages) - len(worst) + result.dropped_messages
    if more > 0:
        remark(f"and {more} more messages")


class _Bar(AbstractContextManager["_Bar"]):
    """A progress bar for work of more than a second, on a terminal only."""

    def __init__(self, system: System) -> None:
        self._length = float(system.stop_time - system.start_time)
        self._start = time.perf_counter()
        self._bar: Progress | None = None

    def update(self, fraction: float) -> None:
        if self._bar is None:
            if time.perf_counter() - self._start < 1.0 or not sys.stderr.isatty():
                return
            from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

            columns = BarColumn(), TextColumn("{task.completed:.3g} of {task.total:g} s"), TimeRemainingColumn()
            self._bar = Progress(*columns, console=Console(stderr=True), transient=True)
            self._bar.add_task("", total=self._length)
            self._bar.start()
        self._bar.update(self._bar.task_ids[0], completed=fraction * self._length)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()
