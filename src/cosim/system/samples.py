"""Checks that communication steps fit step multiples and sampling times."""

from __future__ import annotations

from collections.abc import Mapping
from decimal import Decimal
from fractions import Fraction

from ..units import parse_unit
from .experiment import ExperimentTimes
from .findings import Findings
from .parts import Instance
from .values import decimal, whole

COARSE = 100.0
"""A communication step is suspicious from so many times the step in the DefaultExperiment of an FMU."""


FEW_SAMPLES = 10
"""A controller that takes fewer samples in a run, and is slower than its step, probably has T_s in another unit."""


def check_steps(instances: Mapping[str, Instance], experiment: ExperimentTimes, findings: Findings) -> None:
    """Report step multiples that do not divide the run, and sampling times that do not fit the communication step.

    A sampling time must be a multiple of the instance's communication step, or divide it. If there are several samples
    in a step, a note says that only the last one is seen.
    """
    for name, instance in instances.items():
        where = f"instances.{name}"
        multiple = instance.step_multiple
        if experiment.steps and experiment.steps % multiple:
            findings.problem(
                f"{where}.step_multiple", f"{multiple} does not divide the {experiment.steps} steps of the run."
            )
        sampling = sampling_time(instance)
        own = experiment.step_size * multiple
        stated = instance.fmu.step_size
        if sampling is None and stated and instance.fmu.inputs and float(own) >= COARSE * stated > 0.0:
            findings.note(
                where,
                f"its step of {own} s is {float(own) / stated:.0f} times that of its file, {stated:g} s. "
                "Take a smaller step_size, unless its results stay the same.",
            )
        if sampling is None or not experiment.step_size:
            continue
        ratio = Fraction(own) / Fraction(sampling)
        samples = whole(ratio)
        if samples is None and whole(1 / ratio) is None:
            findings.problem(
                where,
                f"T_s = {sampling} s against a communication step of {own} s: neither is a multiple of the other, "
                "so samples would fall between communication points. Change start.T_s, step_size or step_multiple.",
            )
        elif samples is not None and samples > 1:
            findings.note(
                where,
                f"T_s = {sampling} s against a communication step of {own} s: it takes {samples} samples a step with "
                "inputs that do not change, and only the last of its outputs is seen. Take a smaller step_size.",
            )
        elif samples is None and (taken := int(experiment.steps * experiment.step_size / sampling) + 1) < FEW_SAMPLES:
            length = experiment.stop_time - experiment.start_time
            findings.note(where, f"T_s = {sampling} s: it takes only {taken} samples in the run of {length} s.")


def sampling_time(instance: Instance) -> Decimal | None:
    """The sampling time ``T_s`` of a sampled controller in s; None for other FMUs.

    A sampled controller is an FMU that has inputs and a positive parameter ``T_s``, a time.
    """
    variable = instance.fmu.variables.get("T_s")
    if variable is None or variable.causality != "parameter" or variable.unit is None or not instance.fmu.inputs:
        return None
    unit = instance.fmu.unit(variable.unit)
    seconds = None if unit is None else unit.conversion(parse_unit("s"))
    if seconds is None:
        return None
    given = instance.start.get("T_s")
    value = decimal(variable.start_text if given is None else given)
    if value is None or not value.is_finite() or value <= 0:
        return None
    return value if seconds[0] == 1.0 else value * Decimal(repr(seconds[0]))
