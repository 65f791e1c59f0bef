"""Writes a system as a TOML file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from ..files import write_file
from ..fmu.description import Fmu
from ..fmu.tables import write_toml
from ..fmu.variables import Value
from .ssp_write import resource_names
from .written import connection_entries, record_files, record_names, signal_tables

if TYPE_CHECKING:
    from .system import System


def write_system(system: System, target: str | Path) -> Path:
    """Write a system as a TOML file. Raises FileError.

    FMUs are copied into the folder STEM_fmus beside it, records into the folder STEM_records.
    """
    target = Path(target)
    names = resource_names(system)
    folder = target.with_name(f"{target.stem}_fmus")
    records = record_names(system)
    record_folder = target.with_name(f"{target.stem}_records")
    sources: dict[Path, str] = {}
    for place, files in ((folder, names), (record_folder, records)):
        for name, path in record_files(files).items():
            write_file(place / name, path.read_bytes())
        sources |= {path: f"{place.name}/{name}" for path, name in files.items()}
    return write_toml(target, document(system, sources))


def document(system: System, sources: Mapping[Path, str]) -> dict[str, Any]:
    """A system with the keys of a system file; ``sources`` gives the relative path of each FMU and record."""
    return {
        **({"description": system.description} if system.description else {}),
        "connections": connection_entries(system.connections),
        "experiment": {
            **{key: getattr(system, key) for key in ("start_time", "stop_time", "step_size")},
            "order": system.order if isinstance(system.order, str) else list(system.order),
            **({} if system.tolerance is None else {"tolerance": system.tolerance}),
        },
        "instances": {
            instance.name: {
                "fmu": sources[instance.fmu.path],
                **({} if instance.step_multiple == 1 else {"step_multiple": instance.step_multiple}),
                **({"start": dict(_gathered(instance.fmu, instance.start))} if instance.start else {}),
            }
            for instance in system.instances
        },
        **({"signals": signal_tables(system, sources)} if system.signals else {}),
        "record": {"decimation": system.decimation, "variables": [".".join(entry) for entry in system.record]},
    }


def _gathered(fmu: Fmu, start: Mapping[str, Value]) -> Iterator[tuple[str, object]]:
    """Start values, with a list for each complete array, and enumerations as item names."""
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
    """A flat list as nested lists of the given shape; the last index changes fastest."""
    if len(shape) == 1:
        return list(values)
    size = len(values) // shape[0]
    return [_nested(values[i * size : (i + 1) * size], shape[1:]) for i in range(shape[0])]
