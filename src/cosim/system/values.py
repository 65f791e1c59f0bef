"""Values of system files: read as decimals, checked against the variable they are for."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterator, Mapping
from decimal import Decimal, InvalidOperation
from typing import Any, cast

from ..errors import suggest
from ..fmu.description import Value, Variable


def parse_value(text: str) -> object:
    """A value typed at a prompt: what TOML reads it as, else the text itself (an enumeration item)."""
    try:
        return tomllib.loads(f"value = {text}", parse_float=Decimal)["value"]
    except tomllib.TOMLDecodeError:
        return text


def flat_table(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted names and values: TOML reads ``nct.error = [...]`` as a table in a table."""
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from flat_table(cast("Mapping[str, Any]", value), f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def decimal(value: object) -> Decimal | None:
    """``value`` as a decimal if it is a number; floats as they are written."""
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


def show_value(value: object) -> str:
    """A value as it is written in a system file."""
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, bool):
        return str(value).lower()
    return str(value)


def unit_suffix(variable: Variable) -> str:
    """The unit of a variable behind a number, empty without one."""
    return f" {variable.unit}" if variable.unit and variable.unit != "1" else ""


def is_numeric(variable: Variable) -> bool:
    """Whether a variable holds numbers: everything but texts."""
    return variable.type != "String"


def start_value(variable: Variable, given: object) -> tuple[Value | None, str]:
    """The start value for ``variable``, or what is wrong with it."""
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
    number = None if isinstance(given, str) else decimal(given)
    if number is None:
        return None, f"{show_value(given)} is not a number." + (f" The unit is {variable.unit}." if unit else "")
    if not number.is_finite() or not math.isfinite(float(number)):
        return None, f"{show_value(given)} is not finite. Give a number."
    if kind in ("Integer", "Enumeration"):
        if number != number.to_integral_value():
            return None, f"{show_value(given)} is not a whole number."
        if not -(2**31) <= number < 2**31:
            return None, f"{show_value(given)} does not fit 32 bits."
        if variable.items and int(number) not in variable.items.values():
            return None, f"{show_value(given)} is no item of this enumeration.{suggest('', variable.items)}"
    if variable.min is not None and number < Decimal(repr(variable.min)):
        return None, f"{show_value(given)}{unit} is below its minimum {variable.min:g}{unit}."
    if variable.max is not None and number > Decimal(repr(variable.max)):
        return None, f"{show_value(given)}{unit} is above its maximum {variable.max:g}{unit}."
    return (float(number) if kind == "Real" else int(number)), ""
