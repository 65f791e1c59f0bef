"""When a signal oscillates, and the search for the value at which a system begins to."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import cast

import numpy as np

from ..errors import DescriptionError
from ..result.metrics import Array

SCAN = 1.15
"""Ratio of neighbouring gains in the upward scan, before the limit is passed.

A larger ratio might jump over a narrow unstable range; a smaller one takes more runs.
"""
PRECISION = 1.005
"""Ratio of the first unstable to the last stable gain at the end of a search: the limit is known to 0.5 %."""
SWING = 50e-9
"""Smallest peak-to-peak value in m that counts as an oscillation."""
KEPT = 0.8
"""A sustained oscillation keeps at least this share of its size from the third quarter of a run to the last.

Oscillations that decay lose more; beats of a sustained one lose less.
"""
CROSSINGS = 8
"""Least number of zero crossings in the last quarter; a signal with fewer is a creep, not an oscillation."""


@dataclass(frozen=True)
class Oscillation:
    """The oscillation at the end of a step response."""

    size: float
    """Peak to peak over the last quarter, trend removed, in the unit of the signal."""
    frequency: float
    """Frequency in Hz."""
    sustained: bool


def oscillation(time: Array, signal: Array, *, swing: float = SWING) -> Oscillation:
    """Whether a signal still oscillates at the end of the record.

    The linear trend of each quarter is removed. The signal oscillates if the peak-to-peak value of the last quarter is
    above ``swing`` and at least 0.8 times that of the quarter before, and if the last quarter crosses zero 8 times. The
    third condition excludes a slow creep. ``time`` is in s, ``swing`` in the unit of the signal; both signals have the
    shape (samples,). Raises DescriptionError for fewer than 64 samples.
    """
    quarter = time.size // 4
    if quarter < 16:
        raise DescriptionError(f"{time.size} samples are too few to judge an oscillation.")

    def detrended(part: slice) -> Array:
        t, y = time[part] - time[part][0], signal[part]
        slope, offset = cast("tuple[float, float]", np.polyfit(t, y, 1))
        return y - (slope * t + offset)

    before, last = detrended(slice(-2 * quarter, -quarter)), detrended(slice(-quarter, None))
    size, earlier = float(np.ptp(last)), float(np.ptp(before))
    signs = np.signbit(last)
    crossings = int(np.count_nonzero(signs[1:] != signs[:-1]))
    frequency = 0.5 * crossings / (quarter * float(time[1] - time[0]))
    return Oscillation(size, frequency, size > swing and size >= KEPT * earlier and crossings >= CROSSINGS)


@dataclass(frozen=True)
class Limit:
    """The limit of a gain, and the number of runs that the search took."""

    stable: float
    """Largest gain found stable; NaN if the first gain was unstable."""
    unstable: float
    """Smallest gain found unstable; NaN if all gains of the scan were stable."""
    runs: int

    @property
    def value(self) -> float:
        """The limit: the geometric mean of ``stable`` and ``unstable``."""
        return math.sqrt(self.stable * self.unstable)


def search_limit(oscillates: Callable[[float], bool], first: float, last: float) -> Limit:
    """Scan gains from ``first`` upwards by the ratio ``SCAN`` until one oscillates, then bisect to ``PRECISION``.

    Stability need not be monotone at low gain, so the limit is sought only between the last stable and the first
    unstable gain of the upward scan. Raises DescriptionError for ends that are not finite and above 0.
    """
    if not (0.0 < first < first * SCAN and first <= last < math.inf):
        raise DescriptionError(f"gains from {first:g} to {last:g}: must be finite, above 0, and not fall.")
    runs, stable, gain = 0, math.nan, first
    while gain <= last * (1.0 + 1e-9):
        runs += 1
        if oscillates(gain):
            break
        stable, gain = gain, gain * SCAN
    else:
        return Limit(stable, math.nan, runs)
    unstable = gain
    while math.isfinite(stable) and unstable / stable > PRECISION:
        middle = math.sqrt(stable * unstable)
        runs += 1
        if oscillates(middle):
            unstable = middle
        else:
            stable = middle
    return Limit(stable, unstable, runs)
