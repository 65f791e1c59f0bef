"""What a step does, as rows of numbers for the inner loop."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..fmu.description import Variable
from ..system.parts import Connection
from ..system.system import System
from . import loop
from .instance import FmuInstance

KINDS = {"Real": 0, "Integer": 1, "Enumeration": 1, "Boolean": 2}
"""Which of the loop's set and get calls serves a type."""


def same_program(one: System, other: System) -> bool:
    """Whether two variants of a system differ in nothing that a program holds."""
    same = one.connections == other.connections and one.record == other.record and one.visits == other.visits
    multiples = [(i.name, i.step_multiple) for i in one.instances] == [
        (i.name, i.step_multiple) for i in other.instances
    ]
    return same and multiples and one.parallel == other.parallel


@dataclass
class Program:
    """What the loop executes for one system, in arrays."""

    point: list[loop.Row]
    step: list[loop.Row]
    initial: list[loop.Row]
    """Rows for a communication point, from one to the next, and for a pass of initialization."""
    outputs: list[loop.Row]
    """Rows that read all outputs needed."""
    slots: Mapping[tuple[str, str], int]
    connections: list[Connection]
    """In the order of ``links``."""
    links: NDArray[np.void]
    values: NDArray[np.float64]
    others: NDArray[np.uint64]
    recorded: NDArray[np.uint64]
    references: list[NDArray[np.uint32]]
    """Held because the rows know them by address only."""


class Signals:
    """The slot of every signal that travels or is recorded, by instance, direction and type."""

    def __init__(self, system: System) -> None:
        self.slots: dict[tuple[str, str], int] = {}
        self.inputs: dict[tuple[str, int], list[Connection]] = {}
        self.outputs: dict[tuple[str, int], list[Variable]] = {}
        fed = {connection.target for connection in system.connections}
        for instance in system.instances:
            variables = instance.fmu.variables
            incoming = [c for c in system.connections if c.target[0] == instance.name]
            wanted = [c.source[1] for c in system.connections if c.source[0] == instance.name]
            wanted += [v for name, v in system.record if name == instance.name and (name, v) not in fed]
            for kind in range(3):
                inputs = [c for c in incoming if KINDS[variables[c.target[1]].type] == kind]
                outputs = [variables[name] for name in dict.fromkeys(wanted) if KINDS[variables[name].type] == kind]
                self.inputs[instance.name, kind], self.outputs[instance.name, kind] = inputs, outputs
                for name in [*(c.target[1] for c in inputs), *(v.name for v in outputs)]:
                    self.slots[instance.name, name] = len(self.slots)
        self.values = np.zeros(max(len(self.slots), 1))
        self.others = np.zeros(self.values.size, dtype=np.uint64)
        """Buffers for values of other types than double, those of a call side by side from its first slot on."""
        self.references: list[NDArray[np.uint32]] = []

    def call(self, slave: FmuInstance, kind: int, variables: Sequence[Variable], *, into: bool) -> loop.Row:
        """A call that sets (``into``) or reads variables whose slots lie side by side."""
        name, number = list(loop.FMI2_TYPES.items())[kind]
        function = f"fmi2{'Set' if into else 'Get'}{name}"
        self.references.append(np.array([variable.reference for variable in variables], dtype=np.uint32))
        slot = self.slots[slave.name, variables[0].name]
        buffer = self.values if number == loop.FLOAT64 else self.others
        return {
            loop.ACT: loop.EXCHANGE,
            loop.FMI: 2,
            loop.COMPONENT: slave.component,
            loop.FUNCTION: slave.address(function),
            loop.CALL: loop.call_number(slave.number, function),
            loop.REFERENCES: self.references[-1].ctypes.data,
            loop.REFERENCE_COUNT: len(variables),
            loop.COUNT: len(variables),
            loop.BUFFER: buffer.ctypes.data + slot * buffer.itemsize,
            loop.SLOT: slot,
            loop.TYPE: number,
            loop.SET: int(into),
        }


def make_program(system: System, slaves: list[FmuInstance]) -> Program:
    """Resolve names to slots, value references and addresses, once."""
    signals = Signals(system)
    links: list[Connection] = []
    sets: dict[str, list[loop.Row]] = {}
    gets: dict[str, list[loop.Row]] = {}
    step: list[loop.Row] = []
    for instance, slave in zip(system.instances, slaves, strict=True):
        variables, name, multiple = instance.fmu.variables, instance.name, instance.step_multiple
        into, out = sets.setdefault(name, []), gets.setdefault(name, [])
        for kind in range(3):
            connections, outputs = signals.inputs[name, kind], signals.outputs[name, kind]
            if connections:
                row = signals.call(slave, kind, [variables[c.target[1]] for c in connections], into=True)
                into.append({**row, loop.LINKS: len(connections), loop.LINK: len(links)})
                links += connections
            if outputs:
                out.append(signals.call(slave, kind, outputs, into=False))
        first, *others = out or [{loop.FMI: 2, loop.COMPONENT: slave.component}]
        called = loop.call_number(slave.number, "fmi2DoStep")
        stepping = {loop.STEP: slave.address("fmi2DoStep"), loop.STEP_CALL: called, loop.MULTIPLE: multiple}
        step += _guarded([{**first, **stepping}, *others], multiple)

    fed = {connection.target for connection in system.connections}
    point: list[loop.Row] = []
    initial: list[loop.Row] = []
    for name in system.visits:
        instance = system.instance(name)
        read = [variable.name for kind in range(3) for variable in signals.outputs[name, kind]]
        direct = any((name, i) in fed for output in read for i in instance.fmu.dependencies.get(output, ()))
        rows = [*sets[name], *gets[name]] if direct and not system.parallel else sets[name]
        point += _guarded(rows, instance.step_multiple)
        initial += [*sets[name], *gets[name]]
    return Program(
        point=point,
        step=step,
        initial=initial,
        outputs=[row for rows in gets.values() for row in rows],
        slots=signals.slots,
        connections=links,
        links=np.array(
            [(signals.slots[c.source], signals.slots[c.target], c.factor, c.offset) for c in links], loop.LINK_TYPE
        ),
        values=signals.values,
        others=signals.others,
        recorded=np.array([signals.slots[end] for end in system.record], dtype=np.uint64),
        references=signals.references,
    )


def _guarded(rows: list[loop.Row], multiple: int) -> list[loop.Row]:
    """Rows that hold only at every ``multiple``-th communication point."""
    if multiple == 1 or not rows:
        return rows
    return [{loop.ACT: loop.GUARD, loop.MULTIPLE: multiple, loop.COUNT: len(rows)}, *rows]
