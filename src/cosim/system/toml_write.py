"""Writes a system as a TOML file."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from decimal import Decimal
from pathlib import Path
from typing import TYPE_CHECKING, cast

from ..files import write_file
from ..fmu.description import Fmu
from ..fmu.variables import Value
from .connections import arrow
from .parts import Connection
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
    lines += [f"    {_connection(connection)}," for connection in system.connections]
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


def _connection(connection: Connection) -> str:
    """A connection so that reading it gives the same one."""
    short = arrow(connection)
    if short is not None and connection.units == "same" and connection.stated == (1.0, 0.0):
        return _text(short)
    factor, offset = connection.stated
    entries = {"from": ".".join(connection.source), "to": ".".join(connection.target)}
    parts = [f"{key} = {_text(end)}" for key, end in entries.items()]
    if connection.units == "given" or factor != 1.0:
        parts.append(f"factor = {factor!r}")
    if offset != 0.0:
        parts.append(f"offset = {offset!r}")
    if connection.units in ("converted", "suppressed"):
        parts.append(f'units = "{"convert" if connection.units == "converted" else "suppress"}"')
    return f"{{ {', '.join(parts)} }}"


def _gathered(fmu: Fmu, start: Mapping[str, Value]) -> Iterator[tuple[str, object]]:
    """Start values with complete arrays gathered and enumerations by name."""
    whole = {
        element: name
        for name, array in fmu.arrays.items()
        if array.shape and name not in fmu.variables and all(element in start for element in array.elements)
        for element in array.elements
    }
    done: set[str] = set()
    for name, value in start.items():
        array = whole.get(name)
        if array is None:
            yield name, _item(fmu, name, value)
        elif array not in done:
            done.add(array)
            values = [_item(fmu, element, start[element]) for element in fmu.arrays[array].elements]
            yield array, _nested(values, fmu.arrays[array].shape)


def _item(fmu: Fmu, name: str, value: Value) -> Value:
    items = {number: item for item, number in fmu.variables[name].items.items()}
    return items.get(cast(int, value), value) if items else value


def _nested(values: Sequence[object], shape: Sequence[int]) -> list[object]:
    """A flat list as nested lists, the last index fastest."""
    if len(shape) == 1:
        return list(values)
    size = len(values) // shape[0]
    return [_nested(values[i * size : (i + 1) * size], shape[1:]) for i in range(shape[0])]


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
