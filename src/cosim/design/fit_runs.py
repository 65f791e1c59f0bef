"""The runs of a fit: what the system gives in each record for values of what is free, several runs side by side."""

from __future__ import annotations

import math
import threading
import time as clock_time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, Self, cast

import numpy as np

from ..errors import CosimError, SimulationError
from ..result.metrics import Array
from ..result.result import Result
from .fit_file import Fit, FitRecord, Free, Output
from .workers import Limit, Loadable, LoadError, Worker, Workers

Traces = Mapping[str, Array]
"""Signals of a run by name, over its communication points."""

FAR = 1e-9
"""Times of a record and of a run that differ by less, in s, are the same."""


class Budget(CosimError):
    """The runs of a fit are used up."""


def traces(result: Result, signals: Sequence[str]) -> Traces:
    """What a worker sends back of a run."""
    found = {signal: np.ascontiguousarray(result[signal]) for signal in signals}
    return {**found, "": np.ascontiguousarray(result.time)}


class Runs:
    """Carries out the runs of a fit; a context manager.

    A run that was done is kept: values that only change outputs (delay, gain, bias) need no run of their own.
    """

    def __init__(self, fit: Fit, workers: int, progress: Callable[[int, float], None]) -> None:
        self.fit = fit
        self.loops = 0
        """Runs of a record so far."""
        self.run_seconds = 0.0
        """Time in runs, over all workers."""
        self.best = math.inf
        self.budget = math.inf
        """Runs that may be done."""
        self._progress = progress
        self._systems = {record.name: Loadable.of(record.system) for record in fit.records}
        signals = tuple(dict.fromkeys(output.signal for output in fit.outputs))
        self._judge = partial(traces, signals=signals)
        self._limit = Limit(fit.timeout)
        self._workers = Workers()
        self._pool = ThreadPoolExecutor(workers)
        self._known: dict[tuple[str, tuple[float, ...]], Traces | CosimError] = {}
        self._lock = threading.Lock()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._pool.shutdown(wait=False, cancel_futures=True)
        self._workers.stop()
        self._pool.shutdown()

    def traces(self, points: Sequence[Array], records: Sequence[FitRecord]) -> list[list[Traces | CosimError]]:
        """For each point and record the signals, or why there are none. Raises LoadError, Budget."""
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
        """Free the signals of all runs so far."""
        self._known.clear()

    def changes(self, point: Array, record: FitRecord) -> dict[str, float]:
        """Start values of a run."""
        return {
            variable: float(value)
            for free, value in zip(self.fit.free, point, strict=True)
            if free.record in ("", record.name)
            for variable in free.variables
        }

    def _key(self, point: Array, record: FitRecord) -> tuple[str, tuple[float, ...]]:
        return record.name, tuple(self.changes(point, record).values())

    def _run(self, what: tuple[Array, FitRecord]) -> Traces | CosimError:
        point, record = what
        worker: Worker = self._workers.mine()
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
    """What the record should show of an output, in its window; NaN after the end of a run that ended early."""
    values = output_values(fit, output, point)
    time, signal = found[""], found[output.signal]
    wanted = record.time[record.part] - values["delay"]
    return values["gain"] * sampled(time, signal, wanted) + values["bias"]


def sampled(time: Array, signal: Array, wanted: Array) -> Array:
    """``signal`` at the times ``wanted``: its own samples where times agree, else a cubic spline through them."""
    from scipy.interpolate import CubicSpline as _CubicSpline

    at = np.clip(np.searchsorted(time, wanted - FAR), 0, len(time) - 1)
    if bool(np.all(np.abs(time[at] - wanted) <= FAR)):
        return signal[at]
    spline = cast(Any, _CubicSpline)(time, signal, extrapolate=False)
    inside = np.where(np.abs(wanted - time[-1]) <= FAR, time[-1], wanted)
    return cast(Array, spline(np.where(np.abs(inside - time[0]) <= FAR, time[0], inside)))


def residuals(fit: Fit, records: Sequence[FitRecord], point: Array, found: Sequence[Traces | CosimError]) -> Array:
    """Record less expectation over noise, of all records and outputs in a row; infinite where a run failed."""
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
    """The residuals. Raises SimulationError where a run failed."""
    for record, of_run in zip(records, found, strict=True):
        if isinstance(of_run, CosimError):
            values = ", ".join(f"{f.name} = {v:.6g} {f.unit}" for f, v in zip(fit.free, point, strict=True))
            raise SimulationError(f"record {record.name}: the run with {values} failed: {of_run}")
    off = residuals(fit, records, point, found)
    if not np.all(np.isfinite(off)):
        raise SimulationError("the run ended before the record does, so they cannot be compared.")
    return off


class Coordinates:
    """Free values as the solver sees them: logarithms, or shares of their scale."""

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
        """The values, inside their bounds whatever rounding does."""
        with np.errstate(over="ignore"):
            values = np.where(self.log, np.exp(np.where(self.log, z, 0.0)), z * self.scale)
        return np.clip(values, [f.low for f in self.free], [f.high for f in self.free])

    def slope(self, values: Array) -> Array:
        """Change of a value with its coordinate."""
        return np.where(self.log, values, self.scale)
