"""Tables in CSV files, as spreadsheets and measuring tools write them."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import DescriptionError, shortened
from ..fmu.text import read_text
from .header import is_units_row, unit_text

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|[+-]?(nan|inf|infinity)", re.IGNORECASE)
_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?")
"""A number with a decimal comma."""
_TRUTH = {"true": 1.0, "false": 0.0}
"""Values of digital channels, in upper or lower case."""
_DATE = re.compile(r"\d+[-./]\d+[-./]\d+.*|\d+:\d+.*")
"""A date, a time of day, or both."""


class CsvTable:
    """A table whose first line names the columns; a row of units may follow.

    Cells are divided by comma, semicolon or tab, or else by blanks. Without commas between cells, numbers may have a
    decimal comma. The text is UTF-8, with or without a byte order mark, UTF-16 with one, or Windows-1252. Lines that
    begin with # are comments. If the first line holds numbers, the last comment before it may name the columns.
    Raises DescriptionError for a file that holds no such table.
    """

    metadata: Mapping[str, object]

    def __init__(self, path: Path) -> None:
        self._path = path
        self.metadata = {}
        comment = ""
        kept: list[str] = []
        numbers: list[int] = []
        # In all Western encodings, numbers and the names of units look the same as in Windows-1252.
        for number, line in enumerate(read_text(path, "cp1252").split("\n"), 1):
            if line.lstrip().startswith("#"):
                comment = comment if kept else line.lstrip()[1:]
            elif line.strip():
                kept.append(line)
                numbers.append(number)
        stated = re.fullmatch(r"sep=(.)", kept[0].strip()) if kept else None
        if stated:
            del kept[0], numbers[0]
        while kept and not kept[-1].strip(";,\t "):  # spreadsheets write such lines for cells that were cleared
            del kept[-1], numbers[-1]
        if not kept:
            raise DescriptionError(f"{path}: holds no rows. The first line names the columns.")
        self._delimiter = stated[1] if stated else _delimiter(kept)
        if self._delimiter == " ":
            self._delimiter = "\t"
            comment, *kept = ("\t".join(line.split()) for line in (comment, *kept))
        self.labels, first = self._names(kept[0], comment)
        self._check_head(kept, numbers)
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
        while names[-1] == "" and len(names) > 1:  # some tools end every line with delimiters
            del names[-1]
        return [name or f"column {number}" for number, name in enumerate(names, 1)], 1

    def _check_head(self, lines: Sequence[str], numbers: Sequence[int]) -> None:
        """Raise DescriptionError if the first line is a heading, not the names: rows then have more cells than it."""
        middle = len(lines) // 2
        count, last = (len(self._without_end(self._cells(line))) for line in (lines[middle], lines[-1]))
        if count > len(self.labels) < last:
            remedy = " The first line must name the columns: leave out the lines above the names, or begin them with #."
            raise DescriptionError(
                f"{self._path}: line {numbers[0]} has {_counted(len(self.labels))}, line {numbers[middle]} has {count}."
                f"{self._divided(self._cells(lines[middle])) or remedy}"
            )

    def _without_end(self, cells: list[str]) -> list[str]:
        """Cells without the empty ones behind the last column."""
        while len(cells) > len(self.labels) and cells[-1] == "":
            del cells[-1]
        return cells

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
        end = self._delimiter * (count + 1 - len(self.labels))
        if count + 1 < len(self.labels) or any(line.count(self._delimiter) != count for line in self._lines):
            raise ValueError
        if end and any(not line.rstrip(" ").endswith(end) for line in self._lines):
            raise ValueError
        lines = (line.replace(",", ".") for line in self._lines) if self._comma else self._lines
        return np.loadtxt(
            lines, delimiter=self._delimiter, comments=None, quotechar='"', usecols=tuple(columns), ndmin=2
        )

    def _patiently(self, columns: Sequence[int]) -> NDArray[np.float64]:
        result = np.full((len(self._lines), len(columns)), math.nan)
        problems: list[str] = []
        for row, line in enumerate(self._lines):
            cells = self._without_end(self._cells(line))
            if len(cells) != len(self.labels):
                problems.append(
                    f"{self._path}: line {self._numbers[row]}: {_counted(len(cells))} for {len(self.labels)} columns."
                    f"{self._divided(cells)}"
                )
                continue
            numbers = (self._number(cells[column]) for column in columns)
            result[row] = [math.nan if number is None else number for number in numbers]
        if problems:
            raise DescriptionError(shortened(problems, "lines"))
        return result

    def _number(self, cell: str) -> float | None:
        if self._delimiter != "," and _COMMA.fullmatch(cell):
            cell = cell.replace(",", ".")
        return float(cell) if _NUMBER.fullmatch(cell) else _TRUTH.get(cell.lower())

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
        if _DATE.fullmatch(cell):
            return (
                f"'{cell}' is not a number but a date or a time of day. Write times in seconds, or name the columns to "
                "read and give a sampling time."
            )
        if not re.search(r"\d", cell):
            return f"'{cell}' is not a number. Leave out rows of text, and name the columns to read."
        return f"'{cell}' is not a number. Write it with a point, and without a mark for thousands."

    def _divided(self, cells: list[str]) -> str:
        """A hint, if a line looks like numbers with a decimal comma in a file divided by commas; else ""."""
        many = self._delimiter == "," and all(re.fullmatch(r"[+-]?\d+", cell) for cell in cells[1:])
        return " If numbers have a decimal comma, divide cells by semicolons." if many and len(cells) > 1 else ""


def _delimiter(lines: Sequence[str]) -> str:
    """The mark that divides cells, judged by the first line and a row. Marks inside quotation marks do not count."""
    first, row = (re.sub(r'"[^"]*"', "", line) for line in (lines[0], lines[len(lines) // 2]))
    marks = [mark for mark in ";\t," if mark in row]
    both = [mark for mark in marks if mark in first]
    if not both and len(row.split()) > 1 and len(row.split()) == len(first.split()):
        return " "
    return (both or marks or [","])[0]


def _counted(cells: int) -> str:
    return f"{cells} cell{'' if cells == 1 else 's'}"
