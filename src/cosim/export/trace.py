"""From the equations of a component to C functions: run the methods on CasADi symbols, print the expressions they give.

Every combination of ``bool`` and ``Choice`` parameters is traced on its own, so these parameters cost nothing at run
time. Equal functions are printed once. Subexpressions that depend on parameters only have a function of their own,
which runs when parameters change.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, cast

from ..errors import TraceError
from ..model import Choice, Component
from .c_printer import Printer
from .check import check_component
from .interface import Scalar, choice_number, gap_rules, ordered_states, scalars
from .place import of_class
from .symbol import Symbol, casadi
from .variant import NoteText, Symbols, Variant, depends

MAX_VARIANTS = 256
"""Most combinations of bool and Choice parameters: each is traced and printed, so more would make slow builds."""
RUNTIME_PARAMETERS = ("T_s", "tolerance")
"""Parameters that the runtime of an FMU uses, whether or not an equation does."""
MAX_ROWS = 4096
"""Most rows of the table of variants. A row holds nine pointers, so the largest table has about 0.3 MB."""


@dataclass(frozen=True)
class Trace:
    """What the exporter knows of a component: its scalar variables, C functions and dependencies.

    ``states`` has the continuous states first. ``choices`` holds index, smallest number and count of numbers of each
    bool or Choice parameter. ``functions`` is C text. ``variants`` has the names of the functions for each combination
    of these numbers, the last parameter counting fastest. Dependencies are sets of indices.
    """

    kind: type[Component]
    parameters: tuple[Scalar, ...]
    inputs: tuple[Scalar, ...]
    states: tuple[Scalar, ...]
    outputs: tuple[Scalar, ...]
    n_continuous: int
    choices: tuple[tuple[int, int, int], ...]
    rules: tuple[str, ...]
    notes: tuple[NoteText, ...]
    n_constants: int
    functions: str
    variants: tuple[tuple[str, ...], ...]
    output_inputs: tuple[frozenset[int], ...] = field(default=())
    output_states: tuple[frozenset[int], ...] = field(default=())
    derivative_inputs: tuple[frozenset[int], ...] = field(default=())
    derivative_states: tuple[frozenset[int], ...] = field(default=())
    initial_parameters: dict[str, frozenset[int]] = field(default_factory=dict[str, frozenset[int]])
    initial_inputs: dict[str, frozenset[int]] = field(default_factory=dict[str, frozenset[int]])
    remarks: tuple[str, ...] = ()
    """Remarks for the author of the component: what is legal, but probably a mistake."""


def _members(scalar: Scalar) -> tuple[Any, ...]:
    """The values of a ``bool`` or ``Choice`` parameter, in the order of their numbers."""
    if isinstance(scalar.start, bool):
        return (False, True)
    return tuple(sorted(cast("type[Choice]", type(scalar.start)), key=choice_number))


@lru_cache(maxsize=1)
def trace(kind: type[Component]) -> Trace:
    """Trace every variant of a component.

    Raises DescriptionError for a wrong declaration, TraceError for equations that cannot be traced; both name the
    component, file, line and remedy.
    """
    check_component(kind)
    parameters, inputs, outputs = scalars(kind), scalars(kind.Input), scalars(kind.Output)
    states, n_continuous = ordered_states(kind)
    symbols = Symbols(states, n_continuous, inputs, parameters)
    discrete = {i: _members(s) for i, s in enumerate(parameters) if s.declaration.is_discrete_choice}
    collected = _traced(kind, symbols, discrete, states, n_continuous)
    printer = Printer()
    notes = tuple(dict.fromkeys(note for variant in collected.values() for note in variant.note_texts))
    choices, rules, variants = _table(kind, printer, symbols, discrete, collected, notes=notes)
    choice_indices = frozenset(discrete) if len(set(variants)) > 1 else frozenset[int]()

    def union(pick: Callable[[Variant], Sequence[Any]], letter: str, n: int) -> tuple[frozenset[int], ...]:
        return tuple(
            frozenset[int]().union(*(depends(pick(v)[row], letter) for v in collected.values())) for row in range(n)
        )

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
        notes=notes,
        n_constants=printer.n_constants,
        functions=printer.text(),
        variants=variants,
        output_inputs=union(lambda v: v.output, "u", n_y),
        output_states=union(lambda v: v.output, "x", n_y),
        derivative_inputs=union(lambda v: v.derivative, "u", n_c),
        derivative_states=union(lambda v: v.derivative, "x", n_c),
        initial_parameters=initial_parameters,
        initial_inputs=initial_inputs,
        remarks=tuple(_remarks(kind, list(collected.values()), choices, variants)),
    )


def _remarks(
    kind: type[Component],
    traced: Sequence[Variant],
    choices: Sequence[tuple[int, int, int]],
    variants: Sequence[tuple[str, ...]],
) -> Iterator[str]:
    """Parameters and inputs that no equation uses, and states whose derivative is the state itself."""
    name = kind.__name__
    rows = [r for v in traced for r in (*v.output, *v.derivative, *v.next, *v.update, *v.initial, *v.rules, *v.notes)]
    numbers = list(itertools.product(*(range(count) for _, _, count in choices)))
    used = {"p": set[int](), "u": set[int]()}
    for letter, found in used.items():
        found.update(*(depends(row, letter) for row in rows))
    for k, (index, _, _) in enumerate(choices):
        groups: dict[tuple[int, ...], set[tuple[str, ...]]] = {}
        for number, functions in zip(numbers, variants, strict=True):
            groups.setdefault((*number[:k], *number[k + 1 :]), set()).add(functions)
        if any(len(group) > 1 for group in groups.values()):
            used["p"].add(index)
    for owner, letter, what in ((kind, "p", "parameter"), (kind.Input, "u", "input")):
        members: dict[str, list[int]] = {}
        for index, scalar in enumerate(scalars(owner)):
            members.setdefault(scalar.declaration.name, []).append(index)
        for member, indices in members.items():
            if member not in RUNTIME_PARAMETERS and not used[letter].intersection(indices):
                yield f"{name}: no equation uses the {what} {member}. Take it out, or use it."
    for i, state in enumerate(ordered_states(kind)[0]):
        if any(
            i < len(v.derivative) and v.derivative[i].is_symbolic() and i in depends(v.derivative[i], "x")
            for v in traced
        ):
            yield (
                f"{name}: the derivative of {state.name} is {state.name} itself, as replace(x, ...) leaves it: it "
                "grows exponentially. Give its derivative, such as 0.0."
            )


def _traced(
    kind: type[Component],
    symbols: Symbols,
    discrete: Mapping[int, tuple[Any, ...]],
    states: Sequence[Scalar],
    n_continuous: int,
) -> dict[tuple[float, ...], Variant]:
    """Each combination of the numbers of bool and Choice parameters, and its variant."""
    combinations = list(itertools.product(*discrete.values()))
    if len(combinations) > MAX_VARIANTS:
        raise TraceError(
            f"{of_class(kind)}: {kind.__name__}: {len(combinations)} combinations of bool and Choice parameters, at "
            f"most {MAX_VARIANTS} are traced. Make some of them numbers."
        )
    collected: dict[tuple[float, ...], Variant] = {}
    for combination in combinations:
        arguments: list[Any] = [Symbol(p) for p in symbols.p]
        for index, value in zip(discrete, combination, strict=True):
            arguments[index] = value
        variant = Variant(kind, symbols, arguments, states, n_continuous)
        collected[tuple(map(choice_number, combination))] = variant
    return collected


def _table(
    kind: type[Component],
    printer: Printer,
    symbols: Symbols,
    discrete: Mapping[int, tuple[Any, ...]],
    collected: Mapping[tuple[float, ...], Variant],
    *,
    notes: Sequence[NoteText],
) -> tuple[tuple[tuple[int, int, int], ...], tuple[str, ...], tuple[tuple[str, ...], ...]]:
    """Choices, texts of rules, and the functions of each row of the table that the core looks variants up in.

    The table has a row for every whole number from the smallest to the largest of each Choice. A row of a number
    without a member has a broken rule; its other functions are those of the parameter's start value.
    """
    spans = {i: range(int(choice_number(m[0])), int(choice_number(m[-1])) + 1) for i, m in discrete.items()}
    size = math.prod(map(len, spans.values()))
    if size > MAX_ROWS:
        raise TraceError(
            f"{of_class(kind)}: {kind.__name__}: the numbers of its Choice parameters span {size} combinations, at "
            f"most {MAX_ROWS} can be told apart. Number the members 1, 2, 3 without gaps."
        )
    texts: dict[tuple[str, int], None] = {}
    for variant in collected.values():
        texts |= dict.fromkeys(_numbered(variant.rule_texts))
    gaps = gap_rules(kind)
    names: dict[tuple[float, ...], tuple[str, ...]] = {}
    for numbers, variant in collected.items():
        conditions = dict(zip(_numbered(variant.rule_texts), variant.rules, strict=True))
        rows = [conditions.get(text, casadi.SX(1.0)) for text in texts] + [casadi.SX(1.0) for _ in gaps]
        values = dict(zip(variant.note_texts, zip(variant.notes[::2], variant.notes[1::2], strict=True), strict=True))
        # A note that this variant lacks gets value 0 and limit 0, so that it is never told.
        pairs = [row for note in notes for row in values.get(note, (casadi.SX(0.0), casadi.SX(0.0)))]
        names[numbers] = printer.variant(variant, symbols, rows, pairs)
    listed: list[tuple[str, ...]] = []
    for numbers in itertools.product(*spans.values()):
        known = names.get(tuple(map(float, numbers)))
        if known is None:
            given = dict(zip(discrete, numbers, strict=True))
            starts = {i: choice_number(scalars(kind)[i].start) for i in discrete}
            member = [float(n) if n in set(map(choice_number, discrete[i])) else starts[i] for i, n in given.items()]
            rows = [casadi.SX(1.0) for _ in texts]
            rows += [casadi.SX(float(given[gap.reference] in gap.numbers)) for gap in gaps]
            known = printer.with_rules(names[tuple(member)], symbols, rows)
        listed.append(known)
    choices = tuple((i, span.start, len(span)) for i, span in spans.items())
    return choices, (*(text for text, _ in texts), *(gap.text for gap in gaps)), tuple(listed)


def _numbered(texts: Sequence[str]) -> list[tuple[str, int]]:
    """Each text with the number of equal texts before it, as two rules may have the same text."""
    return [(text, texts[:i].count(text)) for i, text in enumerate(texts)]
