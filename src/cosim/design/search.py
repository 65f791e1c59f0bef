"""The search for the value at which a system begins to oscillate."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

SCAN = 1.15
"""Ratio of neighbouring gains while the limit is not yet passed."""
PRECISION = 1.005
"""Ratio of the first unstable to the last stable gain at the end of a search."""


@dataclass(frozen=True)
class Limit:
    """Where the gain becomes too large, and what it took to find it."""

    stable: float
    """Largest gain found stable; NaN if the first was not."""
    unstable: float
    """Smallest gain found unstable; NaN if none was up to the end of the scan."""
    runs: int

    @property
    def value(self) -> float:
        """The limit: the geometric mean of both."""
        return math.sqrt(self.stable * self.unstable)


def search_limit(
    oscillates: Callable[[float], bool], first: float, last: float, *, scan: float = SCAN, precision: float = PRECISION
) -> Limit:
    """Scan gains upwards from ``first`` by the ratio ``scan`` to the first that oscillates, then bisect.

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
