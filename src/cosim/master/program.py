"""What a step does, as rows of numbers for the inner loop."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..fmu.description import Variable
from ..master import loop
from ..system.parts import Connection
from ..system.system import System
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


Row = dict[np.uint64, int]
"""A row of the loop's program: column -> number, 0 where nothing is said."""


@dataclass
class Program:
    """What the compiled loop executes for one system, in arrays."""

    point: list[Row]
    step: list[Row]
    initial: list[Row]
    """Rows for a communication point, from one to the next, and for a pass of initialization."""
    outputs: list[Row]
    """Rows that read all outputs needed."""
    sources: NDArray[np.uint64]
    factors: NDArray[np.float64]
    offsets: NDArray[np.float64]
    values: NDArray[np.float64]
    integers: NDArray[np.int32]
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
        self.integers = np.zeros(self.values.size, dtype=np.int32)
        self.references: list[NDArray[np.uint32]] = []

    def call(self, slave: FmuInstance, call: int, variables: Sequence[Variable]) -> Row:
        """A call of one FMI function on variables whose slots lie side by side."""
        self.references.append(np.array([variable.reference for variable in variables], dtype=np.uint32))
        slot = self.slots[slave.name, variables[0].name]
        buffer = self.values if call in (loop.SET_REAL, loop.GET_REAL) else self.integers
        return {
            loop.COMPONENT: slave.component,
            loop.CALL: call,
            loop.FUNCTION: slave.address(loop.FUNCTIONS[call]),
            loop.REFERENCES: self.references[-1].ctypes.data,
            loop.COUNT: len(variables),
            loop.BUFFER: buffer.ctypes.data + slot * buffer.itemsize,
            loop.SLOT: slot,
        }


def make_program(system: System, slaves: list[FmuInstance]) -> Program:
    """Resolve names to slots, value references and addresses, once."""
    signals = Signals(system)
    links: list[Connection] = []
    sets: dict[str, list[Row]] = {}
    gets: dict[str, list[Row]] = {}
    step: list[Row] = []
    for instance, slave in zip(system.instances, slaves, strict=True):
        variables, name, multiple = instance.fmu.variables, instance.name, instance.step_multiple
        into, out = sets.setdefault(name, []), gets.setdefault(name, [])
        for kind in range(3):
            connections, outputs = signals.inputs[name, kind], signals.outputs[name, kind]
            if connections:
                row = signals.call(slave, loop.SET_REAL + kind, [variables[c.target[1]] for c in connections])
                joined = {loop.LINKS: len(connections), loop.LINK: len(links)}
                if kind == 0:
                    into.append({**row, **joined})
                else:
                    convert = loop.TO_INTEGER if kind == 1 else loop.TO_BOOLEAN
                    into += [{**joined, **_conversion(row, convert)}, row]
                links += connections
            if outputs:
                row = signals.call(slave, loop.GET_REAL + kind, outputs)
                out += [row] if kind == 0 else [row, _conversion(row, loop.FROM_INTEGER)]
        first, *others = out or [{loop.COMPONENT: slave.component, loop.CALL: loop.FROM_INTEGER}]
        stepping = {loop.STEP: slave.address("fmi2DoStep"), loop.MULTIPLE: multiple}
        step += _guarded([{**first, **stepping}, *others], multiple)

    fed = {connection.target for connection in system.connections}
    point: list[Row] = []
    initial: list[Row] = []
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
        sources=np.array([signals.slots[c.source] for c in links], dtype=np.uint64),
        factors=np.array([c.factor for c in links], dtype=np.float64),
        offsets=np.array([c.offset for c in links], dtype=np.float64),
        values=signals.values,
        integers=signals.integers,
        recorded=np.array([signals.slots[end] for end in system.record], dtype=np.uint64),
        references=signals.references,
    )


def _conversion(row: Row, act: int) -> Row:
    """Between doubles and integers, for the slots of the call in ``row``."""
    return {loop.CALL: act, loop.COUNT: row[loop.COUNT], loop.SLOT: row[loop.SLOT]}


def _guarded(rows: list[Row], multiple: int) -> list[Row]:
    """Rows that hold only at every ``multiple``-th communication point."""
    if multiple == 1 or not rows:
        return rows
    return [{loop.CALL: loop.GUARD, loop.MULTIPLE: multiple, loop.COUNT: len(rows)}, *rows]


def program_array(rows: list[Row]) -> NDArray[np.uint64]:
    """The rows of a program as one array for the loop."""
    program = np.zeros((len(rows), loop.PROGRAM_COLUMNS), dtype=np.uint64)
    for number, row in enumerate(rows):
        for column, value in row.items():
            program[number, column] = value
    return program.reshape(-1)
