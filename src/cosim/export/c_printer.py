"""Expressions of CasADi as C functions; equal functions are printed once."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, cast

from ..errors import TraceError
from ..model import Controller
from .symbol import casadi
from .variant import Symbols, Variant

FUNCTIONS = (
    "constants",
    "initial",
    "rules",
    "derivative",
    "jacobian",
    "output",
    "update",
    "sample",
    "directional",
    "notes",
)
"""The C functions of a variant, in the order of the core's ``Variant`` struct."""

_RESULTS = {
    "update": "",
    "jacobian": ", double *out, double *second",
    "sample": ", double *out, double *second",
    "directional": ", const double *direction, double *out",
}
_SIGNATURES = {
    name: ("double t, double *x, " if name == "update" else "double t, const double *x, ")
    + "const double *u, const double *p, const double *c"
    + _RESULTS.get(name, ", double *out")
    for name in FUNCTIONS
}


class Printer:
    """Prints functions as C; equal functions are printed once."""

    def __init__(self) -> None:
        self.known: dict[str, str] = {}
        self.n_constants = 0

    def text(self) -> str:
        return "\n".join(
            f"static void {name}({signature})\n{body}"
            for (signature, body), name in ((key.split("\0"), name) for key, name in self.known.items())
        )

    def variant(
        self, variant: Variant, symbols: Symbols, rules: Sequence[Any], notes: Sequence[Any]
    ) -> tuple[str, ...]:
        """The names of the functions of a variant, in the order of ``FUNCTIONS``."""
        sampled = issubclass(variant.kind, Controller)
        hot = {
            "derivative": variant.derivative,
            "jacobian": [*variant.jacobian, *variant.time_derivative],
            "output": variant.output,
            "update": variant.update,
            "sample": [*variant.output, *variant.next] if sampled else [],
            "directional": variant.directional,
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
        cold = {"constants": constants, "initial": variant.initial, "rules": rules, "notes": notes}
        for name, rows in cold.items():
            targets = [f"out[{i}]" for i in range(len(rows))]
            names[name] = self.function(name, symbols.all, symbols.text, rows, targets)
        return tuple(names[name] for name in FUNCTIONS)

    def with_rules(self, names: Sequence[str], symbols: Symbols, rules: Sequence[Any]) -> tuple[str, ...]:
        """The names of the functions of a variant (``names``), with its function of rules replaced."""
        targets = [f"out[{i}]" for i in range(len(rules))]
        own = self.function("rules", symbols.all, symbols.text, rules, targets)
        return tuple(own if kind == "rules" else name for kind, name in zip(FUNCTIONS, names, strict=True))

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
    "OP_TAN": "tan({0})",
    "OP_ASIN": "asin({0})",
    "OP_ACOS": "acos({0})",
    "OP_ATAN": "atan({0})",
    "OP_TANH": "tanh({0})",
    "OP_FLOOR": "floor({0})",
    "OP_FABS": "fabs({0})",
    "OP_SIGN": "(double)(({0} > 0.0) - ({0} < 0.0))",
    "OP_ASSIGN": "{0}",
}
_CALLS = frozenset(
    getattr(casadi, f"OP_{name}") for name in ("EXP", "LOG", "SIN", "COS", "TAN", "ASIN", "ACOS", "ATAN", "TANH")
)
"""Operations that call the C library, which takes longer than everything else in a statement."""
_BINARY = {
    "OP_ADD": "{0} + {1}",
    "OP_SUB": "{0} - {1}",
    "OP_MUL": "{0}*{1}",
    "OP_DIV": "{0}/{1}",
    "OP_POW": "pow({0}, {1})",
    "OP_CONSTPOW": "pow({0}, {1})",
    "OP_ATAN2": "atan2({0}, {1})",
    "OP_HYPOT": "hypot({0}, {1})",
    "OP_FMOD": "fmod({0}, {1})",
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
    """C statements that assign ``rows`` to ``targets``, without intermediate values that nothing uses."""
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
    """One statement.

    ``(c ? a : 0) + (!c ? b : 0)``, CasADi's form of a choice, is printed ``c ? a : b``; ``c ? (c ? a : 0) : 0`` is
    printed ``c ? a : 0``. A library function of a choice with a constant is called in the branch of the variable only.
    """
    if operation in _CALLS and (choice := _choice(arguments[0], lines)) is not None:
        sign, chosen = choice
        call = _FORMATS[operation][0]
        condition, yes, no = chosen[0], call.format(sign + chosen[1]), call.format(sign + chosen[2])
        return _Line(name, operation, chosen, False, f"({condition} ? {yes} : {no})")
    inner = lines.get(arguments[1]) if operation == casadi.OP_IF_ELSE_ZERO else None
    if inner is not None and inner.operation == operation and inner.arguments[0] == arguments[0]:
        arguments = inner.arguments
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


def _choice(name: str, lines: dict[str, _Line]) -> tuple[str, list[str]] | None:
    """Sign, and condition and both values, of a choice between a variable and a constant. None if it is not one."""
    line = lines.get(name)
    if line is None:
        return None
    if line.operation == casadi.OP_NEG and (choice := _choice(line.arguments[0], lines)) is not None:
        sign, chosen = choice
        return ("" if sign else "-"), chosen
    if line.operation == casadi.OP_IF_ELSE_ZERO:
        chosen = [*line.arguments, "0.0"]
    elif line.operation == casadi.OP_ADD and len(line.arguments) == 3:
        chosen = line.arguments
    else:
        return None
    constants = sum(value[0].isdigit() or value[0] == "(" for value in chosen[1:])
    return ("", chosen) if constants == 1 else None


def _number(value: float) -> str:
    text = repr(float(value))
    if text in ("inf", "-inf", "nan"):
        raise TraceError(f"the constant {text} appears in the equations. Keep every branch finite.")
    return f"({text})" if text.startswith("-") else text
