"""``cosim run``: a run of a system, and what is shown of it."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from math import isfinite
from types import TracebackType
from typing import TYPE_CHECKING, Self

from rich.box import SIMPLE
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from .console import complain, remark, standard_output
from .systems import chosen_system

if TYPE_CHECKING:
    from rich.progress import Progress

    from ..master.instance import CallError
    from ..result.result import Result
    from ..system.system import System


MAX_SHOWN_MESSAGES = 20


MAX_SHOWN_NAMES = 5


def run_command(options: argparse.Namespace) -> int:
    """Run a system and show what came out."""
    begun = time.perf_counter()
    if options.output is not None:
        from ..result.result import check_output

        check_output(options.output)
    system = chosen_system(options)
    from ..master.instance import CallError
    from ..master.run import Interrupted
    from ..master.simulation import simulate

    if not options.json:
        for note in system.notes:
            remark(f"note: {note}")
    try:
        with _Bar(system) as bar:
            result = simulate(system, progress=bar.update, debug=options.debug)
    except CallError as error:
        _failed(error, options)
        return 1
    except Interrupted as interruption:
        complain(f"Interrupted. {_kept(interruption.result, options)}")
        _finish(interruption.result, options, begun, system.notes)
        return 130
    return _finish(result, options, begun, system.notes)


def _failed(error: CallError, options: argparse.Namespace) -> None:
    if error.result is not None:
        _show_messages(error.result, but=error.message)
    complain(str(error))
    if error.result is not None and error.result.time.size:
        remark(_kept(error.result, options))
        _save(error.result, options)


def _kept(result: Result, options: argparse.Namespace) -> str:
    if not result.time.size:
        return "Nothing had been computed."
    rows = f"Computed up to {result.time[-1]:.9g} s ({result.time.size} rows)"
    if options.output is None:
        return f"{rows}; name a file with --output to keep them."
    return f"{rows}, kept in {options.output}."


def _save(result: Result, options: argparse.Namespace) -> None:
    if options.output is not None:
        result.save(options.output)
    if options.plot is not None and result.time.size > 1:
        from ..result.plots import plot_run

        plot_run(result, options.plot)


def _finish(result: Result, options: argparse.Namespace, begun: float, notes: Sequence[str]) -> int:
    """Messages, files and the summary that end a run; the exit code, 1 if values are not finite."""
    from ..result.summary import not_finite, summary

    figures, wrong = summary(result), not_finite(result)
    if wrong:
        complain(_not_finite(wrong))
    _show_messages(result)
    _save(result, options)
    facts = result.metadata
    simulated = facts["steps"] * facts["step_size"]
    factor = simulated / facts["stepping_seconds"] if facts["stepping_seconds"] > 0.0 else float("inf")
    if options.json:
        facts_shown = {
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
                {
                    "name": row.name,
                    "value": row.value if isfinite(row.value) else None,
                    "unit": row.unit,
                    "reason": row.reason or None,
                }
                for row in figures
            ],
            "not_finite": wrong,
            "notes": list(notes),
            "output": None if options.output is None else str(options.output),
            "plot": None if options.plot is None else str(options.plot),
        }
        sys.stdout.write(json.dumps(facts_shown, indent=2) + "\n")
        return 1 if wrong else 0
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
        value = f"{row.value:.4g}" if isfinite(row.value) else "none"
        table.add_row(escape(row.name), value, escape(row.reason or row.unit))
    console = standard_output()
    console.print(table)
    for file in (options.output, options.plot):
        if file is not None:
            console.print(f"Written: {escape(str(file))}")
    return 1 if wrong else 0


def _not_finite(wrong: Mapping[str, float]) -> str:
    """Which variables are not finite, and from when; the first ones first."""
    first = sorted(wrong.items(), key=lambda item: item[1])
    shown = ", ".join(f"{name} from {time:g} s on" for name, time in first[:MAX_SHOWN_NAMES])
    more = f" and {len(first) - MAX_SHOWN_NAMES} more" if len(first) > MAX_SHOWN_NAMES else ""
    return f"not finite: {shown}{more}. No figure is computed from these."


def _show_messages(result: Result, but: str = "") -> None:
    """What FMUs logged, without the message ``but``, which is told elsewhere."""
    messages = [message for message in result.messages if message.text != but]
    for message in messages[:MAX_SHOWN_MESSAGES]:
        remark(str(message))
    more = len(messages) - MAX_SHOWN_MESSAGES + result.dropped_messages
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
