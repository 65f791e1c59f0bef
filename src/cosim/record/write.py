"""Writes the file of a record, at once or during the run. The file is there whole or not at all."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Generator, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Self

import numpy as np
from numpy.typing import NDArray

from ..errors import DescriptionError
from ..extras import require
from ..files import Replacement, cannot_write, check_no_folder, check_writable
from .description import Column, description_of, description_path, metadata_with

FORMATS = (".csv", ".parquet")

PARQUET_BYTES, CSV_BYTES = 2**26, 2**22
"""Size of the rows that are written at a time, in bytes.

Rows are copied before they are written. As CSV text they are several times larger.
"""


class _CsvFile:
    """CSV with commas between columns and quoted names. Numbers have the fewest digits that read back the same."""

    def __init__(self, file: BinaryIO, columns: Sequence[Column]) -> None:
        self._file = file
        names = (column.name.replace('"', '""') for column in columns)
        file.write((",".join(f'"{name}"' for name in names) + "\n").encode())

    def write(self, table: NDArray[np.float64]) -> None:
        self._file.write("".join(",".join(map(repr, row)) + "\n" for row in table.tolist()).encode())

    def close(self, late: Mapping[str, str]) -> None:
        pass


class _ParquetFile:
    """Parquet with units in the columns and metadata in the schema.

    Metadata that are known only at the end of the run are key-value metadata of the file.
    """

    def __init__(self, file: BinaryIO, columns: Sequence[Column], metadata: Mapping[str, str]) -> None:
        self._arrow: Any = import_module("pyarrow")
        fields = [
            self._arrow.field(
                c.name,
                self._arrow.float64(),
                metadata={"unit": c.unit, "display_unit": c.display_unit, "description": c.description},
            )
            for c in columns
        ]
        self._schema = self._arrow.schema(fields, dict(metadata))
        # Arrow writes to a Python file object, so that an OSError reaches the caller unchanged.
        self._writer: Any = import_module("pyarrow.parquet").ParquetWriter(file, self._schema)

    def write(self, table: NDArray[np.float64]) -> None:
        arrays = [self._arrow.array(np.ascontiguousarray(column)) for column in table.T]
        self._writer.write_table(self._arrow.Table.from_arrays(arrays, schema=self._schema))

    def close(self, late: Mapping[str, str]) -> None:
        if late:
            self._writer.add_key_value_metadata(dict(late))
        self._writer.close()


class RecordWriter:
    """Writes rows to ``path`` (.csv or .parquet) as they come. As a context manager it keeps only a finished file.

    Units, descriptions and metadata of a CSV file are in a second file beside it (module ``description``).
    Raises DescriptionError for another ending or a folder, FileError if the file cannot be written.
    """

    def __init__(self, path: Path, columns: Sequence[Column], metadata: Mapping[str, Any]) -> None:
        check_format(path)
        check_no_folder(path)
        all_columns = (Column("time", "s", "Time", "s"), *columns)
        csv = path.suffix.lower() == ".csv"
        self._path = path
        self._columns = all_columns
        self._metadata = dict(metadata)
        self._csv = csv
        self._piece = max(1, (CSV_BYTES if csv else PARQUET_BYTES) // (8 * len(all_columns)))
        self._new = Replacement(path)
        with self._written():
            self._file = (
                _CsvFile(self._new.file, all_columns)
                if csv
                else _ParquetFile(self._new.file, all_columns, _texts(metadata_with(all_columns, metadata)))
            )

    def write(self, times: NDArray[np.float64], rows: NDArray[np.float64]) -> None:
        """Add ``rows``, one for each of ``times`` in s; shape (times, columns). Raises FileError."""
        with self._written():
            for first in range(0, len(rows), self._piece):
                part = slice(first, first + self._piece)
                self._file.write(np.column_stack((times[part], rows[part])))

    def finish(self, late: Mapping[str, Any]) -> None:
        """Complete the file with ``late`` metadata and give it its name. Raises FileError."""
        with self._written():
            self._file.close(_texts(late))
        if not self._csv:
            self._new.commit()
            return
        content = description_of(self._path, self._columns, {**self._metadata, **late}, self._new.file.tell())
        try:
            # Both files are complete on the disk before either gets its name. The record gets its name first.
            with Replacement(description_path(self._path)) as description:
                description.file.write(content)
                description.file.flush()
                self._new.commit()
        except BaseException:
            self.discard()
            raise

    def discard(self) -> None:
        """Remove the unfinished file. An older file at ``path`` stays."""
        self._new.discard()

    @contextlib.contextmanager
    def _written(self) -> Generator[None]:
        try:
            yield
        except OSError as error:
            self.discard()
            raise cannot_write(self._path, error) from None
        except BaseException:
            self.discard()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is not None:
            self.discard()


def check_format(path: Path) -> None:
    """Raise DescriptionError for another ending than .csv or .parquet, or for .parquet without pyarrow."""
    if path.suffix.lower() not in FORMATS:
        raise DescriptionError(f"{path}: the name must end in {' or '.join(FORMATS)}.")
    if path.suffix.lower() == ".parquet":
        require("pyarrow", f"{path}: to write Parquet", "name a .csv file")


def check_output(path: Path) -> None:
    """Check that a record can be written to ``path``. Raises DescriptionError or FileError if it cannot."""
    check_format(path)
    check_writable(path)


def _texts(metadata: Mapping[str, Any]) -> dict[str, str]:
    return {key: value if isinstance(value, str) else json.dumps(value) for key, value in metadata.items()}
