"""The memory of an instance of a Python FMU, and conversions between its numbers and a component's records."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cache
from typing import Any, cast

from ...model import Component
from ..contract import INSTANTIATED
from ..interface import InterfaceVariable, gap_rules, ordered_states, scalars, variables_of
from .dual import Dual
from .messages import PHASES
from .ticks import Ticks


@dataclass
class Memory:
    """All that an instance remembers, which is its FMU state. ``core.c`` explains the fields of the same names."""

    v: list[float]
    next: list[float]
    start: float = 0.0
    time: float = 0.0
    stop: float = math.inf
    tolerance: float = 0.0
    step: float = 0.0
    steps: int = 0
    count: Ticks = field(default_factory=Ticks)
    counts: list[int] = field(default_factory=lambda: [0] * 5)
    phase: int = INSTANTIATED
    tolerance_set: bool = False
    parameters_dirty: bool = True
    outputs_dirty: bool = True
    derivatives_dirty: bool = True
    sampled: bool = False
    told: list[str] = field(default_factory=list[str])
    """Names and limits of the notes that have been told."""

    def copy(self) -> dict[str, Any]:
        """Plain values that share nothing with this memory."""
        return asdict(self)


class MemoryLayout:
    """Where the variables of a component are in ``Memory.v``."""

    def __init__(self, kind: type[Component]) -> None:
        self.variables: tuple[InterfaceVariable, ...] = variables_of(kind)
        states, self.n_continuous = ordered_states(kind)
        sizes = [
            len(scalars(kind)),
            len(scalars(kind.Input)),
            len(states),
            len(scalars(kind.Output)),
            self.n_continuous,
        ]
        starts = [sum(sizes[:i]) for i in range(len(sizes) + 1)]
        self.parameters, self.inputs, self.states, self.outputs, self.derivatives = (
            slice(starts[i], starts[i + 1]) for i in range(5)
        )
        self.counter_0 = starts[5]
        declared = [scalar.name for scalar in scalars(kind.State)]
        ordered = [scalar.name for scalar in states]
        self.to_record = [ordered.index(name) for name in declared]
        self.from_record = [declared.index(name) for name in ordered]
        self.nominals = [scalar.declaration.nominal for scalar in states[: self.n_continuous]]
        self.references = {variable.name: variable.reference for variable in self.variables}
        self.gaps = gap_rules(kind)
        self.whole_states = [(i, v) for i, v in enumerate(self.variables[self.states]) if v.type != "Real"]
        self.whole_inputs = [(i, v) for i, v in enumerate(self.variables[self.inputs]) if v.type != "Real"]


@cache
def interface(kind: type[Component]) -> MemoryLayout:
    """The memory layout of a component; it is made once."""
    return MemoryLayout(kind)


def restored(state: Mapping[str, Any], like: Memory, face: MemoryLayout) -> Memory | None:
    """The memory from saved values. None if they do not fit this FMU; ``like`` is a memory that does."""
    copied: dict[str, Any] = {k: list(cast("list[Any]", v)) if isinstance(v, list) else v for k, v in state.items()}
    try:
        copied["count"] = Ticks(**copied["count"])
        memory = Memory(**copied)
        values: list[Any] = [*memory.v, *memory.next]
        given = zip(face.variables[: face.states.start], memory.v, strict=False)
        sound = (
            len(memory.v) == len(like.v)
            and len(memory.next) == len(like.next)
            and len(memory.counts) == len(like.counts)
            and memory.phase in PHASES
            and all(math.isfinite(value) and v.min <= value <= v.max for v, value in given)
            and all(isinstance(value, float | int) for value in values)
            and all(math.isfinite(value) for value in (memory.start, memory.time, memory.tolerance))
            and memory.stop > memory.start
            and memory.count.is_sound()
            and isinstance(cast(object, memory.told), list)
        )
    except (KeyError, TypeError, ValueError, OverflowError):
        return None
    return memory if sound else None


def value_of(variable: InterfaceVariable, number: float) -> Any:
    """The value of a component's field for a number of the FMU; the start value for a number without a member."""
    if variable.choice is not None:
        known = {item.number: item for item in variable.choice}
        return known.get(int(number), known[int(variable.start)])
    return {"Boolean": bool, "Integer": int}.get(variable.type, float)(number)


def with_types(values: Sequence[Dual | float], whole: Sequence[tuple[int, InterfaceVariable]]) -> Sequence[Any]:
    """Values with the types that equations expect; ``whole`` lists the places that hold no floats."""
    if not whole:
        return values
    typed: list[Any] = list(values)
    for i, variable in whole:
        typed[i] = value_of(variable, typed[i])
    return typed


def numbers(call: Callable[[], Any], n: int) -> list[float]:
    """The values of the record that ``call`` returns; ``n`` NaNs if Python refuses to compute them."""
    try:
        return [value if isinstance(value, float) else float_of(value) for value in cast(Iterable[Any], call())]
    except (ArithmeticError, ValueError):
        return [math.nan] * n


def float_of(value: Any) -> float:
    """A number as float. A complex number, as Python gives for roots of negative values, becomes NaN."""
    return math.nan if isinstance(value, complex) else float(value)
