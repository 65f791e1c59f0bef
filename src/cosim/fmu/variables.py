"""The variables of an FMU of FMI 2.0 or 3.0. An array of FMI 3.0 becomes one variable for each element."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, cast

from ..errors import DescriptionError, suggest

Type = Literal["Real", "Integer", "Boolean", "String", "Enumeration", "Binary", "Clock"]
"""The types under their names in FMI 2.0; Binary and Clock exist only in FMI 3.0."""

Value = float | int | bool | str

MAX_VARIABLES = 2**20
"""Largest number of variables of an FMU, with every array element counted.

A larger number can only be an attempt to fill the memory.
"""


@dataclass(frozen=True)
class DisplayUnit:
    """``value in this unit = factor * value + offset``, or ``factor / value`` for an ``inverse`` unit of FMI 3.0."""

    name: str
    factor: float = 1.0
    offset: float = 0.0
    inverse: bool = False


@dataclass(frozen=True)
class Variable:
    """A scalar variable of an FMU, or an element of an array of FMI 3.0. Attributes are named as in FMI 2.0."""

    name: str
    reference: int
    type: Type
    passed_as: str
    """The type in the names of the FMI functions: ``Integer`` in fmi2SetInteger, ``Int64`` in fmi3SetInt64."""
    causality: str
    variability: str
    initial: str | None
    unit: str | None
    display_unit: DisplayUnit | None
    start: Value | None
    start_text: str | None
    min: float | None
    max: float | None
    description: str
    items: Mapping[str, int]
    """Names and values of an Enumeration, empty for other types."""
    derivative_of: str | None = None
    """The name of the state, if this variable is its time derivative."""
    whole: tuple[str, ...] = ()
    """For an element of an array of FMI 3.0: the names of all elements of the array, in order. Else empty.

    An array of FMI 3.0 is set and read as a whole.
    """
    relative: bool = False
    """Whether it is a difference (relativeQuantity of FMI): offsets of its units, such as 273.15 K, do not count."""

    @property
    def settable(self) -> bool:
        """Whether a start value may be given before initialization."""
        if self.type in ("Binary", "Clock") or self.causality == "structuralParameter":
            return False
        if self.causality in ("parameter", "input"):
            return True
        return self.variability != "constant" and self.initial in ("exact", "approx")


def suggest_variable(
    name: str, chosen: Iterable[Variable], arrays: Iterable[str] = (), path: Path | None = None
) -> str:
    """The variable that ``name`` may stand for, by name or description; else where those of FMU ``path`` are listed.

    ``chosen`` are the variables that fit, ``arrays`` the names of whole arrays. Elements of arrays are meant only by
    names with an index.
    """
    known = {v.name: v.description for v in chosen if "[" in name or not v.name.endswith("]")} | dict.fromkeys(
        arrays, ""
    )
    return suggest(name, known, known) or ("" if path is None else f" Its variables: cosim info {path}")


def read_variables(model: Any, findings: list[str]) -> dict[str, Variable]:
    """The variables of FMPy's ModelDescription by name. Broken rules are appended to ``findings``.

    Different variables of one name are left out: the name would not tell which is meant.
    Raises DescriptionError for too many variables.
    """
    version, units = int(model.fmiMajorVersion), {unit.name: unit for unit in model.unitDefinitions}
    count = sum(math.prod(v.shape) for v in model.modelVariables)
    if count > MAX_VARIABLES:
        raise DescriptionError(f"{model.modelName}: {count} variables, at most {MAX_VARIABLES} are read.")
    found: dict[str, Variable] = {}
    twice: dict[str, None] = {}
    for v in model.modelVariables:
        if v.causality == "independent":
            continue
        for variable in _scalars(v, version, units, findings):
            other = found.setdefault(variable.name, variable)
            if (other.type, other.reference) != (variable.type, variable.reference):
                twice.update(dict.fromkeys((variable.name, *variable.whole, *other.whole)))
    findings += [f"more than one variable has the name '{name}'. Left out." for name in twice]
    return {name: variable for name, variable in found.items() if name not in twice}


def read_dependencies(
    model: Any, variables: Mapping[str, Variable]
) -> tuple[dict[str, tuple[str, ...]], frozenset[str]]:
    """The inputs on which each output depends directly, and the outputs for which the file does not say.

    These count as depending on all inputs.
    """
    inputs = tuple(v.name for v in variables.values() if v.causality == "input")
    version = int(model.fmiMajorVersion)

    def key(v: Any) -> tuple[str, int]:
        """Type and value reference. Only aliases of a variable have both in common."""
        return _passed_as(v.type, version), int(v.valueReference)

    stated: dict[tuple[str, int], tuple[str, ...]] = {}
    for unknown in model.outputs:
        if unknown.dependencies is not None:
            needed = {key(known) for known in unknown.dependencies}
            stated[key(unknown.variable)] = tuple(
                name for name in inputs if (variables[name].passed_as, variables[name].reference) in needed
            )
    outputs = {name: (v.passed_as, v.reference) for name, v in variables.items() if v.causality == "output"}
    unstated = frozenset(name for name, reference in outputs.items() if reference not in stated)
    return {name: stated.get(reference, inputs) for name, reference in outputs.items()}, unstated


_TYPES: dict[str, Type] = {
    "Float64": "Real",
    "Float32": "Real",
    **{f"{sign}Int{bits}": "Integer" for sign in ("", "U") for bits in (8, 16, 32, 64)},
}
"""FMI 3.0 types that have another name in FMI 2.0."""


def _passed_as(type_name: str, version: int) -> str:
    return ("Int64" if version == 3 else "Integer") if type_name == "Enumeration" else type_name


def _suffixes(shape: tuple[int, ...]) -> list[str]:
    """The indices behind the name for each element of an array, such as ``[1,2]``; the last index changes fastest.

    A scalar has one empty text.
    """
    if not shape:
        return [""]
    return [f"[{','.join(map(str, index))}]" for index in itertools.product(*(range(1, n + 1) for n in shape))]


def _scalars(v: Any, version: int, units: Mapping[str, Any], findings: list[str]) -> list[Variable]:
    """The scalar variables that a variable of the file stands for: itself, or the elements of an array."""
    kind = _TYPES.get(v.type, cast(Type, v.type))
    declared = v.declaredType

    def of(attribute: str) -> Any:
        own = getattr(v, attribute)
        return own if own is not None or declared is None else getattr(declared, attribute)

    unit = cast("str | None", of("unit")) if kind == "Real" else None
    display = cast("str | None", of("displayUnit")) if kind == "Real" else None
    relative = kind == "Real" and bool(of("relativeQuantity"))
    shown: DisplayUnit | None = None
    if display is not None and unit is not None and unit in units:
        for candidate in units[unit].displayUnits:
            if candidate.name == display:
                offset = 0.0 if relative else float(candidate.offset)
                shown = DisplayUnit(display, float(candidate.factor), offset, candidate.inverse)
    bounded = kind in ("Real", "Integer", "Enumeration")
    low, high = (_number(v.name, bound, of(bound), findings) if bounded else None for bound in ("min", "max"))
    items = {item.name: int(item.value) for item in declared.items} if kind == "Enumeration" and declared else {}
    suffixes = _suffixes(v.shape)
    whole = tuple(f"{v.name}{suffix}" for suffix in suffixes) if v.shape else ()
    starts = _starts(v, len(suffixes), findings)
    return [
        Variable(
            name=f"{v.name}{suffix}",
            reference=int(v.valueReference),
            type=kind,
            passed_as=_passed_as(v.type, version),
            causality=v.causality,
            variability=v.variability,
            initial=v.initial,
            unit=unit,
            display_unit=shown,
            start=_start(v.name, kind, start, findings),
            start_text=start,
            min=low,
            max=high,
            description=v.description or "",
            items=MappingProxyType(items),
            derivative_of=None if v.derivative is None else f"{v.derivative.name}{suffix}",
            whole=whole,
            relative=relative,
        )
        for suffix, start in zip(suffixes, starts, strict=True)
    ]


def _starts(v: Any, count: int, findings: list[str]) -> list[str | None]:
    """The text of the start value of each element. A single value in the file holds for all elements."""
    if v.start is None or not v.shape or v.type in ("String", "Binary"):
        return [v.start] * count
    given = v.start.split()
    if len(given) == 1:
        return given * count
    if len(given) != count:
        findings.append(f"variable '{v.name}' has {len(given)} start values for {count} elements. Left out.")
        return [None] * count
    return given


def _start(name: str, kind: Type, text: str | None, findings: list[str]) -> Value | None:
    if text is None or kind in ("String", "Binary", "Clock"):
        return text
    if kind == "Boolean":
        return text in ("true", "1")
    return _number(name, "start", text, findings, int if kind != "Real" else float)


def _number(name: str, attribute: str, text: str | None, findings: list[str], read: Any = float) -> Any:
    try:
        return None if text is None else read(text)
    except ValueError:
        findings.append(f"variable '{name}': {attribute} is '{text}', which is no number of its type. Left out.")
        return None
