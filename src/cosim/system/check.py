"""Checks a document and reports all problems at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from decimal import Decimal
from pathlib import Path
from typing import Any, TypedDict

from ..errors import DescriptionError
from .connections import read_connections
from .experiment import read_experiment
from .findings import Findings
from .instances import Places, read_instances
from .order import evaluation_order
from .parts import Connection, Instance, Order, system_digest
from .record import read_record
from .samples import check_steps


class SystemFields(TypedDict):
    """The fields of a System, as a check finds them."""

    name: str
    description: str
    instances: tuple[Instance, ...]
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
    """The fields of the System that a document describes; ``problems`` and ``notes`` are those known already.

    Raises DescriptionError with every problem found.
    """
    findings = Findings(name, problems)
    findings.known_keys("", document, ("description", "connections", "experiment", "instances", "record"))
    instances = read_instances(document, Places(folder, fmus), findings)
    experiment = read_experiment(document, findings)
    connections = read_connections(document, instances, findings)
    check_steps(instances, experiment, findings)
    record, decimation = read_record(document, instances, findings)
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
        description=str(document.get("description", "")),
        instances=tuple(instances.values()),
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
        digest=system_digest(instances, connections, (start, stop, step), order, tolerance, record, decimation),
        document=document,
        folder=folder,
        fmus=fmus,
    )
