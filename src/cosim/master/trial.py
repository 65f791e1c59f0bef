"""A trial initializes a system in another process, so that its FMUs can complain about their start values.

If an FMU crashes there, this process goes on. The other process is ``python -m cosim.master.trial``. It reads its job
from one file and writes its findings to another, so that text printed by FMUs does no harm.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from decimal import Decimal
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from ..errors import CosimError
from ..files import temporary_folder, temporary_variables, write_file
from ..fmu.variables import Value, Variable
from ..system.parts import Instance
from ..system.samples import sampling_time
from ..system.system import System, make_system
from ..system.unconnected import fitting_outputs, unconnected_inputs
from ..system.values import is_numeric, show_start, start_value, unit_suffix
from .board import Board, mapped
from .failure import limit_text, process_error
from .process import shared_memory
from .simulation import Simulation

POINTS = 200
"""Largest number of communication points at which the outputs of a source are compared, spread over the run."""

STEPS = 50
"""Number of steps before and after the change of an input, in the run that tells whether this input matters."""

FACTORS = (1.01, 2.0, 0.5)
"""Factors on a start value. At least one of them must change an output.

One is small; the others are large enough to pass a limit or a rounding.
"""

SECONDS = 60.0
"""Longest time of a trial in s."""


@dataclass(frozen=True)
class Findings:
    """The findings of a trial."""

    problem: str = ""
    """The reason why the system cannot be initialized; empty if it can."""
    notes: tuple[str, ...] = ()
    """Warnings of FMUs, values that are not finite, probably forgotten inputs, and start values without effect."""


class Trial:
    """A trial that runs in another process. As a context manager it kills this process at the end of the block."""

    def __init__(self, system: System) -> None:
        self._resources = contextlib.ExitStack()
        folder = self._resources.enter_context(temporary_folder())
        self._file = folder / "findings.json"
        # The other process makes its board from the same file.
        memory, _ = self._resources.enter_context(shared_memory(folder, Board.size(), shared_file=True))
        self._board = Board(memoryview(memory))
        job = folder / "job"
        job.write_bytes(pickle.dumps((dict(system.document), system.name, system.folder, system.fmus)))
        command = [sys.executable, "-m", __name__, str(job), str(self._file)]
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env=os.environ | temporary_variables(folder),
            process_group=0 if sys.platform != "win32" else None,
        )

    def findings(self, *, seconds: float = SECONDS) -> Findings:
        """Wait for the findings, at most ``seconds`` from now. A trial that takes longer is killed: a problem."""
        try:
            code = self._process.wait(seconds)
        except subprocess.TimeoutExpired:
            limit = limit_text(seconds, "the initialization")
            return Findings(str(process_error(self._board, None, limit=limit)))
        if self._file.is_file():
            found: dict[str, Any] = json.loads(self._file.read_text(encoding="utf-8"))
            return Findings(found["problem"], tuple(found["notes"]))
        return Findings(str(process_error(self._board, code)))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._process.poll() is None:
            self._process.kill()
        if sys.platform != "win32":
            with contextlib.suppress(ProcessLookupError, PermissionError):
                # Processes that an FMU has started end, too.
                os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        self._resources.close()


def try_system(system: System, *, seconds: float = SECONDS) -> Findings:
    """Try ``system`` in another process, for at most ``seconds``."""
    with Trial(system) as trial:
        return trial.findings(seconds=seconds)


# The other process


def _try(system: System) -> Findings:
    notes: list[str] = []
    try:
        with Simulation(system) as simulation:
            result = simulation.initialize()
            notes += [f"{m.instance}: {m.text}" for m in result.messages if m.status != "OK"]
            names = {instance.name for instance in system.instances}
            for name, variable in (entry for entry in system.record if entry[0] in names):
                value = simulation.value(name, variable)
                if not np.isfinite(value):
                    notes.append(f"{name}.{variable} is {value} after initialization.")
    except CosimError as error:
        return Findings(str(error), tuple(notes))
    notes += _forgotten(system)
    for instance in system.instances:
        with contextlib.suppress(CosimError):  # a source that cannot run alone is not checked
            notes += _without_effect(system, instance)
    return Findings("", tuple(notes))


def _forgotten(system: System) -> Iterator[str]:
    """A note for each unconnected input that some output would fit, and whose value changes the results."""
    fitting = fitting_outputs(system)
    if not fitting:
        return
    stay = unconnected_inputs(system)
    matter = _mattering(system, list(fitting))
    for (name, variable), outputs in fitting.items():
        if (name, variable) in matter:
            yield (
                f"instances.{name}: input '{variable}' is not connected and stays at {stay[name, variable]}. "
                f"{outputs[0]} would fit: connect it, or give a start value."
            )


def _mattering(system: System, inputs: Sequence[tuple[str, str]]) -> set[tuple[str, str]]:
    """The inputs whose values change outputs of their instance some time after the start. All inputs, if this fails.

    The first steps do not count: at the start, an input may only initialize an estimate that does not need it later.
    """
    samples = [float(T_s / system.step_size) for i in system.instances if (T_s := sampling_time(i)) is not None]
    steps = min(max(STEPS, math.ceil(2.0 * max(samples, default=0.0))), system.steps // 2)
    if steps == 0:
        return set(inputs)
    record: dict[str, None] = {}
    for name, _ in inputs:
        fmu = system.instance(name).fmu
        record |= dict.fromkeys(f"{name}.{output}" for output in fmu.outputs if is_numeric(fmu.variables[output]))
    found: set[tuple[str, str]] = set()
    try:
        stop = system.start_time + 2 * steps * system.step_size
        short = system.changed(stop_time=stop, record=list(record), decimation=1)
        with Simulation(short, keep_going=True) as simulation:
            checkpoint = simulation.pause(float(system.start_time + steps * system.step_size))
            expected = simulation.resume(checkpoint).rows
            for name, variable in inputs:
                described = system.variable(name, variable)
                start = system.instance(name).start.get(variable, described.start)
                for value in _changes(described, 0.0 if start is None else start):
                    rows = simulation.resume(checkpoint, {f"{name}.{variable}": value}).rows
                    if not np.array_equal(rows, expected, equal_nan=True):
                        found.add((name, variable))
                        break
    except CosimError:
        return set(inputs)  # not known, for example without fmi2GetFMUstate; rather a note too many
    return found


def _without_effect(system: System, instance: Instance) -> Iterator[str]:
    """A note for each given start value of a source that does not change any of its outputs.

    Only sources are checked that have kinds, which means a parameter of type Enumeration.
    """
    fmu = instance.fmu
    kinds = [v for v in fmu.variables.values() if v.type == "Enumeration" and v.causality == "parameter"]
    numbers = [name for name in instance.start if _varied(fmu.variables[name])]
    if not kinds or not numbers or fmu.inputs or not fmu.outputs:
        return
    alone = _alone(system, instance)
    chosen = ", ".join(f"{kind.name} = {_item(kind, instance)}" for kind in kinds)
    with Simulation(alone, keep_going=True) as simulation:
        for name in numbers:
            tried = _tried_in_vain(simulation, [alone, _without_zeros(alone, instance, name)], instance, name)
            if tried:
                yield (
                    f"instances.{instance.name}.start.{name}: "
                    f"{_brief(fmu.variables[name], instance.start[name])} has no effect, all outputs are the same with "
                    f"{', '.join(tried)}. Is it of another kind than {chosen}?"
                )


def _tried_in_vain(simulation: Simulation, systems: Sequence[System], instance: Instance, name: str) -> list[str]:
    """The other values of a parameter that were tried, if none of them changes an output in any of the systems.

    Empty if one of them does.
    """
    variable = instance.fmu.variables[name]
    tried: dict[str, None] = {}
    for system in systems:
        try:
            expected = simulation.run(system).rows
        except CosimError:
            continue
        for value in _changes(variable, instance.start[name]):
            try:
                rows = simulation.run(system.changed({f"{instance.name}.{name}": value})).rows
            except CosimError:
                continue  # a value that a rule forbids
            if not np.array_equal(rows, expected, equal_nan=True):
                return []
            tried[_brief(variable, value)] = None
    return list(tried)


def _without_zeros(system: System, instance: Instance, but: str) -> System:
    """The same source with 1 in place of each given start value of 0, except ``but``.

    An amplitude of 0, for example, hides the effect of the other parameters.
    """
    zeros = {
        f"{instance.name}.{name}": 1.0
        for name, value in instance.start.items()
        if value == 0.0 and name != but and instance.fmu.variables[name].type == "Real"
    }
    try:
        return system.changed(zeros) if zeros else system
    except CosimError:
        return system


def _brief(variable: Variable, value: Value) -> str:
    return f"{value:.5g}{unit_suffix(variable)}" if isinstance(value, float) else show_start(variable, value)


def _varied(variable: Variable) -> bool:
    return variable.causality == "parameter" and variable.type in ("Real", "Integer", "Boolean")


def _item(kind: Variable, instance: Instance) -> str:
    value = instance.start.get(kind.name, kind.start)
    return "?" if value is None else show_start(kind, value)


def _changes(variable: Variable, value: Value) -> list[Value]:
    """Other allowed values of a variable, to try in place of ``value``."""
    if variable.type == "Boolean":
        return [not value]
    number = float(value)
    wanted = [number * factor for factor in FACTORS] if number else [1e-3, 1.0, -1.0]
    if variable.type == "Integer":
        wanted = [number + 1, 2 * number, number - 1]
    allowed = [start_value(variable, new)[0] for new in wanted]
    return [new for new in allowed if new is not None and new != value]


def _alone(system: System, instance: Instance) -> System:
    """A system of one source, over the time of ``system`` with fewer and longer steps. All outputs are recorded."""
    steps = next(n for n in range(min(POINTS, system.steps), 0, -1) if system.steps % n == 0)
    step = (system.stop_time - system.start_time) / Decimal(steps)
    document: Mapping[str, Any] = {
        "instances": {instance.name: {"fmu": str(instance.fmu.path), "start": dict(instance.start)}},
        "experiment": {"start_time": system.start_time, "stop_time": system.stop_time, "step_size": step},
    }
    return make_system(document, name=system.name)


def _main() -> None:
    job, file = (Path(argument) for argument in sys.argv[1:])
    document, name, folder, fmus = pickle.loads(job.read_bytes())
    Board.show(mapped(file.with_name("memory")))
    found = _try(make_system(document, name=name, folder=folder, fmus=fmus))
    write_file(file, json.dumps(asdict(found)))
    # The findings are written. Exit at once, so that an FMU that crashes during unloading does no harm.
    os._exit(0)


if __name__ == "__main__":
    _main()
