"""The file of a record: written at once or while the run goes on, there whole or not at all."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from ..errors import DescriptionError
from ..files import Replacement, cannot_write, check_writable

FORMATS = (".csv", ".parquet")

PIECE_BYTES = 2**26
"""Size of what is written at a time: a copy of so much of the rows is made."""


@dataclass(frozen=True)
class Column:
    """What a recorded variable is; ``value in display_unit = display_factor*value + display_offset``."""

    name: str
    unit: str
    text: str
    display_unit: str
    display_factor: float = 1.0
    display_offset: float = 0.0


class RecordWriter:
    """Writes rows to ``path`` as they come; a context manager that keeps the file only if there was no exception.

    .csv has a comma between columns, quoted names, time first, and the shortest digits that read back the same.
    .parquet has units with each column and ``metadata`` with the schema, as JSON where it is not text; what is known
    at the end only, ``late``, is among the key-value metadata of the file.
    Raises DescriptionError for another ending, FileError if the file cannot be written.
    """

    def __init__(self, path: Path, columns: Sequence[Column], metadata: Mapping[str, Any]) -> None:
        check_format(path)
        self._path = path
        self._arrow: Any = import_module("pyarrow")
        fields = [
            self._arrow.field(
                c.name, self._arrow.float64(), metadata={"unit": c.unit, "display_unit": c.display_unit, "text": c.text}
            )
            for c in (Column("time", "s", "Time", "s"), *columns)
        ]
        self._schema = self._arrow.schema(fields, _texts(metadata))
        self._new = Replacement(path)
        self._writer: Any = None
        try:
            # Arrow writes to a file of Python, whose errors come through as they are.
            if path.suffix.lower() == ".csv":
                self._writer = import_module("pyarrow.csv").CSVWriter(self._new.file, self._schema)
            else:
                self._writer = import_module("pyarrow.parquet").ParquetWriter(self._new.file, self._schema)
        except OSError as error:
            self.discard()
            raise cannot_write(path, error) from None

    def write(self, times: NDArray[np.float64], rows: NDArray[np.float64]) -> None:
        """Add rows, one a time."""
        piece = max(1, PIECE_BYTES // (8 * (1 + rows.shape[1])))
        try:
            for first in range(0, max(len(rows), 1), piece):
                part = slice(first, first + piece)
                columns = [times[part], *(np.ascontiguousarray(rows[part, i]) for i in range(rows.shape[1]))]
                arrays = [self._arrow.array(column) for column in columns]
                self._writer.write_table(self._arrow.Table.from_arrays(arrays, schema=self._schema))
        except OSError as error:
            self.discard()
            raise cannot_write(self._path, error) from None

    def finish(self, late: Mapping[str, Any]) -> None:
        """Complete the file and give it its name."""
        try:
            if late and self._path.suffix.lower() == ".parquet":
                self._writer.add_key_value_metadata(_texts(late))
            self._writer.close()
        except OSError as error:
            self.discard()
            raise cannot_write(self._path, error) from None
        self._new.commit()

    def discard(self) -> None:
        """Leave everything as it was."""
        if self._writer is not None:
            try:
                self._writer.close()
            except (OSError, ValueError):
                pass  # It writes the end of a file that is removed next.
        self._new.discard()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is not None:
            self.discard()


def check_format(path: Path) -> None:
    """Raise DescriptionError unless ``path`` ends as a record can."""
    if path.suffix.lower() not in FORMATS:
        raise DescriptionError(f"{path}: the name must end in {' or '.join(FORMATS)}.")


def check_output(path: Path) -> None:
    """Raise DescriptionError unless results can be written as ``path`` says."""
    check_format(path)
    check_writable(path)


def _texts(metadata: Mapping[str, Any]) -> dict[str, str]:
    return {key: value if isinstance(value, str) else json.dumps(value) for key, value in metadata.items()}
