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
# ``LINKS`` on.
CALL, MULTIPLE, FUNCTION, COMPONENT, REFERENCES, COUNT, BUFFER, SLOT, LINKS, INSTANCE = range(10)
PROGRAM_COLUMNS = 10

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
    i64 = numba.types.int64

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kind = ir.FunctionType(ir.IntType(32), [ir.IntType(64)] * 4)
        return builder.call(builder.inttoptr(arguments[0], kind.as_pointer()), arguments[1:])

    return numba.types.int32(i64, i64, i64, i64, i64), generate


@intrinsic
def _do_step(typing: Any, function: Any, component: Any, time: Any, step: Any) -> Any:
    """``fmi2DoStep(component, time, step, fmi2True)`` with the function given as address."""
    i64, f64 = numba.types.int64, numba.types.float64

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        real, int32 = ir.DoubleType(), ir.IntType(32)
        kind = ir.FunctionType(int32, [ir.IntType(64), real, real, int32])
        call = [*arguments[1:], ir.Constant(int32, 1)]
        return builder.call(builder.inttoptr(arguments[0], kind.as_pointer()), call)

    return numba.types.int32(i64, i64, f64, f64), generate


@numba.njit(
    "boolean(int64[:, ::1], int64, int64[::1], float64[:, ::1], float64[::1], int32[::1], int64[::1], "
    "float64[:, ::1], float64[::1], int64[::1], int64, int64, int64)",
    cache=True,
    nogil=True,
)
def advance(
    program: Any,
    split: int,
    sources: Any,
    gains: Any,
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

    ``program`` has ``split`` rows for a communication point, the others step to the next. ``gains`` holds factor and
    offset of each connection, ``clock`` start time and step size. ``rows`` gets the ``recorded`` slots at every
    ``decimation``-th point. Point ``end`` is left to the next call, except for the ``last`` one of the run, from
    which nothing steps any more.
    """
    start, step = clock[0], clock[1]
    for k in range(state[POINT], end + 1):
        if k == end and end != last:
            break
        for phase in range(2):
            if phase == 1:
                if k % decimation == 0:
                    record = k // decimation
                    for column in range(recorded.size):
                        rows[record, column] = values[recorded[column]]
                    state[ROWS] = record + 1
                if k == last:
                    break
            for row in range(split * phase, split if phase == 0 else program.shape[0]):
                multiple = program[row, MULTIPLE]
                if multiple != 1 and (k + phase) % multiple != 0:
                    continue
                call, function, component = program[row, CALL], program[row, FUNCTION], program[row, COMPONENT]
                if call == DO_STEP:
                    begin = k + 1 - multiple
                    status = _do_step(function, component, start + begin * step, multiple * step)
                else:
                    slot, count = program[row, SLOT], program[row, COUNT]
                    if call <= SET_BOOLEAN:
                        link = program[row, LINKS]
                        for i in range(count):
                            value = gains[link + i, 0] * values[sources[link + i]] + gains[link + i, 1]
                            values[slot + i] = value
                            if call == SET_INTEGER:
                                integers[slot + i] = np.int32(np.rint(value))
                            elif call == SET_BOOLEAN:
                                integers[slot + i] = np.int32(value != 0.0)
                    status = _exchange(function, component, program[row, REFERENCES], count, program[row, BUFFER])
                    if call == GET_INTEGER or call == GET_BOOLEAN:
                        for i in range(slot, slot + count):
                            values[i] = integers[i]
                if status != 0:
                    if status != 1:
                        state[FAILED_INSTANCE] = program[row, INSTANCE]
                        state[FAILED_CALL] = call
                        state[FAILED_STATUS] = status
                        return False
                    state[WARNINGS] += 1
        else:
            state[POINT] = k + 1
    return True
