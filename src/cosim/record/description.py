"""What a CSV file of ours cannot hold: units, texts and metadata, in a JSON file beside it.

It lies where tools look for it by the W3C's recommendation Metadata Vocabulary for Tabular Data (CSV on the Web, 2015),
as ``run.csv-metadata.json`` beside ``run.csv``, and is written in that vocabulary. What is ours stands in its notes.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, cast

from ..errors import DescriptionError

CONTEXT = "http://www.w3.org/ns/csvw"


@dataclass(frozen=True)
class Column:
    """What a recorded variable is; ``value in display_unit = display_factor*value + display_offset``."""

    name: str
    unit: str
    description: str
    display_unit: str
    display_factor: float = 1.0
    display_offset: float = 0.0


def description_path(csv: Path) -> Path:
    """Where the description of a CSV file lies."""
    return csv.with_name(f"{csv.name}-metadata.json")


def description_of(csv: Path, columns: Sequence[Column], metadata: Mapping[str, Any], size: int) -> bytes:
    """The description of a CSV file of ``size`` bytes."""
    content = {
        "@context": CONTEXT,
        "url": csv.name,
        "tableSchema": {
            "columns": [
                {"titles": c.name, "datatype": "double", "dc:description": c.description, "schema:unitText": c.unit}
                for c in columns
            ]
        },
        "notes": [{"cosim": metadata_with(columns, metadata), "bytes": size}],
    }
    return (json.dumps(content, indent=1) + "\n").encode()


def metadata_with(columns: Sequence[Column], metadata: Mapping[str, Any]) -> dict[str, Any]:
    """The metadata of a file, and all that is known of its columns."""
    return {**metadata, "columns": [asdict(column) for column in columns]}


def read_description(csv: Path) -> dict[str, Any]:
    """The metadata of a CSV file that a run wrote; empty if there are none.

    Raises DescriptionError if the file has changed since: units and all else may be those of another record.
    """
    path = description_path(csv)
    try:
        note = json.loads(path.read_text(encoding="utf-8"))["notes"][0]
        metadata, size = cast("dict[str, Any]", note["cosim"]), int(note["bytes"])
        now = csv.stat().st_size
    except (OSError, ValueError, LookupError, TypeError):
        return {}
    if size != now:
        raise DescriptionError(
            f"{csv}: has {now} bytes, and {path.name} describes a file of {size}: it was changed after the run. Remove "
            f"{path.name} to read it without what is said there, such as units."
        )
    return metadata


def columns_of(path: Path, metadata: Mapping[str, object]) -> list[Column]:
    """The columns that the metadata of the file ``path`` describe; empty for files of other tools.

    Raises DescriptionError if they are not written as ours.
    """
    try:
        return [Column(**entry) for entry in cast("Sequence[dict[str, Any]]", metadata.get("columns", ()))]
    except TypeError:
        raise DescriptionError(f"{path}: its metadata describe columns in a way that is not known here.") from None
