"""Processes that do runs. An FMU that crashes, exits or hangs then stops one run only, not the sweep, fit or tuning.

A worker is a Python process that keeps the FMUs of a system loaded from run to run. It exchanges data with its owner
through two pipes, so it opens no network port. The owner ends a process that takes too long, and the next call starts a
new process. A worker whose owner is gone ends itself.
"""

from __future__ import annotations

import atexit
import contextlib
import locale
import math
import os
import pickle
import queue
import signal
import subprocess
import sys
import threading
import time as clock_time
import traceback
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Self, TypeVar, cast

from ..errors import CosimError, DescriptionError, FileError, SimulationError
from ..files import reason, temporary_folder, temporary_variables
from ..master.board import Board, mapped
from ..master.child import Channel, high, sent
from ..master.failure import ProcessError, limit_text, process_error
from ..master.interrupts import ENDING
from ..master.process import FmuProcess, shared_memory
from ..master.simulation import Simulation
from ..result.result import Result
from ..system.system import System, make_system

T = TypeVar("T")
Item = TypeVar("Item")
Answer = tuple[str, Any, bool]
"""Kind of the answer, its content, and whether the settings of the process are unchanged."""

POLL_SECONDS = 0.1
"""Time between two checks of the time limit; an answer wakes the owner at once."""

END_SECONDS = 2.0
"""Longest time for a process to end after its pipe has closed. An FMU may close the pipe while the process goes on."""

KILLS = 3
"""A run has failed if its process was killed from outside this many times."""

LONGEST_TIMES, LEAST_SECONDS = 20.0, 10.0
"""The time limit of a run is the longest run so far times the first number, but at least the second number in s.

Run times of a system differ, since parameters change its stiffness, and a loaded machine slows all runs.
"""

UNKNOWN_SECONDS = 3600.0
"""Time limit of loading, and of runs before the first run has ended, if none is given: their time is not known."""


def check_workers(count: int, least: int = 1) -> None:
    """Raise DescriptionError if ``count`` is no number of processes."""
    if count < least:
        unprotected = ", or 0 for this one" if least == 0 else ""
        raise DescriptionError(f"workers: {count} is not a number of processes. Give 1 or more{unprotected}.")


class LoadError(CosimError):
    """The FMUs of a system cannot be loaded, whatever the parameters are."""


class Limit:
    """The time limit of a run: the given one, or one computed from the times of the runs so far."""

    def __init__(self, given: float | None = None, of: str = "a run") -> None:
        self.given = given
        self.of = of
        self.longest = math.nan

    def learn(self, seconds: float) -> None:
        """Take the time of a finished run in s into account."""
        if not seconds <= self.longest:
            self.longest = seconds

    @property
    def seconds(self) -> float:
        """The present limit in s."""
        if self.given is not None:
            return self.given
        if math.isnan(self.longest):
            return UNKNOWN_SECONDS
        return max(LEAST_SECONDS, LONGEST_TIMES * self.longest)

    def __str__(self) -> str:
        text = limit_text(self.seconds, self.of)
        longest = "" if math.isnan(self.longest) else f"the longest so far took {self.longest:.3g} s; "
        return text if self.given is not None else f"{text} ({longest}timeout sets another)"


# ---- in the process that does the runs ----


@dataclass(frozen=True)
class Loadable:
    """A system in plain values, as a worker gets it."""

    document: Mapping[str, Any]
    name: str
    folder: str
    fmus: str | None
    digest: str

    @classmethod
    def of(cls, system: System) -> Loadable:
        """The data from which a worker can read ``system`` again."""
        fmus = None if system.fmus is None else str(Path(system.fmus).resolve())
        return cls(system.document, system.name, str(Path(system.folder).resolve()), fmus, system.digest)

    def system(self) -> System:
        """The system, read again. Raises DescriptionError if it is not the same."""
        system = make_system(self.document, name=self.name, folder=self.folder, fmus=self.fmus)
        if system.digest != self.digest:
            raise DescriptionError(
                f"{self.name}: this worker finds other FMUs or records than its owner. "
                f"Give all machines the same files below {self.folder}."
            )
        return system


KEPT = 4
"""Number of systems that a process keeps loaded: a fit alternates between the systems of its records."""

_loaded: dict[str, Simulation] = {}
"""The simulations that this process keeps from run to run, in the order of their last use."""


def simulation_of(loadable: Loadable) -> Simulation:
    """The simulation of a system in this process; if too many are loaded, the one unused for longest is freed.

    Raises LoadError if the FMUs cannot be loaded.
    """
    found = _loaded.pop(loadable.digest, None)
    if found is not None:
        _loaded[loadable.digest] = found
        return found
    while len(_loaded) >= KEPT:
        _loaded.pop(next(iter(_loaded))).close()
    try:
        _loaded[loadable.digest] = Simulation(loadable.system()).__enter__()
    except DescriptionError:
        raise
    except CosimError as error:
        raise LoadError(f"{loadable.name}: the FMUs cannot be loaded: {error}") from None
    return _loaded[loadable.digest]


def unload() -> None:
    """Free the FMUs that runs in this process have kept loaded."""
    for simulation in _loaded.values():
        simulation.close()
    _loaded.clear()


atexit.register(unload)


def load(loadable: Loadable, *uses: object) -> None:
    """Load the FMUs of a system, and the modules that ``uses`` need, so that this time is no part of the first run."""
    simulation_of(loadable)


def evaluate(loadable: Loadable, changes: Mapping[str, object], judge: Callable[[Result], T]) -> T:
    """The value of ``judge`` for a run of the system with the start values ``changes``. Raises CosimError."""
    simulation = simulation_of(loadable)
    try:
        return judge(simulation.run(simulation.system.changed(changes)))
    except CosimError:
        unload()  # An FMU that failed may be damaged.
        raise


def serve(memory: Path) -> None:
    """The main program of a worker: calls come on standard input, answers go to standard output, FMI calls to a board.

    ``memory`` is the file of the board.
    """
    Board.show(mapped(memory))
    for number in ENDING:
        signal.signal(number, signal.SIG_IGN)
    asked = open(high(0), "rb")  # noqa: SIM115 (open to the end of the process)
    answers = Channel(high(1))
    nothing = os.open(os.devnull, os.O_RDWR)
    for number in (0, 1, 2):
        os.dup2(nothing, number)
    if sys.platform == "linux":
        with contextlib.suppress(OSError):
            # If memory runs out, Linux shall end this worker, not another process.
            Path("/proc/self/oom_score_adj").write_text("1000")
    calls: queue.SimpleQueue[tuple[Callable[..., Any], tuple[Any, ...]]] = queue.SimpleQueue()
    owner = os.getppid()

    def receive() -> None:
        """Receive calls until the owner is gone; then end the process and all its children, even if an FMU hangs."""
        try:
            while True:
                calls.put(pickle.load(asked))
        except EOFError:
            pass
        except (OSError, pickle.UnpicklingError):
            # An FMU has closed this connection. The owner learns it from the answer, or from the end of the answers.
            while os.getppid() == owner:
                clock_time.sleep(POLL_SECONDS)
        if hasattr(os, "killpg"):
            os.killpg(0, signal.SIGKILL)
        os._exit(1)

    threading.Thread(target=receive, daemon=True).start()
    clean = _surroundings()
    while True:
        function, arguments = calls.get()
        try:
            answer = "value", function(*arguments)
        except DescriptionError as error:
            answer = "description", error.problems
        except CosimError as error:
            answer = "load" if isinstance(error, LoadError) else "run", str(error)
        except MemoryError:
            answer = "run", "the memory is used up."
        except BaseException:
            answer = "bug", traceback.format_exc()
        answers.send((*answer, _surroundings() == clean and _is_open(asked)))


def _is_open(file: BinaryIO) -> bool:
    """Whether nobody has closed the file below Python."""
    try:
        os.fstat(file.fileno())
    except OSError:
        return False
    return True


def _surroundings() -> tuple[object, ...]:
    """Settings of the process that an FMU may change: folder, decimal point, rounding mode, subnormal numbers."""
    tiny, third = sys.float_info.min, 3.0
    try:
        folder = os.getcwd()
    except OSError:
        folder = ""
    return folder, locale.localeconv()["decimal_point"], 1.0 / third, -1.0 / third, tiny / third


# ---- on the owner's side ----


_PROGRAM = (
    "import pickle, sys\n"
    "sys.path[:], memory = pickle.load(sys.stdin.buffer.raw)\n"
    "from cosim.design.workers import serve\n"
    "serve(memory)\n"
)


class Worker:
    """Calls functions in another process, one at a time; a context manager."""

    def __init__(self) -> None:
        self._process: FmuProcess | None = None
        self._board: Board | None = None
        self._calls: BinaryIO | None = None
        self._answers: queue.SimpleQueue[Answer | None] = queue.SimpleQueue()
        self._folder = contextlib.ExitStack()
        self._ready = ""
        self._stopped = False
        self._killed = False
        """Whether the last process was killed from outside, perhaps because the memory was used up."""
        self.seconds = 0.0
        """Time of the last call in s, up to its end or its failure."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.stop()

    def evaluate(
        self, loadable: Loadable, changes: Mapping[str, object], judge: Callable[[Result], T], limit: Limit
    ) -> T:
        """``evaluate`` in the worker's process.

        Raises the errors of ``evaluate``, ProcessError for a run that crashes or takes too long, and LoadError.
        """
        return self.run(loadable, evaluate, loadable, changes, judge, limit=limit)

    def run(self, loadable: Loadable, function: Callable[..., Any], *arguments: Any, limit: Limit) -> Any:
        """``call`` after the system is loaded. If the process is killed from outside, the call is repeated.

        Raises the errors of ``call``, and LoadError.
        """
        kills = 0
        while True:
            try:
                self.prepare(loadable, limit.given, *arguments)
                return self.call(function, *arguments, limit=limit)
            except ProcessError as error:
                kills += self._killed
                if not self._killed or kills == KILLS:
                    raise error.of(f"killed {KILLS} times") if self._killed else error from None

    def prepare(self, loadable: Loadable, given: float | None, *uses: object) -> None:
        """Load the system, and the modules that ``uses`` need, in the worker's process. Raises LoadError.

        ``given`` is the time limit of a run in s, if the user gave one. Loading may take longer than a short run.
        """
        if self._ready == loadable.digest and self._process is not None and not self._process.ended():
            return
        try:
            most = UNKNOWN_SECONDS if given is None else max(given, LEAST_SECONDS)
            self.call(load, loadable, *uses, limit=Limit(most, "loading"))
        except ProcessError as error:
            if self._killed:
                raise
            raise LoadError(f"{loadable.name}: loading the FMUs: {error}") from None
        self._ready = loadable.digest

    def call(self, function: Callable[..., Any], *arguments: Any, limit: Limit) -> Any:
        """The value of ``function``, called in the worker's process; it must be a function of a module.

        Raises the CosimError that the function raises, or ProcessError if the process crashes or takes too long.
        """
        process = self._started()
        assert self._calls is not None
        assert self._board is not None
        self._killed, begun = False, clock_time.perf_counter()
        with contextlib.suppress(OSError):
            # If the process is gone, the end of its answers shows it below.
            pickle.dump((function, arguments), self._calls)
            self._calls.flush()
        while True:
            self.seconds = clock_time.perf_counter() - begun
            with contextlib.suppress(queue.Empty):
                answer = self._answers.get(timeout=POLL_SECONDS)
                self.seconds = clock_time.perf_counter() - begun
                if answer is None:
                    raise self._end(process)
                if not answer[-1]:
                    # An FMU has changed settings of the process, which would affect later runs.
                    self.close()
                return _opened(answer)
            if self.seconds > limit.seconds:
                error = process_error(self._board, None, limit=str(limit))
                self.close()
                raise error
            if process.ended():
                # The last answer of the process may still arrive.
                with contextlib.suppress(queue.Empty):
                    if (answer := self._answers.get(timeout=END_SECONDS)) is not None:
                        return _opened(answer)
                raise self._end(process)

    def close(self) -> None:
        """End the process, even in the middle of a call."""
        process, self._process, self._ready = self._process, None, ""
        if process is not None:
            process.kill()
            if self._calls is not None:
                with contextlib.suppress(OSError):
                    self._calls.close()
        self._folder.close()

    def stop(self) -> None:
        """End the process; no call starts it again. Any thread may call this."""
        self._stopped = True
        self.close()

    def _started(self) -> FmuProcess:
        if self._stopped:
            raise SimulationError("the work was ended.")
        if self._process is not None and not self._process.ended():
            return self._process
        self.close()
        folder = self._folder.enter_context(temporary_folder())
        memory, path = self._folder.enter_context(shared_memory(folder, Board.size(), shared_file=True))
        self._board = Board(memoryview(memory))
        pipe = subprocess.PIPE
        try:
            popen = subprocess.Popen(
                [sys.executable, "-c", _PROGRAM],
                stdin=pipe,
                stdout=pipe,
                stderr=subprocess.DEVNULL,
                env=os.environ | temporary_variables(folder),
                # Ctrl-C is for the owner alone.
                process_group=0 if sys.platform != "win32" else None,
                creationflags=subprocess.CREATE_NEW_PROCESS_GROUP if sys.platform == "win32" else 0,
            )
        except OSError as error:
            raise FileError(f"a process for runs cannot be started: {reason(error)}.") from None
        calls, answers = cast(BinaryIO, popen.stdin), cast(BinaryIO, popen.stdout)
        with contextlib.suppress(OSError):
            pickle.dump((sys.path, path), calls)
            calls.flush()
        self._calls, self._answers = calls, queue.SimpleQueue()
        reader = threading.Thread(target=_read, args=(answers, self._answers), daemon=True)
        reader.start()
        self._process = process = FmuProcess(popen.pid, answers, answers, popen)
        if self._stopped:
            # Another thread has called ``stop`` meanwhile.
            self.close()
        return process

    def _end(self, process: FmuProcess) -> ProcessError:
        """The error that says how the process ended."""
        deadline = clock_time.perf_counter() + END_SECONDS
        while not process.ended() and clock_time.perf_counter() < deadline:
            clock_time.sleep(1e-3)
        assert self._board is not None
        self._killed = hasattr(signal, "SIGKILL") and process.code == -signal.SIGKILL
        error = process_error(self._board, process.code)
        self.close()
        return error


def _read(file: BinaryIO, answers: queue.SimpleQueue[Answer | None]) -> None:
    """Put answers where the owner waits for them, and None after the last one."""
    with file:
        for answer in sent(file):
            answers.put(answer)
    answers.put(None)


def _opened(answer: Answer) -> Any:
    kind, content, _ = answer
    if kind == "value":
        return content
    errors = {"description": DescriptionError, "load": LoadError, "run": SimulationError}
    raise errors.get(kind, RuntimeError)(content)


class Workers:
    """A worker for each thread that asks for one."""

    def __init__(self) -> None:
        self._own = threading.local()
        self._all: list[Worker] = []
        self._stopped = False
        self._lock = threading.Lock()

    def mine(self) -> Worker:
        """The worker of this thread."""
        found: Worker | None = getattr(self._own, "worker", None)
        if found is None:
            found = self._own.worker = Worker()
            with self._lock:
                if self._stopped:
                    found.stop()
                self._all.append(found)
        return found

    def stop(self) -> None:
        """End all workers; calls in progress fail, and no call starts a worker again."""
        with self._lock:
            self._stopped = True
            for worker in self._all:
                worker.stop()


class Pool:
    """Threads of this process, each with a worker; a context manager that does not wait for the runs in progress."""

    def __init__(self, count: int) -> None:
        self._threads = ThreadPoolExecutor(count)
        self._workers = Workers()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.stop()

    def stop(self) -> None:
        """End all workers; calls in progress fail."""
        self._threads.shutdown(wait=False, cancel_futures=True)
        self._workers.stop()
        self._threads.shutdown()

    def submit(self, call: Callable[[Worker], T]) -> Future[T]:
        """Have ``call`` done by a thread, with its worker."""
        return self._threads.submit(lambda: call(self._workers.mine()))

    def map(self, call: Callable[[Worker, Item], T], items: Iterable[Item]) -> list[T]:
        """The values of ``call`` for all items, in their order. Raises what the first failed call raises."""

        def with_worker(item: Item) -> T:
            return call(self._workers.mine(), item)

        return list(self._threads.map(with_worker, items))
