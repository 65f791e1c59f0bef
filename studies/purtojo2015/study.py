"""Fuzzy NCTF control of a linear stage: the statements of the paper compared with the results of its equations."""

from __future__ import annotations

import math
from pathlib import Path

from cosim.study import Numbers, Outcomes, Picture, Run, measures, read_study
from cosim.study.pictures import Signals, errors_of, over_time

SINES = {
    "1mm_pi": ("1 mm at π", 1e-3, 0.5),
    "1.5mm_pi": ("1.5 mm at π", 1.5e-3, 0.5),
    "5mm_pi": ("5 mm at π", 5e-3, 0.5),
    "1mm_2pi": ("1 mm at 2π", 1e-3, 1.0),
    "1mm_4pi": ("1 mm at 4π", 1e-3, 2.0),
}
"""Amplitude in m and frequency in Hz; the labels have the frequency of the paper in rad/s."""
STEPS = {"1mm": ("1 mm", 1e-3), "5mm": ("5 mm", 5e-3)}
GRID = {"controller.defuzzification": "grid", "controller.grid_points": 101}
POINTS = ((0.1, 0.0), (10.0, 0.0), (56.72, 0.0), (0.05, -1.0))
"""Inputs of the fuzzy rules at which the command is measured: u_p in mm/s, u_i in mm."""
MM = 1e3


# Runs


def rule_name(u_p: float, u_i: float) -> str:
    return f"rules_{u_p:g}_{u_i:g}"


def runs() -> dict[str, Run]:
    found: dict[str, Run] = {}
    kinds = {"proposed": "", "existing": "", "proposed_slow": "_slow", "proposed_slow_grid": "_slow"}
    for name, suffix in kinds.items():
        variant = name.split("_")[0]
        changed = GRID if name.endswith("grid") else {}
        for key, (_, amplitude, frequency) in SINES.items():
            sine = {"trajectory.amplitude": amplitude, "trajectory.frequency": frequency}
            found[f"{name}_{key}"] = Run(f"{variant}_sine{suffix}.toml", sine | changed)
        for key, (_, amplitude) in STEPS.items():
            step = {"trajectory.amplitude": amplitude}
            found[f"{name}_step_{key}"] = Run(
                f"{variant}_step{suffix}.toml",
                step | changed,
                measure=measures.step_response(shares={"settling": 0.02}),
            )
    for u_p, u_i in POINTS:
        # 1 um of the source is 1 mm/s; two samples, T_s = 0.5 s, bring the integral to u_i, the first prepares it
        first = 1e-6 * (2.0 * u_i - u_p)
        found[rule_name(u_p, u_i)] = Run(
            "rules.toml",
            {"source.offset": first, "source.amplitude": 1e-6 * u_p - first},
            measure=measures.sample(1, {name: f"controller.{name}" for name in ("u_p", "u_i", "command")}),
        )
    return found


# What a claim measures beyond single figures


def commands(outcomes: Outcomes) -> Numbers:
    found: dict[str, float] = {}
    for u_p, u_i in POINTS:
        numbers = outcomes[rule_name(u_p, u_i)].numbers
        reached = math.isclose(MM * numbers["u_p"], u_p, abs_tol=1e-11)
        reached = reached and math.isclose(MM * numbers["u_i"], u_i, abs_tol=1e-11)
        found[f"({u_p:g}, {u_i:g})"] = numbers["command"] if reached else math.nan
    return found


# Pictures


def pictures() -> dict[str, Picture]:
    """All pictures by file name."""
    kinds = {"Proposed": "proposed", "Existing": "existing"}
    labels = {key: f"{text} rad/s" for key, (text, _, _) in SINES.items()}
    errors = {
        "errors_proposed": ("proposed", "proposed, T = 0.1 ms"),
        "errors_slow": ("proposed_slow", "proposed, T = 0.75 ms"),
        "errors_existing": ("existing", "existing, T = 0.1 ms"),
    }
    steps = [
        Signals("Position", "m", {text: f"{k}_step_{key}: plant.position" for text, k in kinds.items()}, (0.0, end))
        for key, end in (("1mm", 0.15), ("5mm", 0.6))
    ]
    return {
        "steps": over_time("Steps of 1 mm and 5 mm, T = 0.1 ms", steps),
        **{
            name: errors_of(f"Error on sines, {text}", {labels[key]: f"{kind}_{key}" for key in SINES})
            for name, (kind, text) in errors.items()
        },
    }


STUDY = read_study(Path(__file__).with_name("claims.toml"), runs(), pictures(), measures={"commands": commands})
