"""The result of a run: time, recorded variables with units, messages, and the origin of everything."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..errors import DescriptionError, suggest
from ..record.description import Column
from ..record.frame import dataframe, optional, signals_text, span
from ..record.write import RecordWriter

if TYPE_CHECKING:
    from .picture import Picture
    from .summary import Figure


@dataclass(frozen=True)
class Message:
    """A log message of an FMU, or of the master about an FMU; ``time`` in s."""

    instance: str
    time: float
    status: str
    category: str
    text: str

    def __str__(self) -> str:
        return f"{self.time:.9g} s {self.instance} [{self.status}] {self.text}"


@dataclass(frozen=True, repr=False)
class Result:
    """The record of a run: ``result["plant.position"]`` is an array over ``result.time``, in ``result.unit(...)``."""

    time: NDArray[np.float64]
    """Times of the recorded communication points in s."""
    rows: NDArray[np.float64]
    """Recorded values: one row for each communication point, one column for each variable."""
    columns: tuple[Column, ...]
    partial: bool
    """Whether the run ended before its stop time."""
    messages: tuple[Message, ...]
    dropped_messages: int
    """Number of messages that were not kept because there were too many."""
    solver: Mapping[str, Mapping[str, float]]
    """For each instance, the values of its ``solver.*`` variables at the end: steps, rejected, rhs_evaluations ..."""
    metadata: Mapping[str, Any]
    """Facts about the run that are written to its file: system, digest, versions, times in s ..."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the recorded variables, ``instance.variable``."""
        return tuple(column.name for column in self.columns)

    def __repr__(self) -> str:
        signals = signals_text({column.name: column.unit for column in self.columns})
        ended = ", ended early" if self.partial else ""
        return f"<Result of {self.metadata.get('system', 'a run')}: {span(self.time)}{ended}: {signals}>"

    @cached_property
    def _places(self) -> Mapping[str, int]:
        return {column.name: place for place, column in enumerate(self.columns)}

    def __contains__(self, name: object) -> bool:
        return name in self._places

    def __iter__(self) -> Iterator[str]:
        return iter(self.names)

    def __getitem__(self, name: str) -> NDArray[np.float64]:
        return self.rows[:, self._place(name)]

    def column(self, name: str) -> Column:
        """Unit and description of a recorded variable. Raises DescriptionError if it was not recorded."""
        return self.columns[self._place(name)]

    def _place(self, name: str) -> int:
        if name not in self._places:
            raise DescriptionError(f"'{name}' was not recorded.{suggest(name, self.names)}")
        return self._places[name]

    def unit(self, name: str) -> str:
        """The unit of a recorded variable; ``"1"`` if it has none. Raises DescriptionError if it was not recorded."""
        return self.column(name).unit

    def displayed(self, name: str) -> NDArray[np.float64]:
        """The values of a variable in its display unit."""
        column = self.column(name)
        if column.display_inverse:
            with np.errstate(divide="ignore"):  # the inverse of 0 is infinite
                return column.display_factor / self[name]
        return column.display_factor * self[name] + column.display_offset

    def to_dataframe(self, *, units: bool = False) -> Any:
        """A pandas DataFrame over time; ``attrs`` holds the units and the metadata.

        With ``units`` the columns are named ``plant.position [m]``, as ``cosim.read_record`` reads them from a file.
        pandas is not a dependency of this package. Raises DescriptionError if it is not installed.
        """
        named = {column.name: column.unit for column in self.columns}
        return dataframe(self.time, self.rows, named, self.metadata, in_names=units)

    def to_xarray(self) -> Any:
        """An xarray Dataset over ``time``; each variable has ``units`` and ``long_name``, ``attrs`` the metadata.

        xarray is not a dependency of this package. Raises DescriptionError if it is not installed.
        """
        xarray = optional("xarray", "to_xarray")
        variables = {
            c.name: ("time", self[c.name], {"units": c.unit, "long_name": c.description or c.name})
            for c in self.columns
        }
        time = ("time", self.time, {"units": "s", "long_name": "Time"})
        return xarray.Dataset(variables, coords={"time": time}, attrs=dict(self.metadata))

    def figures(self, start: float | None = None) -> list[Figure]:
        """The figures of merit that ``cosim run`` prints: name, value, unit of each; a missing one has its ``reason``.

        Tracking figures are those from ``start`` in s on (default: the second half of the run). Lengths are in um.
        """
        from .summary import summary

        return summary(self, start)

    def plot(self, path: str | Path | None = None, *, signals: Sequence[str] | None = None) -> Picture:
        """A picture of the run: its loops, or the named ``signals``. A notebook shows it. It is written to ``path``.

        Raises DescriptionError for names that were not recorded, FileError if the file cannot be written.
        """
        from .picture import plot

        return plot(self, path, signals=signals)

    def _repr_html_(self) -> str:
        from .notebook import result_html

        return result_html(self)

    def save(self, path: str | Path) -> Path:
        """Write the result to ``path``, a .csv or .parquet file, whole or not at all.

        CSV has commas, quoted names, time first, and the fewest digits that read back the same; a second file beside it
        has units and metadata. Parquet contains units and metadata, and needs pyarrow.
        Raises DescriptionError for another ending, FileError if the file cannot be written.
        """
        path = Path(path)
        with RecordWriter(path, self.columns, {**self.metadata, **self.ending()}) as writer:
            writer.write(self.time, self.rows)
            writer.finish({})
        return path

    def ending(self) -> dict[str, Any]:
        """The part of a file's metadata that is known only after the run."""
        return {
            "partial": self.partial,
            "solver": {instance: dict(counts) for instance, counts in self.solver.items()},
            "messages": [asdict(message) for message in self.messages],
            "dropped_messages": self.dropped_messages,
        }
