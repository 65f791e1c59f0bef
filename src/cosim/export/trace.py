"""From the equations of a component to C functions: run the methods on CasADi symbols, print what they did.

Every combination of ``bool`` and ``Choice`` parameters is traced on its own, so these cost nothing at run time;
equal functions are printed once. Subexpressions of parameters only are moved to a function of their own that runs
when parameters change.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, cast

from ..errors import TraceError
from ..model import Choice, Component
from .c_printer import Printer
from .interface import Scalar, choice_number, ordered_states, scalars
from .symbol import Symbol
from .variant import Symbols, Variant, depends

MAX_VARIANTS = 256


@dataclass(frozen=True)
class Trace:
    """What the exporter knows of a component: its scalar variables, C functions and dependencies.

    ``states`` has the continuous ones first. ``functions`` is C text; ``variants`` lists, for every combination
    of discrete choices in mixed radix order, the names of its functions. Dependencies are sets of indices.
    """

    kind: type[Component]
    parameters: tuple[Scalar, ...]
    inputs: tuple[Scalar, ...]
    states: tuple[Scalar, ...]
    outputs: tuple[Scalar, ...]
    n_continuous: int
    choices: tuple[tuple[int, tuple[float, ...]], ...]
    rules: tuple[str, ...]
    n_constants: int
    functions: str
    variants: tuple[tuple[str, ...], ...]
    output_inputs: tuple[frozenset[int], ...] = field(default=())
    output_states: tuple[frozenset[int], ...] = field(default=())
    derivative_inputs: tuple[frozenset[int], ...] = field(default=())
    derivative_states: tuple[frozenset[int], ...] = field(default=())
    initial_parameters: dict[str, frozenset[int]] = field(default_factory=dict[str, frozenset[int]])
    initial_inputs: dict[str, frozenset[int]] = field(default_factory=dict[str, frozenset[int]])


def _choices(scalar: Scalar) -> tuple[Any, ...]:
    if isinstance(scalar.start, bool):
        return (False, True)
    return tuple(cast("type[Choice]", type(scalar.start)))


def trace(kind: type[Component]) -> Trace:
    """Trace every variant of a component. Raises TraceError naming component, method and remedy."""
    parameters, inputs, outputs = scalars(kind), scalars(kind.Input), scalars(kind.Output)
    states, n_continuous = ordered_states(kind)
    symbols = Symbols(states, inputs, parameters)
    choices = tuple(
        (i, tuple(choice_number(v) for v in _choices(s)))
        for i, s in enumerate(parameters)
        if s.declaration.is_discrete_choice
    )
    combinations = list(itertools.product(*(_choices(parameters[i]) for i, _ in choices)))
    if len(combinations) > MAX_VARIANTS:
        raise TraceError(
            f"{kind.__name__}: {len(combinations)} combinations of bool and Choice parameters, at most "
            f"{MAX_VARIANTS} are traced. Make some of them numbers."
        )
    printer = Printer()
    variants: list[tuple[str, ...]] = []
    rules: tuple[str, ...] = ()
    collected: list[Variant] = []
    for combination in combinations:
        arguments: list[Any] = [Symbol(p) for p in symbols.p]
        for (index, _), value in zip(choices, combination, strict=True):
            arguments[index] = value
        variant = Variant(kind, symbols, arguments, states, n_continuous)
        rules = variant.rule_texts
        collected.append(variant)
        variants.append(printer.variant(variant, symbols))
    choice_indices = frozenset(i for i, _ in choices) if len(set(variants)) > 1 else frozenset[int]()

    def union(pick: Callable[[Variant], Sequence[Any]], letter: str, n: int) -> tuple[frozenset[int], ...]:
        return tuple(frozenset[int]().union(*(depends(pick(v)[row], letter) for v in collected)) for row in range(n))

    n_y, n_c = len(outputs), n_continuous
    initial_parameters: dict[str, frozenset[int]] = {}
    initial_inputs: dict[str, frozenset[int]] = {}
    groups: list[tuple[str, Callable[[Variant], Sequence[Any]], int]] = [
        ("state", lambda v: v.initial, n_c),
        ("output", lambda v: v.at_start(v.output), n_y),
        ("derivative", lambda v: v.at_start(v.derivative), n_c),
    ]
    for name, pick, count in groups:
        needed, used = union(pick, "p", count), union(pick, "u", count)
        for row in range(count):
            initial_parameters[f"{name}{row}"] = needed[row] | choice_indices
            initial_inputs[f"{name}{row}"] = used[row]
    return Trace(
        kind=kind,
        parameters=parameters,
        inputs=inputs,
        states=states,
        outputs=outputs,
        n_continuous=n_c,
        choices=choices,
        rules=rules,
        n_constants=printer.n_constants,
        functions=printer.text(),
        variants=tuple(variants),
        output_inputs=union(lambda v: v.output, "u", n_y),
        output_states=union(lambda v: v.output, "x", n_y),
        derivative_inputs=union(lambda v: v.derivative, "u", n_c),
        derivative_states=union(lambda v: v.derivative, "x", n_c),
        initial_parameters=initial_parameters,
        initial_inputs=initial_inputs,
    )
