"""The search for the value at which a system begins to oscillate."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

SCAN = 1.15
"""Ratio of neighbouring gains in the upward scan, before the limit is passed.

A larger ratio might jump over a narrow unstable range; a smaller one takes more runs.
"""
PRECISION = 1.005
"""Ratio of the first unstable to the last stable gain at the end of a search: the limit is known to 0.5 %."""


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


def search_limit(
    oscillates: Callable[[float], bool], first: float, last: float, *, scan: float = SCAN, precision: float = PRECISION
) -> Limit:
    """Scan gains from ``first`` upwards by the ratio ``scan`` until one oscillates, then bisect down to ``precision``.

    Stability need not be monotone at low gain, so the limit is sought only between the last stable and the first
    unstable gain of the upward scan.
    """
    runs, stable, gain = 0, math.nan, first
    while gain <= last * (1.0 + 1e-9):
        runs += 1
        if oscillates(gain):
            break
        stable, gain = gain, gain * scan
    else:
        return Limit(stable, math.nan, runs)
    unstable = gain
    while math.isfinite(stable) and unstable / stable > precision:
        middle = math.sqrt(stable * unstable)
        runs += 1
        if oscillates(middle):
            unstable = middle
        else:
            stable = middle
    return Limit(stable, unstable, runs)
