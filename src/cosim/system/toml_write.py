"""Writes a system as a TOML file."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from decimal import Decimal
from pathlib import Path
from typing import TYPE_CHECKING, cast

from ..files import write_file
from ..fmu.description import Fmu, Value
from .ssp_write import resource_names

if TYPE_CHECKING:
    from .system import System


# ---- TOML ----


def write_toml(system: System, target: str | Path) -> Path:
    """Write a system as a TOML file, its FMUs into the folder STEM_fmus beside it. Raises FileError."""
    target = Path(target)
    names = resource_names(system)
    folder = target.with_name(f"{target.stem}_fmus")
    for path, name in names.items():
        write_file(folder / name, path.read_bytes())
    return write_file(target, toml(system, {path: f"{folder.name}/{name}" for path, name in names.items()}))


def toml(system: System, sources: Mapping[Path, str]) -> str:
    """A system as the text of a system file; ``sources`` gives the path of each FMU relative to it."""
    lines: list[str] = []
    if system.description:
        lines.append(f"description = {_text(system.description)}")
    lines.append("connections = [")
    for connection in system.connections:
        if connection.factor == 1.0 and connection.offset == 0.0:
            lines.append(f"    {_text(str(connection))},")
        else:
            source, target = ".".join(connection.source), ".".join(connection.target)
            lines.append(
                f"    {{ from = {_text(source)}, to = {_text(target)}, factor = {connection.factor!r}, "
                f"offset = {connection.offset!r} }},"
            )
    lines += ["]", "", "[experiment]"]
    lines += [f"{key} = {_decimal(getattr(system, key))}" for key in ("start_time", "stop_time", "step_size")]
    lines.append(f"order = {_value(system.order if isinstance(system.order, str) else list(system.order))}")
    if system.tolerance is not None:
        lines.append(f"tolerance = {system.tolerance!r}")
    for instance in system.instances:
        lines += ["", f"[instances.{instance.name}]", f"fmu = {_text(sources[instance.fmu.path])}"]
        if instance.step_multiple != 1:
            lines.append(f"step_multiple = {instance.step_multiple}")
        if instance.start:
            lines += ["", f"[instances.{instance.name}.start]"]
            lines += [f"{_key(name)} = {_value(value)}" for name, value in _gathered(instance.fmu, instance.start)]
    lines += ["", "[record]", f"decimation = {system.decimation}", "variables = ["]
    lines += [f"    {_text('.'.join(entry))}," for entry in system.record]
    return "\n".join([*lines, "]", ""])


def _gathered(fmu: Fmu, start: Mapping[str, Value]) -> Iterator[tuple[str, object]]:
    """Start values with complete arrays gathered and enumerations by name."""
    whole = {e: array for array, elements in fmu.arrays.items() if all(e in start for e in elements) for e in elements}
    done: set[str] = set()
    for name, value in start.items():
        array = whole.get(name)
        if array is None:
            items = {number: item for item, number in fmu.variables[name].items.items()}
            yield name, items.get(cast(int, value), value) if items else value
        elif array not in done:
            done.add(array)
            yield array, [start[element] for element in fmu.arrays[array]]


def _text(text: str) -> str:
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else _text(name)


def _decimal(number: Decimal) -> str:
    text = str(number)
    return text if re.search(r"[.eE]", text) else f"{text}.0"


def _value(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return _text(value)
    if isinstance(value, list):
        return f"[{', '.join(_value(item) for item in cast('list[object]', value))}]"
    return repr(value)
