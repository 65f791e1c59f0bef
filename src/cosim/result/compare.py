"""Compares two recordings: two runs, two records, or one of each.

``a`` is the reference (a measurement, a published trace); ``b`` is compared with it. A difference is b minus a, in the
unit of a. Every change of values is reported: conversion of units, delay, interpolation.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from ..errors import DescriptionError, suggest
from ..record.read import Record
from ..units import conversion
from .align import Pairs, estimate_delay, pair, resample, side_of
from .metrics import Array, max_abs, mean, nrmse_fit, relative_rms, rms, sine_amplitude
from .picture import source_labels
from .summary import Recorded, loops

SEGMENTS = 8
"""Number of segments over which a spectrum is averaged.

Fewer segments give a rough spectrum. More segments are shorter and have no low frequencies.
"""
WORTH_SAYING = 0.05
"""Smallest delay that is reported, as a fraction of a step. A smaller delay does not move a sample."""

Shift = float | Literal["estimate"]


@dataclass(frozen=True)
class Tolerance:
    """A tube around ``a``: ``absolute`` plus ``relative`` times the range of a (largest minus smallest value).

    ``b`` may also be early or late by up to ``time`` seconds.
    """

    absolute: float = 0.0
    relative: float = 0.0
    time: float = 0.0
    unit: str = ""
    """Unit of ``absolute``; if empty, the unit of the signal."""


@dataclass(frozen=True)
class Outside:
    """Samples of ``b`` outside its tube."""

    count: int
    share: float
    """``count`` as a fraction of all samples."""
    first: float
    """Time of the first sample outside, in s."""
    excess: float
    """Largest distance from the tube, in the unit of the signal."""


@dataclass(frozen=True)
class Spectrum:
    """One-sided amplitude spectral density of a difference; its square integrates to the variance (Welch 1967)."""

    frequency: Array
    """Frequencies in Hz, without 0."""
    density: Array
    """Density at each frequency, in the unit of the signal per square root of Hz."""
    peak_frequency: float
    """Frequency in Hz of the largest component of the whole difference."""
    peak_amplitude: float
    """Amplitude of this component, in the unit of the signal."""


@dataclass(frozen=True, repr=False)
class Difference:
    """A signal of both sides at common times, and its figures. Figures are NaN if a sample is not finite."""

    name: str
    other: str
    """The name in ``b``."""
    unit: str
    time: Array
    a: Array
    b: Array
    maximum: float
    """Largest magnitude of b - a."""
    at: float
    """Time of ``maximum``, in s."""
    rms: float
    mean: float
    relative: float
    """``rms`` as a fraction of the rms of a; NaN if a is 0 everywhere."""
    fit: float
    """100 * (1 - norm(b - a) / norm(a - mean(a))) %: the NRMSE fit of system identification; NaN if a does not vary."""
    spectrum: Spectrum | None
    tube: tuple[Array, Array] | None = None
    """Lower and upper limits of b, if there is a tolerance."""
    outside: Outside | None = None
    """None if all samples are inside, or without a tolerance."""

    def __repr__(self) -> str:
        return (
            f"<Difference of {self.other} from {self.name}: largest {self.maximum:.4g} {self.unit} at {self.at:.6g} s, "
            f"rms {self.rms:.4g} {self.unit}, fit {self.fit:.4g} %>"
        )

    @property
    def difference(self) -> Array:
        """b - a."""
        return self.b - self.a


@dataclass(frozen=True)
class Tracking:
    """The tracking errors (position minus reference) of a loop on both sides, in the unit of its position."""

    loop: str
    unit: str
    rms_a: float
    rms_b: float
    maximum: float
    """Largest magnitude of the difference of the two errors."""
    rms: float
    """Root mean square of the difference of the two errors."""


@dataclass(frozen=True, repr=False)
class Comparison:
    """The comparison of two recordings; ``a`` and ``b`` are their labels."""

    a: str
    b: str
    differences: tuple[Difference, ...]
    tracking: tuple[Tracking, ...]
    delay: float
    """Seconds by which b was moved back before the comparison."""
    estimated_delay: float
    """Seconds by which the recorded b lags behind a, estimated from their best fit; NaN if there is no estimate."""
    how: str
    """A phrase that says at which times both were compared, and which side was interpolated."""
    notes: tuple[str, ...]

    def __repr__(self) -> str:
        found = "; ".join(f"{d.name}: rms {d.rms:.4g} {d.unit}, fit {d.fit:.4g} %" for d in self.differences)
        return f"<Comparison of {self.b} with {self.a}: {found}>"

    @property
    def within(self) -> bool:
        """Whether every signal with a tolerance is inside its tube."""
        return all(entry.outside is None for entry in self.differences)

    def __getitem__(self, name: str) -> Difference:
        """The difference of a signal, by its name in ``a``. Raises DescriptionError if it was not compared."""
        for entry in self.differences:
            if entry.name == name:
                return entry
        raise DescriptionError(f"'{name}' was not compared.{suggest(name, (d.name for d in self.differences))}")


def compare(
    a: Recorded | Record,
    b: Recorded | Record,
    signals: Mapping[str, str] | Sequence[str] | None = None,
    *,
    tolerance: Tolerance | Mapping[str, Tolerance] | None = None,
    delay: Shift = 0.0,
    interpolation: Literal["linear", "hold"] = "linear",
    start: float = -math.inf,
    stop: float = math.inf,
    labels: tuple[str, str] | None = None,
) -> Comparison:
    """Compare ``b`` with the reference ``a``.

    ``signals``: ``{name in a: name in b}``, or names that both have; None for all names that both have.
    ``tolerance``: one for all signals, or by name in a.
    ``delay``: seconds by which b is moved back; ``"estimate"`` takes the delay with the best fit.
    ``start``, ``stop``: the times of a in s between which both are compared.
    ``labels``: names of both sides in messages and pictures. Default as in ``cosim.plot``: system or file.

    Units are converted. If one side states no unit, it is taken to have the unit of the other side. The side with
    longer steps keeps its samples; the other side is interpolated at these times.
    Raises DescriptionError for names, units and times that do not fit together.
    """
    if labels is None:
        first, second = source_labels((a, b))
        labels = first, second
    pairs = pair(side_of(a, labels[0]), side_of(b, labels[1]), signals)
    tolerances = _tolerances(tolerance, pairs.a.units)
    estimated = estimate_delay(pairs, everywhere=delay == "estimate")
    moved = estimated if delay == "estimate" else float(delay)
    if not math.isfinite(moved):
        raise DescriptionError(
            f"the delay of {labels[1]} cannot be estimated: no signal varies on both sides. Give it in seconds."
            if delay == "estimate"
            else f"delay {moved}: give a finite number of seconds."
        )
    hold = interpolation == "hold"
    time, of_a, of_b, how = resample(pairs, moved, hold=hold, interval=(start, stop))
    differences = tuple(
        _difference((name, other, unit), time, (of_a[name], of_b[name]), tolerances.get(name))
        for (name, other), unit in zip(pairs.names, pairs.units, strict=True)
    )
    notes = [*pairs.notes, *_delay_notes(labels[1], moved, estimated, min(pairs.a.step, pairs.b.step))]
    tracking = _tracking(pairs, (a, b), of_a, of_b, notes)
    return Comparison(*labels, differences, tracking, moved, estimated, how, tuple(notes))


def _delay_notes(label: str, moved: float, estimated: float, step: float) -> list[str]:
    """The note about the delay of ``b``; empty if there is none to report."""
    if moved:
        way = "back" if moved > 0.0 else "forward"
        return [f"{label} is moved {way} by {abs(moved):.6g} s before it is compared."]
    if math.isfinite(estimated) and abs(estimated) > WORTH_SAYING * step:
        word = "lags behind" if estimated > 0.0 else "leads"
        return [f"{label} {word} by {abs(estimated):.3g} s, as it fits best. It is compared as it was recorded."]
    return []


def _tolerances(given: Tolerance | Mapping[str, Tolerance] | None, units: Mapping[str, str]) -> dict[str, Tolerance]:
    """The tolerance of each signal in its own unit; ``units`` by name. Raises DescriptionError with all problems."""
    if given is None:
        return {}
    found = dict.fromkeys(units, given) if isinstance(given, Tolerance) else dict(given)
    problems: list[str] = []
    for name, entry in found.items():
        if name not in units:
            problems.append(f"tolerance: '{name}' is not compared.{suggest(name, units)}")
        elif not all(math.isfinite(part) and part >= 0.0 for part in (entry.absolute, entry.relative, entry.time)):
            problems.append(f"tolerance of {name}: give finite numbers that are not negative.")
        elif entry.unit not in ("", units[name]):
            try:
                factor = conversion(entry.unit, units[name])
            except DescriptionError as error:
                problems.append(f"tolerance of {name}: {error}")
            else:
                found[name] = replace(entry, absolute=factor * entry.absolute, unit=units[name])
    if problems:
        raise DescriptionError(problems)
    return found


def _difference(
    said: tuple[str, str, str], time: Array, values: tuple[Array, Array], tolerance: Tolerance | None
) -> Difference:
    """The difference of a signal; ``said`` are its name in a, its name in b and its unit."""
    a, b = values
    off = b - a
    finite = bool(np.all(np.isfinite(off)))
    tube = None if tolerance is None else _tube(time, a, tolerance)
    return Difference(
        *said,
        time,
        a,
        b,
        maximum=max_abs(off),
        at=float(time[int(np.argmax(np.abs(off)))]),
        rms=rms(off),
        mean=mean(off),
        relative=relative_rms(off, a),
        fit=nrmse_fit(off, a),
        spectrum=spectrum(time, off) if finite and np.any(off) and time.size >= 2 * SEGMENTS else None,
        tube=tube,
        outside=None if tube is None else _outside(time, b, tube),
    )


def _tube(time: Array, a: Array, tolerance: Tolerance) -> tuple[Array, Array]:
    """The lower and the upper limit of b at each time.

    They are the smallest and the largest value of ``a`` within the tolerance of time, widened by the other tolerances.
    ``a`` is linear between samples.
    """
    finite = a[np.isfinite(a)]
    width = tolerance.absolute + tolerance.relative * (float(np.ptp(finite)) if finite.size else 0.0)
    low, high = a.copy(), a.copy()
    if tolerance.time > 0.0:
        # The extremes are those of the samples in the window of time and of the interpolated values at its two ends.
        ends = [np.interp(time + shift, time, a) for shift in (-tolerance.time, tolerance.time)]
        first = np.searchsorted(time, time - tolerance.time, side="left")
        last = np.searchsorted(time, time + tolerance.time, side="right")
        low = np.minimum(np.minimum(*ends), _over(np.minimum, a, first, last))
        high = np.maximum(np.maximum(*ends), _over(np.maximum, a, first, last))
    return low - width, high + width


def _over(extreme: np.ufunc, values: Array, first: Any, last: Any) -> Array:
    """The extreme of ``values[first:last]`` for every window, from the extremes over powers of two (sparse table)."""
    levels = [values]
    while 2 ** len(levels) <= int(np.max(last - first)):
        half = 2 ** (len(levels) - 1)
        levels.append(extreme(levels[-1][:-half], levels[-1][half:]))
    level = np.floor(np.log2(last - first)).astype(np.intp)
    found = np.empty_like(values)
    for number, table in enumerate(levels):
        here = level == number
        found[here] = extreme(table[first[here]], table[last[here] - 2**number])
    return found


def _outside(time: Array, b: Array, tube: tuple[Array, Array]) -> Outside | None:
    excess = np.maximum(tube[0] - b, b - tube[1])
    out = np.flatnonzero(~(excess <= 0.0))  # samples that are not finite are outside
    if not out.size:
        return None
    farthest = float(np.max(excess))
    return Outside(int(out.size), out.size / time.size, float(time[out[0]]), farthest)


def spectrum(time: Array, signal: Array) -> Spectrum:
    """The spectrum of a signal by Welch's method: ``SEGMENTS`` segments with half overlap and a Hann window.

    ``time`` in s. If it is uneven, the signal is interpolated linearly to even times with the mean step.
    """
    step = float(time[-1] - time[0]) / (time.size - 1)
    even: Array = time[0] + step * np.arange(time.size, dtype=np.float64)
    values: Array = signal if np.allclose(time, even, rtol=0.0, atol=1e-3 * step) else np.interp(even, time, signal)
    # Segments of length n that overlap by half: (SEGMENTS + 1)*n/2 samples.
    length = 2 * (time.size // (SEGMENTS + 1))
    hann = 0.5 - 0.5 * np.cos(2.0 * math.pi * np.arange(length) / length)
    power = np.zeros(length // 2 + 1)
    for k in range(SEGMENTS):
        segment = values[k * length // 2 :][:length]
        power += np.abs(np.fft.rfft(hann * (segment - np.mean(segment)))) ** 2
    power *= 2.0 * step / (SEGMENTS * float(np.sum(hann**2)))
    whole = 0.5 - 0.5 * np.cos(2.0 * math.pi * np.arange(time.size) / time.size)
    lines = np.abs(np.fft.rfft(whole * (values - np.mean(values))))
    peak = float(np.argmax(lines[1:]) + 1) / (time.size * step)
    density, frequency = np.sqrt(power[1:]), np.arange(1.0, length // 2 + 1.0) / (length * step)
    return Spectrum(frequency, density, peak, sine_amplitude(even, values, peak))


def _tracking(
    pairs: Pairs,
    sources: tuple[Recorded | Record, Recorded | Record],
    of_a: Mapping[str, Array],
    of_b: Mapping[str, Array],
    notes: list[str],
) -> tuple[Tracking, ...]:
    """The tracking errors of all loops whose reference and position are compared.

    The loops are known if at least one side is a run. Adds a note for a loop whose units do not fit.
    """
    names_of_b = {other: name for name, other in pairs.names}
    units = dict(zip((name for name, _ in pairs.names), pairs.units, strict=True))
    found: dict[tuple[str, str], Tracking] = {}
    for source, own in zip(sources, ({name: name for name in of_a}, names_of_b), strict=True):
        for loop in () if isinstance(source, Record) else loops(source):
            reference, position = own.get(loop.reference), own.get(loop.position)
            if reference is None or position is None or (reference, position) in found:
                continue
            try:
                factor = conversion(units[reference], units[position])
            except DescriptionError as error:
                notes.append(f"no tracking error of {loop.name}: {error}")
                continue
            errors = [side[position] - factor * side[reference] for side in (of_a, of_b)]
            off = errors[1] - errors[0]
            found[reference, position] = Tracking(
                loop.name, units[position], rms(errors[0]), rms(errors[1]), max_abs(off), rms(off)
            )
    return tuple(found.values())
