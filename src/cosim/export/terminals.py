"""terminalsAndIcons.xml: which variables of an FMU belong together, so that a tool wires them with one connection.

FMI 3.0 defines the file; FMI 2.0 takes it over since 2.0.4. Two terminals of the same name fit each other: their
members of the same name are connected (rule ``bus``).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from xml.etree.ElementTree import Element, SubElement

from ..fmu.xml import document
from ..model import Component, Controller, Plant, Source
from .interface import variables_of

TEXTS = {
    "reference": "Reference motion",
    "motion": "Measured motion",
    "drive": "Command to the drive",
    "compensation": "What other controllers add to the command",
}
"""Name of a terminal -> its description, in the order of the file."""

_INPUTS: Mapping[type[Component], Mapping[str, tuple[str, str]]] = {
    Controller: {
        "position_ref": ("reference", "position"),
        "velocity_ref": ("reference", "velocity"),
        "acceleration_ref": ("reference", "acceleration"),
        "position_next": ("reference", "position_next"),
        "position": ("motion", "position"),
        "velocity": ("motion", "velocity"),
        "motor_position": ("motion", "motor_position"),
        "disturbance_estimate": ("compensation", "disturbance_estimate"),
        "velocity_pulse": ("compensation", "velocity_pulse"),
    },
    Plant: {"command": ("drive", "command")},
    Source: {},
}
_OUTPUTS: Mapping[type[Component], Mapping[str, tuple[str, str]]] = {
    Controller: {
        "command": ("drive", "command"),
        "disturbance_estimate": ("compensation", "disturbance_estimate"),
        "velocity_pulse": ("compensation", "velocity_pulse"),
    },
    Plant: {name: ("motion", name) for name in ("position", "velocity", "motor_position")},
    Source: {name: ("reference", name) for name in ("position", "velocity", "acceleration", "position_next")},
}
"""By kind of component, for inputs and for outputs: name of a variable -> its terminal and its member name there."""


@dataclass
class Terminal:
    """A group of inputs or outputs: member name -> name of the variable."""

    name: str
    description: str
    members: dict[str, str] = field(default_factory=dict[str, str])


def terminals(kind: type[Component]) -> tuple[Terminal, ...]:
    """The terminals of a component that have members."""
    base = next(base for base in (Plant, Controller, Source) if issubclass(kind, base))
    found = {name: Terminal(name, text) for name, text in TEXTS.items()}
    for variable in variables_of(kind):
        place = {"input": _INPUTS, "output": _OUTPUTS}.get(variable.role, {}).get(base, {}).get(variable.name)
        if place:
            found[place[0]].members[place[1]] = variable.name
    return tuple(terminal for terminal in found.values() if terminal.members)


def terminals_and_icons(kind: type[Component]) -> bytes:
    """terminalsAndIcons/terminalsAndIcons.xml; the icon fills the coordinate system."""
    root = Element("fmiTerminalsAndIcons", fmiVersion="3.0")
    shown = SubElement(root, "GraphicalRepresentation")
    corners = {"x1": "-100", "y1": "-100", "x2": "100", "y2": "100"}
    SubElement(shown, "CoordinateSystem", {**corners, "suggestedScalingFactorTo_mm": "0.1"})
    SubElement(shown, "Icon", corners)
    found = terminals(kind)
    listed = SubElement(root, "Terminals") if found else root
    for terminal in found:
        element = SubElement(
            listed,
            "Terminal",
            name=terminal.name,
            matchingRule="bus",
            terminalKind=f"org.motion-cosim.{terminal.name}",
            description=terminal.description,
        )
        for member, variable in terminal.members.items():
            SubElement(
                element, "TerminalMemberVariable", variableName=variable, memberName=member, variableKind="signal"
            )
    return document(root)
