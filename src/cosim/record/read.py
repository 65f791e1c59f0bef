"""Records: columns of numbers over one time, read from CSV, Parquet and MAT files and checked."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import DescriptionError, suggest
from ..units import conversion
from .csv import shortened
from .header import TIME_NAMES, split_label, unit_text
from .tables import Table, open_table

Array = NDArray[np.float64]

UNEVEN = 0.1
"""Steps that differ by more than this fraction from the usual one are told of: logs round their times to less."""


@dataclass(frozen=True)
class Record:
    """What a file has recorded: ``columns``, one value a sample, over ``time``."""

    path: Path
    time: Array
    """In s, rising strictly."""
    columns: Mapping[str, Array]
    """By name; all of the length of ``time``, finite, in ``units``."""
    units: Mapping[str, str]
    """By name; "" where the file does not say."""
    metadata: Mapping[str, object]
    """What else the file holds: of a run its system, versions, messages ..."""

    def column(self, name: str) -> Array:
        """The values of a column. Raises DescriptionError if there is none of that name."""
        if name not in self.columns:
            raise DescriptionError(f"{self.path}: no column '{name}'.{suggest(name, self.columns)}")
        return self.columns[name]

    @property
    def step(self) -> float:
        """The usual step of time in s, the median; 0 for a single sample."""
        return float(np.median(np.diff(self.time))) if self.time.size > 1 else 0.0

    def uneven(self) -> str:
        """A sentence about steps of time that are not the usual one, "" if there is none."""
        steps = np.diff(self.time)
        others = np.flatnonzero(np.abs(steps - self.step) > UNEVEN * self.step)
        if not others.size:
            return ""
        first = int(others[0])
        return (
            f"{self.path}: {others.size} of {steps.size} steps of time are not the usual {self.step:.6g} s: the first "
            f"is {steps[first]:.6g} s, from {self.time[first]:.9g} s (row {first + 1}) to {self.time[first + 1]:.9g} s."
        )


def read_record(
    path: str | Path,
    *,
    time: str | None = None,
    time_unit: str | None = None,
    sampling_time: float | None = None,
    columns: Sequence[str] | None = None,
    units: Mapping[str, str] | None = None,
) -> Record:
    """Read a record from a .csv (.tsv, .txt, .dat), .parquet or .mat file.

    CSV: cells divided by comma, semicolon or tab, decimal point or comma, the first line names the columns, a row of
    units may follow. Units may stand in names, too: column ``x [mm]`` is ``x`` in mm. ``time`` names the column of time
    (default: the one called time or t). ``time_unit`` is its unit, by default what the file says, s if it does not. A
    record without times needs ``sampling_time`` in s; its first sample is at 0 then. ``columns`` are those to read, by
    name or by all of the label, default all. ``units`` says units that the file does not say, or says wrongly; values
    stay as they are.
    Parquet needs the extra ``parquet``, MAT (version 5) the extra ``tools``.
    Raises DescriptionError that names row and column of what is no finite number, and times that do not rise.
    """
    path = Path(path)
    table = open_table(path)
    names = _Names(path, table)
    problems: list[str] = []
    time_column = _time_column(names, time, sampling_time, problems)
    if columns is None:
        chosen = {name: i for i, name in enumerate(names.names) if i != time_column}
    else:
        chosen = {name: i for name in columns if (i := names.find(name, problems)) is not None}
    stated = {
        number: unit for name, unit in (units or {}).items() if (number := names.find(name, problems)) is not None
    }
    if problems:
        raise DescriptionError(problems)
    if not chosen:
        raise DescriptionError(f"{path}: holds no column beside its time.")
    wanted = [*chosen.values(), *([] if time_column is None else [time_column])]
    wanted = sorted(set(wanted))
    values = table.values(wanted)
    if not len(values):
        raise DescriptionError(f"{path}: holds no rows.")
    in_order = {number: np.ascontiguousarray(values[:, place]) for place, number in enumerate(wanted)}
    found = {number: unit_text(stated.get(number, names.units[number])) for number in wanted}
    wrong = [
        (row, wanted[place], f"{names.names[wanted[place]]}: {table.wrong(row, wanted[place])}")
        for row, place in np.argwhere(~np.isfinite(values)).tolist()
    ]
    if time_column is None:
        seconds = np.arange(len(values), dtype=np.float64) * float(sampling_time or 0.0)
    else:
        unit = found[time_column] if time_unit is None else unit_text(time_unit)
        seconds = _seconds(path, names.names[time_column], in_order[time_column], unit)
        wrong += [(row, time_column, f"{names.names[time_column]}: {why}") for row, why in _falling(seconds)]
    if wrong:
        texts = [f"{path}: {table.place(row)}, column {text}" for row, _, text in sorted(wrong)]
        raise DescriptionError(shortened(path, texts))
    return Record(
        path,
        seconds,
        {name: in_order[number] for name, number in chosen.items()},
        {name: found[number] for name, number in chosen.items()},
        table.metadata,
    )


class _Names:
    """Names and units of the columns of a table. Raises DescriptionError for names that stand twice."""

    def __init__(self, path: Path, table: Table) -> None:
        self.path = path
        self.labels = table.labels
        split = [
            (label, "") if unit else split_label(label) for label, unit in zip(table.labels, table.units, strict=True)
        ]
        self.names = [name for name, _ in split]
        self.units = [stated or unit for stated, (_, unit) in zip(table.units, split, strict=True)]
        # "x [mm]" and "x [N]" differ by their units only: they keep them.
        self.names = [
            label if self.names.count(name) > 1 else name for name, label in zip(self.names, self.labels, strict=True)
        ]
        twice = sorted({name for name in self.names if self.names.count(name) > 1})
        if twice:
            raise DescriptionError(f"{path}: more than one column is called {', '.join(map(repr, twice))}. Rename one.")

    def find(self, name: str, problems: list[str]) -> int | None:
        """The number of a column, by its name or all of its label."""
        for names in (self.names, self.labels):
            if name in names:
                return names.index(name)
        problems.append(f"{self.path}: no column '{name}'.{suggest(name, self.names)}")
        return None


def _time_column(names: _Names, time: str | None, sampling_time: float | None, problems: list[str]) -> int | None:
    if sampling_time is not None:
        if time is not None:
            problems.append(f"{names.path}: give a column of time or a sampling time, not both.")
        elif not (math.isfinite(sampling_time) and sampling_time > 0.0):
            problems.append(f"sampling time {sampling_time:g} s: must be a finite number above 0.")
        return None
    if time is not None:
        return names.find(time, problems)
    for known in TIME_NAMES:
        # In a MAT file the time may be a field of a struct.
        found = [i for i, name in enumerate(names.names) if name.rpartition(".")[2].strip().casefold() == known]
        if len(found) == 1:
            return found[0]
    marks = " Cells are divided by comma, semicolon or tab." if len(names.names) == 1 else ""
    known = suggest("time", names.names)
    problems.append(f"{names.path}: which column is the time? Name it, or give a sampling time.{known}{marks}")
    return None


def _seconds(path: Path, name: str, values: Array, unit: str) -> Array:
    try:
        factor = conversion(unit or "s", "s")
    except DescriptionError:
        raise DescriptionError(f"{path}: column {name}: '{unit}' is no unit of time.") from None
    return values if factor == 1.0 else values * factor


def _falling(time: Array) -> list[tuple[int, str]]:
    """Rows whose time is not after that of the row before, and what is wrong there."""
    return [
        (row + 1, f"{time[row + 1]:.9g} s is not after {time[row]:.9g} s, the time of the row before. Times must rise.")
        for row in np.flatnonzero(np.diff(time) <= 0.0).tolist()
    ]
