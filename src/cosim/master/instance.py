"""One FMU instance on FMPy: checks the status of its calls and keeps its messages."""

from __future__ import annotations

import contextlib
import ctypes
import itertools
import logging
import math
import os
import threading
from collections import Counter
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, ClassVar, cast

from ..errors import SimulationError
from ..files import forbidden_library
from ..fmu.description import Fmu
from ..fmu.variables import Variable
from ..result.result import Message, Result
from ..system.parts import Instance
from . import loop
from .board import Board

fmpy: Any = import_module("fmpy")

fmi1: Any = import_module("fmpy.fmi1")

fmi2: Any = import_module("fmpy.fmi2")

fmi_logging: Any = import_module("fmpy.logging")

STATUS = ("OK", "Warning", "Discard", "Error", "Fatal", "Pending")
"""Names of the values of fmi2Status, in their order."""

FATAL = 4
"""Value of fmi2Status after which no function of an instance may be called."""

TERMINATED, LAST_SUCCESSFUL_TIME = 3, 2
"""Values of fmi2StatusKind for fmi2GetBooleanStatus and fmi2GetRealStatus."""

MAX_MESSAGES = 10_000
"""Largest number of messages kept for each instance and status in a run.

The limit holds for each status alone, so that many OK messages cannot displace a warning.
"""

MAX_TEXT = 10_000
"""Largest number of characters kept of a message. A longer text is a dump of data, which nobody reads."""


class RunError(SimulationError):
    """A run ended early, at ``time`` in s. ``result`` holds the rows computed so far."""

    def __init__(self, text: str, *, time: float, message: str = "") -> None:
        self.time = time
        self.message = message
        self.result: Result | None = None
        super().__init__(text)


class CallError(RunError):
    """An FMI call failed. The text names instance, function, time in s, status and the last message of the FMU."""

    def __init__(
        self, instance: str, function: str, *, time: float, status: str, message: str, remedy: str = ""
    ) -> None:
        self.instance = instance
        self.function = function
        self.status = status
        said = f" The FMU said: {message}" if message else " The FMU gave no message."
        known = not status.lstrip("-").isdecimal()
        returned = f"{function[:4]}{status}" if known else f"status {status}, which FMI does not know"
        text = f"{instance}: {function} at {time:.9g} s returned {returned}.{said}{remedy}"
        super().__init__(text, time=time, message=message)


LEVELS = {"OK": logging.INFO, "Warning": logging.WARNING, "Discard": logging.WARNING}
"""Level in Python's logging for each status; all other statuses have the level ERROR."""


def log_message(message: Message) -> None:
    """Send a message of an FMU to Python's logger ``cosim.fmu``."""
    logging.getLogger("cosim.fmu").log(LEVELS.get(message.status, logging.ERROR), "%s", message)


class Log:
    """The messages of one instance. The FMU passes the log's number as its component environment."""

    _numbers: ClassVar = itertools.count(1)
    _open: ClassVar[dict[int, Log]] = {}

    sink: ClassVar[Callable[[Message], None]] = staticmethod(log_message)
    """Called with every message that is kept, as soon as it arrives."""

    def __init__(self, instance: str) -> None:
        self.instance = instance
        self.number = next(self._numbers)
        self._open[self.number] = self
        self.begin(lambda: 0.0)

    def begin(self, clock: Callable[[], float]) -> None:
        """Forget all messages. Later messages get their time from ``clock``, in s."""
        self.clock = clock
        self.messages: list[Message] = []
        self.dropped = 0
        self.last = ""
        self._counts: Counter[str] = Counter()

    def close(self) -> None:
        self._open.pop(self.number, None)

    def add(self, status: int, category: str, text: str) -> None:
        said = STATUS[status] if 0 <= status < len(STATUS) else str(status)
        if len(text) > MAX_TEXT:
            text = f"{text[:MAX_TEXT]} ... ({len(text)} characters)"
        if status > 0:
            self.last = text
        self._counts[said] += 1
        if self._counts[said] <= MAX_MESSAGES:
            message = Message(self.instance, self.clock(), said, category, text)
            self.messages.append(message)
            Log.sink(message)
        else:
            self.dropped += 1

    @classmethod
    def receive(cls, environment: int | None, name: bytes, status: int, category: bytes, message: bytes) -> None:
        """The logger callback of FMUs. They also call it while the loop runs."""
        log = cls._open.get(environment or 0)
        if log is None:
            # FMPy has one logger for the whole process. Other code has loaded this FMU.
            fmi1.printLogMessage(environment, name, status, category, message)
        else:
            log.add(status, (category or b"").decode("utf-8", "replace"), (message or b"").decode("utf-8", "replace"))


_receive = fmi2.fmi2CallbackLoggerTYPE(Log.receive)


def _callbacks(environment: int) -> Any:
    callbacks = fmi2.fmi2CallbackFunctions()
    callbacks.logger = _receive
    callbacks.allocateMemory = fmi2.defaultCallbacks.allocateMemory
    callbacks.freeMemory = fmi2.defaultCallbacks.freeMemory
    callbacks.componentEnvironment = environment
    # The proxy formats the variable arguments of a message in C. FMPy passes all messages to the logger that was added
    # last. Therefore it is added again for every instance.
    fmi_logging.addLoggerProxy(ctypes.byref(callbacks))
    return callbacks


OPTIONAL = (
    *("fmi2GetFMUstate", "fmi2SetFMUstate", "fmi2FreeFMUstate", "fmi2SerializedFMUstateSize"),
    *("fmi2SerializeFMUstate", "fmi2DeSerializeFMUstate", "fmi2GetDirectionalDerivative"),
    *("fmi2SetRealInputDerivatives", "fmi2GetRealOutputDerivatives", "fmi2CancelStep"),
)
"""Functions that an importer calls only if the FMU says that it has the capability. Some FMUs leave them out."""


class _Library:
    """A loaded library. For a function of ``OPTIONAL`` that it lacks, it has one that raises SimulationError."""

    def __init__(self, library: Any, instance: str) -> None:
        self._library = library
        self._instance = instance

    def __getattr__(self, name: str) -> Any:
        try:
            return getattr(self._library, name)
        except AttributeError:
            if name in OPTIONAL:
                return _Missing(f"{self._instance}: the library has no {name}.")
            raise


class _Missing:
    """A function that a library lacks."""

    def __init__(self, problem: str) -> None:
        self._problem = problem

    def __call__(self, *_: object) -> None:
        raise SimulationError(self._problem)


class FMU2Tolerant(fmi2.FMU2Slave):
    """FMPy's FMU2Slave for libraries without functions of ``OPTIONAL``. FMPy needs a name that begins with FMU2."""

    @property
    def dll(self) -> _Library:
        """The library. FMPy sets it after loading, and then looks up all functions."""
        return self._tolerant

    @dll.setter
    def dll(self, library: Any) -> None:
        self._tolerant = _Library(library, self.instanceName)


_LOADING = threading.Lock()
"""Held while FMPy loads a library, because FMPy then changes the working directory of the process."""


class FmuInstance:
    """An instance of an FMU of FMI 2.0, on FMPy's FMU2Slave. Checks the status of its calls and keeps its messages."""

    prefix = "fmi2"
    """The beginning of the names of its FMI functions."""
    types: ClassVar[Mapping[str, int]] = loop.FMI2_TYPES
    """The loop's number of each type, by the name of the type in the FMI functions."""
    _state = "FMUstate"

    def __init__(self, number: int, instance: Instance, folder: Path, library: Path, *, debug: bool) -> None:
        self.number = number
        self.name = instance.name
        self.fmu: Fmu = instance.fmu
        self.log = Log(instance.name)
        self.fatal = False
        self._folder = folder
        self._library = library
        self._debug = debug
        self._slave: Any = None

    # Life

    def load(self) -> None:
        """Load the library and create the instance. Raises SimulationError."""
        with _LOADING, _working_folder(self._folder), self._calling("loading the library"):
            try:
                self._slave = self._bind()
            except Exception as error:
                # FMPy raises bare exceptions for a library that does not load or lacks a function.
                text = str(error).replace(str(self._folder), self.fmu.path.name)
                text += forbidden_library(text)
                raise SimulationError(f"{self.name}: the library of {self.fmu.name} cannot be used: {text}") from None
        function = self._instantiating
        try:
            with self._calling(function):
                self._instantiate()
        except Exception:
            self._slave.freeLibrary()
            self._slave = None
            raise CallError(self.name, function, time=0.0, status="Error", message=self.log.last) from None
        if not self._debug:
            self._log_less()

    _instantiating = "fmi2Instantiate"

    def _bind(self) -> Any:
        """FMPy's object for the loaded library."""
        return FMU2Tolerant(
            guid=self.fmu.guid,
            modelIdentifier=self.fmu.identifier,
            unzipDirectory=str(self._folder),
            instanceName=self.name,
            libraryPath=str(self._library),
        )

    def _instantiate(self) -> None:
        self._slave.instantiate(callbacks=_callbacks(self.log.number), loggingOn=True)

    def _log_less(self) -> None:
        """Let the FMU log only warnings and errors.

        Logging is not part of the model. If the FMU cannot choose what it logs, the run goes on.
        """
        categories = [category.encode() for category in self.fmu.log_categories if category.startswith("logStatus")]
        if not categories:
            return
        try:
            self.call(
                f"{self.prefix}SetDebugLogging", True, len(categories), (ctypes.c_char_p * len(categories))(*categories)
            )
        except CallError as error:
            if self.fatal:
                raise
            said = f"SetDebugLogging returned {error.status}. The run goes on, with all that the FMU logs."
            self.log.add(1, "logging", said)

    @property
    def component(self) -> int:
        return int(self._slave.component)

    def address(self, function: str) -> int:
        """The address of an FMI function in the loaded library."""
        return cast(int, ctypes.cast(getattr(self._slave.dll, function), ctypes.c_void_p).value)

    def call(self, function: str, *arguments: Any) -> Any:
        """Call an FMI function on this instance; raises CallError for a status other than OK and Warning."""
        if self._slave is None or self.fatal:
            raise SimulationError(f"{self.name}: no call of {function} any more: the instance has ended.")
        try:
            with self._calling(function):
                return getattr(self._slave, function)(self._slave.component, *arguments)
        except fmi1.FMICallException as error:
            raise self.failed(function, int(error.status)) from None

    def failed(self, function: str, status: int) -> CallError:
        """The error for a status that ``function`` returned."""
        self.fatal = self.fatal or status == FATAL
        name = STATUS[status] if 0 <= status < len(STATUS) else str(status)
        remedy = " Asynchronous FMUs are not supported." if name == "Pending" else ""
        return CallError(self.name, function, time=self.log.clock(), status=name, message=self.log.last, remedy=remedy)

    def enter_initialization(self, start: float, stop: float, tolerance: float) -> None:
        """Set start and stop time in s and the tolerance (0: none), and enter initialization mode. Raises CallError."""
        self.call("fmi2SetupExperiment", tolerance > 0.0, tolerance, start, True, stop)
        self.call("fmi2EnterInitializationMode")

    def exit_initialization(self) -> None:
        self.call(f"{self.prefix}ExitInitializationMode")

    def terminate(self) -> None:
        self.call(f"{self.prefix}Terminate")

    def reset(self) -> None:
        self.call(f"{self.prefix}Reset")

    def terminated_at(self) -> float | None:
        """The last time in s that the FMU reached, if it asked to end the simulation; else None.

        Called after fmi2DoStep has returned Discard.
        """
        with contextlib.suppress(CallError):
            ended, time = ctypes.c_int(), ctypes.c_double(-math.inf)
            self.call("fmi2GetBooleanStatus", TERMINATED, ctypes.byref(ended))
            if ended:
                with contextlib.suppress(CallError):
                    self.call("fmi2GetRealStatus", LAST_SUCCESSFUL_TIME, ctypes.byref(time))
                return time.value
        return None

    def free(self) -> None:
        """Free the instance and its library, except after the status Fatal."""
        if self._slave is not None and not self.fatal:
            with self._calling(f"{self.prefix}FreeInstance"):
                self._slave.freeInstance()
        self._slave = None
        self.log.close()

    # Values

    def set(self, variable: Variable, value: Any) -> None:
        """Set one variable."""
        self.set_all({variable.name: value})

    def set_all(self, values: Mapping[str, Any]) -> None:
        """Set variables by name, with one call for each type. Raises CallError."""
        for kind, group in self._grouped(values).items():
            references = value_references(group)
            self.call(f"fmi2Set{kind}", references, len(group), self._buffer(kind, [values[v.name] for v in group]))

    def get(self, variable: Variable) -> float:
        """Read one numeric variable."""
        buffer = self._buffer(variable.passed_as, [0])
        self.call(f"fmi2Get{variable.passed_as}", value_references([variable]), 1, buffer)
        return float(buffer[0])

    def get_all(self, names: Iterable[str]) -> dict[str, float]:
        """Read numeric variables by name, with one call for each type. Raises CallError."""
        found: dict[str, float] = {}
        for kind, group in self._grouped(names).items():
            buffer = self._buffer(kind, [0] * len(group))
            self.call(f"fmi2Get{kind}", value_references(group), len(group), buffer)
            found.update(zip((variable.name for variable in group), map(float, buffer), strict=True))
        return found

    def keep(self, start: Mapping[str, Any]) -> None:
        """Set start values again if the FMU lost them. Some FMUs return to their own values at initialization."""
        variables = self.fmu.variables
        given = {
            name: float(value)
            for name, value in start.items()
            if not isinstance(value, str)
            and (variables[name].initial == "exact" or variables[name].causality == "input")
        }
        try:
            found = self.get_all(given)
        except CallError:
            if self.fatal:
                raise
            return  # the FMU does not give its values in this mode, so nothing can be compared
        lost = [name for name, value in given.items() if found[name] != value]
        if lost:
            self.set_all({name: start[name] for name in lost})

    def derivatives(self, unknowns: Sequence[Variable], known: Variable) -> Sequence[float]:
        """Partial derivatives of ``unknowns`` by ``known`` in the current state of the instance. Raises CallError."""
        found, seed = (ctypes.c_double * len(unknowns))(), (ctypes.c_double * 1)(1.0)
        rows, column = value_references(unknowns), value_references([known])
        self.call("fmi2GetDirectionalDerivative", rows, len(unknowns), column, 1, seed, found)
        return list(found)

    def _grouped(self, names: Iterable[str]) -> dict[str, list[Variable]]:
        """Variables grouped by the type in the names of the FMI functions."""
        groups: dict[str, list[Variable]] = {}
        for name in names:
            variable = self.fmu.variables[name]
            groups.setdefault(variable.passed_as, []).append(variable)
        return groups

    def _buffer(self, kind: str, values: Sequence[Any]) -> Any:
        """Values of the type ``kind`` as a ctypes array."""
        if kind == "String":
            return (ctypes.c_char_p * len(values))(*(value.encode() for value in values))
        return (loop.TYPES[self.types[kind]][1] * len(values))(*values)

    # State

    def save(self) -> Any:
        """Save the FMU's state for ``restore``. Raises CallError."""
        state = ctypes.c_void_p()
        self.call(f"{self.prefix}Get{self._state}", ctypes.byref(state))
        return state

    def restore(self, state: Any) -> None:
        """Go back to a saved state. Raises CallError."""
        self.call(f"{self.prefix}Set{self._state}", state)

    def forget(self, state: Any) -> None:
        """Free a saved state."""
        if self._slave is not None and not self.fatal and state.value is not None:
            self.call(f"{self.prefix}Free{self._state}", ctypes.byref(state))

    def _calling(self, function: str) -> contextlib.AbstractContextManager[None]:
        return contextlib.nullcontext() if Board.here is None else Board.here.call(self.name, function)


@contextlib.contextmanager
def _working_folder(folder: Path) -> Generator[None]:
    """Return to the present working folder at the end. If it has been deleted, ``folder`` takes its place."""
    try:
        place = os.getcwd()
    except FileNotFoundError:
        os.chdir(folder)
        place = str(folder)
    try:
        yield
    finally:
        os.chdir(place)


def value_references(variables: Sequence[Variable]) -> Any:
    """Value references of variables as a ctypes array."""
    return (ctypes.c_uint * len(variables))(*(variable.reference for variable in variables))
