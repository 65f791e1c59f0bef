"""An FMU as a system of its own: one instance, nothing connected, the experiment that its file suggests."""

from __future__ import annotations

import re
from collections.abc import Mapping
from decimal import Decimal
from pathlib import Path
from typing import Any

from ..fmu.description import Fmu, read_fmu
from .values import decimal

STEPS = 1000
"""Steps of a run whose FMU states no step size."""


def fmu_document(path: Path) -> dict[str, Any]:
    """The document of a system file that runs the FMU at ``path`` alone. Raises DescriptionError.

    A step that the file does not state is a thousandth of the time between its start and stop, if it states these.
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
    """The name of an FMU's only instance: that of its file, as far as instances may be called so."""
    name = re.sub(r"\W", "_", fmu.path.stem, flags=re.ASCII)
    return f"_{name}" if name[:1].isdigit() else name


def full_names(document: Mapping[str, Any], overrides: Mapping[str, object]) -> dict[str, object]:
    """Overrides of a system of one FMU with the instance before each variable, which may be left out."""
    (instance,) = document["instances"]
    return {
        name if name.startswith(f"{instance}.") else f"{instance}.{name}": value for name, value in overrides.items()
    }
