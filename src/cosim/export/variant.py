"""The equations of one combination of ``bool`` and ``Choice`` parameters as expressions of CasADi."""

from __future__ import annotations

import inspect
import random
import sys
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import FrozenInstanceError
from typing import Any, NamedTuple, cast

from ..errors import TraceError, suggest
from ..model import (
    FUNCTIONS,
    Choice,
    Component,
    Controller,
    Declaration,
    Note,
    Plant,
    Record,
    Rule,
    Source,
    declarations,
    unflatten,
)
from . import place
from .interface import Scalar, scalars, unchecked
from .symbol import Symbol, casadi, expression

POINTS = 3
"""Number of points at which methods are called with numbers. One may lie where the method raises an error."""
SAME, SMALLEST = 1e-6, 1e-9
"""Largest relative difference that rounding of expressions in another order explains, and the smallest value that is
compared."""
ALLOWED = f"Equations use arithmetic, comparisons and these functions of cosim.model: {', '.join(FUNCTIONS)}."


class Symbols:
    """The symbols t, x, u, p of one component, and the C text of each.

    ``known`` holds the continuous states and inputs; ``direction`` holds a symbol for the change of each of them.
    """

    def __init__(self, x: Sequence[Scalar], n_continuous: int, u: Sequence[Scalar], p: Sequence[Scalar]) -> None:
        self.t: Any = casadi.SX.sym("t")
        self.x = [casadi.SX.sym(f"x{i}") for i in range(len(x))]
        self.u = [casadi.SX.sym(f"u{i}") for i in range(len(u))]
        self.p = [casadi.SX.sym(f"p{i}") for i in range(len(p))]
        self.known = [*self.x[:n_continuous], *self.u]
        self.direction = [casadi.SX.sym(f"d{i}") for i in range(len(self.known))]
        self.all = [self.t, *self.x, *self.u, *self.p, *self.direction]
        groups = (("x", self.x), ("u", self.u), ("p", self.p), ("direction", self.direction))
        self.text = ["t"] + [f"{name}[{i}]" for name, group in groups for i in range(len(group))]


def depends(expr: Any, letter: str) -> frozenset[int]:
    """Indices of the symbols named by ``letter`` (x, u or p) that an expression depends on."""
    names = [cast(str, symbol.name()) for symbol in casadi.symvar(expr)]
    return frozenset(int(name[1:]) for name in names if name[0] == letter and name[1:].isdigit())


class Variant:
    """The expressions of one combination of discrete choices.

    Raises TraceError if a method cannot be traced, or if a second call of it gives another result.
    """

    def __init__(
        self,
        kind: type[Component],
        symbols: Symbols,
        arguments: Sequence[Any],
        states: Sequence[Scalar],
        n_continuous: int,
    ) -> None:
        self.kind, self.symbols, self.n_continuous = kind, symbols, n_continuous
        with _watched(kind.State, kind.Output):
            at = self._symbolic(symbols)
            rows = self._evaluated(arguments, states, at)
            again = self._evaluated(arguments, states, at)
        self.rule_texts, self.note_texts = rows.rules, rows.notes
        for method, known in rows.known.items():
            if (
                rows.rules != again.rules
                or rows.notes != again.notes
                or self._text(known) != self._text(again.known[method])
            ):
                raise TraceError(
                    f"{place.of_method(kind, method)}: {kind.__name__}.{method} gives another result when it is called "
                    "again with the same arguments. Take out random numbers, clocks and what a call leaves behind."
                )
        self._compare_numbers(rows, arguments, states)
        self.rules, self.initial, self.output = rows.known["rules"], rows.known["initial"], rows.known["output"]
        self.notes = rows.known["notes"]
        discrete = rows.known.get("update", [])
        self.next: list[Any] = discrete if issubclass(kind, Controller) else []
        self.update: list[Any] = discrete[n_continuous:] if issubclass(kind, Plant) else []
        self.derivative: list[Any] = rows.known.get("derivative", [])[:n_continuous]
        self._differentiate()

    def _differentiate(self) -> None:
        symbols, n_continuous = self.symbols, self.n_continuous
        rows = casadi.vertcat(*self.derivative) if self.derivative else casadi.SX(0, 1)
        columns = casadi.vertcat(*symbols.x[:n_continuous]) if n_continuous else casadi.SX(0, 1)
        self.jacobian = _dense(casadi.jacobian(rows, columns))
        self.time_derivative = _dense(casadi.jacobian(rows, symbols.t))
        unknown, known, direction = (
            casadi.vertcat(*rows) for rows in ([*self.derivative, *self.output], symbols.known, symbols.direction)
        )
        self.directional = _dense(casadi.jtimes(unknown, known, direction)) if symbols.known else []

    @staticmethod
    def _symbolic(symbols: Symbols) -> _Point:
        return _Point(Symbol(symbols.t), [Symbol(s) for s in symbols.x], [Symbol(s) for s in symbols.u])

    def _compare_numbers(self, rows: _Rows, arguments: Sequence[Any], states: Sequence[Scalar]) -> None:
        """Raise TraceError if a method gives other results for numbers than its expressions have there.

        Such a method asks whether a value is a number (isinstance, try, is): its Python FMU and its native FMU differ.
        A point at which the method raises an error, or gives values that are not finite, decides nothing.
        """
        draw, symbols = random.Random(0), self.symbols
        parameters, inputs = scalars(self.kind), scalars(self.kind.Input)
        unknown = casadi.vertcat(symbols.t, *symbols.x, *symbols.u, *symbols.p)
        functions = {m: casadi.Function("f", [unknown], [casadi.vertcat(*known)]) for m, known in rows.known.items()}
        for _ in range(POINTS):
            p = [_near(s, draw) if isinstance(a, Symbol) else a for s, a in zip(parameters, arguments, strict=True)]
            at = _Point(draw.random(), [_near(s, draw) for s in states], [_near(s, draw) for s in inputs])
            try:
                numbers = self._evaluated(p, states, at)
            except TraceError:
                continue
            given = casadi.vertcat(at.t, *at.x, *at.u, *(0.0 if isinstance(v, Choice) else float(v) for v in p))
            for method, function in functions.items():
                found = function(given).full().ravel()
                for traced, value in zip(found, map(float, numbers.known[method]), strict=True):
                    largest = max(abs(traced), abs(value), SMALLEST)
                    if abs(traced - value) > SAME * largest:  # false for NaN
                        raise self._refuse(
                            method,
                            f"gives {value:.6g} for numbers, where its equations give {traced:.6g}. Take out what "
                            "treats numbers in another way, such as isinstance, try or is.",
                        )

    def _evaluated(self, arguments: Sequence[Any], states: Sequence[Scalar], at: _Point) -> _Rows:
        """The results of each method; states are in the order of the FMU."""
        kind = self.kind
        component = unchecked(kind, arguments)
        order = {scalar.name: i for i, scalar in enumerate(states)}
        declared = [scalar.name for scalar in scalars(kind.State)]
        x = kind.State(**unflatten(kind.State, (at.x[order[name]] for name in declared)))
        u = kind.Input(**unflatten(kind.Input, iter(at.u)))
        t = at.t

        def state(method: str, value: Any, needed: Callable[[Declaration], bool]) -> list[Any]:
            flat = self._record(method, kind.State, value, needed)
            by_name = dict(zip(declared, flat, strict=True))
            return [by_name[scalar.name] for scalar in states]

        rules = self._rules(self._call("rules", component.rules))
        notes = self._notes(self._call("notes", lambda: component.notes(x)))
        known = {
            "rules": [condition for _, condition in rules],
            "notes": [row for note in notes for row in (expression(note.value), expression(note.limit))],
        }
        known["initial"] = state("initial", self._call("initial", component.initial), lambda _: False)
        given: tuple[Any, ...] = (t,) if isinstance(component, Source) else (t, x, u)
        y = self._call("output", lambda: component.output(*given))
        known["output"] = self._record("output", kind.Output, y, lambda _: True)
        if isinstance(component, Controller):
            found = self._call("update", lambda: component.update(cast(float, t), x, u, y))
            known["update"] = state("update", found, lambda _: True)
        elif isinstance(component, Plant):
            found = self._call("derivative", lambda: component.derivative(*given)) if order else x
            known["derivative"] = state("derivative", found, lambda declaration: not declaration.discrete)
            found = self._call("update", lambda: component.update(*given))
            known["update"] = state("update", found, lambda declaration: declaration.discrete)
        texts = tuple(NoteText(note.name, note.limit_name, note.unit, note.text) for note in notes)
        return _Rows(tuple(text for text, _ in rules), texts, known)

    def _text(self, rows: Sequence[Any]) -> str:
        """The expressions as text, which is the same for equal expressions."""
        return casadi.Function("f", [casadi.vertcat(*self.symbols.all)], [casadi.vertcat(*rows)]).serialize()

    def at_start(self, rows: Sequence[Any]) -> Sequence[Any]:
        """``rows`` with the states replaced by their initial expressions."""
        if not rows or not self.symbols.x:
            return rows
        old, new = casadi.vertcat(*self.symbols.x), casadi.vertcat(*self.initial)
        return [casadi.substitute(row, old, new) for row in rows]

    def _call(self, method: str, call: Callable[[], Any]) -> Any:
        """Call one method; whatever it raises becomes a TraceError with file and line."""
        try:
            return call()
        except Exception as error:
            own = inspect.getsourcefile(self.kind) or ""
            at = place.of_error(error.__traceback__, own) or place.of_method(self.kind, method)
            text = str(error) if isinstance(error, TraceError) else f"{type(error).__name__}: {error}."
            raise TraceError(f"{at}: {self.kind.__name__}.{method}: {text}{_hint(error)} {ALLOWED}") from error

    def _refuse(self, method: str, text: str, at: str = "") -> TraceError:
        return TraceError(f"{at or place.of_method(self.kind, method)}: {self.kind.__name__}.{method}: {text}")

    def _rules(self, rules: Any) -> list[tuple[str, Any]]:
        """Text and condition of each rule."""
        if not isinstance(rules, tuple) or not all(isinstance(rule, Rule) for rule in cast("tuple[Any, ...]", rules)):
            raise self._refuse("rules", f"returns {rules!r}. Return a tuple of Rule(condition, text).")
        found: list[tuple[str, Any]] = []
        for rule in cast("tuple[Rule, ...]", rules):
            if not isinstance(cast(object, rule.condition), bool | Symbol) or not rule.text.strip():
                raise self._refuse("rules", f"{rule!r}: give a condition such as self.a < self.b, and a text.")
            found.append((rule.text, expression(rule.condition)))
        return found

    def _notes(self, notes: Any) -> tuple[Note, ...]:
        """The notes of the component. Raises TraceError for anything but notes, or for a note with an empty text."""
        if not isinstance(notes, tuple) or not all(isinstance(note, Note) for note in cast("tuple[Any, ...]", notes)):
            raise self._refuse("notes", f"returns {notes!r}. Return a tuple of Note(name, value, ...).")
        for note in cast("tuple[Note, ...]", notes):
            if not all(part.strip() for part in (note.name, note.limit_name, note.text)):
                raise self._refuse("notes", f"{note!r}: give name, limit_name and text.")
        return cast("tuple[Note, ...]", notes)

    def _record(
        self, method: str, record: type[Record], value: Any, needed: Callable[[Declaration], bool]
    ) -> list[Any]:
        """The members of a record that a method gave, arrays flattened."""
        name = record.__name__
        if not isinstance(value, record):
            members = ", ".join(f"{d.attribute}=..." for d in declarations(record))
            raise self._refuse(method, f"returns {value!r}. Return a {record.__qualname__}: self.{name}({members}).")
        made: _Made | None = getattr(value, "_made", None)
        at = made.at if made else ""
        missing = [d for d in declarations(record) if made and needed(d) and d.attribute not in made.given]
        if missing:
            names = " and ".join(d.attribute for d in missing)
            remedy = f"; a member that keeps its value is {missing[0].attribute}=x.{missing[0].attribute}"
            text = f"the {name} is given no {names}. Give every member{remedy if method == 'update' else ''}."
            raise self._refuse(method, text, at)
        found: list[Any] = []
        for declaration in declarations(record):
            item, length = getattr(value, declaration.attribute), declaration.length
            wanted = "a number" if length is None else f"a tuple of {length} numbers"
            elements: tuple[Any, ...] = cast("tuple[Any, ...]", item) if isinstance(item, tuple) else (item,)
            if isinstance(item, tuple) != (length is not None) or len(elements) != (length or 1):
                shown = f"{len(elements)} elements" if isinstance(item, tuple) else f"{item!r}"
                raise self._refuse(method, f"{name}.{declaration.attribute} is {shown}. Give {wanted}.", at)
            for element in elements:
                try:
                    found.append(expression(element))
                except TraceError as error:
                    text = f"{name}.{declaration.attribute}: {error} {ALLOWED}"
                    raise self._refuse(method, text, at) from error
        return found


class NoteText(NamedTuple):
    """The part of a note that is known before the run: its names, unit and text."""

    name: str
    limit_name: str
    unit: str
    text: str


class _Point(NamedTuple):
    """Time, states in the order of the FMU, and inputs: symbols or numbers."""

    t: Any
    x: Sequence[Any]
    u: Sequence[Any]


def _near(scalar: Scalar, draw: random.Random) -> Any:
    """A number near the start value and within the bounds; a start value that is no float itself."""
    if not isinstance(scalar.start, float):
        return scalar.start
    declaration = scalar.declaration
    size = 0.1 * abs(scalar.start) or declaration.nominal
    return min(max(scalar.start + size * draw.uniform(-1.0, 1.0), declaration.min), declaration.max)


class _Rows:
    """The texts of rules and notes, and for each method its expressions."""

    def __init__(self, rules: tuple[str, ...], notes: tuple[NoteText, ...], known: Mapping[str, list[Any]]) -> None:
        self.rules, self.notes, self.known = rules, notes, known


class _Made:
    """The members that a new record was given, and the line that made it."""

    def __init__(self, given: frozenset[str], at: str) -> None:
        self.given, self.at = given, at


@contextmanager
def _watched(*records: type[Record]) -> Generator[None]:
    """Note for each new record of these classes which members it is given, and where; the others keep start values."""
    plain = {record: cast(Any, record).__init__ for record in dict.fromkeys(records)}

    def watching(make: Callable[..., None]) -> Callable[..., None]:
        def init(self: Record, *values: Any, **given: Any) -> None:
            make(self, *values, **given)
            made = _Made(frozenset(given), place.of_caller(sys._getframe(1)))  # pyright: ignore[reportPrivateUsage]
            object.__setattr__(self, "_made", made)

        return init

    try:
        for record, make in plain.items():
            cast(Any, record).__init__ = watching(make)
        yield
    finally:
        for record, make in plain.items():
            cast(Any, record).__init__ = make


def _hint(error: Exception) -> str:
    """A remedy for errors whose own text gives none."""
    if isinstance(error, FrozenInstanceError):
        return " Nothing is changed in place: give new values to self.State(...)."
    if isinstance(error, AttributeError) and isinstance(error.obj, Record | Component):
        known = [item for item in vars(error.obj) if not item.startswith("_")]
        return suggest(error.name or "", known)
    if isinstance(error, TypeError) and "unhashable type: 'Symbol'" in str(error):
        return " A value is no key of a dict or set, and no argument of a cached function."
    if isinstance(error, NotImplementedError):
        return " Write this method."
    return ""


def _dense(matrix: Any) -> list[Any]:
    full = casadi.densify(matrix)
    return [full[i, j] for i in range(full.shape[0]) for j in range(full.shape[1])]
