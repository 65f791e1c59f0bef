"""A single FMU as a system: one instance, no connections, and the DefaultExperiment of its file."""

from __future__ import annotations

import re
from collections.abc import Mapping
from decimal import Decimal
from pathlib import Path
from typing import Any

from ..fmu.description import Fmu, read_fmu
from .values import decimal

STEPS = 1000
"""Number of steps of a run whose FMU states no step size."""


def fmu_document(path: Path) -> dict[str, Any]:
    """The document of a system file that runs the FMU at ``path`` alone. Raises DescriptionError.

    If the file states no step size, it is the time from start to stop divided by ``STEPS``.
    """
    fmu = read_fmu(path)
    experiment = {
        key: value
        for key in ("start_time", "stop_time", "step_size")
        if (value := decimal(getattr(fmu, key))) is not None
    }
    start = experiment.get("start_time", Decimal(0))
    if "step_size" not in experiment and experiment.get("stop_time", start) > start:
        experiment["step_size"] = (experiment["stop_time"] - start) / STEPS
    return {
        "description": fmu.description or fmu.name,
        "experiment": experiment,
        "instances": {instance_name(fmu): {"fmu": str(path.resolve())}},
    }


def instance_name(fmu: Fmu) -> str:
    """The name of an FMU's only instance: its file name, with ``_`` for characters that are not allowed."""
    name = re.sub(r"\W", "_", fmu.path.stem, flags=re.ASCII)
    return f"_{name}" if name[:1].isdigit() else name


def full_names(document: Mapping[str, Any], overrides: Mapping[str, object]) -> dict[str, object]:
    """Overrides of a system of one FMU, with the instance name put before each variable that lacks it."""
    (instance,) = document["instances"]
    return {
        name if name.startswith(f"{instance}.") else f"{instance}.{name}": value for name, value in overrides.items()
    }
