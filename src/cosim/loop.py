"""The compiled inner loop: it calls the FMI functions of loaded libraries by their addresses.

What a step does is data: ``program`` has one row an FMI call, first those at a communication point, then those from
it to the next. Everything is in arrays of plain numbers, so one compiled version serves every system, and numba keeps
it on disk (``cache=True``). The loop holds no lock: threads may run systems side by side, and an FMU may call back
into Python (log messages) while it runs.

``values`` holds all signals as doubles, the inputs of an instance side by side, and its outputs, so that Real calls
read and write it in place. Integer and Boolean signals go through ``integers``, which has the same layout.
"""

from __future__ import annotations

from typing import Any

import numba as _numba
import numpy as np
from llvmlite import ir as _ir
from numba.extending import intrinsic as _intrinsic

numba: Any = _numba
ir: Any = _ir
intrinsic: Any = _intrinsic

# Columns of ``program``. A set call first takes its ``COUNT`` values from the slots that ``sources`` names from
# ``LINKS`` on; ``PLAIN`` says that none of them is transformed.
PROGRAM_COLUMNS = 11
CALL, MULTIPLE, FUNCTION, COMPONENT, REFERENCES, COUNT, BUFFER, SLOT, LINKS, PLAIN, INSTANCE = (
    np.uint64(column) for column in range(PROGRAM_COLUMNS)
)

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

# Elements of ``state``, which tells Python where the loop is.
POINT, ROWS, WARNINGS, FAILED_INSTANCE, FAILED_CALL, FAILED_STATUS = range(6)
STATE_LENGTH = 6


@intrinsic
def _exchange(typing: Any, function: Any, component: Any, references: Any, count: Any, buffer: Any) -> Any:
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
    to the next. Set calls transform by ``factors`` and ``offsets``; ``clock`` is start time and step size. ``rows``
    gets the ``recorded`` slots at every ``decimation``-th point. Point ``end`` is left to the next call, except for
    the ``last`` one of the run, from which nothing steps any more.
    """
    start, step = clock[0], clock[1]
    width = np.uint64(PROGRAM_COLUMNS)
    for k in range(state[POINT], end + 1):
        if k == end and end != last:
            break
        for phase in range(2):
            if phase == 1:
                if decimation == 1 or np.uint64(k) % np.uint64(decimation) == 0:
                    record = state[ROWS]
                    for column in range(recorded.size):
                        rows[record, column] = values[recorded[column]]
                    state[ROWS] = record + 1
                if k == last:
                    break
            at = width * split if phase == 1 else np.uint64(0)
            stop = np.uint64(program.size) if phase == 1 else width * split
            while at < stop:
                call, function, component = program[at + CALL], program[at + FUNCTION], program[at + COMPONENT]
                multiple = program[at + MULTIPLE]
                slot, count, link = program[at + SLOT], program[at + COUNT], program[at + LINKS]
                row = at
                at += width
                if multiple != 1 and np.uint64(k + phase) % multiple != 0:
                    continue
                if call == DO_STEP:
                    length = np.int64(multiple)
                    status = _do_step(function, component, start + (k + 1 - length) * step, length * step)
                else:
                    if call <= SET_BOOLEAN:
                        if program[row + PLAIN] != 0:
                            for i in range(count):
                                values[slot + i] = values[sources[link + i]]
                        else:
                            for i in range(count):
                                values[slot + i] = factors[link + i] * values[sources[link + i]] + offsets[link + i]
                        if call == SET_INTEGER:
                            for i in range(count):
                                integers[slot + i] = np.int32(np.rint(values[slot + i]))
                        elif call == SET_BOOLEAN:
                            for i in range(count):
                                integers[slot + i] = np.int32(values[slot + i] != 0.0)
                    status = _exchange(function, component, program[row + REFERENCES], count, program[row + BUFFER])
                    if call >= GET_INTEGER:
                        for i in range(count):
                            values[slot + i] = integers[slot + i]
                if status != 0:
                    if status != 1:
                        state[FAILED_INSTANCE] = program[row + INSTANCE]
                        state[FAILED_CALL] = call
                        state[FAILED_STATUS] = status
                        return False
                    state[WARNINGS] += 1
        else:
            state[POINT] = k + 1
    return True
