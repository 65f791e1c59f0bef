"""Shared memory in which the process that runs the FMUs shows its progress and its rows to the watching process."""

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
"""Numbers reserved for the state of the loop, which has less (``loop.STATE_LENGTH``)."""
_FLAGS = 16
"""Numbers reserved for ``flags``, which has less. The header is then a multiple of 64 bytes, a line of the cache."""
_TEXT = 512
"""Bytes reserved for the names of the instance and function of the present FMI call."""
_HEADER = 8 * (_STATE + _FLAGS) + _TEXT


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

    Rows are in one window for the whole run, or in two windows of ``capacity`` rows that are filled in turn.
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
        """Number of bytes that a board needs."""
        return _HEADER + 8 * columns * capacity * windows

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

    def called(self) -> tuple[str, str]:
        """Instance and function of the last call outside of the loop; empty before the first."""
        instance, _, function = self.text.tobytes().rstrip(b"\0").decode("utf-8", "replace").partition("\0")
        return instance, function

    def mark(self) -> tuple[int, ...]:
        """Numbers of which at least one changes with every call."""
        return int(self.flags[CALLS]), int(self.flags[IN_CALL]), *(int(number) for number in self.state)
