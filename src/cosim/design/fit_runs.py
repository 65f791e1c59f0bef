"""The runs of a fit: signals of the system for each record at given free values. Several runs are done in parallel."""

from __future__ import annotations

import math
import threading
import time as clock_time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, Self, cast

import numpy as np

from ..errors import CosimError, SimulationError
from ..result.metrics import Array
from ..result.result import Result
from .fit_file import Fit, FitRecord, Free, Output
from .workers import Limit, Loadable, LoadError, Pool, Worker

Traces = Mapping[str, Array]
"""Name of a signal -> its values at the communication points of a run."""

FAR = 1e-9
"""Times in s of a record and of a run are the same if they differ by less.

Rounding of decimal times causes about 1e-12 s; the shortest sampling times are near 1e-6 s.
"""


class Budget(CosimError):
    """The fit has used all the runs that it may do."""


def traces(result: Result, signals: Sequence[str]) -> Traces:
    """The part of a result that a worker sends back: the signals needed."""
    found = {signal: np.ascontiguousarray(result[signal]) for signal in signals}
    return {**found, "": np.ascontiguousarray(result.time)}


class Runs:
    """Carries out the runs of a fit; a context manager.

    The signals of a run are kept: a point that differs in delay, gain or bias of outputs only needs no new run.
    """

    def __init__(self, fit: Fit, workers: int, progress: Callable[[int, float], None]) -> None:
        self.fit = fit
        self.loops = 0
        """Number of runs so far; a run is one simulation of one record."""
        self.run_seconds = 0.0
        """Total time of all runs in s, summed over the workers."""
        self.best = math.inf
        self.budget = math.inf
        """Largest number of runs allowed."""
        self._progress = progress
        self._systems = {record.name: Loadable.of(record.system) for record in fit.records}
        signals = tuple(dict.fromkeys(output.signal for output in fit.outputs))
        self._judge = partial(traces, signals=signals)
        self._limit = Limit(fit.timeout)
        self._pool = Pool(workers)
        self._known: dict[tuple[str, tuple[float, ...]], Traces | CosimError] = {}
        self._lock = threading.Lock()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._pool.stop()

    def traces(self, points: Sequence[Array], records: Sequence[FitRecord]) -> list[list[Traces | CosimError]]:
        """For each point and record the signals, or the error of a failed run.

        Raises LoadError if the FMUs cannot be loaded, Budget if no more runs are allowed.
        """
        wanted = {
            self._key(point, record): (point, record)
            for point in points
            for record in records
            if self._key(point, record) not in self._known
        }
        if self.loops + len(wanted) > self.budget:
            raise Budget(f"the runs are used up: {self.budget:g}.")
        for key, found in zip(wanted, self._pool.map(self._run, wanted.values()), strict=True):
            self._known[key] = found
        return [[self._known[self._key(point, record)] for record in records] for point in points]

    def forget(self) -> None:
        """Free the memory of the signals of all runs so far."""
        self._known.clear()

    def changes(self, point: Array, record: FitRecord) -> dict[str, float]:
        """Start values of the run for a point and a record: INSTANCE.VARIABLE -> value."""
        return {
            variable: float(value)
            for free, value in zip(self.fit.free, point, strict=True)
            if free.record in ("", record.name)
            for variable in free.variables
        }

    def _key(self, point: Array, record: FitRecord) -> tuple[str, tuple[float, ...]]:
        return record.name, tuple(self.changes(point, record).values())

    def _run(self, worker: Worker, what: tuple[Array, FitRecord]) -> Traces | CosimError:
        point, record = what
        begun = clock_time.perf_counter()
        found: Traces | CosimError
        try:
            found = worker.evaluate(self._systems[record.name], self.changes(point, record), self._judge, self._limit)
            self._limit.learn(worker.seconds)
        except LoadError:
            raise
        except CosimError as error:
            found = error
        with self._lock:
            self.loops += 1
            self.run_seconds += clock_time.perf_counter() - begun
            self._progress(self.loops, self.best)
        return found


# ---- from signals to residuals ----


def output_values(fit: Fit, output: Output, point: Array) -> dict[str, float]:
    """Delay, gain and bias of an output at a point."""
    free = {f.part: float(v) for f, v in zip(fit.free, point, strict=True) if f.output == output.name}
    return {**output.fixed, **free}


def expected(fit: Fit, record: FitRecord, output: Output, point: Array, found: Traces) -> Array:
    """Expected values of an output at the samples in the record's window; NaN after the end of an aborted run."""
    values = output_values(fit, output, point)
    time, signal = found[""], found[output.signal]
    wanted = record.time[record.part] - values["delay"]
    return values["gain"] * sampled(time, signal, wanted) + values["bias"]


def sampled(time: Array, signal: Array, wanted: Array) -> Array:
    """``signal`` at the times ``wanted`` in s: its samples if all times agree, else a cubic spline through them."""
    from scipy.interpolate import CubicSpline as _CubicSpline

    at = np.clip(np.searchsorted(time, wanted - FAR), 0, len(time) - 1)
    if bool(np.all(np.abs(time[at] - wanted) <= FAR)):
        return signal[at]
    spline = cast(Any, _CubicSpline)(time, signal, extrapolate=False)
    inside = np.where(np.abs(wanted - time[-1]) <= FAR, time[-1], wanted)
    return cast(Array, spline(np.where(np.abs(inside - time[0]) <= FAR, time[0], inside)))


def residuals(fit: Fit, records: Sequence[FitRecord], point: Array, found: Sequence[Traces | CosimError]) -> Array:
    """(measured - expected)/noise of all records and outputs, joined to one array; infinite where a run failed."""
    parts: list[Array] = []
    for record, of_run in zip(records, found, strict=True):
        for output in fit.outputs:
            measured = record.values[output.name][record.part]
            if isinstance(of_run, CosimError):
                parts.append(np.full(len(measured), np.inf))
                continue
            off = (measured - expected(fit, record, output, point, of_run)) / output.noise
            parts.append(np.where(np.isnan(off), np.inf, off))
    return np.concatenate(parts)


def checked_residuals(
    fit: Fit, records: Sequence[FitRecord], point: Array, found: Sequence[Traces | CosimError]
) -> Array:
    """As ``residuals``, but raises SimulationError if a run failed."""
    for record, of_run in zip(records, found, strict=True):
        if isinstance(of_run, CosimError):
            values = ", ".join(f"{f.name} = {v:.6g} {f.unit}" for f, v in zip(fit.free, point, strict=True))
            raise SimulationError(f"record {record.name}: the run with {values} failed: {of_run}")
    off = residuals(fit, records, point, found)
    if not np.all(np.isfinite(off)):
        raise SimulationError("the run ended before the record does, so they cannot be compared.")
    return off


class Coordinates:
    """Converts free values to coordinates of the solver and back: logarithms, or values divided by their scale."""

    def __init__(self, free: Sequence[Free]) -> None:
        self.free = free
        self.log = np.array([f.log for f in free], dtype=bool)
        self.scale = np.array([f.scale for f in free], dtype=np.float64)
        self.low = self.to(np.array([f.low for f in free]))
        self.high = self.to(np.array([f.high for f in free]))

    def to(self, values: Array) -> Array:
        """Values in the coordinates of the solver."""
        with np.errstate(divide="ignore", invalid="ignore"):
            logarithm = np.log(np.where(self.log, np.maximum(values, 0.0), 1.0))
        return np.where(self.log, logarithm, values / self.scale)

    def back(self, z: Array) -> Array:
        """Coordinates of the solver as values; rounding never moves them out of their bounds."""
        with np.errstate(over="ignore"):
            values = np.where(self.log, np.exp(np.where(self.log, z, 0.0)), z * self.scale)
        return np.clip(values, [f.low for f in self.free], [f.high for f in self.free])

    def slope(self, values: Array) -> Array:
        """Derivative of each value by its coordinate."""
        return np.where(self.log, values, self.scale)
