"""Reference outputs of a component in an experiment, from its Python methods alone: no FMI, no C, no own integrator.

Plants are integrated by scipy's Radau at a relative tolerance of 1e-10; integration starts anew whenever inputs
change. For plants with jumps in their rates the experiment names another solution. Controllers and sources are
evaluated as they are. Row k stands for the time t[k] = k*step_size. Its inputs are held from t[k] to t[k+1]. Its
outputs are those right after the step that ends at t[k], before the next inputs are set; for a controller this is
the output applied over that step. The outputs of row 0 are those after initialization with the inputs of row 0.
"""

# scipy leaves the types of its solvers open:
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from math import floor
from typing import Any, cast

import numpy as np
from scipy.integrate import Radau

from ..errors import DescriptionError
from ..export.interface import scalars
from ..model import Component, Controller, Plant, Source, unflatten
from .fmi_ls_ref import Tolerance

RELATIVE_TOLERANCE = 1e-10
"""Relative tolerance of Radau, far below the tolerance of every comparison."""

STIMULI_DIGITS = 7
"""Significant digits of a stimulus. Stimuli are rounded before use, so that the file holds exactly the values used."""

PLANT_TOLERANCE = 1e-9
"""Relative tolerance that a plant's experiment asks its solver for."""

SHARES = {Plant: 1e-6, Controller: 1e-9, Source: 1e-9}
"""Relative tolerances of comparison. Plants: the error of the native and the Python integrator at a tolerance of 1e-9
over 100 restarts, with a factor of 10 to spare. Others: differences in the last bits of ``exp`` and ``sin`` on other
platforms, which a division by T_s makes larger."""


@dataclass(frozen=True, kw_only=True)
class Validation:
    """An experiment that a component is validated with."""

    name: str
    description: str
    step_size: float = 2.0**-9
    """In s. A power of two, so that k*step_size is exact and all importers sample at the same times.

    2^-9 s = 1.953125 ms is also exact in whole nanoseconds, in which some importers count time.
    """
    steps: int
    shown: tuple[str, ...]
    """Outputs that the picture shows."""
    parameters: Mapping[str, Any] = field(default_factory=dict[str, Any])
    """Parameter values by attribute; all others have their start values."""
    stimuli: Mapping[str, Callable[[float], float]] = field(default_factory=dict[str, Callable[[float], float]])
    """Inputs as functions of time in s; all others are 0."""
    solution: Callable[[Any, float, list[Any]], list[tuple[float, ...]]] | None = None
    """A function that replaces integration: (component, step size in s, inputs) -> outputs of every row."""

    def component(self, kind: type[Component]) -> Component:
        """``kind`` with the parameters of this experiment."""
        return kind(**dict(self.parameters))

    def time(self, row: int) -> float:
        """Time of a row in s."""
        return row * self.step_size

    def inputs(self, kind: type[Component]) -> list[tuple[float, ...]]:
        """The inputs of every row, in SI units and in the order of the component's ``Input``.

        Raises DescriptionError for stimuli that are no inputs.
        """
        names = scalar_names(kind.Input)
        unknown = set(self.stimuli) - set(names)
        if unknown:
            raise DescriptionError(f"{kind.__name__}, experiment '{self.name}': no input {sorted(unknown)}.")
        return [
            tuple(
                float(f"{self.stimuli[name](self.time(row)):.{STIMULI_DIGITS}g}") if name in self.stimuli else 0.0
                for name in names
            )
            for row in range(self.steps + 1)
        ]


def tolerance(kind: type[Component]) -> Tolerance:
    """The largest difference allowed between an output of a component and its reference."""
    return Tolerance(0.0, next(share for base, share in SHARES.items() if issubclass(kind, base)))


def scalar_names(record: Any) -> tuple[str, ...]:
    """Names of the scalar members of a record, array elements one by one."""
    return tuple(scalar.name for scalar in scalars(record))


def trace(
    kind: type[Component], validation: Validation, inputs: list[tuple[float, ...]] | None = None
) -> list[tuple[float, ...]]:
    """The outputs of every row; ``inputs`` replaces those of the experiment."""
    component = validation.component(kind)
    given = validation.inputs(kind) if inputs is None else inputs
    if validation.solution is not None:
        filled = [kind.Input(**unflatten(kind.Input, iter(row))) for row in given]
        return validation.solution(component, validation.step_size, filled)
    rows = {Plant: _plant, Controller: _controller, Source: _source}
    base = next(base for base in rows if isinstance(component, base))
    made = rows[base](
        cast(Any, component), validation, [kind.Input(**unflatten(kind.Input, iter(row))) for row in given]
    )
    return [tuple(float(value) for value in output) for output in made]


def _source(source: Source, validation: Validation, inputs: list[Any]) -> Iterator[Any]:
    for row in range(len(inputs)):
        yield source.output(validation.time(row))


def _controller(controller: Controller, validation: Validation, inputs: list[Any]) -> Iterator[Any]:
    """Outputs of a controller, sampled at multiples of T_s. A step covers several samples, one, or none."""
    ratio = validation.step_size / controller.T_s
    x = controller.initial()
    y = controller.output(0.0, x, inputs[0])
    yield y
    sampled = 0
    for row, u in enumerate(inputs[:-1]):
        # number of samples, at k*T_s, before the end of this step
        until = -floor(-(row + 1) * ratio)
        for k in range(sampled, until):
            y = controller.output(k * controller.T_s, x, u)
            x = controller.update(k * controller.T_s, x, u, y)
        sampled = until
        yield y


def _plant(plant: Plant, validation: Validation, inputs: list[Any]) -> Iterator[Any]:
    x = plant.initial()
    yield plant.output(0.0, x, inputs[0])
    for row, u in enumerate(inputs[:-1]):
        start, end = validation.time(row), validation.time(row + 1)
        x = _integrated(plant, x, u, start, end)
        yield plant.output(end, x, u)


def _integrated(plant: Plant, x: Any, u: Any, start: float, end: float) -> Any:
    """The state at ``end``. ``update`` is called after each step of Radau, at least 16 times a communication step."""
    state: Any = type(x)
    lines = [scalar.declaration for scalar in scalars(state)]
    free = [i for i, line in enumerate(lines) if not line.discrete]
    values = [float(value) for value in x]

    def filled(y: Any) -> Any:
        whole = list(values)
        for i, value in zip(free, y, strict=True):
            whole[i] = float(value)
        return state(**unflatten(state, iter(whole)))

    def rate(t: float, y: Any) -> Any:
        derivative = [float(value) for value in plant.derivative(float(t), filled(y), u)]
        return np.array([derivative[i] for i in free])

    solver = Radau(
        rate,
        start,
        np.array([values[i] for i in free]),
        end,
        max_step=(end - start) / 16,
        rtol=RELATIVE_TOLERANCE,
        atol=cast(Any, np.array([RELATIVE_TOLERANCE * lines[i].nominal for i in free])),
    )
    while solver.status == "running":
        problem = solver.step()
        if problem:
            raise DescriptionError(f"{type(plant).__name__}: Radau stopped at {solver.t:g} s: {problem}")
        values[:] = [float(value) for value in plant.update(float(solver.t), filled(solver.y), u)]
    return state(**unflatten(state, iter(values)))
