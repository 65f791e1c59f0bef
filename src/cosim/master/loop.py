"""The compiled inner loop: it calls the FMI functions of loaded libraries by their addresses.

What a step does is data: ``program`` has one row an FMI call, first those at a communication point, then those from
it to the next. Everything is in arrays of plain numbers, so one compiled version serves every system. The loop holds
no lock: threads may run systems side by side, and an FMU may call back into Python (log messages) while it runs.

``values`` holds all signals as doubles, the inputs of an instance side by side, and its outputs, so that Real calls
read and write it in place. Integer and Boolean signals go through ``integers``, which has the same layout.

``kernel`` is compiled with numba once; its machine code is kept on disk and loaded with llvmlite alone, because
importing numba takes longer than everything else before the first step.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import sys
import tempfile
import threading
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

llvm: Any = import_module("llvmlite.binding")


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


Unsigned = NDArray[np.uint64]


Reals = NDArray[np.float64]


def advance(  # noqa: PLR0917 (all of it is what the loop works on)
    program: Unsigned,
    split: int,
    sources: Unsigned,
    factors: Reals,
    offsets: Reals,
    values: Reals,
    integers: NDArray[np.int32],
    recorded: Unsigned,
    rows: Reals,
    clock: Reals,
    state: NDArray[np.int64],
    *,
    end: int,
    last: int,
    decimation: int,
) -> bool:
    """Go on from communication point ``state[POINT]`` to ``end``; False if an FMI call failed.

    ``program`` holds its rows one behind the other, ``split`` of them for a communication point, the others to step
    to the next. A connection sets ``factor*values[source] + offset``; ``clock`` is start time and step size. ``rows``
    gets the ``recorded`` slots at every ``decimation``-th point. Point ``end`` is left to the next call, except for
    the ``last`` one of the run, from which nothing steps any more.
    """
    done = _machine_code().function(
        *(program.ctypes.data, program.size, split),
        *(array.ctypes.data for array in (sources, factors, offsets, values, integers, recorded)),
        *(recorded.size, rows.ctypes.data, clock[0], clock[1], state.ctypes.data, end, last, decimation),
    )
    return bool(done)


class _MachineCode:
    """The kernel in memory; ``engine`` owns it."""

    SIGNATURE = ctypes.CFUNCTYPE(
        ctypes.c_int32,
        *(ctypes.c_void_p, ctypes.c_uint64, ctypes.c_uint64),
        *([ctypes.c_void_p] * 6),
        *(ctypes.c_uint64, ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_void_p),
        *(ctypes.c_int64, ctypes.c_int64, ctypes.c_uint64),
    )

    def __init__(self) -> None:
        llvm.initialize_native_target()
        llvm.initialize_native_asmprinter()
        cpu, features = llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten()
        target = llvm.Target.from_default_triple()
        machine = target.create_target_machine(cpu=cpu, features=features, opt=3, codemodel="jitdefault")
        sources = b"".join(Path(__file__).with_name(f"{name}.py").read_bytes() for name in ("loop", "kernel"))
        versions = f"{version('numba')} {llvm.llvm_version_info} {target.triple} {cpu} {features}"
        key = hashlib.sha256(sources + versions.encode()).hexdigest()[:16]
        self.name, code = _load(key) or _compile(machine, key)
        self.engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)
        self.engine.add_object_file(llvm.ObjectFileRef.from_data(code))
        self.engine.finalize_object()
        self.function = self.SIGNATURE(self.engine.get_function_address(self.name))


_LOCK = threading.Lock()


_loaded: list[_MachineCode] = []


def _machine_code() -> _MachineCode:
    with _LOCK:
        if not _loaded:
            _loaded.append(_MachineCode())
        return _loaded[0]


def _compile(machine: Any, key: str) -> tuple[str, bytes]:
    """Name and object code of the kernel; kept under ``key`` where a folder can be written."""
    name, text = import_module("cosim.master.kernel").compiled()
    code = bytes(machine.emit_object(llvm.parse_assembly(text)))
    content = f"{name}\n".encode() + code
    for folder in _folders():
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.NamedTemporaryFile(dir=folder, delete=False) as file:
                file.write(hashlib.sha256(content).digest() + content)
            os.replace(file.name, folder / f"kernel-{key}.bin")
        except OSError:
            continue
        break
    return name, code


def _load(key: str) -> tuple[str, bytes] | None:
    """What ``_compile`` has kept under ``key``, None if that is not there or damaged."""
    for folder in _folders():
        try:
            content = (folder / f"kernel-{key}.bin").read_bytes()
        except OSError:
            continue
        digest, content = content[:32], content[32:]
        if hashlib.sha256(content).digest() == digest:
            name, _, code = content.partition(b"\n")
            return name.decode(), code
    return None


def _folders() -> tuple[Path, ...]:
    """Where machine code is kept: with Python's own compiled files, else in the user's cache."""
    if sys.platform == "win32":
        user = Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local"))
    elif sys.platform == "darwin":
        user = Path.home() / "Library" / "Caches"
    else:
        user = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return Path(__file__).with_name("__pycache__"), user / "motion-cosim"


CALLING = 7


def prepare() -> None:
    _machine_code()


def call_of(state: NDArray[np.int64]) -> tuple[int, str] | None:
    return None
