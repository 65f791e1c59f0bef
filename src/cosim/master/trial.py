"""A trial of a system in a process of its own: initialized, so that its FMUs say what they think of their start values.

Whatever an FMU does there, this process goes on. The other one is ``python -m cosim.master.trial``: a pickled job comes
in on its standard input, a file takes the outcome, so that what FMUs print does no harm.
"""

from __future__ import annotations

import contextlib
import json
import os
import pickle
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import CosimError
from ..fmu.description import Value, Variable
from ..system.parts import Instance
from ..system.system import System, make_system
from ..system.values import show_start, start_value
from .simulation import Simulation

POINTS = 200
"""Communication points at which a source is compared, spread over the run."""


FACTORS = (1.01, 2.0, 0.5)
"""Changes of a start value that must show in some output: small, and large enough to pass a limit or a rounding."""


SECONDS = 60.0
"""Time that an initialization may take."""


@dataclass(frozen=True)
class Trial:
    """What came out of a trial."""

    problem: str = ""
    """Why the system cannot be initialized; empty if it can."""
    notes: tuple[str, ...] = ()
    """Warnings of FMUs, values that are not finite, start values without effect."""


def try_system(system: System, *, seconds: float = SECONDS) -> Trial:
    """Initialize ``system`` in another process, which may take ``seconds``; look for start values without effect."""
    job = pickle.dumps((dict(system.document), system.name, system.folder, system.fmus))
    with tempfile.TemporaryDirectory(prefix="cosim-") as folder:
        outcome = Path(folder) / "outcome.json"
        try:
            process = subprocess.run(
                [sys.executable, "-m", __name__, str(outcome)],
                input=job,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                timeout=seconds,
                check=False,
            )
        except subprocess.TimeoutExpired:
            where = _text(outcome.with_suffix(".at"))
            return Trial(f"{where or 'the system'} is not initialized after {seconds:g} s.")
        found = _text(outcome)
        if found:
            trial: dict[str, Any] = json.loads(found)
            return Trial(trial["problem"], tuple(trial["notes"]))
        where = _text(outcome.with_suffix(".at"))
        return Trial(f"{where or 'an FMU'} ended the process during initialization ({_ending(process.returncode)}).")


def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8") if path.is_file() else ""


def _ending(code: int) -> str:
    if code >= 0:
        return f"exit code {code}"
    with contextlib.suppress(ValueError):
        return signal.Signals(-code).name
    return f"signal {-code}"


# The other process


def _try(system: System, at: Path) -> Trial:
    notes: list[str] = []
    try:
        at.write_text(_names(system), encoding="utf-8")
        with Simulation(system) as simulation:
            result = simulation.initialize()
            notes += [f"{m.instance}: {m.text}" for m in result.messages if m.status != "OK"]
            for name, variable in system.record:
                value = simulation.value(name, variable)
                if not np.isfinite(value):
                    notes.append(f"{name}.{variable} is {value} after initialization.")
    except CosimError as error:
        return Trial(str(error), tuple(notes))
    for instance in system.instances:
        with contextlib.suppress(CosimError):  # a source that does not run alone is not judged
            notes += _without_effect(system, instance)
    return Trial("", tuple(notes))


def _names(system: System) -> str:
    names = [instance.name for instance in system.instances]
    return names[0] if len(names) == 1 else f"one of {', '.join(names)}"


def _without_effect(system: System, instance: Instance) -> Iterator[str]:
    """Start values of a source with kinds (an Enumeration) that change none of its outputs, whatever their value."""
    fmu = instance.fmu
    kinds = [v for v in fmu.variables.values() if v.type == "Enumeration" and v.causality == "parameter"]
    numbers = [name for name in instance.start if _varied(fmu.variables[name])]
    if not kinds or not numbers or fmu.inputs or not fmu.outputs:
        return
    alone = _alone(system, instance)
    with Simulation(alone) as simulation:
        expected = simulation.run().rows
        for name in numbers:
            tried: list[str] = []
            variable = fmu.variables[name]
            for value in _changes(variable, instance.start[name]):
                try:
                    rows = simulation.run(alone.changed({f"{instance.name}.{name}": value})).rows
                except CosimError:
                    continue  # a value that a rule forbids
                if not np.array_equal(rows, expected, equal_nan=True):
                    break
                tried.append(show_start(variable, value))
            else:
                if tried:
                    chosen = ", ".join(f"{k.name} = {_item(k, instance)}" for k in kinds)
                    yield (
                        f"instances.{instance.name}.start.{name}: "
                        f"{show_start(variable, instance.start[name])} has no effect: with {' or '.join(tried)} all "
                        f"outputs stay the same. Is it of another kind than {chosen}?"
                    )


def _varied(variable: Variable) -> bool:
    return variable.causality == "parameter" and variable.type in ("Real", "Integer", "Boolean")


def _item(kind: Variable, instance: Instance) -> str:
    value = instance.start.get(kind.name, kind.start)
    return "?" if value is None else show_start(kind, value)


def _changes(variable: Variable, value: Value) -> list[Value]:
    """Other values that a variable may take."""
    if variable.type == "Boolean":
        return [not value]
    number = float(value)
    wanted = [number * factor for factor in FACTORS] if number else [1e-3, 1.0]
    if variable.type == "Integer":
        wanted = [number + 1, 2 * number, number - 1]
    allowed = [start_value(variable, new)[0] for new in wanted]
    return [new for new in allowed if new is not None and new != value]


def _alone(system: System, instance: Instance) -> System:
    """A source by itself over the time of the system, with fewer and longer steps; all outputs recorded."""
    steps = next(n for n in range(min(POINTS, system.steps), 0, -1) if system.steps % n == 0)
    step = (system.stop_time - system.start_time) / Decimal(steps)
    document: Mapping[str, Any] = {
        "instances": {instance.name: {"fmu": str(instance.fmu.path), "start": dict(instance.start)}},
        "experiment": {"start_time": system.start_time, "stop_time": system.stop_time, "step_size": step},
    }
    return make_system(document, name=system.name)


def _main() -> None:
    outcome = Path(sys.argv[1])
    document, name, folder, fmus = pickle.load(sys.stdin.buffer)
    trial = _try(make_system(document, name=name, folder=folder, fmus=fmus), outcome.with_suffix(".at"))
    part = outcome.with_suffix(".part")
    part.write_text(json.dumps(asdict(trial)), encoding="utf-8")
    os.replace(part, outcome)
    # The outcome is there: an FMU that crashes while it is unloaded changes nothing.
    os._exit(0)


if __name__ == "__main__":
    _main()
