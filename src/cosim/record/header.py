"""Reads the name and the unit of a column from its label, as measuring tools, spreadsheets and MATLAB write it."""

from __future__ import annotations

import re

from ..errors import DescriptionError
from ..units import parse_unit

TIME_NAMES = ("time", "t", "zeit")
"""Names of a time column, in upper or lower case. The first of them that a file has is its time."""

_SIGNS = str.maketrans(
    {"\u00b5": "u", "\u03bc": "u", "\u00b7": ".", "\u22c5": ".", "*": ".", "^": "", "\u00b2": "2", "\u00b3": "3"}
    | {"\u2126": "Ohm", "\u03a9": "Ohm", " ": ""}
)
"""Replacements for the micro sign and mu, dots for products, superscript digits, the Ohm sign and Omega."""

_WORDS = {
    "-": "1",
    "sec": "s",
    "second": "s",
    "seconds": "s",
    "msec": "ms",
    "°": "deg",
    "degree": "deg",
    "degrees": "deg",
    "°C": "degC",
    "Nm": "N.m",
    "Nmm": "N.mm",
    "ohm": "Ohm",
    "1/min": "rpm",
    "rev/min": "rpm",
    "r/min": "rpm",
    "°/s": "deg/s",
}
"""Names of units in measuring tools, and their names here. Drives use ``1/min`` for a rotational speed."""

_SQUARE = re.compile(r"(?P<name>.*?)(?P<space>\s*)\[(?P<unit>[^\[\]]*)\]", re.DOTALL)
_ROUND = re.compile(r"(?P<name>.*\S)\s*\((?P<unit>.*)\)", re.DOTALL)
_INDEX = re.compile(r"\d+(,\d+)*")


def unit_text(text: str) -> str:
    """The unit in ``text``, as this package writes it. ``text`` may have brackets around it.

    If the unit is not known, returns ``text`` without the spaces and brackets around it.
    """
    text = text.strip()
    text = text[1:-1].strip() if re.fullmatch(r"\[.*\]|\(.*\)", text) else text
    found = _WORDS.get(text, text.translate(_SIGNS))
    found = _WORDS.get(found, found)
    return found if is_unit(found) else text


def is_unit(text: str) -> bool:
    """Whether ``text`` is a known unit."""
    try:
        parse_unit(text)
    except DescriptionError:
        return False
    return True


def split_label(label: str) -> tuple[str, str]:
    """The name and the unit of a column: ``x [mm]`` is ``x`` in mm; ``a[1]`` is an array element without unit.

    A text in round brackets is a unit only if the unit is known: ``force (N)``.
    """
    match = _SQUARE.fullmatch(label.strip())
    if match and match["name"] and (match["space"] or not _INDEX.fullmatch(match["unit"])):
        return match["name"], unit_text(match["unit"])
    match = _ROUND.fullmatch(label.strip())
    if match and is_unit(unit := unit_text(match["unit"])):
        return match["name"], unit
    return label.strip(), ""


def is_units_row(cells: list[str]) -> bool:
    """Whether the cells below the names are units.

    They are if no cell is a number other than ``1``, and at least half of the other cells are known units.
    """
    told = [cell for cell in (cell.strip() for cell in cells) if cell]
    if not told or any(cell != "1" and _is_number(cell) for cell in told):
        return False
    named = [is_unit(unit_text(cell)) for cell in told if cell != "1"]
    return 2 * sum(named) >= len(named) > 0


def _is_number(cell: str) -> bool:
    try:
        float(cell.replace(",", "."))
    except ValueError:
        return False
    return True
