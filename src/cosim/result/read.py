"""Reads the result of a run back from its file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np

from ..errors import DescriptionError, shortened
from ..record.description import Column, columns_of
from ..record.tables import Table, file_metadata, open_table
from .result import Message, Result

TIME = "time"


def read_result(path: str | Path) -> Result:
    """The result of a run from the .csv or .parquet file that ``Result.save`` or ``cosim run --output`` wrote.

    The result has the units, descriptions, display units, messages and metadata of the run. For a CSV file they are in
    a second file beside it. Without this file, all units are "1" and there are no metadata. Values that are not finite
    are kept.
    Raises DescriptionError for a file that is not readable, or whose first column is not ``time``. Use
    ``cosim.read_record`` for other records.
    """
    path = Path(path)
    table = open_table(path)
    if not table.labels or table.labels[0] != TIME:
        raise DescriptionError(f"{path}: is no result of a run: its first column is not '{TIME}'. Read it as a record.")
    metadata = dict(table.metadata)
    known = {column.name: column for column in columns_of(path, metadata)}
    metadata.pop("columns", None)
    columns = [
        known.get(name, Column(name, unit or "1", "", unit or "1"))
        for name, unit in zip(table.labels[1:], table.units[1:], strict=True)
    ]
    values = _numbers(path, table)
    messages = cast("Sequence[Mapping[str, Any]]", metadata.pop("messages", ()))
    solver = cast("Mapping[str, Mapping[str, float]]", metadata.pop("solver", {}))
    return Result(
        time=np.ascontiguousarray(values[:, 0]),
        rows=np.ascontiguousarray(values[:, 1:]),
        columns=tuple(columns),
        partial=bool(metadata.pop("partial", False)),
        messages=tuple(Message(**message) for message in messages),
        dropped_messages=cast("int", metadata.pop("dropped_messages", 0)),
        solver=solver,
        metadata=metadata,
    )


def _numbers(path: Path, table: Table) -> Any:
    """All values of a table, shape (rows, columns). Raises DescriptionError for cells that hold no number."""
    values = table.values(range(len(table.labels)))
    wrong = [
        f"{path}: {table.place(row)}, column {table.labels[column]}: {table.wrong(row, column)}"
        for row, column in np.argwhere(~np.isfinite(values)).tolist()
        if not table.is_number(row, column)
    ]
    if wrong:
        raise DescriptionError(shortened(wrong, "cells"))
    return values


def holds_result(path: Path) -> bool:
    """Whether a file was written by a run, with its metadata.

    Raises DescriptionError for a CSV file that was changed after the run.
    """
    return "system_digest" in file_metadata(path)
