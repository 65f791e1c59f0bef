"""Units in SSP: where their names are defined, and how values and connections are converted.

A unit's name means what the FMU states about it; what the FMU does not state, the ``Units`` of the SSP file may; a
name that no file defines means what the table of ``cosim.units`` says. Values of a parameter set have the meaning
that its own ``Units`` give them.
"""

from __future__ import annotations

from collections.abc import Mapping
from decimal import Decimal
from fractions import Fraction
from typing import Any

from ..errors import DescriptionError
from ..fmu.description import Fmu
from ..units import BASE_UNITS, Unit, resolve_unit
from .connections import unit_conversion
from .ssp_names import tag


def defined_units(parent: Any, element: str) -> dict[str, Unit]:
    """The units that ``ssd:Units`` or ``ssv:Units`` below ``parent`` define by a BaseUnit."""
    found: dict[str, Unit] = {}
    for unit in parent.findall(f"{tag(element)}/{tag('ssc:Unit')}"):
        base = unit.find(tag("ssc:BaseUnit"))
        if base is not None:
            exponents = tuple(Fraction(base.get(symbol, "0")) for symbol in BASE_UNITS)
            found[unit.get("name")] = Unit(float(base.get("factor", "1")), exponents, float(base.get("offset", "0")))
    return found


def converted_value(
    value: Decimal, unit: str, variable_unit: str, *, fmu: Fmu, own: Mapping[str, Unit], defined: Mapping[str, Unit]
) -> Decimal:
    """A parameter's value in the unit of its variable.

    ``own`` are the units of the parameter set, ``defined`` those of the SSD. Raises DescriptionError for units that
    cannot be converted.
    """
    meant = resolve_unit(unit, own, fmu.base_units, defined)
    wanted = resolve_unit(variable_unit, fmu.base_units, defined)
    if meant is None or wanted is None:
        if unit == variable_unit:
            return value
        unknown = unit if meant is None else variable_unit
        raise DescriptionError(f"nothing says what unit '{unknown}' is. Define it in Units.")
    factors = unit_conversion(meant, wanted)
    if factors is None:
        raise DescriptionError(_kinds(unit, meant, variable_unit, wanted))
    factor, offset = factors
    return value if factors == (1.0, 0.0) else value * Decimal(repr(factor)) + Decimal(repr(offset))


def _kinds(unit: str, meant: Unit, other: str, other_meant: Unit) -> str:
    """That two units differ in kind; what they mean is told where the names do not tell it."""
    first, second = (f" ({meant})", f" ({other_meant})") if unit == other else ("", "")
    return f"unit '{unit}'{first} cannot be converted to '{other}'{second}."


class ConnectorUnits:
    """The units of the connectors of a system: as the SSD states them, else those of the FMUs' variables."""

    def __init__(self, defined: Mapping[str, Unit]) -> None:
        self.defined = defined
        self.stated: dict[tuple[str, str], str] = {}
        """Units that the SSD states for connectors (component, connector)."""
        self.fmus: dict[str, Fmu] = {}
        """The FMU of each component that could be read."""

    def own(self, end: tuple[str, str]) -> str | None:
        """The unit of the variable behind a connector."""
        fmu = self.fmus.get(end[0])
        variable = None if fmu is None else fmu.variables.get(end[1])
        return None if variable is None else variable.unit

    def name(self, end: tuple[str, str]) -> str | None:
        """The unit of a connector."""
        return self.stated.get(end, self.own(end))

    def unit(self, end: tuple[str, str]) -> Unit | None:
        """What the unit of a connector means, None if nothing says it."""
        name = self.name(end)
        fmu = self.fmus.get(end[0])
        return None if name is None else resolve_unit(name, {} if fmu is None else fmu.base_units, self.defined)

    def differs(self, end: tuple[str, str]) -> bool:
        """Whether a connector has another unit than the FMU file alone says of its variable."""
        fmu, own, meant = self.fmus.get(end[0]), self.own(end), self.unit(end)
        known = None if fmu is None or own is None else fmu.unit(own)
        if known is None or meant is None:
            return meant is not None
        return not known.matches(meant)

    def conversion(self, source: tuple[str, str], target: tuple[str, str]) -> tuple[float, float]:
        """Factor and offset from the unit of one connector to that of another; (1, 0) if one has none.

        Raises DescriptionError for units that cannot be converted.
        """
        unit, other = self.name(source), self.name(target)
        if unit is None or other is None:
            return 1.0, 0.0
        one, two = self.unit(source), self.unit(target)
        if one is None or two is None:
            if unit == other:
                return 1.0, 0.0
            unknown = unit if one is None else other
            raise DescriptionError(
                f"nothing says what unit '{unknown}' is. Define it in ssd:Units, or set suppressUnitConversion."
            )
        factors = unit_conversion(one, two)
        if factors is None and unit == other and one.exponents[:-1] == two.exponents[:-1]:
            return one.factor / two.factor, (one.offset - two.offset) / two.factor
        if factors is None:
            raise DescriptionError(_kinds(unit, one, other, two))
        return factors
