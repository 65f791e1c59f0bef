"""Tuning: parameters of a system that make a figure of merit small while others keep their limits.

A tuning file is TOML::

    system = "step.toml"                       # a system file, relative to this file
    objective = "error_rms"                    # one of the metrics
    generations = 30                           # optional, as are population (15 a parameter) and seed (1)
    timeout = 60.0                             # s, limit for a run; optional, as in a sweep file

    [parameters]
    "controller.K_P" = { from = 100.0, to = 2000.0, log = true }
    "controller.K_I" = { from = 0.0, to = 2e5 }

    [limits]                                   # optional: largest value of metrics
    command_tv = 500.0
    error_max = 2e-5

    [metrics]                                  # optional, as in a sweep file
    [experiment]                               # optional, as in a sweep file

Differential evolution (Storn & Price 1997) searches the smallest objective. Points are compared by Deb's rules: a point
that keeps all limits beats a point that does not. Of two points that break limits, the one with the smaller sum of
relative excesses wins. So limits need no weights. A run that fails, crashes or takes too long breaks all limits.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np

from ..errors import CosimError, DescriptionError, suggest
from ..fmu import tables
from ..fmu.places import shipped_file
from ..fmu.tables import checked
from ..fmu.text import read_toml
from ..public import public_names
from ..result.metrics import Array
from ..system.system import System
from .documents import RangeData, TuningData
from .plan import Metric, check_values, figures_of, measure, recording, system_of, variable_of
from .workers import Limit, Loadable, LoadError, Pool, Worker, check_workers

__dir__ = public_names(globals())

EDGE = 0.03
"""A value within this share of its range from an end counts as at the end: the search takes no exact ends."""
WORST = 1e6
"""Excess of a failed run, and the largest excess of any run. It is finite, so that the search can compare points."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Tuning:
    """A checked tuning."""

    system: System
    parameters: tuple[str, ...]
    ranges: tuple[RangeData, ...]
    """Range of each parameter."""
    metrics: tuple[Metric, ...]
    window: tuple[float, float]
    objective: str
    limits: Mapping[str, float]
    generations: int
    population: int
    seed: int
    timeout: float | None = None
    """Time limit of a run in s; None if it is computed from the times of earlier runs."""


@dataclass(frozen=True)
class Trial:
    """One evaluated point."""

    values: tuple[float, ...]
    figures: Mapping[str, float]
    excess: float
    """Sum of the relative excesses over the limits; 0 if all are kept."""
    error: str = ""


@dataclass(frozen=True)
class Tuned:
    """The best point found."""

    parameters: Mapping[str, float]
    best: Trial
    feasible: bool
    """Whether the best point keeps all limits."""
    trials: tuple[Trial, ...]
    generations: int
    message: str
    notes: tuple[str, ...] = ()
    """Sentences on parameters that ended at an end of their range."""


def read_tuning(path: str | Path, *, fmus: str | Path | None = None) -> Tuning:
    """Read and check a tuning file. Raises DescriptionError with every problem found."""
    path = shipped_file(path)
    return make_tuning(read_toml(path), name=path.name, folder=path.parent, fmus=fmus)


def make_tuning(
    document: Mapping[str, Any], *, name: str = "tuning", folder: str | Path = ".", fmus: str | Path | None = None
) -> Tuning:
    """Check a tuning given as nested tables, as a tuning file holds them. Raises DescriptionError with all problems."""
    data, problems = checked(document, TuningData, name)
    if data is None:
        raise DescriptionError(problems)
    system = system_of(data, folder, fmus, problems)
    ranges = tuple(data.parameters.values())
    try:
        variables = {path: variable_of(system, path) for path in data.parameters}
        # The variables must accept the ends of the ranges, too.
        check_values(variables, [tuple(reach.at(share) for reach in ranges) for share in (0.0, 0.5, 1.0)])
    except DescriptionError as error:
        problems += [f"{name}: {problem}" for problem in error.problems]
    wanted, window, found = figures_of(data, system)
    problems += [f"{name}: {problem}" for problem in found]
    known = [metric.name for metric in wanted]
    for key, metric in (("objective", data.objective), *((f"limits.{limit}", limit) for limit in data.limits)):
        if known and metric not in known:
            problems.append(f"{name}: {key}: '{metric}' is no metric.{suggest(metric, known)}")
    if problems:
        raise DescriptionError(problems)
    return Tuning(
        recording(system, wanted),
        tuple(data.parameters),
        ranges,
        wanted,
        window,
        data.objective,
        data.limits,
        data.generations,
        data.population,
        data.seed,
        data.timeout,
    )


class _Evaluator:
    """Runs of the system at points of the unit cube, by several workers."""

    def __init__(self, tuning: Tuning, pool: Pool, progress: Callable[[int, Trial | None], None]) -> None:
        self.tuning = tuning
        self.trials: list[Trial] = []
        self.best: Trial | None = None
        self.progress = progress
        self._system = Loadable.of(tuning.system)
        self._judge = partial(measure, wanted=tuning.metrics, window=tuning.window)
        self._limit = Limit(tuning.timeout)
        self._pool = pool

    def objective(self, shares: Array) -> Any:
        """One number that orders points by Deb's rules: points that keep all limits are below 0.5, others above 1."""
        flat = shares.ndim == 1
        scored = self.scores(shares[:, None] if flat else shares)
        ordered = np.arctan(scored[0]) / math.pi
        over = scored[1] > 0.0
        ordered[over] = 1.0 + scored[1][over]
        return float(ordered[0]) if flat else ordered

    def scores(self, shares: Array) -> Array:
        """Objective and excess, shape (2, points), of points given as columns (scipy's vectorized form)."""
        found = self._pool.map(self.trial, shares.T)
        for trial in found:
            self.trials.append(trial)
            if self.best is None or _key(trial, self.tuning) < _key(self.best, self.tuning):
                self.best = trial
        self.progress(len(self.trials), self.best)
        return np.array([_key(trial, self.tuning)[::-1] for trial in found]).T

    def trial(self, worker: Worker, shares: Array) -> Trial:
        """One run; ``shares`` (0 ... 1) are the positions of the parameters in their ranges."""
        tuning = self.tuning
        values = tuple(reach.at(float(share)) for reach, share in zip(tuning.ranges, shares, strict=True))
        changes = dict(zip(tuning.parameters, values, strict=True))
        try:
            figures = worker.evaluate(self._system, changes, self._judge, self._limit)
        except LoadError:
            raise
        except CosimError as error:
            return Trial(values, {}, WORST, str(error))
        self._limit.learn(worker.seconds)
        missing = [name for name in (tuning.objective, *tuning.limits) if name not in figures]
        if missing:
            raise DescriptionError(f"'{missing[0]}' is no metric of this system.{suggest(missing[0], figures)}")
        excess = 0.0
        for name, limit in tuning.limits.items():
            over = (figures[name] - limit) / max(abs(limit), 1e-300)
            excess += max(0.0, over) if math.isfinite(over) else WORST
        if not math.isfinite(figures[tuning.objective]):
            excess += WORST
        return Trial(values, figures, min(excess, WORST))


def _key(trial: Trial, tuning: Tuning) -> tuple[float, float]:
    """The key that orders trials: the excess first, then the objective."""
    return trial.excess, trial.figures.get(tuning.objective, math.inf) if trial.excess < WORST else WORST


def tune(
    source: str | Path | Tuning,
    *,
    workers: int = 1,
    fmus: str | Path | None = None,
    progress: Callable[[int, Trial | None], None] = lambda done, best: None,
) -> Tuned:
    """Carry out a tuning::

        tuned = tune("gains.toml", workers=2)
        tuned.parameters, tuned.best.figures

    ``workers`` processes evaluate a generation in parallel; the result does not depend on their number. ``progress``
    gets the number of runs and the best trial so far. Raises DescriptionError for a wrong file.
    """
    from scipy import optimize as _optimize

    optimize = cast(Any, _optimize)
    tuning = source if isinstance(source, Tuning) else read_tuning(source, fmus=fmus)
    check_workers(workers)
    with Pool(workers) as pool:
        evaluator = _Evaluator(tuning, pool, progress)
        try:
            found = optimize.differential_evolution(
                evaluator.objective,
                [(0.0, 1.0)] * len(tuning.ranges),
                maxiter=tuning.generations,
                popsize=tuning.population,
                rng=tuning.seed,
                init="sobol",
                polish=False,
                updating="deferred",
                vectorized=True,
                tol=1e-4,
            )
        except KeyboardInterrupt:
            if evaluator.best is not None:
                values = zip(tuning.parameters, evaluator.best.values, strict=True)
                told = ", ".join(f"{name} = {value:.7g}" for name, value in values)
                _log.warning("interrupted after %d runs. The best so far: %s", len(evaluator.trials), told)
            raise
    best = evaluator.best
    if best is None or best.excess >= WORST:
        errors = [trial.error for trial in evaluator.trials if trial.error]
        raise DescriptionError(f"no run of {len(evaluator.trials)} succeeded. " + (errors[0] if errors else ""))
    parameters = dict(zip(tuning.parameters, best.values, strict=True))
    trials = tuple(evaluator.trials)
    notes = tuple(
        f"{name} = {value:.6g} is at the end of its range, {reach.low:g} to {reach.high:g}: a wider range may hold a "
        "better value."
        for (name, value), reach in zip(parameters.items(), tuning.ranges, strict=True)
        if not reach.at(EDGE) < value < reach.at(1.0 - EDGE)
    )
    return Tuned(parameters, best, best.excess == 0.0, trials, int(found.nit), str(found.message), notes)


def write_start(tuned: Tuned, path: Path, *, base: str | None = None) -> None:
    """Write a system file with the values found; ``base`` is the file that it extends. Raises FileError."""
    tables.write_start(path, tuned.parameters, base=base)
