"""Measured rows in CSV files, as spreadsheets and measuring tools write them."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import DescriptionError
from ..fmu.text import read_text
from ..result.metrics import Array

MOST_PROBLEMS = 5
"""Wrong cells that are told of."""


_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?")
"""A number with a decimal comma."""


@dataclass(frozen=True)
class _Lines:
    """The lines of a file that hold something, cut into cells, with their numbers."""

    delimiter: str
    cells: list[list[str]]
    numbers: list[int]


def read_columns(path: Path) -> Mapping[str, Array]:
    """The columns of a CSV file by the names in its first line, one value a row.

    Cells are divided by comma, semicolon or tab; beside the last two, numbers may have a decimal comma. Text is UTF-8,
    with a byte order mark or without, or UTF-16 with one; lines that begin with # are left out.
    Raises DescriptionError that names row and column of what is no finite number.
    """
    lines = _lines(path)
    if not lines.cells:
        raise DescriptionError(f"{path}: holds no rows. The first line names the columns.")
    names = lines.cells[0]
    if all(_number(name, lines.delimiter) is not None for name in names):
        raise DescriptionError(f"{path}: the first line holds numbers. It must name the columns, such as t,u,x.")
    problems: list[str] = []
    rows: list[list[float]] = []
    for row, (number, cells) in enumerate(zip(lines.numbers[1:], lines.cells[1:], strict=True), 1):
        where = f"{path}: line {number}"
        if len(cells) != len(names):
            problems.append(f"{where}: {len(cells)} cells for {len(names)} columns.{_divided(cells, lines.delimiter)}")
            continue
        values = [_number(cell, lines.delimiter) for cell in cells]
        for name, cell, value in zip(names, cells, values, strict=True):
            if value is None or not math.isfinite(value):
                problems.append(f"{where}, row {row}, column {name}: {_wrong(cell, value)}")
        rows.append([math.nan if value is None else value for value in values])
    if problems:
        more = len(problems) - MOST_PROBLEMS
        raise DescriptionError(
            problems[:MOST_PROBLEMS] + ([f"{path}: {more} more cells like these."] if more > 0 else [])
        )
    if not rows:
        raise DescriptionError(f"{path}: holds no rows below its first line.")
    data = np.array(rows, dtype=np.float64)
    return {name: data[:, i] for i, name in enumerate(names)}


def _lines(path: Path) -> _Lines:
    kept = [
        (number, line)
        for number, line in enumerate(read_text(path).split("\n"), 1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    header = kept[0][1] if kept else ""
    delimiter = next((mark for mark in ";\t," if mark in header), ",")
    reader = csv.reader((line for _, line in kept), delimiter=delimiter, skipinitialspace=True)
    cells = [[cell.strip() for cell in row] for row in reader]
    if cells and cells[0][-1] == "":
        # Some tools end every line with the mark that divides cells.
        cells = [row[:-1] if row[-1] == "" else row for row in cells]
    return _Lines(delimiter, cells, [number for number, _ in kept])


def _number(cell: str, delimiter: str) -> float | None:
    if delimiter != "," and _COMMA.fullmatch(cell):
        cell = cell.replace(",", ".")
    try:
        return float(cell)
    except ValueError:
        return None


def _wrong(cell: str, value: float | None) -> str:
    if cell == "":
        return "is empty. Leave the row out, or interpolate before."
    if value is not None:
        return f"{cell} is not finite. Leave the row out, or interpolate before."
    return f"'{cell}' is not a number. Write it with a point, and without a mark for thousands."


def _divided(cells: list[str], delimiter: str) -> str:
    """A hint at decimal commas between commas."""
    many = delimiter == "," and all(re.fullmatch(r"[+-]?\d+", cell) for cell in cells[1:])
    return " If numbers have a decimal comma, divide cells by semicolons." if many else ""
