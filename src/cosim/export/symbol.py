"""What equations see while they are traced: scalars of CasADi that look like numbers without a value."""

from __future__ import annotations

import importlib
from typing import Any

from ..errors import TraceError

casadi: Any = importlib.import_module("casadi")


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
