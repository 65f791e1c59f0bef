"""Units as text, such as ``N.m.s/rad``, ``kg.m2`` or ``N/(m/s)0.5``, converted to SI base units.

The syntax is that of Modelica, with decimal exponents. ``.`` multiplies. ``/`` divides by the factor or parenthesis
after it. A number after a symbol or parenthesis is its exponent.

If a file defines a unit, ``resolve_unit`` takes this definition. The table of this module is used only for units that
no file defines.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cache

from .errors import DescriptionError, suggest

BASE_UNITS = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")
"""The base units of FMI 2.0, in the order of its BaseUnit element."""


@dataclass(frozen=True)
class Unit:
    """``value in base units = factor*value + offset``, with one exponent for each of ``BASE_UNITS``."""

    factor: float
    exponents: tuple[Fraction, ...]
    offset: float = 0.0
    cycles: Fraction = field(default=Fraction(0), compare=False)
    """Exponent of Hz in the text of the unit: a cycle is a turn of 2*pi rad, though its exponents are those of 1/s."""

    def __str__(self) -> str:
        """The unit in base units, such as ``3600 s``, ``9.80665 m/s2`` or ``K + 273.15``."""
        over = [_symbol(name, e) for name, e in zip(BASE_UNITS, self.exponents, strict=True) if e > 0]
        under = [_symbol(name, -e) for name, e in zip(BASE_UNITS, self.exponents, strict=True) if e < 0]
        base = ".".join(over) or "1"
        if under:
            base += f"/{under[0]}" if len(under) == 1 else f"/({'.'.join(under)})"
        scale = "" if self.factor == 1.0 else f"{self.factor:.12g} "
        shift = "" if self.offset == 0.0 else f" {'+' if self.offset > 0.0 else '-'} {abs(self.offset):.12g}"
        return f"{scale}{base}{shift}"

    def power(self, exponent: Fraction) -> Unit:
        """The unit to a power. The offset is dropped: ``degC`` in a power means a temperature difference."""
        exponents = tuple(e * exponent for e in self.exponents)
        return Unit(self.factor ** float(exponent), exponents, cycles=self.cycles * exponent)

    def times(self, other: Unit) -> Unit:
        """The product of two units. Offsets are dropped: ``degC`` in a product means a temperature difference."""
        exponents = tuple(a + b for a, b in zip(self.exponents, other.exponents, strict=True))
        return Unit(self.factor * other.factor, exponents, cycles=self.cycles + other.cycles)

    @property
    def difference(self) -> Unit:
        """The unit of a difference of two values: the same, without offset."""
        return replace(self, offset=0.0)

    @property
    def integral(self) -> bool:
        """Whether all exponents are integers. A BaseUnit of FMI 2.0 cannot state a unit such as ``N/(m/s)0.5``."""
        return all(e.denominator == 1 for e in self.exponents)

    def matches(self, other: Unit) -> bool:
        """Whether both units have equal exponents, factor and offset, so that values need no conversion."""
        return (
            self.exponents == other.exponents
            and math.isclose(self.factor, other.factor, rel_tol=1e-12)
            and math.isclose(self.offset, other.offset, rel_tol=1e-12)
        )

    def with_angles_of(self, other: Unit) -> Unit:
        """This unit, with angles counted as ``other`` of the same name counts them, if nothing else differs.

        For some files rad is a base unit, for others it is 1: rad/s is rad.s-1 in one file and s-1 in the other.
        """
        same = self.exponents[:-1] == other.exponents[:-1]
        return replace(self, exponents=other.exponents) if same else self

    def conversion(self, target: Unit) -> tuple[float, float] | None:
        """Factor and offset with ``value in target = factor*value + offset``; None for different quantities.

        An angle counts as a number, as in SI: ``rad`` converts to ``1``. But 1/s and 1/s2 do not convert to rad/s and
        rad/s2, nor V/Hz to V.s/rad, because they may count turns or radians.
        """
        if self.exponents[:-1] != target.exponents[:-1]:
            return None
        only_time = all(
            name == "rad" or (e < 0 if name == "s" else e == 0)
            for name, e in zip(BASE_UNITS, self.exponents, strict=True)
        )
        if self.exponents != target.exponents and (only_time or self.cycles or target.cycles):
            return None
        return self.factor / target.factor, (self.offset - target.offset) / target.factor


def _symbol(name: str, exponent: Fraction) -> str:
    return name if exponent == 1 else f"{name}{float(exponent):g}"


def _base(factor: float = 1.0, offset: float = 0.0, cycles: int = 0, **exponents: int) -> Unit:
    return Unit(factor, tuple(Fraction(exponents.get(name, 0)) for name in BASE_UNITS), offset, Fraction(cycles))


_WORDS = {
    word: symbol
    for symbol, words in {
        "m": "metre metres meter meters",
        "mm": "millimetre millimetres millimeter millimeters",
        "um": "micron microns micrometre micrometres micrometer micrometers",
        "s": "sec second seconds",
        "min": "minute minutes",
        "h": "hour hours",
        "kg": "kilogram kilograms",
        "N": "newton newtons",
        "A": "amp amps ampere amperes",
        "V": "volt volts",
        "W": "watt watts",
        "Pa": "pascal pascals",
        "K": "kelvin",
        "degC": "celsius",
        "deg": "degree degrees",
        "rad": "radian radians",
        "rev": "u turn turns revolution revolutions",
        "Hz": "hertz",
        "Ohm": "ohms",
        "1": "none dimensionless",
    }.items()
    for word in words.split()
}
"""Word -> the symbol that is meant, for the hint of a message."""
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
    "ns": _base(1e-9, s=1),
    "min": _base(60.0, s=1),
    "h": _base(3600.0, s=1),
    "A": _base(A=1),
    "mA": _base(1e-3, A=1),
    "K": _base(K=1),
    "degC": _base(1.0, 273.15, K=1),
    "degF": _base(5.0 / 9.0, 459.67 * 5.0 / 9.0, K=1),
    "l": _base(1e-3, m=3),
    "mol": _base(mol=1),
    "cd": _base(cd=1),
    "rad": _base(rad=1),
    "mrad": _base(1e-3, rad=1),
    "urad": _base(1e-6, rad=1),
    "deg": _base(math.pi / 180.0, rad=1),
    "rev": _base(2.0 * math.pi, rad=1),
    "Hz": _base(s=-1, cycles=1),
    "kHz": _base(1e3, s=-1, cycles=1),
    "rpm": _base(2.0 * math.pi / 60.0, rad=1, s=-1),
    "N": _base(kg=1, m=1, s=-2),
    "mN": _base(1e-3, kg=1, m=1, s=-2),
    "uN": _base(1e-6, kg=1, m=1, s=-2),
    "kN": _base(1e3, kg=1, m=1, s=-2),
    "Pa": _base(kg=1, m=-1, s=-2),
    "bar": _base(1e5, kg=1, m=-1, s=-2),
    "MPa": _base(1e6, kg=1, m=-1, s=-2),
    "J": _base(kg=1, m=2, s=-2),
    "W": _base(kg=1, m=2, s=-3),
    "V": _base(kg=1, m=2, s=-3, A=-1),
    "mV": _base(1e-3, kg=1, m=2, s=-3, A=-1),
    "Ohm": _base(kg=1, m=2, s=-3, A=-2),
    "%": _base(1e-2),
}

_SPELLINGS = str.maketrans(
    {"^": "", "²": "2", "³": "3", "µ": "u", "μ": "u", "Ω": "Ohm", "°": "deg", "·": ".", "⋅": "."}
)
"""Characters of other spellings of units, and what they are here."""

_TOKEN = re.compile(r"(?P<symbol>[A-Za-z%]+|1(?=[./)]|$))|(?P<number>-?\d+(\.\d+)?)|(?P<mark>[./()])")


@cache
def parse_unit(text: str) -> Unit:
    """The unit written as ``text``. Raises DescriptionError that names the unknown part."""
    tokens: list[str] = []
    position = 0
    while position < len(text):
        match = _TOKEN.match(text, position)
        if match is None:
            meant = _spelt(text) or "Write it like 'N.m.s/rad'."
            raise DescriptionError(f"unit '{text}': cannot read '{text[position:]}'. {meant}")
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
            raise DescriptionError(f"unit '{text}': unknown symbol '{token}'.{_meant(text, token)}")
        at += 1
        if at < len(tokens) and re.fullmatch(r"-?\d+(\.\d+)?", tokens[at]):
            unit = unit.power(Fraction(tokens[at]))
            at += 1
        return unit, at

    unit, end = product(0)
    if end != len(tokens):
        raise DescriptionError(f"unit '{text}': cannot read '{''.join(tokens[end:])}'.")
    return unit


def _spelt(text: str) -> str:
    """The question for a unit in another spelling, such as ``kg*m^2`` or ``µm``; "" if that is no unit either."""
    spelt = text.strip().translate(_SPELLINGS).replace("**", "").replace("*", ".").replace(" ", ".")
    if spelt == text:
        return ""
    try:
        parse_unit(spelt)
    except DescriptionError:
        return ""
    return f"Did you mean '{spelt}'?"


def _meant(text: str, token: str) -> str:
    """The question for an unknown symbol: a word, two symbols without a point as in ``Nm``, or a similar symbol."""
    if word := _WORDS.get(token.lower()):
        return f" Did you mean '{word}'?"
    for i in range(1, len(token)):
        if token[:i] in _SYMBOLS and token[i:] in _SYMBOLS:
            return f" Did you mean '{text.replace(token, f'{token[:i]}.{token[i:]}')}'?"
    return suggest(token, _SYMBOLS)


def resolve_unit(name: str, *definitions: Mapping[str, Unit]) -> Unit | None:
    """The unit called ``name``; None if it is unknown.

    The first of ``definitions`` that contains the name decides; the table of this module comes last. A name in square
    brackets, such as ``[mm]``, is the same unit as without brackets.
    """
    for defined in definitions:
        if name in defined:
            return defined[name]
    if name.startswith("[") and name.endswith("]"):
        return resolve_unit(name[1:-1], *definitions)
    try:
        return parse_unit(name)
    except DescriptionError:
        return None


def conversion(source: str, target: str) -> float:
    """The factor c with ``value in target = c * value in source``.

    Raises DescriptionError for units of different quantities, and for units that need an offset (degC and K).
    """
    found = parse_unit(source).conversion(parse_unit(target))
    if found is None:
        raise DescriptionError(f"unit '{source}' cannot be converted to '{target}'.")
    factor, offset = found
    if offset != 0.0:
        raise DescriptionError(f"unit '{source}' cannot be converted to '{target}' by a factor: they differ in zero.")
    return factor
