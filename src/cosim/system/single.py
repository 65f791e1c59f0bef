"""A single FMU as a system: one instance, no connections, and the DefaultExperiment of its file."""

from __future__ import annotations

import re
from collections.abc import Mapping
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import Any

from ..fmu.description import Fmu, read_fmu
from .values import decimal, fraction, whole

STEPS = 1000
"""Number of steps of a run whose FMU states no step size."""


def fmu_document(
    path: Path, stop_time: object = None, step_size: object = None
) -> tuple[dict[str, Any], tuple[str, ...]]:
    """The document of a system file that runs the FMU at ``path`` alone, and notes. Raises DescriptionError.

    ``stop_time`` and ``step_size`` are the values that the caller gives in place of those of the file, or None. If the
    file states no step size, it is the time from start to stop divided by ``STEPS``. If the file states a step that
    does not divide its own times, the run ends at the last whole step.
    """
    fmu = read_fmu(path)
    experiment: dict[str, Any] = {
        key: value
        for key in ("start_time", "stop_time", "step_size")
        if (value := decimal(getattr(fmu, key))) is not None
    }
    notes: tuple[str, ...] = ()
    start = fraction(experiment.get("start_time")) or Fraction(0)
    given = experiment.get("stop_time") if stop_time is None else stop_time
    stop = fraction(given) or fraction(decimal(given))
    length = start - start if stop is None else stop - start
    step = fraction(experiment.get("step_size"))
    if length > 0 and step is None:
        experiment["step_size"] = _written(length / STEPS)
    elif step and step > 0 and stop_time is step_size is None and length >= step and whole(length / step) is None:
        end = _written(start + length // step * step)
        notes = (f"the file's step of {experiment['step_size']} s does not divide its times: the run ends at {end} s.",)
        experiment["stop_time"] = end
    document: dict[str, Any] = {
        "description": fmu.description or fmu.name,
        "experiment": experiment,
        "instances": {instance_name(fmu): {"fmu": str(path.resolve())}},
    }
    return document, notes


def _written(number: Fraction) -> Decimal | str:
    """A fraction as a decimal number, if it is one of up to 28 digits; else as text, such as ``1/3``."""
    quotient = Decimal(number.numerator) / Decimal(number.denominator)
    return quotient if Fraction(quotient) == number else f"{number.numerator}/{number.denominator}"


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
