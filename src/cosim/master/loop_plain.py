"""The inner loop in Python, for machines without a compiled loop. It gives the same results as ``loop.c``."""

from __future__ import annotations

import ctypes
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import loop
from .loop import Numbers, Reals, Unsigned

ADDRESS, SIZE, REAL, STATUS, BOOLEAN = (
    ctypes.c_void_p,
    ctypes.c_size_t,
    ctypes.c_double,
    ctypes.c_int,
    ctypes.c_bool,
)
EXCHANGES: dict[int, Any] = {
    2: ctypes.CFUNCTYPE(STATUS, ADDRESS, ADDRESS, SIZE, ADDRESS),
    3: ctypes.CFUNCTYPE(STATUS, ADDRESS, ADDRESS, SIZE, ADDRESS, SIZE),
}
STEPS: dict[int, Any] = {
    2: ctypes.CFUNCTYPE(STATUS, ADDRESS, REAL, REAL, ctypes.c_int),
    3: ctypes.CFUNCTYPE(STATUS, ADDRESS, REAL, REAL, BOOLEAN, *[ctypes.POINTER(BOOLEAN)] * 3, ctypes.POINTER(REAL)),
}
LARGEST_FLOAT32 = float(np.finfo(np.float32).max)


class Stopped(Exception):
    """Ends the loop. The reason is in the state."""


class _Row:
    """A row of the program, with its addresses converted to functions and buffers."""

    def __init__(self, columns: list[int]) -> None:
        self.component, self.multiple, self.step_call = (
            columns[column] for column in (loop.COMPONENT, loop.MULTIPLE, loop.STEP_CALL)
        )
        first, links = (columns[column] // loop.LINK_TYPE.itemsize for column in (loop.LINK, loop.LINKS))
        self.links = range(first, first + links)
        self.act, self.call, self.count, self.slot = (
            columns[column] for column in (loop.ACT, loop.CALL, loop.COUNT, loop.SLOT)
        )
        self.set, self.type, self.fmi = bool(columns[loop.SET]), columns[loop.TYPE], columns[loop.FMI]
        self.step: Any = STEPS[self.fmi](columns[loop.STEP]) if columns[loop.STEP] else None
        self.function: Any = None
        if self.act in (loop.EXCHANGE, loop.CALL_REAL, loop.STEP_GET_REAL):
            self.function = EXCHANGES[self.fmi](columns[loop.FUNCTION])
            self.arguments = columns[loop.REFERENCES], columns[loop.REFERENCE_COUNT], columns[loop.BUFFER]
            self.buffer = (loop.TYPES[self.type][1] * self.count).from_address(columns[loop.BUFFER])
        self.table = columns[loop.BUFFER]


@dataclass
class _Loop:
    """The data that the rows of a program read and change."""

    links: list[tuple[int, int, float, float]]
    values: Any
    clock: tuple[float, float]
    state: Numbers
    first: int
    check: bool

    def run(self, rows: list[_Row], due: int) -> None:
        """Execute ``rows`` for communication point ``due``."""
        left_out = 0
        for row in rows:
            if left_out:
                left_out -= 1
                continue
            if row.step is not None:
                self.step(row, due)
            for link in row.links:
                self.carry(link, add=row.act == loop.ADD)
            if row.function is not None:
                self.exchange(row)
            elif row.act == loop.GUARD and due % row.multiple:
                left_out = row.count
            elif row.act == loop.TABLE:
                place = row.table + (due - self.first) * row.count * ctypes.sizeof(REAL)
                for i, value in enumerate((REAL * row.count).from_address(place)):
                    self.values[row.slot + i] = value

    def step(self, row: _Row, due: int) -> None:
        start, step = self.clock
        span = start + (due - row.multiple) * step, row.multiple * step
        self.state[loop.CALLING] = row.step_call
        if row.fmi == 2:
            self.called(row.step(row.component, *span, 1))
            return
        event, terminate, early, last = BOOLEAN(), BOOLEAN(), BOOLEAN(), REAL(span[0])
        flags = (ctypes.byref(flag) for flag in (event, terminate, early))
        status = row.step(row.component, *span, True, *flags, ctypes.byref(last))
        self.state.view(np.float64)[loop.LAST_TIME] = last.value
        self.called(status)
        if terminate or early:
            self.stop(loop.TERMINATED if terminate else loop.RETURNED_EARLY, loop.STATUS, status)

    def carry(self, link: int, *, add: bool) -> None:
        """Set the target of a connection to its value, or ``add`` the value to the target."""
        source, target, factor, offset = self.links[link]
        value = factor * self.values[source] + offset
        value = self.values[target] + value if add else value
        if self.check and not math.isfinite(value):
            self.stop(loop.NOT_FINITE, loop.FAILED_LINK, link)
        self.values[target] = value

    def exchange(self, row: _Row) -> None:
        if row.set and row.type != loop.FLOAT64:
            for i in range(row.count):
                row.buffer[i] = self.converted(row, i)
        self.state[loop.CALLING] = row.call
        references, reference_count, buffer = row.arguments
        counts = (row.count,) if row.fmi == 3 else ()
        self.called(row.function(row.component, references, reference_count, buffer, *counts))
        if not row.set and row.type != loop.FLOAT64:
            for i in range(row.count):
                self.values[row.slot + i] = float(row.buffer[i])

    def converted(self, row: _Row, i: int) -> float | int | bool:
        """The value of slot ``i`` of a call, converted to the type of the call."""
        value = self.values[row.slot + i]
        if row.type in (loop.BOOLEAN8, loop.BOOLEAN32):
            return value != 0.0
        if row.type == loop.FLOAT32:
            if self.check and abs(value) > LARGEST_FLOAT32:
                self.stop(loop.OUT_OF_RANGE, loop.FAILED_SLOT, row.slot + i)
            return value
        least, most = _LIMITS[row.type]
        whole = round(value) if math.isfinite(value) else value
        fits = least <= whole <= most
        if self.check and not fits:
            self.stop(loop.OUT_OF_RANGE, loop.FAILED_SLOT, row.slot + i)
        return int(whole) if fits else most if whole > most else least

    def called(self, status: int) -> None:
        """Count a status other than OK. A status other than OK and Warning ends the run."""
        if status != 0:
            self.state[loop.WARNINGS] += 1
        if status not in (0, 1):
            self.stop(loop.CALL_FAILED, loop.STATUS, status)

    def stop(self, reason: int, place: int, what: int) -> None:
        self.state[loop.REASON] = reason
        self.state[place] = what
        raise Stopped


def _limits(ctype: Any) -> tuple[int, int]:
    """Smallest and largest value of an integer type. For 64 bits, the largest value that a double can hold."""
    kind = np.dtype(ctype)
    information = np.iinfo(kind)
    most = int(information.max)
    return int(information.min), most if kind.itemsize < 8 else int(np.nextafter(float(most), 0.0))


_LIMITS = {number: _limits(loop.TYPES[number][1]) for number in range(loop.INT8, loop.UINT64 + 1)}


def advance(  # noqa: PLR0917 (as loop.Advance)
    program: Unsigned,
    split: int,
    links: NDArray[np.void],
    values: Reals,
    recorded: Unsigned,
    rows: Reals,
    clock: Reals,
    state: Numbers,
    *,
    end: int,
    last: int,
    decimation: int,
    check: bool,
) -> bool:
    """See ``loop.Advance``."""
    acts = [_Row(row) for row in program.reshape(-1, loop.PROGRAM_COLUMNS).tolist()]
    point, onwards = acts[:split], acts[split:]
    # A memory view gives Python numbers. They are faster than NumPy numbers and never warn.
    times = float(clock[0]), float(clock[1])
    run = _Loop(links.tolist(), values.data, times, state, int(state[loop.POINT]), check)
    try:
        for k in range(int(state[loop.POINT]), end + (end == last)):
            state[loop.POINT] = k
            run.run(point, k)
            if k % decimation == 0:
                if recorded.size:
                    rows[state[loop.ROWS]] = values[recorded]
                state[loop.ROWS] += 1
            if k < last:
                run.run(onwards, k + 1)
    except Stopped:
        return False
    state[loop.POINT] = end
    state[loop.CALLING] = -1
    return True
