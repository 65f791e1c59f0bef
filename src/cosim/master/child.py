"""The process that runs the FMUs of an isolated run; ``isolation`` is its other side.

It is forked or started anew. Its standard output and error go through a pipe to the watching process, as do messages
and what came out; rows and state lie in shared memory. Whatever an FMU does to the process ends with it.
"""

from __future__ import annotations

import contextlib
import ctypes
import faulthandler
import gc
import io
import mmap
import os
import pickle
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import CosimError, DescriptionError, FileError
from ..files import reason
from ..result.result import Result
from ..system.system import System, make_system
from .board import FINISHED, Board
from .instance import Log, RunError
from .loading import loaded
from .program import make_program
from .run import Interrupted, Run
from .signals import ENDING, Presses

HIGH = 400
"""File numbers of the pipes: higher than those that an FMU closes which closes all it can think of."""

THREAD_SECONDS = 0.1
"""How long the process waits for threads that an FMU has left running, to see whether they crash."""


@dataclass(frozen=True)
class Assignment:
    """What the process is to do."""

    folder: Path
    """Where FMUs are unpacked."""
    debug: bool
    keep_going: bool
    columns: int
    capacity: int
    windows: int


@dataclass(frozen=True)
class Ending:
    """How a run ended: with ``solver`` counters, or with an error, of which class, text and attributes travel."""

    seconds: float
    dropped_messages: int
    solver: Mapping[str, Mapping[str, float]]
    stopped: bool = False
    ended: bool = False
    """Whether an FMU asked for the end, which makes it a whole run."""
    error: tuple[type[CosimError], tuple[Any, ...], dict[str, Any]] | None = None
    bug: str = ""
    """The traceback of an exception that nobody expected."""


class Channel:
    """The way of messages and outcome to the watching process: pickles, each after its length."""

    def __init__(self, number: int) -> None:
        self._number = number
        self._lock = threading.Lock()

    def send(self, item: object) -> None:
        """Write ``item`` whole; nothing if the pipe is gone, closed by an FMU or by the end of the other side."""
        content = pickle.dumps(item)
        view = memoryview(len(content).to_bytes(8, "little") + content)
        with self._lock, contextlib.suppress(OSError):
            while view:
                view = view[os.write(self._number, view) :]


def serve(system: System | Callable[[], System], job: Assignment, memory: mmap.mmap, channel: Channel) -> None:
    """Run ``system`` and tell what came out. Does not return."""
    code = 1
    try:
        _quiet()
        board = Board(memoryview(memory), job.columns, job.capacity, job.windows)
        threads = _threads()
        Log.sink = channel.send
        _run(system, job, board, channel)
        if _threads() > threads:
            time.sleep(THREAD_SECONDS)
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError, ValueError):
                stream.flush()
        board.flags[FINISHED] = 1
        code = 0
    except BaseException:
        channel.send(Ending(0.0, 0, {}, bug=traceback.format_exc()))
    finally:
        # No handler of the process from which this one was forked may run here.
        os._exit(code)


def _run(system: System | Callable[[], System], job: Assignment, board: Board, channel: Channel) -> None:
    """Run from loading to freeing; what came out is sent before the FMUs are freed, which may go wrong, too."""
    try:
        if not isinstance(system, System):
            system = system()
        with loaded(system, debug=job.debug, folder=job.folder, board=board) as instances:
            program = make_program(system, instances)
            channel.send(_outcome(Run(system, instances, program, board=board, check=not job.keep_going)))
    except CosimError as error:
        channel.send(Ending(0.0, 0, {}, error=(type(error), error.args, vars(error))))
    except OSError as error:
        text = f"{error.filename or job.folder}: {reason(error)}."
        channel.send(Ending(0.0, 0, {}, error=(FileError, (text,), {})))


def _outcome(run: Run) -> Ending:
    """How the run ends. The rows are in shared memory, the messages have been sent."""
    try:
        result = run.run(None, Presses())
        return Ending(_seconds(result), result.dropped_messages, result.solver, ended=run.ended)
    except Interrupted as interruption:
        result = interruption.result
        return Ending(_seconds(result), result.dropped_messages, result.solver, stopped=True)
    except RunError as error:
        result, error.result = error.result, None
        dropped = 0 if result is None else result.dropped_messages
        return Ending(_seconds(result), dropped, {}, error=(type(error), error.args, vars(error)))


def _seconds(result: Result | None) -> float:
    return 0.0 if result is None else float(result.metadata["stepping_seconds"])


def _quiet() -> None:
    """Only the watching process ends this one, and only its standard output is that of the command."""
    for number in ENDING:
        signal.signal(number, signal.SIG_IGN)
    faulthandler.disable()
    # Collecting garbage among the objects from before a fork would copy the memory that both processes share.
    gc.freeze()
    sys.stdin = io.StringIO()
    # Python FMUs print to these.
    sys.stdout = open(1, "w", buffering=1, encoding="utf-8", errors="replace", closefd=False)  # noqa: SIM115
    sys.stderr = open(2, "w", buffering=1, encoding="utf-8", errors="replace", closefd=False)  # noqa: SIM115
    if sys.platform == "linux":
        with contextlib.suppress(OSError, AttributeError):
            # 1: PR_SET_PDEATHSIG. If the watching process is killed, this one goes, too.
            ctypes.CDLL(None).prctl(1, signal.SIGKILL)
        with contextlib.suppress(OSError, AttributeError):
            # An FMU that calls exit ends here at once: what libraries of the process from which this one was forked do
            # at their end (join threads that are not here) could wait for ever. Handlers run last come, first served.
            library = ctypes.CDLL(None)
            library.on_exit(library._exit, None)
        with contextlib.suppress(OSError):
            # An FMU that takes all memory is to be ended, not another process.
            Path("/proc/self/oom_score_adj").write_text("1000")


def _threads() -> int:
    """Threads of this process, also those that Python does not know; 0 where that cannot be told."""
    try:
        return len(os.listdir("/proc/self/task"))
    except OSError:
        return 0


def high(number: int) -> int:
    """A copy of an open file with a high number, not inherited by programs that are started."""
    if sys.platform == "win32":
        return os.dup(number)
    import fcntl

    try:
        return fcntl.fcntl(number, fcntl.F_DUPFD_CLOEXEC, HIGH)
    except OSError:
        # Fewer files than that are allowed here.
        return fcntl.fcntl(number, fcntl.F_DUPFD_CLOEXEC, 3)


def started() -> None:
    """The main program of a process that was started anew: the job comes in on standard input."""
    channel = Channel(high(1))
    os.dup2(2, 1)
    given = pickle.load(sys.stdin.buffer)
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.close(nothing)
    arguments: tuple[Mapping[str, Any], str, Path, Path | None] = given["system"]
    job: Assignment = given["job"]
    with open(given["memory"], "r+b") as file:
        memory = mmap.mmap(file.fileno(), 0)
    if hasattr(os, "setpgid"):
        os.setpgid(0, 0)

    def system() -> System:
        document, name, folder, fmus = arguments
        made = make_system(document, name=name, folder=folder, fmus=fmus)
        if made.digest != given["digest"]:
            raise DescriptionError(f"{name}: an FMU or a record changed after it was read. Read the system again.")
        return made

    serve(system, job, memory, channel)
