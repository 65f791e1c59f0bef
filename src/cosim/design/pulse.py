"""Learning of friction pulses: amplitude and duration of the velocity pulse at a reversal, over the acceleration.

Every run of the loop goes through one reversal on a circle at constant speed, so that the reverse acceleration is
speed^2/radius. Runs start ``LEAD_IN`` seconds before the reversal, at that speed, with steady friction, which the
integrator of the controller already compensates. The state at the reversal is saved, and all runs of one acceleration
go on from there. The performance index is J, the rms position error during the monitoring time 2.5*t_c from the
reversal on.

    1. t_c, the time from the reversal to the largest error without pulse, at four accelerations (4 runs)
    2. the duration of the best pulse at these accelerations, the shortest if several are equally good: nine durations
       of 0.5 ... 1.5 t_c, ten amplitudes each (360 runs)
    3. the amplitude at 13 accelerations, eleven coarse steps from A_0 to A_max (143 runs)
    4. the amplitude at these and at the points between, eleven fine steps around the coarse value (275 runs)
    5. a general regression neural network (Nadaraya & Watson) over the logarithm of the acceleration smooths the
       amplitudes; the spread is the one that best predicts each amplitude from the others

The tables hold amplitude and duration at 60 accelerations of equal ratios. A change of friction makes J larger with the
same pulses: if J exceeds 1.5 times its nominal value, the tables have to be learned again.

Source: Feng et al., A novel time-varying friction compensation method for servomechanism, Mathematical Problems in
Engineering 2015; its formulas are not legible and are rebuilt from its text and figures.
"""

from __future__ import annotations

import json
import math
import time as clock_time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import DescriptionError
from ..files import write_file
from ..fmu import tables
from ..public import public_names
from ..result.metrics import Array
from ..system.system import System, read_system
from .names import AxisNames, axis_names
from .quantities import si_factor
from .reversals import LEAD_OUT, Axis, AxisRuns, Job, Pulse

__dir__ = public_names(globals())

ACCELERATIONS = (2e-3, 10e-3, 40e-3, 120e-3)
"""Reverse accelerations at which durations are learned, m/s2; the first and last bound the tables."""
MONITORED = 2.5
"""Monitoring time divided by t_c. It holds the peak of the error and most of its decay."""
SHARES = tuple(0.5 + 0.125 * i for i in range(9))
"""Durations tried, divided by t_c. With 0.7 to 1.3 times the nominal friction, the best ones lie inside this range."""
AMPLITUDES = 10
"""Number of amplitudes tried with each duration: steps of a tenth of the largest, enough to tell durations apart."""
FLAT = 1.02
"""Durations whose J is within this ratio of the least J are equally good, and the shortest is taken. Without this rule,
a difference of one sample in t_c would decide between them."""
TOP = 0.98
"""Samples above this share of the largest error belong to its peak: enough of them for a parabola."""
STEPS = 10
"""Number of steps of the coarse search and of the fine search for the amplitude."""
FINE = 5
"""Number of fine steps in a coarse step. The fine search therefore reaches one coarse step to both sides."""
NODES = 60
"""Number of nodes of the tables: neighbours differ by 7 %."""
RELEARN = 1.5
"""J divided by its nominal value above which friction counts as changed.

A change of friction by 30 % makes it 1.75 or more (study feng2015).
"""


@dataclass(frozen=True)
class Tables:
    """Amplitude and duration over reverse acceleration, SI units."""

    acceleration: Array
    amplitude: Array
    duration: Array

    def at(self, acceleration: float) -> Pulse:
        """Amplitude in m/s and duration in s at an acceleration in m/s2, linear between nodes; the ends are held."""
        return (
            float(np.interp(acceleration, self.acceleration, self.amplitude)),
            float(np.interp(acceleration, self.acceleration, self.duration)),
        )


@dataclass(frozen=True)
class Learned:
    """What was learned for an axis; SI units."""

    t_c: Array
    """Time from the reversal to the largest error without pulse, at ``ACCELERATIONS``."""
    durations: Array
    """Duration of the best pulse, at ``ACCELERATIONS``."""
    accelerations: Array
    """Accelerations of the fine search."""
    amplitudes: Array
    costs: Array
    """J at the amplitudes of the fine search."""
    spread: float
    tables: Tables
    nominal: Array
    """J with the pulses of the tables, at ``ACCELERATIONS``."""
    runs: Mapping[str, int]
    """Stage -> number of runs, without the runs for ``nominal``."""
    seconds: float

    def monitoring_time(self, acceleration: float) -> float:
        """Time in s after a reversal over which J is computed."""
        return MONITORED * log_interpolated(acceleration, self.t_c)


def log_interpolated(acceleration: float, values: Array) -> float:
    """Interpolation of ``values`` at ``ACCELERATIONS``, linear in both logarithms; the ends are held."""
    return math.exp(float(np.interp(math.log(acceleration), np.log(ACCELERATIONS), np.log(values))))


# Learning


def learn_friction_pulse(
    source: str | Path | System,
    axis: Axis | str = "",
    *,
    overrides: Mapping[str, object] | None = None,
    acceleration_max: float = 1.0,
    rise_time: float | None = None,
    alpha: float = 0.1,
    radius: float = 0.05,
    workers: int = 1,
    timeout: float | None = None,
    fmus: str | Path | None = None,
    progress: Callable[[str, int, int], None] = lambda stage, done, total: None,
) -> Learned:
    """Learn the tables of an axis::

        learned = learn_friction_pulse("studies/feng2015/circle.toml", "x")
        learned.tables.amplitude

    The largest amplitude is ``acceleration_max`` (m/s2) times ``rise_time`` in s of the pulse (default: that of the
    pulse's instance). The smallest amplitude of the coarse search is ``alpha`` times the largest. ``radius`` of the
    circle is in m. ``workers`` processes share the runs of a stage; ``timeout`` in s is the limit for a run.
    ``progress`` gets the stage, the number of runs done and the total. Raises DescriptionError for a wrong system or
    axis, ProcessError for a run that crashes or hangs.
    """
    axis = Axis.named(axis) if isinstance(axis, str) else axis
    system = (source if isinstance(source, System) else read_system(source, fmus=fmus)).changed(overrides)
    if rise_time is None:
        name = axis.names.pulse.rise_time
        variable = system.variable(axis.pulse, name)
        given = float(system.instance(axis.pulse).start.get(name, variable.start or 0.0))
        rise_time = si_factor(system, f"{axis.pulse}.{name}", "s") * given
    with AxisRuns(system, axis, radius=radius, workers=workers, timeout=timeout) as runs:
        return _learn(runs, acceleration_max * rise_time, alpha, progress)


def _learn(runs: AxisRuns, A_max: float, alpha: float, progress: Callable[[str, int, int], None]) -> Learned:
    begun = clock_time.perf_counter()
    total = len(ACCELERATIONS) * (1 + len(SHARES) * AMPLITUDES) + (13 + 25) * (STEPS + 1)
    counts: dict[str, int] = {}

    def done(stage: str) -> None:
        counts[stage] = runs.count - sum(counts.values())
        progress(stage, runs.count, total)

    unhelped = runs.errors([(a, [(0.0, 0.0)], LEAD_OUT) for a in ACCELERATIONS])
    t_c = np.array([peak_time(error[0]) * runs.T_s for error in unhelped])
    done("peak")

    A_0, dA = alpha * A_max, (A_max - alpha * A_max) / STEPS
    pulses = [
        [(A_max * (i + 1) / AMPLITUDES, share * float(peak)) for share in SHARES for i in range(AMPLITUDES)]
        for peak in t_c
    ]
    costs = runs.costs(
        [(a, tried, MONITORED * float(peak)) for a, tried, peak in zip(ACCELERATIONS, pulses, t_c, strict=True)]
    )
    least = [np.min(np.reshape(cost, (len(SHARES), AMPLITUDES)), axis=1) for cost in costs]
    chosen = [int(np.flatnonzero(low <= FLAT * np.min(low))[0]) for low in least]
    durations = np.array([SHARES[i] * float(peak) for i, peak in zip(chosen, t_c, strict=True)])
    done("duration")

    def best(accelerations: Array, amplitudes: Sequence[np.ndarray[Any, Any]]) -> tuple[Array, Array]:
        jobs: list[Job] = []
        for a, tried in zip((float(a) for a in accelerations), amplitudes, strict=True):
            T = log_interpolated(a, durations)
            jobs.append((a, [(float(A), T) for A in tried], MONITORED * log_interpolated(a, t_c)))
        found = runs.costs(jobs)
        at = [int(np.argmin(cost)) for cost in found]
        return (
            np.array([tried[i] for tried, i in zip(amplitudes, at, strict=True)]),
            np.array([cost[i] for cost, i in zip(found, at, strict=True)]),
        )

    grid = coarse_grid()
    coarse, _ = best(grid, [A_0 + dA * np.arange(STEPS + 1)] * grid.size)
    done("coarse")
    fine_grid = np.sort(np.append(grid, 0.5 * (grid[1:] + grid[:-1])))
    centres = np.interp(fine_grid, grid, coarse)
    offsets = dA / FINE * np.arange(STEPS + 1) - dA
    amplitudes, fine_costs = best(fine_grid, [np.maximum(float(centre) + offsets, 0.0) for centre in centres])
    done("fine")

    spread = best_spread(fine_grid, amplitudes)
    nodes = np.geomspace(ACCELERATIONS[0], ACCELERATIONS[-1], NODES)
    nodes[0], nodes[-1] = ACCELERATIONS[0], ACCELERATIONS[-1]
    tables = Tables(
        nodes,
        regression(nodes, fine_grid, amplitudes, spread),
        np.array([log_interpolated(float(a), durations) for a in nodes]),
    )
    nominal = table_costs(runs, tables, t_c)
    seconds = clock_time.perf_counter() - begun
    return Learned(t_c, durations, fine_grid, amplitudes, fine_costs, spread, tables, nominal, counts, seconds)


def table_costs(runs: AxisRuns, tables: Tables, t_c: Array) -> Array:
    """J at ``ACCELERATIONS`` with the pulses of ``tables``."""
    jobs = [(a, [tables.at(a)], MONITORED * float(peak)) for a, peak in zip(ACCELERATIONS, t_c, strict=True)]
    return np.array([cost[0] for cost in runs.costs(jobs)])


def peak_time(error: Array) -> float:
    """Position of the largest magnitude in samples, from a parabola fitted to the samples of the peak.

    Rounding of the error makes the top flat, so that the largest sample alone is not unique. Raises DescriptionError
    for an error without a peak.
    """
    size = np.abs(error)
    top = int(np.argmax(size))
    low = top - int(np.argmin(size[top::-1] >= TOP * size[top]))
    high = top + int(np.argmin(size[top:] >= TOP * size[top]))
    if not low < top < high or size[top] <= 0.0:
        raise DescriptionError("the error does not peak after a reversal: there is no friction to learn from.")
    at = np.arange(low + 1, high) - top
    if at.size < 3:
        return float(top)
    bend, slope, _ = (float(value) for value in np.polyfit(at, size[low + 1 : high], 2))
    return float(top) if bend >= 0.0 else top - 0.5 * slope / bend


def coarse_grid() -> Array:
    """The 13 accelerations of the coarse search: four equal steps between neighbours in ``ACCELERATIONS``."""
    parts = [np.linspace(low, high, 5)[:-1] for low, high in pairwise(ACCELERATIONS)]
    return np.append(np.concatenate(parts), ACCELERATIONS[-1])


def regression(at: Array, points: Array, values: Array, spread: float) -> Array:
    """Nadaraya & Watson's mean of ``values`` at ``points``, with Gaussian weights over the logarithm of the points."""
    exponent = -((np.log(at)[:, None] - np.log(points)[None, :]) ** 2) / (2.0 * spread**2)
    weights = np.exp(exponent - np.max(exponent, axis=1, keepdims=True))
    return np.asarray(weights @ values / np.sum(weights, axis=1), dtype=np.float64)


def best_spread(points: Array, values: Array) -> float:
    """The spread, out of 40, that best predicts each value from the others."""
    median = float(np.median(np.diff(np.log(points))))

    def miss(spread: float) -> float:
        total = 0.0
        for i in range(points.size):
            others = np.arange(points.size) != i
            total += float(regression(points[i : i + 1], points[others], values[others], spread)[0] - values[i]) ** 2
        return total

    return min((float(spread) for spread in np.geomspace(0.05, 3.0, 40) * median), key=miss)


# Monitoring


@dataclass(frozen=True)
class Monitored:
    """J of an axis with given tables, and its nominal value."""

    acceleration: float
    J: float
    nominal: float

    @property
    def ratio(self) -> float:
        """J divided by its nominal value."""
        return self.J / self.nominal


def monitor(
    source: str | Path | System,
    learned: Learned,
    axis: Axis | str = "",
    *,
    overrides: Mapping[str, object] | None = None,
    radius: float = 0.05,
    timeout: float | None = None,
    fmus: str | Path | None = None,
) -> list[Monitored]:
    """J with the learned pulses over the learned monitoring times; above the ratio ``RELEARN``, learn again.

    ``timeout`` and errors are as in ``learn_friction_pulse``.
    """
    axis = Axis.named(axis) if isinstance(axis, str) else axis
    system = (source if isinstance(source, System) else read_system(source, fmus=fmus)).changed(overrides)
    with AxisRuns(system, axis, radius=radius, timeout=timeout) as runs:
        found = table_costs(runs, learned.tables, learned.t_c)
    return [
        Monitored(a, float(J), float(nominal))
        for a, J, nominal in zip(ACCELERATIONS, found, learned.nominal, strict=True)
    ]


# Files


def save(learned: Learned, path: Path) -> None:
    """Write what was learned as JSON, for ``load``. Raises FileError."""
    content = {
        "t_c": learned.t_c.tolist(),
        "durations": learned.durations.tolist(),
        "accelerations": learned.accelerations.tolist(),
        "amplitudes": learned.amplitudes.tolist(),
        "costs": learned.costs.tolist(),
        "spread": learned.spread,
        "tables": {name: values.tolist() for name, values in vars(learned.tables).items()},
        "nominal": learned.nominal.tolist(),
        "runs": dict(learned.runs),
        "seconds": learned.seconds,
    }
    write_file(path, json.dumps(content, indent=1) + "\n")


def load(path: Path) -> Learned:
    """Read a file that ``save`` has written. Raises DescriptionError for any other file."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        arrays = {name: np.array(content[name]) for name in ("t_c", "durations", "accelerations", "amplitudes")}
        tables = Tables(
            **{name: np.array(content["tables"][name]) for name in ("acceleration", "amplitude", "duration")}
        )
        return Learned(
            **arrays,
            costs=np.array(content["costs"]),
            spread=float(content["spread"]),
            tables=tables,
            nominal=np.array(content["nominal"]),
            runs=content["runs"],
            seconds=float(content["seconds"]),
        )
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise DescriptionError(f"{path}: holds nothing learned: {error}") from None


def write_start(
    learned: Mapping[str, Learned],
    path: Path,
    *,
    base: str | None = None,
    names: AxisNames | None = None,
    system: System | None = None,
) -> None:
    """Write a system file that gives each pulse instance its tables; ``base`` is the file that it extends.

    The tables are in the units of ``system``, or in SI units without it. Raises FileError; DescriptionError if the
    units of ``system`` do not fit.
    """
    pulse = (names or axis_names()).pulse
    values: dict[str, Any] = {}
    for instance, result in learned.items():
        values |= {f"{instance}.{name}": value for name, value in pulse.table.items()}
        for name, unit, nodes in (
            (pulse.table_acceleration, "m/s2", result.tables.acceleration),
            (pulse.table_amplitude, "m/s", result.tables.amplitude),
            (pulse.table_duration, "s", result.tables.duration),
        ):
            factor = 1.0 if system is None else si_factor(system, f"{instance}.{name}", unit)
            values[f"{instance}.{name}"] = (nodes / factor).tolist()
    tables.write_start(path, values, base=base, digits=9)


def plot_learned(learned: Mapping[str, Learned], path: Path) -> None:
    """Draw amplitudes and durations over the acceleration: the values found and the tables.

    Raises DescriptionError for an unknown ending, FileError if the file cannot be written.
    """
    from ..result.plots import Panel, Series, plot_panels

    amplitude: list[Series] = []
    duration: list[Series] = []
    for i, (name, result) in enumerate(learned.items()):
        tables = result.tables
        amplitude.append(Series(f"{name} found", result.accelerations, result.amplitudes, 2 * i, dashed=True))
        amplitude.append(Series(f"{name} table", tables.acceleration, tables.amplitude, 2 * i))
        duration.append(Series(name, tables.acceleration, tables.duration, 2 * i))
    panels = [Panel("Amplitude", "m/s", tuple(amplitude)), Panel("Duration", "s", tuple(duration))]
    plot_panels(path, panels, x_quantity="Reverse acceleration", x_unit="m/s2")
