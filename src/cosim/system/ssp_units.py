"""Units in SSP: where their names are defined, and how values and connections are converted.

The first of these that defines a unit name decides: the ``Units`` of the parameter set (only for its own values), the
FMU, the ``Units`` of the SSD, the table of ``cosim.units``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from ..errors import DescriptionError
from ..units import BASE_UNITS, Unit, resolve_unit
from .connections import meaning, unit_of_values
from .ssp_names import tag
from .ssp_tree import End, Part, Path


def defined_units(parent: Any, element: str) -> dict[str, Unit]:
    """The units that ``ssd:Units`` or ``ssv:Units`` below ``parent`` define by a BaseUnit."""
    found: dict[str, Unit] = {}
    for unit in parent.findall(f"{tag(element)}/{tag('ssc:Unit')}"):
        base = unit.find(tag("ssc:BaseUnit"))
        if base is not None:
            exponents = tuple(Fraction(base.get(symbol, "0")) for symbol in BASE_UNITS)
            found[unit.get("name")] = Unit(float(base.get("factor", "1")), exponents, float(base.get("offset", "0")))
    return found


@dataclass(frozen=True)
class NamedUnit:
    """The name of a unit and its meaning; None if no file defines it."""

    name: str
    meaning: Unit | None


def conversion(unit: NamedUnit | None, other: NamedUnit | None, remedy: str) -> tuple[float, float]:
    """Factor and offset from one unit to another; (1, 0) if one of them is None.

    Raises DescriptionError for units that cannot be converted. For an undefined unit, the message ends with ``remedy``.
    """
    if unit is None or other is None:
        return 1.0, 0.0
    one, two = unit.meaning, other.meaning
    if one is None or two is None:
        if unit.name == other.name:
            return 1.0, 0.0
        unknown = unit.name if one is None else other.name
        raise DescriptionError(f"nothing says what unit '{unknown}' is. {remedy}")
    factors = one.conversion(two.with_angles_of(one) if unit.name == other.name else two)
    if factors is not None:
        return factors
    if unit.name == other.name:
        raise DescriptionError(
            f"unit '{unit.name}' ({one}) cannot be converted to '{other.name}' ({two}). Correct one of the definitions."
        )
    raise DescriptionError(f"unit '{unit.name}' cannot be converted to '{other.name}'.")


class ConnectorUnits:
    """The units of the connectors of a system. The SSD states them, or else the variables of the FMUs."""

    def __init__(self, top: Part, defined: Mapping[str, Unit]) -> None:
        self.defined = defined
        """The units that the SSD defines."""
        self.parts: dict[Path, Part] = {part.path: part for part in top.all()}

    def meant(self, end: End, name: str, *own: Mapping[str, Unit]) -> NamedUnit:
        """The unit called ``name`` at a connector. The definitions ``own`` come first."""
        fmu = self.parts[end[0]].fmu
        stated: Mapping[str, Unit] = {} if fmu is None else fmu.base_units
        unit = resolve_unit(name, *own, stated, self.defined)
        variable = None if fmu is None else fmu.variables.get(end[1])
        return NamedUnit(name, unit if variable is None else unit_of_values(unit, variable))

    def own(self, end: End) -> NamedUnit | None:
        """The unit of the FMU's variable behind a connector; for a connector of a system, the unit in the SSD."""
        fmu = self.parts[end[0]].fmu
        if fmu is None:
            return self.stated(end)
        variable = fmu.variables.get(end[1])
        return None if variable is None or variable.unit is None else self.meant(end, variable.unit)

    def stated(self, end: End) -> NamedUnit | None:
        """The unit that the SSD states for a connector."""
        connector = self.parts[end[0]].connectors.get(end[1])
        real = None if connector is None else connector.find(tag("ssc:Real"))
        name = None if real is None else real.get("unit")
        return self.meant(end, name) if name else None

    def unit(self, end: End) -> NamedUnit | None:
        """The unit of a connector."""
        return self.stated(end) or self.own(end)

    def contradicted(self) -> list[End]:
        """The variables of FMUs for which the SSD states a unit that is not the one in the FMU."""
        found: list[End] = []
        for part in self.parts.values():
            for end in ((part.path, name) for name in part.connectors if part.fmu is not None):
                own, stated = self.own(end), self.stated(end)
                if own is None or stated is None or own.meaning is None or stated.meaning is None:
                    continue
                try:
                    same = conversion(own, stated, "") == (1.0, 0.0)
                except DescriptionError:
                    same = False
                if not same:
                    found.append(end)
        return found

    def differs(self, end: End) -> bool:
        """Whether the unit of a connector differs from the unit of its variable in the FMU alone."""
        fmu, own, unit = self.parts[end[0]].fmu, self.own(end), self.unit(end)
        wanted = None if unit is None else unit.meaning
        known = None if fmu is None or own is None else meaning(fmu, fmu.variables[end[1]])
        if known is None or wanted is None:
            return wanted is not None
        return not known.matches(wanted)
