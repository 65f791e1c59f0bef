"""Connections: types and units of their two ends."""

from __future__ import annotations

import math
import re

from ..errors import DescriptionError
from ..fmu.description import Fmu
from ..units import conversion, same_unit

ARROW = re.compile(r"\s*(\S+)\s*->\s*(\S+)\s*")


ACCEPTED_TYPES = {
    "Real": ("Real", "Integer", "Enumeration", "Boolean"),
    "Integer": ("Integer", "Enumeration", "Boolean"),
    "Boolean": ("Boolean",),
    "Enumeration": ("Enumeration",),
}
"""Types of outputs that an input of a type takes; what loses nothing is converted."""


def is_same_unit(one: Fmu, unit: str, other: Fmu, other_unit: str) -> bool:
    """Whether two units of two FMUs mean the same."""
    if unit == other_unit:
        return True
    try:
        return same_unit(unit, other_unit)
    except DescriptionError:
        # A unit this package cannot read: compare what the two files state about it.
        a, b = one.base_units.get(unit), other.base_units.get(other_unit)
        return a is not None and b is not None and a[1:] == b[1:] and math.isclose(a[0], b[0], rel_tol=1e-12)


def unit_remedy(unit: str, other: str, source: str, target: str) -> str:
    """What to write in a connection so that it converts."""
    try:
        factor = f"{conversion(unit, other):.12g}"
    except DescriptionError:
        factor = f"... ({other} per {unit})"
    return f'To convert, write {{ from = "{source}", to = "{target}", factor = {factor} }}.'
