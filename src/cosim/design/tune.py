"""Tuning: parameters of a system that make a figure of merit small while others keep their limits.

A tuning file is TOML::

    system = "step.toml"                       # a system file, relative to this file
    objective = "error_rms"                    # one of the metrics
    generations = 30                           # optional, as are population (15 a parameter) and seed (1)

    [parameters]
    "controller.K_P" = { from = 100.0, to = 2000.0, log = true }
    "controller.K_I" = { from = 0.0, to = 2e5 }

    [limits]                                   # optional: largest value of metrics
    command_tv = 500.0
    error_max = 2e-5

    [metrics]                                  # optional, as in a sweep file
    [experiment]                               # optional, as in a sweep file

Differential evolution (Storn & Price 1997) looks for the least objective. Points are compared by Deb's rules: one
that keeps all limits beats one that does not, of two that do not the one with the smaller sum of relative excesses
wins, so limits need no weights. A run that fails keeps no limit.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from threading import Lock, get_ident
from typing import Any, cast

import numpy as np

from ..errors import CosimError, DescriptionError, suggest
from ..files import write_file
from ..fmu.places import shipped_file
from ..fmu.text import read_toml
from ..master.simulation import Simulation
from ..result.metrics import Array
from .plan import Range, Sweep, make_sweep, measure, read_range

WORST = 1e6
"""Excess of a run that failed."""


@dataclass(frozen=True)
class Tuning:
    """A checked tuning."""

    plan: Sweep
    """System, metrics and window; its points are the middle of the ranges."""
    ranges: tuple[Range, ...]
    objective: str
    limits: Mapping[str, float]
    generations: int
    population: int
    seed: int


@dataclass(frozen=True)
class Trial:
    """One evaluation."""

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
    """Whether it keeps all limits."""
    trials: tuple[Trial, ...]
    generations: int
    message: str


def read_tuning(path: str | Path, *, fmus: str | Path | None = None) -> Tuning:
    """Read and check a tuning file. Raises DescriptionError."""
    path = shipped_file(path)
    document = read_toml(path)
    return make_tuning(document, name=path.name, folder=path.parent, fmus=fmus)


def make_tuning(
    document: Mapping[str, Any], *, name: str = "tuning", folder: str | Path = ".", fmus: str | Path | None = None
) -> Tuning:
    """Check a tuning given as nested tables, as a tuning file holds them."""
    own = ("objective", "limits", "generations", "population", "seed")
    shared_keys = ("system", "description", "parameters", "experiment", "metrics")
    parameters = dict(cast("Mapping[str, Any]", document.get("parameters", {})))
    ranges: list[Range] = []
    known_keys = (*shared_keys, *own)
    problems = [f"{name}: {key}: unknown key.{suggest(key, known_keys)}" for key in document if key not in known_keys]
    for path, given in parameters.items():
        try:
            ranges.append(read_range(path, cast("Mapping[str, Any]", given if isinstance(given, Mapping) else {})))
        except DescriptionError as error:
            problems += [f"{name}: {problem}" for problem in error.problems]
    if problems:
        raise DescriptionError(problems)
    shared = {key: value for key, value in document.items() if key in shared_keys}
    middles = {path: [reach.at(0.5)] for path, reach in zip(parameters, ranges, strict=True)}
    # The ends, too, must be values that the variables take.
    for share in (0.0, 1.0):
        ends = {path: [reach.at(share)] for path, reach in zip(parameters, ranges, strict=True)}
        make_sweep({**shared, "parameters": ends}, name=name, folder=folder, fmus=fmus)
    plan = make_sweep({**shared, "parameters": middles}, name=name, folder=folder, fmus=fmus)
    known = [metric.name for metric in plan.metrics]
    limits = {key: float(value) for key, value in dict(document.get("limits", {})).items()}
    objective = document.get("objective")
    if not isinstance(objective, str):
        raise DescriptionError(f'{name}: objective: missing. Name a metric: objective = "error_rms".')
    for metric in (objective, *limits):
        if known and metric not in known:
            problems.append(f"{name}: '{metric}' is no metric.{suggest(metric, known)}")
    counts: dict[str, int] = {}
    for key, default in (("generations", 30), ("population", 15), ("seed", 1)):
        value = document.get(key, default)
        if not isinstance(value, int) or isinstance(value, bool) or value < 1:
            problems.append(f"{name}: {key}: {value} is not a count of at least 1.")
        else:
            counts[key] = value
    if problems:
        raise DescriptionError(problems)
    return Tuning(plan, tuple(ranges), objective, limits, **counts)


class _Evaluator:
    """Runs of the system at points of the unit cube, by several threads, each with its own simulation."""

    def __init__(self, tuning: Tuning, workers: int, progress: Callable[[int, Trial | None], None]) -> None:
        self.tuning = tuning
        self.trials: list[Trial] = []
        self.best: Trial | None = None
        self.progress = progress
        self._pool = ThreadPoolExecutor(workers)
        self._simulations: dict[int, Simulation] = {}
        self._lock = Lock()

    def close(self) -> None:
        self._pool.shutdown(cancel_futures=True)
        for simulation in self._simulations.values():
            simulation.close()

    def scores(self, shares: Array) -> Array:
        """Objective and excess, shape (2, points), of points given as columns (scipy's vectorized form)."""
        found = list(self._pool.map(self.trial, shares.T))
        for trial in found:
            self.trials.append(trial)
            if self.best is None or _key(trial, self.tuning) < _key(self.best, self.tuning):
                self.best = trial
        self.progress(len(self.trials), self.best)
        return np.array([_key(trial, self.tuning)[::-1] for trial in found]).T

    def trial(self, shares: Sequence[float] | Array) -> Trial:
        """One run; shares of the ranges."""
        tuning = self.tuning
        values = tuple(reach.at(float(share)) for reach, share in zip(tuning.ranges, shares, strict=True))
        simulation = self._simulation()
        try:
            system = tuning.plan.system.changed(dict(zip(tuning.plan.parameters, values, strict=True)))
            figures = measure(simulation.run(system), tuning.plan.metrics, tuning.plan.window)
        except CosimError as error:
            self._discard()
            return Trial(values, {}, WORST, str(error))
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

    def _simulation(self) -> Simulation:
        thread = get_ident()
        with self._lock:
            found = self._simulations.get(thread)
        if found is None:
            found = Simulation(self.tuning.plan.system).__enter__()
            with self._lock:
                self._simulations[thread] = found
        return found

    def _discard(self) -> None:
        """Free the simulation of this thread: an FMU that failed may not be what it was."""
        with self._lock:
            failed = self._simulations.pop(get_ident(), None)
        if failed is not None:
            failed.close()


def _key(trial: Trial, tuning: Tuning) -> tuple[float, float]:
    """What is compared: excess first, then the objective."""
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

    ``workers`` threads evaluate a generation side by side; the result does not depend on them. ``progress`` is told
    the number of runs and the best so far. Raises DescriptionError.
    """
    from scipy import optimize as _optimize

    optimize = cast(Any, _optimize)
    tuning = source if isinstance(source, Tuning) else read_tuning(source, fmus=fmus)
    evaluator = _Evaluator(tuning, workers, progress)

    def objective(shares: Array) -> Any:
        """One number that orders points as Deb's rules do: those that keep all limits lie below 0.5, others above 1."""
        flat = shares.ndim == 1
        scored = evaluator.scores(shares[:, None] if flat else shares)
        ordered = np.arctan(scored[0]) / math.pi
        over = scored[1] > 0.0
        ordered[over] = 1.0 + scored[1][over]
        return float(ordered[0]) if flat else ordered

    try:
        found = optimize.differential_evolution(
            objective,
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
    finally:
        evaluator.close()
    best = evaluator.best
    if best is None or best.excess >= WORST:
        errors = [trial.error for trial in evaluator.trials if trial.error]
        raise DescriptionError(f"no run of {len(evaluator.trials)} succeeded. " + (errors[0] if errors else ""))
    parameters = dict(zip(tuning.plan.parameters, best.values, strict=True))
    trials = tuple(evaluator.trials)
    return Tuned(parameters, best, best.excess == 0.0, trials, int(found.nit), str(found.message))


def write_start(tuned: Tuned, path: Path, *, base: str | None = None) -> None:
    """Write a system file with the values found; ``base`` is the file it completes."""
    lines = [] if base is None else [f'base = "{base}"', ""]
    instances: dict[str, list[str]] = {}
    for name, value in tuned.parameters.items():
        instance, _, variable = name.partition(".")
        instances.setdefault(instance, []).append(f'"{variable}" = {value:.12g}')
    for instance, values in instances.items():
        lines += [f"[instances.{instance}.start]", *values, ""]
    write_file(path, "\n".join(lines))
