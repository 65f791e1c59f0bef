"""The data set of a sweep: a file for each batch of rows, so that an interrupted sweep can go on."""

from __future__ import annotations

import contextlib
import json
import os
import sys
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from ..errors import DescriptionError
from ..extras import import_extra
from ..files import PART, reason, write_file
from .plan import Point, Sweep, figure_units, variable_of

DATA_SET = "the data set of a sweep"
ABOUT = "sweep.json"
DAMAGED = ".damaged"
DIGEST = b"cosim.sweep"
"""Key of the sweep's digest in the metadata of each Parquet file.

It shows which sweep the rows belong to, even without ``sweep.json``.
"""


@dataclass(frozen=True)
class RunRow:
    """One run as the data set holds it."""

    run: int
    values: Point
    figures: Mapping[str, float]
    seconds: float
    error: str = ""


class DataSet:
    """A folder of Parquet files that together hold the rows of a sweep, and a description of it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.runs = folder / "runs"
        self.notes: list[str] = []
        """The damages that ``open`` found, one sentence each."""

    @contextlib.contextmanager
    def locked(self) -> Generator[None]:
        """Lock the folder against other sweeps. Raises DescriptionError if another sweep is writing there."""
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise DescriptionError(f"{self.folder}: cannot be made: {reason(error)}. Name another folder.") from None
        if sys.platform == "win32":
            yield
            return
        import fcntl

        try:
            number = os.open(self.folder, os.O_RDONLY)
        except OSError as error:
            raise DescriptionError(f"{self.folder}: cannot be read: {reason(error)}. Name another folder.") from None
        try:
            # The operating system releases the lock when the process ends, also by a crash. Some file systems have
            # no locks.
            with contextlib.suppress(OSError):
                try:
                    fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
                except BlockingIOError:
                    raise DescriptionError(
                        f"{self.folder}: another sweep is writing there. Wait for its end, or name another folder."
                    ) from None
            yield
        finally:
            os.close(number)

    def open(self, sweep: Sweep, *, restart: bool = False) -> set[int]:
        """Create or continue the data set of ``sweep``; returns the numbers of the runs that it holds.

        Damaged files are set aside, so their runs count as missing. Raises DescriptionError if the folder holds another
        sweep, FileError if it cannot be written.
        """
        if not self.runs.is_dir() and not (self.folder / ABOUT).exists() and any(self.folder.iterdir()):
            raise DescriptionError(f"{self.folder} is not empty and holds no sweep. Name another folder.")
        self.runs.mkdir(parents=True, exist_ok=True)
        for path in self.runs.iterdir():
            if path.suffix == PART or (restart and path.suffix in (".parquet", DAMAGED)):
                path.unlink()
        held = self._digest()
        for path in sorted(self.runs.glob("*.parquet")):
            found = self._checked(path)
            if found is not None and held is None:
                held = found
            if found not in (None, "", held):
                held = ""
        if not restart and held not in (None, sweep.digest):
            raise DescriptionError(
                f"{self.folder} holds another sweep, or one with other FMUs or records. Name another folder with "
                "--output, or start anew with --restart."
            )
        content = {
            "digest": sweep.digest,
            "name": sweep.name,
            "description": sweep.description,
            "system": sweep.system.name,
            "system_digest": sweep.system.digest,
            "method": sweep.method,
            "parameters": list(sweep.parameters),
            "units": {path: variable_of(sweep.system, path).unit or "1" for path in sweep.parameters},
            "figures": figure_units(sweep.system, sweep.metrics),
            "runs": len(sweep.points),
        }
        write_file(self.folder / ABOUT, json.dumps(content, indent=2))
        return set(self.read().column("run").to_pylist())

    def _digest(self) -> str | None:
        """The digest in ``sweep.json``; None if the file is missing or damaged."""
        path = self.folder / ABOUT
        try:
            return str(self.about()["digest"])
        except FileNotFoundError:
            return None
        except DescriptionError:
            self.notes.append(f"{path} is damaged and was written anew.")
            return None

    def about(self) -> Mapping[str, Any]:
        """The description of the sweep. Raises FileNotFoundError, or DescriptionError if it is damaged."""
        path = self.folder / ABOUT
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
            if isinstance(content, dict) and {"digest", "name", "method", "parameters", "units", "runs"} <= set(
                cast("dict[str, Any]", content)
            ):
                return cast("dict[str, Any]", content)
        except FileNotFoundError:
            raise
        except (OSError, ValueError):
            pass
        raise DescriptionError(f"{path} is damaged. The command of the sweep writes it anew.")

    def _checked(self, path: Path) -> str | None:
        """The digest in a file of rows, "" if it has none. A damaged file is set aside and gives None."""
        parquet, broken = _parquet()
        try:
            table = parquet.read_table(path)
            table.column("run")
        except (OSError, KeyError, broken) as error:
            aside = path.with_name(path.name + DAMAGED)
            os.replace(path, aside)
            text = reason(error) if isinstance(error, OSError) and error.errno else "it is not whole"
            self.notes.append(f"{path} cannot be read ({text}); it is now {aside.name}, and its runs are done again.")
            return None
        metadata = cast("dict[bytes, bytes]", table.schema.metadata or {})
        return metadata.get(DIGEST, b"").decode()

    def write(self, sweep: Sweep, rows: Sequence[RunRow]) -> None:
        """Add a file with ``rows``; it is written completely or not at all. Raises FileError."""
        arrow = import_extra("pyarrow", DATA_SET)
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
        table = arrow.table(columns).replace_schema_metadata({DIGEST: sweep.digest})
        _parquet()[0].write_table(table, buffer)
        write_file(self.runs / f"{min(row.run for row in rows):08d}.parquet", buffer.getvalue())

    def read(self) -> Any:
        """All rows as one pyarrow table, in the order of the runs. Raises DescriptionError for a damaged file."""
        arrow = import_extra("pyarrow", DATA_SET)
        parquet, broken = _parquet()
        tables: list[Any] = []
        for path in sorted(self.runs.glob("*.parquet")):
            try:
                tables.append(parquet.read_table(path))
            except (OSError, broken):
                raise DescriptionError(
                    f"{path} cannot be read: it is not whole. The command of the sweep does its runs again."
                ) from None
        if not tables:
            return arrow.table({"run": arrow.array([], arrow.int64())})
        return arrow.concat_tables(tables, promote_options="default").sort_by("run")


def _parquet() -> tuple[Any, type[Exception]]:
    """The module for Parquet files, and the exception that it raises for a damaged file."""
    return import_extra("pyarrow.parquet", DATA_SET), import_extra("pyarrow", DATA_SET).ArrowException
