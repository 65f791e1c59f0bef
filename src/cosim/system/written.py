"""Writes connections and signals of a checked system with the keys of a system file. Reading them gives the same."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..record.description import description_path
from .parts import Connection

_UNUSABLE = re.compile(r'[\x00-\x1f"*:<>?\\|\ud800-\udfff]')
"""Control characters, those that Windows reserves, and bytes that are not UTF-8."""

if TYPE_CHECKING:
    from .system import System


def connection_entries(connections: Sequence[Connection]) -> list[str | dict[str, Any]]:
    """The entries of the list ``connections``; all connections of a sum are one entry."""
    groups: dict[tuple[str, str], list[Connection]] = {}
    for connection in connections:
        groups.setdefault(connection.target, []).append(connection)
    return [_entry(group) for group in groups.values()]


def _entry(group: Sequence[Connection]) -> str | dict[str, Any]:
    first = group[0]
    short = arrow(first)
    plain = first.units == "same" and first.stated == (1.0, 0.0) and first.noise is None
    if short is not None and plain and len(group) == 1:
        return short
    factors = [connection.stated[0] for connection in group]
    offset = first.stated[1]
    entry: dict[str, Any] = {"from": ".".join(first.source), "to": ".".join(first.target)}
    if len(group) > 1:
        entry["from"] = [".".join(connection.source) for connection in group]
        if any(factor != 1.0 for factor in factors):
            entry["factors"] = factors
    elif first.units == "given" or factors != [1.0]:
        entry["factor"] = factors[0]
    if offset != 0.0:
        entry["offset"] = offset
    how = {connection.units for connection in group}
    if "converted" in how or "suppressed" in how:
        entry["units"] = "convert" if "converted" in how else "suppress"
    if first.noise is not None:
        entry["noise"] = {"rms": first.noise.rms, "seed": first.noise.seed}
    return entry


def arrow(connection: Connection) -> str | None:
    """The text ``a.y -> b.u``; None if ``read_connections`` could not read the two ends back from it."""
    source, target = (".".join(end) for end in (connection.source, connection.target))
    plain = all("->" not in end and end == end.strip() for end in (source, target))
    return f"{source} -> {target}" if plain else None


def record_names(system: System) -> dict[Path, str]:
    """A file name for each record of the system. Different records of the same name get a number."""
    return unique_names(signal.path for signal in system.signals)


def record_files(names: Mapping[Path, str]) -> dict[str, Path]:
    """The files to write for the records ``names``: new file name -> file. Includes the description of a CSV record."""
    files = {name: path for path, name in names.items()}
    for path, name in names.items():
        if description_path(path).is_file():
            files[description_path(Path(name)).name] = description_path(path)
    return files


def unique_names(paths: Any) -> dict[Path, str]:
    """A file name for each path. Different files of the same name get a number.

    Characters that an archive or another machine refuses in the name of a file become ``_``.
    """
    names: dict[Path, str] = {}
    for path in paths:
        plain = Path(_UNUSABLE.sub("_", path.name))
        name, number = plain.name, 1
        while path not in names and name.lower() in (taken.lower() for taken in names.values()):
            number += 1
            name = f"{plain.stem}_{number}{plain.suffix}"
        names.setdefault(path, name)
    return names


def signal_tables(system: System, files: Mapping[Path, str]) -> dict[str, Any]:
    """The table ``[signals]``; ``files`` gives the path of each record relative to the file that holds it."""
    return {signal.name: {**signal.table, "file": files[signal.path]} for signal in system.signals}
