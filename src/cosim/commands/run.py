"""``cosim run``: run a system and show what came out."""

from __future__ import annotations

import argparse
import contextlib
import time
from collections.abc import Mapping, Sequence
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.markup import escape

from .console import Bar, make_table, print_error, print_json, print_note, standard_output
from .systems import given_system, system_arguments

if TYPE_CHECKING:
    from ..master.instance import RunError
    from ..result.result import Result

MAX_SHOWN_MESSAGES = 20
MAX_SHOWN_NAMES = 5
TRIAL_SECONDS = 2.0
"""How long the end of a run waits for what was found beside it about inputs that look forgotten."""


def add(commands: Any) -> None:
    """Add ``run``."""
    run = commands.add_parser(
        "run",
        help="run a system, or an FMU alone",
        description="Run a system and show what came out. An FMU runs alone, over the times that its file suggests.",
        epilog="Example: cosim run studies/shams2010/fsmc_5sin.toml --set plant.m=70 --output result.parquet, or "
        "cosim run Trajectory --set kind=quintic --plot move.png",
    )
    system_arguments(run)
    run.add_argument("--output", type=Path, metavar="FILE", help="write the record as .csv or .parquet")
    run.add_argument("--plot", type=Path, metavar="FILE", help="draw the run, such as run.png")
    run.add_argument("--json", action="store_true", help="print the summary as JSON, for scripts")
    run.add_argument(
        "--keep-going", action="store_true", help="go on if a connection carries a value that is not finite"
    )
    run.add_argument("--debug", action="store_true", help="show everything the FMUs log, not only what went wrong")
    run.set_defaults(command=_run)


def _run(options: argparse.Namespace) -> int:
    """Run a system and show what came out."""
    begun = time.perf_counter()
    if options.output is not None:
        from ..result.result import check_output

        check_output(options.output)
    system = given_system(options)
    from ..master.instance import RunError
    from ..master.run import Interrupted
    from ..master.simulation import simulate
    from ..master.trial import Trial
    from ..system.unconnected import fitting_outputs

    notes = list(system.notes)
    with contextlib.ExitStack() as resources:
        trial = resources.enter_context(Trial(system)) if fitting_outputs(system) else None
        if not options.json:
            _show_notes(notes)
        try:
            with Bar("Seconds") as bar:
                length = float(system.stop_time - system.start_time)
                result = simulate(
                    system,
                    progress=lambda share: bar.update(share * length, length),
                    debug=options.debug,
                    keep_going=options.keep_going,
                )
        except RunError as error:
            _failed(error, options)
            return 1
        except Interrupted as interruption:
            print_error(f"Interrupted. {_kept(interruption.result, options)}")
            _finish(interruption.result, options, begun, notes)
            return 130
        if trial is not None:
            found = trial.findings(seconds=TRIAL_SECONDS).notes
            notes += found
            if not options.json:
                _show_notes(found)
    return _finish(result, options, begun, notes)


def _show_notes(notes: Sequence[str]) -> None:
    for note in notes:
        print_note(f"note: {note}")


def _failed(error: RunError, options: argparse.Namespace) -> None:
    if error.result is not None:
        _show_messages(error.result, but=error.message)
    print_error(str(error))
    if error.result is not None and error.result.time.size:
        print_note(_kept(error.result, options))
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
    """Messages, files and the summary that end a run; the exit code, 1 if recorded values are not finite."""
    from ..result.summary import not_finite, summary

    figures, wrong = summary(result), not_finite(result)
    if wrong:
        print_error(_not_finite(wrong))
    _show_messages(result)
    _save(result, options)
    facts = result.metadata
    simulated = facts["steps"] * facts["step_size"]
    factor = simulated / facts["stepping_seconds"] if facts["stepping_seconds"] > 0.0 else float("inf")
    if options.json:
        content = {
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
                {"name": row.name, "value": row.value, "unit": row.unit, "reason": row.reason or None}
                for row in figures
            ],
            "not_finite": wrong,
            "notes": notes,
            "output": None if options.output is None else str(options.output),
            "plot": None if options.plot is None else str(options.plot),
        }
        print_json(content)
        return 1 if wrong else 0
    table = make_table("", "", "", right=("1",), whole=("1",), title=str(facts["description"] or facts["system"]))
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
        print_note(str(message))
    more = len(messages) - MAX_SHOWN_MESSAGES + result.dropped_messages
    if more > 0:
        print_note(f"and {more} more messages")
