"""Which samples a communication step of a controller holds: the arithmetic of ``core.c`` for the Python flavour.

An importer may add up its time, t += h: in a long run the sum drifts from k*h by many samples. So where a step is a
fraction or a multiple of the sampling time, ticks are counted, and the sampling instants move with the importer's
clock; elsewhere time decides. This module travels inside Python FMUs.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass

EPSILON = sys.float_info.epsilon

SAME_TICK = 1e-6
"""Two counts of ticks are equal if they differ by less: counts are whole, unless counting began between ticks."""
MOST_TICKS, MOST_PER_SAMPLE = 1e9, 1e5
"""Beyond these a count is no longer exact to ``SAME_TICK``, and any number would be a fraction."""

Fraction = tuple[float, float]
"""Ticks of a step, and ticks that make a sampling time; (0, 0) if there is no such fraction."""
NONE: Fraction = (0.0, 0.0)


def fraction_of(step: float, T_s: float, slack: float) -> Fraction:
    """The simplest fraction of ``T_s`` that ``step`` is to within ``slack`` (all in s), from its continued fraction."""
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
    return NONE


def whole_if_near(number: float, slack: float) -> float:
    """The number, or the whole number next to it if that is within ``slack``."""
    whole = math.floor(number + 0.5)
    return float(whole) if abs(number - whole) <= slack else number


def same_instant(T_s: float, time: float) -> float:
    """Two times are one sampling instant if they differ by no more, s."""
    return min(1e-6 * T_s + 8.0 * EPSILON * abs(time), 0.25 * T_s)


@dataclass
class Ticks:
    """Where a controller is between its samples. The fields mean what they mean in ``core.c``."""

    origin: float = 0.0
    sample: int = 0
    per_sample: float = 0.0
    ahead: float = 0.0
    step: float = 0.0
    step_ticks: float = 0.0
    step_per_sample: float = 0.0

    def instant(self, T_s: float, ahead: int = 0) -> float:
        """The next sampling instant on the importer's clock, or the one so many behind it, s."""
        return self.origin + (self.sample + ahead) * T_s

    def at_instant(self, T_s: float, time: float) -> bool:
        """Whether ``time``, at which the last step ended, is a sampling instant."""
        if self.per_sample > 0.0:
            return self.ahead <= SAME_TICK
        return abs(time - self.instant(T_s)) <= same_instant(T_s, time)

    def begin(self, T_s: float, time: float, step: float) -> float:
        """Bring the count to the beginning of a step; the number of samples in the step."""
        end, near = time + step, same_instant(T_s, time)
        difference = end - time == step  # taken between two times it is only as exact as these are
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
        """The number of instants before ``last``."""
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
        """Whether one can go on with these values, wherever they come from."""
        counts = (self.per_sample, self.step_per_sample)
        return (
            math.isfinite(self.origin)
            and 0 <= self.sample < 2**53
            and all(n == 0.0 or 1.0 <= n <= MOST_PER_SAMPLE for n in counts)
            and 0.0 <= self.ahead <= MOST_TICKS
            and 0.0 <= self.step_ticks <= MOST_TICKS
        )

    def end(self, samples: float) -> None:
        """Move the count to the end of a step in which so many samples were taken."""
        if self.per_sample > 0.0:
            self.ahead += samples * self.per_sample - self.step_ticks
