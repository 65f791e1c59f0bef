"""The equations of one combination of ``bool`` and ``Choice`` parameters as expressions of CasADi."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, cast

from ..errors import TraceError
from ..model import Component, Controller, Record, Source, fill
from .interface import Scalar, scalars
from .symbol import Symbol, casadi, expression


class Symbols:
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


def depends(expr: Any, letter: str) -> frozenset[int]:
    """Indices of the symbols named by ``letter`` (x, u or p) that an expression depends on."""
    names = [cast(str, symbol.name()) for symbol in casadi.symvar(expr)]
    return frozenset(int(name[1:]) for name in names if name[0] == letter and name[1:].isdigit())


class Variant:
    """The expressions of one combination of discrete choices."""

    def __init__(
        self,
        kind: type[Component],
        symbols: Symbols,
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
