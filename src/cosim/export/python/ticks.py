"""The samples that a communication step of a controller covers: the arithmetic of ``sampling.c`` for Python FMUs.

An importer may add up its time, t += h: in a long run the sum drifts from k*h by many samples. If the step and the
sampling time have a simple ratio, both are counted in ticks, a common fraction of them: then counts decide which
samples are due, and the sampling instants move with the importer's clock. Otherwise the time decides. This module
travels inside Python FMUs.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass

EPSILON = sys.float_info.epsilon

SAME_TICK = 1e-6
"""Two counts of ticks that differ by less than this are equal. Counts are whole unless counting began between ticks."""
MOST_TICKS, MOST_PER_SAMPLE = 1e9, 1e5
"""Largest ticks of a step and of a sampling time.

With more ticks a count is no longer exact to ``SAME_TICK``, and any ratio of step and sampling time would pass as a
fraction.
"""

Fraction = tuple[float, float]
"""Number of ticks in a step, and number of ticks in a sampling time; (0, 0) if there is no such fraction."""


def fraction_of(step: float, T_s: float, slack: float) -> Fraction:
    """The simplest fraction step/T_s that is right to within ``slack``, by its continued fraction (arguments in s)."""
    most = min(MOST_PER_SAMPLE, math.sqrt(0.01 * T_s / slack))
    rest, p, p_last, q, q_last = step / T_s, 1.0, 0.0, 0.0, 1.0
    while math.isfinite(rest):
        whole = math.floor(rest)
        p, p_last, q, q_last = whole * p + p_last, p, whole * q + q_last, q
        if p > MOST_TICKS or q > most:
            break
        if p >= 1.0 and abs(p * T_s - q * step) <= q * slack:
            return float(p), float(q)
        if rest == whole:
            break
        rest = 1.0 / (rest - whole)
    return 0.0, 0.0


def whole_if_near(number: float, slack: float) -> float:
    """The number itself, or the nearest whole number if it is within ``slack``."""
    whole = math.floor(number + 0.5)
    return float(whole) if abs(number - whole) <= slack else number


def same_instant(T_s: float, time: float) -> float:
    """Largest difference in s of two times that count as the same sampling instant.

    It is 1e-6 of ``T_s`` and the rounding of ``time``, but at most a quarter of ``T_s``, so that no time belongs to two
    instants.
    """
    return min(1e-6 * T_s + 8.0 * EPSILON * abs(time), 0.25 * T_s)


@dataclass
class Ticks:
    """Where a controller is between its samples. ``core.c`` explains the fields of the same names."""

    origin: float = 0.0
    sample: int = 0
    per_sample: float = 0.0
    ahead: float = 0.0
    step: float = 0.0
    step_ticks: float = 0.0
    step_per_sample: float = 0.0

    def instant(self, T_s: float, ahead: int = 0) -> float:
        """Time in s on the importer's clock of the next sampling instant, or of the one ``ahead`` instants later."""
        return self.origin + (self.sample + ahead) * T_s

    def at_instant(self, T_s: float, time: float) -> bool:
        """Whether ``time``, at which the last step ended, is a sampling instant."""
        if self.per_sample > 0.0:
            return self.ahead <= SAME_TICK
        return abs(time - self.instant(T_s)) <= same_instant(T_s, time)

    def begin(self, T_s: float, time: float, step: float) -> float:
        """Move the count to the beginning of a step; returns the number of samples in the step."""
        end, near = time + step, same_instant(T_s, time)
        difference = end - time == step  # a difference of two times is only as exact as the times are
        if step != self.step or (difference and self.step_per_sample == 0.0):
            slack = EPSILON * (32.0 * step + (2.0 * abs(end) if difference else 0.0))
            self.step = step
            self.step_ticks, self.step_per_sample = fraction_of(step, T_s, slack)
        if self.per_sample > 0.0:
            drift = time + self.ahead / self.per_sample * T_s - self.instant(T_s)
            if abs(drift) > 0.5 * near:
                self.origin += drift
        n = self.step_per_sample
        if n != self.per_sample:
            if self.per_sample > 0.0:
                self.ahead = whole_if_near(self.ahead / self.per_sample * n, SAME_TICK)
            else:
                self.ahead = max(0.0, whole_if_near((self.instant(T_s) - time) / T_s * n, near / T_s * n))
            self.per_sample = n
        if n > 0.0:
            last = self.step_ticks - SAME_TICK
            return math.floor((last - self.ahead) / n) + 1.0 if self.ahead < last else 0.0
        return self._by_time(T_s, end - near)

    def _by_time(self, T_s: float, last: float) -> float:
        """The number of sampling instants before the time ``last``."""
        samples = (last - self.instant(T_s)) / T_s
        if samples > MOST_TICKS:
            return samples
        due = max(0, math.ceil(samples))
        while due > 0 and self.instant(T_s, due - 1) >= last:
            due -= 1
        while self.instant(T_s, due) < last:
            due += 1
        return float(due)

    def is_sound(self) -> bool:
        """Whether the values are consistent; they may come from a saved FMU state."""
        counts = (self.per_sample, self.step_per_sample)
        return (
            math.isfinite(self.origin)
            and 0 <= self.sample < 2**53
            and all(n == 0.0 or 1.0 <= n <= MOST_PER_SAMPLE for n in counts)
            and 0.0 <= self.ahead <= MOST_TICKS
            and 0.0 <= self.step_ticks <= MOST_TICKS
        )

    def end(self, samples: float) -> None:
        """Move the count to the end of a step in which ``samples`` samples were taken."""
        if self.per_sample > 0.0:
            self.ahead += samples * self.per_sample - self.step_ticks
