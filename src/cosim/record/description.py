"""The JSON file beside a CSV record. It holds the units, descriptions and metadata that a CSV file cannot hold.

Its name and its vocabulary follow the W3C recommendation Metadata Vocabulary for Tabular Data (CSV on the Web, 2015):
``run.csv-metadata.json`` describes ``run.csv``. Entries that are not in this vocabulary are in its ``notes``.
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
    """The description of a recorded variable.

    ``value in display_unit = display_factor*value + display_offset``, or ``display_factor/value`` for an inverse unit.
    """

    name: str
    unit: str
    description: str
    display_unit: str
    display_factor: float = 1.0
    display_offset: float = 0.0
    display_inverse: bool = False


def description_path(csv: Path) -> Path:
    """The path of the description of a CSV file."""
    return csv.parent / f"{csv.name}-metadata.json"


def description_of(csv: Path, columns: Sequence[Column], metadata: Mapping[str, Any], size: int) -> bytes:
    """The description of a CSV file of ``size`` bytes, as the content of a JSON file."""
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
    """The metadata of a file, with the description of all its columns under ``columns``."""
    return {**metadata, "columns": [asdict(column) for column in columns]}


def read_description(csv: Path) -> dict[str, Any]:
    """The metadata of a CSV file that a run wrote; empty if there are none.

    Raises DescriptionError if the CSV file has another size than the run wrote. Its units could then be wrong.
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

    Raises DescriptionError if an entry does not have the fields of ``Column``.
    """
    try:
        return [Column(**entry) for entry in cast("Sequence[dict[str, Any]]", metadata.get("columns", ()))]
    except TypeError:
        raise DescriptionError(f"{path}: its metadata describe columns in a way that is not known here.") from None
