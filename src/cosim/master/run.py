"""One run of a system on loaded instances."""

from __future__ import annotations

import math
import os
import signal
import time as clock_time
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ..errors import DescriptionError
from ..fmu.variables import Value, Variable
from ..result.result import Message, Result
from ..system.parts import Connection
from ..system.system import System
from ..system.values import is_numeric
from . import loop, loop_plain
from .board import IN_LOOP, STEPPING, STOP, Board
from .instance import STATUS, FmuInstance, Log, RunError
from .interrupts import Ended, Presses
from .metadata import result_columns, system_metadata
from .program import Program
from .tables import POINTS

Progress = Callable[[float], None]
"""Called with the fraction of the run that is done, about twenty times a second at most."""

CHUNK_SECONDS = 0.05
"""Time between two looks at Ctrl-C and reports of progress: too short to notice, long beside the cost of a chunk."""

MAX_PASSES = 50
"""Largest number of passes of initialization. Without a loop through initial values, two are enough; a loop
whose values still change after so many passes converges too slowly or not at all."""

SOLVER = "solver."
"""Beginning of the names of solver counters. Their values at the end of a run are kept in the result."""


class Interrupted(Ended):
    """Ctrl-C, SIGTERM or SIGHUP ended a run. ``result`` holds the rows computed so far.

    ``number`` is the number of the signal.
    """

    def __init__(self, result: Result, number: int = signal.SIGINT) -> None:
        super().__init__(number)
        self.result = result
        self.args = (f"interrupted at {result.time[-1] if result.time.size else 0.0:.9g} s",)


class SignalError(RunError):
    """A connection carries a value that is not finite, or that does not fit the type of its input.

    ``value`` is in the unit of the input.
    """

    def __init__(self, connection: Connection, value: float, *, time: float, why: str) -> None:
        self.connection = connection
        self.value = value
        source, target = ".".join(connection.source), ".".join(connection.target)
        super().__init__(
            f"{source} gives {target} the value {value:.9g} at {time:.9g} s: {why}. To go on with such values: "
            "--keep-going, or keep_going=True.",
            time=time,
        )


class _Termination(RunError):
    """An FMU asked to end the simulation at ``reached`` in s: at the end of its step, or earlier."""

    def __init__(self, slave: FmuInstance, reached: float, *, time: float) -> None:
        self.slave = slave
        self.reached = reached
        super().__init__(f"{slave.name} ended the simulation at {reached:.9g} s.", time=time)


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
        self.board = Board.here
        """The memory in which another process sees the state; None if there is no other process."""
        self.shared = self.board if self.board is not None and self.board.capacity else None
        """The same memory if the rows are in it, too."""
        self.first_row = -(-begin // system.decimation)
        if self.shared is None:
            rows = self.last // system.decimation + 1 - self.first_row
            check_memory(system, rows)
            self.rows = np.empty((rows, len(system.record)))
        else:
            self.rows = self.shared.window
        if self.board is None:
            self.state = np.zeros(loop.STATE_LENGTH, dtype=np.int64)
            self.state[loop.POINT] = begin
        else:
            self.state = self.board.state
            self.board.begin(system, begin)
        self.notices: list[Message] = []
        self.ended = False
        """Whether an FMU asked for the end."""
        self.started = clock_time.perf_counter()
        self.stepping_seconds = 0.0

    def time(self) -> float:
        return float(self.clock[0] + self.state[loop.POINT] * self.clock[1])

    def run(self, progress: Progress | None, interrupted: Presses, *, end: int | None = None) -> Result:
        """Run from initialization to termination. With ``end``, stop before this point and do not terminate.

        Raises CallError, SignalError or Interrupted, with the partial ``result``.
        """
        self.begin_log()
        try:
            self.initialize()
            stopped = self.step(progress, interrupted, end)
            solver = self.counters()
            if end is None:
                for slave in self.slaves:
                    slave.terminate()
        except RunError as error:
            error.result = self.result({}, partial=True)
            raise
        result = self.result(solver, partial=stopped or end is not None)
        if stopped or interrupted():
            raise Interrupted(result, interrupted.number or signal.SIGINT)
        return result

    def resume(
        self, changes: list[tuple[int, Variable, Value]], progress: Progress | None, interrupted: Presses
    ) -> Result:
        """Run from a restored checkpoint to the end. The instances are not terminated, so they can be restored again.

        ``changes`` are instance number, variable and value. Raises CallError, SignalError or Interrupted.
        """
        self.begin_log()
        try:
            for number, variable, value in changes:
                self.slaves[number].set(variable, value)
            stopped = self.step(progress, interrupted)
            solver = self.counters()
        except RunError as error:
            error.result = self.result({}, partial=True)
            raise
        result = self.result(solver, partial=stopped)
        if stopped or interrupted():
            raise Interrupted(result, interrupted.number or signal.SIGINT)
        return result

    def begin_log(self) -> None:
        """Begin a new log in every instance, with the time of this run."""
        for slave in self.slaves:
            slave.log.begin(self.time)

    def initialize(self) -> None:
        system = self.system
        for slave, instance in zip(self.slaves, system.instances, strict=True):
            slave.set_all(instance.start)
        for slave in self.slaves:
            tolerance = (slave.fmu.tolerance if system.tolerance is None else system.tolerance) or 0.0
            slave.enter_initialization(float(self.clock[0]), float(system.stop_time), tolerance)
        for slave, instance in zip(self.slaves, system.instances, strict=True):
            slave.keep(instance.start)
        self.propagate()
        for slave in self.slaves:
            slave.exit_initialization()
        self.evaluate("outputs")

    def propagate(self) -> None:
        """Carry outputs to inputs until nothing changes: two passes, unless there is a loop through initial values."""
        program = self.program
        self.evaluate("outputs")
        for _ in range(MAX_PASSES):
            before = program.values.copy()
            self.evaluate("initial")
            if np.array_equal(before, program.values, equal_nan=True):
                return
        text = f"outputs still change after {MAX_PASSES} passes of initialization; the loop may have no solution"
        self.notices.append(Message("master", self.time(), "Warning", "initialization", text))
        Log.sink(self.notices[-1])

    def evaluate(self, part: str) -> None:
        """Execute a part of ``Program.arrays`` at the start of the run, without recording.

        Values are not checked: they may be not finite until all outputs are known.
        """
        unrecorded = np.zeros(0, dtype=np.uint64), np.zeros((0, 0)), 1
        rows = self.program.arrays[part]
        self.loop(rows, rows.size // loop.PROGRAM_COLUMNS, unrecorded, end=0, last=0, check=False)
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
        """Run the loop to point ``end``; ``record`` is slots, rows and decimation. Raises RunError."""
        slots, rows, decimation = record
        self.program.tables.fill(int(self.state[loop.POINT]), end)
        arrays = program, split, self.program.links, self.program.values, slots, rows, self.clock, self.state
        advance = loop.compiled() or loop_plain.advance
        if self.board is not None:
            self.board.flags[IN_LOOP] = 1
        try:
            done = advance(*arrays, end=end, last=last, decimation=decimation, check=check)
        finally:
            if self.board is not None:
                self.board.flags[IN_LOOP] = 0
        if not done:
            raise self.stopped()

    def stopped(self) -> RunError:
        """The error for the reason why the loop stopped."""
        program, state = self.program, self.state
        if state[loop.REASON] == loop.NOT_FINITE:
            number = int(state[loop.FAILED_LINK])
            source, _, factor, offset = program.links[number].tolist()
            value = factor * float(program.values[source]) + offset
            if math.isfinite(value):
                value = math.copysign(math.inf, value)  # the sum of several sources is too large
            return SignalError(program.connections[number], value, time=self.time(), why="not finite")
        if state[loop.REASON] == loop.OUT_OF_RANGE:
            slot = int(state[loop.FAILED_SLOT])
            connection = next(c for c in program.connections if program.slots[c.target] == slot)
            why = f"beyond what {self.system.variable(*connection.target).passed_as} can be"
            return SignalError(connection, float(program.values[slot]), time=self.time(), why=why)
        number, function = loop.call_of(state) or (0, "")
        slave, reached = self.slaves[number], float(state.view(np.float64)[loop.LAST_TIME])
        if state[loop.REASON] == loop.TERMINATED:
            return _Termination(slave, reached, time=self.time())
        if state[loop.REASON] == loop.RETURNED_EARLY:
            where = f"{slave.name}: {function} at {self.time():.9g} s"
            text = f"{where} returned early, at {reached:.9g} s, though told not to. Take a step that ends there."
            return RunError(text, time=self.time(), message=slave.log.last)
        status = int(state[loop.STATUS])
        error = slave.failed(function, status)
        if function == "fmi2DoStep" and STATUS[status : status + 1] == ("Discard",):
            ended = slave.terminated_at()
            if ended is not None:
                return _Termination(slave, ended, time=self.time())
        return error

    def step(self, progress: Progress | None, interrupted: Presses, pause: int | None = None) -> bool:
        """Run all steps, or the steps up to point ``pause``. Returns True if the run was interrupted.

        Steps are run in chunks of about ``CHUNK_SECONDS``, so that progress is reported and Ctrl-C is seen in between.
        """
        chunk = 64
        stop = self.last if pause is None else pause
        last = stop if pause is None else stop + 1
        program = self.program.arrays["step"]
        split = len(self.program.point)
        every = self.system.decimation
        most = POINTS if self.program.tables.width else stop
        if self.board is not None:
            self.board.flags[STEPPING] = 1
        while True:
            point = int(self.state[loop.POINT])
            end = min(point + chunk, stop, point + most)
            if self.shared is not None:
                room = self.shared.room()
                # Each multiple of ``every`` from ``point`` to ``end`` gives a row. These rows must fit into ``room``.
                end = min(end, (-(-point // every) + room - 1) * every)
                self.rows = self.shared.window
            record = self.program.recorded, self.rows, every
            begun = clock_time.perf_counter()
            try:
                self.loop(program, split, record, end=end, last=last, check=self.check)
            except _Termination as termination:
                self.finish(termination)
                return False
            finally:
                spent = clock_time.perf_counter() - begun
                self.stepping_seconds += spent
            if progress is not None:
                progress(end / stop)
            if end == stop:
                return False
            if interrupted() or (self.board is not None and self.board.flags[STOP]):
                return True
            steps = end - point
            chunk = max(1, min(4 * chunk, int(steps * CHUNK_SECONDS / max(spent, 1e-9))))

    def finish(self, termination: _Termination) -> None:
        """End the run where an FMU asked for it: at the end of its step if it got there, else at the point before.

        If it got to the end of its step, the remaining instances step to the same point, and the row is recorded.
        """
        point = int(self.state[loop.POINT])
        due, h = float(self.clock[0] + (point + 1) * self.clock[1]), float(self.clock[1])
        rows = self.program.step
        reached = termination.reached
        while reached >= due - 1e-6 * h:
            # The FMU's step is done. The rest of its row, and all later rows, remain to be executed.
            calling = int(self.state[loop.CALLING])
            at = next(i for i, row in enumerate(rows) if row.get(loop.STEP) and row[loop.STEP_CALL] == calling)
            rows = [{**rows[at], loop.STEP: 0}, *rows[at + 1 :]]
            recorded = int(self.state[loop.ROWS])
            try:
                nothing = np.zeros(0, dtype=np.uint64), np.zeros((0, 0)), self.system.decimation
                self.loop(loop.array(rows), 0, nothing, end=point + 1, last=point + 2, check=self.check)
            except _Termination as another:
                reached = min(reached, another.reached)
                continue
            finally:
                self.state[loop.ROWS] = recorded
            record = self.program.recorded, self.rows, self.system.decimation
            points = loop.array(self.program.point)
            self.loop(points, len(self.program.point), record, end=point + 1, last=point + 1, check=self.check)
            break
        self.ended = True
        text = f"asked to end the simulation at {termination.reached:.9g} s; the run ends at {self.time():.9g} s"
        self.notices.append(Message(termination.slave.name, self.time(), "OK", "terminated", text))
        Log.sink(self.notices[-1])

    def counters(self) -> dict[str, dict[str, float]]:
        found: dict[str, dict[str, float]] = {}
        for slave in self.slaves:
            names = [v.name for v in slave.fmu.variables.values() if v.name.startswith(SOLVER) and is_numeric(v)]
            if names:
                values = slave.get_all(names)
                found[slave.name] = {name.removeprefix(SOLVER): values[name] for name in names}
        return found

    def result(self, solver: dict[str, dict[str, float]], *, partial: bool) -> Result:
        if self.shared is not None:
            # The watching process makes the result. It has the rows and the messages already.
            dropped = sum(slave.log.dropped for slave in self.slaves)
            facts = {"stepping_seconds": self.stepping_seconds}
            return Result(np.empty(0), np.empty((0, 0)), (), partial, (), dropped, solver, facts)
        return make_result(
            self.system,
            self.rows[: int(self.state[loop.ROWS])],
            self.state,
            first_row=self.first_row,
            messages=[*self.notices, *(m for slave in self.slaves for m in slave.log.messages)],
            dropped_messages=sum(slave.log.dropped for slave in self.slaves),
            solver=solver,
            partial=partial,
            total_seconds=clock_time.perf_counter() - self.started,
            stepping_seconds=self.stepping_seconds,
        )


def make_result(
    system: System,
    rows: NDArray[np.float64],
    state: NDArray[np.int64],
    *,
    first_row: int = 0,
    every: int = 1,
    messages: Sequence[Message],
    dropped_messages: int,
    solver: Mapping[str, Mapping[str, float]],
    partial: bool,
    total_seconds: float,
    stepping_seconds: float,
) -> Result:
    """The result of a run whose loop is in ``state``. ``rows`` holds every ``every``-th row from ``first_row`` on.

    ``rows`` has the shape (rows, recorded variables). Times are in s.
    """
    return Result(
        time=row_times(system, first_row, len(rows), every),
        rows=rows,
        columns=result_columns(system),
        partial=partial,
        messages=tuple(sorted(messages, key=lambda message: message.time)),
        dropped_messages=dropped_messages,
        solver=solver,
        metadata={
            **system_metadata(system),
            "decimation": system.decimation * every,
            "steps": int(state[loop.POINT]),
            "warnings": int(state[loop.WARNINGS]),
            "total_seconds": total_seconds,
            "stepping_seconds": stepping_seconds,
        },
    )


def row_times(system: System, first: int, count: int, every: int = 1) -> NDArray[np.float64]:
    """The times in s of ``count`` rows, which are every ``every``-th row from row ``first`` on."""
    each = system.decimation
    times = np.arange(first * each, (first + count * every) * each, every * each, dtype=np.float64)
    # In place, because the times of a long record can be as large as its rows.
    times *= float(system.step_size)
    times += float(system.start_time)
    return times


def check_memory(system: System, rows: int) -> None:
    """Raise DescriptionError if ``rows`` recorded rows do not fit into the memory of this machine."""
    need = rows * len(system.record) * 8
    if need > _physical_memory():
        raise DescriptionError(
            f"{system.name}: {rows} rows of {len(system.record)} variables need {need / 2**30:.1f} GiB of memory. "
            "Record fewer variables or take a larger decimation."
        )


def _physical_memory() -> float:
    """The memory of this machine in bytes; infinity if the system does not tell."""
    names = getattr(os, "sysconf_names", {})
    if "SC_PHYS_PAGES" not in names:
        return math.inf
    return float(os.sysconf("SC_PHYS_PAGES")) * os.sysconf("SC_PAGE_SIZE")
