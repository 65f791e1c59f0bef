"""The inner loop: it calls the FMI functions of loaded libraries by their addresses.

A step is described by data: ``program`` has one row for each FMI call. First come the rows for a communication point,
then the rows for the step to the next point. All data are arrays of plain numbers. Therefore one compiled loop serves
every system, also systems with FMUs of FMI 2.0 and 3.0 together. The loop holds no lock: several threads may run
systems at the same time, and an FMU may call back into Python (log messages).

``values`` holds all signals as doubles. The inputs of an instance are side by side, and so are its outputs. Therefore
calls with doubles read and write ``values`` in place. Calls with other types use separate buffers.

The loop is in ``loop.c``. Its library is beside this file; the build of the FMUs or the wheel puts it there. Its name
contains the digest of ``loop.c``, so that a library of another version is never loaded. If no library fits this
machine, ``loop_plain`` does the same in Python, some hundred times slower.
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
"""Columns of ``program``. A row does the following, in this order; each part may be missing:

- call fmi2DoStep or fmi3DoStep (``FMI`` is 2 or 3) at address ``STEP``, over ``MULTIPLE`` communication steps;
- carry the values of ``LINKS`` connections, from number ``LINK`` on (``array`` converts both to bytes for the loop);
- do ``ACT``, see below.

``state[CALLING]`` is ``STEP_CALL`` during the call of ``STEP``, and ``CALL`` during the call of ``FUNCTION``.
"""

CALL_REAL, STEP_GET_REAL, NOTHING, EXCHANGE, ADD, TABLE, GUARD = range(7)
"""The last action of a row.

``EXCHANGE`` calls ``FUNCTION``, which sets (``SET`` is 1) or gets (``SET`` is 0) ``COUNT`` values of ``TYPE`` in
``BUFFER``, for ``REFERENCE_COUNT`` value references at ``REFERENCES``. Values of other types than double are converted
from or to the slots from ``SLOT`` on. A double is rounded to an integer; a double other than 0 becomes true.
``CALL_REAL`` (without a step) and ``STEP_GET_REAL`` are the two most frequent kinds of ``EXCHANGE``: doubles, FMI 2.0.
They have a fast path in the loop; ``array`` selects them.
``ADD``: the connections of this row add to their targets instead of setting them.
``TABLE`` copies ``COUNT`` values from a table of doubles at ``BUFFER`` to the slots from ``SLOT`` on. The table has one
row of ``COUNT`` values for each point; its first row is for the point at which ``advance`` begins.
``GUARD`` skips the next ``COUNT`` rows unless the number of the point is a multiple of ``MULTIPLE``.
"""

LINK_TYPE = np.dtype([("source", np.int64), ("target", np.int64), ("factor", np.float64), ("offset", np.float64)])
"""A connection: the slots of its source and target, and ``target = factor*source + offset``."""

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
"""The name in FMI 3.0 and the C type of each type. Its position is the value of ``TYPE``. The last is fmi2Boolean."""
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
"""Elements of ``state``, which shows the progress of the loop at any time.

``POINT`` is the communication point, ``ROWS`` the number of recorded rows, ``WARNINGS`` the number of calls with a
status other than OK. ``CALLING`` is the number (``call_number``) of the present or last FMI call; -1 outside of the
loop. ``REASON`` says why the loop stopped; ``STATUS``, ``FAILED_LINK`` and ``FAILED_SLOT`` give the details.
``LAST_TIME`` holds the bits of a double: lastSuccessfulTime of the last fmi3DoStep.
"""
STATE_LENGTH = 9
"""Number of elements of ``state``."""

DONE, CALL_FAILED, NOT_FINITE, OUT_OF_RANGE, TERMINATED, RETURNED_EARLY = range(6)
"""The reasons why the loop stopped, in this order:

- it did not stop;
- a call returned ``STATUS``;
- connection ``FAILED_LINK`` carries a value that is not finite;
- the value for slot ``FAILED_SLOT`` does not fit its type;
- fmi3DoStep asked to terminate;
- fmi3DoStep returned early.
"""

Numbers = NDArray[np.int64]
Unsigned = NDArray[np.uint64]
Reals = NDArray[np.float64]
Row = dict[int, int]
"""A row of a program: column -> number. Missing columns are 0."""


def call_number(instance: int, function: str) -> int:
    """The value of ``state[CALLING]`` while ``function`` is called on instance number ``instance``."""
    return instance * len(FUNCTIONS) + FUNCTIONS.index(function)


def call_of(state: Numbers) -> tuple[int, str] | None:
    """The instance number and the function name of the present or failed call; None outside of the loop."""
    number = int(state[CALLING])
    return None if number < 0 else (number // len(FUNCTIONS), FUNCTIONS[number % len(FUNCTIONS)])


class Advance(Protocol):
    """A loop, compiled or in Python."""

    def __call__(  # noqa: PLR0917 (the loop works on all of them)
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
        """Run from communication point ``state[POINT]`` to ``end``. Returns False if the loop stopped early.

        ``program``: its rows, one after the other. The first ``split`` rows are for a communication point, the others
        for the step to the next point. ``links``: connections of ``LINK_TYPE``. ``clock``: start time and step size in
        s. ``rows`` (shape: points, recorded variables) gets the ``recorded`` slots of ``values`` at every
        ``decimation``-th point.
        The rows for point ``end`` are left to the next call. Only if ``end`` is ``last``, the last point of the run,
        they are executed now, and no step follows.
        With ``check``, a value on a connection stops the loop before it is used if it is not finite or does not fit the
        type of its input. Without ``check``, a value that does not fit is replaced by the nearest value that does.
        ``state`` may be in memory that another process watches.
        """
        ...


@cache
def compiled() -> Advance | None:
    """The compiled loop. If there is none for this machine, returns None and logs a warning (only once)."""
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
    """The path of the compiled loop for this machine, whether it exists or not."""
    source = Path(__file__).with_name("loop.c")
    ending = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")
    digest = sha256(source.read_bytes()).hexdigest()[:12]
    places = [source.with_name(f"loop-{digest}-{folder}{ending}") for folder in platform_folders()]
    return next((place for place in places if place.exists()), places[0])


def array(rows: list[Row]) -> Unsigned:
    """The rows of a program as one array of numbers."""
    program = np.zeros((len(rows), PROGRAM_COLUMNS), dtype=np.uint64)
    for number, row in enumerate(rows):
        for column, value in {**row, ACT: _act(row)}.items():
            program[number, column] = value * LINK_TYPE.itemsize if column in (LINK, LINKS) else value
    return program.reshape(-1)


def _act(row: Row) -> int:
    """The act of a row. An ``EXCHANGE`` that fits one of the fast paths gets the act of this path."""
    act = row.get(ACT, NOTHING)
    if act == EXCHANGE and row[FMI] == 2 and row[TYPE] == FLOAT64:
        if not row.get(STEP):
            return CALL_REAL
        if not row[SET] and not row.get(LINKS) and row[MULTIPLE] == 1:
            return STEP_GET_REAL
    return act
