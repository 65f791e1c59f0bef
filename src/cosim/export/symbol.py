"""Symbols that the equations get while they are traced: CasADi scalars that act like numbers but have no value."""

from __future__ import annotations

import importlib
import math
from typing import Any

from ..errors import TraceError

casadi: Any = importlib.import_module("casadi")


class Symbol:
    """A CasADi scalar for tracing: equations can compute with it, but it has no value and no truth."""

    __slots__ = ("expression",)
    __hash__ = None  # type: ignore[assignment]

    def __init__(self, expression: Any) -> None:
        self.expression = expression

    def __bool__(self) -> bool:
        raise TraceError(
            "a condition on values is used as a Python truth value. Write where(condition, a, b) for if, "
            "both(a, b) for and, either(a, b) for or, minimum/maximum/clip for min/max."
        )

    def _refuse(self, *_: object) -> Any:
        raise TraceError(
            "a value is used where Python needs a number that is known now (float, int, round, an index, text, or a "
            "function of math)."
        )

    __float__ = __int__ = __index__ = __complex__ = __round__ = __trunc__ = __ceil__ = __len__ = __iter__ = _refuse
    __contains__ = __getitem__ = __format__ = _refuse

    def __floor__(self) -> Any:
        raise TraceError("math.floor is used on a value. Write floor(x).")

    def __floordiv__(self, _: object) -> Any:
        raise TraceError("// is used on a value. Write floor(x/y), or mod(x, y) for the remainder.")

    __rfloordiv__ = __divmod__ = __rdivmod__ = __floordiv__

    def __xor__(self, _: object) -> Any:
        raise TraceError("^ is used on a value. Write x**y for a power, a != b for one of two conditions.")

    __rxor__ = __xor__

    def __invert__(self) -> Any:
        raise TraceError("~ is used on a value. Write where(condition, 0.0, 1.0) for not.")

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

    def __mod__(self, other: object) -> Symbol:
        return self.mod(other)

    def __rmod__(self, other: object) -> Symbol:
        return self.rmod(other)

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

    def tan(self) -> Symbol:
        """Tangent."""
        return Symbol(casadi.tan(self.expression))

    def asin(self) -> Symbol:
        """Arc sine."""
        return Symbol(casadi.asin(self.expression))

    def acos(self) -> Symbol:
        """Arc cosine."""
        return Symbol(casadi.acos(self.expression))

    def atan(self) -> Symbol:
        """Arc tangent."""
        return Symbol(casadi.atan(self.expression))

    def atan2(self, x: object) -> Symbol:
        """Angle of the vector (x, self)."""
        return Symbol(_atan2(self.expression, expression(x)))

    def ratan2(self, y: object) -> Symbol:
        """Angle of the vector (self, y)."""
        return Symbol(_atan2(expression(y), self.expression))

    def hypot(self, other: object) -> Symbol:
        """Length of the vector (self, other)."""
        return Symbol(_hypot(self.expression, expression(other)))

    def rhypot(self, other: object) -> Symbol:
        """Length of the vector (other, self)."""
        return Symbol(_hypot(expression(other), self.expression))

    def mod(self, other: object) -> Symbol:
        """Remainder of self/other with the sign of ``other``."""
        return Symbol(_mod(self.expression, expression(other)))

    def rmod(self, other: object) -> Symbol:
        """Remainder of other/self with the sign of ``self``."""
        return Symbol(_mod(expression(other), self.expression))

    def tanh(self) -> Symbol:
        """Hyperbolic tangent."""
        return Symbol(casadi.tanh(self.expression))

    def floor(self) -> Symbol:
        """Largest whole number not above x."""
        return Symbol(casadi.floor(self.expression))

    def sign(self) -> Symbol:
        """-1, 0 or 1."""
        return Symbol(casadi.sign(self.expression))


def _away_from_zero(one: Any, other: Any) -> tuple[Any, Any]:
    """The condition that both are 0, and ``other`` with 1 there: the formulas of the derivatives would give 0/0."""
    zero = casadi.logic_and(one == 0, other == 0)
    return zero, casadi.if_else(zero, 1.0, other)


def _atan2(y: Any, x: Any) -> Any:
    return casadi.atan2(y, _away_from_zero(y, x)[1])


def _hypot(x: Any, y: Any) -> Any:
    zero, length = _away_from_zero(x, y)
    return casadi.if_else(zero, 0.0, casadi.hypot(x, length))


def _mod(x: Any, y: Any) -> Any:
    remainder = casadi.fmod(x, y)
    other_side = casadi.logic_and(remainder != 0, (remainder < 0) != (y < 0))
    return casadi.if_else(other_side, remainder + y, remainder)


def expression(value: object) -> Any:
    """The CasADi expression of a symbol or a plain number. Raises TraceError for anything else, and for NaN."""
    if isinstance(value, Symbol):
        return value.expression
    if isinstance(value, bool | int | float):
        if not math.isfinite(value):
            raise TraceError(f"the constant {float(value)} appears in the equations. Keep every branch finite.")
        return casadi.SX(float(value))
    raise TraceError(f"equations gave {value!r} where a number is needed.")
