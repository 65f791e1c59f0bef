"""The function that the inner loop runs, as numba compiles it; imported only where it is not compiled yet.

It knows nothing but numbers and addresses. What it executes, and in which arrays, is said in ``loop``.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

import numba as _numba
import numpy as np
from numba.extending import intrinsic as _intrinsic

from .loop import (
    BUFFER,
    CALL,
    COMPONENT,
    COUNT,
    DO_STEP,
    FAILED_COMPONENT,
    FAILED_FUNCTION,
    FAILED_STATUS,
    FUNCTION,
    GUARD,
    LINK,
    LINKS,
    MULTIPLE,
    POINT,
    PROGRAM_COLUMNS,
    REFERENCES,
    ROWS,
    SLOT,
    STEP,
    TO_BOOLEAN,
    TO_INTEGER,
    WARNINGS,
)

numba: Any = _numba


intrinsic: Any = _intrinsic


ir: Any = import_module("llvmlite.ir")


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


def advance(  # noqa: PLR0917 (called from C)
    program: Any,
    size: Any,
    split: Any,
    sources: Any,
    factors: Any,
    offsets: Any,
    values: Any,
    integers: Any,
    recorded: Any,
    columns: Any,
    rows: Any,
    start: float,
    step: float,
    state: Any,
    end: int,
    last: int,
    every: Any,
) -> Any:
    """``loop.advance`` with every array as the address of its first element; 1, or 0 if an FMI call failed.

    Indices are unsigned: numba then adds no code for negative ones.
    """
    width, one = np.uint64(PROGRAM_COLUMNS), np.uint64(1)
    middle = width * split
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
                            return 0
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
                        return 0
            if stop != middle:
                break
            if every == one or due % every == 0:
                for column in range(columns):
                    rows[record * columns + column] = values[recorded[column]]
                record += one
                state[ROWS] = record
            if k == last:
                break
            stop = size
            due += one
    state[POINT] = end
    return 1


def compiled() -> tuple[str, str]:
    """The name of ``advance`` as a C function, and its optimized LLVM code."""
    t = numba.types
    numbers, reals = t.CPointer(t.uint64), t.CPointer(t.float64)
    signals = (numbers, reals, reals, reals, t.CPointer(t.int32), numbers, t.uint64, reals)
    run = (t.float64, t.float64, t.CPointer(t.int64), t.int64, t.int64, t.uint64)
    function = numba.cfunc(t.int32(numbers, t.uint64, t.uint64, *signals, *run), error_model="numpy")(advance)
    return str(function.native_name), str(function.inspect_llvm())
