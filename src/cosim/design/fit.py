"""Fits: free start values of a system, and of its sensors, from records of the real machine.

    fitted = fit("fit.toml", workers=2)
    fitted.values, fitted.estimates, fitted.comparisons

The file is that of ``cosim.design.fit_file``. Least squares over the difference between records and runs in units of
noise: scipy's trust region method with bounds; derivatives are differences of runs, which are done side by side. What
the records cannot tell is named, see ``cosim.design.fit_statistics``.

Source: Branch, Coleman & Li, SIAM J. Scientific Computing 21(1), 1999 (trust region reflective).
"""

from __future__ import annotations

import math
import os
import time as clock_time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np

from ..errors import CosimError, DescriptionError, SimulationError
from ..fmu import tables
from ..result.metrics import Array
from .fit_file import Fit, FitRecord, Output, read_fit
from .fit_runs import Budget, Coordinates, Runs, checked_residuals, expected, residuals
from .fit_statistics import FAR_STEP, NORMAL, Block, Peak, Spread, Weak, agreement, peaks, repeatability, spread

STEP, FINAL_STEP = 3e-3, 1e-2
"""Steps of the differences, in parts of a value: one-sided on the way, central and larger for the intervals.

The error of the integrators is divided by the step; friction is smooth enough for one of a hundredth.
"""

TOLERANCE = 1e-7
"""Relative change of the sum of squares at which the search ends: below 1 for 1e7 samples, so it does not decide."""

HOLD = 0.1
"""Pull towards the start, units of noise for a change of a value by itself.

It holds what the records do not tell; what they tell to 10 % it moves by a ten-thousandth of the way to the start.
"""

OUTLIER = 3.0
"""Units of noise beyond which a robust loss counts a sample less."""

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
"""Each loss of scipy, and its derivative, of a squared residual z in units of OUTLIER."""

Advance = Callable[[int, float], None]
"""Is told the runs so far and the sum of squares over samples of the best."""


@dataclass(frozen=True)
class Estimate:
    """A fitted value."""

    name: str
    unit: str
    start: float
    value: float
    low: float
    """Of the 95 % interval, as ``high``; infinite where the records do not tell."""
    high: float
    deviation: float
    """Standard deviation in ``unit``."""
    told: bool
    at_bound: bool
    effects: Mapping[str, float]
    """By output: rms change of the signal, in its unit, for 1 % more of this value."""


@dataclass(frozen=True)
class Comparison:
    """A record against the system, for one output."""

    record: str
    output: str
    unit: str
    validates: bool
    rms: float
    largest: float
    relative: float
    """rms of the difference over that of the signal, %; of the tracking error where the output has a reference."""
    fit: float
    """100*(1 - norm(difference)/norm(signal - mean)), %."""
    repeatability: float
    """rms difference from lap to lap; NaN if the record names no period."""
    peaks: tuple[Peak, ...]
    """Of the spectrum of the difference."""
    time: Array
    measured: Array
    expected: Array


@dataclass(frozen=True)
class Fitted:
    """What a fit, or the look before one, has found."""

    fit: Fit
    estimates: tuple[Estimate, ...]
    correlation: Array
    weak: tuple[Weak, ...]
    comparisons: tuple[Comparison, ...]
    converged: bool
    message: str
    loops: int
    """Runs of a record."""
    seconds: float
    run_seconds: float
    """Time in runs, over all workers."""
    workers: int
    costs: tuple[float, ...]
    """For each start, sum of squares over samples at its end; infinite if it failed."""

    @property
    def values(self) -> dict[str, float]:
        """Every fitted value by name."""
        return {estimate.name: estimate.value for estimate in self.estimates}

    @property
    def start_values(self) -> dict[str, float]:
        """Fitted start values of all records by INSTANCE.VARIABLE, as ``--set`` and start files take them."""
        return {
            variable: estimate.value
            for free, estimate in zip(self.fit.free, self.estimates, strict=True)
            if not free.record
            for variable in free.variables
        }


def fit(
    source: str | Path | Fit,
    *,
    workers: int | None = None,
    fmus: str | Path | None = None,
    progress: Advance = lambda loops, cost: None,
) -> Fitted:
    """Carry out a fit; ``workers`` processes do runs side by side (default: one a core).

    Raises DescriptionError for a file that is wrong, a value that nothing depends on, a record without excitation;
    SimulationError if the run fails at the starting point.
    """
    return _carried_out(source, workers, fmus, progress, search=True)


def sensitivities(
    source: str | Path | Fit,
    *,
    workers: int | None = None,
    fmus: str | Path | None = None,
    progress: Advance = lambda loops, cost: None,
) -> Fitted:
    """What the records would tell, judged where the values start; nothing is fitted. Raises as ``fit`` does."""
    return _carried_out(source, workers, fmus, progress, search=False)


def _carried_out(
    source: str | Path | Fit, workers: int | None, fmus: str | Path | None, progress: Advance, *, search: bool
) -> Fitted:
    problem = source if isinstance(source, Fit) else read_fit(source, fmus=fmus)
    if workers is not None and workers < 1:
        raise DescriptionError(f"workers: {workers} is not a number of processes. Give 1 or more.")
    count = workers if workers is not None else os.cpu_count() or 1
    begun = clock_time.perf_counter()
    with Runs(problem, count, progress) as runs:
        solver = _Solver(problem, runs)
        solver.check_dependence()
        found = (
            solver.search() if search else _Found(solver.first, solver.cost_at(solver.first), True, "not fitted", ())
        )
        known, effects = solver.knowledge(found.point)
        comparisons = solver.comparisons(found.point)
        estimates = tuple(solver.estimates(found.point, known, effects))
        return Fitted(
            problem,
            estimates,
            known.correlation,
            known.weak,
            comparisons,
            found.converged,
            found.message,
            runs.loops,
            clock_time.perf_counter() - begun,
            runs.run_seconds,
            count,
            found.costs,
        )


@dataclass(frozen=True)
class _Found:
    """The end of a search, in coordinates."""

    point: Array
    cost: float
    converged: bool
    message: str
    costs: tuple[float, ...]


class _Solver:
    """Least squares for one fit."""

    def __init__(self, problem: Fit, runs: Runs) -> None:
        self.fit, self.runs = problem, runs
        self.records = problem.fitted
        self.coordinates = Coordinates(problem.free)
        self.first = self.coordinates.to(np.array([free.start for free in problem.free]))
        self.blocks = list(self._blocks())
        self.best: tuple[float, Array] = (math.inf, self.first)

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
        """Residuals at a point; infinite where a run failed, unless it ``must`` not."""
        point = self.coordinates.back(z)
        of_runs = self.runs.traces([point], self.records)[0]
        off = (checked_residuals if must else residuals)(self.fit, self.records, point, of_runs)
        cost = self._cost(off)
        if cost < self.best[0]:
            self.best = cost, np.array(z)
            self.runs.best = cost
        return off

    def _cost(self, off: Array) -> float:
        """Sum of squares over samples, outliers counted as the loss does."""
        if not np.all(np.isfinite(off)):
            return math.inf
        z = (off / OUTLIER) ** 2
        return OUTLIER**2 * float(np.mean(LOSSES[self.fit.loss][0](z)))

    def cost_at(self, z: Array) -> float:
        """Sum of squares over samples at a point."""
        return self._cost(self.residuals(z, must=True))

    def jacobian(self, z: Array, step: float, *, central: bool) -> Array:
        """Derivative of the residuals by the coordinates. Raises SimulationError where no run succeeds."""
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

    def _held(self, z: Array) -> Array:
        """The residuals, and the pull towards the start."""
        return np.concatenate([self.residuals(z), HOLD * (z - self.first)])

    def _slope(self, z: Array) -> Array:
        """The derivative of ``_held``."""
        return np.vstack([self.jacobian(z, STEP, central=False), HOLD * np.eye(len(z))])

    def check_dependence(self) -> None:
        """Raise DescriptionError for values that nothing depends on."""
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

    # the search

    def search(self) -> _Found:
        """The best end of all starts."""
        random = np.random.default_rng(self.fit.seed)
        ends = [self._from(self.first if not i else self._other(random)) for i in range(self.fit.starts)]
        best = min(ends, key=lambda end: end.cost)
        if not math.isfinite(best.cost):
            raise SimulationError(f"{self.fit.name}: {best.message}")
        costs = tuple(end.cost for end in ends)
        return _Found(best.point, best.cost, best.converged, best.message, costs)

    def _other(self, random: np.random.Generator) -> Array:
        """Another starting point: anywhere between finite bounds, else within a factor of 2."""
        low, high = self.coordinates.low, self.coordinates.high
        low = np.where(np.isfinite(low) & np.isfinite(high), low, np.maximum(self.first - math.log(2.0), low))
        high = np.where(np.isfinite(self.coordinates.low) & np.isfinite(high), high, self.first + math.log(2.0))
        return low + (np.minimum(high, self.coordinates.high) - low) * random.random(len(low))

    def _from(self, begin: Array) -> _Found:
        from scipy import optimize as _optimize

        optimize = cast(Any, _optimize)
        self.best = (math.inf, begin)
        self.runs.best = math.inf
        self.runs.budget = self.runs.loops + self.fit.loops * len(self.records)
        converged, message = False, ""
        try:
            found = optimize.least_squares(
                self._held,
                begin,
                jac=self._slope,
                bounds=(self.coordinates.low, self.coordinates.high),
                x_scale="jac",
                loss=self.fit.loss,
                f_scale=OUTLIER,
                ftol=TOLERANCE,
                xtol=1e-6,
                gtol=None,
            )
            converged, message = bool(found.success), str(found.message).strip("`")
        except Budget:
            message = f"ended after {self.fit.loops} runs of a record, before it converged; loops = ... allows more"
        except (SimulationError, ValueError) as error:
            message = str(error)
        finally:
            self.runs.budget = math.inf
        cost, point = self.best
        return _Found(point, cost, converged, message, (cost,))

    # what is known

    def knowledge(self, z: Array) -> tuple[Spread, list[dict[str, float]]]:
        """How well the values are known at a point, and by value and output the effect of 1 % more."""
        base = self.residuals(z, must=True)
        J = self.jacobian(z, FINAL_STEP, central=True)
        weight = np.sqrt(LOSSES[self.fit.loss][1]((base / OUTLIER) ** 2))

        def look(direction: Array) -> float:
            """Change of the residuals along a direction, by a step that is large beside the errors of integration."""
            ends: list[float] = []
            for sign in (1.0, -1.0):
                moved = np.clip(z + sign * FAR_STEP * direction, self.coordinates.low, self.coordinates.high)
                size = float(np.linalg.norm(moved - z))
                off = self.residuals(moved) if size > 0.5 * FAR_STEP else np.array([np.inf])
                if np.all(np.isfinite(off)):
                    ends.append(float(np.linalg.norm(weight * (off - base))) / size)
            return min(ends, default=math.inf)

        names = [free.name for free in self.fit.free]
        known = spread(names, self.blocks, weight * base, weight[:, None] * J, look)
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

    def estimates(self, z: Array, known: Spread, effects: Sequence[Mapping[str, float]]) -> Sequence[Estimate]:
        """The values with their intervals."""
        value = self.coordinates.back(z)
        slope = self.coordinates.slope(value)
        found: list[Estimate] = []
        for i, free in enumerate(self.fit.free):
            deviation = float(known.deviation[i])
            told = math.isfinite(deviation)
            low, high = -math.inf, math.inf
            if told and free.log:
                low, high = value[i] * math.exp(-NORMAL * deviation), value[i] * math.exp(NORMAL * deviation)
            elif told:
                low, high = (value[i] + sign * NORMAL * deviation * slope[i] for sign in (-1.0, 1.0))
            near = 1e-6 * abs(slope[i])
            at_bound = value[i] - free.low <= near or free.high - value[i] <= near
            found.append(
                Estimate(
                    free.name,
                    free.unit,
                    free.start,
                    float(value[i]),
                    float(low),
                    float(high),
                    deviation * float(slope[i]),
                    told,
                    bool(at_bound),
                    effects[i],
                )
            )
        return found

    def comparisons(self, z: Array) -> tuple[Comparison, ...]:
        """All records against the system, those that validate included."""
        point = self.coordinates.back(z)
        of_runs = self.runs.traces([point], self.fit.records)[0]
        found: list[Comparison] = []
        for record, of_run in zip(self.fit.records, of_runs, strict=True):
            if isinstance(of_run, CosimError):
                raise SimulationError(f"record {record.name}: the run with the fitted values failed: {of_run}")
            found += [
                _compared(record, output, expected(self.fit, record, output, point, of_run))
                for output in self.fit.outputs
            ]
        return tuple(found)


def _compared(record: FitRecord, output: Output, shown: Array) -> Comparison:
    time, measured = record.time[record.part], record.values[output.name][record.part]
    about = record.references.get(output.name)
    figures = agreement(measured, shown, None if about is None else about[record.part])
    laps = math.nan if record.period is None else repeatability(time, measured, record.period)
    found = peaks(time, measured - shown)
    return Comparison(
        record.name,
        output.name,
        output.unit,
        record.validates,
        figures["rms"],
        figures["largest"],
        figures["relative"],
        figures["fit"],
        laps,
        found,
        time,
        measured,
        shown,
    )


def _rms(parts: Sequence[Array]) -> float:
    joined = np.concatenate(parts)
    return math.sqrt(float(np.mean(joined**2)))


def write_start(fitted: Fitted, path: Path, *, base: str | None = None) -> None:
    """Write a system file with the fitted start values; ``base`` is the file it completes. Raises FileError."""
    tables.write_start(path, fitted.start_values, base=base)
