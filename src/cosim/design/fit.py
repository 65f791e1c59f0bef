"""Fits: free start values of a system, and of its sensors, from records of the real machine.

    fitted = fit("fit.toml", workers=2)
    fitted.values, fitted.estimates, fitted.comparisons

``cosim.design.fit_file`` describes the file. A fit minimizes the squares of the differences between records and runs,
in units of noise, by scipy's trust region method with bounds. Derivatives are differences of runs, which are carried
out in parallel. The result names values that the records cannot tell, see ``cosim.design.fit_statistics``.
"""

from __future__ import annotations

import json
import math
import os
import time as clock_time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from ..errors import CosimError, SimulationError
from ..files import write_file
from ..fmu import tables
from ..public import public_names
from ..result.metrics import Array
from .fit_file import Fit, FitRecord, Output, read_fit
from .fit_runs import Runs, expected
from .fit_solver import Found, Solver
from .fit_statistics import NORMAL, Peak, Spread, Weak, agreement, peaks, repeatability
from .workers import check_workers

__dir__ = public_names(globals(), "Fit", "read_fit")

ALIKE = 0.99
"""Pairs of values with a larger correlation are reported: the records hardly tell them apart."""

Advance = Callable[[int, float], None]
"""Function called with the number of runs so far and the best sum of squares divided by the number of samples."""


@dataclass(frozen=True)
class Estimate:
    """A fitted value."""

    name: str
    unit: str
    start: float
    value: float
    low: float
    """Lower end of the 95 % interval, whose upper end is ``high``; infinite if the records do not tell the value."""
    high: float
    deviation: float
    """Standard deviation in ``unit``."""
    told: bool
    at_bound: bool
    effects: Mapping[str, float]
    """Output -> rms change of its signal, in the unit of the signal, if this value is 1 % larger."""


@dataclass(frozen=True)
class OutputFit:
    """The comparison of a record with the system, for one output."""

    record: str
    output: str
    unit: str
    validates: bool
    rms: float
    largest: float
    relative: float
    """rms of the difference in % of the rms of the signal, or of the tracking error if the output has a reference."""
    fit: float
    """100*(1 - norm(difference)/norm(signal - mean)), %."""
    repeatability: float
    """rms difference from lap to lap; NaN if the record names no period."""
    peaks: tuple[Peak, ...]
    """Peaks in the spectrum of the difference."""
    time: Array
    measured: Array
    expected: Array


@dataclass(frozen=True, repr=False)
class Fitted:
    """The result of ``fit`` or ``sensitivities``."""

    fit: Fit
    estimates: tuple[Estimate, ...]
    correlation: Array
    weak: tuple[Weak, ...]
    comparisons: tuple[OutputFit, ...]
    converged: bool
    message: str
    held: tuple[str, ...]
    """Values that kept their start: the records do not tell them together with the others."""
    loops: int
    """Number of runs; a run is one simulation of one record."""
    seconds: float
    run_seconds: float
    """Total time of all runs in s, summed over the workers."""
    workers: int
    costs: tuple[float, ...]
    """For each starting point, the final sum of squares divided by the number of samples; infinite if it failed."""

    def __repr__(self) -> str:
        values = ", ".join(
            f"{e.name} = {e.value:.5g}"
            + (f" +- {0.5 * (e.high - e.low):.2g}" if e.told else " (not told)")
            + f" {e.unit}"
            for e in self.estimates
        )
        return f"<Fitted {self.fit.name}: {values}; {self.message}>"

    @property
    def values(self) -> dict[str, float]:
        """Every fitted value by name."""
        return {estimate.name: estimate.value for estimate in self.estimates}

    @property
    def findings(self) -> tuple[str, ...]:
        """Sentences for the user on values that are not told, that are correlated, that are at a bound or were held."""
        found = [str(weak) for weak in self.weak]
        if self.held:
            found.append(f"While the others were fitted, {', '.join(self.held)} stayed at the start.")
        told = [i for i, estimate in enumerate(self.estimates) if estimate.told]
        for i in told:
            for j in told:
                if i < j and abs(self.correlation[i, j]) > ALIKE:
                    names = f"{self.estimates[i].name} and {self.estimates[j].name}"
                    found.append(f"{names} are hard to tell apart: their correlation is {self.correlation[i, j]:.4f}.")
        for estimate in self.estimates:
            if estimate.at_bound:
                found.append(f"{estimate.name} ends at its bound, {estimate.value:.6g} {estimate.unit}.")
        if not self.converged:
            found.append(f"The fit did not converge: {self.message}.")
        return tuple(found)

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
    """Carry out a fit; ``workers`` processes run in parallel (default: one for each core).

    Raises DescriptionError for a wrong file, a value that no output depends on, or a record without excitation;
    SimulationError if the run at the starting point fails.
    """
    return _carried_out(source, workers, fmus, progress, search=True)


def sensitivities(
    source: str | Path | Fit,
    *,
    workers: int | None = None,
    fmus: str | Path | None = None,
    progress: Advance = lambda loops, cost: None,
) -> Fitted:
    """How well the records tell the values, judged at the start values; no value is fitted. Raises as ``fit`` does."""
    return _carried_out(source, workers, fmus, progress, search=False)


def _carried_out(
    source: str | Path | Fit, workers: int | None, fmus: str | Path | None, progress: Advance, *, search: bool
) -> Fitted:
    problem = source if isinstance(source, Fit) else read_fit(source, fmus=fmus)
    count = workers if workers is not None else os.cpu_count() or 1
    check_workers(count)
    begun = clock_time.perf_counter()
    with Runs(problem, count, progress) as runs:
        solver = Solver(problem, runs)
        solver.look_around()
        found = solver.search() if search else Found(solver.first, solver.cost_at(solver.first), True, "not fitted", ())
        known, effects = solver.knowledge(found.point)
        comparisons = _comparisons(solver, found.point)
        estimates = tuple(_estimates(solver, found.point, known, effects))
        return Fitted(
            problem,
            estimates,
            known.correlation,
            known.weak,
            comparisons,
            found.converged,
            found.message,
            tuple(problem.free[i].name for i in solver.held) if search else (),
            runs.loops,
            clock_time.perf_counter() - begun,
            runs.run_seconds,
            count,
            found.costs,
        )


def _estimates(solver: Solver, z: Array, known: Spread, effects: Sequence[Mapping[str, float]]) -> Sequence[Estimate]:
    """The values with their intervals."""
    value = solver.coordinates.back(z)
    slope = solver.coordinates.slope(value)
    found: list[Estimate] = []
    for i, free in enumerate(solver.fit.free):
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


def _comparisons(solver: Solver, z: Array) -> tuple[OutputFit, ...]:
    """The comparisons of all records with the system, including the records for validation."""
    point = solver.coordinates.back(z)
    of_runs = solver.runs.traces([point], solver.fit.records)[0]
    found: list[OutputFit] = []
    for record, of_run in zip(solver.fit.records, of_runs, strict=True):
        if isinstance(of_run, CosimError):
            raise SimulationError(f"record {record.name}: the run with the fitted values failed: {of_run}")
        found += [
            _compared(record, output, expected(solver.fit, record, output, point, of_run))
            for output in solver.fit.outputs
        ]
    return tuple(found)


def _compared(record: FitRecord, output: Output, shown: Array) -> OutputFit:
    time, measured = record.time[record.part], record.values[output.name][record.part]
    about = record.references.get(output.name)
    figures = agreement(measured, shown, None if about is None else about[record.part])
    laps = math.nan if record.period is None else repeatability(time, measured, record.period)
    found = peaks(time, measured - shown)
    return OutputFit(
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


def summary(fitted: Fitted) -> dict[str, Any]:
    """The result of a fit as values for JSON, without the signals."""
    names = [estimate.name for estimate in fitted.estimates]
    return {
        "parameters": {
            e.name: {key: value for key, value in vars(e).items() if key != "name"} for e in fitted.estimates
        },
        "correlation": {
            a: {b: float(fitted.correlation[i, j]) for j, b in enumerate(names)} for i, a in enumerate(names)
        },
        "comparisons": [
            {
                **{k: v for k, v in vars(c).items() if k not in ("time", "measured", "expected", "peaks")},
                "peaks": [vars(peak) for peak in c.peaks],
            }
            for c in fitted.comparisons
        ],
        "noise": {output.name: output.noise for output in fitted.fit.outputs},
        "findings": list(fitted.findings),
        "converged": fitted.converged,
        "message": fitted.message,
        "costs": list(fitted.costs),
        "loops": fitted.loops,
        "seconds": fitted.seconds,
        "run_seconds": fitted.run_seconds,
        "workers": fitted.workers,
    }


def write_fit(fitted: Fitted, folder: Path, *, base: str | None = None) -> list[Path]:
    """Write start.toml, fit.json, and for each record NAME.csv with its measured and expected signals.

    ``base`` is the system file that start.toml extends. Returns the paths. Raises FileError.
    """
    start = folder / "start.toml"
    write_start(fitted, start, base=base)
    written = [start, write_file(folder / "fit.json", json.dumps(_finite(summary(fitted)), indent=2) + "\n")]
    for record in dict.fromkeys(comparison.record for comparison in fitted.comparisons):
        found = [comparison for comparison in fitted.comparisons if comparison.record == record]
        columns: dict[str, tuple[str, Array]] = {"time": ("s", found[0].time)}
        for c in found:
            columns |= {f"{c.output} measured": (c.unit, c.measured), f"{c.output} expected": (c.unit, c.expected)}
        lines = [",".join(columns), ",".join(unit for unit, _ in columns.values())]
        rows = zip(*(values.tolist() for _, values in columns.values()), strict=True)
        lines += [",".join(map(repr, row)) for row in rows]
        written.append(write_file(folder / f"{record}.csv", "\n".join(lines) + "\n"))
    return written


def _finite(value: Any) -> Any:
    """``value`` as JSON allows it: infinity and NaN become null."""
    if isinstance(value, dict):
        return {str(key): _finite(item) for key, item in cast("dict[Any, Any]", value).items()}
    if isinstance(value, list):
        return [_finite(item) for item in cast("list[Any]", value)]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def write_start(fitted: Fitted, path: Path, *, base: str | None = None) -> None:
    """Write a system file with the fitted start values; ``base`` is the file that it extends. Raises FileError."""
    tables.write_start(path, fitted.start_values, base=base)
