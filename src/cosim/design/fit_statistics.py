"""What a fit says about its values: intervals, correlation, what records cannot tell apart; residuals, repeatability.

Residuals are in units of noise, J is their derivative by coordinates in which 1 is a change of a value by itself (or a
factor e): one row a sample. Residuals of a model that is not quite right are not white: neighbours go together, and so
many samples tell less than they seem to. The covariance of the values is therefore computed twice, for white residuals
and with their correlation over time (Newey & West), and each value gets the larger of both.

Source: Ljung, System Identification, 2nd ed. 1999, sec. 9.4, 16.4 and 16.5; Newey & West, Econometrica 55(3), 1987.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..result.compare import spectrum
from ..result.metrics import Array

NORMAL = 1.959963984540054
"""95 % of a normal distribution lie within so many standard deviations."""

SHARE = 0.3
"""A value takes part in a direction if its component is at least this part of the largest."""

FAINT = 1e-2
"""Directions with a singular value below this part of the largest are looked at again, with a larger step."""

FAR_STEP = 0.2
"""The step of that look: integration errors, divided by it, are small beside one unit of noise."""


NOTHING = 10.0
"""A value that is known to this many times itself is not known at all."""


@dataclass(frozen=True)
class Weak:
    """A combination of values that the records do not tell."""

    names: tuple[str, ...]
    share: float
    """Half of its 95 % interval, 1 for a change of the values by themselves; infinite where nothing depends on it."""

    def __str__(self) -> str:
        known = f"known to +-{100.0 * self.share:.3g} % only" if self.share < NOTHING else "not known"
        if len(self.names) == 1:
            return f"From the records {self.names[0]} is {known}."
        listed = f"{', '.join(self.names[:-1])} and {self.names[-1]}"
        return f"The records cannot tell {listed} apart: one combination of them is {known}."


@dataclass(frozen=True)
class Spread:
    """Standard deviations and correlation of the coordinates, and what is not told."""

    deviation: Array
    """Infinite for a value that takes part in a direction that is not told."""
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
    """How well values are known."""
    size, directions = _directions(J, look)
    # A model that is not right is known less well than its noise says.
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
"""Gives the change of the residuals along a direction, by a step of ``FAR_STEP`` and divided by it."""


def _directions(J: Array, look: Look) -> tuple[Array, Array]:
    """Directions in the space of the values, one a row, and the change of the residuals along each.

    Of a faint direction that change counts which no small move along those that are told makes up: where the faint
    one is a little off, or bent, it is theirs.
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
    """Numbers of values that have to be held for the others to be told, at the noise alone: one a direction."""
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
    """Covariance of the gradient: sum over the outputs of the records, which are independent of each other."""
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
    """Samples after which residuals have forgotten each other: where their correlation first falls below its noise."""
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
    """Standard deviation of white noise in ``values`` from their third differences, which slow motion does not reach.

    The median of their magnitudes is taken, so that jumps do not count: 0.6745 is that of a normal distribution, 20
    the sum of the squares of the weights 1, 3, 3, 1.
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
    """Hz."""
    share: float
    """Part of the power of the signal near this frequency."""


def peaks(time: Array, signal: Array, count: int = 3) -> tuple[Peak, ...]:
    """The frequencies around which most of the power of a signal lies, the largest first."""
    found_spectrum = spectrum(time, signal)
    frequency, power = found_spectrum.frequency, found_spectrum.density**2
    total = float(np.sum(power))
    found: list[Peak] = []
    left = power.copy()
    for _ in range(count):
        top = int(np.argmax(left))
        low, high = max(top - 2, 0), top + 3
        share = float(np.sum(left[low:high])) / total if total > 0.0 else 0.0
        if share <= 0.0:
            break
        found.append(Peak(float(frequency[top]), share))
        left[low:high] = 0.0
    return tuple(found)


def repeatability(time: Array, signal: Array, period: float) -> float:
    """Lap to lap: rms difference between ``signal`` and itself one period later; NaN if there is no second lap.

    A model that repeats itself and is right in everything else would still be off by this over the root of 2.
    """
    inside = time[time + period <= time[-1] + 1e-9]
    if not len(inside):
        return math.nan
    later = np.interp(inside + period, time, signal)
    return math.sqrt(float(np.mean((later - signal[: len(inside)]) ** 2)))


def agreement(measured: Array, expected: Array, about: Array | None = None) -> Mapping[str, float]:
    """Figures of a comparison: rms and largest difference; relative and fit in %.

    ``relative`` is rms over the rms of what was measured, ``fit`` is 100*(1 - norm(difference)/norm(measured - mean)).
    Both are those of ``measured - about`` where ``about`` is given: of the tracking error, if it is the reference.
    """
    off = measured - expected
    signal = measured if about is None else measured - about
    rms = math.sqrt(float(np.mean(off**2)))
    size = math.sqrt(float(np.mean(signal**2)))
    variation = float(np.std(signal))
    return {
        "rms": rms,
        "largest": float(np.max(np.abs(off))),
        "relative": 100.0 * rms / size if size > 0.0 else math.nan,
        "fit": 100.0 * (1.0 - rms / variation) if variation > 0.0 else math.nan,
    }
