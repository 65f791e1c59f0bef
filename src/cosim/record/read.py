"""Records: signals over a common time, read from CSV, Parquet and MAT files and checked."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import DescriptionError, shortened, suggest
from ..units import conversion
from .frame import dataframe, signals_text, span
from .header import TIME_NAMES, split_label, unit_text
from .resample import EXACT, UNEVEN, usual_step
from .tables import TEXT, Table, open_table

Array = NDArray[np.float64]


LONGEST_GAP = 5.0
"""Longest step of time, in usual steps, over which a record is interpolated: some samples that a logger lost."""


@dataclass(frozen=True, repr=False)
class Record:
    """The signals of a file: ``record["x"]`` is an array over ``record.time``, in ``record.units["x"]``."""

    path: Path
    time: Array
    """Times in s, strictly increasing."""
    columns: Mapping[str, Array]
    """Values by name. Each column has the length of ``time``; all values are finite."""
    units: Mapping[str, str]
    """Unit of each column by name; "" if the file does not state it."""
    metadata: Mapping[str, object]
    """Other data in the file. The file of a run holds its system, versions, messages ..."""

    def __repr__(self) -> str:
        signals = signals_text(self.units)
        return f"<Record {self.path.name}: {span(self.time)}, every {self.step:.6g} s: {signals}>"

    def __getitem__(self, name: str) -> Array:
        """The values of a column. Raises DescriptionError if there is no column of this name."""
        return self.column(name)

    def column(self, name: str) -> Array:
        """The values of a column. Raises DescriptionError if there is no column of this name."""
        if name not in self.columns:
            raise DescriptionError(f"{self.path}: no column '{name}'.{suggest(name, self.columns)}")
        return self.columns[name]

    def to_dataframe(self, *, units: bool = False) -> Any:
        """A pandas DataFrame over time; ``attrs`` holds the units and the metadata. With ``units`` names have units.

        pandas is not a dependency of this package. Raises DescriptionError if it is not installed.
        """
        values = np.column_stack(list(self.columns.values()))
        return dataframe(self.time, values, dict(self.units), self.metadata, in_names=units)

    @property
    def step(self) -> float:
        """The usual step of time in s: the mean if no step is uneven, else the median; 0 for a single sample."""
        return usual_step(self.time)

    def resampled(self, step: float | None = None, *, longest_gap: float = LONGEST_GAP) -> Record:
        """The record at equal steps of ``step`` in s (default: its usual step), on the lines between its samples.

        Raises DescriptionError if two samples are further apart than ``longest_gap`` usual steps: the line between
        them would be no measurement.
        """
        gaps = np.flatnonzero(np.diff(self.time) > longest_gap * self.step)
        if gaps.size:
            first = int(gaps[0])
            raise DescriptionError(
                f"{self.path}: {gaps.size} gap{'s' if gaps.size > 1 else ''} of more than {longest_gap:g} steps of "
                f"{self.step:.6g} s: the first is from {self.time[first]:.9g} s to "
                f"{self.time[first + 1]:.9g} s. Use a part of the record without gaps."
            )
        own = self.step if step is None else step
        if not (math.isfinite(own) and own > 0.0):
            raise DescriptionError(f"{self.path}: a step of {own:g} s: must be a finite number above 0.")
        count = math.floor((self.time[-1] - self.time[0]) / own + EXACT) + 1
        time: Array = self.time[0] + own * np.arange(count, dtype=np.float64)
        columns: dict[str, Array] = {
            name: np.interp(time, self.time, values).astype(np.float64) for name, values in self.columns.items()
        }
        return replace(self, time=time, columns=columns)

    def uneven(self) -> str:
        """A sentence about steps of time that differ from the usual step; "" if all are equal."""
        steps = np.diff(self.time)
        others = np.flatnonzero(np.abs(steps - self.step) > UNEVEN * self.step)
        if not others.size:
            return ""
        first = int(others[0])
        return (
            f"{self.path}: {others.size} of {steps.size} steps of time are not the usual {self.step:.6g} s: the first "
            f"is {steps[first]:.6g} s, from {self.time[first]:.9g} s (row {first + 1}) to {self.time[first + 1]:.9g} s."
        )


def _chosen(
    names: _Names, time_column: int | None, columns: Sequence[str] | None, units: Mapping[str, str], problems: list[str]
) -> tuple[dict[str, int], dict[int, str]]:
    """Name -> number of each column to be read, and number -> unit of those whose unit is given.

    Raises DescriptionError with ``problems``, which were found before, and those of these names.
    """
    if columns is None:
        chosen = {name: i for i, name in enumerate(names.names) if i != time_column}
    else:
        chosen = {name: i for name in columns if (i := names.find(name, problems)) is not None}
    stated = {number: unit for name, unit in units.items() if (number := names.find(name, problems)) is not None}
    if problems:
        raise DescriptionError(problems)
    if not chosen:
        raise DescriptionError(f"{names.path}: holds no column beside its time.")
    return chosen, stated


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

    In a CSV file, comma, semicolon, tab or blanks divide the cells. Numbers have a decimal point or comma. The first
    line names the columns; a row of units may follow. A name may hold the unit: column ``x [mm]`` is ``x`` in mm.
    Parquet needs the extra ``parquet``, MAT (version 5) the extra ``tools``.

    ``time``: name of the column of time (default: the column called time, t or zeit).
    ``time_unit``: its unit (default: the unit in the file, else s).
    ``sampling_time``: in s, for a record without times. The first sample is then at 0 s.
    ``columns``: names or full labels of the columns to read (default: all).
    ``units``: units of columns by name, where the file states none or a wrong one. Values are not converted.

    Raises DescriptionError for unknown columns, for values that are not finite numbers (with row and column), and for
    times that do not increase.
    """
    path = Path(path)
    table = open_table(path)
    names = _Names(path, table)
    problems: list[str] = []
    time_column = _time_column(names, time, sampling_time, problems)
    chosen, stated = _chosen(names, time_column, columns, units or {}, problems)
    read = set(chosen.values()) if time_column is None else {*chosen.values(), time_column}
    wanted = sorted(read)
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
        raise DescriptionError(shortened(texts, "cells"))
    return Record(
        path,
        seconds,
        {name: in_order[number] for name, number in chosen.items()},
        {name: found[number] for name, number in chosen.items()},
        table.metadata,
    )


class _Names:
    """Names and units of the columns of a table. Raises DescriptionError if two columns have the same name."""

    def __init__(self, path: Path, table: Table) -> None:
        self.path = path
        self.labels = table.labels
        split = [
            (label, "") if unit else split_label(label) for label, unit in zip(table.labels, table.units, strict=True)
        ]
        self.names = [name for name, _ in split]
        self.units = [stated or unit for stated, (_, unit) in zip(table.units, split, strict=True)]
        # "x [mm]" and "x [N]" differ only in their units. Such columns keep the unit in their name.
        self.names = [
            label if self.names.count(name) > 1 else name for name, label in zip(self.names, self.labels, strict=True)
        ]
        twice = sorted({name for name in self.names if self.names.count(name) > 1})
        if twice:
            raise DescriptionError(f"{path}: more than one column is called {', '.join(map(repr, twice))}. Rename one.")

    def find(self, name: str, problems: list[str]) -> int | None:
        """The number (from 0) of a column, by its name or its full label. None for an unknown name, and a problem."""
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
    whole = [name.strip().casefold() for name in names.names]
    # In a MAT file the time may be a field of a struct.
    for parts in (whole, [name.rpartition(".")[2].strip() for name in whole]):
        for known in TIME_NAMES:
            if parts.count(known) == 1:
                return parts.index(known)
    alone = len(names.names) == 1 and names.path.suffix.lower() in TEXT
    marks = " Cells are divided by comma, semicolon, tab or blanks." if alone else ""
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
    """The rows whose time is not after the time of the row before, each with a message."""
    return [
        (row + 1, f"{time[row + 1]:.9g} s is not after {time[row]:.9g} s, the time of the row before. Times must rise.")
        for row in np.flatnonzero(np.diff(time) <= 0.0).tolist()
    ]
