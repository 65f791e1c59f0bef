"""Units as text: ``N.m.s/rad``, ``kg.m2``, ``N/(m/s)0.5`` resolved to SI base units.

Syntax (that of Modelica, with decimal exponents): ``.`` multiplies, one ``/`` divides by the
factor or parenthesis behind it, a number behind a symbol or parenthesis is its exponent.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from fractions import Fraction
from functools import cache

from .errors import DescriptionError, suggest

BASE_UNITS = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")
"""The base units of FMI 2.0, in the order of its BaseUnit element."""


@dataclass(frozen=True)
class Unit:
    """``value in base units = factor * value``, with one exponent for each of ``BASE_UNITS``."""

    factor: float
    exponents: tuple[Fraction, ...]

    def power(self, exponent: Fraction) -> Unit:
        return Unit(self.factor ** float(exponent), tuple(e * exponent for e in self.exponents))

    def times(self, other: Unit) -> Unit:
        exponents = tuple(a + b for a, b in zip(self.exponents, other.exponents, strict=True))
        return Unit(self.factor * other.factor, exponents)

    @property
    def integral(self) -> bool:
        """FMI 2.0 can state only integer exponents; a unit such as ``N/(m/s)0.5`` has no BaseUnit."""
        return all(e.denominator == 1 for e in self.exponents)


def _base(factor: float = 1.0, **exponents: int) -> Unit:
    return Unit(factor, tuple(Fraction(exponents.get(name, 0)) for name in BASE_UNITS))


_SYMBOLS: dict[str, Unit] = {
    "1": _base(),
    "kg": _base(kg=1),
    "g": _base(1e-3, kg=1),
    "m": _base(m=1),
    "cm": _base(1e-2, m=1),
    "mm": _base(1e-3, m=1),
    "um": _base(1e-6, m=1),
    "nm": _base(1e-9, m=1),
    "s": _base(s=1),
    "ms": _base(1e-3, s=1),
    "us": _base(1e-6, s=1),
    "min": _base(60.0, s=1),
    "h": _base(3600.0, s=1),
    "A": _base(A=1),
    "mA": _base(1e-3, A=1),
    "K": _base(K=1),
    "mol": _base(mol=1),
    "cd": _base(cd=1),
    "rad": _base(rad=1),
    "mrad": _base(1e-3, rad=1),
    "urad": _base(1e-6, rad=1),
    "deg": _base(math.pi / 180.0, rad=1),
    "rev": _base(2.0 * math.pi, rad=1),
    "Hz": _base(s=-1),
    "kHz": _base(1e3, s=-1),
    "rpm": _base(2.0 * math.pi / 60.0, rad=1, s=-1),
    "N": _base(kg=1, m=1, s=-2),
    "mN": _base(1e-3, kg=1, m=1, s=-2),
    "uN": _base(1e-6, kg=1, m=1, s=-2),
    "kN": _base(1e3, kg=1, m=1, s=-2),
    "Pa": _base(kg=1, m=-1, s=-2),
    "MPa": _base(1e6, kg=1, m=-1, s=-2),
    "J": _base(kg=1, m=2, s=-2),
    "W": _base(kg=1, m=2, s=-3),
    "V": _base(kg=1, m=2, s=-3, A=-1),
    "mV": _base(1e-3, kg=1, m=2, s=-3, A=-1),
    "Ohm": _base(kg=1, m=2, s=-3, A=-2),
    "%": _base(1e-2),
}

_TOKEN = re.compile(r"(?P<symbol>[A-Za-z%]+|1(?=[./)]|$))|(?P<number>-?\d+(\.\d+)?)|(?P<mark>[./()])")


@cache
def parse_unit(text: str) -> Unit:
    """The unit written as ``text``. Raises DescriptionError naming the unknown part."""
    tokens: list[str] = []
    position = 0
    while position < len(text):
        match = _TOKEN.match(text, position)
        if match is None:
            raise DescriptionError(f"unit '{text}': cannot read '{text[position:]}'. Write it like 'N.m.s/rad'.")
        tokens.append(match.group())
        position = match.end()

    def product(start: int) -> tuple[Unit, int]:
        unit, at = factor(start)
        while at < len(tokens) and tokens[at] in "./":
            right, after = factor(at + 1)
            unit = unit.times(right.power(Fraction(1 if tokens[at] == "." else -1)))
            at = after
        return unit, at

    def factor(at: int) -> tuple[Unit, int]:
        token = tokens[at] if at < len(tokens) else ""
        if token == "(":
            unit, at = product(at + 1)
            if at >= len(tokens) or tokens[at] != ")":
                raise DescriptionError(f"unit '{text}': a parenthesis is not closed.")
        elif token in _SYMBOLS:
            unit = _SYMBOLS[token]
        else:
            raise DescriptionError(f"unit '{text}': unknown symbol '{token}'.{suggest(token, _SYMBOLS)}")
        at += 1
        if at < len(tokens) and re.fullmatch(r"-?\d+(\.\d+)?", tokens[at]):
            unit = unit.power(Fraction(tokens[at]))
            at += 1
        return unit, at

    unit, end = product(0)
    if end != len(tokens):
        raise DescriptionError(f"unit '{text}': cannot read '{''.join(tokens[end:])}'.")
    return unit


def conversion(source: str, target: str) -> float:
    """Factor c with ``value in target = c * value in source``. Raises DescriptionError if they differ in kind.

    An angle counts as a number here (``rad`` may stand where ``1`` is meant), as in SI.
    """
    a, b = parse_unit(source), parse_unit(target)
    if a.exponents[:-1] != b.exponents[:-1]:
        raise DescriptionError(f"unit '{source}' cannot be converted to '{target}'.")
    return a.factor / b.factor


def same_unit(one: str, other: str) -> bool:
    """Whether two units are of one kind and one scale, so that values may be connected unchanged."""
    a, b = parse_unit(one), parse_unit(other)
    return a.exponents == b.exponents and math.isclose(a.factor, b.factor, rel_tol=1e-12)
