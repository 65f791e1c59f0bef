"""First values of inertia and friction from a log of position and force, and which of them the log excites.

Position, its two derivatives and the force pass the same filter, a local polynomial of third order without phase
shift, so they stay synchronous. In motion

    force = inertia*acceleration + F_C*sign(velocity) + F_v*velocity + offset

holds by least squares: once for both directions together, once with the Coulomb friction F_C and the viscous friction
F_v of each direction. The force less the inertia force, over the speed, is the friction curve of a direction. The
break-away force is the largest force between a standstill and the start of motion. The presliding stiffness is the
slope of friction over position where friction passes 0: there the bristles are bent and do not slip yet.

Source: Savitzky & Golay, Analytical Chemistry 36(8), 1964; Janot, Gautier & Brunot, Data set and reference models of
EMPS, 2019 (least squares over filtered signals); Armstrong-Helouvry, Dupont & Canudas de Wit, Automatica 30(7), 1994
(what friction is made of).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from ..errors import DescriptionError
from ..public import public_names
from ..record.read import read_record
from ..result.metrics import Array, window
from ..units import conversion, parse_unit, resolve_unit
from .fit_statistics import NORMAL, fast_noise, memory

__dir__ = public_names(globals())

ORDER = 3
"""Order of the local polynomial: the lowest one that can follow a changing acceleration."""
SHORTEST, LONGEST = 5, 101
"""Limits of the filter length in samples. The shortest has one more than the polynomial needs; a longer one than the
longest flattens reversals."""
QUIET = 0.02
"""The filter is long enough if the noise is at most this share (2 %) of the velocity and of the acceleration (rms)."""
MOVING = 0.02
"""Share of the largest speed above which the least squares treat the machine as sliding.

Below it the bristles bend, and friction is no function of the speed.
"""
BINS = 12
"""Number of points of the friction curve for each direction: enough to show its dip at low speed."""
LEAST = 5
"""Least number of samples of a point of the curve: a spread of fewer samples says little."""
PRESLIDING = 0.5
"""The slope is taken below this share of the sliding friction, where the bristles do not slip yet."""
SLOW = 0.1
"""A sampling time from which the times of a record are probably not in s: drives and machines are logged faster."""
LARGEST_CONDITION = 100.0
"""A value counts as not excited if similarity to other columns makes its deviation larger by more than this factor.

With such a factor, noise of 1 % of the force leaves nothing of the value.
"""


@dataclass(frozen=True)
class Value:
    """A first value."""

    name: str
    value: float
    """The value in ``unit``; NaN if the record does not excite it."""
    deviation: float
    """Standard deviation, or standard deviation over several events, in ``unit``."""
    unit: str
    excited: bool
    why: str
    """The part of the record that tells the value, or the excitation that is missing."""


@dataclass(frozen=True)
class FrictionCurve:
    """Friction over speed for one direction: means and spread of groups of samples."""

    velocity: Array
    """Velocity with sign, m/s or rad/s."""
    friction: Array
    """Force minus inertia*acceleration, with sign, in the unit of the force."""
    spread: Array
    """Standard deviation within the group."""
    count: Array


@dataclass(frozen=True)
class FrictionLook:
    """First values from a record."""

    values: tuple[Value, ...]
    positive: FrictionCurve
    negative: FrictionCurve
    unit: str
    """Unit of the force."""
    length: str
    """Unit of the position: m or rad."""
    filter_samples: int
    samples: int
    slow_share: float
    """Share of the samples in which the machine moves, but slower than a hundredth of its largest speed."""
    notes: tuple[str, ...] = ()
    """Units that nothing says, and what the signals are taken as."""

    def value(self, name: str) -> Value:
        """The value called ``name``."""
        return next(value for value in self.values if value.name == name)


def identify_friction(
    source: str | Path,
    *,
    position: str,
    force: str,
    factor: float = 1.0,
    force_unit: str | None = None,
    time: str | None = None,
    sampling_time: float | None = None,
    units: Mapping[str, str] | None = None,
    span: tuple[float, float] = (-math.inf, math.inf),
) -> FrictionLook:
    """First values from the record at ``source``::

        look = identify_friction("axis.csv", position="x", force="u", factor=35.15, force_unit="N")

    ``position`` and ``force`` name columns; the force is ``factor`` times its column, in ``force_unit`` (default: that
    of the record, else N). Positions with a unit of length are converted to m, angles to rad; without a unit they are
    in m. ``units`` gives units that the record does not state, that of its time too. ``span`` in s is the part of the
    record that is used. A record of uneven steps is taken at equal ones.

    Raises DescriptionError for a record that cannot be read, has gaps or no such columns, is too short, or in which
    nothing moves, and for a factor on a force in N or N.m, or a multiple of it, if ``force_unit`` does not say the
    unit after the factor.
    """
    record = read_record(source, time=time, sampling_time=sampling_time, columns=[position, force], units=units)
    part = window(record.time, *span)
    columns = {name: values[part] for name, values in record.columns.items()}
    whole, record = record, replace(record, time=record.time[part], columns=columns)
    uneven = whole.uneven() if record.uneven() else ""
    record = record.resampled() if uneven else record
    stated = record.units.get(position, "") or "m"
    length = "rad" if parse_unit(stated).conversion(parse_unit("rad")) else "m"
    x = record.column(position) * conversion(stated, length)
    told = record.units.get(force, "")
    if factor != 1.0 and force_unit is None and _is_force(told):
        raise DescriptionError(
            f"{source}: {force} is in {told}: say the unit after the factor, --unit N or force_unit='N'."
        )
    unit = force_unit or (told if factor == 1.0 else "") or "N"
    look = friction_from_signals(record.time, x, factor * record.column(force), unit=unit, length=length)
    taken = {position: length} if not record.units.get(position) else {}
    taken |= {force: unit} if not told and force_unit is None else {}
    notes = [
        f"nothing says the unit of {name}: taken as {each}. Say another one with --units {name}=UNIT or units={{...}}."
        for name, each in taken.items()
    ]
    if record.step >= SLOW:
        notes.append(
            f"the record has a sample every {record.step:.6g} s, too few for friction. If its times are not in s, say "
            "their unit: --units COLUMN=ms or units={...}."
        )
    if uneven:
        notes.append(f"{uneven} Taken at equal steps, on the lines between the samples.")
    return replace(look, notes=tuple(notes))


def _is_force(unit: str) -> bool:
    """Whether a unit is one of forces or torques."""
    meaning = resolve_unit(unit) if unit else None
    return meaning is not None and any(meaning.conversion(parse_unit(each)) for each in ("N", "N.m"))


def friction_from_signals(
    time: Array, position: Array, force: Array, *, unit: str = "N", length: str = "m"
) -> FrictionLook:
    """First values from signals with equal time steps, all of shape (samples,); ``time`` in s.

    ``unit`` is the unit of ``force``, ``length`` that of ``position`` (m or rad).

    Raises DescriptionError for a record that is too short or in which nothing moves.
    """
    if len(time) < 10 * SHORTEST:
        raise DescriptionError(f"{len(time)} samples are too few. Give at least {10 * SHORTEST}.")
    noise = fast_noise(position)
    if not float(np.ptp(position)) > 10.0 * noise or float(np.ptp(position)) == 0.0:
        raise DescriptionError(
            f"a record without excitation: the position moves by {float(np.ptp(position)):.3g} {length}, its noise is "
            f"{noise:.3g} {length}. Take one in which the machine moves."
        )
    if float(np.ptp(force)) == 0.0:
        raise DescriptionError(
            f"the force is {float(force[0]):g} {unit} in all samples, which tells nothing. Take one that was "
            "logged, and a factor other than 0."
        )
    return _Look(time, position, force, noise=noise, unit=unit, length=length).look()


def summary(look: FrictionLook) -> dict[str, Any]:
    """The first values and curves as values for JSON."""
    curves = {"positive": look.positive, "negative": look.negative}
    return {
        "values": {value.name: {k: v for k, v in vars(value).items() if k != "name"} for value in look.values},
        "curve": {name: {k: v.tolist() for k, v in vars(curve).items()} for name, curve in curves.items()},
        "filter_samples": look.filter_samples,
        "samples": look.samples,
        "slow_share": look.slow_share,
    }


def plot_friction(look: FrictionLook, path: Path, *, title: str = "") -> None:
    """Draw friction over speed with its spread, and the friction law of each direction.

    Raises DescriptionError for an unknown ending, FileError if the file cannot be written.
    """
    from ..result.plots import COLOURS, save, typeset

    def draw(figure: Any) -> None:
        axes = figure.add_subplot()
        for curve, name, colour in ((look.positive, "positive", COLOURS[0]), (look.negative, "negative", COLOURS[1])):
            values = [look.value(f"Coulomb friction {name}"), look.value(f"viscous friction {name}")]
            axes.errorbar(
                1e3 * curve.velocity, curve.friction, yerr=curve.spread, fmt="o", ms=3, color=colour, label=name
            )
            if all(value.excited for value in values):
                v = np.linspace(0.0, float(curve.velocity[-1]), 50)
                sign = 1.0 if name == "positive" else -1.0
                axes.plot(1e3 * v, sign * values[0].value + values[1].value * v, "--", color=colour, linewidth=1.0)
        axes.axhline(0.0, color="0.6", linewidth=0.6)
        axes.set_xlabel(f"Velocity / {'mm/s' if look.length == 'm' else 'mrad/s'}")
        axes.set_ylabel(f"Friction / {typeset(look.unit)}")
        axes.set_title(title)
        axes.legend()

    save(path, draw, (6.4, 4.0))


class _Look:
    """The filtered signals of a record, and the values that they tell."""

    def __init__(self, time: Array, position: Array, force: Array, *, noise: float, unit: str, length: str) -> None:
        self.step = float(np.median(np.diff(time)))
        self.unit, self.length = unit, length
        self.noise = noise
        self.size = self._size(position)
        self.x, self.v, self.a = (_smooth(position, self.size, order, self.step) for order in (0, 1, 2))
        self.u = _smooth(force, self.size, 0, self.step)
        self.fastest = float(np.max(np.abs(self.v)))
        self.still = max(0.002 * self.fastest, 3.0 * noise * _gain(self.size, 1, self.step))
        """Speed below which the machine counts as resting."""

    def _size(self, position: Array) -> int:
        """Length of the filter in samples: as short as the noise allows."""
        for size in range(SHORTEST, min(LONGEST, len(position) // 5) + 1, 2):
            quiet = [
                self.noise * _gain(size, order, self.step)
                < QUIET * float(np.std(_smooth(position, size, order, self.step)))
                for order in (1, 2)
            ]
            if all(quiet):
                return size
        return min(LONGEST, len(position) // 5) | 1

    def look(self) -> FrictionLook:
        sliding = np.abs(self.v) > max(MOVING * self.fastest, self.still)
        inertia, both, sided = self._least_squares(sliding)
        mass = inertia.value if inertia.excited else 0.0
        friction = self.u - mass * self.a
        curves = [self._curve(friction, sign) for sign in (1.0, -1.0)]
        coulomb = both[0].value if both[0].excited else math.nan
        slow = (np.abs(self.v) > self.still) & (np.abs(self.v) < 0.01 * self.fastest)
        values = (inertia, *both, *sided, self._break_away(friction), self._stiffness(friction, coulomb))
        return FrictionLook(
            values, curves[0], curves[1], self.unit, self.length, self.size, len(self.x), float(np.mean(slow))
        )

    # sliding

    def _least_squares(self, sliding: np.ndarray[Any, np.dtype[np.bool_]]) -> tuple[Value, list[Value], list[Value]]:
        a, v, u = self.a[sliding], self.v[sliding], self.u[sliding]
        sign = np.sign(v)
        one, per = self.unit, f"{self.unit}.s/{self.length}"
        mass = ("inertia", a, self._mass_unit())
        symmetric = [
            mass,
            ("Coulomb friction", sign, one),
            ("viscous friction", v, per),
            ("offset", np.ones_like(v), one),
        ]
        found = self._solved(symmetric, u)
        up, down = v > 0.0, v < 0.0
        directions = [mass]
        for name, part in (("positive", up), ("negative", down)):
            directions += [(f"Coulomb friction {name}", sign * part, one), (f"viscous friction {name}", v * part, per)]
        sided = self._solved(directions, u)[1:]
        return found[0], found[1:], sided

    def _mass_unit(self) -> str:
        known = {("N", "m"): "kg", ("N.m", "rad"): "kg.m2"}
        return known.get((self.unit, self.length), f"{self.unit}.s2/{self.length}")

    def _solved(self, columns: Sequence[tuple[str, Array, str]], u: Array) -> list[Value]:
        """Values by least squares. A column that is nearly a sum of other columns counts as not excited."""
        A = np.column_stack([values for _, values, _ in columns])
        size = np.linalg.norm(A, axis=0)
        empty = size == 0.0
        scaled = A / np.where(empty, 1.0, size)
        if len(u) <= 2 * len(columns):
            why = f"only {len(u)} samples in which the machine slides"
            return [_unexcited(name, unit, why) for name, _, unit in columns]
        solution = np.linalg.lstsq(scaled, u, rcond=None)[0]
        off = u - scaled @ solution
        inverse = np.linalg.pinv(scaled.T @ scaled)
        # Neighbouring residuals are correlated, at least by the filter: this number of samples counts as one.
        together = 1 + 2 * max(memory(off), self.size)
        variance = float(off @ off) / max(len(u) - len(columns), 1) * together
        found: list[Value] = []
        for i, (name, _, unit) in enumerate(columns):
            inflation = math.sqrt(max(float(inverse[i, i]), 0.0))
            deviation = math.sqrt(variance) * inflation
            value = float(solution[i])
            scale = 1.0 if empty[i] else float(size[i])
            excited = not empty[i] and inflation < LARGEST_CONDITION
            why = f"{len(u)} samples in motion"
            if empty[i]:
                why = "no motion in this direction"
            elif not excited:
                why = "the motion does not separate it from the others"
            elif name == "inertia" and value < -NORMAL * deviation:
                excited, why = False, "it comes out negative: a positive force must push towards positive position"
            elif name == "inertia" and abs(value) < NORMAL * deviation:
                excited, why = False, "accelerations are too small beside what else is in the force"
            elif abs(value) < NORMAL * deviation:
                why += ", not different from 0"
            found.append(Value(name, value / scale if excited else math.nan, deviation / scale, unit, excited, why))
        return found

    def _curve(self, friction: Array, sign: float) -> FrictionCurve:
        """Groups of equally many samples of one direction, from slow to fast."""
        chosen = np.flatnonzero(sign * self.v > self.still)
        order = chosen[np.argsort(np.abs(self.v[chosen]), kind="stable")]
        groups = [group for group in np.array_split(order, BINS) if len(group) >= LEAST]
        return FrictionCurve(
            np.array([float(np.mean(self.v[g])) for g in groups]),
            np.array([float(np.mean(friction[g])) for g in groups]),
            np.array([float(np.std(friction[g])) for g in groups]),
            np.array([len(g) for g in groups], dtype=np.float64),
        )

    # rest and reversal

    def _break_away(self, friction: Array) -> Value:
        """Break-away force: the largest force after a rest, before the machine slides."""
        resting = np.abs(self.v) <= self.still
        peaks: list[float] = []
        begins = np.flatnonzero(~resting[1:] & resting[:-1]) + 1
        for begin in begins:
            last = begin - 1
            first = last
            while first > 0 and resting[first - 1]:
                first -= 1
            slides = np.abs(self.v[begin : begin + 4 * self.size]) > self.still
            if last - first + 1 >= self.size and np.all(slides):
                peaks.append(float(np.max(np.abs(friction[max(first, begin - self.size) : begin + self.size]))))
        if not peaks:
            return _unexcited("break-away friction", self.unit, "the machine never starts from rest")
        spread = float(np.std(peaks)) if len(peaks) > 1 else math.nan
        return Value(
            "break-away friction", float(np.mean(peaks)), spread, self.unit, True, f"{len(peaks)} starts from rest"
        )

    def _stiffness(self, friction: Array, coulomb: float) -> Value:
        """Presliding stiffness: slope of friction over position where friction passes 0, as in Dahl's law."""
        per = f"{self.unit}/{self.length}"
        if not math.isfinite(coulomb) or coulomb <= 0.0:
            return _unexcited("presliding stiffness", per, "the sliding friction is not known")
        inside = np.abs(friction) < PRESLIDING * coulomb
        edges = np.flatnonzero(np.diff(np.concatenate([[0], inside.astype(np.int8), [0]])))
        slopes: list[float] = []
        passes = 0
        for begin, end in edges.reshape(-1, 2).tolist():
            x, f = self.x[begin:end], friction[begin:end]
            if float(np.ptp(f)) < PRESLIDING * coulomb:
                continue
            passes += 1
            if end - begin >= 2 * self.size and float(np.ptp(x)) > 8.0 * self.noise:
                slopes.append(float(np.polyfit(x, f, 1)[0]))
        if len(slopes) < 2:
            why = f"in {len(slopes)} of {passes} passes through 0 friction changes slowly enough for the sampling"
            return _unexcited("presliding stiffness", per, why)
        why = f"{len(slopes)} of {passes} passes through 0"
        return Value("presliding stiffness", float(np.median(slopes)), float(np.std(slopes)), per, True, why)


def _unexcited(name: str, unit: str, why: str) -> Value:
    """A value that the record does not tell."""
    return Value(name, math.nan, math.nan, unit, False, why)


def _filter(size: int, order: int, step: float) -> Array:
    from scipy import signal as _signal

    return cast(Array, cast(Any, _signal).savgol_coeffs(size, ORDER, deriv=order, delta=step))


def _gain(size: int, order: int, step: float) -> float:
    """Standard deviation of the filtered signal for white noise of 1."""
    return float(np.linalg.norm(_filter(size, order, step)))


def _smooth(signal: Array, size: int, order: int, step: float) -> Array:
    from scipy import signal as _signal

    return cast(Array, cast(Any, _signal).savgol_filter(signal, size, ORDER, deriv=order, delta=step))
