"""The integrator of native FMUs (``runtime/integrator.c``) in Python, with the same steps; its source is given there.

It needs no package, keeps nothing between two steps but ``StepProgress``, and has the counts of the native one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

GAMMA, NODE = 0.14, 0.6
TO_NODE = (0.14, 0.133, 0.31, -1.174, 4.361947521865889, -5.725822157434402, 3.2480874635568515, -0.6932128279883382)
TO_END = (
    *(0.14, 0.14, 0.126, 0.6804262113008469, -2.839139247535749, 6.066833263917812, -4.359382201860336),
    1.045261974177426,
)
NODE_IN_STAGE = (0.3888888888888889, -0.1, 1.1925925925925926)
FROM_NODE = (0.0, 0.1361111111111111, 0.06407785336356765, 0.7035903250188964, -0.3250755857898715)
FROM_END = (0.14, 0.0518, 0.04201496598639456, -0.1744299319727891, 0.06561496598639456)
LINEAR_ERROR, REMAINDER_ERROR = 0.625, 1.0 / 32.0
"""The coefficients of ``attempt`` in integrator.c; tests/export/test_integrator.py compares them."""

TOO_SMALL, TOO_MANY, NOT_FINITE = "STEP_TOO_SMALL", "TOO_MANY_STEPS", "NOT_FINITE"
"""Names of the contract's ``REASONS``."""

Vector = list[float]
Matrix = list[list[float]]


@dataclass
class StepProgress:
    """What an instance keeps between steps: the proposed step size in s, and counts in the order of the counters."""

    step: float = 0.0
    counts: list[int] = field(default_factory=lambda: [0] * 5)


class Stopped(Exception):
    """Integration ended early: the reason, the time in s, and the index of the continuous state at fault, or None."""

    def __init__(self, reason: str, time: float, state: int | None) -> None:
        self.reason, self.time, self.state = reason, time, state
        super().__init__(reason)


@dataclass(frozen=True)
class Problem:
    """The equations of one communication step.

    ``derivative`` gives the rates at (t, x). ``linear`` gives the rates, the Jacobian and the time derivatives of the
    rates. ``accepted`` is called after each accepted step.
    """

    derivative: Callable[[float, Sequence[float]], Vector]
    linear: Callable[[float, Sequence[float]], tuple[Vector, Matrix, Vector]]
    accepted: Callable[[float, Sequence[float]], None]
    nominal: Sequence[float]
    tolerance: float
    max_steps: int


def integrate(problem: Problem, progress: StepProgress, t: float, end: float, x: Vector) -> None:
    """Advance ``x`` in place from ``t`` to ``end``. Raises Stopped; ``x`` is then the state at the time it names."""
    step = progress.step if progress.step > 0.0 else end - t
    smallest = 1e-15 * max(abs(t), abs(end))
    attempts, rejected = 0, False
    known: tuple[Vector, Matrix, Vector] | None = None
    counts, progress.step = progress.counts, 0.0
    while t < end:
        left = end - t
        last = step >= 0.999 * left
        h = left if last else min(step, 0.5 * left)
        if attempts >= problem.max_steps:
            raise Stopped(TOO_MANY, t, None)
        attempts += 1
        if known is None:
            known = problem.linear(t, x)
            counts[2] += 1
            counts[3] += 1
            rates, jacobian, by_time = known
            entries = [value for row in jacobian for value in row]
            bad = [*_not_finite(rates), *_not_finite(by_time), *(i // len(x) for i in _not_finite(entries))]
            if bad:
                raise Stopped(NOT_FINITE, t, bad[0])
        y, error, failing = _attempt(problem, counts, (t, h), x, known)
        if error <= 1.0:
            counts[0] += 1
            t = end if last else t + h
            x[:] = y
            problem.accepted(t, x)
            known = None
            following = h * min(1.0 if rejected else 6.0, 0.9 / math.sqrt(math.sqrt(max(error, 1e-8))))
            step = max(step, following) if last and not rejected else following
            rejected = False
        else:
            counts[1] += 1
            rejected = True
            step = 0.5 * h if math.isnan(error) else h * max(0.2, 0.9 / math.sqrt(math.sqrt(error)))
            if step < smallest:
                raise Stopped(NOT_FINITE if math.isnan(error) else TOO_SMALL, t, failing)
    progress.step = step


def _attempt(
    problem: Problem, counts: list[int], times: tuple[float, float], x: Vector, known: tuple[Vector, Matrix, Vector]
) -> tuple[Vector, float, int | None]:
    """One attempt of size h from (t, x): the solution, its error, and the state with the largest error.

    The error is in units of the tolerance, so that errors up to 1 are accepted; NaN if anything is not finite.
    """
    t, h = times
    rates, jacobian, by_time = known
    n = range(len(x))
    w = [[-GAMMA * h * jacobian[i][j] + (1.0 if i == j else 0.0) for j in n] for i in n]
    counts[4] += 1
    if not _invert(w):
        return x, math.nan, None
    linear = [[h * rate for rate in rates]]
    for k in range(len(TO_NODE)):
        linear.append(_times(w, [linear[k][i] + GAMMA * h * h * by_time[i] for i in n]))

    moved, shifted = _combined(linear, TO_NODE)
    rate = problem.derivative(t + NODE * h, [x[i] + moved[i] for i in n])
    counts[2] += 1
    bad = _not_finite(rate)
    if bad:
        return x, math.nan, bad[0]
    at_node = [[(shifted[i] - moved[i]) * (1.0 / GAMMA) + h * rate[i] for i in n]]
    for k in range(len(FROM_NODE)):
        at_node.append(_times(w, at_node[k]))

    moved, shifted = _combined(linear, TO_END)
    solution = list(moved)
    for k, weight in enumerate(NODE_IN_STAGE):
        for i in n:
            moved[i] += weight * at_node[k + 1][i]
            shifted[i] += weight * at_node[k][i]
    rate = problem.derivative(t + h, [x[i] + moved[i] for i in n])
    counts[2] += 1
    bad = _not_finite(rate)
    if bad:
        return x, math.nan, bad[0]
    at_end = [[(shifted[i] - moved[i]) * (1.0 / GAMMA) + h * rate[i] for i in n]]
    for k in range(len(FROM_END)):
        at_end.append(_times(w, at_end[k]))

    y: Vector = []
    largest, failing = 0.0, None
    for i in n:
        v = solution[i]
        for k, (node, end) in enumerate(zip(FROM_NODE, FROM_END, strict=True)):
            v += node * at_node[k + 1][i] + end * at_end[k + 1][i]
        y.append(x[i] + v)
        fourth = linear[4][i] - 4.0 * linear[5][i] + 6.0 * linear[6][i] - 4.0 * linear[7][i] + linear[8][i]
        departure = at_end[2][i] - at_node[2][i] * (1.0 / (NODE * NODE))
        weight = problem.tolerance * (max(abs(x[i]), abs(y[i])) + problem.nominal[i])
        error = (LINEAR_ERROR * abs(fourth) + REMAINDER_ERROR * abs(departure)) / weight
        if not (math.isfinite(y[i]) and math.isfinite(error)):
            return x, math.nan, i
        if error > largest:
            largest, failing = error, i
    return y, largest, failing


def _combined(linear: Sequence[Vector], weights: Sequence[float]) -> tuple[Vector, Vector]:
    """Two weighted sums: of W^(k+1) h f with weights[k], and of W^k h f with weights[k] for k >= 1."""
    moved: Vector = []
    shifted: Vector = []
    for i in range(len(linear[0])):
        v, s = weights[0] * linear[1][i], weights[1] * linear[1][i]
        for k in range(1, len(weights)):
            v += weights[k] * linear[k + 1][i]
        for k in range(2, len(weights)):
            s += weights[k] * linear[k][i]
        moved.append(v)
        shifted.append(s)
    return moved, shifted


def _times(m: Matrix, v: Vector) -> Vector:
    found: Vector = []
    for row in m:
        total = row[0] * v[0]
        for j in range(1, len(v)):
            total += row[j] * v[j]
        found.append(total)
    return found


def _invert(m: Matrix) -> bool:
    """Replace the matrix by its inverse (Gauss-Jordan, partial pivoting); False if it is singular or not finite."""
    n, pivot = len(m), list[int]()
    for k in range(n):
        best = max(range(k, n), key=lambda i: abs(m[i][k]))
        pivot.append(best)
        m[k], m[best] = m[best], m[k]
        reciprocal = 1.0 / m[k][k] if m[k][k] else math.inf
        if not math.isfinite(reciprocal) or reciprocal == 0.0:
            return False
        m[k][k] = 1.0
        m[k] = [value * reciprocal for value in m[k]]
        for i in range(n):
            if i != k:
                factor, m[i][k] = m[i][k], 0.0
                m[i] = [a - factor * b for a, b in zip(m[i], m[k], strict=True)]
    for k in reversed(range(n)):
        for row in m:
            row[k], row[pivot[k]] = row[pivot[k]], row[k]
    return True


def _not_finite(values: Sequence[float]) -> list[int]:
    """Indices of the values that are not finite."""
    return [i for i, value in enumerate(values) if not math.isfinite(value)]
