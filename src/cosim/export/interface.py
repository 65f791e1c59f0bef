"""The scalar variables of an FMU in the order of their value references. XML, C tables and Python instances use them.

This module needs the declaration only, no trace, as it travels inside Python FMUs.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Literal

from ..model import Choice, Component, Controller, Declaration, Plant, Record, declarations, unflatten

Role = Literal["fixed", "tunable", "input", "state", "output", "derivative", "counter", "independent"]
Type = Literal["Real", "Integer", "Boolean", "Enumeration"]

COUNTERS = (
    ("solver.steps", "Accepted steps of the integrator since initialization"),
    ("solver.rejected", "Rejected steps of the integrator since initialization"),
    ("solver.rhs_evaluations", "Evaluations of the derivatives since initialization"),
    ("solver.jacobians", "Evaluations of the Jacobian since initialization"),
    ("solver.decompositions", "Inversions of the matrix of the stages since initialization"),
)


@dataclass(frozen=True)
class Scalar:
    """One scalar variable of the FMU: its declaration and, for an array, the index of the element."""

    declaration: Declaration
    name: str
    start: Any


def scalars(owner: type[Record] | type[Component]) -> tuple[Scalar, ...]:
    """The scalar variables of a record or of a component's parameters, arrays flattened."""
    found: list[Scalar] = []
    for declaration in declarations(owner):
        starts = (declaration.start,) if declaration.length is None else declaration.start
        found += [Scalar(declaration, name, start) for name, start in zip(declaration.names, starts, strict=True)]
    return tuple(found)


def ordered_states(kind: type[Component]) -> tuple[tuple[Scalar, ...], int]:
    """The scalar states in the order of FMUs, continuous ones first, and how many of these there are."""
    states = scalars(kind.State)
    continuous = [s for s in states if issubclass(kind, Plant) and not s.declaration.discrete]
    return (*continuous, *(s for s in states if s not in continuous)), len(continuous)


def choice_number(value: Any) -> float:
    """The number an FMU keeps for a ``bool`` or ``Choice``."""
    return float(value.number) if isinstance(value, Choice) else float(value)


def unchecked(kind: type[Component], values: Iterable[Any]) -> Any:
    """The component with these scalar parameters. Bounds and rules are not checked, as the values may be symbols."""
    component: Any = object.__new__(kind)
    for name, value in unflatten(kind, iter(values)).items():
        object.__setattr__(component, name, value)
    return component


@dataclass(frozen=True)
class Gap:
    """An enumeration parameter whose numbers are not consecutive, and the rule that refuses the missing numbers."""

    reference: int
    numbers: frozenset[int]
    text: str


def gap_rules(kind: type[Component]) -> tuple[Gap, ...]:
    """The rules of enumerations with gaps. Bounds alone would let numbers without a member pass."""
    found: list[Gap] = []
    for reference, scalar in enumerate(scalars(kind)):
        if not isinstance(scalar.start, Choice):
            continue
        members = sorted(type(scalar.start), key=lambda item: item.number)
        if members[-1].number - members[0].number >= len(members):
            listed = ", ".join(f"{item.number} ({item.name})" for item in members)
            text = f"{scalar.name} has a number without a member. Give one of {listed}."
            found.append(Gap(reference, frozenset(item.number for item in members), text))
    return tuple(found)


@dataclass(frozen=True)
class InterfaceVariable:
    """A scalar variable; ``reference`` is its value reference, ``start`` is numeric (enumerations by number)."""

    reference: int
    name: str
    role: Role
    type: Type
    start: float
    unit: str
    description: str
    min: float = -math.inf
    max: float = math.inf
    nominal: float = 1.0
    display_unit: str | None = None
    choice: type[Choice] | None = None
    continuous: bool = True
    state: int | None = None
    """Value reference of the state whose derivative this variable is."""
    array: str | None = None
    """Name of the array that has this variable as an element."""


def _declared(reference: int, scalar: Scalar, role: Role, continuous: bool) -> InterfaceVariable:
    """The variable of a declared scalar."""
    declaration, start = scalar.declaration, scalar.start
    low, high, typed, choice = declaration.min, declaration.max, "Real", None
    if isinstance(start, bool):
        typed, low, high = "Boolean", 0.0, 1.0
    elif isinstance(start, Choice):
        typed, choice = "Enumeration", type(start)
        numbers = [float(item.number) for item in choice]
        low, high = min(numbers), max(numbers)
    elif isinstance(declaration.start, int):
        typed = "Integer"
    return InterfaceVariable(
        reference=reference,
        name=scalar.name,
        role=role,
        type=typed,
        start=choice_number(start),
        unit=declaration.unit,
        description=declaration.description,
        min=low,
        max=high,
        nominal=declaration.nominal,
        display_unit=declaration.display_unit,
        choice=choice,
        continuous=continuous,
        array=None if declaration.length is None else declaration.name,
    )


def variables_of(kind: type[Component]) -> tuple[InterfaceVariable, ...]:
    """All variables: parameters, inputs, states, outputs, derivatives, solver counters."""
    found: list[InterfaceVariable] = []
    sampled = issubclass(kind, Controller)
    parameters, inputs, outputs = scalars(kind), scalars(kind.Input), scalars(kind.Output)
    states, n_continuous = ordered_states(kind)

    def add(scalar: Scalar, role: Role, continuous: bool = True) -> None:
        found.append(_declared(len(found), scalar, role, continuous))

    for scalar in parameters:
        add(scalar, "tunable" if scalar.declaration.variability == "tunable" else "fixed")
    for scalar in inputs:
        add(scalar, "input", not sampled)
    first_state = len(found)
    names = {scalar.name for scalar in (*parameters, *inputs, *outputs)}
    for i, scalar in enumerate(states):
        name = f"state.{scalar.name}" if scalar.name in names else scalar.name
        add(Scalar(scalar.declaration, name, scalar.start), "state", i < n_continuous)
    for scalar in outputs:
        add(scalar, "output", not sampled)
    for i in range(n_continuous):
        state = found[first_state + i]
        found.append(
            InterfaceVariable(
                reference=len(found),
                name=f"der({state.name})",
                role="derivative",
                type="Real",
                start=0.0,
                unit=derivative_unit(state.unit),
                description=f"Time derivative of {state.name}",
                state=state.reference,
            )
        )
    if issubclass(kind, Plant):
        for name, text in COUNTERS:
            found.append(
                InterfaceVariable(len(found), name, "counter", "Integer", 0.0, "1", text, min=0.0, continuous=False)
            )
    return tuple(found)


def fmi3_variables(kind: type[Component]) -> tuple[tuple[InterfaceVariable, ...], ...]:
    """The variables of an FMI 3.0 FMU, each with its elements. A parameter array is one variable; time comes last.

    A value reference is that of the first element.
    """
    flat = variables_of(kind)
    found: list[list[InterfaceVariable]] = []
    for variable in flat:
        whole = variable.array is not None and variable.role in ("fixed", "tunable")
        if whole and found and found[-1][0].array == variable.array:
            found[-1].append(variable)
        else:
            found.append([variable])
    return (*map(tuple, found), (InterfaceVariable(len(flat), "time", "independent", "Real", 0.0, "s", "Time"),))


def derivative_unit(unit: str) -> str:
    """The unit of a time derivative."""
    known = {
        "m": "m/s",
        "m/s": "m/s2",
        "rad": "rad/s",
        "rad/s": "rad/s2",
        "1": "1/s",
        "A": "A/s",
        "N": "N/s",
        "V": "V/s",
    }
    return known.get(unit, f"({unit})/s")


def reference_of(kind: type[Component], variables: tuple[InterfaceVariable, ...], name: str) -> int:
    """The value reference of the variable ``name``. The error for a wrong name says which component lacks it."""
    for variable in variables:
        if variable.name == name:
            return variable.reference
    raise KeyError(f"{kind.__name__} has no variable {name}")
