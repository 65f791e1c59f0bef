"""Numbers with their partial derivatives. Equations evaluated with such numbers return exact Jacobians.

Forward differentiation (Griewank, Walther, Evaluating Derivatives, 2008, chapter 3). A comparison gives a ``bool`` of
the values, so equations take the branch they take with plain numbers.
"""

from __future__ import annotations

import math


class Dual:
    """A value and its slopes, the derivatives with respect to each of the chosen variables."""

    __slots__ = ("slopes", "value")
    __hash__ = None  # type: ignore[assignment]

    def __init__(self, value: float, slopes: tuple[float, ...]) -> None:
        self.value, self.slopes = value, slopes

    def scaled(self, value: float, factor: float) -> Dual:
        """The result of a function of this number alone: ``value``, and slopes by its derivative ``factor``."""
        return Dual(value, tuple([factor * slope for slope in self.slopes]))

    def mixed(self, value: float, own: float, other: Dual, factor: float) -> Dual:
        """The result of a function of this and another number: ``value``, and slopes by its two partial derivatives.

        ``own`` is the derivative with respect to this number, ``factor`` with respect to ``other``.
        """
        pairs = zip(self.slopes, other.slopes, strict=True)
        return Dual(value, tuple([own * a + factor * b for a, b in pairs]))

    def __add__(self, other: Dual | float) -> Dual:
        if isinstance(other, Dual):
            return self.mixed(self.value + other.value, 1.0, other, 1.0)
        return Dual(self.value + other, self.slopes)

    __radd__ = __add__

    def __sub__(self, other: Dual | float) -> Dual:
        if isinstance(other, Dual):
            return self.mixed(self.value - other.value, 1.0, other, -1.0)
        return Dual(self.value - other, self.slopes)

    def __rsub__(self, other: float) -> Dual:
        return self.scaled(other - self.value, -1.0)

    def __mul__(self, other: Dual | float) -> Dual:
        if isinstance(other, Dual):
            return self.mixed(self.value * other.value, other.value, other, self.value)
        return self.scaled(self.value * other, float(other))

    __rmul__ = __mul__

    def __truediv__(self, other: Dual | float) -> Dual:
        if isinstance(other, Dual):
            value = self.value / other.value
            return self.mixed(value, 1.0 / other.value, other, -value / other.value)
        return self.scaled(self.value / other, 1.0 / other)

    def __rtruediv__(self, other: float) -> Dual:
        value = other / self.value
        return self.scaled(value, -value / self.value)

    def __pow__(self, other: Dual | float) -> Dual:
        value = self.value ** (other.value if isinstance(other, Dual) else other)
        if isinstance(other, Dual):
            own = _ratio(other.value * value, self.value)
            return self.mixed(value, own, other, value * math.log(self.value) if value else 0.0)
        # the usual p*x**p/x would be 0/0 at x = 0
        slope = other * self.value ** (other - 1.0) if self.value or other >= 1.0 else _ratio(other, 0.0)
        return self.scaled(value, slope if other else 0.0)

    def __rpow__(self, other: float) -> Dual:
        value = other**self.value
        return self.scaled(value, value * math.log(other) if value else 0.0)

    def __mod__(self, other: Dual | float) -> Dual:
        return self.mod(other)

    def __rmod__(self, other: float) -> Dual:
        return self.rmod(other)

    def __neg__(self) -> Dual:
        return self.scaled(-self.value, -1.0)

    def __pos__(self) -> Dual:
        return self

    def __abs__(self) -> Dual:
        return self.scaled(abs(self.value), self.sign())

    def __lt__(self, other: Dual | float) -> bool:
        return self.value < plain(other)

    def __le__(self, other: Dual | float) -> bool:
        return self.value <= plain(other)

    def __gt__(self, other: Dual | float) -> bool:
        return self.value > plain(other)

    def __ge__(self, other: Dual | float) -> bool:
        return self.value >= plain(other)

    def __eq__(self, other: object) -> bool:
        return self.value == (other.value if isinstance(other, Dual) else other)

    # ``cosim.model`` calls these methods for its functions of the same names

    def exp(self) -> Dual:
        """e**x."""
        value = math.exp(self.value)
        return self.scaled(value, value)

    def log(self) -> Dual:
        """Natural logarithm."""
        return self.scaled(math.log(self.value), 1.0 / self.value)

    def sqrt(self) -> Dual:
        """Square root."""
        value = math.sqrt(self.value)
        return self.scaled(value, _ratio(0.5, value))

    def sin(self) -> Dual:
        """Sine."""
        return self.scaled(math.sin(self.value), math.cos(self.value))

    def cos(self) -> Dual:
        """Cosine."""
        return self.scaled(math.cos(self.value), -math.sin(self.value))

    def tan(self) -> Dual:
        """Tangent."""
        return self.scaled(math.tan(self.value), 1.0 / math.cos(self.value) ** 2)

    def asin(self) -> Dual:
        """Arc sine."""
        return self.scaled(math.asin(self.value), _ratio(1.0, math.sqrt(1.0 - self.value**2)))

    def acos(self) -> Dual:
        """Arc cosine."""
        return self.scaled(math.acos(self.value), _ratio(-1.0, math.sqrt(1.0 - self.value**2)))

    def atan(self) -> Dual:
        """Arc tangent."""
        return self.scaled(math.atan(self.value), 1.0 / (1.0 + self.value**2))

    def tanh(self) -> Dual:
        """Hyperbolic tangent."""
        value = math.tanh(self.value)
        return self.scaled(value, 1.0 - value * value)

    def floor(self) -> float:
        """Largest whole number not above x; its slopes are 0."""
        return float(math.floor(self.value))

    def sign(self) -> float:
        """-1, 0 or 1; its slopes are 0."""
        return float((self.value > 0.0) - (self.value < 0.0))

    def atan2(self, x: Dual | float) -> Dual:
        """Angle of the vector (x, self)."""
        return _atan2(self, x)

    def ratan2(self, y: float) -> Dual:
        """Angle of the vector (self, y)."""
        return _atan2(y, self)

    def hypot(self, other: Dual | float) -> Dual:
        """Length of the vector (self, other); its slopes are 0 at the origin."""
        value = math.hypot(self.value, plain(other))
        scale = value or 1.0
        if isinstance(other, Dual):
            return self.mixed(value, self.value / scale, other, other.value / scale)
        return self.scaled(value, self.value / scale)

    rhypot = hypot

    def mod(self, other: Dual | float) -> Dual:
        """Remainder of self/other with the sign of ``other``."""
        value = self.value % plain(other)
        if isinstance(other, Dual):
            return self.mixed(value, 1.0, other, (value - self.value) / other.value)
        return Dual(value, self.slopes)

    def rmod(self, other: float) -> Dual:
        """Remainder of other/self with the sign of ``self``."""
        value = other % self.value
        return self.scaled(value, (value - other) / self.value)


def plain(number: Dual | float) -> float:
    """The value alone."""
    return number.value if isinstance(number, Dual) else number


def _ratio(dividend: float, divisor: float) -> float:
    """A quotient as C gives it, infinite for a divisor of 0: no error in a branch that is not taken."""
    if divisor:
        return dividend / divisor
    return math.copysign(math.inf, dividend) if dividend else math.nan


def _atan2(y: Dual | float, x: Dual | float) -> Dual:
    a, b = plain(y), plain(x)
    value, square = (math.atan2(a, b), a * a + b * b) if a or b else (0.0, 0.0)
    by_y, by_x = (b / square, -a / square) if square else (1.0, 0.0)
    if isinstance(y, Dual):
        return y.mixed(value, by_y, x, by_x) if isinstance(x, Dual) else y.scaled(value, by_y)
    return x.scaled(value, by_x) if isinstance(x, Dual) else Dual(value, ())
