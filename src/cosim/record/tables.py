"""Tables in Parquet files and in MAT files (version 5, which MATLAB saves with ``-v7`` or ``-v6``)."""

from __future__ import annotations

import json
import pickle
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Protocol, cast

import numpy as np
from numpy.typing import NDArray

from ..errors import DescriptionError
from ..extras import import_extra, require
from ..files import reason
from .csv import CsvTable
from .description import columns_of, read_description

TEXT = (".csv", ".tsv", ".txt", ".dat")
"""Endings of files that are read as CSV."""


class Table(Protocol):
    """A file as a table: the common interface of CSV, Parquet and MAT files."""

    labels: list[str]
    units: list[str]
    """The unit of each column; "" if the file states none, or only within the label."""
    metadata: Mapping[str, object]

    def values(self, columns: Sequence[int]) -> NDArray[np.float64]:
        """The values of ``columns`` (numbers from 0), shape (rows, columns); NaN where a cell is not a number."""
        ...

    def place(self, row: int) -> str:
        """The place in the file of row number ``row`` (from 0), as text."""
        ...

    def is_number(self, row: int, column: int) -> bool:
        """Whether a cell holds a number; NaN and infinity count as numbers."""
        ...

    def wrong(self, row: int, column: int) -> str:
        """The reason why a cell holds no finite number."""
        ...


def open_table(path: Path) -> Table:
    """The table in a file. The ending of its name says how it is read.

    Raises DescriptionError for an unknown ending, and for a file that cannot be read.
    """
    ending = path.suffix.lower()
    if ending in TEXT:
        table = CsvTable(path)
        table.metadata = read_description(path)
        described = {column.name: column.unit for column in columns_of(path, table.metadata)}
        table.units = [unit or described.get(name, "") for name, unit in zip(table.labels, table.units, strict=True)]
        return table
    if ending in (".parquet", ".mat"):
        if not path.is_file():
            raise DescriptionError(f"{path}: {'is a folder' if path.is_dir() else 'no such file'}.")
        return ParquetTable(path) if ending == ".parquet" else MatTable(path)
    raise DescriptionError(f"{path}: the name of a record must end in {', '.join((*TEXT, '.parquet', '.mat'))}.")


def file_metadata(path: Path) -> Mapping[str, object]:
    """The metadata that ``open_table`` gives, without reading the rows.

    Empty for MAT files, for files that are not there, and for Parquet files without pyarrow.
    """
    ending = path.suffix.lower()
    if ending in TEXT:
        return read_description(path)
    if ending != ".parquet" or not path.is_file() or find_spec("pyarrow") is None:
        return {}
    try:
        return _decoded(import_module("pyarrow.parquet").read_metadata(path).metadata or {})
    except (import_module("pyarrow").ArrowException, OSError):
        return {}


class _Arrays:
    """A table whose columns are arrays of numbers."""

    def __init__(
        self, labels: Sequence[str], columns: Sequence[NDArray[np.float64]], metadata: Mapping[str, object]
    ) -> None:
        self.labels = list(labels)
        self.units = ["" for _ in columns]
        self.metadata = metadata
        self._columns = list(columns)

    def values(self, columns: Sequence[int]) -> NDArray[np.float64]:
        return np.column_stack([self._columns[column] for column in columns])

    def place(self, row: int) -> str:
        return f"row {row + 1}"

    def is_number(self, row: int, column: int) -> bool:
        return True

    def wrong(self, row: int, column: int) -> str:
        return f"{self._columns[column][row]:g} is not finite. Leave the row out, or interpolate before."


class ParquetTable(_Arrays):
    """A table in a Parquet file, with units and metadata as ``RecordWriter`` writes them.

    Raises DescriptionError if pyarrow is not installed, or if the file cannot be read.
    """

    def __init__(self, path: Path) -> None:
        parquet: Any = import_extra("pyarrow.parquet", f"{path}: to read Parquet")
        arrow: Any = import_module("pyarrow")
        try:
            file = parquet.ParquetFile(path)
            table = file.read()
        except (arrow.ArrowException, OSError) as error:
            raise DescriptionError(f"{path}: is no Parquet file that can be read ({error}).") from None
        columns: list[NDArray[np.float64]] = []
        self._others: dict[int, str] = {}
        """Why the values of a column are no numbers, by the number of the column."""
        of = arrow.types
        for number, column in enumerate(table.columns):
            kind = column.type
            if of.is_floating(kind) or of.is_integer(kind) or of.is_boolean(kind) or of.is_decimal(kind):
                columns.append(column.cast(arrow.float64()).to_numpy())
                continue
            columns.append(np.full(len(column), np.nan))
            self._others[number] = f"{next(iter(column.slice(0, 1).to_pylist()), None)!r} is not a number."
            if of.is_temporal(kind):
                self._others[number] = f"the values are of type {kind}. Write times in seconds, as numbers."
        super().__init__(table.column_names, columns, _decoded(file.metadata.metadata or {}))
        fields: list[Mapping[bytes, bytes] | None] = [field.metadata for field in table.schema]
        self.units = [(field or {}).get(b"unit", b"").decode("utf-8", "replace") for field in fields]

    def is_number(self, row: int, column: int) -> bool:
        return column not in self._others

    def wrong(self, row: int, column: int) -> str:
        return self._others.get(column) or super().wrong(row, column)


def _decoded(metadata: Mapping[bytes, bytes]) -> dict[str, object]:
    """The metadata of a Parquet file. Texts that are valid JSON are decoded, because ``RecordWriter`` writes JSON."""
    result: dict[str, object] = {}
    for key, value in metadata.items():
        if key == b"ARROW:schema":
            continue
        text = value.decode("utf-8", "replace")
        try:
            result[key.decode("utf-8", "replace")] = json.loads(text)
        except ValueError:
            result[key.decode("utf-8", "replace")] = text
    return result


class MatTable(_Arrays):
    """The vectors of a MAT file.

    A vector in a struct is named ``struct.field``. The columns of a matrix and the elements of a struct array or cell
    array are named ``name[1]``, ``name[2]`` ...
    Vectors of other lengths than the most common one are left out. Scalars and texts are metadata.
    Raises DescriptionError if scipy is not installed, if the file cannot be read, or if it has no vectors.
    """

    def __init__(self, path: Path) -> None:
        require("scipy", f"{path}: to read MAT files")
        content = _mat_content(path)
        vectors: dict[str, NDArray[np.float64]] = {}
        metadata: dict[str, object] = {}
        for name, value in _leaves("", {key: value for key, value in content.items() if not key.startswith("__")}):
            array = np.asarray(value)
            if array.dtype.kind not in "fiub" or array.ndim > 2:
                metadata.update({name: value} if isinstance(value, str) else {})
            elif array.ndim == 0:
                metadata[name] = array.item()
            elif array.ndim == 1:
                vectors[name] = array.astype(np.float64)
            else:
                vectors.update({f"{name}[{i + 1}]": array[:, i].astype(np.float64) for i in range(array.shape[1])})
        lengths = [vector.size for vector in vectors.values()]
        if not lengths:
            raise DescriptionError(f"{path}: holds no vectors of numbers.")
        length = max(lengths, key=lambda size: (lengths.count(size), size))
        kept = {name: vector for name, vector in vectors.items() if vector.size == length}
        super().__init__(list(kept), list(kept.values()), metadata)


_MAT_PROGRAM = """
import pickle, sys
sys.path[:] = pickle.load(sys.stdin.buffer)
try:
    import scipy.io
    answer = "content", scipy.io.loadmat(sys.argv[1], simplify_cells=True)
except NotImplementedError:
    answer = "newer", ""
except Exception as error:  # scipy raises exceptions of many classes for a damaged file
    answer = "damaged", str(error)
pickle.dump(answer, sys.stdout.buffer)
"""
"""Reads a MAT file in a process of its own: some damaged files make scipy crash its process."""


def _mat_content(path: Path) -> dict[str, Any]:
    """The variables of a MAT file by name. Raises DescriptionError."""
    try:
        command = [sys.executable, "-c", _MAT_PROGRAM, str(path)]
        done = subprocess.run(command, input=pickle.dumps(sys.path), capture_output=True, check=False)
    except OSError as error:
        raise DescriptionError(f"{path}: the process that reads it cannot be started: {reason(error)}.") from None
    kind, content = pickle.loads(done.stdout) if done.returncode == 0 else ("damaged", "reading it crashed")
    if kind == "newer":
        raise DescriptionError(f"{path}: is a MAT file of version 7.3, which is not read. Save it in MATLAB with -v7.")
    if kind == "damaged":
        raise DescriptionError(f"{path}: is no MAT file that can be read ({content}).")
    return cast("dict[str, Any]", content)


def _leaves(prefix: str, content: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    for name, value in content.items():
        if isinstance(value, dict):
            yield from _leaves(f"{prefix}{name}.", cast("dict[str, Any]", value))
        elif isinstance(value, list):
            elements = enumerate(cast("list[Any]", value), 1)
            yield from _leaves(prefix, {f"{name}[{number}]": element for number, element in elements})
        else:
            yield f"{prefix}{name}", value
