"""Finds the sources of the signals of an SSP: follows connections through the connectors of systems."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ..errors import suggest
from .ssp_names import tag
from .ssp_tree import End, Part
from .ssp_units import ConnectorUnits, conversion
from .ssp_values import Given, linear, other_transformation, scaled, transformed

SOURCES = ("output", "calculatedParameter")
TARGETS = ("input", "parameter")

REMEDY = "Define it in ssd:Units, or set suppressUnitConversion."


@dataclass(frozen=True)
class Hop:
    """A connection in the direction of its signal."""

    source: End
    target: End
    xml: Any

    @property
    def suppressed(self) -> bool:
        """Whether units are not converted."""
        return self.xml.get("suppressUnitConversion") in ("true", "1")

    def __str__(self) -> str:
        return " -> ".join(said(end) for end in (self.source, self.target))


def said(end: End) -> str:
    """A connector as text for messages."""
    return ".".join((*end[0], end[1]))


class Flow:
    """The connection that feeds each connector."""

    def __init__(self, top: Part, units: ConnectorUnits, problem: Callable[[str], None]) -> None:
        self.units = units
        self.problem = problem
        self.into: dict[End, Hop] = {}
        for part in top.all():
            for connection in part.xml.findall(f"{tag('ssd:Connections')}/{tag('ssd:Connection')}"):
                hop = self.hop(part, connection)
                if hop is None:
                    continue
                if hop.target in self.into:
                    self.problem(
                        f"'{said(hop.target)}' has two sources, '{said(self.into[hop.target].source)}' and "
                        f"'{said(hop.source)}'. Keep one."
                    )
                self.into[hop.target] = hop

    def hop(self, system: Part, connection: Any) -> Hop | None:
        """A connection of a system, with its direction; None if a problem was found."""
        ends: list[End] = []
        gives: list[bool | None] = []
        for side in ("start", "end"):
            element, connector = connection.get(f"{side}Element") or "", connection.get(f"{side}Connector")
            part = system if not element else system.parts.get(element)
            if part is None:
                self.problem(
                    f"'{system.name}': a connection names no element '{element}'.{suggest(element, system.parts)}"
                )
                return None
            if part.kind not in ("System", "Component"):
                self.problem(f"'{part.name}' is a {part.kind}, which is not read; '{connector}' of it is connected.")
                return None
            if part.kind == "System" and connector not in part.connectors:
                known = suggest(connector, part.connectors)
                self.problem(f"'{part.name}': a connection names no connector '{connector}' of it.{known}")
                return None
            kind = part.connector_kind(connector)
            if kind == "inout":
                self.problem(f"'{said((part.path, connector))}' is an inout connector, which is not read.")
                return None
            ends.append((part.path, connector))
            gives.append(_gives(kind, inside=part is system))
        hop = Hop(ends[0], ends[1], connection)
        if None not in gives and gives[0] == gives[1]:
            what = "give values" if gives[0] else "take values"
            self.problem(f"connection {hop}: both ends {what} there. Connect an output to an input.")
            return None
        if gives[0] is False or gives[1] is True:
            hop = Hop(ends[1], ends[0], connection)  # SSP lets a connection be written from either side
            if len(connection) and (linear(connection) or other_transformation(connection)) is not None:
                self.problem(f"connection {hop}: starts at an input and transforms. Write it from the output.")
                return None
        return hop

    def trace(self, target: End) -> list[Hop]:
        """The chain of connections from the source of a signal to ``target``; empty if connectors form a loop."""
        hops: list[Hop] = []
        end = target
        while end in self.into:
            hop = self.into[end]
            if hop in hops:
                self.problem(f"connection {hop}: its signal comes from itself, through connectors only.")
                return []
            hops.insert(0, hop)
            end = hop.source
        return hops

    def through(self, hops: list[Hop], stated: tuple[float, float] | None = None) -> tuple[float, float]:
        """Factor and offset of a chain of connections. Each converts units first, and then applies its own factor.

        ``stated`` replaces the factor and offset of a single connection, and makes it convert units. A connector
        without a unit does not change the unit. Raises DescriptionError for units that cannot be converted.
        """
        unit = self.units.unit(hops[0].source)
        factor, offset = 1.0, 0.0
        for hop in hops:
            wanted = self.units.unit(hop.target)
            converts = (1.0, 0.0) if hop.suppressed and stated is None else conversion(unit, wanted, REMEDY)
            a, b = stated or linear(hop.xml) or (1.0, 0.0)
            factor, offset = a * converts[0] * factor, a * (converts[0] * offset + converts[1]) + b
            if wanted is not None:
                unit = wanted
            elif hop.suppressed or (a, b) != (1.0, 0.0):
                unit = None  # the unit of the values is not known any more
        return factor, offset

    def constant(self, given: Given, hops: list[Hop]) -> object:
        """The value that arrives at the end of a chain of connections, if ``given`` is the value at its start.

        Raises DescriptionError for units that cannot be converted, and for a transformation that does not fit.
        """
        value, unit = given.value, given.unit or self.units.unit(hops[0].source)
        for hop in hops:
            wanted = self.units.unit(hop.target)
            if not hop.suppressed and not isinstance(value, bool | str):
                value = scaled(value, *conversion(unit, wanted, REMEDY))
            before, value = value, transformed(value, hop.xml)
            unit = wanted if wanted is not None else unit if value is before and not hop.suppressed else None
        return value


def _gives(kind: str | None, *, inside: bool) -> bool | None:
    """Whether a connector of this kind gives values to a connection; None if the kind does not say so.

    ``inside``: the connector belongs to the system that contains the connection.
    """
    if kind in SOURCES:
        return not inside
    return inside if kind in TARGETS else None
