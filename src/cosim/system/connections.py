"""The list ``connections``: its forms, and what the two ends must have in common."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, cast

from ..errors import suggest
from ..fmu.description import Fmu
from ..fmu.variables import Variable
from ..units import Unit
from .findings import Findings
from .parts import Connection, Instance
from .values import decimal, show_value

ACCEPTED_TYPES = {
    "Real": ("Real", "Integer", "Enumeration", "Boolean"),
    "Integer": ("Integer", "Enumeration", "Boolean"),
    "Boolean": ("Boolean",),
    "Enumeration": ("Enumeration", "Integer"),
}
"""For each input type, the output types it accepts (lossless conversions only)."""


KEYS = ("from", "to", "factor", "offset", "units")


def read_connections(
    document: Mapping[str, Any], instances: Mapping[str, Instance], findings: Findings
) -> tuple[Connection, ...]:
    """The connections of a document between the instances that could be read."""
    value = document.get("connections", [])
    if isinstance(value, str) or not isinstance(value, Sequence):
        findings.problem("connections", 'must be a list, such as ["a.y -> b.u"].')
        return ()
    declared = findings.table(document, "instances")
    result: list[Connection] = []
    taken: dict[tuple[str, str], Connection] = {}
    for number, item in enumerate(cast("Sequence[object]", value), 1):
        connection = _connection(f"connections, number {number}", item, findings)
        if connection is None:
            continue
        checked = _checked(connection, instances, declared, findings)
        if checked is not None:
            result.append(checked)
        if connection.target in taken:
            findings.problem(
                f"connection {connection}",
                f"input '{'.'.join(connection.target)}' is connected already, to "
                f"'{'.'.join(taken[connection.target].source)}'. Keep one.",
            )
        taken.setdefault(connection.target, connection)
    return tuple(result)


# One entry


def _connection(where: str, item: object, findings: Findings) -> Connection | None:
    if isinstance(item, str):
        ends: tuple[object, object] | None = _ends(where, item, findings)
        table: Mapping[str, Any] = {}
    elif isinstance(item, Mapping):
        table = cast("Mapping[str, Any]", item)
        findings.known_keys(where, table, KEYS)
        ends = table.get("from"), table.get("to")
    else:
        findings.problem(where, "write a text 'a.y -> b.u' or a table { from = ..., to = ... }.")
        return None
    if ends is None:
        return None
    source, target = ends
    if not isinstance(source, str) or not isinstance(target, str):
        findings.problem(where, 'give both ends: { from = "a.y", to = "b.u", factor = 1.0, offset = 0.0 }.')
        return None
    stated: list[float] = []
    for key, default in (("factor", 1), ("offset", 0)):
        number = decimal(table.get(key, default))
        if number is None or not number.is_finite() or isinstance(table.get(key), str):
            findings.problem(f"{where}, {key}", f"{show_value(table.get(key))} is not a finite number.")
            return None
        stated.append(float(number))
    units = table.get("units")
    if units not in (None, "convert", "suppress"):
        findings.problem(f"{where}, units", f'{show_value(units)}: give "convert" or "suppress".')
        return None
    if "." not in source or "." not in target:
        findings.problem(where, f"'{source} -> {target}': write INSTANCE.VARIABLE at both ends.")
        return None
    a, _, b = source.partition(".")
    c, _, d = target.partition(".")
    factor, offset = stated
    how = "converted" if units == "convert" else "given" if "factor" in table else "suppressed" if units else "same"
    return Connection((a, b), (c, d), factor, offset, how, (factor, offset))


def _ends(where: str, text: str, findings: Findings) -> tuple[str, str] | None:
    """The two ends of an arrow; names may have blanks, but an arrow in a name needs the other form."""
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


def arrow(connection: Connection) -> str | None:
    """``a.y -> b.u`` for ends that ``read_connections`` reads back from it, else None."""
    source, target = (".".join(end) for end in (connection.source, connection.target))
    plain = all("->" not in end and end == end.strip() for end in (source, target))
    return f"{source} -> {target}" if plain else None


# Both ends


def _checked(
    connection: Connection, instances: Mapping[str, Instance], declared: Mapping[str, Any], findings: Findings
) -> Connection | None:
    """The connection with its conversion, None if a problem was found or an instance could not be read."""
    where = f"connection {connection}"
    before = len(findings.problems)
    found: list[Variable] = []
    for (name, variable), causality in ((connection.source, "output"), (connection.target, "input")):
        if name not in instances:
            if name not in declared:
                findings.problem(where, f"no instance '{name}'.{suggest(name, declared)}")
            continue
        fmu = instances[name].fmu
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
        else:
            findings.problem(where, f"{fmu.name} has no {causality} '{variable}'.{suggest(variable, known)}")
    if len(findings.problems) > before or len(found) < 2:
        return None
    source, target = found
    if source.type not in ACCEPTED_TYPES.get(target.type, ()):
        findings.problem(where, f"an output of type {source.type} cannot feed an input of type {target.type}.")
        return None
    if (source.type, target.type) == ("Integer", "Enumeration"):
        findings.note(where, f"its numbers choose items of {target.name}: {_items(target)}.")
    if (connection.factor != 1.0 or connection.offset != 0.0) and target.type != "Real":
        findings.problem(where, f"factor and offset need an input of type Real, not {target.type}.")
    fmus = instances[connection.source[0]].fmu, instances[connection.target[0]].fmu
    checked = _with_units(where, connection, (source, target), fmus, findings)
    return checked if len(findings.problems) == before else None


def _items(variable: Variable) -> str:
    """The first items of an enumeration with their numbers."""
    shown = [f"{number} {name}" for name, number in variable.items.items()]
    return ", ".join(shown[:6]) + (" ..." if len(shown) > 6 else "")


def _with_units(
    where: str,
    connection: Connection,
    variables: tuple[Variable, Variable],
    fmus: tuple[Fmu, Fmu],
    findings: Findings,
) -> Connection | None:
    """The connection with the conversion of its units, where it asks for one; None if they do not fit."""
    if connection.units in ("given", "suppressed"):
        return connection
    unit, other = variables[0].unit, variables[1].unit
    if unit is None or other is None or is_same_unit(fmus[0], unit, fmus[1], other):
        return replace(connection, units="same")
    factors = unit_conversion(fmus[0].unit(unit), fmus[1].unit(other))
    if connection.units == "converted" and factors is not None:
        return converted(connection, *factors)
    known = fmus[0].unit(unit), fmus[1].unit(other)
    one, two = (f"{name} ({known[i]})" if unit == other else name for i, name in enumerate((unit, other)))
    findings.problem(where, f"unit {one} does not match {two}. {_remedy(connection, unit, other, known, factors)}")
    return None


def is_same_unit(one: Fmu, unit: str, other: Fmu, other_unit: str) -> bool:
    """Whether two units of two FMUs mean the same: by what the files state about them, else by their names."""
    a, b = one.unit(unit), other.unit(other_unit)
    if a is None or b is None:
        return unit == other_unit
    if unit == other_unit and a.exponents[:-1] == b.exponents[:-1]:
        # Files differ in whether an angle has a unit: rad/s is rad.s-1 in one and s-1 in the other.
        b = replace(b, exponents=a.exponents)
    return a.matches(b)


def unit_conversion(unit: Unit | None, other: Unit | None) -> tuple[float, float] | None:
    """Factor and offset from one unit to another; None if they are of different kinds or one is not known."""
    return None if unit is None or other is None else unit.conversion(other)


def converted(connection: Connection, factor: float, offset: float) -> Connection:
    """A connection whose values are converted first, then transformed as stated (SSP 1.0, LinearTransformation)."""
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
    """What to write in a connection so that it converts."""
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
