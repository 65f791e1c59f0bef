"""What the process that runs the FMUs shows to the one that watches it: where it is, and the rows so far."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Generator

import numpy as np
from numpy.typing import NDArray

from . import loop

WINDOW, ROWS_0, ROWS_1, DRAINED, STOP, IN_LOOP, CALLS, IN_CALL, STEPPING, FINISHED = range(10)
"""Elements of ``flags``: see ``Board``."""

_STATE = 32
"""Numbers for the state of the loop: more than it has."""
_FLAGS = 16
_TEXT = 512
_HEADER = 8 * (_STATE + _FLAGS) + _TEXT


class Board:
    """Shared memory of two processes: numbers and text that one writes and the other reads, without locks.

    ``state`` is that of the inner loop. ``flags`` has ``CALLS``, the number of FMI calls made outside of the loop;
    1 or 0 for ``IN_CALL`` (during such a call), ``IN_LOOP``, ``STEPPING`` (initialization is over) and ``FINISHED``
    (the run came to its end, all instances are freed); and ``STOP``, by which the reader asks for an end.

    Rows lie in one window, or take turns in two of ``capacity`` rows each: ``WINDOW`` is how many have been handed
    over, ``ROWS_0`` and ``ROWS_1`` how many rows the last one in either place has, ``DRAINED`` how many of them were
    taken.
    """

    def __init__(self, memory: memoryview, columns: int, capacity: int, windows: int) -> None:
        numbers = np.frombuffer(memory, dtype=np.int64, count=_STATE + _FLAGS)
        self.state: NDArray[np.int64] = numbers[: loop.STATE_LENGTH]
        self.flags: NDArray[np.int64] = numbers[_STATE:]
        self.text: NDArray[np.uint8] = np.frombuffer(memory, dtype=np.uint8, count=_TEXT, offset=_HEADER - _TEXT)
        rows = np.frombuffer(memory, dtype=np.float64, count=windows * capacity * columns, offset=_HEADER)
        self.rows: NDArray[np.float64] = rows.reshape(windows, capacity, columns)
        self.capacity = capacity

    @staticmethod
    def size(columns: int, capacity: int, windows: int) -> int:
        """Bytes that a board needs."""
        return _HEADER + 8 * columns * capacity * windows

    @property
    def window(self) -> NDArray[np.float64]:
        """The window that rows go to now."""
        return self.rows[int(self.flags[WINDOW]) % len(self.rows)]

    def room(self) -> int:
        """Rows that the window takes; one that is full is handed over, which waits for the other place to be free.

        At least 2, which is what one chunk of steps can need; a single window has that to spare at the end.
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
        """Say what is called."""
        text = f"{instance}\0{function}".encode()[:_TEXT].ljust(_TEXT, b"\0")
        self.text[:] = np.frombuffer(text, dtype=np.uint8)
        self.flags[CALLS] += 1
        self.flags[IN_CALL] = 1
        try:
            yield
        finally:
            self.flags[IN_CALL] = 0

    def called(self) -> tuple[str, str]:
        """Instance and function of the last call outside of the loop; empty before the first."""
        instance, _, function = self.text.tobytes().rstrip(b"\0").decode("utf-8", "replace").partition("\0")
        return instance, function

    def mark(self) -> tuple[int, ...]:
        """What changes with every call."""
        return int(self.flags[CALLS]), int(self.flags[IN_CALL]), *(int(number) for number in self.state)
