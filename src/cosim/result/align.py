"""Brings two recordings to common units and common times: conversion of units, delay, resampling."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import DescriptionError, listed, suggest
from ..record.read import Record
from ..record.resample import usual_step
from ..units import parse_unit
from .metrics import Array, window
from .summary import Recorded

LEAST_OVERLAP = 0.5
"""Smallest overlap of both recordings after a delay, as a fraction of the shorter one. Less overlap says little."""
MOST_POINTS = 2**19
"""Largest number of points of the grids for the search of a delay. More points take seconds for each signal."""
MOST_SIGNALS = 8
"""Largest number of signals for the search of a delay: the first that vary. Each takes a fraction of a second."""
STILL = 1e-3
"""A part of a signal says nothing about the delay if its variance is below this fraction of the whole variance."""
EQUAL = 1e-9
"""Correlations that differ by less count as equal. Rounding causes differences of about 1e-12."""
SAME = 1e-6
"""Times that differ by less than this fraction of a step count as equal. Files round times to fewer digits."""


@dataclass(frozen=True)
class Side:
    """One of two recordings that are compared."""

    label: str
    time: Array
    values: Mapping[str, Array]
    units: Mapping[str, str]
    """Unit of each signal by name; "" if the recording does not state it."""
    metadata: Mapping[str, Any] = field(default_factory=dict[str, Any])

    @property
    def step(self) -> float:
        """The usual step of time in s."""
        return usual_step(self.time)

    def named(self, name: str) -> Array:
        """The values of a signal. Raises DescriptionError if there is no such signal."""
        if name not in self.values:
            raise DescriptionError(f"{self.label}: has no '{name}'.{suggest(name, self.values)}")
        return self.values[name]


def side_of(source: Recorded | Record, label: str) -> Side:
    """A result or a record as a Side. Raises DescriptionError if it has less than two samples."""
    if source.time.size < 2:
        raise DescriptionError(f"{label}: {source.time.size} samples: give a recording with at least 2.")
    if isinstance(source, Record):
        return Side(label, source.time, dict(source.columns), dict(source.units), source.metadata)
    values = {name: source[name] for name in source.names}
    return Side(label, source.time, values, {name: source.unit(name) for name in values}, source.metadata)


@dataclass(frozen=True)
class Pairs:
    """The paired signals of two sides. The values of ``b`` are converted to the units of ``a``."""

    names: tuple[tuple[str, str], ...]
    units: tuple[str, ...]
    a: Side
    b: Side
    """Sides with the paired signals only, both under the names of ``a``."""
    notes: tuple[str, ...]


def pair(a: Side, b: Side, signals: Mapping[str, str] | Sequence[str] | None) -> Pairs:
    """Pair the signals ``{name in a: name in b}``, or names that both sides have; None for all names that both have.

    Raises DescriptionError with all missing names and all units that do not convert.
    """
    if signals is None:
        names = [(name, name) for name in common_names(a, b)]
        if not names:
            known = [listed(list(side.values), 5) for side in (a, b)]
            raise DescriptionError(
                f"no signal of {a.label} ({known[0]}) has the name of one of {b.label} ({known[1]}): "
                "say which belong together, as NAME=OTHER, with --signals or signals = {NAME: OTHER}."
            )
    else:
        names = list(signals.items()) if isinstance(signals, Mapping) else [(name, name) for name in signals]
    problems: list[str] = []
    notes: list[str] = []
    of_a: dict[str, Array] = {}
    of_b: dict[str, Array] = {}
    units: list[str] = []
    for one, other in names:
        try:
            values, converted = a.named(one), b.named(other)
            unit, factor, offset = _conversion(a, b, (one, other), notes)
        except DescriptionError as error:
            problems += error.problems
            continue
        units.append(unit)
        of_a[one] = values
        of_b[one] = converted if (factor, offset) == (1.0, 0.0) else factor * converted + offset
    if problems:
        raise DescriptionError(problems)
    shown = dict(zip(of_a, units, strict=True))
    left, right = replace(a, values=of_a, units=shown), replace(b, values=of_b, units=shown)
    return Pairs(tuple(names), tuple(units), left, right, tuple(notes))


def common_names(a: Side, b: Side) -> list[str]:
    """The names that both sides have."""
    return [name for name in a.values if name in b.values]


def _conversion(a: Side, b: Side, names: tuple[str, str], notes: list[str]) -> tuple[str, float, float]:
    """The unit of a pair, and factor and offset from the unit of ``b``. Raises DescriptionError if there is none."""
    # FMUs state no unit in two cases: the variable has no unit, or its unit is not known.
    one, other = (
        "" if (unit := side.units.get(name, "")) == "1" else unit for side, name in zip((a, b), names, strict=True)
    )
    if not one or not other:
        if one or other:
            silent = f"{b.label}: {names[1]}" if one else f"{a.label}: {names[0]}"
            notes.append(f"{silent} says no unit: taken as {one or other}.")
        return one or other or "1", 1.0, 0.0
    if one == other:
        return one, 1.0, 0.0
    where = f"{a.label}: {names[0]} in {one} and {b.label}: {names[1]} in {other}"
    try:
        found = parse_unit(other).conversion(parse_unit(one))
    except DescriptionError as error:
        raise DescriptionError(f"{where}: {error}") from None
    if found is None:
        raise DescriptionError(f"{where} are of different kinds. Compare signals of one kind, or say the right unit.")
    notes.append(f"{b.label}: {names[1]} is converted from {other} to {one}.")
    return one, *found


# Delay.


def estimate_delay(pairs: Pairs, *, everywhere: bool = False) -> float:
    """The delay in s by which ``b`` lags behind ``a``. At this delay the correlation is largest.

    A gain and an offset do not change the correlation. The search covers delays up to a quarter of the common time.
    With ``everywhere``, it covers all delays that leave an overlap of half of the shorter side. All pairs that vary
    have the same weight, but only the first ``MOST_SIGNALS`` are used. The search is on a grid with the coarser step of
    both sides; Gauss-Newton steps then refine the delay between the grid points. NaN if no signal varies on both sides,
    or if their times do not overlap.
    """
    a, b = pairs.a, pairs.b
    lengths = [float(side.time[-1] - side.time[0]) for side in (a, b)]
    step = max(a.step, b.step, sum(lengths) / MOST_POINTS)
    start = float(b.time[0] - a.time[0])
    grid_a, grid_b = _grid(a, step), _grid(b, step)
    # If sample i of a meets sample i + lag of b, then b lags by lag*step + start.
    lags: NDArray[np.intp] = np.arange(1 - grid_a.size, grid_b.size, dtype=np.intp)
    shared = np.minimum(grid_a.size, grid_b.size - lags) - np.maximum(0, -lags)
    allowed = shared >= max(2.0, LEAST_OVERLAP * min(lengths) / step)
    if not everywhere:
        common = min(float(a.time[-1]), float(b.time[-1])) - max(float(a.time[0]), float(b.time[0]))
        allowed &= np.abs(lags * step + start) <= 0.25 * common
    costs: list[Array] = []
    for name in a.values:
        if len(costs) == MOST_SIGNALS:
            break
        one: Array = np.interp(grid_a, a.time, a.values[name])
        other: Array = np.interp(grid_b, b.time, b.values[name])
        if np.all(np.isfinite(one)) and np.all(np.isfinite(other)) and np.ptp(one) > 0.0 and np.ptp(other) > 0.0:
            middle = float(np.mean(one))
            costs.append(_cost(one - middle, other - middle, lags, shared))
    if not costs or not np.any(allowed):
        return math.nan
    total = np.where(allowed, np.sum(costs, axis=0), np.inf)
    # Ramps fit ramps at every lag. Of equally good lags, take the smallest.
    equal = np.flatnonzero(total <= np.min(total) + EQUAL)
    best = equal[int(np.argmin(np.abs(lags[equal] * step + start)))]
    return _refined(pairs, float(lags[best]) * step + start, step)


def _grid(side: Side, step: float) -> Array:
    """Equally spaced times over the whole side, in s."""
    count = int((side.time[-1] - side.time[0]) / step + SAME) + 1
    return side.time[0] + step * np.arange(count, dtype=np.float64)


def _cost(one: Array, other: Array, lags: NDArray[np.intp], shared: NDArray[np.intp]) -> Array:
    """For every lag, 1 minus the correlation of ``one[i]`` and ``other[i + lag]`` over the overlapping samples.

    It is 1, as for unrelated signals, if one of them hardly varies in the overlap: a rest would fit any other rest.
    """
    size = 1 << int(one.size + other.size - 1).bit_length()
    product = np.fft.irfft(np.fft.rfft(other, size) * np.conj(np.fft.rfft(one, size)), size)[lags]
    begin, end = np.maximum(0, -lags), np.minimum(one.size, other.size - lags)

    def moments(values: Array, first: NDArray[np.intp], last: NDArray[np.intp]) -> tuple[Array, Array]:
        sums, squares = (np.concatenate(([0.0], np.cumsum(part))) for part in (values, values * values))
        return (sums[last] - sums[first]) / shared, (squares[last] - squares[first]) / shared

    mean_one, square_one = moments(one, begin, end)
    mean_other, square_other = moments(other, begin + lags, end + lags)
    variances = square_one - mean_one**2, square_other - mean_other**2
    covariance = product / shared - mean_one * mean_other
    still = (variances[0] <= STILL * float(np.var(one))) | (variances[1] <= STILL * float(np.var(other)))
    return 1.0 - np.where(still, 0.0, covariance) / np.sqrt(np.where(still, 1.0, variances[0] * variances[1]))


def _refined(pairs: Pairs, lag: float, step: float) -> float:
    """The lag within one step of ``lag`` at which gain*a + offset fits b best, for all pairs together.

    Three Gauss-Newton steps; each pair has its own gain and offset.
    """
    a, b = pairs.a, pairs.b
    found = lag
    for _ in range(3):
        begin, end = max(a.time[0], b.time[0] - found), min(a.time[-1], b.time[-1] - found)
        times = np.arange(begin + step, end - step, step)
        if times.size < 3:
            return lag
        gradient, curvature = 0.0, 0.0
        for name, values in a.values.items():
            one = np.interp(times, a.time, values)
            low, other, high = (np.interp(times + found + k * step, b.time, b.values[name]) for k in (-1, 0, 1))
            one -= np.mean(one)
            norm, spread = float(one @ one), float(np.var(other))
            if not (norm > 0.0 and spread > 0.0 and math.isfinite(norm) and math.isfinite(spread)):
                continue
            slope = (high - low) / (2.0 * step)
            steepness = float(slope @ slope)
            # Remove from both the part that a gain and an offset of a can explain.
            slope, rest = (part - np.mean(part) - (float(one @ part) / norm) * one for part in (slope, other))
            if float(slope @ slope) > EQUAL * steepness:
                gradient += float(slope @ rest) / spread
                curvature += float(slope @ slope) / spread
        if not curvature > 0.0:
            return lag
        found = min(max(found - gradient / curvature, lag - step), lag + step)
    return found


# Common times.


def resample(
    pairs: Pairs, lag: float, *, hold: bool, interval: tuple[float, float]
) -> tuple[Array, dict[str, Array], dict[str, Array], str]:
    """Common times (on the clock of ``a``, in s), the values of a and of b at these times, and a phrase that says how.

    ``b`` is moved back by ``lag`` seconds. The side with the longer steps keeps its samples. The other side is
    interpolated at these times: linearly, or, with ``hold``, with its last sample. Only times in ``interval`` count.
    Raises DescriptionError if the sides have less than two times in common.
    """
    a, b = pairs.a, pairs.b
    time_b = b.time - lag if lag else b.time
    step = min(a.step, b.step)
    begin, end = max(a.time[0], time_b[0], interval[0]), min(a.time[-1], time_b[-1], interval[1])
    keeps_a = a.step >= b.step * (1.0 - SAME)
    base, base_time, fine, fine_time = (a, a.time, b, time_b) if keeps_a else (b, time_b, a, a.time)
    slack = SAME * step
    inside = (base_time >= begin - slack) & (base_time <= end + slack)
    times = base_time[inside]
    if times.size < 2:
        raise DescriptionError(
            f"{a.label} ({_span(a.time)}) and {b.label} ({_span(time_b)}{', moved' if lag else ''}) have no two times "
            "in common there. If their clocks differ, give the delay, or let it be estimated."
        )
    part = window(fine_time, float(times[0]) - slack, float(times[-1]) + slack)
    same = fine_time[part].size == times.size and bool(np.all(np.abs(fine_time[part] - times) <= slack))
    kept = {name: values[inside] for name, values in base.values.items()}
    if same:
        met = {name: values[part] for name, values in fine.values.items()}
        how = f"both at the same {times.size} times"
    elif hold:
        # A time gets the value of the last sample that is not after it.
        index = np.maximum(np.searchsorted(fine_time, times + slack, side="right") - 1, 0)
        met = {name: values[index] for name, values in fine.values.items()}
        how = f"{fine.label} (every {fine.step:.6g} s) held at the {times.size} times of {base.label}"
    else:
        met = {name: np.interp(times, fine_time, values) for name, values in fine.values.items()}
        how = f"{fine.label} (every {fine.step:.6g} s) interpolated linearly at the {times.size} times of {base.label}"
    how += f", {times[0]:.6g} s to {times[-1]:.6g} s"
    return times, kept if keeps_a else met, met if keeps_a else kept, how


def _span(time: Array) -> str:
    return f"{time[0]:.9g} s to {time[-1]:.9g} s"
