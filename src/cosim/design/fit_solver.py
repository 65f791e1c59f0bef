"""The search of a fit: least squares over runs, and the uncertainty of the values found.

Source: Branch, Coleman & Li, SIAM J. Scientific Computing 21(1), 1999 (trust region reflective).
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from ..errors import DescriptionError, SimulationError
from ..result.metrics import Array
from .fit_file import Fit
from .fit_runs import Budget, Coordinates, Runs, checked_residuals, residuals
from .fit_statistics import FAR_STEP, Block, Look, Spread, spread, untold

STEP, FINAL_STEP = 3e-3, 1e-2
"""Steps of the finite differences as shares of a value: one-sided in the search, central and larger for the intervals.

The error of the integrators is divided by the step, so the step must not be small. Friction is smooth enough for a step
of a hundredth.
"""

TOLERANCE = 1e-6
"""The search ends at this relative change of the sum of squares.

With up to 1e6 samples it is a change of less than 1 of the sum of squares in units of noise, which is not significant.
"""

ENDS: Mapping[int, str] = {
    0: "ended before it converged",
    2: "converged: the sum of squares changes no more",
    3: "converged: the values change no more",
    4: "converged: neither the sum of squares nor the values change",
}
"""Status of scipy's ``least_squares`` -> message."""

OUTLIER = 3.0
"""A robust loss gives less weight to samples with a residual above this many units of noise."""

_log = logging.getLogger(__name__)

Function = Callable[[Array], Array]

LOSSES: Mapping[str, tuple[Function, Function]] = {
    "linear": (np.array, np.ones_like),
    "soft_l1": (lambda z: 2.0 * (np.sqrt(1.0 + z) - 1.0), lambda z: 1.0 / np.sqrt(1.0 + z)),
    "huber": (
        lambda z: np.where(z <= 1.0, z, 2.0 * np.sqrt(z) - 1.0),
        lambda z: np.where(z <= 1.0, 1.0, 1.0 / np.sqrt(np.maximum(z, 1.0))),
    ),
    "cauchy": (np.log1p, lambda z: 1.0 / (1.0 + z)),
}
"""Loss of scipy -> the loss and its derivative as functions of z = (residual/OUTLIER)^2."""


@dataclass(frozen=True)
class Found:
    """The end of a search, in the coordinates of the solver."""

    point: Array
    cost: float
    converged: bool
    message: str
    costs: tuple[float, ...]


class Solver:
    """Least squares for one fit."""

    def __init__(self, problem: Fit, runs: Runs) -> None:
        self.fit, self.runs = problem, runs
        self.records = problem.fitted
        self.coordinates = Coordinates(problem.free)
        self.first = self.coordinates.to(np.array([free.start for free in problem.free]))
        self.blocks = list(self._blocks())
        self.best: tuple[float, Array] = (math.inf, self.first)
        self.held: list[int] = []
        """Indices of the values that keep their start: the records do not tell them together with the others."""

    def _blocks(self) -> Sequence[Block]:
        blocks: list[Block] = []
        at = 0
        for record in self.records:
            for output in self.fit.outputs:
                size = record.part.stop - record.part.start
                blocks.append(Block(record.name, output.name, slice(at, at + size)))
                at += size
        return blocks

    # residuals and their derivatives

    def residuals(self, z: Array, *, must: bool = False) -> Array:
        """Residuals at a point; infinite where a run failed. With ``must``, raises SimulationError instead."""
        point = self.coordinates.back(z)
        of_runs = self.runs.traces([point], self.records)[0]
        off = (checked_residuals if must else residuals)(self.fit, self.records, point, of_runs)
        cost = self._cost(off)
        if cost < self.best[0]:
            self.best = cost, np.array(z)
            self.runs.best = cost
        return off

    def _cost(self, off: Array) -> float:
        """Sum of the loss of all residuals, divided by the number of samples."""
        if not np.all(np.isfinite(off)):
            return math.inf
        z = (off / OUTLIER) ** 2
        return OUTLIER**2 * float(np.mean(LOSSES[self.fit.loss][0](z)))

    def cost_at(self, z: Array) -> float:
        """``_cost`` at a point. Raises SimulationError if a run fails."""
        return self._cost(self.residuals(z, must=True))

    def jacobian(self, z: Array, step: float, *, central: bool) -> Array:
        """Derivative of the residuals by the coordinates, shape (residuals, coordinates).

        Raises SimulationError if no run around the point succeeds.
        """
        base = self.residuals(z, must=True)
        low, high = self.coordinates.low, self.coordinates.high
        points: list[tuple[int, Array]] = []
        for i in range(len(z)):
            signs = (1.0, -1.0) if central else (1.0 if z[i] + step <= high[i] else -1.0,)
            for sign in signs:
                moved = np.array(z)
                moved[i] = np.clip(z[i] + sign * step, low[i], high[i])
                if moved[i] != z[i]:
                    points.append((i, moved))
        values = [self.coordinates.back(moved) for _, moved in points]
        found = self.runs.traces(values, self.records)
        J = np.zeros((len(base), len(z)))
        for i in range(len(z)):
            sides = [
                (moved[i], residuals(self.fit, self.records, value, of_runs))
                for (j, moved), value, of_runs in zip(points, values, found, strict=True)
                if j == i
            ]
            sides = [(at, off) for at, off in sides if np.all(np.isfinite(off))]
            if not sides:
                raise SimulationError(f"no run near {self.fit.free[i].name} = {self.fit.free[i].start:g} succeeds.")
            (at, off), (other, beside) = sides[0], sides[1] if len(sides) > 1 else (z[i], base)
            J[:, i] = (off - beside) / (at - other)
        self.runs.forget()
        return J

    def look_around(self) -> None:
        """Find the values that have to be held. Raises DescriptionError for values that no output depends on."""
        J = self.jacobian(self.first, FINAL_STEP, central=False)
        dead = [free for free, column in zip(self.fit.free, J.T, strict=True) if not np.any(column)]
        if dead:
            outputs = ", ".join(output.signal for output in self.fit.outputs)
            raise DescriptionError(
                [
                    f"{self.fit.name}: {free.name} is free, but nothing depends on it: {outputs} stay the same to the "
                    f"last bit when it changes by 1 %. Do not free it, or switch on what it belongs to."
                    for free in dead
                ]
            )
        self.held = untold(J, self.look(self.first))

    # the search

    def search(self) -> Found:
        """The best end of the searches from all starting points. Raises SimulationError if all of them failed."""
        random = np.random.default_rng(self.fit.seed)
        ends: list[Found] = []
        try:
            for i in range(self.fit.starts):
                ends.append(self._from(self.first if not i else self._other(random)))
        except KeyboardInterrupt:
            cost, point = min([*((end.cost, end.point) for end in ends), self.best], key=lambda end: end[0])
            if math.isfinite(cost):
                values = zip(self.fit.free, self.coordinates.back(point), strict=True)
                told = ", ".join(f"{free.name} = {value:.7g}" for free, value in values)
                _log.warning("interrupted after %d runs of a record. The best values so far: %s", self.runs.loops, told)
            raise
        best = min(ends, key=lambda end: end.cost)
        if not math.isfinite(best.cost):
            raise SimulationError(f"{self.fit.name}: {best.message}")
        costs = tuple(end.cost for end in ends)
        return Found(best.point, best.cost, best.converged, best.message, costs)

    def _other(self, random: np.random.Generator) -> Array:
        """Another starting point: anywhere between finite bounds, else within a factor of 2."""
        low, high = self.coordinates.low, self.coordinates.high
        low = np.where(np.isfinite(low) & np.isfinite(high), low, np.maximum(self.first - math.log(2.0), low))
        high = np.where(np.isfinite(self.coordinates.low) & np.isfinite(high), high, self.first + math.log(2.0))
        return low + (np.minimum(high, self.coordinates.high) - low) * random.random(len(low))

    def _from(self, begin: Array) -> Found:
        from scipy import optimize as _optimize

        optimize = cast(Any, _optimize)
        self.best = (math.inf, begin)
        self.runs.best = math.inf
        self.runs.budget = self.runs.loops + self.fit.loops * len(self.records)
        converged, message = False, ""
        free = np.setdiff1d(np.arange(len(begin)), self.held)

        def whole(moving: Array) -> Array:
            """The whole point: moving and held coordinates."""
            z = np.array(self.first)
            z[free] = moving
            return z

        def off(moving: Array) -> Array:
            return self.residuals(whole(moving))

        def slope(moving: Array) -> Array:
            return self.jacobian(whole(moving), STEP, central=False)[:, free]

        try:
            found = optimize.least_squares(
                off,
                begin[free],
                jac=slope,
                bounds=(self.coordinates.low[free], self.coordinates.high[free]),
                x_scale="jac",
                loss=self.fit.loss,
                f_scale=OUTLIER,
                ftol=TOLERANCE,
                xtol=1e-6,
                gtol=None,
            )
            converged, message = bool(found.success), ENDS.get(int(found.status), str(found.message))
        except Budget:
            message = f"ended after {self.fit.loops} runs of a record, before it converged; loops = ... allows more"
        except (SimulationError, ValueError) as error:
            message = str(error)
        finally:
            self.runs.budget = math.inf
        cost, point = self.best
        return Found(point, cost, converged, message, (cost,))

    # uncertainty

    def knowledge(self, z: Array) -> tuple[Spread, list[dict[str, float]]]:
        """How well the values are known at a point; and for each value: output -> effect of 1 % more."""
        base = self.residuals(z, must=True)
        J = self.jacobian(z, FINAL_STEP, central=True)
        weight = self._weight(base)
        names = [free.name for free in self.fit.free]
        known = spread(names, self.blocks, weight * base, weight[:, None] * J, self.look(z))
        effects: list[dict[str, float]] = []
        for i, free in enumerate(self.fit.free):
            share = 0.01 if free.log or free.start == 0.0 else 0.01 * abs(z[i])
            effects.append(
                {
                    output.name: share
                    * output.noise
                    * _rms([J[b.part, i] for b in self.blocks if b.output == output.name])
                    for output in self.fit.outputs
                }
            )
        return known, effects

    def look(self, z: Array) -> Look:
        """A function for the change of the residuals along a direction from ``z``; infinite where no run succeeds."""

        def change(direction: Array) -> Array:
            base = self.residuals(z, must=True)
            found = np.full(len(base), np.inf)
            for sign in (1.0, -1.0):
                moved = np.clip(z + sign * FAR_STEP * direction, self.coordinates.low, self.coordinates.high)
                size = float(np.linalg.norm(moved - z))
                off = self.residuals(moved) if size > 0.5 * FAR_STEP else found
                by_step = self._weight(base) * (off - base) / max(size, 1e-300)
                if np.linalg.norm(by_step) < np.linalg.norm(found):
                    found = by_step
            return found

        return change

    def _weight(self, off: Array) -> Array:
        """Square root of the weight that the loss gives to each residual."""
        return np.sqrt(LOSSES[self.fit.loss][1]((off / OUTLIER) ** 2))


def _rms(parts: Sequence[Array]) -> float:
    joined = np.concatenate(parts)
    return math.sqrt(float(np.mean(joined**2)))
