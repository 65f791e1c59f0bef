"""The inner loop: it calls the FMI functions of loaded libraries by their addresses.

What a step does is data: ``program`` has one row an FMI call, first those at a communication point, then those from
it to the next. Everything is in arrays of plain numbers, so one compiled loop serves every system, FMUs of FMI 2.0 and
3.0 side by side. The loop holds no lock: threads may run systems side by side, and an FMU may call back into Python
(log messages) while it runs.

``values`` holds all signals as doubles, the inputs of an instance side by side, and its outputs, so that calls with
doubles read and write it in place. Calls with other types go through buffers of their own.

``loop.c`` is the loop. Its library lies beside this file, put there when FMUs are built, or by the wheel; its name
holds the digest of ``loop.c``, so that no other version is ever loaded. Where none fits this machine, ``loop_plain``
does the same in Python, some hundred times slower.
"""

from __future__ import annotations

import ctypes
import logging
import sys
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..fmu.description import platform_folders

PROGRAM_COLUMNS = 17
(
    ACT,
    FMI,
    COMPONENT,
    STEP,
    STEP_CALL,
    MULTIPLE,
    LINK,
    LINKS,
    FUNCTION,
    CALL,
    REFERENCES,
    REFERENCE_COUNT,
    COUNT,
    BUFFER,
    SLOT,
    TYPE,
    SET,
) = range(PROGRAM_COLUMNS)
"""Columns of ``program``. A row does, in this order, what it has:

- fmi2DoStep or fmi3DoStep, as ``FMI`` says, at address ``STEP``, over ``MULTIPLE`` steps;
- ``LINKS`` connections, from number ``LINK`` on; ``array`` makes bytes of both, as the loop wants them;
- ``ACT``, one of those below.

``STEP_CALL`` and ``CALL`` are what ``state[CALLING]`` says during the calls of ``STEP`` and of ``FUNCTION``.
"""

SET_REAL, STEP_GET_REAL, NOTHING, EXCHANGE, ADD, TABLE, GUARD = range(7)
"""What a row does last.

``EXCHANGE`` calls ``FUNCTION``, which gives or takes (``SET`` is 1) ``COUNT`` values of ``TYPE`` in ``BUFFER`` for
``REFERENCE_COUNT`` value references at ``REFERENCES``. Unless they are doubles, they are converted from or to the slots
from ``SLOT`` on: rounded to integers, true for what is not 0. ``SET_REAL`` and ``STEP_GET_REAL`` are the two commonest
kinds of it, for which the loop is made; ``array`` finds them.
``ADD`` lets the connections of this row add to their targets instead of setting them.
``TABLE`` takes ``COUNT`` slots from ``SLOT`` on out of a table of doubles at ``BUFFER``: one row of ``COUNT`` for each
point, the first for the point from which the loop goes on.
``GUARD`` leaves out the next ``COUNT`` rows unless the number of the point is a multiple of ``MULTIPLE``.
"""

LINK_TYPE = np.dtype([("source", np.int64), ("target", np.int64), ("factor", np.float64), ("offset", np.float64)])
"""A connection: slots of its ends, and ``target = factor*source + offset``."""

TYPES = (
    ("Float64", ctypes.c_double),
    ("Float32", ctypes.c_float),
    ("Int8", ctypes.c_int8),
    ("UInt8", ctypes.c_uint8),
    ("Int16", ctypes.c_int16),
    ("UInt16", ctypes.c_uint16),
    ("Int32", ctypes.c_int32),
    ("UInt32", ctypes.c_uint32),
    ("Int64", ctypes.c_int64),
    ("UInt64", ctypes.c_uint64),
    ("Boolean", ctypes.c_uint8),
    ("Boolean", ctypes.c_int32),
)
"""Name in FMI 3.0 and type in C, in the order of the numbers that ``TYPE`` takes; the last is fmi2Boolean."""
FLOAT64, FLOAT32, INT8, UINT8, INT16, UINT16, INT32, UINT32, INT64, UINT64, BOOLEAN8, BOOLEAN32 = range(len(TYPES))
FMI2_TYPES = {"Real": FLOAT64, "Integer": INT32, "Boolean": BOOLEAN32}
FMI3_TYPES = {name: number for number, (name, _) in enumerate(TYPES[:-1])}

FUNCTIONS = (
    *(f"fmi2{act}{name}" for act in ("Set", "Get") for name in FMI2_TYPES),
    "fmi2DoStep",
    *(f"fmi3{act}{name}" for act in ("Set", "Get") for name in FMI3_TYPES),
    "fmi3DoStep",
)
"""The functions that the loop calls; see ``call_number``."""

POINT, ROWS, WARNINGS, CALLING, REASON, STATUS, FAILED_LINK, FAILED_SLOT, LAST_TIME = range(9)
"""Elements of ``state``, which tells at any time where the loop is.

``POINT`` is the communication point, ``ROWS`` the number of rows recorded, ``WARNINGS`` that of calls whose status was
not OK. ``CALLING`` is the number (``call_number``) of the FMI call that is made now, or was made last; -1 outside of
the loop. ``REASON`` says why the loop stopped, the others are what belongs to it. ``LAST_TIME`` holds the bits of a
double: lastSuccessfulTime of the last fmi3DoStep.
"""
STATE_LENGTH = 9

DONE, CALL_FAILED, NOT_FINITE, OUT_OF_RANGE, TERMINATED, RETURNED_EARLY = range(6)
"""Why the loop stopped: not; a call returned ``STATUS``; connection ``FAILED_LINK`` carries a value that is not finite;
the value for slot ``FAILED_SLOT`` does not fit its type; fmi3DoStep asked to terminate, or returned early."""

Numbers = NDArray[np.int64]
Unsigned = NDArray[np.uint64]
Reals = NDArray[np.float64]
Row = dict[int, int]
"""A row of a program: column -> number, 0 where nothing is said."""


def call_number(instance: int, function: str) -> int:
    """What ``state[CALLING]`` says while ``function`` is called on the instance of that number."""
    return instance * len(FUNCTIONS) + FUNCTIONS.index(function)


def call_of(state: Numbers) -> tuple[int, str] | None:
    """Number of the instance and name of the function that is called now, or failed; None outside of the loop."""
    number = int(state[CALLING])
    return None if number < 0 else (number // len(FUNCTIONS), FUNCTIONS[number % len(FUNCTIONS)])


class Advance(Protocol):
    """A loop, compiled or in Python."""

    def __call__(  # noqa: PLR0917 (all of it is what the loop works on)
        self,
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
        """Go on from communication point ``state[POINT]`` to ``end``; False if something stopped the loop.

        ``program`` holds its rows one behind the other, ``split`` of them for a communication point, the others to
        step to the next. ``links`` are of ``LINK_TYPE``; ``clock`` is start time and step size. ``rows`` gets the
        ``recorded`` slots of ``values`` at every ``decimation``-th point. Point ``end`` is left to the next call,
        except for the ``last`` one of the run, from which nothing steps any more. With ``check``, values on connections
        that are not finite, or do not fit the type of their input, stop the loop before they are used; without, the
        latter become the nearest that fits. ``state`` may lie in memory that another process watches.
        """
        ...


@cache
def compiled() -> Advance | None:
    """The compiled loop; None where there is none for this machine, which is told once in the log."""
    path = library()
    try:
        function = ctypes.CDLL(str(path)).advance
    except OSError as error:
        logging.getLogger("cosim").warning(
            "No compiled loop for this machine (%s). Systems run in Python, some hundred times slower, with the same "
            "results. To compile it: python build_fmus.py.",
            error if path.exists() else f"{path.name} is missing",
        )
        return None
    address, number, real = ctypes.c_void_p, ctypes.c_int64, ctypes.c_double
    function.argtypes = [
        *(address, number, number, address, address),
        *(address, number, address, real, real, address),
        *(number, number, number, ctypes.c_int),
    ]

    def advance(  # noqa: PLR0917 (as Advance)
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
        done = function(
            *(program.ctypes.data, program.size // PROGRAM_COLUMNS, split, links.ctypes.data, values.ctypes.data),
            *(recorded.ctypes.data, recorded.size, rows.ctypes.data, clock[0], clock[1], state.ctypes.data),
            *(end, last, decimation, check),
        )
        return bool(done)

    return advance


def library() -> Path:
    """Where the compiled loop for this machine should be."""
    source = Path(__file__).with_name("loop.c")
    ending = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")
    digest = sha256(source.read_bytes()).hexdigest()[:12]
    places = [source.with_name(f"loop-{digest}-{folder}{ending}") for folder in platform_folders()]
    return next((place for place in places if place.exists()), places[0])


def array(rows: list[Row]) -> Unsigned:
    """The program of these rows."""
    program = np.zeros((len(rows), PROGRAM_COLUMNS), dtype=np.uint64)
    for number, row in enumerate(rows):
        for column, value in {**row, ACT: _act(row)}.items():
            program[number, column] = value * LINK_TYPE.itemsize if column in (LINK, LINKS) else value
    return program.reshape(-1)


def _act(row: Row) -> int:
    """The act of a row, or the special one for what this row does."""
    act = row.get(ACT, NOTHING)
    if act == EXCHANGE and row[FMI] == 2 and row[TYPE] == FLOAT64:
        if row[SET] and not row.get(STEP):
            return SET_REAL
        if not row[SET] and not row.get(LINKS) and row.get(STEP) and row[MULTIPLE] == 1:
            return STEP_GET_REAL
    return act
