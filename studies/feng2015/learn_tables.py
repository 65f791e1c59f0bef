"""Learn the tables of the friction pulse: amplitude and duration over reverse acceleration, for both axes.

Each run starts 0.6 s before a velocity reversal on a circle of 50 mm at constant speed, in steady friction, and is
judged by the rms error J from the reversal to 2.5 times the time t_c at which the uncompensated error peaks:

    1. t_c at four accelerations (4 runs)
    2. the duration of the best pulse there, the shortest if several are equally good: nine durations around t_c times
       ten amplitudes (360 runs)
    3. the amplitude at 13 accelerations, in eleven coarse steps (143 runs)
    4. the amplitude at these and the points between, in eleven fine steps around the coarse value (275 runs)
    5. a general regression neural network over the logarithm of the acceleration smooths the amplitudes; its spread
       is the best of 40 by leave-one-out validation; the tables are 60 nodes of the smoothed amplitudes and durations

This script has its own fast loop of axis and controller (LuGre friction, eight substeps per sample). It uses no part of
the FMUs, so that the FMUs can check the tables independently. ``python learn_tables.py`` writes ``learned.toml``,
``circle_pulse.toml`` and ``out_and_back_pulse.toml`` beside itself, in some ten seconds.

Source: Feng et al., A novel time-varying friction compensation method for servomechanism, Mathematical Problems in
Engineering 2015, 269391; the formulas are not legible and the procedure is rebuilt from text and figures.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

try:
    from numba import njit  # pyright: ignore[reportAssignmentType]
except ModuleNotFoundError:
    # One run takes a second in plain Python; for all 782 of them install numba (extra "references").
    def njit(function):  # type: ignore[no-untyped-def]
        return function


Array = NDArray[np.float64]
HERE = Path(__file__).parent

T_S, SUBSTEPS = 2.5e-4, 8
K_POS, OMEGA_V, T_I, FILTER, FORCE_MAX = 40.0, 250.0, 0.02, 5e-4, 4000.0
GRATING, ENCODER = 1e-7, 0.01 / 2**20
RISE, A_MAX, ALPHA = 2e-3, 2e-3, 0.1
A_0 = ALPHA * A_MAX
ACCELERATIONS = np.array([2e-3, 10e-3, 40e-3, 120e-3])
RADIUS, LEAD_IN, LEAD_OUT = 0.05, 0.6, 0.5
NODES = 60
FLAT = 1.02
"""Durations whose J is within this ratio of the least J are equally good."""


@dataclass(frozen=True)
class Axis:
    """Mass and friction of an axis at the table, SI."""

    mass: float
    F_C: float
    F_S: float
    v_s: float
    sigma_0: float
    sigma_1: float
    sigma_2: float

    def scaled(self, factor: float) -> Axis:
        """The same axis with other Coulomb and static friction."""
        return Axis(self.mass, factor * self.F_C, factor * self.F_S, self.v_s, self.sigma_0, self.sigma_1, self.sigma_2)

    @property
    def values(self) -> tuple[float, ...]:
        return self.mass, self.F_C, self.F_S, self.v_s, self.sigma_0, self.sigma_1, self.sigma_2


AXES = {
    "x": Axis(380.0, 90.0, 115.0, 2e-3, 1.8e7, 2.5e4, 400.0),
    "y": Axis(430.0, 140.0, 180.0, 2.5e-3, 2e7, 3e4, 600.0),
}


@njit
def track(ref, v_start, axis, pulse):  # type: ignore[no-untyped-def]
    """Error of the table in m at each sample of ``ref`` except the last; friction is steady at the start."""
    mass, F_C, F_S, v_s, sigma_0, sigma_1, sigma_2 = axis
    amplitude, duration = pulse
    rise = min(RISE, 0.5 * duration) if duration > 0.0 else 1.0
    samples = len(ref) - 1
    error = np.zeros(samples)
    level = F_C + (F_S - F_C) * math.exp(-((v_start / v_s) ** 2))
    x, v, z = ref[0], v_start, level / sigma_0 * np.sign(v_start)
    integral = level * np.sign(v_start) + sigma_2 * v_start
    K_vel, h = mass * OMEGA_V, T_S / SUBSTEPS
    a = math.exp(-T_S / FILTER)
    v_hat, read_last, increment_last = v_start, 0.0, ref[1] - ref[0]
    moving, since, sense = 0.0, -1, 0.0
    for k in range(samples):
        error[k] = ref[k] - x
        increment = ref[k + 1] - ref[k]
        read = math.floor(x / ENCODER + 0.5) * ENCODER
        if k > 0:
            v_hat = a * v_hat + (1.0 - a) * (read - read_last) / T_S
        read_last = read
        if increment != 0.0:
            if moving != 0.0 and np.sign(increment) != moving:
                since, sense = 0, np.sign(increment)
            moving = np.sign(increment)
        p = 0.0
        if since >= 0:
            time = since * T_S
            if time < duration:
                p = sense * amplitude * max(0.0, min(1.0, min(time, duration - time) / rise))
            since += 1
        measured = math.floor(x / GRATING + 0.5) * GRATING
        command = K_POS * (ref[k] - measured) + increment / T_S + p
        wanted = K_vel * (command - v_hat) + integral + mass * (increment - increment_last) / T_S**2
        u = min(max(wanted, -FORCE_MAX), FORCE_MAX)
        if u == wanted:
            integral += K_vel / T_I * (command - v_hat) * T_S
        increment_last = increment
        for _ in range(SUBSTEPS):
            level = F_C + (F_S - F_C) * math.exp(-((v / v_s) ** 2))
            z_next = z
            if v != 0.0:
                steady = level / sigma_0 * np.sign(v)
                z_next = steady + (z - steady) * math.exp(-sigma_0 * abs(v) * h / level)
            friction = 0.5 * sigma_0 * (z + z_next) + sigma_1 * (z_next - z) / h + sigma_2 * v
            z = z_next
            v += h * (u - friction) / mass
            x += h * v
    return error


def log_interpolated(at: Array, x: Array, y: Array) -> Array:
    """Linear interpolation of ln y over ln x at the points ``at``; the ends are held."""
    return np.exp(np.interp(np.log(at), np.log(x), np.log(y)))


@dataclass
class Learner:
    """Runs of one axis; ``runs`` counts them by stage."""

    axis: Axis
    runs: dict[str, int]

    def error(self, acceleration: float, pulse: tuple[float, float], stage: str) -> Array:
        """Error in m from the reversal on."""
        self.runs[stage] = self.runs.get(stage, 0) + 1
        rate = math.sqrt(acceleration / RADIUS)
        first = round(LEAD_IN / T_S)
        t = (np.arange(first + round(LEAD_OUT / T_S) + 2) - first) * T_S
        start = RADIUS * rate * math.sin(rate * float(t[0]))
        return track(-RADIUS * np.cos(rate * t), start, self.axis.values, pulse)[first:]

    def cost(self, acceleration: float, pulse: tuple[float, float], t_c: float, stage: str) -> float:
        """J in m."""
        error = self.error(acceleration, pulse, stage)
        return float(np.sqrt(np.mean(error[: round(2.5 * t_c / T_S) + 1] ** 2)))


@dataclass(frozen=True)
class Learned:
    """What was learned for one axis, SI."""

    t_c: Array
    durations: Array
    accelerations: Array
    amplitudes: Array
    costs: Array
    """J in m at the amplitudes of the fine search."""
    spread: float
    table: tuple[Array, Array, Array]
    """Acceleration, amplitude, duration at the nodes."""
    runs: dict[str, int]


def peak_time(learner: Learner, acceleration: float) -> float:
    """Time from the reversal to the largest uncompensated error."""
    return float(np.argmax(np.abs(learner.error(acceleration, (0.0, 0.0), "peak")))) * T_S


def best_duration(learner: Learner, acceleration: float, t_c: float) -> float:
    """Duration in s of the best pulse; the shortest of those that are equally good."""
    shares = np.linspace(0.5, 1.5, 9)

    def least_cost(share: float) -> float:
        pulses = [(float(amplitude), share * t_c) for amplitude in np.arange(1, 11) * 0.1 * A_MAX]
        return min(learner.cost(acceleration, pulse, t_c, "duration") for pulse in pulses)

    costs = np.array([least_cost(float(share)) for share in shares])
    return float(shares[np.flatnonzero(costs <= FLAT * np.min(costs))[0]]) * t_c


def regression(at: Array, points: Array, values: Array, spread: float) -> Array:
    """General regression neural network over ln of the acceleration."""
    weights = np.exp(-((np.log(at)[:, None] - np.log(points)[None, :]) ** 2) / (2.0 * spread**2))
    return (weights @ values) / weights.sum(axis=1)


def best_spread(points: Array, values: Array) -> float:
    """The spread whose prediction of each point from the others is best."""
    candidates = np.geomspace(0.05, 3.0, 40) * float(np.median(np.diff(np.log(points))))

    def miss(spread: float) -> float:
        kept = [np.arange(len(points)) != i for i in range(len(points))]
        with np.errstate(invalid="ignore"):
            off = [regression(points[~k], points[k], values[k], spread)[0] - values[~k][0] for k in kept]
        squares = float(np.sum(np.square(off)))
        return squares if math.isfinite(squares) else math.inf

    return float(min(candidates, key=miss))


def learn(axis: Axis) -> Learned:
    """The whole procedure for one axis."""
    learner = Learner(axis, {})
    t_c = np.array([peak_time(learner, float(a)) for a in ACCELERATIONS])
    durations = np.array([best_duration(learner, float(a), float(t)) for a, t in zip(ACCELERATIONS, t_c, strict=True)])

    def best_amplitude(acceleration: float, candidates: Array, stage: str) -> tuple[float, float]:
        at = np.array([acceleration])
        peak = float(log_interpolated(at, ACCELERATIONS, t_c)[0])
        duration = float(log_interpolated(at, ACCELERATIONS, durations)[0])
        costs = [learner.cost(acceleration, (float(a), duration), peak, stage) for a in candidates]
        best = int(np.argmin(costs))
        return float(candidates[best]), costs[best]

    coarse_step = (A_MAX - A_0) / 10.0
    grid = np.concatenate([np.linspace(lo, hi, 5)[:-1] for lo, hi in ((2e-3, 10e-3), (10e-3, 40e-3))])
    grid = np.concatenate([grid, np.linspace(40e-3, 120e-3, 5)])
    coarse = np.array([best_amplitude(float(a), A_0 + np.arange(11) * coarse_step, "coarse")[0] for a in grid])
    fine_grid = np.sort(np.concatenate([grid, 0.5 * (grid[1:] + grid[:-1])]))
    start = np.interp(fine_grid, grid, coarse)
    steps = np.arange(11) * coarse_step / 5.0 - coarse_step
    fine = [
        best_amplitude(float(a), np.maximum(centre + steps, 0.0), "fine")
        for a, centre in zip(fine_grid, start, strict=True)
    ]
    amplitudes, costs = (np.array(column) for column in zip(*fine, strict=True))
    spread = best_spread(fine_grid, amplitudes)
    nodes = np.geomspace(ACCELERATIONS[0], ACCELERATIONS[-1], NODES)
    table = (
        nodes,
        regression(nodes, fine_grid, amplitudes, spread),
        log_interpolated(nodes, ACCELERATIONS, durations),
    )
    return Learned(t_c, durations, fine_grid, amplitudes, costs, spread, table, learner.runs)


FRICTIONS = {"nominal": 1.0, "high": 1.3, "low": 0.7}
"""Friction at which tables are learned, as a factor on the friction of ``AXES``."""


def numbers(values: Array) -> str:
    """A TOML array, seven digits."""
    return "[" + ", ".join(f"{value:.6e}" for value in values) + "]"


def table_lines(axis: str, learned: Learned) -> list[str]:
    """The instance of a system whose pulses follow the tables."""
    names = ("table.acceleration", "table.amplitude", "table.duration")
    return [
        f"[instances.pulse_{axis}.start]",
        'mode = "table"',
        *(f'"{name}" = {numbers(values)}' for name, values in zip(names, learned.table, strict=True)),
        "",
    ]


def write() -> None:
    """Learn everything and write the three files."""
    header = "# Written by learn_tables.py."
    result = {
        (axis, friction): learn(AXES[axis].scaled(factor)) for axis in AXES for friction, factor in FRICTIONS.items()
    }
    lines = [header + " SI units; t_c, T_opt at 2, 10, 40, 120 mm/s2, then the points of the fine search."]
    for (axis, friction), learned in result.items():
        lines += [
            "",
            f"[{axis}.{friction}]",
            f"t_c = {numbers(learned.t_c)}",
            f"duration = {numbers(learned.durations)}",
            f"acceleration = {numbers(learned.accelerations)}",
            f"amplitude = {numbers(learned.amplitudes)}",
            f"cost = {numbers(learned.costs)}",
            f"spread = {learned.spread:.6e}",
            f"runs = {{ {', '.join(f'{stage} = {count}' for stage, count in learned.runs.items())} }}",
            *(
                f"table_{name} = {numbers(values)}"
                for name, values in zip(("acceleration", "amplitude", "duration"), learned.table, strict=True)
            ),
        ]
    (HERE / "learned.toml").write_text("\n".join([*lines, ""]), encoding="utf-8")
    texts = {"circle": "Two feed drive axes on a circle of 25 mm at F 1000", "out_and_back": "Y axis out and back (S1)"}
    for name, axes in (("circle", "xy"), ("out_and_back", "y")):
        system = [
            header,
            f'base = "{name}.toml"',
            f'description = "{texts[name]}, cascade control with learned friction pulses, 4 kHz"',
            "",
        ]
        for axis in axes:
            system += table_lines(axis, result[axis, "nominal"])
        (HERE / f"{name}_pulse.toml").write_text("\n".join(system), encoding="utf-8")


if __name__ == "__main__":
    write()
