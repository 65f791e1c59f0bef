"""Linear motor for micro-milling under P-PI and super-twisting control: Table I and the claims around it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from cosim.result import metrics, plots
from cosim.result.metrics import Array
from cosim.result.result import Result
from cosim.study import Criterion, Numbers, Outcomes, Picture, Run, Value, read_study
from cosim.study.pictures import Signals, over_time

Window = tuple[float, float]
Values = Mapping[str, Value]

UM = 1e6
SLOW: Values = {"force.amplitude": 46e-3, "force.offset": -26e-3}
FIT: Values = {"controller.mu": 0.25, "controller.lambda_": 3.5}
CUTTING: Values = {"plant.feed_per_tooth": 1e-6}
IN_UN: Values = {**CUTTING, "plant.K_t": 3500.0, "plant.K_n": 2100.0}
RELAY: Values = {**FIT, "controller.switching": "relay"}


# What is measured in a run, SI units


def errors(result: Result) -> tuple[Array, Array]:
    """Errors of position and velocity as reference minus actual value, the sign of the paper."""
    return (
        result["trajectory.position"] - result["plant.position"],
        result["trajectory.velocity"] - result["plant.velocity"],
    )


def measure(result: Result, window: Window) -> dict[str, float]:
    e, v = errors(result)
    end = metrics.window(result.time, float(result.time[-1]) - 5.0)
    early = metrics.window(result.time, 10.0 if result.time[-1] > 20.0 else 0.0, 20.0)
    force_step = np.diff(result["controller.force"])
    return {
        "e_max": metrics.max_abs(e),
        "e_std": metrics.std(e),
        "v_max": metrics.max_abs(v),
        "v_opposite": float(np.max(-v)),
        "v_std": metrics.std(v),
        "e_end": metrics.max_abs(e[end]),
        "e_early": metrics.max_abs(e[early]),
        "force_step": metrics.rms(force_step),
    }


# Runs


def run(system: str, *changes: Values, stop_time: float | None = None, keep_every: int = 4) -> Run:
    overrides: dict[str, Value] = {}
    for change in changes:
        overrides |= change
    return Run(f"{system}.toml", overrides, stop_time, measure=measure, keep_every=keep_every)


def gains(Lambda: float, W: float) -> Values:
    return {"controller.Lambda": Lambda, "controller.W": W}


def runs() -> dict[str, Run]:
    limit = {"controller.T_s": 1e-4, "trajectory.amplitude": 0.0, "plant.position_start": 1e-6}
    return {
        "p_pi": run("p_pi"),
        "p_pi_slow": run("p_pi", SLOW),
        "p_pi_25s": run("p_pi", stop_time=25.0),
        "p_pi_unfiltered": run("p_pi", {"controller.velocity_filter_time": 0.0}),
        "p_pi_volts": run("p_pi", {"controller.K_p": 5000.0}),
        "p_pi_observer": run("p_pi_observer", SLOW),
        "p_pi_observer_free": run("p_pi_observer"),
        "fit": run("super_twisting", FIT),
        "fit_slow": run("super_twisting", FIT, SLOW),
        "fit_observer": run("super_twisting_observer", FIT, SLOW),
        "fit_observer_free": run("super_twisting_observer", FIT),
        "design": run("super_twisting"),
        "design_slow": run("super_twisting", SLOW),
        "relay": run("super_twisting", RELAY),
        "p_pi_uN": run("p_pi", IN_UN),
        "fit_uN": run("super_twisting", FIT, IN_UN),
        "p_pi_cutting": run("p_pi", CUTTING),
        "fit_cutting": run("super_twisting", FIT, CUTTING),
        "stiff_cutting": run("p_pi", {"controller.K_p": 5000.0}, CUTTING),
        "stiff_observer_cutting": run("p_pi_observer", {"controller.K_p": 5000.0, "observer.g": 300.0}, CUTTING),
        "physical_low_cutting": run("super_twisting", gains(10.0, 1.0), CUTTING),
        "physical_cutting": run("super_twisting", gains(30.0, 3.0), CUTTING),
        "physical_high_cutting": run("super_twisting", gains(100.0, 3.0), CUTTING),
        "stable": run("p_pi", limit, {"controller.K_i": 4.9}, stop_time=60.0),
        "unstable": run("p_pi", limit, {"controller.K_i": 5.5}, stop_time=60.0),
        **{
            f"{name}{suffix}": run(f"{system}{suffix}", *changes, stop_time=3.0)
            for name, system, changes in (("p_pi", "p_pi", ()), ("fit", "super_twisting", (FIT,)))
            for suffix in ("_20khz", "_1khz", "_parallel", "_1khz_parallel")
        },
    }


# What claims measure beyond single figures


def induced(runs_: Mapping[str, tuple[str, str]]) -> Callable[[Outcomes], Numbers]:
    """rms in um of the position change by the disturbance; ``runs_``: label -> (disturbed run, free run)."""

    def measured(outcomes: Outcomes) -> Numbers:
        return {
            label: UM * metrics.rms(errors(outcomes.result(loaded))[0] - errors(outcomes.result(free))[0])
            for label, (loaded, free) in runs_.items()
        }

    return measured


ADDED = {
    "P-PI": ("p_pi_slow", "p_pi"),
    "P-PI, observer": ("p_pi_observer", "p_pi_observer_free"),
    "super-twisting": ("fit_slow", "fit"),
    "super-twisting, observer": ("fit_observer", "fit_observer_free"),
}
"""Pairs of a disturbed and a free run."""


def damped(outcomes: Outcomes) -> Numbers:
    added = induced(ADDED)(outcomes)
    return {name: added[name] / added[f"{name}, observer"] for name in ("P-PI", "super-twisting")}


def growth(outcomes: Outcomes) -> Numbers:
    """Largest error of the last five seconds divided by the largest error from 10 to 20 s."""
    return {
        label: outcomes.number(name, "e_end") / outcomes.number(name, "e_early")
        for label, name in (("K_i = 4.9", "stable"), ("K_i = 5.5", "unstable"))
    }


SLOW_FORCE = {"P-PI": ("p_pi_slow", "p_pi")}
MEASURES: dict[str, Callable[[Outcomes], Numbers]] = {
    "added": induced(ADDED),
    "added_design": induced({**SLOW_FORCE, "super-twisting": ("design_slow", "design")}),
    "added_fitted": induced({**SLOW_FORCE, "super-twisting": ("fit_slow", "fit")}),
    "damped": damped,
    "growth": growth,
}
RULES = {
    "separated": Criterion(
        "below 1 for the first, above 1 for the second", lambda m, _: min(m.values()) < 1.0 < max(m.values())
    )
}


# Pictures


def draw_added(outcomes: Outcomes, path: Path) -> None:
    """Draw the position change by the slow force."""
    panels: list[plots.Panel] = []
    for i, (label, (loaded, free)) in enumerate(
        {
            "P-PI": ("p_pi_slow", "p_pi"),
            "P-PI with observer": ("p_pi_observer", "p_pi_observer_free"),
            "Super-twisting, fitted gains": ("fit_slow", "fit"),
        }.items()
    ):
        one, other = outcomes.result(loaded), outcomes.result(free)
        series = plots.Series(label, one.time, errors(one)[0] - errors(other)[0], i)
        panels.append(plots.Panel("Added error", "m", (series,)))
    plots.plot_panels(path, panels)


def pictures() -> dict[str, Picture]:
    """All pictures by file name."""
    error, force = "trajectory.position - plant.position", "controller.force"
    loops = {"P-PI": "p_pi", "Super-twisting, fitted gains": "fit", "Super-twisting, design gains": "design"}
    retuned = {
        "P-PI, K_p = 5000 N·s/m": "stiff_cutting",
        "and observer of 300 rad/s": "stiff_observer_cutting",
        "Super-twisting, Λ = 30, W = 3 (SI)": "physical_cutting",
    }

    def each(quantity: str, unit: str, runs: Mapping[str, str], signal: str, begin: float, end: float) -> list[Signals]:
        return [
            Signals(quantity, unit, {label: f"{run}: {signal}"}, (begin, end), colours=(i,))
            for i, (label, run) in enumerate(runs.items())
        ]

    velocity = "trajectory.velocity - plant.velocity"
    switching = {"Integral (super-twisting)": "fit", "Relay": "relay"}
    printed = {"P-PI": "p_pi_cutting"}
    return {
        "position_error": over_time("Position error, sin 3t µm from rest", each("Error", "m", loops, error, 0.0, 3.0)),
        "velocity_error": over_time(
            "Velocity error: both start at 3 µm/s",
            each("Velocity error", "m/s", dict(list(loops.items())[:2]), velocity, 0.0, 3.0),
        ),
        "slow_force": Picture("What the slow force of some 50 µN adds", draw_added),
        "chatter": over_time(
            "Motor force with integral and relay switching", each("Motor force", "N", switching, force, 3.0, 4.0)
        ),
        "cutting": over_time("Real cutting force, printed P-PI gains", each("Error", "m", printed, error, 0.0, 20.0)),
        "cutting_retuned": over_time("Real cutting force, retuned gains", each("Error", "m", retuned, error, 0.0, 0.5)),
    }


STUDY = read_study(
    Path(__file__).with_name("claims.toml"),
    runs(),
    pictures(),
    measures=MEASURES,
    own_rules=RULES,
)
