"""Shared memory in which a process that runs FMUs shows its calls, progress and rows to the watching process."""

from __future__ import annotations

import contextlib
import mmap
import os
import sys
import time
from collections.abc import Generator
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from . import loop

if TYPE_CHECKING:
    from ..system.system import System

WINDOW, ROWS_0, ROWS_1, DRAINED, STOP, IN_LOOP, CALLS, IN_CALL, STEPPING, FINISHED = range(10)
"""Elements of ``flags``: see ``Board``."""

_STATE = 30
"""Numbers reserved for the state of the loop, which has less (``loop.STATE_LENGTH``)."""
_CLOCK = 2
"""Start time and step size of the run in s."""
_FLAGS = 16
"""Numbers reserved for ``flags``, which has less. The header is then a multiple of 64 bytes, a line of the cache."""
_TEXT = 512
"""Bytes reserved for the names of the instance and function of the present FMI call."""
_NAMES = 2**16
"""Bytes reserved for the names of all instances: enough for thousands. A page that is not used takes no memory."""
_NUMBERS = 8 * (_STATE + _CLOCK + _FLAGS)
_HEADER = _NUMBERS + _TEXT + _NAMES


class Board:
    """Shared memory of two processes: one process writes numbers and text, the other reads them, without locks.

    ``state`` is the state of the inner loop. The elements of ``flags`` are:

    - ``CALLS``: number of FMI calls made outside of the loop
    - ``IN_CALL``: 1 during such a call, else 0
    - ``IN_LOOP``: 1 while the loop runs, else 0
    - ``STEPPING``: 1 after initialization
    - ``FINISHED``: 1 when the run is at its end and all instances are freed
    - ``STOP``: the reader sets it to 1 to ask for an end of the run
    - ``WINDOW``: number of windows that the writer has handed over
    - ``ROWS_0``, ``ROWS_1``: number of rows in the last window handed over at either place
    - ``DRAINED``: number of windows that the reader has taken

    Rows are in one window for the whole run, or in two windows of ``capacity`` rows that are filled in turn. A board
    without ``capacity`` has no rows: they are not shared.
    """

    here: ClassVar[Board | None] = None
    """The board of this process; None if no other process watches it."""

    def __init__(self, memory: memoryview, columns: int = 0, capacity: int = 0, windows: int = 1) -> None:
        numbers = np.frombuffer(memory, dtype=np.int64, count=_STATE + _CLOCK + _FLAGS)
        self.state: NDArray[np.int64] = numbers[: loop.STATE_LENGTH]
        self.clock: NDArray[np.float64] = numbers[_STATE : _STATE + _CLOCK].view(np.float64)
        self.flags: NDArray[np.int64] = numbers[_STATE + _CLOCK :]
        self.text: NDArray[np.uint8] = np.frombuffer(memory, dtype=np.uint8, count=_TEXT, offset=_NUMBERS)
        self.names: NDArray[np.uint8] = np.frombuffer(memory, dtype=np.uint8, count=_NAMES, offset=_NUMBERS + _TEXT)
        rows = np.frombuffer(memory, dtype=np.float64, count=windows * capacity * columns, offset=_HEADER)
        self.rows: NDArray[np.float64] = rows.reshape(windows, capacity, columns)
        self.capacity = capacity

    @staticmethod
    def size(columns: int = 0, capacity: int = 0, windows: int = 1) -> int:
        """Number of bytes that a board needs."""
        return _HEADER + 8 * columns * capacity * windows

    @classmethod
    def show(cls, memory: mmap.mmap, columns: int = 0, capacity: int = 0, windows: int = 1) -> Self:
        """Show the calls of this process on a board in ``memory``, from now on."""
        Board.here = board = cls(memoryview(memory), columns, capacity, windows)
        return board

    def begin(self, system: System, point: int = 0) -> None:
        """Show a run of ``system`` that begins at a communication point."""
        self.state[:] = 0
        self.state[loop.POINT] = point
        self.clock[:] = float(system.start_time), float(system.step_size)
        names = "\0".join([*(instance.name for instance in system.instances), "\0"]).encode()[:_NAMES]
        self.names[: len(names)] = np.frombuffer(names, dtype=np.uint8)

    @property
    def window(self) -> NDArray[np.float64]:
        """The window that is being filled."""
        return self.rows[int(self.flags[WINDOW]) % len(self.rows)]

    def room(self) -> int:
        """Number of free rows in the window, at least 2: one chunk of steps can need so many.

        A full window is handed over. Then this waits until the reader has taken the other window. A single window has
        2 spare rows at its end.
        """
        count = int(self.state[loop.ROWS])
        if len(self.rows) > 1 and self.capacity - count < 2:
            self.flags[ROWS_0 + self.flags[WINDOW] % 2] = count
            parent = os.getppid()
            while self.flags[WINDOW] > self.flags[DRAINED]:
                if os.getppid() != parent:
                    raise SystemExit(1)
                time.sleep(1e-3)
            self.flags[WINDOW] += 1
            self.state[loop.ROWS] = count = 0
        return self.capacity - count

    def full(self) -> list[NDArray[np.float64]]:
        """The rows of windows that have been handed over and not been taken yet."""
        handed = range(int(self.flags[DRAINED]), int(self.flags[WINDOW]))
        return [self.rows[number % 2, : int(self.flags[ROWS_0 + number % 2])] for number in handed]

    @contextlib.contextmanager
    def call(self, instance: str, function: str) -> Generator[None]:
        """Announce a call of ``function`` on ``instance`` for the time of the ``with`` block."""
        text = f"{instance}\0{function}".encode()[:_TEXT].ljust(_TEXT, b"\0")
        self.text[:] = np.frombuffer(text, dtype=np.uint8)
        self.flags[CALLS] += 1
        self.flags[IN_CALL] = 1
        try:
            yield
        finally:
            self.flags[IN_CALL] = 0

    @property
    def calling(self) -> bool:
        """Whether the process is in a call of an FMU, or in the loop."""
        return bool(self.flags[IN_CALL] or self.flags[IN_LOOP])

    def called(self) -> tuple[str, str]:
        """Instance and function of the present or last call; empty before the first."""
        if self.flags[IN_LOOP] and (found := loop.call_of(self.state)) is not None:
            names = self.names.tobytes().partition(b"\0\0")[0].decode("utf-8", "replace").split("\0")
            if found[0] < len(names):
                return names[found[0]], found[1]
        instance, _, function = self.text.tobytes().rstrip(b"\0").decode("utf-8", "replace").partition("\0")
        return instance, function

    def time(self) -> float:
        """The time in s of the communication point that the run has reached."""
        return float(self.clock[0] + self.state[loop.POINT] * self.clock[1])

    def mark(self) -> tuple[int, ...]:
        """Numbers of which at least one changes with every call."""
        return int(self.flags[CALLS]), int(self.flags[IN_CALL]), *(int(number) for number in self.state)


def mapped(path: Path) -> mmap.mmap:
    """The shared memory in a file that another process has made.

    Python keeps a copy of the file open as long as the memory is used. This copy is replaced by one of the null device,
    because some FMUs write to all open files.
    """
    with path.open("r+b") as file:
        memory, made = mmap.mmap(file.fileno(), 0), os.fstat(file.fileno())
        # New files get the lowest free number, so that of the copy is below this one.
        nothing = os.open(os.devnull, os.O_RDWR)
    for number in range(nothing) if sys.platform != "win32" else ():
        with contextlib.suppress(OSError):
            if os.path.samestat(os.fstat(number), made):
                os.dup2(nothing, number, inheritable=False)
    os.close(nothing)
    return memory
