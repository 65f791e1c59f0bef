"""Starts and ends the process of the FMUs, and tells whether it has ended. Used by the watching process."""

from __future__ import annotations

import contextlib
import mmap
import os
import pickle
import select
import signal
import subprocess
import sys
import threading
import warnings
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import BinaryIO

from ..errors import FileError
from ..files import cannot_write
from ..system.system import System
from . import child
from .child import Assignment, Channel

HANG_UP_MILLISECONDS = 50
"""Longest time until the pipes of killed processes have closed."""


class FmuProcess:
    """The process of the FMUs. It has its own process group, on systems with process groups."""

    def __init__(
        self, number: int, channel: BinaryIO, printed: BinaryIO, popen: subprocess.Popen[bytes] | None
    ) -> None:
        self.channel = channel
        self.printed = printed
        self.code: int | None = None
        """The exit code of the ended process: negative for a signal; None while the process runs."""
        self._number = number
        self._popen = popen

    def ended(self) -> bool:
        """Whether the process has ended. If so, all processes that it has started are killed."""
        if self.code is not None:
            return True
        if self._popen is not None and sys.platform == "win32":
            self.code = self._popen.poll()
            return self.code is not None
        if hasattr(os, "waitid"):
            # WNOWAIT leaves the process in the process table. So no other process can get its number before the group
            # is killed.
            if os.waitid(os.P_PID, self._number, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None:
                return False
            self._end_group()
            self._reap(0)
            self._end_holders()
            return True
        if self._reap(os.WNOHANG):
            self._end_group()
            self._end_holders()
        return self.code is not None

    def kill(self) -> None:
        """Kill the process and all processes that it has started, and wait for its end."""
        if self.code is not None:
            return
        if self._popen is not None and sys.platform == "win32":
            self._popen.kill()
            self.code = self._popen.wait()
            return
        self._end_group()
        with contextlib.suppress(ProcessLookupError):
            os.kill(self._number, signal.SIGKILL)
        self._reap(0)
        self._end_holders()

    def _reap(self, options: int) -> bool:
        try:
            number, status = os.waitpid(self._number, options)
        except ChildProcessError:
            # Other code in this process has waited for all children.
            number, status = self._number, 0
        if number == 0:
            return False
        self.code = os.waitstatus_to_exitcode(status)
        if self._popen is not None:
            self._popen.returncode = self.code
        return True

    def _end_group(self) -> None:
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self._number, signal.SIGKILL)

    def _end_holders(self) -> None:
        """Kill processes that an FMU has started in a group of their own: they still hold the pipes for writing."""
        if sys.platform != "linux":
            return
        for file in (self.channel, self.printed):
            if file.closed:
                continue
            ended = select.poll()
            ended.register(file, 0)
            if not ended.poll(HANG_UP_MILLISECONDS):
                for number in _writers(os.fstat(file.fileno())):
                    with contextlib.suppress(ProcessLookupError, PermissionError):
                        os.kill(number, signal.SIGKILL)


def _writers(pipe: os.stat_result) -> Iterator[int]:
    """The numbers of the other processes that have ``pipe`` open for writing. Linux only."""
    for place in Path("/proc").glob("[0-9]*/fd/*"):
        with contextlib.suppress(OSError, ValueError):
            process = int(place.parts[2])
            if process != os.getpid() and os.path.samestat(place.stat(), pipe):
                # Processes that were forked from this one may hold its end, which is for reading.
                flags = Path(f"/proc/{process}/fdinfo/{place.name}").read_text().split("flags:")[1].split()[0]
                if int(flags, 8) & os.O_ACCMODE == os.O_WRONLY:
                    yield process


def may_fork() -> bool:
    """Whether forking is safe: only on Linux, and only without other threads.

    A fork does not copy other threads. A lock that such a thread holds would stay locked for ever. macOS can fork, but
    its system libraries do not support it.
    """
    alone = threading.active_count() == 1 and threading.current_thread() is threading.main_thread()
    return sys.platform == "linux" and alone


@contextlib.contextmanager
def shared_memory(folder: Path, size: int, *, shared_file: bool) -> Generator[tuple[mmap.mmap, Path]]:
    """Memory of ``size`` bytes that both processes share, and the path of its file.

    A forked process needs no file; a new process needs ``shared_file``, a file in ``folder``. Raises FileError.
    """
    path = folder / "memory"
    if not shared_file:
        yield mmap.mmap(-1, size), path
        return
    try:
        with path.open("w+b") as file:
            if hasattr(os, "posix_fallocate"):
                os.posix_fallocate(file.fileno(), 0, size)
            file.truncate(size)
            memory = mmap.mmap(file.fileno(), size)
    except OSError as error:
        raise cannot_write(path, error) from None
    yield memory, path


def fork_process(system: System, job: Assignment, memory: mmap.mmap) -> FmuProcess:
    """Do ``job`` in a fork of this process. Libraries that are loaded here need not be loaded again."""
    channel, channel_end = os.pipe()
    printed, printed_end = os.pipe()
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError, AttributeError):
            stream.flush()
    with warnings.catch_warnings():
        # Python warns of idle threads of libraries such as Arrow. The child does not use these libraries.
        warnings.simplefilter("ignore", DeprecationWarning)
        number = os.fork()
    if number == 0:
        try:
            os.setpgid(0, 0)
            kept, nothing = child.high(channel_end), child.high(os.open(os.devnull, os.O_RDONLY))
            printing = child.high(printed_end)
            os.dup2(nothing, 0)
            os.dup2(printing, 1)
            os.dup2(printing, 2)
            for other in (channel, channel_end, printed, printed_end, nothing, printing):
                if other > 2:
                    os.close(other)
            child.serve(system, job, memory, Channel(kept))
        finally:
            os._exit(1)
    with contextlib.suppress(PermissionError, ProcessLookupError):
        # Both processes set the group. So it exists from now on, whichever of them is first.
        os.setpgid(number, number)
    os.close(channel_end)
    os.close(printed_end)
    return FmuProcess(number, open(channel, "rb"), open(printed, "rb", buffering=0), None)


_PROGRAM = (
    "import pickle, sys\n"
    "sys.path[:] = pickle.load(sys.stdin.buffer)\n"
    "from cosim.master.child import started\n"
    "started()\n"
)


def start_process(system: System, job: Assignment, memory: Path) -> FmuProcess:
    """Do ``job`` in a new Python process; ``memory`` is the file of the shared memory.

    Raises FileError if the process cannot be started.
    """
    given = {
        "system": (system.document, system.name, system.folder.resolve(), system.fmus and system.fmus.resolve()),
        "digest": system.digest,
        "job": job,
        "memory": memory,
    }
    pipe = subprocess.PIPE
    flags = subprocess.CREATE_NEW_PROCESS_GROUP if sys.platform == "win32" else 0
    try:
        popen = subprocess.Popen(
            [sys.executable, "-c", _PROGRAM], stdin=pipe, stdout=pipe, stderr=pipe, bufsize=-1, creationflags=flags
        )
    except OSError as error:
        raise FileError(f"{sys.executable}: cannot be started: {error.strerror}.") from None
    assert popen.stdin is not None
    assert popen.stdout is not None
    assert popen.stderr is not None
    with contextlib.suppress(BrokenPipeError), popen.stdin as stdin:
        pickle.dump(sys.path, stdin)
        pickle.dump(given, stdin)
    return FmuProcess(popen.pid, popen.stdout, popen.stderr, popen)  # pyright: ignore[reportArgumentType]
