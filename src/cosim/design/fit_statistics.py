"""Statistics of a fit: intervals, correlation, values that records cannot tell apart; residuals, repeatability.

Residuals are in units of noise. J is their derivative by the coordinates, with one row for each sample; a change of 1
in a coordinate changes a value by its own size, or by a factor e. Residuals of a model that is not quite right are not
white: neighbours are correlated, so the samples tell less than their number suggests. The covariance of the values is
therefore computed twice, for white residuals and with their correlation over time (Newey & West). Each value gets the
larger deviation of both.

Source: Ljung, System Identification, 2nd ed. 1999, sec. 9.4, 16.4 and 16.5; Newey & West, Econometrica 55(3), 1987.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..result.compare import spectrum
from ..result.metrics import Array, max_abs, nrmse_fit, relative_rms, rms

NORMAL = 1.959963984540054
"""95 % of a normal distribution lie within this number of standard deviations."""

SHARE = 0.3
"""A value belongs to a direction if its component is at least this share of the largest component.

Smaller components change the residuals by less than a tenth of the power of the largest.
"""

FAINT = 1e-2
"""Directions with a singular value below this share of the largest are evaluated again, with a larger step.

Along them, the error of the finite differences may hide the change of the residuals.
"""

FAR_STEP = 0.2
"""The larger step: integration errors divided by it are small beside one unit of noise."""

NOTHING = 10.0
"""A value with an uncertainty of this many times its size is reported as not known at all: not even its sign."""


@dataclass(frozen=True)
class Weak:
    """A combination of values that the records do not tell."""

    names: tuple[str, ...]
    share: float
    """Half width of its 95 % interval as a share of the values; infinite if no residual depends on it."""

    def __str__(self) -> str:
        known = f"known to +-{100.0 * self.share:.3g} % only" if self.share < NOTHING else "not known"
        if len(self.names) == 1:
            return f"From the records {self.names[0]} is {known}."
        listed = f"{', '.join(self.names[:-1])} and {self.names[-1]}"
        return f"The records cannot tell {listed} apart: one combination of them is {known}."


@dataclass(frozen=True)
class Spread:
    """Standard deviations and correlation of the coordinates, and the combinations that the records do not tell."""

    deviation: Array
    """Infinite for a value of a combination that the records do not tell."""
    correlation: Array
    weak: tuple[Weak, ...]
    singular: Array


@dataclass(frozen=True)
class Block:
    """The samples of one output in one record."""

    record: str
    output: str
    part: slice


def spread(
    names: Sequence[str],
    blocks: Sequence[Block],
    residual: Array,
    J: Array,
    look: Look,
) -> Spread:
    """How well the values are known, from the residuals and their derivative ``J``, shape (residuals, values)."""
    size, directions = _directions(J, look)
    # The values of an imperfect model are less certain than the noise alone suggests.
    freedom = max(len(residual) - len(names), 1)
    level = max(1.0, math.sqrt(float(residual @ residual) / freedom))
    with np.errstate(divide="ignore"):
        half = NORMAL * level / size
    told = half < 1.0
    weak = tuple(_weak(names, directions[i], float(half[i])) for i in np.flatnonzero(~told))
    inverse = (directions[told].T / size[told] ** 2) @ directions[told]
    white = inverse @ _meat(blocks, residual, J, correlated=False) @ inverse
    coloured = inverse @ _meat(blocks, residual, J, correlated=True) @ inverse
    deviation = np.sqrt(np.maximum(np.maximum(np.diag(white), np.diag(coloured)), 0.0))
    diagonal = np.sqrt(np.maximum(np.diag(white), 1e-300))
    correlation = np.clip(white / np.outer(diagonal, diagonal), -1.0, 1.0)
    untold = {name for direction in weak for name in direction.names}
    deviation[[name in untold for name in names]] = np.inf
    return Spread(deviation, correlation, weak, size)


Look = Callable[[Array], Array]
"""Function: direction -> change of the residuals for a step of ``FAR_STEP`` along it, divided by the step."""


def _directions(J: Array, look: Look) -> tuple[Array, Array]:
    """Directions in the space of the values, one in each row, and the size of the residuals' change along each.

    Of the change along a faint direction, only the part counts that no small move along the other directions can
    compensate. The rest comes from an error of the faint direction, or from its curvature.
    """
    left, singular, directions = np.linalg.svd(J, full_matrices=False)
    known = [column for column, s in zip(left.T, singular, strict=True) if s >= FAINT * singular[0]]
    size = singular.copy()
    for i in range(len(known), len(singular)):
        change = look(directions[i])
        for column in known:
            change = change - column * (column @ change)
        length = float(np.linalg.norm(change))
        size[i] = min(size[i], length)
        if NORMAL < length < math.inf:
            known.append(change / length)
    return size, directions


def untold(J: Array, look: Look) -> list[int]:
    """Indices of the values to hold so that the records tell all others: one value for each direction not told.

    A direction counts as not told if the noise alone hides it.
    """
    size, directions = _directions(J, look)
    held: list[int] = []
    for s, direction in zip(size, directions, strict=True):
        if s < NORMAL:
            held.append(max((i for i in range(J.shape[1]) if i not in held), key=lambda i: abs(direction[i])))
    return held


def _weak(names: Sequence[str], direction: Array, half: float) -> Weak:
    size = np.abs(direction)
    order = np.argsort(-size, kind="stable")
    return Weak(tuple(str(names[i]) for i in order if size[i] >= SHARE * size[order[0]]), half)


def _meat(blocks: Sequence[Block], residual: Array, J: Array, *, correlated: bool) -> Array:
    """Covariance of the gradient: a sum over outputs and records, which are taken as independent of each other."""
    total = np.zeros((J.shape[1], J.shape[1]))
    for block in blocks:
        r, part = residual[block.part], J[block.part]
        if not correlated:
            total += float(r @ r) / max(len(r), 1) * (part.T @ part)
            continue
        score = part * r[:, None]
        total += score.T @ score
        reach = 2 * memory(r)
        for lag in range(1, reach + 1):
            moved = score[lag:].T @ score[:-lag]
            total += (1.0 - lag / (reach + 1.0)) * (moved + moved.T)
    return total


def memory(residual: Array) -> int:
    """Number of samples over which residuals are correlated: their correlation then first falls below its noise."""
    centred = residual - np.mean(residual)
    power = float(centred @ centred)
    count = len(residual)
    if power <= 0.0:
        return 0
    size = 2 ** math.ceil(math.log2(2 * count))
    spectrum = np.abs(np.fft.rfft(centred, size)) ** 2
    correlation = np.fft.irfft(spectrum, size)[: count // 10 + 1] / power
    below = np.flatnonzero(correlation < NORMAL / math.sqrt(count))
    return int(below[0]) - 1 if below.size else count // 10


def fast_noise(values: Array) -> float:
    """Standard deviation of white noise in ``values``, from their third differences, in which slow motion vanishes.

    The median of the magnitudes is not sensitive to jumps. For a normal distribution it is 0.6745 standard deviations.
    20 is the sum of the squares of the weights 1, -3, 3, -1.
    """
    if len(values) < 4:
        return 0.0
    third = np.diff(values, 3)
    return float(np.median(np.abs(third))) / (0.6745 * math.sqrt(20.0))


# ---- residuals ----


@dataclass(frozen=True)
class Peak:
    """A line in a spectrum."""

    frequency: float
    """Frequency of the peak in Hz."""
    share: float
    """Share of the signal's power that lies near this frequency."""


def peaks(time: Array, signal: Array) -> tuple[Peak, ...]:
    """The three frequencies around which most of the power of a signal lies, the largest first."""
    found_spectrum = spectrum(time, signal)
    frequency, power = found_spectrum.frequency, found_spectrum.density**2
    total = float(np.sum(power))
    found: list[Peak] = []
    left = power.copy()
    for _ in range(3):
        top = int(np.argmax(left))
        low, high = max(top - 2, 0), top + 3
        share = float(np.sum(left[low:high])) / total if total > 0.0 else 0.0
        if share <= 0.0:
            break
        found.append(Peak(float(frequency[top]), share))
        left[low:high] = 0.0
    return tuple(found)


def repeatability(time: Array, signal: Array, period: float) -> float:
    """rms difference between ``signal`` and itself one period later; NaN if the record has no second period.

    ``period`` is in s, the result in the unit of the signal. A perfect model that repeats itself exactly would still
    differ from the record by this value divided by the root of 2.
    """
    inside = time[time + period <= time[-1] + 1e-9]
    if not len(inside):
        return math.nan
    later = np.interp(inside + period, time, signal)
    return rms(later - signal[: len(inside)])


def agreement(measured: Array, expected: Array, about: Array | None = None) -> Mapping[str, float]:
    """Figures of a comparison: rms and largest difference in the unit of the signals; relative and fit in %.

    ``relative`` is the rms difference divided by the rms of the measured signal. ``fit`` is
    100*(1 - norm(difference)/norm(measured - mean)). With ``about``, both refer to ``measured - about`` instead of
    ``measured``; if ``about`` is the reference, this is the tracking error.
    """
    off = measured - expected
    signal = measured if about is None else measured - about
    return {
        "rms": rms(off),
        "largest": max_abs(off),
        "relative": 100.0 * relative_rms(off, signal),
        "fit": nrmse_fit(off, signal),
    }
