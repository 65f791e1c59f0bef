"""The data set of a sweep: one file a part, written so that a stopped sweep goes on."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from ..errors import DescriptionError
from ..files import PART, write_file
from .plan import Point, Sweep


@dataclass(frozen=True)
class Row:
    """One run as it is recorded."""

    run: int
    values: Point
    figures: Mapping[str, float]
    seconds: float
    error: str = ""


# The data set


class DataSet:
    """A folder of Parquet files that together hold the rows of a sweep, and a description of it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.runs = folder / "runs"

    def open(self, sweep: Sweep, *, restart: bool = False) -> set[int]:
        """Make or take up the data set of ``sweep``; the numbers of the runs it holds.

        Raises DescriptionError if the folder holds another sweep.
        """
        about = self.folder / "sweep.json"
        if about.is_file():
            held = json.loads(about.read_text(encoding="utf-8")).get("digest")
            if restart:
                for path in self.runs.glob("*"):
                    path.unlink()
            elif held != sweep.digest:
                raise DescriptionError(
                    f"{self.folder} holds another sweep, or one with other FMUs. Name another folder with --output, "
                    "or start anew with --restart."
                )
        elif self.folder.is_dir() and any(self.folder.iterdir()):
            raise DescriptionError(f"{self.folder} is not empty and holds no sweep. Name another folder.")
        self.runs.mkdir(parents=True, exist_ok=True)
        for path in self.runs.glob(f"*{PART}"):
            path.unlink()
        content = {
            "digest": sweep.digest,
            "name": sweep.name,
            "description": sweep.description,
            "system": sweep.system.name,
            "system_hash": sweep.system.digest,
            "method": sweep.method,
            "parameters": list(sweep.parameters),
            "units": {path: sweep.system.variable(*path.split(".", 1)).unit or "1" for path in sweep.parameters},
            "runs": len(sweep.points),
        }
        write_file(about, json.dumps(content, indent=2))
        return set(self.read().column("run").to_pylist())

    def write(self, sweep: Sweep, rows: Sequence[Row]) -> None:
        """Add a file with ``rows``, complete or not at all. Raises FileError."""
        import pyarrow
        from pyarrow import parquet as _parquet

        arrow, parquet = cast(Any, pyarrow), cast(Any, _parquet)
        names = list(dict.fromkeys(name for row in rows for name in row.figures))
        columns: dict[str, Any] = {"run": arrow.array([row.run for row in rows], arrow.int64())}
        for i, path in enumerate(sweep.parameters):
            kind = arrow.float64() if isinstance(sweep.points[0][i], float) else None
            columns[path] = arrow.array([row.values[i] for row in rows], kind)
        for name in names:
            columns[name] = arrow.array([row.figures.get(name) for row in rows], arrow.float64())
        columns["seconds"] = arrow.array([row.seconds for row in rows], arrow.float64())
        columns["error"] = arrow.array([row.error or None for row in rows], arrow.string())
        buffer = arrow.BufferOutputStream()
        parquet.write_table(arrow.table(columns), buffer)
        write_file(self.runs / f"{min(row.run for row in rows):08d}.parquet", buffer.getvalue())

    def read(self) -> Any:
        """All rows as one pyarrow table, in the order of the runs."""
        import pyarrow
        from pyarrow import parquet as _parquet

        arrow, parquet = cast(Any, pyarrow), cast(Any, _parquet)
        tables = [parquet.read_table(path) for path in sorted(self.runs.glob("*.parquet"))]
        if not tables:
            return arrow.table({"run": arrow.array([], arrow.int64())})
        return arrow.concat_tables(tables, promote_options="default").sort_by("run")
