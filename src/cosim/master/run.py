"""One run of a system on loaded instances."""

from __future__ import annotations

import contextlib
import math
import os
import platform
import time as clock_time
from collections.abc import Callable, Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from ..errors import DescriptionError
from ..fmu.description import Value, Variable
from ..result.result import Column, Message, Result
from ..system.parts import Connection
from ..system.system import System
from . import loop, loop_plain
from .instance import FmuInstance, RunError, fmpy
from .program import KINDS, Program

Progress = Callable[[float], None]
"""Called with the fraction of the run that is done, at most some twenty times a second."""


CHUNK_SECONDS = 0.05


MAX_PASSES = 50


SOLVER = "solver."
"""Numbers an FMU offers under names with this beginning are kept at the end of a run."""


class Interrupted(KeyboardInterrupt):
    """Ctrl-C during a run; ``result`` holds what was computed."""

    def __init__(self, result: Result) -> None:
        self.result = result
        super().__init__(f"interrupted at {result.time[-1] if result.time.size else 0.0:.9g} s")


class SignalError(RunError):
    """A connection carries a value that its input cannot take: not finite, or beyond the input's type."""

    def __init__(self, connection: Connection, value: float, *, time: float, why: str) -> None:
        self.connection = connection
        self.value = value
        source, target = ".".join(connection.source), ".".join(connection.target)
        super().__init__(
            f"{source} gives {target} the value {value:.9g} at {time:.9g} s: {why}. To go on with such values: "
            "--keep-going, or keep_going=True.",
            time=time,
        )


class Run:
    """One run of a system on loaded instances."""

    def __init__(
        self,
        system: System,
        slaves: list[FmuInstance],
        program: Program,
        *,
        begin: int = 0,
        end: int | None = None,
        check: bool = True,
    ) -> None:
        self.system = system
        self.slaves = slaves
        self.program = program
        self.check = check
        """Whether values on connections must be finite and fit their inputs."""
        self.last = system.steps if end is None else end
        """The communication point that ends the run."""
        self.clock = np.array([float(system.start_time), float(system.step_size)])
        self.state = np.zeros(loop.STATE_LENGTH, dtype=np.int64)
        self.state[loop.POINT] = begin
        self.first_row = -(-begin // system.decimation)
        shape = (self.last // system.decimation + 1 - self.first_row, len(system.record))
        need = shape[0] * shape[1] * 8
        if need > _physical_memory():
            raise DescriptionError(
                f"{system.name}: {shape[0]} rows of {shape[1]} variables need {need / 2**30:.1f} GiB of memory. "
                "Record fewer variables or take a larger decimation."
            )
        self.rows = np.empty(shape)
        self.notices: list[Message] = []
        self.started = clock_time.perf_counter()
        self.stepping_seconds = 0.0

    def time(self) -> float:
        return float(self.clock[0] + self.state[loop.POINT] * self.clock[1])

    def go(self, progress: Progress | None, interrupted: Callable[[], bool], *, end: int | None = None) -> Result:
        """From initialization to termination; or to point ``end``, which is left to whoever goes on."""
        self.watch()
        try:
            self.initialize()
            stopped = self.step(progress, interrupted, end)
            solver = self.counters()
            if end is None:
                for slave in self.slaves:
                    slave.call("fmi2Terminate")
        except RunError as error:
            error.result = self.result({}, partial=True)
            raise
        result = self.result(solver, partial=stopped or end is not None)
        if stopped:
            raise Interrupted(result)
        return result

    def go_on(
        self, changes: list[tuple[int, Variable, Value]], progress: Progress | None, interrupted: Callable[[], bool]
    ) -> Result:
        """From a restored checkpoint to the end. The instances are left there: their state is set or reset next."""
        self.watch()
        try:
            for number, variable, value in changes:
                self.slaves[number].set(variable, value)
            stopped = self.step(progress, interrupted)
            solver = self.counters()
        except RunError as error:
            error.result = self.result({}, partial=True)
            raise
        result = self.result(solver, partial=stopped)
        if stopped:
            raise Interrupted(result)
        return result

    def watch(self) -> None:
        """Begin this run's log."""
        for slave in self.slaves:
            slave.log.clock = self.time
            slave.log.messages = []
            slave.log.dropped = 0
            slave.log.last = ""

    def initialize(self) -> None:
        system = self.system
        for slave, instance in zip(self.slaves, system.instances, strict=True):
            slave.set_all(instance.start)
        for slave in self.slaves:
            tolerance = (slave.fmu.tolerance if system.tolerance is None else system.tolerance) or 0.0
            times = self.clock[0], True, float(system.stop_time)
            slave.call("fmi2SetupExperiment", tolerance > 0.0, tolerance, *times)
        for slave in self.slaves:
            slave.call("fmi2EnterInitializationMode")
        self.propagate()
        for slave in self.slaves:
            slave.call("fmi2ExitInitializationMode")
        self.once(self.program.outputs)

    def propagate(self) -> None:
        """Outputs to inputs until nothing changes: two passes where there is no loop through initial values."""
        program = self.program
        self.once(program.outputs)
        for _ in range(MAX_PASSES):
            before = program.values.copy()
            self.once(program.initial)
            if np.array_equal(before, program.values, equal_nan=True):
                return
        text = f"outputs still change after {MAX_PASSES} passes of initialization; the loop may have no solution"
        self.notices.append(Message("master", self.time(), "Warning", "initialization", text))

    def once(self, rows: list[loop.Row]) -> None:
        """Do some rows at the start of the run, recording nothing. Values need not be finite until all are there."""
        unrecorded = np.zeros(0, dtype=np.uint64), np.zeros((0, 0)), 1
        self.loop(loop.array(rows), len(rows), unrecorded, end=0, last=0, check=False)
        self.state[loop.ROWS] = 0

    def loop(
        self,
        program: NDArray[np.uint64],
        split: int,
        record: tuple[NDArray[np.uint64], NDArray[np.float64], int],
        *,
        end: int,
        last: int,
        check: bool,
    ) -> None:
        """Let the loop go on to ``end``; ``record`` is slots, rows and decimation. Raises RunError."""
        slots, rows, decimation = record
        arrays = program, split, self.program.links, self.program.values, slots, rows, self.clock, self.state
        advance = loop.compiled() or loop_plain.advance
        if not advance(*arrays, end=end, last=last, decimation=decimation, check=check):
            raise self.stopped()

    def stopped(self) -> RunError:
        """Why the loop has stopped."""
        program, state = self.program, self.state
        if state[loop.REASON] == loop.NOT_FINITE:
            number = int(state[loop.FAILED_LINK])
            source, _, factor, offset = program.links[number].tolist()
            value = factor * float(program.values[source]) + offset
            return SignalError(program.connections[number], value, time=self.time(), why="not finite")
        if state[loop.REASON] == loop.OUT_OF_RANGE:
            slot = int(state[loop.FAILED_SLOT])
            connection = next(c for c in program.connections if program.slots[c.target] == slot)
            why = f"more than an {self.system.variable(*connection.target).type} can be"
            return SignalError(connection, float(program.values[slot]), time=self.time(), why=why)
        number, function = loop.call_of(state) or (0, "")
        return self.slaves[number].failed(function, int(state[loop.STATUS]))

    def step(self, progress: Progress | None, interrupted: Callable[[], bool], pause: int | None = None) -> bool:
        """Run all steps, or those before point ``pause``, in chunks of about ``CHUNK_SECONDS``; True if interrupted."""
        chunk = 64
        stop = self.last if pause is None else pause
        last = stop if pause is None else stop + 1
        program = loop.array(self.program.point + self.program.step)
        split = len(self.program.point)
        record = self.program.recorded, self.rows, self.system.decimation
        while True:
            end = min(int(self.state[loop.POINT]) + chunk, stop)
            begun = clock_time.perf_counter()
            try:
                self.loop(program, split, record, end=end, last=last, check=self.check)
            finally:
                spent = clock_time.perf_counter() - begun
                self.stepping_seconds += spent
            if progress is not None:
                progress(end / stop)
            if end == stop:
                return False
            if interrupted():
                return True
            chunk = max(1, min(4 * chunk, int(chunk * CHUNK_SECONDS / max(spent, 1e-9))))

    def counters(self) -> dict[str, dict[str, float]]:
        found: dict[str, dict[str, float]] = {}
        for slave in self.slaves:
            variables = [v for v in slave.fmu.variables.values() if v.name.startswith(SOLVER) and v.type in KINDS]
            if variables:
                found[slave.name] = {v.name.removeprefix(SOLVER): slave.get(v) for v in variables}
        return found

    def result(self, solver: dict[str, dict[str, float]], *, partial: bool) -> Result:
        system = self.system
        count = int(self.state[loop.ROWS])
        messages = [*self.notices, *(m for slave in self.slaves for m in slave.log.messages)]
        points = np.arange(self.first_row, self.first_row + count, dtype=np.float64) * system.decimation
        return Result(
            time=self.clock[0] + points * self.clock[1],
            rows=self.rows[:count],
            columns=tuple(_column(f"{name}.{v}", system.variable(name, v)) for name, v in system.record),
            partial=partial,
            messages=tuple(sorted(messages, key=lambda message: message.time)),
            dropped_messages=sum(slave.log.dropped for slave in self.slaves),
            solver=solver,
            metadata={
                "system": system.name,
                "description": system.description,
                "system_hash": system.digest,
                "start_time": float(system.start_time),
                "stop_time": float(system.stop_time),
                "step_size": float(system.step_size),
                "steps": int(self.state[loop.POINT]),
                "order": system.order if isinstance(system.order, str) else list(system.order),
                "decimation": system.decimation,
                "connections": [str(connection) for connection in system.connections],
                "transformations": {
                    str(c): [c.factor, c.offset] for c in system.connections if (c.factor, c.offset) != (1.0, 0.0)
                },
                "fmus": {i.name: {"fmu": i.fmu.name, "sha256": i.fmu.digest} for i in system.instances},
                "warnings": int(self.state[loop.WARNINGS]),
                "versions": dict(_versions()),
                "total_seconds": clock_time.perf_counter() - self.started,
                "stepping_seconds": self.stepping_seconds,
            },
        )


def _column(name: str, variable: Variable) -> Column:
    unit = variable.unit or "1"
    shown = variable.display_unit
    if shown is None:
        return Column(name, unit, variable.text, unit)
    return Column(name, unit, variable.text, shown.name, shown.factor, shown.offset)


@cache
def _versions() -> Mapping[str, str]:
    found = {"python": platform.python_version(), "platform": platform.platform(), "fmpy": str(fmpy.__version__)}
    with contextlib.suppress(PackageNotFoundError):
        found["motion-cosim"] = version("motion-cosim")
    return MappingProxyType(found)


def _physical_memory() -> float:
    """Bytes of memory of this machine, where it can be asked for."""
    names = getattr(os, "sysconf_names", {})
    if "SC_PHYS_PAGES" not in names:
        return math.inf
    return float(os.sysconf("SC_PHYS_PAGES")) * os.sysconf("SC_PAGE_SIZE")
