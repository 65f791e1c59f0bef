"""The table ``[instances]``: FMUs and their start values."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from ..errors import DescriptionError, listed
from ..fmu.description import Array, Fmu, read_fmu
from ..fmu.places import find_fmu
from ..fmu.variables import Value, Variable, suggest_variable
from .findings import Findings
from .parts import Instance
from .values import flat_table, in_unit_of, show_value, start_value

SHOWN_FINDINGS = 3
"""Largest number of findings about an FMU's file that become notes of the system."""

SHOWN_ELEMENTS = 6
"""Largest number of elements of an array that a message lists."""

NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")


@dataclass(frozen=True)
class Places:
    """Where FMUs are looked for."""

    folder: Path
    """The folder where relative paths of the document start."""
    fmus: Path | None
    """The folder of FMUs given by name; None: ``find_fmus`` looks for it."""


def read_instances(document: Mapping[str, Any], places: Places, findings: Findings) -> dict[str, Instance]:
    """The instances of a document, by name. An instance whose FMU cannot be read is left out and is a problem."""
    tables = findings.table(document, "instances")
    if not tables:
        findings.problem("instances", 'none given. Write [instances.NAME] with fmu = "...".')
    result: dict[str, Instance] = {}
    used: dict[Path, str] = {}
    for name, table in tables.items():
        where = f"instances.{name}"
        if not NAME.fullmatch(name):
            findings.problem(where, "an instance's name is made of letters, digits and _, and starts with no digit.")
            continue
        if not isinstance(table, Mapping):
            findings.problem(where, f"must be a table: write [instances.{name}].")
            continue
        items = cast("Mapping[str, Any]", table)
        findings.known_keys(where, items, ("fmu", "start", "step_multiple"))
        multiple = findings.count(f"{where}.step_multiple", items.get("step_multiple", 1))
        fmu = _fmu(f"{where}.fmu", items.get("fmu"), places, findings)
        if fmu is None:
            continue
        if fmu.once_per_process and fmu.path in used:
            findings.problem(where, f"{fmu.name} allows one instance a process; {used[fmu.path]} is one already.")
        used[fmu.path] = name
        if fmu.needs_tool:
            tool = f" ({fmu.tool})" if fmu.tool else ""
            findings.note(where, f"{fmu.name} runs only where the tool that made it{tool} is installed.")
        result[name] = Instance(name, fmu, _starts(f"{where}.start", fmu, items.get("start", {}), findings), multiple)
    return result


def _fmu(where: str, value: object, places: Places, findings: Findings) -> Fmu | None:
    if not isinstance(value, str) or not value:
        findings.problem(where, "missing. Give the name of an FMU or a path to an .fmu file.")
        return None
    try:
        fmu = read_fmu(find_fmu(value, places.fmus, places.folder))
    except DescriptionError as error:
        for problem in error.problems:
            findings.problem(where, problem)
        return None
    for obstacle in fmu.obstacles:
        findings.problem(where, f"{fmu.path.name}: {obstacle}")
    for finding in _shortened(fmu):
        findings.note(where, f"{fmu.path.name}: {finding}")
    return None if fmu.obstacles else fmu


def _shortened(fmu: Fmu) -> list[str]:
    """The first findings about an FMU's file, and the number of the others.

    A tool that makes an error often makes it for all variables.
    """
    more = len(fmu.findings) - SHOWN_FINDINGS
    last = [f"and {more} more findings in it: cosim info {fmu.path}."] if more > 0 else []
    return [*fmu.findings[:SHOWN_FINDINGS], *last]


# Start values


def _starts(where: str, fmu: Fmu, value: object, findings: Findings) -> dict[str, Value]:
    if not isinstance(value, Mapping):
        findings.problem(where, "must be a table, such as start = { m = 62.4 }.")
        return {}
    result: dict[str, Value] = {}
    for name, given in flat_table(cast("Mapping[str, Any]", value)):
        if name in fmu.variables:
            _start(f"{where}.{name}", fmu, fmu.variables[name], given, result, findings)
        elif name in fmu.arrays:
            _array_start(f"{where}.{name}", fmu, fmu.arrays[name], given, result, findings)
        else:
            known = [v for v in fmu.variables.values() if v.settable]
            hint = suggest_variable(name, known, fmu.arrays, fmu.path)
            findings.problem(f"{where}.{name}", f"{fmu.name} has no variable '{name}'.{hint}")
    return result


def _array_start(  # noqa: PLR0917
    where: str, fmu: Fmu, array: Array, given: object, result: dict[str, Value], findings: Findings
) -> None:
    """Enter the start values of a whole array, given as a list, or as a list of rows for two dimensions."""
    if not array.shape:
        known = listed(array.elements, SHOWN_ELEMENTS)
        findings.problem(where, f"the array has gaps: its elements are {known}. Give each by its own name.")
        return
    size = " by ".join(str(n) for n in array.shape)
    try:
        values = list(_elements(given, array.shape))
    except _NoListError as error:
        form = " Write a list of rows: [[...], [...]]." if len(array.shape) > 1 else ""
        findings.problem(where, f"{error} is no list: {fmu.name} has an array of {size} elements here.{form}")
        return
    except _LengthError as error:
        findings.problem(where, f"{error} for an array of {size} elements.")
        return
    if twice := [element for element in array.elements if element in result]:
        findings.note(where, f"{listed(twice, SHOWN_ELEMENTS)} is given before the whole array, too: the array counts.")
    for element, item in zip(array.elements, values, strict=True):
        index = element.rpartition("[")[2]
        _start(f"{where}[{index}", fmu, fmu.variables[element], item, result, findings)


class _NoListError(Exception):
    """A value is not a list, but must be one."""


class _LengthError(Exception):
    """A list has another length than the dimension of the array."""


def _elements(given: object, shape: Sequence[int], row: str = "") -> Iterator[object]:
    """The values of nested lists, the last index fastest. Raises _NoListError or _LengthError."""
    if not shape:
        yield given
        return
    if isinstance(given, str | Mapping) or not isinstance(given, Iterable):
        raise _NoListError(show_value(cast(object, given)))
    rows = list(cast("Iterable[object]", given))
    if len(rows) != shape[0]:
        raise _LengthError(f"{len(rows)} values{row}")
    for item in rows:
        yield from _elements(item, shape[1:], " in a row")


def _start(  # noqa: PLR0917
    where: str, fmu: Fmu, variable: Variable, given: object, result: dict[str, Value], findings: Findings
) -> None:
    if not variable.settable:
        kind = f"{variable.type} {variable.causality}" if variable.type in ("Binary", "Clock") else variable.causality
        remedy = "Only parameters, inputs and initial states can be set."
        findings.problem(where, f"a {variable.variability} {kind} cannot be set. {remedy}")
        return
    given, problem = in_unit_of(fmu, variable, given)
    value = None
    if not problem:
        value, problem = start_value(variable, given)
    if problem:
        findings.problem(where, problem)
    elif value is not None:
        result[variable.name] = value
