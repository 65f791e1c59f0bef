"""Running a system: the life of its instances on FMPy, and the co-simulation algorithm.

Time is ``t_k = start_time + k*step_size`` with integer k, one multiplication in double, never a sum.

Initialization: instances are created, start values set, fmi2SetupExperiment called, initialization mode entered.
There the outputs are propagated along the connections, in the order of feedthrough, until nothing changes; so a
controller's output at the start is computed from the plant's real start. Then initialization mode is left.

Sequential order, at each communication point t_k:

1. each instance that is due (k is a multiple of its step multiple n), in order, gets its inputs from the current
   values; if any of its outputs depends directly on inputs, its outputs are read at once, so that whoever comes
   later in the order sees them;
2. all recorded variables are stored as row k: values at t_k, commands as they are applied from t_k on;
3. each instance whose interval ends at t_k+1 steps over [t_k+1 - n*h, t_k+1] with the inputs latched at its
   beginning, and its outputs are read. Outputs of a slower instance thus never appear early.

The last point gets its inputs, its feedthrough and its row, too.

Parallel order (Jacobi): in 1. all instances due get their inputs from the values after the last step, and nothing is
read until all have stepped: one sample of delay for a controller.

fmi2Warning is counted and logged, the run goes on. Any other status ends it: what was computed is kept in the
error's ``result``. All instances are freed; after fmi2Fatal the standard forbids every further call, so that
instance alone is left to the operating system.
"""

from __future__ import annotations

import contextlib
import ctypes
import itertools
import platform
import signal
import tempfile
import threading
import time as clock_time
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import FrameType, MappingProxyType, TracebackType
from typing import Any, Self, cast

import fmpy as _fmpy
import numpy as np
from fmpy import fmi1 as _fmi1
from fmpy import fmi2 as _fmi2
from fmpy import logging as _fmi_logging
from numpy.typing import NDArray

from . import loop
from .errors import DescriptionError, SimulationError, suggest
from .fmu import Fmu, Value, Variable
from .results import Column, Message, Result
from .system import Connection, Instance, System, start_value

fmpy: Any = _fmpy
fmi1: Any = _fmi1
fmi2: Any = _fmi2
fmi_logging: Any = _fmi_logging

Progress = Callable[[float], None]
"""Called with the fraction of the run that is done, at most some twenty times a second."""

STATUS = ("OK", "Warning", "Discard", "Error", "Fatal", "Pending")
FATAL = 4
CHUNK_SECONDS = 0.05
MAX_MESSAGES = 10_000
MAX_PASSES = 50
SOLVER_COUNTERS = ("solver.steps", "solver.rejected", "solver.rhs_evaluations")
KINDS = {"Real": 0, "Integer": 1, "Enumeration": 1, "Boolean": 2}
"""Which of the loop's set and get calls serves a type."""


class CallError(SimulationError):
    """An FMI call failed: who, which function, when, which status, and the last message of the FMU."""

    def __init__(self, instance: str, function: str, time: float, status: str, message: str, remedy: str = "") -> None:
        self.instance = instance
        self.function = function
        self.time = time
        self.status = status
        self.message = message
        self.result: Result | None = None
        said = f" The FMU said: {message}" if message else " The FMU gave no message."
        super().__init__(f"{instance}: {function} at {time:.9g} s returned fmi2{status}.{said}{remedy}")


class Interrupted(KeyboardInterrupt):
    """Ctrl-C during a run; ``result`` holds what was computed."""

    def __init__(self, result: Result) -> None:
        self.result = result
        super().__init__(f"interrupted at {result.time[-1] if result.time.size else 0.0:.9g} s")


def simulate(
    system: System,
    *,
    stop_time: float | None = None,
    step_size: float | None = None,
    order: str | list[str] | None = None,
    progress: Progress | None = None,
    debug: bool = False,
) -> Result:
    """Run ``system`` once. ``debug`` lets the FMUs log everything, not only what went wrong.

    Raises DescriptionError, CallError (with ``result``), or Interrupted (with ``result``) on Ctrl-C.
    """
    if stop_time is not None or step_size is not None or order is not None:
        system = system.changed(stop_time=stop_time, step_size=step_size, order=order)
    with Simulation(system, debug=debug) as simulation:
        return simulation.run(progress=progress)


class Simulation:
    """The loaded instances of a system, for one run or many::

        with Simulation(system) as simulation:
            for mass in (60.0, 70.0):
                result = simulation.run(system.changed({"plant.m": mass}))

    A context manager: instances exist between entering and leaving it.
    """

    def __init__(self, system: System, *, debug: bool = False) -> None:
        self.system = system
        self.debug = debug
        self._slaves: list[_Slave] = []
        self._fresh = True
        self._program: tuple[System, _Program] | None = None
        self._saved: list[tuple[_Slave, Any]] = []
        self._resources = contextlib.ExitStack()

    def __enter__(self) -> Self:
        try:
            self._open()
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Free all instances and delete what was unpacked. Checkpoints end here, too."""
        self._free_saved(self._saved)
        for slave in self._slaves:
            slave.free()
        self._slaves.clear()
        self._saved = []
        self._program = None
        self._resources.close()

    def run(self, system: System | None = None, *, progress: Progress | None = None) -> Result:
        """Run from the start, with another variant of the system if one is given (same instances of the same FMUs)."""
        run = self._ready(self.system if system is None else system)
        with _watching_for_interrupt() as interrupted:
            return run.go(progress, interrupted)

    def pause(self, time: float, system: System | None = None) -> Checkpoint:
        """Run from the start to ``time`` and keep what there is, for ``resume``.

        Needs FMUs that save their state (fmi2GetFMUstate). Raises DescriptionError for a time that is no communication
        point of the run before its end, CallError.
        """
        system = self.system if system is None else system
        point = _point(system, time)
        run = self._ready(system)
        with _watching_for_interrupt() as interrupted:
            result = run.go(None, interrupted, end=point)
        saved: list[tuple[_Slave, Any]] = []
        try:
            for slave in self._slaves:
                saved.append((slave, slave.save()))
        except CallError:
            self._free_saved(saved)
            raise
        self._saved += saved
        program = run.program
        return Checkpoint(system, run.time(), result, point, saved, program.values.copy(), program.integers.copy())

    def resume(
        self,
        checkpoint: Checkpoint,
        changes: Mapping[str, object] | None = None,
        *,
        stop_time: float | None = None,
        progress: Progress | None = None,
    ) -> Result:
        """Go on from a checkpoint of this simulation to ``stop_time`` (the system's if not given); rows from there on.

        ``changes`` gives tunable parameters and unconnected inputs another value from the checkpoint on.
        """
        system = checkpoint.system
        end = system.steps if stop_time is None else _point(system, stop_time)
        if end <= checkpoint.point:
            raise DescriptionError(f"stop time {stop_time} s is not after the checkpoint at {checkpoint.time:.9g} s.")
        values = _changes(system, changes or {})
        run = _Run(system, self._slaves, self._prepared(system), begin=checkpoint.point, end=end)
        self.restore(checkpoint)
        run.program.values[:] = checkpoint.values
        run.program.integers[:] = checkpoint.integers
        with _watching_for_interrupt() as interrupted:
            return run.go_on(values, progress, interrupted)

    def restore(self, checkpoint: Checkpoint) -> None:
        """Bring every instance back to where it was at ``checkpoint``."""
        if not self._slaves:
            raise DescriptionError("the simulation is closed. Use it in a with statement.")
        for slave, state in checkpoint.saved:
            slave.call("fmi2SetFMUstate", state)
        self._fresh = False

    def release(self, checkpoint: Checkpoint) -> None:
        """Free the FMU states of a checkpoint before the simulation ends."""
        self._saved = [entry for entry in self._saved if entry not in checkpoint.saved]
        self._free_saved(checkpoint.saved)

    def partial_derivatives(self, instance: str, unknowns: Sequence[str], knowns: Sequence[str]) -> NDArray[np.float64]:
        """Partial derivatives of ``unknowns`` (rows) by ``knowns`` of an instance where it is now; SI units.

        Needs an FMU with fmi2GetDirectionalDerivative; ``restore`` a checkpoint first. Raises CallError.
        """
        slave = self._slave(instance)
        variables = slave.fmu.variables
        rows = _references([variables[name] for name in unknowns])
        matrix = np.zeros((len(unknowns), len(knowns)))
        found, seed = (ctypes.c_double * len(unknowns))(), (ctypes.c_double * 1)(1.0)
        for column, name in enumerate(knowns):
            reference = _references([variables[name]])
            slave.call("fmi2GetDirectionalDerivative", rows, len(unknowns), reference, 1, seed, found)
            matrix[:, column] = found
        return matrix

    def value(self, instance: str, variable: str) -> float:
        """The value of a numeric variable where its instance is now."""
        slave = self._slave(instance)
        return slave.get(slave.fmu.variables[variable])

    def _slave(self, instance: str) -> _Slave:
        for slave in self._slaves:
            if slave.name == instance:
                return slave
        raise DescriptionError(f"no instance '{instance}'.{suggest(instance, (s.name for s in self._slaves))}")

    def _ready(self, system: System) -> _Run:
        """A run from the start on instances as new."""
        if not self._slaves:
            raise DescriptionError("the simulation is closed. Use it in a with statement.")
        if [(i.name, i.fmu.digest) for i in system.instances] != [(s.name, s.fmu.digest) for s in self._slaves]:
            raise DescriptionError(f"{system.name}: not the instances of {self.system.name}. Make a new Simulation.")
        run = _Run(system, self._slaves, self._prepared(system))
        if not self._fresh:
            for slave in self._slaves:
                slave.call("fmi2Reset")
        self._fresh = False
        return run

    def _prepared(self, system: System) -> _Program:
        """The program of ``system``: that of the run before, if only start values and times differ."""
        if self._program is None or not _same_program(self._program[0], system):
            self._program = system, _program(system, self._slaves)
        program = self._program[1]
        program.values[:] = 0.0
        program.integers[:] = 0
        return program

    @staticmethod
    def _free_saved(saved: Sequence[tuple[_Slave, Any]]) -> None:
        for slave, state in saved:
            slave.forget(state)

    def _open(self) -> None:
        folders: dict[str, tuple[Path, Path]] = {}
        for number, instance in enumerate(self.system.instances):
            digest = instance.fmu.digest
            if digest not in folders:
                folder = Path(self._resources.enter_context(_temporary_folder()))
                folders[digest] = folder, instance.fmu.extract(folder)
            slave = _Slave(instance, *folders[digest], debug=self.debug)
            self._slaves.append(slave)
            slave.load(number)


@dataclass(frozen=True)
class Checkpoint:
    """A run held at a communication point, from which ``Simulation.resume`` goes on any number of times."""

    system: System
    time: float
    result: Result
    """The rows before that point."""
    point: int
    saved: Sequence[tuple[_Slave, Any]]
    values: NDArray[np.float64]
    integers: NDArray[np.int32]


def _point(system: System, time: float) -> int:
    """Number of the communication point at ``time``."""
    steps = (time - float(system.start_time)) / float(system.step_size)
    point = round(steps)
    if abs(steps - point) > 1e-6 or not 0 < point <= system.steps:
        raise DescriptionError(
            f"{system.name}: {time:.9g} s is no communication point after the start at {system.start_time} s "
            f"up to {system.stop_time} s. Take a whole number of steps of {system.step_size} s."
        )
    return point


def _same_program(one: System, other: System) -> bool:
    """Whether two variants of a system differ in nothing that a program holds."""
    same = one.connections == other.connections and one.record == other.record and one.visits == other.visits
    multiples = [(i.name, i.step_multiple) for i in one.instances] == [
        (i.name, i.step_multiple) for i in other.instances
    ]
    return same and multiples and one.parallel == other.parallel


def _changes(system: System, changes: Mapping[str, object]) -> list[tuple[int, Variable, Value]]:
    """Instance number, variable and value of what changes at a checkpoint."""
    problems: list[str] = []
    found: list[tuple[int, Variable, Value]] = []
    names = [instance.name for instance in system.instances]
    fed = {connection.target for connection in system.connections}
    for path, given in changes.items():
        name, _, variable_name = path.partition(".")
        variable = system.variable(name, variable_name)
        value, problem = start_value(variable, given)
        if variable.causality != "input" and variable.variability != "tunable":
            problems.append(f"{path}: a {variable.variability} {variable.causality} cannot change during a run.")
        elif (name, variable_name) in fed:
            problems.append(f"{path}: this input is connected; only unconnected ones can be changed.")
        elif problem or value is None:
            problems.append(f"{path}: {problem}")
        else:
            found.append((names.index(name), variable, value))
    if problems:
        raise DescriptionError(problems)
    return found


class _Log:
    """Messages of one instance. FMUs find it by a number, which travels as their component environment."""

    _numbers = itertools.count(1)
    _open: dict[int, _Log] = {}

    def __init__(self, instance: str) -> None:
        self.instance = instance
        self.number = next(self._numbers)
        self.clock: Callable[[], float] = lambda: 0.0
        self.messages: list[Message] = []
        self.dropped = 0
        self.last = ""
        self._open[self.number] = self

    def close(self) -> None:
        self._open.pop(self.number, None)

    def add(self, status: int, category: str, text: str) -> None:
        said = STATUS[status] if 0 <= status < len(STATUS) else str(status)
        if status > 0:
            self.last = text
        if len(self.messages) < MAX_MESSAGES:
            self.messages.append(Message(self.instance, self.clock(), said, category, text))
        else:
            self.dropped += 1

    @classmethod
    def receive(cls, environment: int | None, name: bytes, status: int, category: bytes, message: bytes) -> None:
        """What FMUs call to log, while the loop runs, too."""
        log = cls._open.get(environment or 0)
        if log is None:
            # FMPy keeps one logger for the process; this FMU was loaded by someone else.
            fmi1.printLogMessage(environment, name, status, category, message)
        else:
            log.add(status, (category or b"").decode("utf-8", "replace"), (message or b"").decode("utf-8", "replace"))


_receive = fmi2.fmi2CallbackLoggerTYPE(_Log.receive)


def _callbacks(environment: int) -> Any:
    callbacks = fmi2.fmi2CallbackFunctions()
    callbacks.logger = _receive
    callbacks.allocateMemory = fmi2.defaultCallbacks.allocateMemory
    callbacks.freeMemory = fmi2.defaultCallbacks.freeMemory
    callbacks.componentEnvironment = environment
    # Formats the variable arguments of a message in C. FMPy hands all messages to the logger added last: add it anew.
    fmi_logging.addLoggerProxy(ctypes.byref(callbacks))
    return callbacks


class _Slave:
    """An instance on FMPy's FMU2Slave: its calls checked, its messages kept."""

    def __init__(self, instance: Instance, folder: Path, library: Path, *, debug: bool) -> None:
        self.name = instance.name
        self.fmu: Fmu = instance.fmu
        self.log = _Log(instance.name)
        self.fatal = False
        self._folder = folder
        self._library = library
        self._debug = debug
        self._slave: Any = None

    def load(self, number: int) -> None:
        """Load the library and create the instance."""
        try:
            self._slave = fmi2.FMU2Slave(
                guid=self.fmu.guid,
                modelIdentifier=self.fmu.identifier,
                unzipDirectory=str(self._folder),
                instanceName=self.name,
                libraryPath=str(self._library),
            )
        except Exception as error:
            # FMPy raises bare exceptions for a library that does not load or lacks a function.
            raise CallError(self.name, "loading its library", 0.0, "Error", str(error)) from None
        try:
            self._slave.instantiate(callbacks=_callbacks(self.log.number), loggingOn=True)
        except Exception:
            self._slave.freeLibrary()
            self._slave = None
            raise CallError(self.name, "fmi2Instantiate", 0.0, "Error", self.log.last) from None
        if not self._debug:
            categories = [c for c in self.fmu.log_categories if c.startswith("logStatus")]
            if categories:
                self._slave.setDebugLogging(True, categories)

    @property
    def component(self) -> int:
        return int(self._slave.component)

    def address(self, function: str) -> int:
        """Where an FMI function of the loaded library is."""
        return cast(int, ctypes.cast(getattr(self._slave.dll, function), ctypes.c_void_p).value)

    def call(self, function: str, *arguments: Any) -> Any:
        """Call an FMI function on this instance; raises CallError for a status other than OK and Warning."""
        try:
            return getattr(self._slave, function)(self._slave.component, *arguments)
        except fmi1.FMICallException as error:
            raise self.failed(function, int(error.status)) from None

    def failed(self, function: str, status: int) -> CallError:
        """The error for a status that ``function`` returned."""
        self.fatal = self.fatal or status == FATAL
        name = STATUS[status] if 0 <= status < len(STATUS) else str(status)
        remedy = " Asynchronous FMUs are not supported." if name == "Pending" else ""
        return CallError(self.name, function, self.log.clock(), name, self.log.last, remedy)

    def set(self, variable: Variable, value: Any) -> None:
        """Set one variable."""
        kind, ctype = _ctype(variable)
        content = value.encode() if kind == "String" else value
        self.call(f"fmi2Set{kind}", _references([variable]), 1, (ctype * 1)(content))

    def get(self, variable: Variable) -> float:
        """Read one numeric variable."""
        kind, ctype = _ctype(variable)
        buffer = (ctype * 1)()
        self.call(f"fmi2Get{kind}", _references([variable]), 1, buffer)
        return float(buffer[0])

    def save(self) -> Any:
        """The FMU's state, for fmi2SetFMUstate."""
        state = ctypes.c_void_p()
        self.call("fmi2GetFMUstate", ctypes.byref(state))
        return state

    def forget(self, state: Any) -> None:
        """Free a saved state."""
        if self._slave is not None and not self.fatal and state.value is not None:
            self.call("fmi2FreeFMUstate", ctypes.byref(state))

    def free(self) -> None:
        """Free the instance and its library, unless it said fmi2Fatal."""
        if self._slave is not None and not self.fatal:
            self._slave.freeInstance()
        self._slave = None
        self.log.close()


def _ctype(variable: Variable) -> tuple[str, Any]:
    kind = "Integer" if variable.type == "Enumeration" else variable.type
    return kind, {"Real": ctypes.c_double, "String": ctypes.c_char_p}.get(kind, ctypes.c_int)


def _references(variables: list[Variable]) -> Any:
    return (ctypes.c_uint * len(variables))(*(variable.reference for variable in variables))


@dataclass
class _Program:
    """What the compiled loop executes for one system, in arrays."""

    point: list[list[int]]
    step: list[list[int]]
    initial: list[list[int]]
    """Calls at a communication point, from one to the next, and of a pass of initialization."""
    outputs: list[list[int]]
    """Calls that read all outputs needed."""
    sources: NDArray[np.uint64]
    factors: NDArray[np.float64]
    offsets: NDArray[np.float64]
    values: NDArray[np.float64]
    integers: NDArray[np.int32]
    recorded: NDArray[np.uint64]
    references: list[NDArray[np.uint32]]
    """Held because the calls know them by address only."""


def _program(system: System, slaves: list[_Slave]) -> _Program:
    """Resolve names to slots, value references and addresses, once."""
    incoming: dict[str, list[Connection]] = {instance.name: [] for instance in system.instances}
    wanted: dict[str, dict[str, None]] = {instance.name: {} for instance in system.instances}
    for connection in system.connections:
        incoming[connection.target[0]].append(connection)
        wanted[connection.source[0]][connection.source[1]] = None
    fed = {connection.target for connection in system.connections}
    for name, variable in system.record:
        if (name, variable) not in fed:
            wanted[name][variable] = None

    slots: dict[tuple[str, str], int] = {}
    groups: dict[tuple[str, int], list[Variable]] = {}
    for instance in system.instances:
        variables = instance.fmu.variables
        inputs = [variables[connection.target[1]] for connection in incoming[instance.name]]
        outputs = [variables[name] for name in wanted[instance.name]]
        for first, chosen in ((loop.SET_REAL, inputs), (loop.GET_REAL, outputs)):
            for kind in range(3):
                group = [variable for variable in chosen if KINDS[variable.type] == kind]
                if group:
                    groups[instance.name, first + kind] = group
                    for variable in group:
                        slots[instance.name, variable.name] = len(slots)

    values = np.zeros(max(len(slots), 1))
    integers = np.zeros(values.size, dtype=np.int32)
    sources: list[int] = []
    gains: list[tuple[float, float]] = []
    references: list[NDArray[np.uint32]] = []
    sets: dict[str, list[list[int]]] = {}
    gets: dict[str, list[list[int]]] = {}
    steps: list[list[int]] = []
    for number, (instance, slave) in enumerate(zip(system.instances, slaves, strict=True)):

        def row(call: int, group: list[Variable]) -> list[int]:
            cells = [0] * loop.PROGRAM_COLUMNS
            cells[loop.CALL] = call
            cells[loop.MULTIPLE] = instance.step_multiple
            cells[loop.FUNCTION] = slave.address(loop.FUNCTIONS[call])
            cells[loop.COMPONENT] = slave.component
            cells[loop.INSTANCE] = number
            if group:
                references.append(np.array([variable.reference for variable in group], dtype=np.uint32))
                slot = slots[instance.name, group[0].name]
                buffer = values if call in (loop.SET_REAL, loop.GET_REAL) else integers
                cells[loop.REFERENCES] = references[-1].ctypes.data
                cells[loop.COUNT] = len(group)
                cells[loop.BUFFER] = buffer.ctypes.data + slot * buffer.itemsize
                cells[loop.SLOT] = slot
                cells[loop.LINKS] = len(sources)
            return cells

        into = {connection.target[1]: connection for connection in incoming[instance.name]}
        sets[instance.name], gets[instance.name] = [], []
        for call in range(loop.SET_REAL, loop.DO_STEP):
            group = groups.get((instance.name, call))
            if group is None:
                continue
            if call in (loop.SET_REAL, loop.SET_INTEGER, loop.SET_BOOLEAN):
                links = [into[variable.name] for variable in group]
                sets[instance.name].append(row(call, group))
                sets[instance.name][-1][loop.PLAIN] = all((c.factor, c.offset) == (1.0, 0.0) for c in links)
                sources += [slots[c.source] for c in links]
                gains += [(c.factor, c.offset) for c in links]
            else:
                gets[instance.name].append(row(call, group))
        steps += [row(loop.DO_STEP, []), *gets[instance.name]]

    point: list[list[int]] = []
    initial: list[list[int]] = []
    for name in system.visits:
        dependencies = system.instance(name).fmu.dependencies
        direct = any((name, i) in fed for output in wanted[name] for i in dependencies.get(output, ()))
        point += sets[name]
        if direct and not system.parallel:
            point += gets[name]
        initial += [*sets[name], *gets[name]]
    return _Program(
        point=point,
        step=steps,
        initial=initial,
        outputs=[cells for rows in gets.values() for cells in rows],
        sources=np.array(sources, dtype=np.uint64),
        factors=np.array([factor for factor, _ in gains], dtype=np.float64),
        offsets=np.array([offset for _, offset in gains], dtype=np.float64),
        values=values,
        integers=integers,
        recorded=np.array([slots[end] for end in system.record], dtype=np.uint64),
        references=references,
    )


class _Run:
    """One run of a system on loaded instances."""

    def __init__(
        self, system: System, slaves: list[_Slave], program: _Program, *, begin: int = 0, end: int | None = None
    ) -> None:
        self.system = system
        self.slaves = slaves
        self.program = program
        self.last = system.steps if end is None else end
        """The communication point that ends the run."""
        self.clock = np.array([float(system.start_time), float(system.step_size)])
        self.state = np.zeros(loop.STATE_LENGTH, dtype=np.int64)
        self.state[loop.POINT] = begin
        self.first_row = -(-begin // system.decimation)
        shape = (self.last // system.decimation + 1 - self.first_row, len(system.record))
        try:
            self.rows = np.empty(shape)
        except MemoryError:
            size = shape[0] * shape[1] * 8 / 2**30
            raise DescriptionError(
                f"{system.name}: {shape[0]} rows of {shape[1]} variables need {size:.1f} GiB of memory. "
                "Record fewer variables or take a larger decimation."
            ) from None
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
        except CallError as error:
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
        except CallError as error:
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
            for name, value in instance.start.items():
                slave.set(instance.fmu.variables[name], value)
        tolerance = system.tolerance
        for slave in self.slaves:
            slave.call(
                "fmi2SetupExperiment",
                tolerance is not None,
                0.0 if tolerance is None else tolerance,
                self.clock[0],
                True,
                float(system.stop_time),
            )
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

    def once(self, calls: list[list[int]]) -> None:
        """Make some calls at the start of the run, recording nothing."""
        nothing = np.zeros(0, dtype=np.uint64)
        self.loop(_array(calls), len(calls), nothing, np.zeros((0, 0)), 0, 0, 1)
        self.state[loop.ROWS] = 0

    def loop(
        self,
        program: NDArray[np.uint64],
        split: int,
        recorded: NDArray[np.uint64],
        rows: NDArray[np.float64],
        end: int,
        last: int,
        decimation: int,
    ) -> None:
        """Let the compiled loop go on to ``end``; raises CallError."""
        p = self.program
        ready = p.sources, p.factors, p.offsets, p.values, p.integers, recorded, rows, self.clock, self.state
        if not loop.advance(program, split, *ready, end, last, decimation):
            slave = self.slaves[int(self.state[loop.FAILED_INSTANCE])]
            function = loop.FUNCTIONS[int(self.state[loop.FAILED_CALL])]
            raise slave.failed(function, int(self.state[loop.FAILED_STATUS]))

    def step(self, progress: Progress | None, interrupted: Callable[[], bool], pause: int | None = None) -> bool:
        """Run all steps, or those before point ``pause``, in chunks of about ``CHUNK_SECONDS``; True if interrupted."""
        chunk = 64
        stop = self.last if pause is None else pause
        last = stop if pause is None else stop + 1
        program = _array(self.program.point + self.program.step)
        split = len(self.program.point)
        while True:
            end = min(int(self.state[loop.POINT]) + chunk, stop)
            begun = clock_time.perf_counter()
            try:
                self.loop(program, split, self.program.recorded, self.rows, end, last, self.system.decimation)
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
            variables = [slave.fmu.variables[name] for name in SOLVER_COUNTERS if name in slave.fmu.variables]
            if variables:
                found[slave.name] = {v.name.removeprefix("solver."): slave.get(v) for v in variables}
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
                "fmus": {i.name: {"fmu": i.fmu.name, "sha256": i.fmu.digest} for i in system.instances},
                "warnings": int(self.state[loop.WARNINGS]),
                "versions": dict(_versions()),
                "total_seconds": clock_time.perf_counter() - self.started,
                "stepping_seconds": self.stepping_seconds,
            },
        )


def _array(calls: list[list[int]]) -> NDArray[np.uint64]:
    return np.array(calls, dtype=np.uint64).reshape(-1)


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


def _temporary_folder() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="cosim-", ignore_cleanup_errors=True)


@contextlib.contextmanager
def _watching_for_interrupt() -> Generator[Callable[[], bool]]:
    """Ctrl-C sets a flag instead of raising, so that no instance is left half-stepped; a second one raises."""
    if threading.current_thread() is not threading.main_thread() or (
        signal.getsignal(signal.SIGINT) is not signal.default_int_handler
    ):
        yield lambda: False
        return
    pressed = threading.Event()

    def handle(number: int, frame: FrameType | None) -> None:
        if pressed.is_set():
            signal.default_int_handler(number, frame)
        pressed.set()

    signal.signal(signal.SIGINT, handle)
    try:
        yield pressed.is_set
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
