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
import math
import os
import platform
import signal
import tempfile
import threading
import time as clock_time
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import FrameType, MappingProxyType, TracebackType
from typing import Any, ClassVar, Self, cast

import numpy as np
from numpy.typing import NDArray

from . import loop, loop_plain
from .errors import DescriptionError, SimulationError, suggest
from .fmu import Fmu, Value, Variable
from .results import Column, Message, Result
from .system import Connection, Instance, System, start_value

fmpy: Any = import_module("fmpy")
fmi1: Any = import_module("fmpy.fmi1")
fmi2: Any = import_module("fmpy.fmi2")
fmi_logging: Any = import_module("fmpy.logging")

Progress = Callable[[float], None]
"""Called with the fraction of the run that is done, at most some twenty times a second."""

STATUS = ("OK", "Warning", "Discard", "Error", "Fatal", "Pending")
FATAL = 4
CHUNK_SECONDS = 0.05
MAX_MESSAGES = 10_000
MAX_PASSES = 50
SOLVER = "solver."
"""Numbers an FMU offers under names with this beginning are kept at the end of a run."""
KINDS = {"Real": 0, "Integer": 1, "Enumeration": 1, "Boolean": 2}
"""Which of the loop's set and get calls serves a type."""


class RunError(SimulationError):
    """Something ended a run early; ``result`` holds what was computed."""

    def __init__(self, text: str, *, time: float, message: str = "") -> None:
        self.time = time
        self.message = message
        self.result: Result | None = None
        super().__init__(text)


class CallError(RunError):
    """An FMI call failed: who, which function, when, which status, and the last message of the FMU."""

    def __init__(
        self, instance: str, function: str, *, time: float, status: str, message: str, remedy: str = ""
    ) -> None:
        self.instance = instance
        self.function = function
        self.status = status
        said = f" The FMU said: {message}" if message else " The FMU gave no message."
        text = f"{instance}: {function} at {time:.9g} s returned fmi2{status}.{said}{remedy}"
        super().__init__(text, time=time, message=message)


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
    keep_going: bool = False,
) -> Result:
    """Run ``system`` once. ``debug`` lets the FMUs log everything, not only what went wrong.

    Values on connections that are not finite, or beyond the type of their input, end the run unless ``keep_going``.
    Raises DescriptionError, CallError or SignalError (with ``result``), or Interrupted (with ``result``) on Ctrl-C.
    """
    if stop_time is not None or step_size is not None or order is not None:
        system = system.changed(stop_time=stop_time, step_size=step_size, order=order)
    with Simulation(system, debug=debug, keep_going=keep_going) as simulation:
        return simulation.run(progress=progress)


class Simulation:
    """The loaded instances of a system, for one run or many::

        with Simulation(system) as simulation:
            for mass in (60.0, 70.0):
                result = simulation.run(system.changed({"plant.m": mass}))

    A context manager: instances exist between entering and leaving it.
    """

    def __init__(self, system: System, *, debug: bool = False, keep_going: bool = False) -> None:
        self.system = system
        self.debug = debug
        self.keep_going = keep_going
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
        point = _point(system, time, least=0)
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
        return Checkpoint(system, run.time(), result, point, saved, program.values.copy(), program.others.copy())

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
        run = _Run(
            system, self._slaves, self._prepared(system), begin=checkpoint.point, end=end, check=not self.keep_going
        )
        self.restore(checkpoint)
        run.program.values[:] = checkpoint.values
        run.program.others[:] = checkpoint.others
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
        run = _Run(system, self._slaves, self._prepared(system), check=not self.keep_going)
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
        program.others[:] = 0
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
            slave = _Slave(number, instance, *folders[digest], debug=self.debug)
            self._slaves.append(slave)
            slave.load()


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
    others: NDArray[np.uint64]


def _point(system: System, time: float, *, least: int = 1) -> int:
    """Number of the communication point at ``time``, ``least`` or later."""
    steps = (time - float(system.start_time)) / float(system.step_size)
    point = round(steps)
    if abs(steps - point) > 1e-6 or not least <= point <= system.steps:
        raise DescriptionError(
            f"{system.name}: {time:.9g} s is no communication point of this run from {system.start_time} s "
            f"to {system.stop_time} s. Take a whole number of steps of {system.step_size} s."
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

    _numbers: ClassVar = itertools.count(1)
    _open: ClassVar[dict[int, _Log]] = {}

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


_LOADING = threading.Lock()
"""Held while FMPy loads a library, for which it changes the working directory of the process."""


class _Slave:
    """An instance on FMPy's FMU2Slave: its calls checked, its messages kept."""

    def __init__(self, number: int, instance: Instance, folder: Path, library: Path, *, debug: bool) -> None:
        self.number = number
        self.name = instance.name
        self.fmu: Fmu = instance.fmu
        self.log = _Log(instance.name)
        self.fatal = False
        self._folder = folder
        self._library = library
        self._debug = debug
        self._slave: Any = None

    def load(self) -> None:
        """Load the library and create the instance. Raises SimulationError."""
        with _LOADING:
            place = os.getcwd()
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
                text = str(error).replace(str(self._folder), self.fmu.path.name)
                raise SimulationError(f"{self.name}: the library of {self.fmu.name} cannot be used: {text}") from None
            finally:
                os.chdir(place)
        try:
            self._slave.instantiate(callbacks=_callbacks(self.log.number), loggingOn=True)
        except Exception:
            self._slave.freeLibrary()
            self._slave = None
            raise CallError(self.name, "fmi2Instantiate", time=0.0, status="Error", message=self.log.last) from None
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
        return CallError(self.name, function, time=self.log.clock(), status=name, message=self.log.last, remedy=remedy)

    def set(self, variable: Variable, value: Any) -> None:
        """Set one variable."""
        kind, ctype = _ctype(variable)
        content = value.encode() if kind == "String" else value
        self.call(f"fmi2Set{kind}", _references([variable]), 1, (ctype * 1)(content))

    def set_all(self, values: Mapping[str, Any]) -> None:
        """Set variables by name, those of one type in one call."""
        groups: dict[str, list[Variable]] = {}
        for name in values:
            variable = self.fmu.variables[name]
            groups.setdefault(_ctype(variable)[0], []).append(variable)
        for kind, group in groups.items():
            ctype = _ctype(group[0])[1]
            given = [values[variable.name] for variable in group]
            content = [value.encode() for value in given] if kind == "String" else given
            self.call(f"fmi2Set{kind}", _references(group), len(group), (ctype * len(group))(*content))

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

    point: list[loop.Row]
    step: list[loop.Row]
    initial: list[loop.Row]
    """Rows for a communication point, from one to the next, and for a pass of initialization."""
    outputs: list[loop.Row]
    """Rows that read all outputs needed."""
    slots: Mapping[tuple[str, str], int]
    connections: list[Connection]
    """In the order of ``links``."""
    links: NDArray[np.void]
    values: NDArray[np.float64]
    others: NDArray[np.uint64]
    recorded: NDArray[np.uint64]
    references: list[NDArray[np.uint32]]
    """Held because the rows know them by address only."""


class _Signals:
    """The slot of every signal that travels or is recorded, by instance, direction and type."""

    def __init__(self, system: System) -> None:
        self.slots: dict[tuple[str, str], int] = {}
        self.inputs: dict[tuple[str, int], list[Connection]] = {}
        self.outputs: dict[tuple[str, int], list[Variable]] = {}
        fed = {connection.target for connection in system.connections}
        for instance in system.instances:
            variables = instance.fmu.variables
            incoming = [c for c in system.connections if c.target[0] == instance.name]
            wanted = [c.source[1] for c in system.connections if c.source[0] == instance.name]
            wanted += [v for name, v in system.record if name == instance.name and (name, v) not in fed]
            for kind in range(3):
                inputs = [c for c in incoming if KINDS[variables[c.target[1]].type] == kind]
                outputs = [variables[name] for name in dict.fromkeys(wanted) if KINDS[variables[name].type] == kind]
                self.inputs[instance.name, kind], self.outputs[instance.name, kind] = inputs, outputs
                for name in [*(c.target[1] for c in inputs), *(v.name for v in outputs)]:
                    self.slots[instance.name, name] = len(self.slots)
        self.values = np.zeros(max(len(self.slots), 1))
        self.others = np.zeros(self.values.size, dtype=np.uint64)
        """Buffers for values of other types than double, those of a call side by side from its first slot on."""
        self.references: list[NDArray[np.uint32]] = []

    def call(self, slave: _Slave, kind: int, variables: Sequence[Variable], *, into: bool) -> loop.Row:
        """A call that sets (``into``) or reads variables whose slots lie side by side."""
        name, number = list(loop.FMI2_TYPES.items())[kind]
        function = f"fmi2{'Set' if into else 'Get'}{name}"
        self.references.append(np.array([variable.reference for variable in variables], dtype=np.uint32))
        slot = self.slots[slave.name, variables[0].name]
        buffer = self.values if number == loop.FLOAT64 else self.others
        return {
            loop.FMI: 2,
            loop.COMPONENT: slave.component,
            loop.ACT: loop.EXCHANGE,
            loop.FUNCTION: slave.address(function),
            loop.CALL: loop.call_number(slave.number, function),
            loop.REFERENCES: self.references[-1].ctypes.data,
            loop.REFERENCE_COUNT: len(variables),
            loop.COUNT: len(variables),
            loop.BUFFER: buffer.ctypes.data + slot * buffer.itemsize,
            loop.SLOT: slot,
            loop.TYPE: number,
            loop.SET: int(into),
        }


def _program(system: System, slaves: list[_Slave]) -> _Program:
    """Resolve names to slots, value references and addresses, once."""
    signals = _Signals(system)
    links: list[Connection] = []
    sets: dict[str, list[loop.Row]] = {}
    gets: dict[str, list[loop.Row]] = {}
    step: list[loop.Row] = []
    for instance, slave in zip(system.instances, slaves, strict=True):
        variables, name, multiple = instance.fmu.variables, instance.name, instance.step_multiple
        into, out = sets.setdefault(name, []), gets.setdefault(name, [])
        for kind in range(3):
            connections, outputs = signals.inputs[name, kind], signals.outputs[name, kind]
            if connections:
                row = signals.call(slave, kind, [variables[c.target[1]] for c in connections], into=True)
                into.append({**row, loop.LINKS: len(connections), loop.LINK: len(links)})
                links += connections
            if outputs:
                out.append(signals.call(slave, kind, outputs, into=False))
        first, *others = out or [{loop.FMI: 2, loop.COMPONENT: slave.component}]
        called = loop.call_number(slave.number, "fmi2DoStep")
        stepping = {loop.STEP: slave.address("fmi2DoStep"), loop.STEP_CALL: called, loop.MULTIPLE: multiple}
        step += _guarded([{**first, **stepping}, *others], multiple)

    fed = {connection.target for connection in system.connections}
    point: list[loop.Row] = []
    initial: list[loop.Row] = []
    for name in system.visits:
        instance = system.instance(name)
        read = [variable.name for kind in range(3) for variable in signals.outputs[name, kind]]
        direct = any((name, i) in fed for output in read for i in instance.fmu.dependencies.get(output, ()))
        rows = [*sets[name], *gets[name]] if direct and not system.parallel else sets[name]
        point += _guarded(rows, instance.step_multiple)
        initial += [*sets[name], *gets[name]]
    return _Program(
        point=point,
        step=step,
        initial=initial,
        outputs=[row for rows in gets.values() for row in rows],
        slots=signals.slots,
        connections=links,
        links=np.array(
            [(signals.slots[c.source], signals.slots[c.target], c.factor, c.offset) for c in links], loop.LINK_TYPE
        ),
        values=signals.values,
        others=signals.others,
        recorded=np.array([signals.slots[end] for end in system.record], dtype=np.uint64),
        references=signals.references,
    )


def _guarded(rows: list[loop.Row], multiple: int) -> list[loop.Row]:
    """Rows that hold only at every ``multiple``-th communication point."""
    if multiple == 1 or not rows:
        return rows
    return [{loop.ACT: loop.GUARD, loop.MULTIPLE: multiple, loop.COUNT: len(rows)}, *rows]


class _Run:
    """One run of a system on loaded instances."""

    def __init__(
        self,
        system: System,
        slaves: list[_Slave],
        program: _Program,
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
        p = self.program
        slots, rows, decimation = record
        arrays = program, split, p.links, p.values, slots, rows, self.clock, self.state
        advance = loop.compiled() or loop_plain.advance
        if not advance(*arrays, end=end, last=last, decimation=decimation, check=check):
            raise self.stopped()

    def stopped(self) -> RunError:
        """Why the loop has stopped."""
        reason, state = int(self.state[loop.REASON]), self.state
        program = self.program
        if reason == loop.NOT_FINITE:
            number = int(state[loop.FAILED_LINK])
            source, _, factor, offset = program.links[number].tolist()
            value = factor * float(program.values[source]) + offset
            return SignalError(program.connections[number], value, time=self.time(), why="not finite")
        if reason == loop.OUT_OF_RANGE:
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
