"""The values of a record at times between its samples, and before and after them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

EQUAL = 0.01
"""Times that differ by less than this fraction of a step count as equal.

Logs round their times, and a product such as ``7*0.1`` is not exactly the decimal number in a file. The step is the
shorter of the record's step and the reader's step.
"""

EXACT = 1e-9
"""The same fraction for linear interpolation. It is so small that it does not change an interpolated value visibly."""

UNEVEN = 0.1
"""A step of time is reported if it differs by more than this fraction from the usual step.

Rounding of the times in logs causes smaller differences.
"""


def usual_step(time: Array) -> float:
    """The usual step of ``time``: the mean if no step is uneven, else the median; 0 for less than two samples."""
    if time.size < 2:
        return 0.0
    steps = np.diff(time)
    median = float(np.median(steps))
    uneven = bool(np.any(np.abs(steps - median) > UNEVEN * median))
    return median if uneven else float(time[-1] - time[0]) / steps.size


class Resampler:
    """Reads samples taken at ``time`` (in s, strictly increasing) at other times, at least ``grid`` seconds apart.

    ``linear``: values are interpolated; else each sample holds until the next. ``repeat``: the record repeats itself.
    """

    def __init__(self, time: Array, *, grid: float = np.inf, linear: bool = False, repeat: bool = False) -> None:
        self.time = time
        self.step = usual_step(time) if time.size > 1 else 1.0
        """The usual step of time in s. A record that repeats itself has this step from its last to its first sample."""
        self.slack = EQUAL * min(self.step, grid)
        self.linear = linear
        self.repeat = repeat

    @property
    def period(self) -> float:
        """The duration of the record in s, including one usual step after the last sample."""
        return float(self.time[-1] - self.time[0]) + self.step

    def outside(self, at: Array) -> NDArray[np.bool_]:
        """For each of the times ``at``, whether it lies before the first or after the last sample."""
        return (at < self.time[0] - self.slack) | (at > self.time[-1] + self.slack)

    def places(self, at: Array) -> tuple[NDArray[np.int_], Array]:
        """The index of the sample at or before each time, and these times within the record. ``at`` must increase."""
        slack = EXACT * self.step if self.linear else self.slack
        if self.repeat:
            rounds: Array = np.floor((at - (self.time[0] - slack)) / self.period)
            at = np.subtract(at, rounds * self.period)
        # The times need few of many samples. A search among only these samples stays in the cache.
        first = max(int(np.searchsorted(self.time, np.min(at))) - 1, 0)
        last = int(np.searchsorted(self.time, np.max(at) + 2.0 * slack, side="right")) + 1
        index = np.searchsorted(self.time[first:last], at + slack, side="right")
        index += first - 1
        np.maximum(index, 0, out=index)
        return index, at

    def slopes(self, samples: Array) -> Array:
        """The slope from each sample to the next, per second. After the last sample it is 0, unless samples repeat."""
        slopes = np.zeros_like(samples)
        steps = np.diff(self.time)
        slopes[:-1] = np.diff(samples, axis=0) / (steps if samples.ndim == 1 else steps[:, np.newaxis])
        if self.repeat:
            slopes[-1] = (samples[0] - samples[-1]) / self.step
        return slopes

    def values(self, samples: Array, at: Array, slopes: Array | None = None) -> Array:
        """The values of ``samples`` at the times ``at``, which must increase; one row for each sample or time.

        Before the record the first sample holds, after it the last sample, unless the record repeats itself. Linear
        interpolation needs ``slopes``; without them they are computed at every call.
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
