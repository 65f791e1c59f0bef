"""``cosim check``: shows the problems and notes of a system, and how it will run."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from rich.markup import escape

from ..errors import DescriptionError, listed
from .console import make_table, print_error, print_json, standard_output
from .parser import EXIT_CODES, timeout_argument
from .systems import given_system, system_arguments

if TYPE_CHECKING:
    from ..system.parts import Connection, Instance
    from ..system.system import System

SHOWN_VALUES = 12
"""Largest number of start values of an instance in the table, so that a row stays a few lines high."""


def add(commands: Any) -> None:
    """Add ``check``."""
    check = commands.add_parser(
        "check",
        help="check a system without running it",
        description="Check a system and say how it will run. Its FMUs are initialized in a process of their own, so "
        "that rules between parameters speak, too.",
    )
    check.examples = ("cosim check shams2010/fsmc_5sin", "cosim check shams2010/fsmc_5sin --set plant.m=70 --json")
    check.exit_codes = {
        **EXIT_CODES,
        0: "the system can run; notes may still name what is suspicious",
        2: "it cannot run",
    }
    system_arguments(check)
    check.add_argument("--json", action="store_true", help="print what was found as JSON, for scripts")
    timeout_argument(check, "the initialization", "60")
    check.set_defaults(command=_run)


def _run(options: argparse.Namespace) -> int:
    """Check a system. The exit code is 0 if it can run, 2 if not."""
    from ..master.trial import SECONDS, try_system

    try:
        system = given_system(options)
    except DescriptionError as error:
        if not options.json:
            raise
        print_json({"system": options.system, "problems": error.problems, "notes": []})
        return 2
    trial = try_system(system, seconds=options.timeout or SECONDS)
    notes = [*system.notes, *_resting(system), *trial.notes]
    if options.json:
        print_json(_facts(system, [trial.problem] if trial.problem else [], notes))
        return 2 if trial.problem else 0
    _show(system, notes)
    if trial.problem:
        print_error(trial.problem)
        return 2
    standard_output().print("No problems.")
    return 0


def _resting(system: System) -> list[str]:
    """The unconnected inputs without a given start value, one line for each instance."""
    from ..system.unconnected import unconnected_inputs

    resting: dict[str, list[str]] = {}
    for (instance, name), value in unconnected_inputs(system).items():
        if name not in system.instance(instance).start:
            resting.setdefault(instance, []).append(f"{name} = {value}")
    return [f"instances.{name}: unconnected inputs stay at {', '.join(values)}." for name, values in resting.items()]


def _starts(instance: Instance) -> dict[str, str]:
    """Start values as text: enumerations as item names, a complete array as one entry."""
    from ..system.values import show_start

    fmu = instance.fmu
    whole = {
        element: name
        for name, array in fmu.arrays.items()
        if len(array.elements) > 1 and all(element in instance.start for element in array.elements)
        for element in array.elements
    }
    shown: dict[str, str] = {}
    for name, value in instance.start.items():
        array = whole.get(name)
        if array is None:
            shown[name] = show_start(fmu.variables[name], value)
        else:
            shown[array] = f"{len(fmu.arrays[array].elements)} values"
    return shown


def _transformation(connection: Connection) -> str:
    """How a connection changes its values, as text."""
    scaled = "" if connection.factor == 1.0 else f" * {connection.factor:.9g}"
    sign = "+" if connection.offset > 0.0 else "-"
    shifted = "" if connection.offset == 0.0 else f" {sign} {abs(connection.offset):.9g}"
    return scaled + shifted


def _show(system: System, notes: list[str]) -> None:
    from ..system.values import unit_suffix

    console = standard_output()
    console.print(f"[bold]{escape(system.description or system.name)}[/]", soft_wrap=True)
    table = make_table("Instance", "FMU", "Start values", "Steps over", whole=("Instance", "Steps over"))
    for instance in system.instances:
        values = listed([f"{name} = {value}" for name, value in _starts(instance).items()], SHOWN_VALUES)
        over = f"{system.step_size * instance.step_multiple} s"
        table.add_row(escape(instance.name), escape(instance.fmu.name), escape(values), over)
    console.print(table)
    for signal in system.signals:
        time = signal.resampler.time
        console.print(
            f"  Record {escape(signal.name)}: {escape(str(signal.path))}, {time.size} samples from {time[0]:.9g} s to "
            f"{time[-1]:.9g} s; {escape(', '.join(signal.outputs))}",
            soft_wrap=True,
        )
    for connection in system.connections:
        source, target = (".".join(end) for end in (connection.source, connection.target))
        units = {"converted": " (units converted)", "suppressed": " (units not converted)"}.get(connection.units, "")
        plus = "+ " if connection.added else ""
        noise = ""
        if connection.noise is not None:
            unit = unit_suffix(system.variable(*connection.target))
            noise = f" (noise of {connection.noise.rms:g}{unit} rms)"
        console.print(f"  {plus}{escape(source)}{_transformation(connection)} -> {escape(target)}{units}{noise}")
    how = "parallel, one step of delay" if system.parallel else ", ".join(system.evaluation_order)
    console.print(f"Order: {escape(how)}")
    console.print(
        f"{system.steps} steps of {system.step_size} s from {system.start_time} s to {system.stop_time} s, "
        f"{len(system.record)} variables recorded, {system.steps // system.decimation + 1} rows"
    )
    for note in notes:
        console.print(f"[yellow]note:[/] {escape(note)}", soft_wrap=True)


def _facts(system: System, problems: list[str], notes: list[str]) -> dict[str, Any]:
    return {
        "system": system.name,
        "description": system.description,
        "problems": problems,
        "notes": notes,
        "instances": {
            instance.name: {
                "fmu": instance.fmu.name,
                "start": _starts(instance),
                "step_multiple": instance.step_multiple,
            }
            for instance in system.instances
        },
        "connections": [
            {
                "from": ".".join(connection.source),
                "to": ".".join(connection.target),
                "factor": connection.factor,
                "offset": connection.offset,
                "units": connection.units,
                "added": connection.added,
                "noise": None if connection.noise is None else asdict(connection.noise),
            }
            for connection in system.connections
        ],
        "signals": {
            signal.name: {
                "file": str(signal.path),
                "digest": signal.digest,
                "samples": int(signal.resampler.time.size),
                "columns": {name: variable.unit or "1" for name, variable in signal.variables.items()},
            }
            for signal in system.signals
        },
        "order": "parallel" if system.parallel else list(system.evaluation_order),
        "start_time": float(system.start_time),
        "stop_time": float(system.stop_time),
        "step_size": float(system.step_size),
        "steps": system.steps,
        "recorded": [".".join(entry) for entry in system.record],
        "decimation": system.decimation,
        "system_digest": system.digest,
    }
