"""The values of a record between its samples, and beyond them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

EQUAL = 0.01
"""Times that differ by less than this fraction of a step are equal: logs round them, and products such as ``7*0.1`` are
not the decimals that a file holds. The step is the shorter one of the record and of those who read it."""

EXACT = 1e-9
"""The same where values between samples are wanted: less than what interpolation could show."""


class Resampler:
    """Samples at rising ``time``, read at other times, which are ``grid`` seconds apart or more."""

    def __init__(self, time: Array, *, grid: float = np.inf, linear: bool = False, repeat: bool = False) -> None:
        self.time = time
        self.step = float(np.median(np.diff(time))) if time.size > 1 else 1.0
        """The usual step of time, that from the last sample to the first where the record repeats itself."""
        self.slack = EQUAL * min(self.step, grid)
        self.linear = linear
        self.repeat = repeat

    @property
    def period(self) -> float:
        """What the record lasts, a usual step behind its last sample included."""
        return float(self.time[-1] - self.time[0]) + self.step

    def outside(self, at: Array) -> NDArray[np.bool_]:
        """Which times lie before the first or after the last sample."""
        return (at < self.time[0] - self.slack) | (at > self.time[-1] + self.slack)

    def places(self, at: Array) -> tuple[NDArray[np.int_], Array]:
        """For each of the times ``at``, which rise, the sample at or before it, and the times in the record."""
        slack = EXACT * self.step if self.linear else self.slack
        if self.repeat:
            rounds: Array = np.floor((at - (self.time[0] - slack)) / self.period)
            at = np.subtract(at, rounds * self.period)
        # Few samples out of many: a search among them alone stays in the cache.
        first = max(int(np.searchsorted(self.time, np.min(at))) - 1, 0)
        last = int(np.searchsorted(self.time, np.max(at) + 2.0 * slack, side="right")) + 1
        index = np.searchsorted(self.time[first:last], at + slack, side="right")
        index += first - 1
        np.maximum(index, 0, out=index)
        return index, at

    def slopes(self, samples: Array) -> Array:
        """The change of ``samples`` a second from each to the next: 0 behind the last one, unless they repeat."""
        slopes = np.zeros_like(samples)
        steps = np.diff(self.time)
        slopes[:-1] = np.diff(samples, axis=0) / (steps if samples.ndim == 1 else steps[:, np.newaxis])
        if self.repeat:
            slopes[-1] = (samples[0] - samples[-1]) / self.step
        return slopes

    def values(self, samples: Array, at: Array, slopes: Array | None = None) -> Array:
        """The values of ``samples``, one line a sample, at the rising times ``at``.

        Where the record does not repeat itself, the first and the last sample hold beyond its ends. Who asks often
        gives the ``slopes`` of the samples, which interpolation needs.
        """
        index, at = self.places(at)
        found: Array = samples.take(index, axis=0)
        if not self.linear:
            return found
        beyond = np.subtract(at, self.time.take(index))
        beyond *= beyond > EXACT * self.step
        rise: Array = (self.slopes(samples) if slopes is None else slopes).take(index, axis=0)
        rise *= beyond if samples.ndim == 1 else beyond[:, np.newaxis]
        rise += found
        return rise
