"""The compiled inner loop: it calls the FMI functions of loaded libraries by their addresses.

What a step does is data: ``program`` has one row an FMI call, first those at a communication point, then those from
it to the next. Everything is in arrays of plain numbers, so one compiled version serves every system, and numba keeps
it on disk (``cache=True``). The loop holds no lock: threads may run systems side by side, and an FMU may call back
into Python (log messages) while it runs.

``values`` holds all signals as doubles, the inputs of an instance side by side, and its outputs, so that Real calls
read and write it in place. Integer and Boolean signals go through ``integers``, which has the same layout.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

import numba as _numba
import numpy as np
from numba.extending import intrinsic as _intrinsic

numba: Any = _numba
intrinsic: Any = _intrinsic
ir: Any = import_module("llvmlite.ir")

PROGRAM_COLUMNS = 11
COMPONENT, STEP, MULTIPLE, LINKS, LINK, CALL, FUNCTION, REFERENCES, COUNT, BUFFER, SLOT = (
    np.uint64(column) for column in range(PROGRAM_COLUMNS)
)
"""Columns of ``program``. A row does, in this order, what it has: fmi2DoStep at address ``STEP`` over ``MULTIPLE``
steps; ``LINKS`` connections, from number ``LINK`` on, into the slots from ``SLOT`` on; and ``CALL``, which is the call
of ``FUNCTION`` on ``COUNT`` variables, or one of the other acts below."""

FUNCTIONS = (
    "fmi2SetReal",
    "fmi2SetInteger",
    "fmi2SetBoolean",
    "fmi2GetReal",
    "fmi2GetInteger",
    "fmi2GetBoolean",
    "fmi2DoStep",
)
SET_REAL, SET_INTEGER, SET_BOOLEAN, GET_REAL, GET_INTEGER, GET_BOOLEAN, DO_STEP = range(7)

GUARD, TO_INTEGER, TO_BOOLEAN, FROM_INTEGER = range(7, 11)
"""``GUARD`` leaves out the next ``COUNT`` rows unless the number of the point is a multiple of ``MULTIPLE``. The others
convert ``COUNT`` slots between ``values`` and ``integers``."""

POINT, ROWS, WARNINGS, FAILED_COMPONENT, FAILED_FUNCTION, FAILED_STATUS = range(6)
"""Elements of ``state``, which tells Python where the loop is."""
STATE_LENGTH = 6


@intrinsic
def _exchange(  # noqa: PLR0917 (numba calls by position)
    typing: Any, function: Any, component: Any, references: Any, count: Any, buffer: Any
) -> Any:
    """``fmi2Status function(component, references, count, buffer)``, all given as addresses."""
    u64 = numba.types.uint64

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kind = ir.FunctionType(ir.IntType(32), [ir.IntType(64)] * 4)
        return builder.call(builder.inttoptr(arguments[0], kind.as_pointer()), arguments[1:])

    return numba.types.int32(u64, u64, u64, u64, u64), generate


@intrinsic
def _do_step(typing: Any, function: Any, component: Any, time: Any, step: Any) -> Any:
    """``fmi2DoStep(component, time, step, fmi2True)`` with the function given as address."""
    u64, f64 = numba.types.uint64, numba.types.float64

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        real, int32 = ir.DoubleType(), ir.IntType(32)
        kind = ir.FunctionType(int32, [ir.IntType(64), real, real, int32])
        call = [*arguments[1:], ir.Constant(int32, 1)]
        return builder.call(builder.inttoptr(arguments[0], kind.as_pointer()), call)

    return numba.types.int32(u64, u64, f64, f64), generate


@numba.njit(
    "boolean(uint64[::1], uint64, uint64[::1], float64[::1], float64[::1], float64[::1], int32[::1], uint64[::1], "
    "float64[:, ::1], float64[::1], int64[::1], int64, int64, int64)",
    cache=True,
    nogil=True,
    error_model="numpy",
)
def advance(  # noqa: PLR0917 (numba calls by position)
    program: Any,
    split: Any,
    sources: Any,
    factors: Any,
    offsets: Any,
    values: Any,
    integers: Any,
    recorded: Any,
    rows: Any,
    clock: Any,
    state: Any,
    end: int,
    last: int,
    decimation: int,
) -> bool:
    """Go on from communication point ``state[POINT]`` to ``end``; False if an FMI call failed.

    ``program`` holds its rows one behind the other, ``split`` of them for a communication point, the others to step
    to the next. A connection sets ``factor*values[source] + offset``; ``clock`` is start time and step size. ``rows``
    gets the ``recorded`` slots at every ``decimation``-th point. Point ``end`` is left to the next call, except for
    the ``last`` one of the run, from which nothing steps any more.

    Indices are unsigned: numba then adds no code for negative ones.
    """
    start, step = clock[0], clock[1]
    width, one = np.uint64(PROGRAM_COLUMNS), np.uint64(1)
    size, middle = np.uint64(program.size), width * split
    columns, every = np.uint64(recorded.size), np.uint64(decimation)
    record = np.uint64(state[ROWS])
    for k in range(state[POINT], end + 1):
        if k == end and end != last:
            break
        state[POINT] = k
        at, stop, due = np.uint64(0), middle, np.uint64(k)
        while True:
            while at < stop:
                row = at
                at += width
                component, links = program[row + COMPONENT], program[row + LINKS]
                if program[row + STEP] != 0:
                    multiple = program[row + MULTIPLE]
                    begin = np.int64(due - multiple)
                    status = _do_step(program[row + STEP], component, start + begin * step, np.int64(multiple) * step)
                    if status != 0:
                        state[WARNINGS] += 1
                        if status != 1:
                            state[FAILED_COMPONENT] = component
                            state[FAILED_FUNCTION] = DO_STEP
                            state[FAILED_STATUS] = status
                            return False
                if links != 0:
                    slot, link = program[row + SLOT], program[row + LINK]
                    values[slot] = factors[link] * values[sources[link]] + offsets[link]
                    for i in range(one, links):
                        values[slot + i] = factors[link + i] * values[sources[link + i]] + offsets[link + i]
                call, count = program[row + CALL], program[row + COUNT]
                if call > DO_STEP:
                    if call == GUARD:
                        if due % program[row + MULTIPLE] != 0:
                            at += width * count
                        continue
                    slot = program[row + SLOT]
                    for i in range(slot, slot + count):
                        if call == TO_INTEGER:
                            integers[i] = np.int32(np.rint(values[i]))
                        elif call == TO_BOOLEAN:
                            integers[i] = np.int32(values[i] != 0.0)
                        else:
                            values[i] = integers[i]
                    continue
                status = _exchange(
                    program[row + FUNCTION], component, program[row + REFERENCES], count, program[row + BUFFER]
                )
                if status != 0:
                    state[WARNINGS] += 1
                    if status != 1:
                        state[FAILED_COMPONENT] = component
                        state[FAILED_FUNCTION] = call
                        state[FAILED_STATUS] = status
                        return False
            if stop != middle:
                break
            if every == one or due % every == 0:
                for column in range(columns):
                    rows[record, column] = values[recorded[column]]
                record += one
                state[ROWS] = record
            if k == last:
                break
            stop = size
            due += one
    state[POINT] = end
    return True
