"""Feed drive axes with friction: observer compared with learned velocity pulses, on circles and moves out and back."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.result import metrics, plots
from cosim.result.metrics import Array
from cosim.result.result import Result
from cosim.study import Criterion, Measure, Numbers, Outcomes, Picture, Run, Value, read_study
from cosim.study.pictures import Signals, over_time

Window = tuple[float, float]
Values = dict[str, Value]

HERE = Path(__file__).parent
LEARNED: Mapping[str, Any] = tomllib.loads((HERE / "learned.toml").read_text(encoding="utf-8"))
UM = 1e6
LEAD = 1.5915494309189535e-3  # m/rad
T_S, RADIUS = 2.5e-4, 0.025
FEEDS = (500, 1000, 2000, 3000)
MOVES = {"S1": (10, 10, 30), "S2": (20, 20, 30), "S3": (20, 30, 50), "S4": (30, 30, 80)}
"""Move -> acceleration in mm/s2, velocity in mm/s, distance in mm."""
CUT_OFFS = (20, 50, 80, 100, 150, 200, 300, 400, 600)
REVERSALS = {"x": math.pi, "y": 0.5 * math.pi}
INDICATORS = ("contour", "peak", "rms", "mean")
FRICTIONS = {"high": 1.3, "low": 0.7}
METHODS = {"without": "plain", "observer 50 rad/s": "observer50", "learned pulses": "pulse"}
"""Label of a method -> first part of the names of its runs."""


# What is measured in a run, SI units


def monitored(axis: str, acceleration: float) -> float:
    """Time in s after a reversal that is evaluated: 2.5 times the time to the uncompensated peak."""
    learned = LEARNED[axis]["nominal"]
    return 2.5 * math.exp(
        float(np.interp(math.log(acceleration), np.log([2e-3, 10e-3, 40e-3, 120e-3]), np.log(learned["t_c"])))
    )


def turns(reference: Array) -> NDArray[np.intp]:
    """Samples of the reversals: those with the first increment in the new direction."""
    moves = np.sign(np.diff(reference))
    return np.flatnonzero(moves[1:] * moves[:-1] < 0.0) + 1


def position(result: Result, axis: str) -> Array:
    """Position of the table in m, not rounded; for a rigid axis it is computed from the screw."""
    if f"plant_{axis}.angle" not in result:
        return result[f"plant_{axis}.position"]
    return LEAD * result[f"plant_{axis}.angle"]


def error(result: Result, axis: str) -> Array:
    return result[f"trajectory_{axis}.position"] - position(result, axis)


def judged(result: Result, axis: str, first: int, acceleration: float) -> dict[str, float]:
    """Figures of the error from the sample ``first`` on."""
    part = slice(first, first + round(monitored(axis, acceleration) / T_S) + 1)
    e = error(result, axis)[part]
    return {"peak": metrics.max_abs(e), "rms": metrics.rms(e), "mean": float(np.mean(np.abs(e)))}


def circle_reversal(result: Result, axis: str) -> int:
    """Sample of the first reversal of X at 180 or of Y at 90 degrees."""
    angle = np.arctan2(result["trajectory_y.position"], result["trajectory_x.position"])
    off = np.abs(np.mod(angle - REVERSALS[axis] + math.pi, 2.0 * math.pi) - math.pi)
    return int(next(k for k in turns(result[f"trajectory_{axis}.position"]) if off[k] < 0.1))


def measure_circle(feed: float) -> Callable[[Result, Window], dict[str, float]]:
    acceleration = (feed / 60e3) ** 2 / RADIUS

    def measure(result: Result, window: Window) -> dict[str, float]:
        x, y = position(result, "x"), position(result, "y")
        radial = metrics.radial_deviation(x, y, RADIUS)
        found: dict[str, float] = {}
        for axis in "xy":
            first = circle_reversal(result, axis)
            part = slice(first, first + round(monitored(axis, acceleration) / T_S) + 1)
            found[f"{axis}.contour"] = metrics.max_abs(radial[part])
            found |= {f"{axis}.{name}": value for name, value in judged(result, axis, first, acceleration).items()}
        angle = np.unwrap(np.arctan2(result["trajectory_y.position"], result["trajectory_x.position"]))
        turn = (angle >= 0.0) & (angle < 2.0 * math.pi)
        if angle[-1] >= 2.0 * math.pi:
            found["G"] = metrics.circular_deviation(x[turn], y[turn])
        return found

    return measure


def measure_move(acceleration: float) -> Callable[[Result, Window], dict[str, float]]:
    def measure(result: Result, window: Window) -> dict[str, float]:
        first = int(turns(result["trajectory_y.position"])[0])
        begin = metrics.window(result.time, 0.0, 0.5)
        return {
            **{f"y.{name}": value for name, value in judged(result, "y", first, acceleration).items()},
            "y.start": metrics.max_abs(error(result, "y")[begin]),
        }

    return measure


def measure_drift(result: Result, window: Window) -> dict[str, float]:
    """Smallest and largest rms error after a reversal of X, over the run."""
    found = [judged(result, "x", int(k), (1.0 / 60.0) ** 2 / RADIUS)["rms"] for k in turns(drive(result))[1:-1]]
    return {"rms_first": found[0], "rms_least": min(found), "rms_most": max(found)}


def drive(result: Result) -> Array:
    return result["trajectory_x.position"]


# Runs


def each(variable: str, value: Value) -> Values:
    """A value for X and Y: ``plant.friction_scale`` -> ``plant_x.friction_scale``, ``plant_y.friction_scale``."""
    instance, _, name = variable.partition(".")
    return {f"{instance}_{axis}.{name}": value for axis in "xy"}


def tables(friction: str, axes: Iterable[str] = "xy") -> Values:
    """The pulses learned at another friction."""
    found: Values = {}
    for axis in axes:
        found[f"pulse_{axis}.mode"] = "table"
        for name in ("acceleration", "amplitude", "duration"):
            for i, value in enumerate(LEARNED[axis][friction][f"table_{name}"]):
                found[f"pulse_{axis}.table.{name}[{i + 1}]"] = value
    return found


def circle(system: str, feed: int, changes: Values | None = None, turns_: float = 1.25) -> Run:
    speed = feed / 60e3
    seconds = speed / 0.2 + 2.0 * math.pi * turns_ * RADIUS / speed
    overrides = {**each("trajectory.feed", speed), **(changes or {})}
    return Run(
        f"{system}.toml", overrides, round(math.ceil(10.0 * seconds) / 10.0 + 0.1, 1), measure=measure_circle(feed)
    )


def move(system: str, name: str, changes: Values | None = None) -> Run:
    acceleration, velocity, distance = (1e-3 * value for value in MOVES[name])
    way = distance / velocity + velocity / acceleration
    # Start so that the reversal lies on a sample.
    start = math.ceil(way * 1e3) * 1e-3 - way
    overrides: Values = {
        "trajectory_y.amplitude": distance,
        "trajectory_y.velocity_max": velocity,
        "trajectory_y.acceleration_max": acceleration,
        "trajectory_y.start_time": start if start > 1e-9 else 0.0,
        **(changes or {}),
    }
    return Run(f"{system}.toml", overrides, round(2.0 * (way + start) + 0.5, 3), measure=measure_move(acceleration))


def fixed(amplitude: float, duration: float) -> Values:
    """A fixed pulse: the X pulse at F 1000 with scaled amplitude and duration."""
    learned = LEARNED["x"]["nominal"]
    acceleration = (1.0 / 60.0) ** 2 / RADIUS
    A, T = (
        float(np.interp(acceleration, learned["table_acceleration"], learned[f"table_{name}"]))
        for name in ("amplitude", "duration")
    )
    return {"pulse_x.mode": "fixed", "pulse_x.A": amplitude * A, "pulse_x.T": duration * T}


def runs() -> dict[str, Run]:
    found: dict[str, Run] = {}
    for feed in FEEDS:
        found[f"plain_{feed}"] = circle("circle", feed)
        found[f"pulse_{feed}"] = circle("circle_pulse", feed)
        for g in CUT_OFFS:
            found[f"observer{g}_{feed}"] = circle("circle", feed, each("observer.g", float(g)))
        for friction, factor in FRICTIONS.items():
            changed = each("plant.friction_scale", factor)
            found[f"{friction}_plain_{feed}"] = circle("circle", feed, changed)
            found[f"{friction}_old_{feed}"] = circle("circle_pulse", feed, changed)
            found[f"{friction}_new_{feed}"] = circle("circle", feed, changed | tables(friction))
    for name in MOVES:
        found[f"plain_{name}"] = move("out_and_back", name)
        found[f"pulse_{name}"] = move("out_and_back_pulse", name)
        found[f"observer50_{name}"] = move("out_and_back", name, {"observer_y.g": 50.0})
    for label, amplitude, duration in (
        ("A0.5", 0.5, 1.0),
        ("A1.5", 1.5, 1.0),
        ("T0.5", 1.0, 0.5),
        ("T2", 1.0, 2.0),
        ("best", 1.0, 1.0),
    ):
        found[f"fixed_{label}"] = circle("circle", 1000, fixed(amplitude, duration))
    alone = {**each("controller.k_vff", 0.0), **each("controller.k_aff", 0.0)}
    found["no_feedforward"] = circle("circle", 1000, alone)
    found["no_feedforward_pulse"] = circle("circle_pulse", 1000, alone)
    for system in ("circle", "circle_pulse"):
        found[f"parallel_{system}"] = circle(f"{system}_parallel", 2000)
    for feed in FEEDS:
        found[f"two_mass_plain_{feed}"] = circle("circle_two_mass", feed)
        found[f"two_mass_observer_{feed}"] = circle("circle_two_mass", feed, each("observer.g", 50.0))
        found[f"two_mass_pulse_{feed}"] = circle("circle_two_mass", feed, tables("nominal"))
    drifting = {
        **each("plant.drift_amplitude", 0.3),
        **each("plant.drift_frequency", 0.01),
        **each("trajectory.turns", 10.25),
    }
    for name, system in (("drift_plain", "circle"), ("drift_pulse", "circle_pulse")):
        run = circle(system, 1000, drifting, 10.25)
        found[name] = Run(run.system, run.overrides, run.stop_time, measure=measure_drift, keep_every=4)
    return found


# What claims measure beyond single figures


def reduction(outcomes: Outcomes, run: str, plain: str, figure: str) -> float:
    """How much smaller a figure is in ``run`` than in ``plain``, %."""
    return 100.0 * (1.0 - outcomes.number(run, figure) / outcomes.number(plain, figure))


def reductions(
    axis: str, cases: Iterable[object], names: Iterable[str], variant: str = ""
) -> Callable[[Outcomes], Numbers]:
    """The smallest reduction by pulses over ``cases``, %."""

    def measured(outcomes: Outcomes) -> Numbers:
        return {
            name: min(
                reduction(outcomes, f"{variant}pulse_{case}", f"{variant}plain_{case}", f"{axis}.{name}")
                for case in cases
            )
            for name in names
        }

    return measured


def below(one: str, other: str) -> Callable[[Outcomes], float]:
    """Number of the 32 comparisons on circles in which ``one`` is better than ``other``."""
    return lambda outcomes: float(
        sum(
            outcomes.number(f"{one}_{feed}", f"{axis}.{name}") < outcomes.number(f"{other}_{feed}", f"{axis}.{name}")
            for feed in FEEDS
            for axis in "xy"
            for name in INDICATORS
        )
    )


def crossover(outcomes: Outcomes) -> Numbers:
    return {f"{g} rad/s": below("pulse", f"observer{g}")(outcomes) for g in CUT_OFFS}


def learned_numbers(axis: str, name: str, factor: float, at: Iterable[float] = ()) -> Callable[[Outcomes], Numbers]:
    """Learned values at the four accelerations."""

    def measured(_: Outcomes) -> Numbers:
        learned = LEARNED[axis]["nominal"]
        found = learned[name] if name == "duration" else np.interp(list(at), learned["acceleration"], learned[name])
        return {f"{a} mm/s²": factor * float(value) for a, value in zip((2, 10, 40, 120), found, strict=True)}

    return measured


def kept_reduction(outcomes: Outcomes) -> Numbers:
    return {
        sign: min(
            reduction(outcomes, f"{friction}_old_{feed}", f"{friction}_plain_{feed}", f"{axis}.rms")
            for feed in FEEDS
            for axis in "xy"
        )
        for friction, sign in (("high", "+30 %"), ("low", "-30 %"))
    }


def least_reduction(outcomes: Outcomes) -> Numbers:
    """The least reduction on axes of two masses, %."""
    return {axis.upper(): min(reductions(axis, FEEDS, INDICATORS, "two_mass_")(outcomes).values()) for axis in "xy"}


def without_feedforward(outcomes: Outcomes) -> Numbers:
    """The reduction of rms by pulses without feed-forward, %."""
    plain, pulse = "no_feedforward", "no_feedforward_pulse"
    return {axis.upper(): reduction(outcomes, pulse, plain, f"{axis}.rms") for axis in "xy"}


AT = (2e-3, 10e-3, 40e-3, 120e-3)
"""Reverse accelerations in m/s2 at which learned amplitudes are compared."""
MEASURES: dict[str, Measure] = {
    "circles_x": reductions("x", FEEDS, INDICATORS),
    "circles_y": reductions("y", FEEDS, INDICATORS),
    "moves": reductions("y", MOVES, INDICATORS[1:]),
    **{f"pulses_{g}": below("pulse", f"observer{g}") for g in CUT_OFFS},
    "crossover": crossover,
    "observers": lambda o: {f"{g} rad/s": below(f"observer{g}", "plain")(o) for g in CUT_OFFS},
    **{f"durations_{axis}": learned_numbers(axis, "duration", 1e3) for axis in "xy"},
    **{f"amplitudes_{axis}": learned_numbers(axis, "amplitude", 1e3, AT) for axis in "xy"},
    "runs": lambda _: {name: float(count) for name, count in LEARNED["x"]["nominal"]["runs"].items()},
    "kept_reduction": kept_reduction,
    "drift": lambda o: {
        "steady friction": UM * o.number("pulse_1000", "x.rms"),
        "worst in drift": UM * o.number("drift_pulse", "rms_most"),
    },
    "two_mass": least_reduction,
    "no_feedforward": without_feedforward,
}
RULES = {"doubled": Criterion("at least doubled", lambda m, _: m["worst in drift"] >= 2.0 * m["steady friction"])}


# Pictures


def draw_reversals(feed: int) -> Callable[[Outcomes, Path], None]:
    """Error of both axes about the judged reversal under the three methods."""

    def draw(outcomes: Outcomes, path: Path) -> None:
        panels: list[plots.Panel] = []
        for axis in "xy":
            series: list[plots.Series] = []
            for label, run in METHODS.items():
                result = outcomes.result(f"{run}_{feed}")
                first = circle_reversal(result, axis)
                begin = result.time[first]
                part = metrics.window(result.time, begin - 0.05, begin + 0.3)
                series.append(plots.Series(label, result.time[part] - begin, error(result, axis)[part]))
            panels.append(plots.Panel(f"Error {axis.upper()}", "m", tuple(series)))
        plots.plot_panels(path, panels, x_quantity="Time after the reversal")

    return draw


def draw_circles(outcomes: Outcomes, path: Path) -> None:
    drawn: list[plots.Polar] = []
    for label, run in METHODS.items():
        series: list[plots.Series] = []
        for i, feed in enumerate((500, 3000)):
            result = outcomes.result(f"{run}_{feed}")
            angle = np.unwrap(np.arctan2(result["trajectory_y.position"], result["trajectory_x.position"]))
            turn = (angle >= 0.0) & (angle < 2.0 * math.pi)
            radial = metrics.radial_deviation(position(result, "x")[turn], position(result, "y")[turn], RADIUS)
            series.append(plots.Series(f"F {feed}", angle[turn], radial, i))
        drawn.append(plots.Polar(label.capitalize(), RADIUS, tuple(series), 500.0))
    plots.plot_polar(path, drawn)


def draw_tables(outcomes: Outcomes, path: Path) -> None:
    panels: list[plots.Panel] = []
    for name, unit in (("amplitude", "m/s"), ("duration", "s")):
        series: list[plots.Series] = []
        for axis in "xy":
            for friction, text in (("nominal", ""), ("high", " +30 %"), ("low", " −30 %")):
                learned = LEARNED[axis][friction]
                x, y = (np.array(learned[f"table_{key}"]) for key in ("acceleration", name))
                series.append(plots.Series(f"{axis.upper()}{text}", x, y))
        panels.append(plots.Panel(name.capitalize(), unit, tuple(series)))
    plots.plot_panels(path, panels, x_quantity="Reverse acceleration", x_unit="m/s2")


def draw_crossover(outcomes: Outcomes, path: Path) -> None:
    """rms of the observer over its cut-off, and that of pulses."""
    panels: list[plots.Panel] = []
    for feed in FEEDS:
        series: list[plots.Series] = []
        for i, axis in enumerate("xy"):
            g = np.array(CUT_OFFS, dtype=np.float64)
            rms = np.array([outcomes.number(f"observer{cut}_{feed}", f"{axis}.rms") for cut in CUT_OFFS])
            level = np.full(2, outcomes.number(f"pulse_{feed}", f"{axis}.rms"))
            series.append(plots.Series(f"{axis.upper()}, observer", g, rms, i))
            series.append(plots.Series(f"{axis.upper()}, pulses", g[[0, -1]], level, i, dashed=True))
        panels.append(plots.Panel(f"rms, F {feed}", "m", tuple(series)))
    plots.plot_panels(path, panels, columns=2, x_quantity="Cut-off of the observer", x_unit="rad/s")


def pictures() -> dict[str, Picture]:
    """All pictures by file name."""
    drifting = {"Without": "drift_plain", "Tables learned before": "drift_pulse"}
    error_x, error_y = (f"trajectory_{axis}.position - plant_{axis}.position" for axis in "xy")
    return {
        "reversals_1000": Picture("Error about the reversals at F 1000", draw_reversals(1000)),
        "circles": Picture("Circles of 25 mm", draw_circles),
        "moves": over_time(
            "Y out and back",
            [
                Signals(f"Error Y, {name}", "m", {text: f"{run}_{name}: {error_y}" for text, run in METHODS.items()})
                for name in ("S1", "S4")
            ],
        ),
        "crossover": Picture("Observer against pulses: rms over the observer's cut-off", draw_crossover),
        "tables": Picture("Learned tables at three frictions", draw_tables),
        "drift": over_time(
            "Ten turns at F 1000 while friction drifts by 30 %",
            [
                Signals("Error X", "m", {text: f"{run}: {error_x}"}, colours=(i,))
                for i, (text, run) in enumerate(drifting.items())
            ],
        ),
    }


STUDY = read_study(HERE / "claims.toml", runs(), pictures(), measures=MEASURES, own_rules=RULES)
