"""NCTF control of a ballscrew: the statements of the paper compared with the results of its equations."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from cosim.design.identify import nct_from_signals
from cosim.design.stability import limit_map, oscillation, read_map
from cosim.result import metrics
from cosim.result.result import Result
from cosim.study import Criterion, Numbers, Outcomes, Picture, Run, measures, read_study
from cosim.study.pictures import Signals, over_time

Window = tuple[float, float]
Measure = Callable[[Outcomes], float | Numbers]

STEPS = {
    "100nm": ("100 nm", 1e-7),
    "1um": ("1 µm", 1e-6),
    "10um": ("10 µm", 1e-5),
    "100um": ("100 µm", 1e-4),
    "1mm": ("1 mm", 1e-3),
    "10mm": ("10 mm", 1e-2),
    "20mm": ("20 mm", 2e-2),
}
T_S = 2e-4  # s
GAIN = 505.0 * 32.3e-3  # alpha*K, m/(A.s2)
K_P = 960.0  # A.s/m, 40 % of the paper's ultimate gain of 2400
COMPENSATORS = {"A": 0.1, "B": 0.175, "C": 0.25}
"""omega_n*T_s of the compensators. The paper gives them in fig. 10, which is lost, so they are chosen: see the text."""
WARM = {"plant.F_C": 0.87 * 0.046, "plant.F_S": 0.87 * 0.046, "plant.sigma_2": 0.76 * 9.7e-4}
E_LIN = 0.643e-6
"""Position error in m at which the NCT's linear part ends."""
SCAN = 1.01
"""Ratio of neighbouring gains in a search for a limit of stability."""
ZETA_LIMITS = {0.02: 195.6, 0.05: 78.0, 0.1: 38.2, 0.2: 17.9, 0.25: 13.5, 0.3: 10.3, 0.4: 5.3}
"""omega_n*T_s -> centre of the search for the largest damping ratio, from the figures of the independent runs."""
GAIN_LIMITS = {"": 2.395, "_parallel": 1.832, "_delayed": 1.832, "_frictionless": 0.645}
"""Suffix of the runs -> centre of the search for the ultimate gain in A.s/mm."""
MARGIN_LIMITS = {0: 616.40, 1: 256.63}
"""Ultimate gain in A.s/m of the frictionless object of fig. 17 for 0 and 1 samples of delay, from eigenvalues."""
MARGINS = (0.1, 0.3, 0.6)
MM = 1e3


def integral_gain(W: float) -> float:
    """K_I in A/m for omega_n*T_s = ``W``."""
    return (W / T_S) ** 2 / GAIN


def zeta(gain: float, W: float) -> float:
    """Damping ratio that corresponds to ``gain`` in A.s/m by eq. (3a); ``W`` is omega_n*T_s."""
    return gain * GAIN * T_S / (2.0 * W)


# What is measured in a run, SI units


def measure_rest(result: Result, window: Window) -> dict[str, float]:
    """Largest error from 0.8 s on and the time in saturation."""
    error = measures.error(result)
    return {
        "residual": metrics.max_abs(error[metrics.window(result.time, 0.8, 1.0)]),
        "saturated": float(np.sum(np.abs(result["controller.command"][:-1]) >= 6.0)) * T_S,
    }


measure_step = measures.together(measures.step_response(bands={"settling_10nm": 10e-9}), measure_rest)


def measure_stairs(result: Result, window: Window) -> dict[str, float]:
    """Largest mean error of the last quarter of a stair, and the mean time to stay within 3 nm of it."""
    time, error = result.time, result["plant.position"] - result["trajectory.position"]
    means: list[float] = []
    times: list[float] = []
    for k in range(round(time[-1] / 0.2)):
        begin = 0.2 * k
        part = metrics.window(time, begin - 1e-9, begin + 0.2 - 1.5 * T_S)
        late = metrics.window(time, begin + 0.15, begin + 0.2 - 1.5 * T_S)
        means.append(abs(float(np.mean(error[late]))))
        times.append(metrics.settling_time(time[part], error[part], 0.0, 3e-9, begin))
    return {"stair_error": max(means), "stair_time": float(np.mean(times))}


def measure_oscillation(result: Result, window: Window) -> dict[str, float]:
    """Peak-to-peak value [m] and frequency [Hz] in the last quarter of the run, and whether it oscillates."""
    found = oscillation(result.time[:-1], result["plant.position"][:-1])
    return {"swing": found.size, "swing_frequency": found.frequency, "oscillates": float(found.sustained)}


def measure_pulse(result: Result, window: Window) -> dict[str, float]:
    """Open-loop identification: rest position, largest velocity, NCT, and the errors at which it has given slopes."""
    signals = result.time, result["plant.command"], result["plant.position"], result["plant.velocity"]
    nct = nct_from_signals(*signals, e_lin=E_LIN)
    numbers = {
        "rest": nct.rest,
        "stop": nct.stop,
        "top_velocity": nct.h_max,
        "reach": nct.reach,
        "inclination": nct.alpha,
        "gain": nct.K,
    }
    for alpha in (250.0, 505.0, 1010.0):
        numbers[f"linear_{alpha:g}"] = nct_from_signals(*signals, alpha=alpha).e_lin
    return numbers


# Runs


def gains(centre: float, count: int) -> list[float]:
    """Gains around ``centre``, each ``SCAN`` times the one before."""
    return [centre * SCAN**k for k in range(-count, count + 1)]


def limit_runs(name: str, system: str, centre: float, overrides: dict[str, float], count: int) -> dict[str, Run]:
    """Runs of a step of 10 um at rising gains in A.s/m."""
    return {
        f"{name}_{i:02d}": Run(
            system,
            {"trajectory.amplitude": 1e-5, "controller.K_P": gain, **overrides},
            0.6,
            measure=measure_oscillation,
            keep_every=1000,
        )
        for i, gain in enumerate(gains(centre, count))
    }


def runs() -> dict[str, Run]:
    found: dict[str, Run] = {"pulse": Run("pulse.toml", measure=measure_pulse)}
    for time in ("0.0328", "0.0329"):
        found[f"pulse_{time}"] = Run("pulse.toml", {"source.dwell": float(time)}, measure=measure_pulse)
    for name, (_, amplitude) in STEPS.items():
        size = {"trajectory.amplitude": amplitude}
        found[f"step_{name}"] = Run("step.toml", size, measure=measure_step)
        found[f"step_{name}_windup"] = Run("step.toml", size | {"controller.antiwindup": False}, measure=measure_step)
    for name in ("1um", "10um", "20mm"):
        size = {"trajectory.amplitude": STEPS[name][1]}
        found[f"step_{name}_parallel"] = Run("step_parallel.toml", size, measure=measure_step)
        found[f"step_{name}_delayed"] = Run("step.toml", size | {"controller.compute_delay": 1}, measure=measure_step)
    for suffix, antiwindup in (("", True), ("_windup", False)):
        slower = {"controller.K_I": integral_gain(0.2), "controller.antiwindup": antiwindup}
        found[f"step_20mm_02{suffix}"] = Run("step.toml", slower, measure=measure_step)
    for letter, W in COMPENSATORS.items():
        stairs = {"trajectory.amplitude": 1e-8, "controller.K_I": integral_gain(W)}
        found[f"stairs_{letter}"] = Run("stairs.toml", stairs, measure=measure_stairs)
    found["stairs_cold"] = Run("stairs.toml", measure=measure_stairs)
    found["stairs_warm"] = Run("stairs.toml", WARM, measure=measure_stairs)
    found["limit_cycle"] = Run(
        "step.toml",
        {"trajectory.amplitude": 1e-5, "controller.K_P": 2600.0, "controller.K_I": 0.0},
        0.6,
        measure=measure_oscillation,
    )
    for delay, limit in MARGIN_LIMITS.items():
        for margin in MARGINS:
            found[f"margin_{delay}_{margin:g}"] = Run(
                "margin.toml",
                {"controller.K_P": (1.0 - margin) * limit, "controller.compute_delay": delay},
                measure=measures.step_response(),
            )
    proportional = {"controller.K_I": 0.0}
    for suffix, centre in GAIN_LIMITS.items():
        system = "step_parallel.toml" if suffix == "_parallel" else "step.toml"
        changed = proportional | {
            "_frictionless": {"plant.F_C": 0.0, "plant.F_S": 0.0},
            "_delayed": {"controller.compute_delay": 1},
        }.get(suffix, {})
        found |= limit_runs(f"gain{suffix}", system, 1e3 * centre, changed, 4)
    for W, centre in ZETA_LIMITS.items():
        changed = {"controller.K_I": integral_gain(W)}
        found |= limit_runs(f"zeta_{W:g}", "step.toml", centre * 2.0 * W / (GAIN * T_S), changed, 4)
    return found


def last_stable(outcomes: Outcomes, name: str) -> float:
    """The last gain in A.s/m before the first that oscillates; NaN if the search did not enclose the limit."""
    found = [run for run in outcomes if run.rpartition("_")[0] == name]
    previous = math.nan
    for run in sorted(found):
        outcome = outcomes[run]
        if outcome.numbers["oscillates"]:
            return previous
        previous = float(outcome.run.overrides["controller.K_P"])
    return math.nan


def ultimate_gain(suffix: str = "") -> Measure:
    return lambda outcomes: 1e-3 * last_stable(outcomes, f"gain{suffix}")


def zeta_limits(*sampled: float) -> Measure:
    return lambda outcomes: {f"{W:g}": zeta(last_stable(outcomes, f"zeta_{W:g}"), W) for W in sampled}


def pulse_length(outcomes: Outcomes) -> float:
    """Duration of 6 A for which K is 32.3 mm/(A.s), ms."""
    ends = {time: outcomes.number(f"pulse_{time}", "gain") for time in ("0.0328", "0.0329")}
    (t_1, K_1), (t_2, K_2) = ((float(time), K) for time, K in ends.items())
    return MM * (t_1 + (32.3e-3 - K_1) / (K_2 - K_1) * (t_2 - t_1))


def _falls(measured: Numbers, _: Numbers) -> bool:
    values = list(measured.values())
    return values[-1] < 0.5 * values[0] and all(b < 1.02 * a for a, b in pairwise(values))


@cache
def limit_maps() -> Numbers:
    """Mean distance of the practical limit from the one found by simulation, in per cent; no run of the study."""
    distances: dict[str, float] = {}
    for name in ("damping", "friction", "inclination"):
        file = read_map(Path(__file__).parent / "limits" / f"{name}.toml")
        distances[name] = 100.0 * limit_map(file.system, file.cases, K=file.K).mean_deviation
    return distances


RULES = {
    "grows": Criterion("none more than 2 % above the one before, the last below half of the first", _falls),
    "good_from_30": Criterion(
        "above 5 % at 10 %, below 5 % from 30 % on",
        lambda measured, _: all((value < 5.0) is (label != "10 %") for label, value in measured.items()),
    ),
}


def with_friction(outcomes: Outcomes) -> Any:
    """The ultimate gain of the stage with friction and without."""
    return {"with": ultimate_gain()(outcomes), "without": ultimate_gain("_frictionless")(outcomes)}


MEASURES: dict[str, Measure] = {
    "ultimate": ultimate_gain(),
    "ultimate_parallel": ultimate_gain("_parallel"),
    "ultimate_delayed": ultimate_gain("_delayed"),
    "with_friction": with_friction,
    "practical_limits": zeta_limits(*ZETA_LIMITS),
    "limits": zeta_limits(0.05, 0.1, 0.2, 0.25, 0.3),
    "limit_maps": lambda _: limit_maps(),
    "pulse_length": pulse_length,
    "same_time_slower": lambda o: (
        100.0 * (o.number("step_20mm_02", "settling_10nm") / o.number("step_20mm_02_windup", "settling_10nm") - 1.0)
    ),
}


# Pictures


def pictures() -> dict[str, Picture]:
    """All pictures by file name."""
    position, reference = "plant.position", "trajectory.position"
    windup = {"With anti-windup": "step_20mm", "Without": "step_20mm_windup"}
    steps: list[Signals] = []
    for i, (key, (text, size)) in enumerate(STEPS.items()):
        whole = {text: f"step_{key}: {position}"}
        steps.append(Signals("Position over step", "1", whole, colours=(i,), over=size))
        steps.append(Signals("Error", "m", {text: f"step_{key}: {position} - {reference}"}, (0.5, 1.0), colours=(i,)))

    def stairs(runs: dict[str, str], end: float = math.inf) -> list[Signals]:
        lines = [{text: f"{run}: {position}", "Reference": f"{run}: {reference}"} for text, run in runs.items()]
        return [Signals("Position", "m", line, (0.0, end), colours=(i, 6)) for i, line in enumerate(lines)]

    return {
        "open_loop": over_time(
            "Open loop: 6 A for 0.1 s",
            [
                Signals(quantity, unit, {"6 A for 0.1 s": f"pulse: plant.{name}"})
                for quantity, unit, name in (("Current", "A", "command"), ("Velocity", "m/s", "velocity"))
            ]
            + [Signals("Position", "m", {"6 A for 0.1 s": f"pulse: {position}"})],
        ),
        "antiwindup": over_time(
            "Step of 20 mm with and without anti-windup, compensator C",
            [
                Signals(quantity, unit, {text: f"{run}: {name}" for text, run in windup.items()})
                for quantity, unit, name in (("Position", "m", position), ("Command", "A", "controller.command"))
            ],
        ),
        "steps": over_time("Seven steps, compensator C; right: error from 0.5 s on", steps, columns=2),
        "resolution": over_time(
            "Stairs of 10 nm, compensators A, B, C",
            stairs({f"Compensator {letter}": f"stairs_{letter}" for letter in COMPENSATORS}, 0.6),
        ),
        "stairs": over_time(
            "Stairs of 5 nm, cold and warm, compensator C", stairs({"Cold": "stairs_cold", "Warm": "stairs_warm"})
        ),
        "limit_cycle": over_time(
            "Limit cycle above the ultimate gain, step of 10 µm",
            [Signals("Position", "m", {"K_P = 2.6 A·s/mm": f"limit_cycle: {position}"}, (0.5, math.inf))],
        ),
    }


STUDY = read_study(Path(__file__).with_name("claims.toml"), runs(), pictures(), measures=MEASURES, own_rules=RULES)
