"""An FMU instance driven by names, through FMPy's binding; messages are collected."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import fmpy
from fmpy.fmi2 import FMU2Slave, fmi2CallbackFunctions, fmi2CallbackLoggerTYPE

OK, WARNING, DISCARD, ERROR = range(4)


class Instance:
    """One instance of an FMU file; ``status`` calls return the FMI status instead of raising."""

    def __init__(self, path: Path, name: str = "test", *, logging: bool = True, guid: str | None = None) -> None:
        self.folder = TemporaryDirectory()
        fmpy.extract(path, unzipdir=self.folder.name)
        self.description = fmpy.read_model_description(path)
        self.variables = {v.name: v for v in self.description.modelVariables}
        self.messages: list[str] = []
        self.fmu = FMU2Slave(
            guid=self.description.guid if guid is None else guid,
            unzipDirectory=self.folder.name,
            modelIdentifier=self.description.coSimulation.modelIdentifier,
            instanceName=name,
        )
        self._log = fmi2CallbackLoggerTYPE(self._collect)
        self.callbacks = fmi2CallbackFunctions(logger=self._log)
        self.logging = logging

    def _collect(self, _: object, name: bytes, status: int, category: bytes, message: bytes) -> None:
        self.messages.append(f"{name.decode()}: {message.decode()}")

    def __enter__(self) -> Instance:
        try:
            self.fmu.instantiate(callbacks=self.callbacks, loggingOn=self.logging)
        except Exception:
            self.folder.cleanup()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.fmu.freeInstance()
        self.folder.cleanup()

    def reference(self, name: str) -> int:
        return self.variables[name].valueReference

    def status(self, function: str, *arguments: Any) -> int:
        """Call ``fmi2FUNCTION`` with the component and raw arguments."""
        raw = self.fmu.dll[f"fmi2{function}"]  # a function object of its own, FMPy keeps its prototype
        raw.restype = ctypes.c_int
        return raw(ctypes.c_void_p(self.fmu.component), *arguments)

    def set_status(self, name: str, value: float) -> int:
        """Status of setting one variable."""
        kind, ctype = {
            "Real": ("Real", ctypes.c_double),
            "Integer": ("Integer", ctypes.c_int),
            "Enumeration": ("Integer", ctypes.c_int),
            "Boolean": ("Boolean", ctypes.c_int),
        }[self.variables[name].type]
        references = (ctypes.c_uint * 1)(self.reference(name))
        return self.status(
            f"Set{kind}", references, ctypes.c_size_t(1), (ctype * 1)(value if kind == "Real" else int(value))
        )

    def set(self, values: Mapping[str, float]) -> None:
        for name, value in values.items():
            status = self.set_status(name, value)
            assert status == OK, self.messages

    def get(self, names: Iterable[str]) -> list[float]:
        found: list[float] = []
        for name in names:
            kind = self.variables[name].type
            read = {"Real": self.fmu.getReal, "Boolean": self.fmu.getBoolean}.get(kind, self.fmu.getInteger)
            found.append(read([self.reference(name)])[0])
        return found

    def names(self, causality: str) -> list[str]:
        return [v.name for v in self.description.modelVariables if v.causality == causality]

    def initialize(
        self, values: Mapping[str, float] | None = None, *, start: float = 0.0, tolerance: float | None = None
    ) -> None:
        self.fmu.setupExperiment(tolerance=tolerance, startTime=start)
        self.set(values or {})
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()

    def step_status(self, time: float, step: float) -> int:
        return self.status("DoStep", ctypes.c_double(time), ctypes.c_double(step), ctypes.c_int(1))

    def step(self, time: float, step: float) -> None:
        status = self.step_status(time, step)
        assert status == OK, self.messages


def excite(fmu: Instance, k: int) -> None:
    """Set every input to a smooth function of the step."""
    fmu.set({name: 1e-3 * math.sin(0.1 * k + i) for i, name in enumerate(fmu.names("input"))})


def run(fmu: Instance, first: int, last: int, step: float) -> list[list[float]]:
    """Outputs, and what they answer to new inputs before the step."""
    rows: list[list[float]] = []
    outputs = fmu.names("output")
    for k in range(first, last):
        excite(fmu, k)
        rows.append(fmu.get(outputs))
        fmu.step(k * step, step)
        rows.append(fmu.get(outputs))
    return rows
