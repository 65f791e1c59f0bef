"""The program of a system: the actions of a step, as rows of numbers for the inner loop."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..fmu.variables import Variable
from ..system.parts import Connection, Instance
from ..system.system import System
from . import loop
from .fmi3 import wholes
from .instance import FmuInstance
from .tables import Tables, table_slots


def same_program(one: System, other: System) -> bool:
    """Whether two variants of a system have the same program: they differ only in start values, times and tolerance."""
    return _decisive(one) == _decisive(other)


def _decisive(system: System) -> tuple[object, ...]:
    """All of a system on which its program depends."""
    steps = [(instance.name, instance.step_multiple) for instance in system.instances]
    return system.connections, system.record, system.signals, system.evaluation_order, system.parallel, steps


@dataclass
class Program:
    """The rows that the loop executes for one system, and the arrays that they use."""

    point: list[loop.Row]
    step: list[loop.Row]
    initial: list[loop.Row]
    """Rows for a communication point (``point``), for the step to the next point (``step``), and for a pass of
    initialization (``initial``)."""
    outputs: list[loop.Row]
    """Rows that read all outputs that are connected or recorded."""
    slots: Mapping[tuple[str, str], int]
    connections: list[Connection]
    """The connection of each element of ``links``."""
    links: NDArray[np.void]
    values: NDArray[np.float64]
    others: NDArray[np.uint64]
    recorded: NDArray[np.uint64]
    resting: list[tuple[str, Variable]]
    """Unconnected array elements that are set at every step, because other elements of their array are connected."""
    references: list[NDArray[np.uint32]]
    """The value references. They are kept here because the rows have only their addresses."""
    tables: Tables
    """The values of records and noise."""

    @cached_property
    def arrays(self) -> Mapping[str, loop.Unsigned]:
        """The rows as arrays: ``step``, with the rows of the point before it, ``initial`` and ``outputs``."""
        rows = {"step": self.point + self.step, "initial": self.initial, "outputs": self.outputs}
        return {name: loop.array(part) for name, part in rows.items()}

    def reset(self, system: System) -> None:
        """Set all signals to their values before a run of ``system``, a variant of the same system."""
        self.values[:] = 0.0
        self.others[:] = 0
        for name, variable in self.resting:
            value = system.instance(name).start.get(variable.name, variable.start)
            self.values[self.slots[name, variable.name]] = 0.0 if value is None else float(value)
        self.tables.begin(system)
        self.tables.fill(0, 0)
        if self.tables.width:
            self.values[-self.tables.width :] = self.tables.buffer[0]


_Link = tuple[Connection, tuple[int, int, float, float]]
"""A connection, with the numbers of ``loop.LINK_TYPE``."""


class Signals:
    """Assigns a slot to every signal that is connected or recorded.

    The slots of an instance's inputs of one type are side by side, and so are the slots of its outputs.
    """

    def __init__(self, system: System) -> None:
        self.slots: dict[tuple[str, str], int] = {}
        self.inputs: dict[tuple[str, int], list[Connection]] = {}
        """By instance and type, the connections that set inputs; for a sum, its first connection."""
        self.outputs: dict[tuple[str, int], list[Variable]] = {}
        self.resting: list[tuple[str, Variable]] = []
        for instance in system.instances:
            name, variables = instance.name, instance.fmu.variables
            incoming = {c.target[1]: c for c in system.connections if c.target[0] == name and not c.added}
            for kind, fed in self._by_kind(instance, incoming).items():
                self.inputs[name, kind] = [incoming[variable.name] for variable in fed]
                for _, elements in wholes(variables, fed):
                    self._place(name, elements)
                    self.resting += [(name, element) for element in elements if element.name not in incoming]
            wanted = [c.source[1] for c in system.connections if c.source[0] == name]
            wanted += [v for other, v in system.record if other == name]
            read = dict.fromkeys(v for v in wanted if (name, v) not in self.slots)
            for kind, outputs in self._by_kind(instance, read).items():
                self.outputs[name, kind] = outputs
                for _, elements in wholes(variables, outputs):
                    self._place(name, elements)
        self.tables = Tables(system)
        self.noise: dict[tuple[str, str], int] = {}
        """The slot of the noise, for each input with noise."""
        first = len(self.slots)
        self.slots.update(table_slots(self.tables, first))
        self.noise = {c.target: first + len(self.tables.columns) + i for i, c in enumerate(self.tables.noise)}
        self.values = np.zeros(max(first + self.tables.width, 1))
        self.others = np.zeros(self.values.size, dtype=np.uint64)
        """Buffers for values of other types than double. The values of a call are packed from its first slot on."""
        self.references: list[NDArray[np.uint32]] = []
        self.links: list[_Link] = []

    def link(self, connection: Connection) -> _Link:
        """A connection with its numbers for the loop."""
        numbers = self.slots[connection.source], self.slots[connection.target], connection.factor, connection.offset
        return connection, numbers

    def addends(self, system: System, connections: Sequence[Connection]) -> list[_Link]:
        """The links that add to the targets of ``connections``: the later connections of sums, and noise."""
        targets = {connection.target for connection in connections}
        links = [self.link(c) for c in system.connections if c.added and c.target in targets]
        noisy = [c for c in connections if c.noise is not None]
        return [*links, *((c, (self.noise[c.target], self.slots[c.target], 1.0, 0.0)) for c in noisy)]

    def setting(self, system: System, slave: FmuInstance, kind: int) -> list[loop.Row]:
        """The rows that carry values to the connected inputs of one type of an instance, and set them."""
        connections = self.inputs.get((slave.name, kind), [])
        if not connections:
            return []
        row = self.call(slave, kind, [slave.fmu.variables[c.target[1]] for c in connections], into=True)
        carry: loop.Row = {loop.LINKS: len(connections), loop.LINK: len(self.links)}
        self.links += [self.link(connection) for connection in connections]
        addends = self.addends(system, connections)
        if not addends:
            return [{**row, **carry}]
        add: loop.Row = {loop.ACT: loop.ADD, loop.LINKS: len(addends), loop.LINK: len(self.links)}
        self.links += addends
        return [{loop.ACT: loop.NOTHING, **carry}, add, row]

    @staticmethod
    def _by_kind(instance: Instance, names: Iterable[str]) -> dict[int, list[Variable]]:
        """Variables grouped by the loop's number of their type, in the order of these numbers."""
        types = loop.FMI3_TYPES if instance.fmu.fmi == 3 else loop.FMI2_TYPES
        found: dict[int, list[Variable]] = {}
        for name in names:
            variable = instance.fmu.variables[name]
            found.setdefault(types[variable.passed_as], []).append(variable)
        return dict(sorted(found.items()))

    def _place(self, name: str, variables: Iterable[Variable]) -> None:
        for variable in variables:
            self.slots[name, variable.name] = len(self.slots)

    def kinds(self, name: str) -> list[int]:
        """The loop's numbers of the types that an instance's signals have, sorted."""
        return sorted({kind for other, kind in (*self.inputs, *self.outputs) if other == name})

    def call(self, slave: FmuInstance, kind: int, variables: Sequence[Variable], *, into: bool) -> loop.Row:
        """The row of a call that sets (``into``) or reads variables, or the arrays that they belong to.

        Their slots must be side by side.
        """
        function = f"{slave.prefix}{'Set' if into else 'Get'}{variables[0].passed_as}"
        whole = wholes(slave.fmu.variables, variables)
        self.references.append(np.array([variable.reference for variable, _ in whole], dtype=np.uint32))
        slot = self.slots[slave.name, whole[0][1][0].name]
        buffer = self.values if kind == loop.FLOAT64 else self.others
        return {
            loop.ACT: loop.EXCHANGE,
            loop.FMI: slave.fmu.fmi,
            loop.COMPONENT: slave.component,
            loop.FUNCTION: slave.address(function),
            loop.CALL: loop.call_number(slave.number, function),
            loop.REFERENCES: self.references[-1].ctypes.data,
            loop.REFERENCE_COUNT: len(whole),
            loop.COUNT: sum(len(elements) for _, elements in whole),
            loop.BUFFER: buffer.ctypes.data + slot * buffer.itemsize,
            loop.SLOT: slot,
            loop.TYPE: kind,
            loop.SET: int(into),
        }


def make_program(system: System, slaves: list[FmuInstance]) -> Program:
    """The program of ``system``: names are resolved once to slots, value references and addresses."""
    signals = Signals(system)
    sets: dict[str, list[loop.Row]] = {}
    gets: dict[str, list[loop.Row]] = {}
    step: list[loop.Row] = []
    for instance, slave in zip(system.instances, slaves, strict=True):
        name = instance.name
        sets[name], gets[name] = [], []
        for kind in signals.kinds(name):
            sets[name] += signals.setting(system, slave, kind)
            if outputs := signals.outputs.get((name, kind)):
                gets[name].append(signals.call(slave, kind, outputs, into=False))
        first, *others = gets[name] or [{loop.FMI: slave.fmu.fmi, loop.COMPONENT: slave.component}]
        function = f"{slave.prefix}DoStep"
        called = loop.call_number(slave.number, function)
        stepping = {loop.STEP: slave.address(function), loop.STEP_CALL: called, loop.MULTIPLE: instance.step_multiple}
        step += _guarded([{**first, **stepping}, *others], instance.step_multiple)

    fed = {connection.target for connection in system.connections}
    point = _table_rows(signals)
    initial: list[loop.Row] = []
    for name in system.evaluation_order:
        instance = system.instance(name)
        read = [variable.name for (other, _), group in signals.outputs.items() if other == name for variable in group]
        direct = any((name, i) in fed for output in read for i in instance.fmu.dependencies.get(output, ()))
        rows = [*sets[name], *gets[name]] if direct and not system.parallel else sets[name]
        point += _guarded(rows, instance.step_multiple)
        initial += [*sets[name], *gets[name]]
    program = Program(
        point=point,
        step=step,
        initial=initial,
        outputs=[row for rows in gets.values() for row in rows],
        slots=signals.slots,
        connections=[connection for connection, _ in signals.links],
        links=np.array([numbers for _, numbers in signals.links], loop.LINK_TYPE),
        values=signals.values,
        others=signals.others,
        recorded=np.array([signals.slots[end] for end in system.record], dtype=np.uint64),
        resting=signals.resting,
        references=signals.references,
        tables=signals.tables,
    )
    program.reset(system)
    return program


def _table_rows(signals: Signals) -> list[loop.Row]:
    """The row that reads the values of records and noise from their table; empty without records and noise."""
    tables = signals.tables
    if not tables.width:
        return []
    slot = signals.values.size - tables.width
    return [{loop.ACT: loop.TABLE, loop.COUNT: tables.width, loop.SLOT: slot, loop.BUFFER: tables.buffer.ctypes.data}]


def _guarded(rows: list[loop.Row], multiple: int) -> list[loop.Row]:
    """``rows``, preceded by a row that skips them unless the point is a multiple of ``multiple``."""
    if multiple == 1 or not rows:
        return rows
    return [{loop.ACT: loop.GUARD, loop.MULTIPLE: multiple, loop.COUNT: len(rows)}, *rows]
