"""Communication steps against sampling times, and inputs that nothing feeds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from decimal import Decimal
from fractions import Fraction

from ..fmu.description import Variable
from .connections import ACCEPTED_TYPES, is_same_unit
from .experiment import Experiment
from .findings import Findings
from .order import find_loop
from .parts import Connection, Instance
from .values import decimal, show_start, whole


def check_steps(instances: Mapping[str, Instance], experiment: Experiment, findings: Findings) -> None:
    """Step multiples divide the run; sampling times and communication steps are multiples of each other."""
    for name, instance in instances.items():
        where = f"instances.{name}"
        multiple = instance.step_multiple
        if experiment.steps and experiment.steps % multiple:
            findings.problem(
                f"{where}.step_multiple", f"{multiple} does not divide the {experiment.steps} steps of the run."
            )
        sampling = sampling_time(instance)
        if sampling is None or not experiment.step_size:
            continue
        own = experiment.step_size * multiple
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


def sampling_time(instance: Instance) -> Decimal | None:
    """``T_s`` of a sampled controller: a parameter of that name in seconds, of an FMU with inputs."""
    variable = instance.fmu.variables.get("T_s")
    if variable is None or variable.causality != "parameter" or variable.unit != "s" or not instance.fmu.inputs:
        return None
    given = instance.start.get("T_s")
    value = decimal(variable.start_text if given is None else given)
    return value if value is not None and value.is_finite() and value > 0 else None


def note_unconnected(instances: Mapping[str, Instance], connections: Sequence[Connection], findings: Findings) -> None:
    """Note the inputs that look forgotten: nothing feeds them, no start value is given, and an output would fit.

    Other inputs, such as a load, rest at their start values without a word.
    """
    connected = {connection.target: connection.source for connection in connections}
    for name, instance in instances.items():
        for variable_name in instance.fmu.inputs:
            variable = instance.fmu.variables[variable_name]
            target = name, variable_name
            if target in connected or variable_name in instance.start:
                continue
            fitting = _fitting(name, variable, instances)
            source = next((end for end in fitting if not find_loop(instances, {**connected, target: end})), None)
            if source is not None:
                start = "its start value" if variable.start is None else show_start(variable, variable.start)
                findings.note(
                    f"instances.{name}",
                    f"input '{variable_name}' is not connected and stays at {start}. {'.'.join(source)} would fit: "
                    "connect it, or give a start value.",
                )


def unconnected(instances: Sequence[Instance], connections: Sequence[Connection]) -> dict[str, str]:
    """The inputs that nothing feeds, ``instance.variable``, and the value at which each stays."""
    connected = {connection.target for connection in connections}
    found: dict[str, str] = {}
    for instance in instances:
        for name in instance.fmu.inputs:
            variable = instance.fmu.variables[name]
            value = instance.start.get(name, variable.start)
            if (instance.name, name) not in connected and value is not None:
                found[f"{instance.name}.{name}"] = show_start(variable, value)
    return found


def _fitting(name: str, variable: Variable, instances: Mapping[str, Instance]) -> list[tuple[str, str]]:
    """Outputs of other instances that an input could take: those of its name; for ``x_ref`` also ``x`` of a source."""
    fmu = instances[name].fmu
    found: list[tuple[str, str]] = []
    for other in instances.values():
        if other.name == name:
            continue
        wanted = {variable.name} if other.fmu.inputs else {variable.name, variable.name.removesuffix("_ref")}
        for output in other.fmu.outputs:
            offered = other.fmu.variables[output]
            if output not in wanted or offered.type not in ACCEPTED_TYPES.get(variable.type, ()):
                continue
            units = offered.unit, variable.unit
            if units[0] is None or units[1] is None or is_same_unit(other.fmu, units[0], fmu, units[1]):
                found.append((other.name, output))
    return found
