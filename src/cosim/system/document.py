"""The document of a system file: loaded with the files it builds on, and changed by overrides."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from decimal import Decimal
from pathlib import Path
from typing import Any, cast

from ..errors import DescriptionError, suggest
from .values import decimal, flat_table


def load_document(path: Path, parents: tuple[Path, ...]) -> dict[str, Any]:
    """The document at ``path``, merged over the files it builds on. ``parents`` are the files that led here."""
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        near = suggest(path.name, (p.name for p in path.parent.glob("*.toml"))) if path.parent.is_dir() else ""
        raise DescriptionError(f"{path}: no such file.{near}") from None
    except (OSError, UnicodeDecodeError) as error:
        raise DescriptionError(f"{path}: cannot be read ({error}).") from None
    try:
        document = tomllib.loads(text, parse_float=Decimal)
    except tomllib.TOMLDecodeError as error:
        raise DescriptionError(f"{path.name}: not valid TOML: {error}.") from None
    base = document.pop("base", None)
    if base is None:
        return document
    if not isinstance(base, str) or Path(base).name != base:
        raise DescriptionError(f"{path.name}: base: give the name of a file in the same folder.")
    parent = path.parent / base
    if parent.resolve() in (path.resolve(), *(p.resolve() for p in parents)):
        raise DescriptionError(f"{path.name}: base: '{base}' leads back to this file.")
    return merged(load_document(parent, (*parents, path)), document)


def merged(under: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """``under`` with the entries of ``over`` in place of its own, table by table."""
    result = dict(under)
    for key, value in over.items():
        old = result.get(key)
        if isinstance(old, Mapping) and isinstance(value, Mapping):
            result[key] = merged(cast("Mapping[str, Any]", old), cast("Mapping[str, Any]", value))
        else:
            result[key] = value
    return result


def changed_document(
    document: Mapping[str, Any], name: str, overrides: Mapping[str, object], **experiment: object
) -> tuple[dict[str, Any], list[str]]:
    """``document`` with start values and experiment replaced, and problems: what cannot be placed."""
    instances = document.get("instances")
    known = list(cast("Mapping[str, Any]", instances)) if isinstance(instances, Mapping) else []
    problems: list[str] = []
    starts: dict[str, dict[str, object]] = {}
    for path, value in overrides.items():
        instance, dot, variable = path.partition(".")
        if not dot or not variable:
            problems.append(f"{name}: value for '{path}': write INSTANCE.VARIABLE, such as plant.m.")
        elif instance not in known:
            problems.append(f"{name}: value for {path}: no instance '{instance}'.{suggest(instance, known)}")
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
                tables[instance] = {**old, "start": {**flat, **values}}
        document = {**document, "instances": tables}
    record = {
        key: value
        for key, value in (("variables", experiment.pop("record")), ("decimation", experiment.pop("decimation")))
        if value is not None
    }
    if record:
        over["record"] = record
    given = {key: decimal(value) or value for key, value in experiment.items() if value is not None}
    if given:
        over["experiment"] = given
    return merged(document, over), problems
