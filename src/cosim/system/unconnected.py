"""Inputs that are not connected: the value at which each stays, and the outputs that would fit it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ..fmu.variables import Variable
from .connections import ACCEPTED_TYPES, is_same_unit
from .order import find_loop
from .parts import Instance, sources
from .system import System
from .values import show_start

Input = tuple[str, str]
"""Instance and variable."""


def unconnected_inputs(system: System) -> dict[Input, str]:
    """Every input that is not connected, and the value at which it stays, as text."""
    connected = {connection.target for connection in system.connections}
    found: dict[Input, str] = {}
    for instance in system.instances:
        for name in instance.fmu.inputs:
            if (instance.name, name) not in connected:
                variable = instance.fmu.variables[name]
                value = instance.start.get(name, variable.start)
                found[instance.name, name] = "no value" if value is None else show_start(variable, value)
    return found


def fitting_outputs(system: System) -> dict[Input, tuple[str, ...]]:
    """The inputs that were probably forgotten. For each, the outputs that would fit it, the best one first.

    Such an input is not connected and has no start value in the system. An output fits if it has the same name, type
    and unit, and makes no algebraic loop. A source is an FMU without inputs. It fits references: its output ``x`` fits
    the input ``x_ref``; and it fits the input ``x`` if no other instance has an output ``x`` and if it feeds the same
    instance already, as ``position_next`` of a trajectory does.
    """
    instances = {instance.name: instance for instance in system.instances}
    connected = sources(system.connections)
    found: dict[Input, tuple[str, ...]] = {}
    for target in unconnected_inputs(system):
        name, input_name = target
        if input_name in instances[name].start:
            continue
        fitting = [
            source
            for source in _fitting(name, instances[name].fmu.variables[input_name], instances, connected)
            if not find_loop(instances, {**connected, target: (source,)})
        ]
        if fitting:
            # With several axes, prefer the instance whose name ends the same: plant_x for controller_x.
            fitting.sort(key=lambda source: source[0].rpartition("_")[2] != name.rpartition("_")[2])
            found[target] = tuple(".".join(source) for source in fitting)
    return found


def _fitting(
    name: str, variable: Variable, instances: Mapping[str, Instance], connected: Mapping[Input, Sequence[Input]]
) -> list[tuple[str, str]]:
    fmu = instances[name].fmu
    measured = any(i.fmu.inputs and variable.name in i.fmu.outputs for i in instances.values() if i.name != name)
    measured = measured or f"{variable.name}_ref" in fmu.inputs
    feeders = {source[0] for target, given in connected.items() if target[0] == name for source in given}
    found: list[tuple[str, str]] = []
    for other in instances.values():
        source = not other.fmu.inputs
        reference = variable.name.endswith("_ref")
        if other.name == name or (source and not reference and (measured or other.name not in feeders)):
            continue
        wanted = variable.name.removesuffix("_ref") if source else variable.name
        offered = other.fmu.variables.get(wanted)
        if (
            offered is None
            or offered.causality != "output"
            or offered.type not in ACCEPTED_TYPES.get(variable.type, ())
        ):
            continue
        if offered.unit is None or variable.unit is None or is_same_unit(other.fmu, offered, fmu, variable):
            found.append((other.name, wanted))
    return found
