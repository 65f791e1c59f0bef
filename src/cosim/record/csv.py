"""Tables in CSV files, as spreadsheets and measuring tools write them."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import DescriptionError
from ..fmu.text import read_text
from .header import is_units_row, unit_text

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|[+-]?(nan|inf|infinity)", re.IGNORECASE)
_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?")
"""A number with a decimal comma."""


class CsvTable:
    """A table whose first line names the columns; a row of units may follow.

    Cells are divided by comma, semicolon or tab. With semicolon or tab, numbers may have a decimal comma. The text is
    UTF-8, with or without a byte order mark, or UTF-16 with one. Lines that begin with # are comments. If the first
    line holds numbers, the last comment before it may name the columns.
    Raises DescriptionError for a file that holds no such table.
    """

    metadata: Mapping[str, object]

    def __init__(self, path: Path) -> None:
        self._path = path
        self.metadata = {}
        comment = ""
        kept: list[str] = []
        numbers: list[int] = []
        for number, line in enumerate(read_text(path).split("\n"), 1):
            if line.lstrip().startswith("#"):
                comment = comment if kept else line.lstrip()[1:]
            elif line.strip():
                kept.append(line)
                numbers.append(number)
        stated = re.fullmatch(r"sep=(.)", kept[0].strip()) if kept else None
        if stated:
            del kept[0], numbers[0]
        if not kept:
            raise DescriptionError(f"{path}: holds no rows. The first line names the columns.")
        self._delimiter = stated[1] if stated else next((mark for mark in ";\t," if mark in kept[0]), ",")
        self.labels, first = self._names(kept[0], comment)
        self.units = ["" for _ in self.labels]
        if first < len(kept) and is_units_row(units := self._cells(kept[first])):
            self.units = [unit_text(unit) for unit in units[: len(self.labels)]]
            self.units += ["" for _ in self.labels[len(self.units) :]]
            first += 1
        self._lines, self._numbers = kept[first:], numbers[first:]
        self._comma = self._delimiter != "," and self._decimal_mark() == ","

    def _names(self, line: str, comment: str) -> tuple[list[str], int]:
        """The names of the columns, and the number of lines that they take: 0 if a comment names the columns."""
        names = self._cells(line)
        if all(self._number(name) is not None for name in names):
            told = self._cells(comment)
            if len(told) != len(names) or any(self._number(name) is not None for name in told):
                raise DescriptionError(
                    f"{self._path}: the first line holds numbers. It must name the columns, such as t,u,x."
                )
            return told, 0
        # Some tools end every line with a delimiter.
        names = names[:-1] if names[-1] == "" and len(names) > 1 else names
        return [name or f"column {number}" for number, name in enumerate(names, 1)], 1

    def _cells(self, line: str) -> list[str]:
        reader = csv.reader([line], delimiter=self._delimiter, skipinitialspace=True)
        return [cell.strip() for row in reader for cell in row]

    def _decimal_mark(self) -> str:
        """The decimal mark of the numbers. Raises DescriptionError if some have a comma and others a point."""
        comma = next((i for i, line in enumerate(self._lines) if "," in line and self._with(line, _COMMA)), None)
        if comma is None:
            return "."
        point = next((i for i, line in enumerate(self._lines) if "." in line and self._with(line, _NUMBER, ".")), None)
        if point is not None:
            cells = self._with(self._lines[comma], _COMMA)[0], self._with(self._lines[point], _NUMBER, ".")[0]
            raise DescriptionError(
                f"{self._path}: '{cells[0]}' in line {self._numbers[comma]} has a comma, '{cells[1]}' in line "
                f"{self._numbers[point]} a point: which of them is the decimal mark? Write all numbers with a point, "
                "and without a mark for thousands."
            )
        return ","

    def _with(self, line: str, pattern: re.Pattern[str], mark: str = "") -> list[str]:
        return [cell for cell in self._cells(line) if mark in cell and pattern.fullmatch(cell)]

    def values(self, columns: Sequence[int]) -> NDArray[np.float64]:
        """The values of ``columns`` (numbers from 0), shape (rows, columns); NaN where a cell is not a number.

        Raises DescriptionError if there are no rows, or if a line has too few or too many cells.
        """
        if not self._lines:
            raise DescriptionError(f"{self._path}: holds no rows below its first line.")
        try:
            return self._quickly(columns)
        except ValueError:
            return self._patiently(columns)

    def _quickly(self, columns: Sequence[int]) -> NDArray[np.float64]:
        """Read with NumPy. Raises ValueError if a cell is not a number, or a line has a wrong number of cells."""
        count = self._lines[0].count(self._delimiter)
        if len(self.labels) not in (count, count + 1) or any(
            line.count(self._delimiter) != count for line in self._lines
        ):
            raise ValueError
        if len(self.labels) == count and any(not line.rstrip(" ").endswith(self._delimiter) for line in self._lines):
            raise ValueError
        lines = (line.replace(",", ".") for line in self._lines) if self._comma else self._lines
        return np.loadtxt(
            lines, delimiter=self._delimiter, comments=None, quotechar='"', usecols=tuple(columns), ndmin=2
        )

    def _patiently(self, columns: Sequence[int]) -> NDArray[np.float64]:
        result = np.full((len(self._lines), len(columns)), math.nan)
        problems: list[str] = []
        for row, line in enumerate(self._lines):
            cells = self._cells(line)
            if len(cells) == len(self.labels) + 1 and cells[-1] == "":
                del cells[-1]
            if len(cells) != len(self.labels):
                problems.append(
                    f"{self._path}: line {self._numbers[row]}: {len(cells)} cells for {len(self.labels)} columns."
                    f"{self._divided(cells)}"
                )
                continue
            numbers = (self._number(cells[column]) for column in columns)
            result[row] = [math.nan if number is None else number for number in numbers]
        if problems:
            raise DescriptionError(shortened(self._path, problems, "lines"))
        return result

    def _number(self, cell: str) -> float | None:
        if self._delimiter != "," and _COMMA.fullmatch(cell):
            cell = cell.replace(",", ".")
        return float(cell) if _NUMBER.fullmatch(cell) else None

    def place(self, row: int) -> str:
        """Line and row in the file of row number ``row`` (from 0), as text."""
        return f"line {self._numbers[row]}, row {row + 1}"

    def is_number(self, row: int, column: int) -> bool:
        """Whether a cell holds a number; NaN and infinity count as numbers."""
        return self._number(self._cells(self._lines[row])[column]) is not None

    def wrong(self, row: int, column: int) -> str:
        """The reason why a cell holds no finite number."""
        cell = self._cells(self._lines[row])[column]
        if cell == "":
            return "is empty. Leave the row out, or interpolate before."
        if self._number(cell) is not None:
            return f"{cell} is not finite. Leave the row out, or interpolate before."
        return f"'{cell}' is not a number. Write it with a point, and without a mark for thousands."

    def _divided(self, cells: list[str]) -> str:
        """A hint, if a line looks like numbers with a decimal comma in a file divided by commas; else ""."""
        many = self._delimiter == "," and all(re.fullmatch(r"[+-]?\d+", cell) for cell in cells[1:])
        return " If numbers have a decimal comma, divide cells by semicolons." if many and len(cells) > 1 else ""


MOST_PROBLEMS = 5
"""Largest number of wrong cells or lines that an error lists."""


def shortened(path: Path, problems: Sequence[str], what: str = "cells") -> list[str]:
    """The first problems of a file, and a line with the number of the others."""
    more = len(problems) - MOST_PROBLEMS
    return [*problems[:MOST_PROBLEMS], *([f"{path}: {more} more {what} like these."] if more > 0 else [])]
