"""Checks the document of a system file and reports all problems at once."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from decimal import Decimal
from pathlib import Path
from typing import Any, TypedDict, cast

from ..errors import DescriptionError
from .connections import read_connections
from .experiment import ExperimentTimes, read_experiment
from .findings import Findings
from .instances import Places, read_instances
from .order import evaluation_order
from .parts import Connection, Instance, Order, Ports, SignalSource, system_digest
from .record import recorded_variables
from .samples import check_steps
from .values import fraction, show_value

KEYS = ("description", "connections", "experiment", "instances", "signals", "record")


class SystemFields(TypedDict):
    """The fields of a checked System."""

    name: str
    description: str
    instances: tuple[Instance, ...]
    signals: tuple[SignalSource, ...]
    connections: tuple[Connection, ...]
    start_time: Decimal
    stop_time: Decimal
    step_size: Decimal
    steps: int
    order: Order
    evaluation_order: tuple[str, ...]
    tolerance: float | None
    record: tuple[tuple[str, str], ...]
    decimation: int
    notes: tuple[str, ...]
    notes_of_file: tuple[str, ...]
    digest: str
    document: Mapping[str, Any]
    folder: Path
    fmus: Path | None


def checked_fields(
    document: Mapping[str, Any],
    name: str,
    folder: Path,
    fmus: Path | None,
    *,
    problems: Sequence[str] = (),
    notes: Sequence[str] = (),
) -> SystemFields:
    """The fields of the System that a document describes.

    ``name`` is the file that messages name, ``folder`` the folder where relative paths start, ``fmus`` the folder of
    FMUs given by name. ``problems`` and ``notes`` were found before.
    Raises DescriptionError with all problems, the earlier ones included.
    """
    findings = Findings(name, problems)
    findings.known_keys("", document, KEYS)
    description = document.get("description", "")
    if not isinstance(description, str):
        findings.problem("description", f"must be a text, not {show_value(description)}.")
    instances = read_instances(document, Places(folder, fmus), findings)
    signals, experiment = _signals_and_experiment(document, instances, folder, findings)
    ports: dict[str, Ports] = {**{name: instance.fmu for name, instance in instances.items()}, **signals}
    connections = read_connections(document, ports, findings)
    signals = _units_of_inputs(signals, connections, ports)
    ports = {**ports, **signals}
    check_steps(instances, experiment, findings)
    record, decimation = recorded_variables(document, ports, connections, findings)
    if decimation > experiment.steps > 0:
        findings.problem(
            "record.decimation", f"{decimation} is more than the {experiment.steps} steps of the run. Take less."
        )
    evaluated = tuple(instances)
    if not findings.problems:
        evaluated = evaluation_order(instances, connections, experiment.order, findings)
    if findings.problems:
        raise DescriptionError(list(dict.fromkeys(findings.problems)))
    start, stop, step = experiment.start_time, experiment.stop_time, experiment.step_size
    order, tolerance = experiment.order, experiment.tolerance
    return SystemFields(
        name=name,
        description=str(description),
        instances=tuple(instances.values()),
        signals=tuple(signals.values()),
        connections=connections,
        start_time=start,
        stop_time=stop,
        step_size=step,
        steps=experiment.steps,
        order=order,
        evaluation_order=evaluated,
        tolerance=tolerance,
        record=record,
        decimation=decimation,
        notes=(*notes, *findings.notes),
        notes_of_file=tuple(notes),
        digest=system_digest(
            instances, connections, (start, stop, step), order, tolerance, record, decimation, tuple(signals.values())
        ),
        document=document,
        folder=folder,
        fmus=fmus,
    )


def _signals_and_experiment(
    document: Mapping[str, Any], instances: Mapping[str, Instance], folder: Path, findings: Findings
) -> tuple[dict[str, SignalSource], ExperimentTimes]:
    """The signals of a document and its experiment. The end of a record may set the stop time."""
    if "signals" not in document:
        return {}, read_experiment(document, findings)
    from .signals import check_times, read_signals, record_ends  # imports NumPy: only for systems with records

    given = findings.table(document, "experiment")
    times = float(fraction(given.get("start_time", 0)) or 0.0), float(fraction(given.get("step_size")) or math.inf)
    signals = read_signals(document, folder, times, findings)
    multiple = math.lcm(*(instance.step_multiple for instance in instances.values()))
    tables = (
        cast("Mapping[str, Any]", t) for t in findings.table(document, "signals").values() if isinstance(t, Mapping)
    )
    ended = any(table.get("extend") == "stop" for table in tables)
    experiment = read_experiment(document, findings, list(record_ends(signals)) if ended else None, multiple)
    if experiment.steps:
        times = float(experiment.start_time), float(experiment.stop_time), float(experiment.step_size)
        check_times(signals, times, findings)
    return signals, experiment


def _units_of_inputs(
    signals: Mapping[str, SignalSource], connections: Sequence[Connection], ports: Mapping[str, Ports]
) -> dict[str, SignalSource]:
    """The signals, with units for columns that state none.

    Such a column gets the unit of the inputs that take its values unchanged, if they all have the same unit.
    """
    result = dict(signals)
    for name, signal in signals.items():
        variables = dict(signal.variables)
        for column, variable in signal.variables.items():
            taken = [c for c in connections if c.source == (name, column) and c.units == "same" and c.factor == 1.0]
            units = {ports[c.target[0]].variables[c.target[1]].unit for c in taken}
            if variable.unit is None and len(units) == 1:
                variables[column] = replace(variable, unit=units.pop())
        result[name] = replace(signal, variables=variables)
    return result
