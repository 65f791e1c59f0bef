"""The list ``connections``: reads its entries and checks that the two ends of a connection fit."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, cast

from ..errors import listed, suggest
from ..fmu.variables import Variable, suggest_variable
from ..units import Unit
from .findings import Findings
from .parts import Connection, Noise, Ports, SignalSource
from .values import decimal, fraction, show_value

ACCEPTED_TYPES = {
    "Real": ("Real", "Integer", "Enumeration", "Boolean"),
    "Integer": ("Integer", "Enumeration", "Boolean"),
    "Boolean": ("Boolean",),
    "Enumeration": ("Enumeration", "Integer"),
}
"""For each input type, the output types it accepts (lossless conversions only)."""
ROUNDED = 5e-4
"""Largest relative difference of a rounded conversion from the exact one: 0.1047 for 0.10472 is rounded, 273 for 273.15
is not."""
SHOWN_CONNECTIONS = 3
"""Largest number of connections that a note lists."""
SHOWN_ITEMS = 6
"""Largest number of items of an enumeration that a note lists."""
KEYS = ("from", "to", "factor", "factors", "offset", "units", "noise")


def read_connections(
    document: Mapping[str, Any], ports: Mapping[str, Ports], findings: Findings
) -> tuple[Connection, ...]:
    """The connections of a document; a sum gives one connection for each addend.

    Connections of an instance or a signal that could not be read are left out.
    """
    value = document.get("connections", [])
    if isinstance(value, str) or not isinstance(value, Sequence):
        findings.problem("connections", 'must be a list, such as ["a.y -> b.u"].')
        return ()
    declared = {**findings.table(document, "instances"), **findings.table(document, "signals")}
    result: list[Connection] = []
    taken: dict[tuple[str, str], Connection] = {}
    for number, item in enumerate(cast("Sequence[object]", value), 1):
        connections = _connections(f"connections, number {number}", item, findings)
        result += [c for given in connections if (c := _checked(given, ports, declared, findings)) is not None]
        for connection in connections[:1]:
            if connection.target in taken:
                target, first = ".".join(connection.target), ".".join(taken[connection.target].source)
                findings.problem(
                    f"connection {connection}",
                    f"input '{target}' is connected already, to '{first}'. Keep one. For their sum, write: "
                    f'{{ from = ["{first}", "{".".join(connection.source)}"], to = "{target}" }}.',
                )
            taken.setdefault(connection.target, connection)
    _same_seeds(result, findings)
    _missing_units(result, ports, findings)
    return tuple(result)


def _same_seeds(connections: Sequence[Connection], findings: Findings) -> None:
    """Note each seed that two inputs share: their noise is the same."""
    seeds: dict[int, Connection] = {}
    for connection in connections:
        if connection.noise is None:
            continue
        first = seeds.setdefault(connection.noise.seed, connection)
        if first is not connection:
            findings.note(
                f"connection {connection}",
                f"noise of the same seed as that of {first}: both are the same numbers. Give another seed.",
            )


def _missing_units(connections: Sequence[Connection], ports: Mapping[str, Ports], findings: Findings) -> None:
    """Note the connections of which one end has a unit and the other has none: nothing can be checked or converted.

    A number without a unit fits ``1``. For a record, the note says where its unit is written.
    """
    found: list[str] = []
    for connection in connections:
        (name, variable), (other, other_variable) = connection.source, connection.target
        unit, wanted = ports[name].variables[variable].unit, ports[other].variables[other_variable].unit
        if connection.units != "same" or (unit is None) == (wanted is None) or "1" in (unit, wanted):
            continue
        if isinstance(ports[name], SignalSource):
            findings.note(
                f"connection {connection}",
                f"nothing says the unit of '{variable}': its values are taken as {wanted}. Say it in "
                f'signals.{name}.columns: unit = "{wanted}".',
            )
        else:
            units = unit or "no unit", wanted or "no unit"
            found.append(f"{connection} ({units[0]} -> {units[1]})")
    if found:
        shown = listed(found, SHOWN_CONNECTIONS)
        findings.note(
            "connections", f"the FMU states no unit at one end, so values are passed on as they are: {shown}."
        )


# One entry


def _connections(where: str, item: object, findings: Findings) -> list[Connection]:
    """The connections of an entry: one, or one for each source of a sum; none if something is wrong."""
    if isinstance(item, str):
        ends: tuple[object, object] | None = _ends(where, item, findings)
        table: Mapping[str, Any] = {}
    elif isinstance(item, Mapping):
        table = cast("Mapping[str, Any]", item)
        findings.known_keys(where, table, KEYS)
        ends = table.get("from"), table.get("to")
    else:
        findings.problem(where, "write a text 'a.y -> b.u' or a table { from = ..., to = ... }.")
        return []
    if ends is None:
        return []
    start, target = ends
    addends = cast("list[object]", start) if isinstance(start, list) else [start]
    if not addends or not all(isinstance(end, str) for end in (*addends, target)):
        findings.problem(
            where,
            'give both ends: { from = "a.y", to = "b.u", factor = 1.0, offset = 0.0 }. A sum: '
            '{ from = ["a.y", "c.y"], to = "b.u" }.',
        )
        return []
    names = cast("list[str]", addends)
    target = cast(str, target)
    before = len(findings.problems)
    offset = _finite(f"{where}, offset", table.get("offset", 0), findings)
    noise = _noise(f"{where}, noise", table["noise"], findings) if "noise" in table else None
    units = table.get("units")
    if units not in (None, "convert", "suppress"):
        findings.problem(f"{where}, units", f'{show_value(units)}: give "convert" or "suppress".')
    if any("." not in end for end in (*names, target)):
        findings.problem(where, f"'{', '.join(names)} -> {target}': write INSTANCE.VARIABLE at both ends.")
    if isinstance(start, list):
        factors = _factors(where, table, len(names), findings)
        for name in sorted({name for name in names if names.count(name) > 1}):
            findings.problem(where, f"'{name}' is in the sum {names.count(name)} times. Name it once, with a factor.")
    else:
        factors = [_finite(f"{where}, factor", table.get("factor", 1), findings)]
        if "factors" in table:
            findings.problem(f"{where}, factors", "belongs to a sum, from = [...]. For one source, write factor.")
    if len(findings.problems) > before:
        return []
    result: list[Connection] = []
    for name, factor in zip(names, factors, strict=True):
        # In a sum, a factor of 1 or -1 is only a sign and does not convert units.
        given = abs(factor) != 1.0 if isinstance(start, list) else "factor" in table
        how = "converted" if units == "convert" else "given" if given else "suppressed" if units else "same"
        stated = factor, 0.0 if result else offset
        ends = _split(name), _split(target)
        result.append(Connection(*ends, *stated, how, stated, added=bool(result), noise=None if result else noise))
    return result


def _split(end: str) -> tuple[str, str]:
    name, _, variable = end.partition(".")
    return name, variable


def _finite(where: str, value: object, findings: Findings) -> float:
    number = decimal(value)
    if number is None or not number.is_finite() or isinstance(value, str):
        findings.problem(where, f"{show_value(value)} is not a finite number.")
        return 0.0
    return float(number)


def _factors(where: str, table: Mapping[str, Any], count: int, findings: Findings) -> list[float]:
    """The factors of a sum; all are 1 if none are given."""
    if "factor" in table:
        findings.problem(f"{where}, factor", "a sum has a factor for each source: write factors = [1.0, -1.0].")
    value = table.get("factors", [1] * count)
    if not isinstance(value, list) or len(cast("list[object]", value)) != count:
        findings.problem(f"{where}, factors", f"must be a list of {count} numbers, one a source.")
        return [0.0] * count
    return [_finite(f"{where}, factors", factor, findings) for factor in cast("list[object]", value)]


def _noise(where: str, value: object, findings: Findings) -> Noise | None:
    if not isinstance(value, Mapping):
        findings.problem(where, "must be a table: noise = { rms = 2e-9, seed = 1 }, rms in the unit of the input.")
        return None
    table = cast("Mapping[str, Any]", value)
    findings.known_keys(where, table, ("rms", "seed"))
    missing = [key for key in ("rms", "seed") if key not in table]
    if missing:
        findings.problem(where, f"{' and '.join(missing)} missing: noise = {{ rms = 2e-9, seed = 1 }}.")
        return None
    before = len(findings.problems)
    rms = _finite(f"{where}.rms", table["rms"], findings)
    if rms < 0.0:
        findings.problem(f"{where}.rms", f"{rms:g} must not be negative.")
    seed = table["seed"]
    number = fraction(seed) if not isinstance(seed, str) else None
    if number is None or number.denominator != 1 or number < 0:
        findings.problem(f"{where}.seed", f"{show_value(seed)}: give a whole number of at least 0.")
        return None
    return Noise(rms, int(number)) if len(findings.problems) == before else None


def _ends(where: str, text: str, findings: Findings) -> tuple[str, str] | None:
    """The two ends of a connection written as an arrow; None if there was a problem.

    Names may contain blanks. A name that contains an arrow needs the form with ``from`` and ``to``.
    """
    parts = text.split("->")
    if len(parts) > 2:
        findings.problem(
            where,
            f"'{text}' has more than one arrow. Write one connection an entry; if a name holds an arrow, write "
            '{ from = "a.y", to = "b.u" }.',
        )
        return None
    if len(parts) < 2 or not all(part.strip() for part in parts):
        findings.problem(where, f"cannot read '{text}'. Write it like 'controller.command -> plant.command'.")
        return None
    return parts[0].strip(), parts[1].strip()


# Both ends


def _checked(
    connection: Connection, ports: Mapping[str, Ports], declared: Mapping[str, Any], findings: Findings
) -> Connection | None:
    """The connection with its conversion of units; None if a problem was found or an instance could not be read."""
    where = f"connection {connection}"
    before = len(findings.problems)
    found: list[Variable] = []
    for (name, variable), causality in ((connection.source, "output"), (connection.target, "input")):
        if name not in ports:
            if name not in declared:
                findings.problem(where, f"no instance '{name}'.{suggest(name, declared)}")
            continue
        fmu = ports[name]
        known = fmu.outputs if causality == "output" else fmu.inputs
        if variable in known:
            found.append(fmu.variables[variable])
        elif variable in fmu.variables:
            what = fmu.variables[variable].causality
            findings.problem(
                where,
                f"'{name}.{variable}' is of causality {what}; the {'left' if causality == 'output' else 'right'} "
                f"end must be an {causality}." + (f" Known: {', '.join(known)}." if 0 < len(known) <= 12 else ""),
            )
        elif causality == "input" and isinstance(fmu, SignalSource):
            findings.problem(where, f"'{name}' is a record: nothing can be connected to it.")
        else:
            what = "column" if isinstance(fmu, SignalSource) else causality
            fitting = (fmu.variables[each] for each in known)
            hint = _missing_derivative(fmu, variable) or suggest_variable(variable, fitting)
            findings.problem(where, f"{fmu.name} has no {what} '{variable}'.{hint}")
    if len(findings.problems) > before or len(found) < 2:
        return None
    source, target = found
    if source.type not in ACCEPTED_TYPES.get(target.type, ()):
        findings.problem(where, f"an output of type {source.type} cannot feed an input of type {target.type}.")
        return None
    if target.type == "Enumeration" and source.items != target.items:
        findings.note(where, f"its numbers choose items of {target.name}: {_items(target)}.")
    if (connection.factor != 1.0 or connection.offset != 0.0) and target.type != "Real":
        findings.problem(where, f"factor and offset need an input of type Real, not {target.type}.")
    if (connection.added or connection.noise is not None) and target.type != "Real":
        findings.problem(where, f"sums and noise need an input of type Real, not {target.type}.")
    ends = ports[connection.source[0]], ports[connection.target[0]]
    checked = _with_units(where, connection, (source, target), ends, findings)
    return checked if len(findings.problems) == before else None


def _items(variable: Variable) -> str:
    """The first items of an enumeration with their numbers."""
    return listed([f"{number} {name}" for name, number in variable.items.items()], SHOWN_ITEMS)


def _missing_derivative(port: Ports, variable: str) -> str:
    """A hint for ``der(x)`` or ``der(x,2)``, if the record has the column ``x`` without derivatives; else ""."""
    match = re.fullmatch(r"der\((?P<name>.+?)(,(?P<order>\d))?\)", variable)
    if match is None or not isinstance(port, SignalSource) or match["name"] not in port.outputs:
        return ""
    return f" Write derivatives = {match['order'] or 1} and smoothing in signals.{port.name}.columns.{match['name']}."


def _with_units(
    where: str,
    connection: Connection,
    variables: tuple[Variable, Variable],
    fmus: tuple[Ports, Ports],
    findings: Findings,
) -> Connection | None:
    """The connection with its conversion of units, if it asks for one; None if the units do not fit."""
    if connection.units == "suppressed":
        return connection
    unit, other = variables[0].unit, variables[1].unit
    if unit is None or other is None or is_same_unit(fmus[0], variables[0], fmus[1], variables[1]):
        return connection if connection.units == "given" else replace(connection, units="same")
    one, two = known = meaning(fmus[0], variables[0]), meaning(fmus[1], variables[1])
    factors = None if one is None or two is None else one.conversion(two)
    if variables[0].relative != variables[1].relative and any(meant and meant.offset for meant in known):
        factors = None  # a temperature is no difference of temperatures
    if connection.units == "given":
        if factors is not None:
            compare_numbers(where, connection.stated, (unit, other), factors, 'add units = "convert"', findings)
        return connection
    if connection.units == "converted" and factors is not None:
        return converted(connection, *factors)
    names = [f"{name} ({known[i]})" if unit == other else name for i, name in enumerate((unit, other))]
    remedy = _remedy(connection, unit, other, known, factors)
    findings.problem(where, f"unit {names[0]} does not match {names[1]}. {remedy}")
    return None


def compare_numbers(  # noqa: PLR0917
    where: str,
    numbers: tuple[float, float],
    units: tuple[str, str],
    conversion: tuple[float, float],
    remedy: str,
    findings: Findings,
) -> None:
    """Note a factor and an offset that do not do what the conversion of the units would do: a ratio may be meant."""
    factor, offset = numbers
    same_offset = conversion[1] == 0.0 or math.isclose(offset, conversion[1], rel_tol=ROUNDED)
    if factor != 0.0 and not (math.isclose(abs(factor), abs(conversion[0]), rel_tol=ROUNDED) and same_offset):
        findings.note(
            where,
            f"{_numbers(numbers)} is all that is done from {units[0]} to {units[1]}; the units alone convert "
            f"by {_numbers(conversion)}. If the numbers are meant beside that, {remedy}.",
        )


def _numbers(numbers: tuple[float, float]) -> str:
    return f"factor = {numbers[0]:.6g}" + (f", offset = {numbers[1]:.6g}" if numbers[1] else "")


def meaning(port: Ports, variable: Variable) -> Unit | None:
    """The meaning of a variable's unit; None if it is unknown."""
    return unit_of_values(None if variable.unit is None else port.unit(variable.unit), variable)


def unit_of_values(unit: Unit | None, variable: Variable) -> Unit | None:
    """``unit`` for the values of a variable: a difference has no offset."""
    return unit.difference if unit is not None and variable.relative else unit


def is_same_unit(one: Ports, variable: Variable, other: Ports, other_variable: Variable) -> bool:
    """Whether two variables have the same unit. Definitions of units decide; if one is not known, names."""
    a, b = meaning(one, variable), meaning(other, other_variable)
    if a is None or b is None:
        return variable.unit == other_variable.unit
    return a.matches(b.with_angles_of(a) if variable.unit == other_variable.unit else b)


def converted(connection: Connection, factor: float, offset: float) -> Connection:
    """The connection with a conversion of units by ``factor`` and ``offset``.

    Values are converted first; then its own factor and offset act (SSP 1.0, LinearTransformation).
    """
    stated_factor, stated_offset = connection.stated
    return replace(
        connection, units="converted", factor=stated_factor * factor, offset=stated_factor * offset + stated_offset
    )


def _remedy(
    connection: Connection,
    unit: str,
    other: str,
    known: tuple[Unit | None, Unit | None],
    factors: tuple[float, float] | None,
) -> str:
    """A sentence that says what to write so that a connection converts its units."""
    source, target = (".".join(end) for end in (connection.source, connection.target))
    if factors is not None:
        numbers = f"factor = {factors[0]!r}" + (f", offset = {factors[1]!r}" if factors[1] else "")
        shorter = ' Or write units = "convert" in place of numbers.'
        return f'To convert, write {{ from = "{source}", to = "{target}", {numbers} }}.{shorter}'
    unknown = [name for name, meaning in zip((unit, other), known, strict=True) if meaning is None]
    said = f"Nothing says what {' and '.join(unknown)} is. " if unknown else ""
    names = (unit, other) if unit != other else (str(known[0]), str(known[1]))
    numbers = f"factor = ... ({names[1]} per {names[0]})"
    return f'{said}To convert, write {{ from = "{source}", to = "{target}", {numbers} }}.'
