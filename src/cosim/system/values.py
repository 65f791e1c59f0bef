"""Values of system files: read as decimals and checked against their variable."""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from decimal import Decimal, InvalidOperation
from fractions import Fraction
from typing import Any, cast

from ..errors import DescriptionError, clipped, suggest
from ..fmu.description import Fmu
from ..fmu.text import FRACTION
from ..fmu.variables import Value, Variable
from ..units import parse_unit

_FRACTION = re.compile(FRACTION)

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
"""A number as people type it. TOML is stricter: it needs digits on both sides of the point, and no leading zeros."""


_QUANTITY = re.compile(rf"(?P<number>(?>{_NUMBER.pattern}))\s*(?P<unit>([^\W\d_]|[%°\[]|1/).*)")
"""A number with a unit, such as ``10 mm`` or ``5 1/s``."""


RANGES = {
    "Integer": (-(2**31), 2**31 - 1),
    **{f"Int{bits}": (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) for bits in (8, 16, 32, 64)},
    **{f"UInt{bits}": (0, 2**bits - 1) for bits in (8, 16, 32, 64)},
}
"""Smallest and largest value of each integer type of FMI."""

MOST_DIGITS = 300
"""Largest number of digits of a fraction. Doubles have numbers up to 1.8e308."""

WHOLE = 4e-15
"""Largest relative distance from a whole number.

A fraction such as 1/30, written with 16 digits, causes about such a distance.
"""


def parse_settings(items: Sequence[str]) -> dict[str, object]:
    """Start values from the command line, such as ``plant.m=70``. Raises DescriptionError with all wrong ones."""
    values: dict[str, object] = {}
    problems: list[str] = []
    for item in items:
        name, equals, value = item.partition("=")
        if not equals or not name.strip():
            problems.append(f"--set {item}: write INSTANCE.VARIABLE=VALUE, such as plant.m=70.")
        elif not value.strip():
            problems.append(f"--set {item}: the value is missing. Write it behind the =, '\"\"' for an empty text.")
        else:
            values[name.strip()] = parse_value(value.strip())
    if problems:
        raise DescriptionError(problems)
    return values


def parse_value(text: str) -> object:
    """A value from the command line: a number, else a TOML value, else the text itself (an enumeration item)."""
    try:
        if _NUMBER.fullmatch(text):
            return Decimal(text)
        return tomllib.loads(f"value = {text}", parse_float=Decimal)["value"]
    except (ValueError, ArithmeticError, RecursionError):
        return text


def flat_table(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Full names and values of nested tables. TOML reads ``nct.error = [...]`` as a table in a table."""
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from flat_table(cast("Mapping[str, Any]", value), f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def decimal(value: object) -> Decimal | None:
    """``value`` as a Decimal; None if it is not a number. A float is taken with the digits of its ``repr``."""
    if isinstance(value, bool):
        return None
    if isinstance(value, Decimal):
        return value
    if isinstance(value, int):
        return Decimal(value)
    try:
        if isinstance(value, str):
            return Decimal(value)
        return Decimal(repr(float(cast(Any, value))))
    except (InvalidOperation, TypeError, ValueError):
        return None


def fraction(value: object) -> Fraction | None:
    """A finite number, exactly as it is written, or a text such as ``"1/30"``; None for everything else."""
    if isinstance(value, str):
        match = _FRACTION.fullmatch(value) if len(value) <= MOST_DIGITS else None
        return Fraction(match[1]) / Fraction(match[2]) if match and Fraction(match[2]) else None
    number = decimal(value)
    # As a fraction, a number with an exponent of millions would fill the memory.
    if number is None or not number.is_finite() or abs(number.adjusted()) > MOST_DIGITS:
        return None
    return Fraction(number)


def whole(ratio: Fraction) -> int | None:
    """The whole number of at least 1 that ``ratio`` equals up to rounding (``WHOLE``); None if there is none."""
    nearest = round(ratio)
    return nearest if nearest > 0 and abs(ratio / nearest - 1) <= WHOLE else None


def show_value(value: object) -> str:
    """A value as it is written in a system file. Of a long one, only the beginning is shown."""
    if isinstance(value, str):
        return f'"{clipped(value)}"'
    if isinstance(value, bool):
        return str(value).lower()
    return clipped(str(value))


def show_start(variable: Variable, value: Value) -> str:
    """A checked start value as text for the user: an enumeration as its item name, a number with its unit."""
    item = next((name for name, number in variable.items.items() if number == value), None)
    if item is not None:
        return item
    return show_value(value) + (unit_suffix(variable) if variable.type == "Real" else "")


def unit_suffix(variable: Variable) -> str:
    """The unit of a variable with a blank before it, to write after a number; "" without a unit."""
    return f" {variable.unit}" if variable.unit and variable.unit != "1" else ""


def is_numeric(variable: Variable) -> bool:
    """Whether a variable holds numbers: all types except String, Binary and Clock."""
    return variable.type not in ("String", "Binary", "Clock")


def in_unit_of(fmu: Fmu, variable: Variable, given: object) -> tuple[object, str]:
    """A value that is given with a unit, such as ``"10 mm"``, as a number in the unit of the variable, and "".

    Every other value is returned as it is. If the unit cannot be converted, the second item is a sentence.
    """
    match = _QUANTITY.fullmatch(given.strip()) if isinstance(given, str) and variable.type == "Real" else None
    if match is None:
        return given, ""
    number, name = Decimal(match["number"]), match["unit"]
    unit, wanted = fmu.unit(name), fmu.unit(variable.unit or "1")
    if unit is None:
        try:
            parse_unit(name)
        except DescriptionError as error:
            return given, f"{show_value(given)}: {error}"
    said = f"The unit is {variable.unit}." if variable.unit else "The variable has no unit: give a number."
    factors = None if unit is None or wanted is None else unit.conversion(wanted)
    if factors is None:
        return given, f"{show_value(given)}: '{name}' cannot be converted. {said}"
    factor, offset = (Decimal(repr(value)) for value in factors)
    return number * factor + offset, ""


def start_value(variable: Variable, given: object) -> tuple[Value | None, str]:
    """The start value for ``variable`` and ""; or None and a sentence about what is wrong with it."""
    kind, unit = variable.type, unit_suffix(variable)
    if kind == "String":
        return (
            (given, "") if isinstance(given, str) else (None, f"{show_value(given)} is not a text. Write it in quotes.")
        )
    if kind == "Boolean":
        return (given, "") if isinstance(given, bool) else (None, f"{show_value(given)}: give true or false.")
    if kind == "Enumeration" and isinstance(given, str):
        if given in variable.items:
            return variable.items[given], ""
        return None, f"'{given}' is no item of this enumeration.{suggest(given, variable.items)}"
    if kind == "Real" and isinstance(given, str) and (ratio := fraction(given)) is not None:
        given = float(ratio)
    number = None if isinstance(given, str) else decimal(given)
    if number is None:
        comma = ""
        if isinstance(given, str) and _NUMBER.fullmatch(given):
            comma = " Write it without quotes."
        elif isinstance(given, str) and _NUMBER.fullmatch(given.replace(",", ".")):
            comma = " Write it with a point."
        said = f"{show_value(given)} is not a number."
        return None, said + comma + (f" The unit is {variable.unit}." if unit else "")
    if not number.is_finite() or not math.isfinite(float(number)):
        return None, f"{show_value(given)} is not finite. Give a number."
    if kind in ("Integer", "Enumeration"):
        if number != number.to_integral_value():
            return None, f"{show_value(given)} is not a whole number."
        low, high = RANGES.get(variable.passed_as, RANGES["Integer"])
        if not low <= number <= high:
            return None, f"{show_value(given)} does not fit {variable.passed_as}, which is {low} to {high}."
        if variable.items and int(number) not in variable.items.values():
            return None, f"{show_value(given)} is no item of this enumeration.{suggest('', variable.items)}"
    if variable.min is not None and number < Decimal(repr(variable.min)):
        return None, f"{show_value(given)}{unit} is below its minimum {variable.min:g}{unit}."
    if variable.max is not None and number > Decimal(repr(variable.max)):
        return None, f"{show_value(given)}{unit} is above its maximum {variable.max:g}{unit}."
    if variable.passed_as == "Float32" and abs(number) > Decimal("3.4028234663852886e38"):
        return None, f"{show_value(given)}{unit} does not fit Float32, which ends at 3.40282e38."
    return (float(number) if kind == "Real" else int(number)), ""
