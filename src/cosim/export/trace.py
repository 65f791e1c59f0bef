"""From the equations of a component to C functions: run the methods on CasADi symbols, print what they did.

Every combination of ``bool`` and ``Choice`` parameters is traced on its own, so these cost nothing at run time;
equal functions are printed once. Subexpressions of parameters only are moved to a function of their own that runs
when parameters change.
"""

from __future__ import annotations

import importlib
import itertools
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

from ..errors import TraceError
from ..model import (
    Choice,
    Component,
    Controller,
    Record,
    Source,
    fill,
)
from .layout import Scalar, choice_number, ordered_states, scalars

casadi: Any = importlib.import_module("casadi")

MAX_VARIANTS = 256


class Symbol:
    """A CasADi scalar that can be computed with but has no value: what equations see while they are traced."""

    __slots__ = ("expression",)
    __hash__ = None  # type: ignore[assignment]

    def __init__(self, expression: Any) -> None:
        self.expression = expression

    def __bool__(self) -> bool:
        raise TraceError(
            "a condition on values is used as a Python truth value. Write where(condition, a, b) for if, "
            "both(a, b) for and, either(a, b) for or, minimum/maximum/clip for min/max."
        )

    def __float__(self) -> float:
        raise TraceError("a value is passed to float or to a function of math. Use the functions of cosim.model.")

    def __add__(self, other: object) -> Symbol:
        return Symbol(self.expression + expression(other))

    def __radd__(self, other: object) -> Symbol:
        return Symbol(expression(other) + self.expression)

    def __sub__(self, other: object) -> Symbol:
        return Symbol(self.expression - expression(other))

    def __rsub__(self, other: object) -> Symbol:
        return Symbol(expression(other) - self.expression)

    def __mul__(self, other: object) -> Symbol:
        return Symbol(self.expression * expression(other))

    def __rmul__(self, other: object) -> Symbol:
        return Symbol(expression(other) * self.expression)

    def __truediv__(self, other: object) -> Symbol:
        return Symbol(self.expression / expression(other))

    def __rtruediv__(self, other: object) -> Symbol:
        return Symbol(expression(other) / self.expression)

    def __pow__(self, other: object) -> Symbol:
        return Symbol(self.expression ** expression(other))

    def __rpow__(self, other: object) -> Symbol:
        return Symbol(expression(other) ** self.expression)

    def __neg__(self) -> Symbol:
        return Symbol(-self.expression)

    def __pos__(self) -> Symbol:
        return self

    def __abs__(self) -> Symbol:
        return Symbol(casadi.fabs(self.expression))

    def __lt__(self, other: object) -> Symbol:
        return Symbol(self.expression < expression(other))

    def __le__(self, other: object) -> Symbol:
        return Symbol(self.expression <= expression(other))

    def __gt__(self, other: object) -> Symbol:
        return Symbol(self.expression > expression(other))

    def __ge__(self, other: object) -> Symbol:
        return Symbol(self.expression >= expression(other))

    def __eq__(self, other: object) -> Symbol:  # type: ignore[override]
        return Symbol(self.expression == expression(other))

    def __ne__(self, other: object) -> Symbol:  # type: ignore[override]
        return Symbol(self.expression != expression(other))

    def __and__(self, other: object) -> Symbol:
        return Symbol(casadi.logic_and(self.expression, expression(other)))

    def __or__(self, other: object) -> Symbol:
        return Symbol(casadi.logic_or(self.expression, expression(other)))

    __rand__ = __and__
    __ror__ = __or__

    def where(self, one: object, other: object) -> Symbol:
        """``one`` where this condition holds, else ``other``."""
        return Symbol(casadi.if_else(self.expression, expression(one), expression(other)))

    def exp(self) -> Symbol:
        """e**x."""
        return Symbol(casadi.exp(self.expression))

    def log(self) -> Symbol:
        """Natural logarithm."""
        return Symbol(casadi.log(self.expression))

    def sqrt(self) -> Symbol:
        """Square root."""
        return Symbol(casadi.sqrt(self.expression))

    def sin(self) -> Symbol:
        """Sine."""
        return Symbol(casadi.sin(self.expression))

    def cos(self) -> Symbol:
        """Cosine."""
        return Symbol(casadi.cos(self.expression))

    def tanh(self) -> Symbol:
        """Hyperbolic tangent."""
        return Symbol(casadi.tanh(self.expression))

    def floor(self) -> Symbol:
        """Largest whole number not above x."""
        return Symbol(casadi.floor(self.expression))

    def sign(self) -> Symbol:
        """-1, 0 or 1."""
        return Symbol(casadi.sign(self.expression))


def expression(value: object) -> Any:
    """The CasADi expression of a symbol or a plain number."""
    if isinstance(value, Symbol):
        return value.expression
    if isinstance(value, bool | int | float):
        return casadi.SX(float(value))
    raise TraceError(f"equations gave {value!r} where a number is needed.")


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


FUNCTIONS = ("constants", "initial", "rules", "derivative", "jacobian", "output", "update", "sample", "partials")
"""The C functions of a variant, in the order of the core's ``Variant`` struct."""

_RESULTS = {
    "update": "",
    "jacobian": ", double *out, double *second",
    "sample": ", double *out, double *second",
}
_SIGNATURES = {
    name: ("double t, double *x, " if name == "update" else "double t, const double *x, ")
    + "const double *u, const double *p, const double *c"
    + _RESULTS.get(name, ", double *out")
    for name in FUNCTIONS
}


def _choices(scalar: Scalar) -> tuple[Any, ...]:
    if isinstance(scalar.start, bool):
        return (False, True)
    return tuple(cast("type[Choice]", type(scalar.start)))


class _Symbols:
    """The symbols t, x, u, p of one component and the C text of each."""

    def __init__(self, x: Sequence[Scalar], u: Sequence[Scalar], p: Sequence[Scalar]) -> None:
        self.t: Any = casadi.SX.sym("t")
        self.x = [casadi.SX.sym(f"x{i}") for i in range(len(x))]
        self.u = [casadi.SX.sym(f"u{i}") for i in range(len(u))]
        self.p = [casadi.SX.sym(f"p{i}") for i in range(len(p))]
        self.all = [self.t, *self.x, *self.u, *self.p]
        self.text = ["t"] + [
            f"{letter}[{i}]" for letter, group in (("x", x), ("u", u), ("p", p)) for i in range(len(group))
        ]


def trace(kind: type[Component]) -> Trace:
    """Trace every variant of a component. Raises TraceError naming component, method and remedy."""
    parameters, inputs, outputs = scalars(kind), scalars(kind.Input), scalars(kind.Output)
    states, n_continuous = ordered_states(kind)
    symbols = _Symbols(states, inputs, parameters)
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
    printer = _Printer()
    variants: list[tuple[str, ...]] = []
    rules: tuple[str, ...] = ()
    collected: list[_Variant] = []
    for combination in combinations:
        arguments: list[Any] = [Symbol(p) for p in symbols.p]
        for (index, _), value in zip(choices, combination, strict=True):
            arguments[index] = value
        variant = _Variant(kind, symbols, arguments, states, n_continuous)
        rules = variant.rule_texts
        collected.append(variant)
        variants.append(printer.variant(variant, symbols))
    choice_indices = frozenset(i for i, _ in choices) if len(set(variants)) > 1 else frozenset[int]()

    def union(pick: Callable[[_Variant], Sequence[Any]], letter: str, n: int) -> tuple[frozenset[int], ...]:
        return tuple(frozenset[int]().union(*(_depends(pick(v)[row], letter) for v in collected)) for row in range(n))

    n_y, n_c = len(outputs), n_continuous
    initial_parameters: dict[str, frozenset[int]] = {}
    initial_inputs: dict[str, frozenset[int]] = {}
    groups: list[tuple[str, Callable[[_Variant], Sequence[Any]], int]] = [
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


def _depends(expr: Any, letter: str) -> frozenset[int]:
    names = [cast(str, symbol.name()) for symbol in casadi.symvar(expr)]
    return frozenset(int(name[1:]) for name in names if name[0] == letter and name[1:].isdigit())


class _Variant:
    """The expressions of one combination of discrete choices."""

    def __init__(
        self,
        kind: type[Component],
        symbols: _Symbols,
        arguments: Sequence[Any],
        states: Sequence[Scalar],
        n_continuous: int,
    ) -> None:
        self.kind, self.symbols, self.n_continuous = kind, symbols, n_continuous
        component: Any = self._call("parameters", lambda: kind(**fill(kind, iter(arguments))))
        order = {scalar.name: i for i, scalar in enumerate(states)}
        declared = [scalar.name for scalar in scalars(kind.State)]
        x = kind.State(**fill(kind.State, (Symbol(symbols.x[order[name]]) for name in declared)))
        u = kind.Input(**fill(kind.Input, (Symbol(s) for s in symbols.u)))
        t = Symbol(symbols.t)

        def state(method: str, call: Callable[[], Any]) -> list[Any]:
            flat = self._record(method, kind.State, call)
            by_name = dict(zip(declared, flat, strict=True))
            return [by_name[scalar.name] for scalar in states]

        rules = self._call("rules", component.rules)
        self.rule_texts = tuple(cast(str, rule.text) for rule in rules)
        self.rules = [expression(rule.condition) for rule in rules]
        self.initial = state("initial", component.initial)
        self.derivative: list[Any] = []
        self.update: list[Any] = []
        self.next: list[Any] = []
        if isinstance(component, Source):
            self.output = self._record("output", kind.Output, lambda: component.output(cast(float, t)))
        else:
            y = self._call("output", lambda: component.output(t, x, u))
            self.output = self._record("output", kind.Output, lambda: y)
            if issubclass(kind, Controller):
                self.next = state("update", lambda: component.update(t, x, u, y))
            else:
                self.derivative = state("derivative", lambda: component.derivative(t, x, u))[:n_continuous]
                self.update = state("update", lambda: component.update(t, x, u))[n_continuous:]
        rows = casadi.vertcat(*self.derivative) if self.derivative else casadi.SX(0, 1)
        columns = casadi.vertcat(*symbols.x[:n_continuous]) if n_continuous else casadi.SX(0, 1)
        self.jacobian = _dense(casadi.jacobian(rows, columns))
        self.time_derivative = _dense(casadi.jacobian(rows, symbols.t))
        known = [*symbols.x[:n_continuous], *symbols.u]
        unknown = [*self.derivative, *self.output]
        self.partials = _dense(casadi.jacobian(casadi.vertcat(*unknown), casadi.vertcat(*known))) if known else []

    def at_start(self, rows: Sequence[Any]) -> Sequence[Any]:
        """``rows`` with the states replaced by their initial expressions."""
        if not rows or not self.symbols.x:
            return rows
        old, new = casadi.vertcat(*self.symbols.x), casadi.vertcat(*self.initial)
        return [casadi.substitute(row, old, new) for row in rows]

    def _call(self, method: str, call: Callable[[], Any]) -> Any:
        try:
            return call()
        except TraceError as error:
            raise TraceError(f"{self.kind.__name__}.{method}: {error}") from error
        except Exception as error:
            place = traceback.extract_tb(error.__traceback__)[-1]
            hint = " Use only arithmetic and the functions of cosim.model." if isinstance(error, TypeError) else ""
            raise TraceError(
                f"{self.kind.__name__}.{method}: {type(error).__name__}: {error} "
                f"({Path(place.filename).name}, line {place.lineno}).{hint}"
            ) from error

    def _record(self, method: str, record: type[Record], call: Callable[[], Any]) -> list[Any]:
        value = self._call(method, call)
        if not isinstance(value, record):
            raise TraceError(f"{self.kind.__name__}.{method}: returns {value!r}. Return a {record.__qualname__}.")
        return [self._call(method, lambda item=item: expression(item)) for item in value]


def _dense(matrix: Any) -> list[Any]:
    full = casadi.densify(matrix)
    return [full[i, j] for i in range(full.shape[0]) for j in range(full.shape[1])]


class _Printer:
    """Prints functions as C, equal ones once."""

    def __init__(self) -> None:
        self.known: dict[str, str] = {}
        self.n_constants = 0

    def text(self) -> str:
        return "\n".join(
            f"static void {name}({signature})\n{body}"
            for (signature, body), name in ((key.split("\0"), name) for key, name in self.known.items())
        )

    def variant(self, variant: _Variant, symbols: _Symbols) -> tuple[str, ...]:
        sampled = issubclass(variant.kind, Controller)
        hot = {
            "derivative": variant.derivative,
            "jacobian": [*variant.jacobian, *variant.time_derivative],
            "output": variant.output,
            "update": variant.update,
            "sample": [*variant.output, *variant.next] if sampled else [],
            "partials": variant.partials,
        }
        sizes = {name: len(rows) for name, rows in hot.items()}
        together = casadi.vertcat(*(row for rows in hot.values() for row in rows))
        constants: list[Any] = []
        constant_symbols: list[Any] = []
        if symbols.p and together.numel():
            together, constant_symbols, constants = casadi.extract_parametric(
                casadi.cse(together), casadi.vertcat(*symbols.p), {}
            )
        self.n_constants = max(self.n_constants, len(constants))
        everything = [*symbols.all, *constant_symbols]
        text = [*symbols.text, *(f"c[{i}]" for i in range(len(constant_symbols)))]
        names: dict[str, str] = {}
        start = 0
        for name, size in sizes.items():
            first = {"jacobian": len(variant.jacobian), "sample": len(variant.output)}.get(name, size)
            targets = [f"out[{i}]" if i < first else f"second[{i - first}]" for i in range(size)]
            if name == "update":
                targets = [f"x[{variant.n_continuous + i}]" for i in range(size)]
            rows = [together[start + i] for i in range(size)]
            names[name] = self.function(name, everything, text, rows, targets)
            start += size
        cold = {"constants": constants, "initial": variant.initial, "rules": variant.rules}
        for name, rows in cold.items():
            targets = [f"out[{i}]" for i in range(len(rows))]
            names[name] = self.function(name, symbols.all, symbols.text, rows, targets)
        return tuple(names[name] for name in FUNCTIONS)

    def function(
        self, name: str, symbols: Sequence[Any], text: Sequence[str], rows: Sequence[Any], targets: Sequence[str]
    ) -> str:
        arguments = [part.split()[-1].lstrip("*") for part in _SIGNATURES[name].split(",")]
        lines = ["".join(f"(void){argument}; " for argument in arguments).rstrip()]
        lines += _statements(symbols, text, rows, targets)
        body = "{\n" + "".join(f"    {line}\n" for line in lines) + "}\n"
        key = f"{_SIGNATURES[name]}\0{body}"
        if key not in self.known:
            count = sum(1 for other in self.known.values() if other.rsplit("_", 1)[0] == name)
            self.known[key] = f"{name}_{count}"
        return self.known[key]


_UNARY = {
    "OP_NEG": "-{0}",
    "OP_EXP": "exp({0})",
    "OP_LOG": "log({0})",
    "OP_SQRT": "sqrt({0})",
    "OP_SQ": "{0}*{0}",
    "OP_TWICE": "2.0*{0}",
    "OP_INV": "1.0/{0}",
    "OP_SIN": "sin({0})",
    "OP_COS": "cos({0})",
    "OP_TANH": "tanh({0})",
    "OP_FLOOR": "floor({0})",
    "OP_FABS": "fabs({0})",
    "OP_SIGN": "(double)(({0} > 0.0) - ({0} < 0.0))",
    "OP_ASSIGN": "{0}",
}
_BINARY = {
    "OP_ADD": "{0} + {1}",
    "OP_SUB": "{0} - {1}",
    "OP_MUL": "{0}*{1}",
    "OP_DIV": "{0}/{1}",
    "OP_POW": "pow({0}, {1})",
    "OP_CONSTPOW": "pow({0}, {1})",
    "OP_FMIN": "({0} < {1} ? {0} : {1})",
    "OP_FMAX": "({0} > {1} ? {0} : {1})",
    "OP_IF_ELSE_ZERO": "({0} ? {1} : 0.0)",
}
_LOGIC = {
    "OP_LT": "{0} < {1}",
    "OP_LE": "{0} <= {1}",
    "OP_EQ": "{0} == {1}",
    "OP_NE": "{0} != {1}",
    "OP_AND": "{0} && {1}",
    "OP_OR": "{0} || {1}",
    "OP_NOT": "!{0}",
}
_FORMATS: dict[int, tuple[str, bool]] = {
    **{getattr(casadi, name): (text, False) for name, text in (_UNARY | _BINARY).items()},
    **{getattr(casadi, name): (text, True) for name, text in _LOGIC.items()},
}


@dataclass
class _Line:
    name: str
    operation: int
    arguments: list[str]
    logical: bool
    text: str


def _statements(
    symbols: Sequence[Any], symbol_text: Sequence[str], rows: Sequence[Any], targets: Sequence[str]
) -> Iterator[str]:
    """C statements that assign ``rows`` to ``targets``, unused intermediate values left out."""
    if not rows:
        return
    function = casadi.Function("f", [casadi.vertcat(*symbols)], [casadi.cse(casadi.vertcat(*rows))])
    slots: dict[int, str] = {}
    lines: dict[str, _Line] = {}
    results: dict[int, str] = {}
    for k in range(function.n_instructions()):
        operation = function.instruction_id(k)
        source, target = function.instruction_input(k), function.instruction_output(k)
        if operation == casadi.OP_OUTPUT:
            results[target[1]] = slots[source[0]]
        elif operation == casadi.OP_INPUT:
            slots[target[0]] = cast(str, symbol_text[source[1]])
        elif operation == casadi.OP_CONST:
            slots[target[0]] = _number(function.instruction_constant(k))
        else:
            if operation not in _FORMATS:
                raise TraceError(f"the operation {k} of the trace (CasADi id {operation}) has no C form.")
            name = f"a{len(lines)}"
            arguments = [slots[i] for i in source]
            lines[name] = _line(name, operation, arguments, lines)
            slots[target[0]] = name
    used: set[str] = set()
    pending = [results[i] for i in results]
    while pending:
        name = pending.pop()
        if name in lines and name not in used:
            used.add(name)
            pending += lines[name].arguments
    for name, line in lines.items():
        if name in used:
            yield f"const {'int' if line.logical else 'double'} {name} = {line.text};"
    for i in range(len(targets)):
        yield f"const double r{i} = {results.get(i, '0.0')};"
    for i, target in enumerate(targets):
        yield f"{target} = r{i};"


def _line(name: str, operation: int, arguments: list[str], lines: dict[str, _Line]) -> _Line:
    """One statement; ``(c ? a : 0) + (!c ? b : 0)``, CasADi's form of a choice, is printed ``c ? a : b``."""
    if operation == casadi.OP_ADD and all(argument in lines for argument in arguments):
        one, other = (lines[argument] for argument in arguments)
        if one.operation == other.operation == casadi.OP_IF_ELSE_ZERO:
            for yes, no in ((one, other), (other, one)):
                negation = lines.get(no.arguments[0])
                if negation and negation.operation == casadi.OP_NOT and negation.arguments == yes.arguments[:1]:
                    chosen = [yes.arguments[0], yes.arguments[1], no.arguments[1]]
                    return _Line(name, operation, chosen, False, "({} ? {} : {})".format(*chosen))
    pattern, logical = _FORMATS[operation]
    return _Line(name, operation, arguments, logical, pattern.format(*arguments))


def _number(value: float) -> str:
    text = repr(float(value))
    if text in ("inf", "-inf", "nan"):
        raise TraceError(f"the constant {text} appears in the equations. Keep every branch finite.")
    return f"({text})" if text.startswith("-") else text
