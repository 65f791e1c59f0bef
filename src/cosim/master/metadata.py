"""The part of a result that is known before the run: its metadata and columns."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from functools import cache
from types import MappingProxyType
from typing import Any

from ..fmu.variables import Variable
from ..record.description import Column
from ..system.parts import Connection
from ..system.system import System
from ..version import VERSION
from .instance import fmpy

METADATA: Mapping[str, str] = {
    "system": "Name of the system file, or of the FMU that ran alone.",
    "description": "The system's description.",
    "system_digest": "SHA-256 of all that determines the result: system, FMUs and records.",
    "start_time": "Start of the run in s.",
    "stop_time": "End of the run in s, as the system asked for it.",
    "step_size": "Communication step in s.",
    "order": '"sequential", "parallel" or the list of instances that the system gives.',
    "evaluation_order": "The instances in the order in which they stepped.",
    "tolerance": "Relative tolerance that the FMUs got; null without.",
    "decimation": "Every n-th communication point is in the result.",
    "connections": "The connections as text.",
    "wires": "The connections as tables: from, to, units of both ends, factor, noise.",
    "transformations": "Connection -> [factor, offset], for those that change values.",
    "fmus": "Instance -> its FMU: name, SHA-256, version of FMI, version, description.",
    "signals": "Record that fed the run -> its file and SHA-256.",
    "start_values": "Start values that differ from those of the FMU, with these and the unit.",
    "notes": "What was legal but suspicious before the run.",
    "versions": "Versions of Python, of the platform, of FMPy and of this package.",
    "steps": "Number of communication steps that were done.",
    "warnings": "Number of warnings of the FMUs.",
    "total_seconds": "Computing time of the whole run in s.",
    "stepping_seconds": "Computing time of the steps in s.",
    "partial": "true if the run ended early: it holds what was computed until then.",
    "solver": "Instance -> what its integrator counted.",
    "messages": "What the FMUs logged: time in s, instance, status, category, text.",
    "dropped_messages": "Number of messages beyond those that are kept.",
    "columns": "Name, unit, description, display unit, factor and offset of every column.",
}
"""Entry of the metadata in the file of a run -> its meaning."""


def result_columns(system: System) -> tuple[Column, ...]:
    """The columns that a run of ``system`` records, in the order of its rows."""
    return tuple(_column(f"{name}.{v}", system.variable(name, v)) for name, v in system.record)


def system_metadata(system: System) -> dict[str, Any]:
    """The metadata of a run that are known before it begins; times are in s."""
    return {
        "system": system.name,
        "description": system.description,
        "system_digest": system.digest,
        "start_time": float(system.start_time),
        "stop_time": float(system.stop_time),
        "step_size": float(system.step_size),
        "order": system.order if isinstance(system.order, str) else list(system.order),
        "evaluation_order": list(system.evaluation_order),
        "tolerance": system.tolerance,
        "decimation": system.decimation,
        "connections": [str(connection) for connection in system.connections],
        "wires": [_wire(system, connection) for connection in system.connections],
        "transformations": {
            str(c): [c.factor, c.offset] for c in system.connections if (c.factor, c.offset) != (1.0, 0.0)
        },
        "fmus": {
            i.name: {
                "fmu": i.fmu.name,
                "digest": i.fmu.digest,
                "fmi": i.fmu.fmi,
                "version": i.fmu.version,
                "description": i.fmu.description,
            }
            for i in system.instances
        },
        "signals": {s.name: {"file": str(s.path), "digest": s.digest} for s in system.signals},
        "start_values": _start_values(system),
        "notes": list(system.notes),
        "versions": dict(_versions()),
    }


def _wire(system: System, connection: Connection) -> dict[str, Any]:
    """A connection as a table, with the units of source and target ("" without unit)."""
    source, target = connection.source, connection.target
    units = [system.variable(*end).unit or "" for end in (source, target)]
    wire: dict[str, Any] = {"from": list(source), "to": list(target), "units": units, "factor": connection.factor}
    return wire if connection.noise is None else {**wire, "noise": connection.noise.rms}


def _start_values(system: System) -> dict[str, dict[str, Any]]:
    """The start values that differ from the FMU's own start values, each with this own value and the unit."""
    found: dict[str, dict[str, Any]] = {}
    for instance in system.instances:
        for name, value in instance.start.items():
            variable = instance.fmu.variables[name]
            if value != variable.start:
                shown = {number: item for item, number in variable.items.items()}
                own = variable.start
                found[f"{instance.name}.{name}"] = {
                    "value": shown.get(value, value) if isinstance(value, int) else value,
                    "fmu": shown.get(own, own) if isinstance(own, int) else own,
                    "unit": variable.unit or "",
                }
    return found


def _column(name: str, variable: Variable) -> Column:
    unit = variable.unit or "1"
    shown = variable.display_unit
    if shown is None:
        return Column(name, unit, variable.description, unit)
    return Column(name, unit, variable.description, shown.name, shown.factor, shown.offset, shown.inverse)


@cache
def _versions() -> Mapping[str, str]:
    own = {"python": platform.python_version(), "platform": platform.platform(), "motion-cosim": VERSION}
    return MappingProxyType({**own, "fmpy": str(fmpy.__version__)})
