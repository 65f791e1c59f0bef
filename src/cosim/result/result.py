"""What a run gives: time, recorded variables with units, messages, and where it all came from."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import DescriptionError, suggest

FORMATS = (".csv", ".parquet")
CSV_ROWS = 50_000
"""Rows that are turned into text at a time."""


@dataclass(frozen=True)
class Message:
    """A log message of an FMU, or of the master about it."""

    instance: str
    time: float
    status: str
    category: str
    text: str

    def __str__(self) -> str:
        return f"{self.time:.9g} s {self.instance} [{self.status}] {self.text}"


@dataclass(frozen=True)
class Column:
    """What a recorded variable is; ``value in display_unit = display_factor*value + display_offset``."""

    name: str
    unit: str
    text: str
    display_unit: str
    display_factor: float = 1.0
    display_offset: float = 0.0


@dataclass(frozen=True)
class Result:
    """The record of a run: ``result["plant.position"]`` is an array over ``result.time``, in ``result.unit(...)``."""

    time: NDArray[np.float64]
    rows: NDArray[np.float64]
    """One row a recorded communication point, one column a variable."""
    columns: tuple[Column, ...]
    partial: bool
    """Whether the run ended before its stop time."""
    messages: tuple[Message, ...]
    dropped_messages: int
    """Messages that came after so many that they were no longer kept."""
    solver: Mapping[str, Mapping[str, float]]
    """By instance, what its ``solver.*`` variables said at the end: steps, rejected, rhs_evaluations ..."""
    metadata: Mapping[str, Any]
    """System, hash, versions, times in seconds: what a file keeps about the run."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the recorded variables, ``instance.variable``."""
        return tuple(column.name for column in self.columns)

    def __contains__(self, name: object) -> bool:
        return any(column.name == name for column in self.columns)

    def __iter__(self) -> Iterator[str]:
        return iter(self.names)

    def __getitem__(self, name: str) -> NDArray[np.float64]:
        return self.rows[:, self.columns.index(self.column(name))]

    def column(self, name: str) -> Column:
        """Unit and text of a recorded variable. Raises DescriptionError if it was not recorded."""
        for column in self.columns:
            if column.name == name:
                return column
        raise DescriptionError(f"'{name}' was not recorded.{suggest(name, self.names)}")

    def unit(self, name: str) -> str:
        """The unit of a recorded variable, ``"1"`` if it has none."""
        return self.column(name).unit

    def displayed(self, name: str) -> NDArray[np.float64]:
        """The values of a variable in its display unit."""
        column = self.column(name)
        return column.display_factor * self[name] + column.display_offset

    def to_dataframe(self) -> Any:
        """A pandas DataFrame over time; ``attrs`` holds the units and the metadata.

        pandas is no dependency of this package: raises DescriptionError if it is not installed.
        """
        try:
            pandas = import_module("pandas")
        except ModuleNotFoundError:
            raise DescriptionError("to_dataframe needs pandas, which is not installed: pip install pandas.") from None
        frame = pandas.DataFrame(self.rows, index=pandas.Index(self.time, name="time"), columns=list(self.names))
        frame.attrs["units"] = {column.name: column.unit for column in self.columns}
        frame.attrs["metadata"] = dict(self.metadata)
        return frame

    def save(self, path: str | Path) -> Path:
        """Write ``path`` as .csv (comma, quoted names, time first, shortest digits that read back the same) or .parquet
        (units with each column, metadata with the file; needs pyarrow). Raises DescriptionError, as ``check_output``.
        """
        path = Path(path)
        check_output(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.suffix.lower() == ".csv":
            self._write_csv(path)
        else:
            import_module("pyarrow.parquet").write_table(self._table(), path)
        return path

    def _write_csv(self, path: Path) -> None:
        names = ",".join('"' + name.replace('"', '""') + '"' for name in ("time", *self.names))
        with path.open("w", encoding="utf-8", newline="\n") as file:
            file.write(names + "\n")
            for begin in range(0, self.time.size, CSV_ROWS):
                part = slice(begin, begin + CSV_ROWS)
                rows = np.column_stack((self.time[part], self.rows[part])).tolist()
                file.writelines(",".join(map(repr, row)) + "\n" for row in rows)

    def _table(self) -> Any:
        """All of it as a pyarrow table."""
        arrow: Any = import_module("pyarrow")
        names: Sequence[Column] = (Column("time", "s", "Time", "s"), *self.columns)
        fields = [
            arrow.field(
                c.name, arrow.float64(), metadata={"unit": c.unit, "display_unit": c.display_unit, "text": c.text}
            )
            for c in names
        ]
        metadata = {key: value if isinstance(value, str) else json.dumps(value) for key, value in self.metadata.items()}
        metadata["partial"] = json.dumps(self.partial)
        metadata["solver"] = json.dumps({instance: dict(counts) for instance, counts in self.solver.items()})
        columns = [self.time, *(np.ascontiguousarray(self.rows[:, i]) for i in range(len(self.columns)))]
        return arrow.Table.from_arrays([arrow.array(c) for c in columns], schema=arrow.schema(fields, metadata))


def check_output(path: Path) -> None:
    """Raise DescriptionError unless results can be written as ``path`` says."""
    if path.suffix.lower() not in FORMATS:
        raise DescriptionError(f"{path}: the name must end in {' or '.join(FORMATS)}.")
    if path.suffix.lower() == ".parquet" and find_spec("pyarrow") is None:
        raise DescriptionError(
            f"{path}: to write Parquet needs pyarrow, which is not installed: install motion-cosim[parquet], "
            "or name a .csv file."
        )
    if path.is_dir():
        raise DescriptionError(f"{path} is a folder. Name a file.")
