"""The document of a system file: loads it together with its base files, and changes it by overrides."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, cast

from ..errors import DescriptionError, suggest
from ..fmu.places import is_fmu_path, shipped_systems
from ..fmu.text import named_path, read_toml
from .values import decimal, flat_table, show_value


def load_document(path: Path, parents: tuple[Path, ...] = ()) -> dict[str, Any]:
    """The document of the file at ``path``, merged over its base file. ``parents`` are the files that have it as base.

    Start values have full variable names as keys. Raises DescriptionError if a file cannot be read, or if the base
    files form a circle.
    """
    document = read_toml(path)
    instances = document.get("instances")
    if isinstance(instances, dict):
        tables = cast("dict[str, Any]", instances)
        document["instances"] = {name: _flat_start(table) for name, table in tables.items()}
    base = document.pop("base", None)
    if base is None:
        return document
    parent = _base(path, base)
    if parent.resolve() in (path.resolve(), *(p.resolve() for p in parents)):
        raise DescriptionError(f"{path.name}: base: '{base}' leads back to this file.")
    return merged(_moved(load_document(parent, (*parents, path)), parent.parent, path.parent), document)


def _moved(document: dict[str, Any], source: Path, target: Path) -> dict[str, Any]:
    """A document from the folder ``source``, changed so that it names the same records and FMUs from ``target``."""
    if source.resolve() == target.resolve():
        return document
    moved = dict(document)
    for section, key in (("signals", "file"), ("instances", "fmu")):
        entries = document.get(section)
        if not isinstance(entries, Mapping):
            continue
        tables: dict[str, Any] = dict(cast("Mapping[str, Any]", entries))
        for name, table in tables.items():
            items: Mapping[str, Any] = cast("Mapping[str, Any]", table) if isinstance(table, Mapping) else {}
            file = items.get(key)
            if isinstance(file, str) and (section == "signals" or is_fmu_path(file)):
                tables[name] = {**items, key: str(named_path(file, source.resolve()))}
        moved[section] = tables
    return moved


def _base(path: Path, base: object) -> Path:
    """The file that ``base`` names in the file ``path``."""
    if isinstance(base, str):
        if Path(base).name == base or (path.parent / base).is_file():
            return path.parent / base
        shipped = shipped_systems()
        name = base.removeprefix("studies/").removesuffix(".toml")
        if name in shipped:
            return shipped[name]
        hint = "" if base.startswith((".", "/")) else suggest(name, shipped)
    else:
        hint = ""
    raise DescriptionError(
        f"{path.name}: base: {show_value(base)} is no file, and no system that comes with cosim, such as "
        f"shams2010/fsmc_5sin. Give a path relative to {path.name}.{hint}"
    )


def _flat_start(table: Any) -> Any:
    """The table of an instance with its start values under full names.

    ``p`` and ``p[2]`` then stand in one table, in the order in which they were given.
    """
    if not isinstance(table, Mapping):
        return table
    items = cast("Mapping[str, Any]", table)
    start = items.get("start")
    return (
        {**items, "start": dict(flat_table(cast("Mapping[str, Any]", start)))} if isinstance(start, Mapping) else items
    )


def merged(under: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """``under`` with entries replaced by the entries of ``over``, table by table.

    A replaced value moves to the end: a start value for a whole array must come after the values of its elements.
    """
    result = dict(under)
    for key, value in over.items():
        old = result.get(key)
        if isinstance(old, Mapping) and isinstance(value, Mapping):
            result[key] = merged(cast("Mapping[str, Any]", old), cast("Mapping[str, Any]", value))
        else:
            result.pop(key, None)
            result[key] = value
    return result


class Changes(NamedTuple):
    """New entries of the experiment and the record; None keeps the old one. Times in s."""

    stop_time: object = None
    step_size: object = None
    order: str | Sequence[str] | None = None
    record: Sequence[str] | None = None
    decimation: int | None = None


def changed_document(
    document: Mapping[str, Any], name: str, overrides: Mapping[str, object], changes: Changes
) -> tuple[dict[str, Any], list[str]]:
    """``document`` with other start values and another experiment; and a problem for each override without a target."""
    instances = document.get("instances")
    known = list(cast("Mapping[str, Any]", instances)) if isinstance(instances, Mapping) else []
    given_signals = document.get("signals")
    signals = dict(cast("Mapping[str, Any]", given_signals)) if isinstance(given_signals, Mapping) else {}
    problems: list[str] = []
    starts: dict[str, dict[str, object]] = {}
    for path, value in overrides.items():
        instance, dot, variable = path.partition(".")
        if not dot or not variable:
            problems.append(f"{name}: value for '{path}': write INSTANCE.VARIABLE, such as plant.m.")
        elif instance in signals and isinstance(signals[instance], Mapping):
            signals[instance] = _changed_signal(cast("Mapping[str, Any]", signals[instance]), variable, value)
            document = {**document, "signals": signals}
        elif instance not in known:
            problems.append(
                f"{name}: value for {path}: no instance '{instance}'.{suggest(instance, [*known, *signals])}"
            )
        else:
            starts.setdefault(instance, {})[variable] = value
    over: dict[str, Any] = {}
    if starts:
        tables = dict(cast("Mapping[str, Any]", instances))
        for instance, values in starts.items():
            table = tables[instance]
            if isinstance(table, Mapping):
                old = cast("Mapping[str, Any]", table)
                start = old.get("start", {})
                flat = dict(flat_table(cast("Mapping[str, Any]", start))) if isinstance(start, Mapping) else {}
                tables[instance] = {**old, "start": merged(flat, values)}
        document = {**document, "instances": tables}
    times = {"stop_time": _number(changes.stop_time), "step_size": _number(changes.step_size)}
    record = {"variables": changes.record, "decimation": changes.decimation}
    for table, values in (("experiment", {**times, "order": changes.order}), ("record", record)):
        given = {key: value for key, value in values.items() if value is not None}
        if given:
            over[table] = given
    return merged(document, over), problems


def _changed_signal(table: Mapping[str, Any], path: str, value: object) -> dict[str, Any]:
    """The table of a signal with another value at ``path``: ``file``, ``extend`` ... or ``columns.NAME.factor``."""
    first, _, rest = path.partition(".")
    column, _, key = rest.rpartition(".")
    columns = table.get("columns")
    if first != "columns" or not column or not isinstance(columns, Mapping):
        return {**table, path: value}
    given = cast("Mapping[str, Any]", columns).get(column, {})
    inner = {"column": given} if isinstance(given, str) else dict(cast("Mapping[str, Any]", given))
    return {**table, "columns": {**cast("Mapping[str, Any]", columns), column: {**inner, key: value}}}


def _number(value: object) -> object:
    """``value`` as a Decimal if it is a number; otherwise unchanged."""
    number = decimal(value)
    return value if number is None else number
