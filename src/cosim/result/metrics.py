"""Figures of merit of recorded signals: tracking errors, step responses, circular tests.

Every function takes arrays with one value for each sample: ``time`` in s, other signals in any unit. A result has the
unit of its signal unless its docstring says otherwise. To use only a part of the signals, cut them with ``window``
first. The position error is position minus reference: in a positive motion, a positive error means that the position
is ahead. For a signal with samples that are not finite, functions of one figure return NaN; functions of several
figures raise DescriptionError.

Terms of circular tests are those of ISO 230-4: radial deviation F about the commanded centre, circular deviation G
about the least-squares centre, circular hysteresis H between the two senses of rotation.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import DescriptionError
from ..public import public_names

__dir__ = public_names(globals())

Array = NDArray[np.float64]

QUADRANTS = (0.0, 0.5 * math.pi, math.pi, 1.5 * math.pi)
"""Angles in rad at which an axis of a circular path reverses: +X, +Y, -X, -Y."""


def _need(samples: Array, least: int = 1) -> None:
    if samples.size < least:
        raise DescriptionError(f"{samples.size} samples in the window: give one with at least {least}.")


def _need_finite(*signals: Array) -> None:
    for signal in signals:
        if not np.all(np.isfinite(signal)):
            raise DescriptionError("a signal is not finite everywhere: there is no figure.")


def window(time: Array, start: float = -math.inf, stop: float = math.inf) -> slice:
    """The samples with start <= time <= stop, as a slice. Times in s.

    A sample outside by less than 1e-6 of the mean step still counts. Raises DescriptionError if there is no sample.
    """
    _need(time)
    begin, end = float(time[0]), float(time[-1])
    slack = 1e-6 * (end - begin) / max(time.size - 1, 1)
    first = int(np.searchsorted(time, start - slack, side="left"))
    last = int(np.searchsorted(time, stop + slack, side="right"))
    if last <= first:
        raise DescriptionError(
            f"no sample from {start:g} s to {stop:g} s: the signal lasts from {begin:g} s to {end:g} s."
        )
    return slice(first, last)


def max_abs(signal: Array) -> float:
    """Largest magnitude."""
    _need(signal)
    peak = float(np.max(np.abs(signal)))
    return peak if math.isfinite(peak) else math.nan


def rms(signal: Array) -> float:
    """Root of the mean square."""
    peak = max_abs(signal)
    return peak * float(np.sqrt(np.mean(np.square(signal / peak)))) if peak > 0.0 else peak


def std(signal: Array) -> float:
    """Standard deviation about the mean: the mean square is over n samples, not n - 1."""
    peak = max_abs(signal)
    return peak * float(np.std(signal / peak)) if peak > 0.0 else peak


def relative_rms(difference: Array, signal: Array) -> float:
    """rms of ``difference`` as a fraction of the rms of ``signal``; NaN if ``signal`` is 0 everywhere."""
    size = rms(signal)
    return rms(difference) / size if size > 0.0 else math.nan


def nrmse_fit(difference: Array, signal: Array) -> float:
    """100*(1 - norm(difference)/norm(signal - mean)) %, as in system identification; NaN if ``signal`` is constant."""
    size = std(signal)
    return 100.0 * (1.0 - rms(difference) / size) if size > 0.0 else math.nan


def mean(signal: Array) -> float:
    """Arithmetic mean."""
    _need(signal)
    return float(np.mean(signal)) if np.all(np.isfinite(signal)) else math.nan


def steady_value(time: Array, signal: Array, duration: float) -> float:
    """Mean over the last ``duration`` seconds."""
    return mean(signal[window(time, time[-1] - duration)])


def total_variation(time: Array, signal: Array) -> float:
    """Sum of the magnitudes of all changes, divided by the duration; in the unit of the signal per second.

    A sine of amplitude A and frequency f has 4*A*f. Chatter gives values that are orders of magnitude larger.
    """
    _need(time, 2)
    if not np.all(np.isfinite(signal)):
        return math.nan
    return float(np.sum(np.abs(np.diff(signal))) / (time[-1] - time[0]))


def overshoot(signal: Array, start: float, final: float) -> float:
    """How far ``signal`` goes beyond ``final`` on its way from ``start``; 0 if it never does."""
    _need(signal)
    if not (np.all(np.isfinite(signal)) and math.isfinite(start) and math.isfinite(final)):
        return math.nan
    return max(0.0, float(np.max((signal - final) * math.copysign(1.0, final - start))))


def settling_time(time: Array, signal: Array, final: float, band: float, start: float = 0.0) -> float:
    """Seconds from ``start`` to the first sample from which on abs(signal - final) <= band.

    NaN if the signal has not settled: its last sample is outside the band.
    """
    _need(signal)
    outside = np.flatnonzero(~(np.abs(signal - final) <= band))  # NaN is outside
    if outside.size == 0:
        return float(time[0]) - start
    if outside[-1] + 1 == signal.size:
        return math.nan
    return float(time[outside[-1] + 1]) - start


def rise_time(time: Array, signal: Array, *, start: float, final: float, low: float = 0.1, high: float = 0.9) -> float:
    """Seconds between the first crossings of the fractions ``low`` and ``high`` of the way from start to final.

    Crossings are interpolated between samples; NaN if ``high`` is never reached.
    """
    if not np.all(np.isfinite(signal)):
        return math.nan
    way = (signal - start) / (final - start)

    def crossing(level: float) -> float:
        above = np.flatnonzero(way >= level)
        if above.size == 0:
            return math.nan
        k = int(above[0])
        if k == 0:
            return float(time[0])
        return float(time[k - 1] + (level - way[k - 1]) / (way[k] - way[k - 1]) * (time[k] - time[k - 1]))

    return crossing(high) - crossing(low)


def reversal_times(time: Array, reference: Array) -> Array:
    """Times in s at which ``reference`` reverses its direction of motion.

    A reversal is at the extreme sample. If the reference rests there, it is at the last sample of the rest. Raises
    DescriptionError if a sample is not finite.
    """
    _need_finite(reference)
    step = np.diff(reference)
    moving = np.flatnonzero(step)
    turned = np.flatnonzero(np.signbit(step[moving[1:]]) != np.signbit(step[moving[:-1]]))
    return time[moving[turned + 1]]


class ReversalPeak(NamedTuple):
    """The peak of the error after one velocity reversal."""

    time: float
    """Time of the reversal in s."""
    peak: float
    """Error of largest magnitude, signed, in the first half of the time to the next reversal."""
    delay: float
    """Seconds from the reversal to the peak."""
    decay: float
    """Seconds from the reversal until the peak has decayed to a tenth of its height above ``base``.

    From then to the end of the half, the magnitude of the error stays below this value. NaN if it does not decay.
    """
    base: float
    """Median magnitude of the error between this reversal and the next."""


def reversal_peaks(time: Array, error: Array, reference: Array) -> list[ReversalPeak]:
    """Peaks of ``error`` after the reversals of ``reference``.

    Only the first half of the time to the next reversal is used, because the second half leads up to the next reversal.
    The last reversal counts only if the record goes on after it for at least the shortest time between two reversals.
    Empty for less than two reversals. Raises DescriptionError if a sample is not finite.
    """
    _need_finite(error)
    times = reversal_times(time, reference)
    if times.size < 2:
        return []
    shortest = float(np.min(np.diff(times)))
    ends = [*(float(after) for after in times[1:]), float(times[-1]) + shortest]
    peaks: list[ReversalPeak] = []
    for begin, end in zip((float(at) for at in times), ends, strict=True):
        if end > float(time[-1]) + 1e-6 * shortest:
            break
        base = float(np.median(np.abs(error[window(time, begin, end)])))
        half = window(time, begin, 0.5 * (begin + end))
        magnitude = np.abs(error[half])
        top = int(np.argmax(magnitude))
        outside = np.flatnonzero(magnitude > base + 0.1 * (magnitude[top] - base))
        settled = int(outside[-1]) + 1 if outside.size else 0
        peaks.append(
            ReversalPeak(
                time=begin,
                peak=float(error[half][top]),
                delay=float(time[half][top]) - begin,
                decay=float(time[half][settled]) - begin if settled < magnitude.size else math.nan,
                base=base,
            )
        )
    return peaks


def sine_amplitude(time: Array, signal: Array, frequency: float) -> float:
    """Amplitude of the component at ``frequency`` Hz: least-squares fit of sine, cosine and a constant."""
    _need(time, 3)
    if not np.all(np.isfinite(signal)):
        return math.nan
    angle = 2.0 * math.pi * frequency * time
    basis = np.column_stack((np.sin(angle), np.cos(angle), np.ones_like(time)))
    solution = np.linalg.lstsq(basis, signal, rcond=None)[0]
    return float(np.hypot(solution[0], solution[1]))


# Two axes: a path sampled at x, y.


def contour_error(x: Array, y: Array, x_ref: Array, y_ref: Array) -> Array:
    """Distance of each sample from the reference path, positive on the left of the direction of motion.

    The path is the polygon through the reference points. For points at a distance v*T on a curve of radius R, it is off
    the curve by at most (v*T)**2/(8*R). The search for the nearest point of the path begins at the reference point of
    the same sample. Therefore a path may cross itself. Beyond an end of the path, the distance is from this end.
    Raises DescriptionError if the reference does not move, or if a sample is not finite.
    """
    _need_finite(x, y, x_ref, y_ref)
    moves = np.concatenate(([True], (np.diff(x_ref) != 0.0) | (np.diff(y_ref) != 0.0)))
    path = np.column_stack((x_ref[moves], y_ref[moves]))
    if len(path) < 2:
        raise DescriptionError("the reference does not move: it has no path.")
    points, begins, steps = np.column_stack((x, y)), path[:-1], np.diff(path, axis=0)
    squares = np.einsum("ij,ij->i", steps, steps)

    def seen(which: NDArray[np.intp], piece: NDArray[np.intp]) -> tuple[Array, Array]:
        """For some points, the place along a piece of the path (0 to 1 on it) and the squared distance from it."""
        offset = points[which] - begins[piece]
        along = np.einsum("ij,ij->i", offset, steps[piece]) / squares[piece]
        off = offset - np.clip(along, 0.0, 1.0)[:, np.newaxis] * steps[piece]
        return along, np.einsum("ij,ij->i", off, off)

    last = len(steps) - 1
    nearest = np.minimum(np.cumsum(moves) - 1, last)
    active = np.arange(x.size)
    along, square = seen(active, nearest)
    while active.size:
        # ``place`` on the extended piece says how many pieces to move. If this is not nearer, try the neighbouring
        # piece. Only moves to a nearer piece are made, so the search ends.
        here, place = nearest[active], along[active]
        far = np.clip(here + np.floor(place).astype(np.intp), 0, last)
        close = np.clip(here + np.where(place > 1.0, 1, np.where(place < 0.0, -1, 0)), 0, last)
        came = np.zeros(active.size, dtype=np.bool_)
        for goal in (far, close):
            new_place, new_square = seen(active, goal)
            better = ~came & (new_square < square[active])
            chosen = active[better]
            nearest[chosen], along[chosen], square[chosen] = goal[better], new_place[better], new_square[better]
            came |= better
        active = active[came]
    offset = points - begins[nearest]
    side = steps[nearest, 0] * offset[:, 1] - steps[nearest, 1] * offset[:, 0]
    return np.copysign(np.sqrt(square), side)


def radial_deviation(x: Array, y: Array, radius: float, centre: tuple[float, float] = (0.0, 0.0)) -> Array:
    """Distance of each sample from ``centre`` minus ``radius``, as a double ball bar shows it (F of ISO 230-4)."""
    return np.hypot(x - centre[0], y - centre[1]) - radius


def least_squares_circle(x: Array, y: Array) -> tuple[float, float, float]:
    """Centre x, y and radius of the circle with the least sum of squared radial distances.

    Gauss-Newton iteration from the algebraic fit. For a path near a circle, six steps converge to rounding errors.
    Raises DescriptionError for fewer than three samples, or if a sample is not finite.
    """
    _need(x, 3)
    _need_finite(x, y)
    x_mean, y_mean = float(np.mean(x)), float(np.mean(y))
    u, v = x - x_mean, y - y_mean
    ones = np.ones_like(u)
    a, b, c = np.linalg.lstsq(np.column_stack((2.0 * u, 2.0 * v, ones)), u * u + v * v, rcond=None)[0]
    u_c, v_c = float(a), float(b)
    radius = math.sqrt(float(c) + u_c**2 + v_c**2)
    for _ in range(6):
        distance = np.hypot(u - u_c, v - v_c)
        jacobian = np.column_stack(((u_c - u) / distance, (v_c - v) / distance, -ones))
        correction = np.linalg.lstsq(jacobian, radius - distance, rcond=None)[0]
        u_c, v_c, radius = u_c + float(correction[0]), v_c + float(correction[1]), radius + float(correction[2])
    return x_mean + u_c, y_mean + v_c, radius


def circular_deviation(x: Array, y: Array) -> float:
    """G of ISO 230-4: largest minus smallest distance from the least-squares centre. Give one turn."""
    x_c, y_c, _ = least_squares_circle(x, y)
    distance = np.hypot(x - x_c, y - y_c)
    return float(np.max(distance) - np.min(distance))


def circular_hysteresis(
    angle_one: Array, deviation_one: Array, angle_other: Array, deviation_other: Array, steps: int = 1800
) -> float:
    """H of ISO 230-4: largest difference of the radial deviations of two turns in opposite directions.

    Angles in rad are the directions in the plane. Each turn must be complete; its samples may have either order. Both
    turns are interpolated at ``steps`` equally spaced angles.
    """
    grid = np.linspace(0.0, 2.0 * math.pi, steps, endpoint=False, dtype=np.float64)
    difference = resample_turn(angle_one, deviation_one, grid) - resample_turn(angle_other, deviation_other, grid)
    return max_abs(difference)


def resample_turn(angle: Array, deviation: Array, grid: Array) -> Array:
    """``deviation`` of one turn, interpolated at the angles ``grid`` in rad; the turn is taken as periodic."""
    return np.interp(grid, np.mod(angle, 2.0 * math.pi), deviation, period=2.0 * math.pi)


def _sector(angle: Array, axis: float, low: float, high: float) -> tuple[Array, NDArray[np.bool_]]:
    """Angles in rad relative to ``axis`` in -pi...pi, and which of them are in low...high (degrees)."""
    relative = np.mod(angle - axis + math.pi, 2.0 * math.pi) - math.pi
    inside = (relative >= math.radians(low)) & (relative <= math.radians(high))
    if not np.any(inside):
        raise DescriptionError(
            f"no sample from {low:g} to {high:g} deg about {math.degrees(axis):g} deg: give one turn."
        )
    return relative, inside


def quadrant_spikes(angle: Array, deviation: Array) -> tuple[float, float, float, float]:
    """Reversal spikes after 0, 90, 180 and 270 deg: the largest difference of the radial deviation from its median.

    Spikes are signed: radial deviation minus median of the turn. ``angle`` in rad must increase along the motion: give
    the angle travelled, so that both directions are treated the same. Each spike is looked for from 2 deg before to
    15 deg after its axis. Raises DescriptionError if there is no sample in this range.
    """
    median = float(np.median(deviation))
    spikes: list[float] = []
    for axis in QUADRANTS:
        _, inside = _sector(angle, axis, -2.0, 15.0)
        off = deviation[inside] - median
        spikes.append(float(off[np.argmax(np.abs(off))]))
    return spikes[0], spikes[1], spikes[2], spikes[3]


def reversal_values(angle: Array, deviation: Array) -> tuple[float, float, float, float]:
    """Steps of the radial deviation at 0, 90, 180 and 270 deg. Lost motion of the reversing axis causes such steps.

    The error of each axis enters the deviation with the cosine or sine of the angle. Therefore a*cos + b*sin is fitted
    from 33 to 15 deg before the axis, and from 15 to 33 deg after it. The step is the difference of both fits on the
    axis. Neither a spike nor a centre offset changes it. ``angle`` in rad must increase along the motion.
    Raises DescriptionError if there is no sample in one of these ranges.
    """
    steps: list[float] = []
    for axis in QUADRANTS:
        sides: list[float] = []
        for low, high in ((-33.0, -15.0), (15.0, 33.0)):
            relative, inside = _sector(angle, axis, low, high)
            basis = np.column_stack((np.cos(relative[inside]), np.sin(relative[inside])))
            sides.append(float(np.linalg.lstsq(basis, deviation[inside], rcond=None)[0][0]))
        steps.append(sides[1] - sides[0])
    return steps[0], steps[1], steps[2], steps[3]


class CircularTest(NamedTuple):
    """One turn of a circular test; lengths in the unit of the path."""

    circular_deviation: float
    """G, about the least-squares centre."""
    radial_max: float
    """F_max, largest radial deviation about the commanded centre."""
    radial_min: float
    """F_min, smallest radial deviation about the commanded centre."""
    radial_mean: float
    """Mean radial deviation about the commanded centre."""
    spikes: tuple[float, float, float, float]
    """``quadrant_spikes`` at 0, 90, 180, 270 deg."""
    reversals: tuple[float, float, float, float]
    """``reversal_values`` at 0, 90, 180, 270 deg."""
    angle: Array
    """Commanded angle travelled since the beginning of the turn, in rad."""
    deviation: Array
    """Radial deviation, one value for each sample."""


def circular_test(x: Array, y: Array, x_ref: Array, y_ref: Array, *, radius: float, turn: int = 2) -> CircularTest:
    """The figures of a turn (1 is the first) of a path commanded as a circle of ``radius`` about the origin.

    The angle is the angle of the commanded point. It is 0 at the first sample and increases along the motion.
    Raises DescriptionError if the path has fewer turns, or if a sample is not finite.
    """
    _need_finite(x, y, x_ref, y_ref)
    angle = np.unwrap(np.arctan2(y_ref, x_ref))
    travelled = (angle - angle[0]) * math.copysign(1.0, float(angle[-1] - angle[0]))
    begin, end = 2.0 * math.pi * (turn - 1), 2.0 * math.pi * turn
    slack = 1e-9
    if float(travelled[-1]) < end - 2.0 * math.pi / 1800.0:
        turns = float(travelled[-1]) / (2.0 * math.pi)
        raise DescriptionError(f"the path has {turns:.3g} turns, turn {turn} is wanted: give a longer stop time.")
    part = (travelled >= begin - slack) & (travelled < end - slack)
    deviation = radial_deviation(x[part], y[part], radius)
    local = travelled[part] - begin
    return CircularTest(
        circular_deviation=circular_deviation(x[part], y[part]),
        radial_max=float(np.max(deviation)),
        radial_min=float(np.min(deviation)),
        radial_mean=float(np.mean(deviation)),
        spikes=quadrant_spikes(local, deviation),
        reversals=reversal_values(local, deviation),
        angle=local,
        deviation=deviation,
    )


OF_ONE_SIGNAL: Mapping[str, Callable[[Array, Array], float]] = {
    "max_abs": lambda time, signal: max_abs(signal),
    "rms": lambda time, signal: rms(signal),
    "std": lambda time, signal: std(signal),
    "mean": lambda time, signal: float(np.mean(signal)),
    "min": lambda time, signal: float(np.min(signal)),
    "max": lambda time, signal: float(np.max(signal)),
    "last": lambda time, signal: float(signal[-1]),
    "peak_to_peak": lambda time, signal: float(np.ptp(signal)),
    "total_variation": total_variation,
}
"""The figures that a file may ask for as ``of``: functions of ``time`` in s and one signal."""
