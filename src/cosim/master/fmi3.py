"""An instance of an FMU of FMI 3.0.

Event mode is not used, though many FMUs offer it. Without it, an FMU handles its events within fmi3DoStep, as an FMU of
FMI 2.0 does. Therefore a system gives the same results with FMUs of either version.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterable, Mapping, Sequence
from importlib import import_module
from typing import Any, ClassVar

from ..fmu.variables import Variable
from . import loop
from .instance import FmuInstance, value_references

fmi3: Any = import_module("fmpy.fmi3")


class Fmi3Instance(FmuInstance):
    """An instance on FMPy's FMU3Slave. FMI 3.0 sets and gets arrays as a whole; here, each element has a name."""

    prefix = "fmi3"
    types: ClassVar[Mapping[str, int]] = loop.FMI3_TYPES
    _state = "FMUState"
    _instantiating = "fmi3InstantiateCoSimulation"

    def _bind(self) -> Any:
        return fmi3.FMU3Slave(
            guid=self.fmu.guid,
            modelIdentifier=self.fmu.identifier,
            unzipDirectory=str(self._folder),
            instanceName=self.name,
        )

    def _instantiate(self) -> None:
        log = self.log

        def receive(environment: int | None, status: int, category: bytes | None, message: bytes | None) -> None:
            log.add(status, (category or b"").decode("utf-8", "replace"), (message or b"").decode("utf-8", "replace"))

        self._slave.instantiate(loggingOn=True, eventModeUsed=False, earlyReturnAllowed=False, logMessage=receive)

    def enter_initialization(self, start: float, stop: float, tolerance: float) -> None:
        self.call("fmi3EnterInitializationMode", tolerance > 0.0, tolerance, start, True, stop)

    def terminated_at(self) -> float | None:
        return None  # fmi3DoStep has an output argument for this

    def set_all(self, values: Mapping[str, Any]) -> None:
        """Set variables by name. If only some elements of an array are given, the others get their start values.

        Raises CallError.
        """
        for kind, group in self._grouped(values).items():
            for variable, elements in self._wholes(group):
                default: Any = "" if kind == "String" else 0
                given = [values.get(element.name, element.start) for element in elements]
                self._set(kind, variable, [default if value is None else value for value in given])

    def set(self, variable: Variable, value: Any) -> None:
        """Set one variable. If it is an array element, the other elements keep their values. Raises CallError."""
        if not variable.whole:
            self._set(variable.passed_as, variable, [value])
            return
        numbers = list(self._get(variable))
        numbers[variable.whole.index(variable.name)] = value
        self._set(variable.passed_as, variable, numbers)

    def get(self, variable: Variable) -> float:
        place = variable.whole.index(variable.name) if variable.whole else 0
        return float(self._get(variable)[place])

    def get_all(self, names: Iterable[str]) -> dict[str, float]:
        found: dict[str, float] = {}
        for variable, elements in self._wholes([self.fmu.variables[name] for name in names]):
            found.update(zip((e.name for e in elements), map(float, self._get(variable)), strict=True))
        return found

    def derivatives(self, unknowns: Sequence[Variable], known: Variable) -> Sequence[float]:
        rows = self._wholes(unknowns)
        elements = [element.name for _, whole in rows for element in whole]
        found = (ctypes.c_double * len(elements))()
        columns = known.whole or (known.name,)
        seed = (ctypes.c_double * len(columns))(*(float(name == known.name) for name in columns))
        references = value_references([variable for variable, _ in rows])
        column = value_references([known])
        self.call(
            *("fmi3GetDirectionalDerivative", references, len(rows), column, 1),
            *(seed, len(columns), found, len(elements)),
        )
        by_name = dict(zip(elements, found, strict=True))
        return [by_name[variable.name] for variable in unknowns]

    def _buffer(self, kind: str, values: Sequence[Any]) -> Any:
        if kind == "Boolean":
            return (ctypes.c_bool * len(values))(*values)
        return super()._buffer(kind, values)

    def _set(self, kind: str, variable: Variable, values: Sequence[Any]) -> None:
        self.call(f"fmi3Set{kind}", value_references([variable]), 1, self._buffer(kind, values), len(values))

    def _get(self, variable: Variable) -> Any:
        """The value of a variable, or all values of the array that it belongs to."""
        buffer = self._buffer(variable.passed_as, [0] * max(len(variable.whole), 1))
        self.call(f"fmi3Get{variable.passed_as}", value_references([variable]), 1, buffer, len(buffer))
        return buffer

    def _wholes(self, group: Iterable[Variable]) -> list[tuple[Variable, tuple[Variable, ...]]]:
        return wholes(self.fmu.variables, group)


def wholes(variables: Mapping[str, Variable], group: Iterable[Variable]) -> list[tuple[Variable, tuple[Variable, ...]]]:
    """One entry for each value reference: a variable of the group, and all elements of its array (or itself)."""
    found: dict[str, tuple[Variable, tuple[Variable, ...]]] = {}
    for variable in group:
        names = variable.whole or (variable.name,)
        found.setdefault(names[0], (variable, tuple(variables[name] for name in names)))
    return list(found.values())
