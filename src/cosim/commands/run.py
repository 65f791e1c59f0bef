"""``cosim run``: runs a system and shows its results."""

from __future__ import annotations

import argparse
import contextlib
import time
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from math import isfinite
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from rich.markup import escape

from ..errors import CosimError, DescriptionError, listed
from .compare import comparison_content, show_comparison
from .console import (
    Bar,
    check_page,
    check_plot,
    make_table,
    print_error,
    print_json,
    print_note,
    problems_of,
    standard_output,
    write_files,
)
from .overlay import Overlay, opened, overlay_arguments
from .parser import EXIT_CODES, timeout_argument
from .systems import given_system, system_arguments

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from rich.table import Table

    from ..master.instance import RunError
    from ..record.write import RecordWriter
    from ..result.compare import Comparison
    from ..result.result import Result
    from ..result.summary import FigureOfMerit, Missing
    from ..system.system import System

MOST_BYTES = 2**28
"""Largest size in bytes of the rows of a run that are kept in memory.

A longer record is written to its file during the run. Figures are then computed from every n-th row.
"""
_FILES = ("output", "plot", "report")
"""Options that name the files of a run."""
WHOLE_NAME = 44
"""Longest name of a figure that is not wrapped."""
MAX_SHOWN_MESSAGES = 20
"""Largest number of messages of FMUs that are shown after a run; the gravest come first."""
MAX_SHOWN_TEXT = 1000
"""Largest number of characters shown of a message; about twelve lines of a terminal."""
MAX_SHOWN_NAMES = 5
"""Largest number of names of variables in a line about values that are not finite."""
TRIAL_SECONDS = 2.0
"""Time that the end of a run waits for the trial, which looks for forgotten inputs at the same time."""
_GRAVITY = {"OK": 0, "Warning": 1, "Discard": 2}
"""Rank of the status of a message, from harmless to bad. All other statuses have rank 3."""


def add(commands: Any) -> None:
    """Add ``run``."""
    run = commands.add_parser(
        "run",
        help="run a system, or an FMU alone",
        description="Run a system and show what came out. An FMU runs alone, over the times that its file suggests.",
    )
    run.examples = (
        "cosim run shams2010/fsmc_5sin --set plant.m=70 --output result.csv",
        "cosim run Trajectory --set kind=quintic --plot move.png",
        "cosim run docs/examples/your_machine/motor.toml --record plant.position "
        "--overlay docs/examples/your_machine/motor.csv --signals plant.position=position --report motor.html",
    )
    run.exit_codes = {
        **EXIT_CODES,
        0: "the run is complete",
        1: "the run failed, a recorded value is not finite, or a file could not be written",
    }
    system_arguments(run)
    run.add_argument(
        "--output", type=Path, metavar="FILE", help="write the record as .csv, or as .parquet with the extra parquet"
    )
    run.add_argument("--plot", type=Path, metavar="FILE", help="draw the run, such as run.png")
    run.add_argument(
        "--report", type=Path, metavar="FILE", help="write a page with all of the run, such as run.html (extra report)"
    )
    overlay_arguments(run)
    run.add_argument("--json", action="store_true", help="print the summary as JSON, for scripts")
    run.add_argument(
        "--keep-going", action="store_true", help="go on if a connection carries a value that is not finite"
    )
    timeout_argument(run)
    run.add_argument(
        "--in-process",
        action="store_true",
        help="run the FMUs in this process, for a debugger: an FMU that crashes takes everything with it",
    )
    run.add_argument("--debug", action="store_true", help="show everything the FMUs log, not only what went wrong")
    run.set_defaults(command=_run)


def _run(options: argparse.Namespace) -> int:
    """Run a system and show its results. Returns the exit code."""
    begun = time.perf_counter()
    _check(options)
    system = given_system(options)
    overlay = opened(options, system)
    from ..master.instance import RunError
    from ..master.run import Interrupted
    from ..master.trial import Trial
    from ..system.unconnected import fitting_outputs

    notes = list(system.notes)
    with contextlib.ExitStack() as resources:
        trial = resources.enter_context(Trial(system)) if fitting_outputs(system) else None
        _show_notes(notes, options)
        record = resources.enter_context(_RecordFile(system, options.output))
        try:
            with Bar("Seconds") as bar:
                result = _simulate(system, options, bar, record)
        except RunError as error:
            return _failed(error, options, record)
        except Interrupted as interruption:
            _finish(interruption.result, options, record, begun, notes, overlay=overlay, interrupted=True)
            return 128 + interruption.number
        if trial is not None:
            said = _said(result)
            found = [note for note in trial.findings(seconds=TRIAL_SECONDS).notes if note not in said]
            _show_notes(found, options)
            notes += found
        return _finish(result, options, record, begun, notes, overlay=overlay)


def _show_notes(notes: Sequence[str], options: argparse.Namespace) -> None:
    if not options.json:
        for note in notes:
            print_note(f"note: {note}")


def _check(options: argparse.Namespace) -> None:
    """Check all options before anything runs. Raises DescriptionError with all problems."""
    problems: list[str] = []
    if options.output is not None:
        from ..record.write import check_output

        problems += problems_of(lambda: check_output(options.output))
    problems += problems_of(lambda: check_plot(options.plot), lambda: check_page(options.report))
    if options.timeout is not None and options.in_process:
        problems.append("--timeout: only works for FMUs in a process of their own. Leave --in-process out.")
    if problems:
        raise DescriptionError(problems)


def _simulate(system: System, options: argparse.Namespace, bar: Bar, record: _RecordFile) -> Result:
    length = float(system.stop_time - system.start_time)

    def progress(share: float) -> None:
        bar.update(share * length, length)

    if options.in_process:
        from ..master.simulation import simulate

        return simulate(system, progress=progress, debug=options.debug, keep_going=options.keep_going)
    from ..master.isolation import simulate_isolated

    return simulate_isolated(
        system,
        progress=progress,
        debug=options.debug,
        keep_going=options.keep_going,
        timeout=options.timeout,
        sink=record,
        most_bytes=MOST_BYTES,
    )


class _RecordFile(AbstractContextManager["_RecordFile"]):
    """The file of ``--output``, if there is one. It is written after the run, or during a run with many rows."""

    def __init__(self, system: System, path: Path | None) -> None:
        self._system = system
        self._path = path
        self._writer: RecordWriter | None = None
        self._rows = 0

    def write(self, times: NDArray[np.float64], rows: NDArray[np.float64]) -> None:
        """Take rows during the run; ``times`` in s. Raises FileError."""
        self._rows += len(rows)
        if self._path is None:
            return
        if self._writer is None:
            from ..master.metadata import result_columns, system_metadata
            from ..record.write import RecordWriter

            self._writer = RecordWriter(self._path, result_columns(self._system), system_metadata(self._system))
        self._writer.write(times, rows)

    def thinned(self, result: Result) -> int:
        """The number n if the result holds every n-th row; 1 if it holds all rows."""
        return int(result.metadata["decimation"]) // self._system.decimation

    def save(self, result: Result) -> None:
        """Complete the file. Raises FileError."""
        if self._writer is not None:
            late = ("steps", "warnings", "total_seconds", "stepping_seconds")
            known = {name: result.metadata[name] for name in late}
            writer, self._writer = self._writer, None
            writer.finish({**known, **result.ending()})
        elif self._path is not None:
            result.save(self._path)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Remove an incomplete file."""
        if self._writer is not None:
            self._writer.discard()

    def count(self, result: Result) -> int:
        """The number of all rows of the run."""
        return self._rows or len(result.time)


def _failed(error: RunError, options: argparse.Namespace, record: _RecordFile) -> int:
    """Print the error of a failed run and write the rows computed so far; returns the exit code."""
    from ..master.isolation import RecordError

    result = error.result
    if result is not None:
        _show_messages(result, but=error.message)
    print_error(str(error))
    if result is not None and result.time.size:
        if isinstance(error, RecordError):
            print_note(f"Computed up to {result.time[-1]:.9g} s.")
        else:
            _save(result, options, record, early=True)
            _draw(result, options, [str(error)])
    return 1


def _save(result: Result, options: argparse.Namespace, record: _RecordFile, *, early: bool) -> bool:
    """Write the record of a run. Returns whether it could be written, and prints an error if not.

    Prints a note for a run that ended ``early``.
    """
    well = True
    kept = "; name a file with --output to keep them" if options.output is None else f", kept in {options.output}"
    if options.output is not None and result.time.size:
        try:
            record.save(result)
        except CosimError as error:
            print_error(str(error))
            well, kept = False, ""
    if early and not result.time.size:
        print_note("Nothing had been computed.")
    elif early:
        print_note(f"Computed up to {result.time[-1]:.9g} s ({record.count(result)} rows){kept}.")
    return well


def _draw(
    result: Result, options: argparse.Namespace, notes: Sequence[str], compared: Comparison | None = None
) -> bool:
    """Write the picture and the page of a run. Returns whether both could be written, and prints an error if not."""
    return write_files(
        (options.plot if result.time.size > 1 else None, lambda path: _plot(result, path, compared)),
        (options.report, lambda path: _report(result, path, notes, compared)),
    )


def _plot(result: Result, path: Path, compared: Comparison | None) -> None:
    from ..result.compare_report import plot_comparison
    from ..result.plots import plot_run

    if compared is None:
        plot_run(result, path)
    else:
        plot_comparison(compared, path)


def _report(result: Result, path: Path, notes: Sequence[str], compared: Comparison | None) -> None:
    from ..result.compare_report import comparison_sections
    from ..result.run_report import report_run

    report_run(result, path, notes=notes, also=[] if compared is None else comparison_sections(compared))


def _finish(
    result: Result,
    options: argparse.Namespace,
    record: _RecordFile,
    begun: float,
    notes: Sequence[str],
    *,
    overlay: Overlay | None,
    interrupted: bool = False,
) -> int:
    """Print the messages and the summary of a run and write its files.

    Returns the exit code: 1 if recorded values are not finite or a file could not be written, else 0.
    """
    from ..result.summary import not_finite, summary

    bad = not_finite(result)
    if bad:
        print_error(_not_finite(bad))
    _show_messages(result)
    if interrupted:
        print_error("Interrupted.")
    every = record.thinned(result)
    thinned = [f"{record.count(result)} rows; figures and pictures are of every {every}th."] if every > 1 else []
    compared = overlay.compare(result) if overlay is not None and result.time.size > 1 else None
    well = _save(result, options, record, early=interrupted) and (overlay is None) == (compared is None)
    for note in thinned:
        print_note(f"note: {note}")
    figures = summary(result)
    files = {name: None if (path := getattr(options, name)) is None else str(path) for name in _FILES}
    if options.json:
        print_json(
            {
                **_facts(result, time.perf_counter() - begun),
                "not_finite": bad,
                "figures": [
                    {"name": row.name, "value": row.value, "unit": row.unit, "reason": row.reason or None}
                    for row in figures
                ],
                "notes": [*notes, *_said(result)],
                "overlay": None if compared is None else comparison_content(compared),
                **files,
            }
        )
    else:
        _show(result, figures, compared)
    well = _draw(result, options, [*notes, *thinned], compared) and well
    for file in files.values() if well and not options.json else ():
        if file is not None:
            standard_output().print(f"Written: {escape(file)}", soft_wrap=True)
    return 0 if well and not bad else 1


def _show(result: Result, figures: Sequence[FigureOfMerit | Missing], compared: Comparison | None) -> None:
    """Print the summary of a run."""
    console = standard_output()
    console.print(f"[bold]{escape(str(result.metadata['description'] or result.metadata['system']))}[/]")
    console.print(_table(result, figures))
    # not in the table: its columns would be as wide as a time that differs each time
    seconds = result.metadata["stepping_seconds"]
    console.print(f"Time of the steps: {seconds:.3g} s, {_real_time_factor(result):.3g} times real time")
    if compared is not None:
        show_comparison(compared)


def _facts(result: Result, elapsed: float) -> dict[str, Any]:
    """Facts about a run for JSON."""
    facts = result.metadata
    kept = ("system", "system_digest", "steps", "step_size", "stepping_seconds", "warnings")
    return {
        **{name: facts[name] for name in kept},
        "partial": result.partial,
        "simulated_seconds": facts["steps"] * facts["step_size"],
        "elapsed_seconds": elapsed,
        "real_time_factor": _real_time_factor(result),
        "solver": {name: dict(counts) for name, counts in result.solver.items()},
    }


def _real_time_factor(result: Result) -> float:
    facts = result.metadata
    spent = facts["stepping_seconds"]
    return facts["steps"] * facts["step_size"] / spent if spent > 0.0 else float("inf")


def _table(result: Result, figures: Sequence[FigureOfMerit | Missing]) -> Table:
    """The table of a run: its length and its figures of merit."""
    facts = result.metadata
    names = [row.name.rpartition(": ")[2] for row in figures]
    names_fit = all(len(name) <= WHOLE_NAME for name in names)
    table = make_table("", "", "", right=("1",), whole=("0", "1") if names_fit else ("1",))
    table.add_row("Simulated", f"{facts['steps'] * facts['step_size']:.9g}", "s")
    table.add_row("Steps", f"{facts['steps']}", f"of {facts['step_size']:g} s")
    for instance, counts in result.solver.items():
        if "rhs_evaluations" in counts and facts["steps"]:
            per_step = counts["rhs_evaluations"] / facts["steps"]
            rejected = f", {counts['rejected']:.0f} rejected" if counts.get("rejected") else ""
            steps = f"{counts.get('steps', 0.0):.0f} steps{rejected}"
            table.add_row(f"{escape(instance)}: equations evaluated", f"{per_step:.3g}", f"times a step ({steps})")
    loop = None
    for row, name in zip(figures, names, strict=True):
        head = row.name.removesuffix(name)  # "controller_x: " if there are several loops
        if head != loop:
            if head or loop:
                table.add_row()
                table.add_row(f"[bold]{escape(head.removesuffix(': ')) or 'path of both axes'}[/]")
            loop = head
        value = f"{row.value:.4g}" if isfinite(row.value) else "none"
        table.add_row(escape(name), value, escape(row.reason or row.unit))
    return table


def _not_finite(wrong: Mapping[str, float]) -> str:
    """A sentence about the variables that are not finite, in the order of the times from which they are not."""
    first = sorted(wrong.items(), key=lambda item: item[1])
    shown = listed([f"{name} is not finite from {time:.9g} s on" for name, time in first], MAX_SHOWN_NAMES)
    return f"{shown}. No figure is computed from these."


def _said(result: Result) -> list[str]:
    """The warnings of FMUs, in the words of ``cosim check``."""
    return [f"{message.instance}: {message.text}" for message in result.messages if message.status == "Warning"]


def _show_messages(result: Result, but: str = "") -> None:
    """Print the messages of FMUs, except the message ``but``, which is printed elsewhere."""
    messages = [message for message in result.messages if message.text != but]
    # Choose the worst messages, so that harmless messages do not displace them. Then print them in order of time.
    worst = sorted(messages, key=lambda message: _GRAVITY.get(message.status, 3), reverse=True)[:MAX_SHOWN_MESSAGES]
    for message in sorted(worst, key=lambda message: message.time):
        text = str(message)
        print_note(text if len(text) <= MAX_SHOWN_TEXT else f"{text[:MAX_SHOWN_TEXT]} ... ({len(text)} characters)")
    more = len(messages) - len(worst) + result.dropped_messages
    if more > 0:
        print_note(f"and {more} more messages")
