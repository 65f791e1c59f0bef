"""The process that runs the FMUs of an isolated run. The watching process is in ``isolation``.

It is forked, or started as a new Python process. A pipe carries its standard output and error to the watching process;
another pipe carries messages and the outcome. Rows and state are in shared memory. Damage that an FMU does to this
process ends with the process.
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
import tempfile
import threading
import time
import traceback
from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from ..errors import CosimError, DescriptionError, FileError
from ..files import reason, temporary_variables
from ..result.result import Result
from ..system.system import System, make_system
from .board import FINISHED, Board, mapped
from .instance import Log, RunError
from .interrupts import ENDING, Presses
from .loading import loaded
from .program import make_program
from .run import Interrupted, Run

HIGH = 400
"""Lowest file number of the pipes. Some FMUs close all low file numbers; they do not reach this one."""

MAX_ITEM = 2**32
"""Largest size of an item in bytes. A larger number means that the pipe holds something else."""

THREAD_SECONDS = 0.1
"""Time that the process waits for threads that an FMU has left running, in case they crash."""


@dataclass(frozen=True)
class Assignment:
    """The task of the process."""

    folder: Path
    """The folder for FMUs that are unpacked, and for all temporary files of the process."""
    debug: bool
    keep_going: bool
    columns: int
    capacity: int
    windows: int


@dataclass(frozen=True)
class Ending:
    """How a run ended: with ``solver`` counters, or with an error (its class, arguments and attributes)."""

    seconds: float
    dropped_messages: int
    solver: Mapping[str, Mapping[str, float]]
    stopped: bool = False
    ended: bool = False
    """Whether an FMU asked for the end. The run is then complete."""
    error: tuple[type[CosimError], tuple[Any, ...], dict[str, Any]] | None = None
    bug: str = ""
    """The traceback of an unexpected exception."""


class Channel:
    """Sends messages and the outcome to the watching process, as pickles; the length of each is sent before it."""

    def __init__(self, number: int) -> None:
        self._number = number
        self._lock = threading.Lock()

    def send(self, item: object) -> None:
        """Write all of ``item``. Does nothing if the pipe is closed: by an FMU, or because the other side has ended."""
        content = pickle.dumps(item)
        view = memoryview(len(content).to_bytes(8, "little") + content)
        with self._lock, contextlib.suppress(OSError):
            while view:
                view = view[os.write(self._number, view) :]


def sent(file: BinaryIO) -> Generator[Any]:
    """What a ``Channel`` has sent, up to the end of the pipe, which may come in the middle of an item.

    An FMU may write into the pipe. Nothing that comes after can then be read.
    """
    with contextlib.suppress(Exception):  # Reading damaged items raises exceptions of many classes.
        while header := file.read(8):
            length = int.from_bytes(header, "little")
            content = file.read(length) if length <= MAX_ITEM else b""
            if len(content) < length:
                return
            yield pickle.loads(content)


def serve(system: System | Callable[[], System], job: Assignment, memory: mmap.mmap, channel: Channel) -> None:
    """Run ``system`` and send the outcome. Does not return."""
    code = 1
    try:
        _quiet()
        os.environ.update(temporary_variables(job.folder))
        tempfile.tempdir = str(job.folder)
        board = Board.show(memory, job.columns, job.capacity, job.windows)
        threads = _threads()
        Log.sink = channel.send
        _run(system, job, channel)
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
        # This process was forked. No exit handler of its parent may run here.
        os._exit(code)


def _run(system: System | Callable[[], System], job: Assignment, channel: Channel) -> None:
    """Load the FMUs, run, and free them. The outcome is sent before they are freed, because freeing may crash."""
    try:
        if not isinstance(system, System):
            system = system()
        with loaded(system, debug=job.debug, folder=job.folder) as instances:
            program = make_program(system, instances)
            channel.send(_outcome(Run(system, instances, program, check=not job.keep_going)))
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
    """Ignore signals, and send printed text to the pipes.

    Only the watching process ends this process, and only its standard output is the standard output of the command.
    """
    for number in ENDING:
        signal.signal(number, signal.SIG_IGN)
    faulthandler.disable()
    # After a fork, both processes share memory. Garbage collection of the older objects would copy it.
    gc.freeze()
    sys.stdin = io.StringIO()
    # Python FMUs print to these.
    sys.stdout = open(1, "w", buffering=1, encoding="utf-8", errors="replace", closefd=False)  # noqa: SIM115
    sys.stderr = open(2, "w", buffering=1, encoding="utf-8", errors="replace", closefd=False)  # noqa: SIM115
    if sys.platform == "linux":
        with contextlib.suppress(OSError, AttributeError):
            # 1 is PR_SET_PDEATHSIG: if the watching process is killed, this process is killed, too.
            ctypes.CDLL(None).prctl(1, signal.SIGKILL)
        with contextlib.suppress(OSError, AttributeError):
            # If an FMU calls exit, the process ends at once. Without this, exit handlers of libraries of the parent
            # process would run; they could wait for ever for threads that a fork does not copy. The handler that is
            # registered last runs first.
            library = ctypes.CDLL(None)
            library.on_exit(library._exit, None)
        with contextlib.suppress(OSError):
            # If an FMU takes all memory, the system should kill this process and no other.
            Path("/proc/self/oom_score_adj").write_text("1000")


def _threads() -> int:
    """Number of threads of this process, including threads unknown to Python; 0 on systems without /proc."""
    try:
        return len(os.listdir("/proc/self/task"))
    except OSError:
        return 0


def high(number: int) -> int:
    """A copy of an open file with a high file number. Programs started by this process do not inherit it."""
    if sys.platform == "win32":
        return os.dup(number)
    import fcntl

    try:
        return fcntl.fcntl(number, fcntl.F_DUPFD_CLOEXEC, HIGH)
    except OSError:
        # The limit of open files is lower than HIGH.
        return fcntl.fcntl(number, fcntl.F_DUPFD_CLOEXEC, 3)


def started() -> None:
    """The main program of a new process (not a fork). It reads its job from standard input."""
    channel = Channel(high(1))
    os.dup2(2, 1)
    given = pickle.load(sys.stdin.buffer)
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.close(nothing)
    arguments: tuple[Mapping[str, Any], str, Path, Path | None] = given["system"]
    job: Assignment = given["job"]
    memory = mapped(given["memory"])
    if hasattr(os, "setpgid"):
        os.setpgid(0, 0)

    def system() -> System:
        document, name, folder, fmus = arguments
        made = make_system(document, name=name, folder=folder, fmus=fmus)
        if made.digest != given["digest"]:
            raise DescriptionError(f"{name}: an FMU or a record changed after it was read. Read the system again.")
        return made

    serve(system, job, memory, channel)
