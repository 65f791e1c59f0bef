"""NCTF control of a ballscrew: what the paper says against what its equations do."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np

from cosim.design.identify import nct_from_signals
from cosim.design.stability import limit_map, oscillation, read_map
from cosim.result import metrics, plots
from cosim.result.result import Result
from cosim.study import (
    Claim,
    Numbers,
    Outcomes,
    Picture,
    Rule,
    Run,
    Study,
    at_least,
    at_most,
    falling,
    near,
)

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
K_PU = 2400.0  # A.s/m, the paper's ultimate gain
K_P = 960.0  # A.s/m, 40 % of it
COMPENSATORS = {"A": 0.1, "B": 0.175, "C": 0.25}
"""omega_n*T_s of the compensators; fig. 10, which has them, is lost, so these are chosen: see the text."""
WARM = {"plant.F_C": 0.87 * 0.046, "plant.F_S": 0.87 * 0.046, "plant.sigma_2": 0.76 * 9.7e-4}
E_LIN = 0.643e-6
"""Position error in m at which the NCT's linear part ends."""
SCAN = 1.01
"""Ratio of one gain to the one before in a search for a limit of stability."""
ZETA_LIMITS = {0.02: 195.6, 0.05: 78.0, 0.1: 38.2, 0.2: 17.9, 0.25: 13.5, 0.3: 10.3, 0.4: 5.3}
"""Where the search for the largest damping ratio is centred, by omega_n*T_s: the figures of the independent runs."""
GAIN_LIMITS = {"": 2.395, "_parallel": 1.832, "_delayed": 1.832, "_frictionless": 0.645}
"""Where the search for the ultimate gain in A.s/mm is centred."""
MARGIN_LIMITS = {0: 616.40, 1: 256.63}
"""Ultimate gain in A.s/m of the frictionless object of fig. 17 for 0 and 1 samples of delay: eigenvalues."""
MARGINS = (0.1, 0.3, 0.6)
NM, UM, MM = 1e9, 1e6, 1e3


def integral_gain(W: float) -> float:
    """K_I in A/m for omega_n*T_s = ``W``."""
    return (W / T_S) ** 2 / GAIN


def zeta(gain: float, W: float) -> float:
    """Damping ratio that ``gain`` in A.s/m means by eq. (3a)."""
    return gain * GAIN * T_S / (2.0 * W)


# What is measured in a run, SI units


def measure_step(result: Result, window: Window) -> dict[str, float]:
    time, position = result.time, result["plant.position"]
    final = float(result["trajectory.position"][-1])
    command = result["controller.command"]
    return {
        "overshoot": metrics.overshoot(position, 0.0, final) / final,
        "settling_10nm": metrics.settling_time(time, position, final, 10e-9),
        "rise": metrics.rise_time(time, position, start=0.0, final=final),
        "residual": metrics.max_abs((position - final)[metrics.window(time, 0.8, 1.0)]),
        "saturated": float(np.sum(np.abs(command[:-1]) >= 6.0)) * T_S,
    }


def measure_margin(result: Result, window: Window) -> dict[str, float]:
    final = float(result["trajectory.position"][-1])
    return {"overshoot": metrics.overshoot(result["plant.position"], 0.0, final) / final}


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
    """Peak to peak and frequency of the last quarter of the run, and whether it is a sustained oscillation."""
    found = oscillation(result.time[:-1], result["plant.position"][:-1])
    return {"swing": found.size, "swing_frequency": found.frequency, "oscillates": float(found.sustained)}


def measure_pulse(result: Result, window: Window) -> dict[str, float]:
    """Open-loop identification: rest, largest velocity, NCT and where its slope has given values."""
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
    """A step of 10 um at rising gains, A.s/m."""
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
                measure=measure_margin,
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


# Claims


def number(run: str, name: str, factor: float = 1.0) -> Measure:
    return lambda outcomes: factor * outcomes.number(run, name)


def several(name: str, factor: float, **found: str) -> Measure:
    """One figure of several runs: label (``_`` for a space) -> run."""
    return lambda outcomes: {
        label.replace("_", " "): factor * outcomes.number(run, name) for label, run in found.items()
    }


def steps(name: str, factor: float, suffix: str = "", *, downwards: bool = False) -> Measure:
    """One figure of the seven steps, smallest first, or largest first."""

    def measure(outcomes: Outcomes) -> Numbers:
        items = list(STEPS.items())
        return {
            text: factor * outcomes.number(f"step_{key}{suffix}", name)
            for key, (text, _) in (items[::-1] if downwards else items)
        }

    return measure


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


def same_time(one: str, other: str) -> Measure:
    """Time to 10 nm of a run over that of another, minus 1, in percent."""
    return lambda outcomes: (
        100.0 * (outcomes.number(one, "settling_10nm") / outcomes.number(other, "settling_10nm") - 1.0)
    )


def _falls(measured: Numbers, _: Numbers) -> bool:
    values = list(measured.values())
    return values[-1] < 0.5 * values[0] and all(b < 1.02 * a for a, b in pairwise(values))


FALLING_OR_EQUAL = Rule("none more than 2 % above the one before, the last below half of the first", _falls)
GOOD_FROM_30 = Rule(
    "above 5 at 10 %, below 5 from 30 % on",
    lambda measured, _: all((value < 5.0) is (label != "10 %") for label, value in measured.items()),
)
REFERENCE = "Compensator C"
SLOWER = "ω_n T = 0.2"
CLAIMS = "Claims of the paper"
NUMBERS = "Reference numbers"
PRACTICAL = {f"{W:g}": K_PU * GAIN * T_S / (2.0 * W) for W in ZETA_LIMITS}
"""The paper's practical limit of the damping ratio, eq. (5)."""


def paper() -> list[Claim]:
    found: list[Claim] = []

    def claim(
        id: str,
        text: str,
        published: str | float | Numbers,
        unit: str,
        measure: Measure,
        verdicts: dict[str, Rule],
        note: str = "",
        setting: str = REFERENCE,
    ) -> None:
        found.append(Claim(id, text, published, unit, measure, verdicts, CLAIMS, setting, note))  # type: ignore[arg-type]

    claim(
        "M1",
        "Inclination of the NCT near its origin",
        505.0,
        "1/s",
        number("pulse", "inclination"),
        {"fitted": near(rel=0.01)},
        "Coulomb friction makes the inclination infinite at the origin; 505 1/s is that of the line to 0.643 µm.",
        "Open loop, 6 A for 0.1 s",
    )
    claim(
        "M2",
        "K = x_f/(u_r t_r) of the open-loop run",
        32.3,
        "mm/(A·s)",
        number("pulse_0.0329", "gain", MM),
        {"fitted": near(rel=5e-3)},
        "u_r and t_r are not printed; K is no constant of the stage: 6 A for 0.1 s gives 43 mm/(A·s).",
        "Open loop, 6 A for 32.9 ms",
    )
    claim(
        "M3",
        "Ultimate proportional gain K_Pu",
        2.4,
        "A·s/mm",
        ultimate_gain(),
        {"fitted": near(rel=0.03)},
        "Step of 10 µm, gains in steps of 1 %. The damping of the bristles, which the paper has not, was fitted to it.",
        "Proportional only",
    )
    claim(
        "M4",
        "Coulomb friction allows higher gains than the linear limit",
        "higher",
        "A·s/mm",
        lambda o: {
            "with friction": 1e-3 * last_stable(o, "gain"),
            "without": 1e-3 * last_stable(o, "gain_frictionless"),
        },
        {"reproduced": falling()},
        "",
        "Proportional only",
    )
    claim(
        "M5a",
        "ζ_prac fits the stability limit of the NCTF control system closely, by ω_n T",
        {label: PRACTICAL[label] for label in ("0.02", "0.05", "0.1", "0.2")},
        "1",
        zeta_limits(0.02, 0.05, 0.1, 0.2),
        {"reproduced": near(rel=0.1)},
        "Proportional and integral elements, step of 10 µm. Holds where the one fitted gain K_Pu does.",
        "Fixed K_I, rising K_P",
    )
    claim(
        "M5b",
        "ζ_prac fits the stability limit of the NCTF control system closely, by ω_n T",
        {label: PRACTICAL[label] for label in ("0.25", "0.3", "0.4")},
        "1",
        zeta_limits(0.25, 0.3, 0.4),
        {"reproduced": near(rel=0.1), "order only": falling()},
        "From ω_n T = 0.25 on the integral element takes a share that grows: half at 0.4.",
        "Fixed K_I, rising K_P",
    )
    claim(
        "M6",
        "Step of 20 mm without anti-windup: overshoot",
        9.3,
        "%",
        number("step_20mm_windup", "overshoot", 100.0),
        {"fitted": near(abs=2.0)},
        "ω_n T = 0.25 and the range of the NCT are chosen; exactly 9.3 % comes at 0.244, and an NCT that ends at "
        "15 mm gives none.",
    )
    claim(
        "M7",
        "Step of 20 mm with anti-windup: overshoot",
        "less than 0.01 %",
        "%",
        number("step_20mm", "overshoot", 100.0),
        {"reproduced": at_most(0.01)},
    )
    claim(
        "M8a",
        "Anti-windup does not change the time to an error below 10 nm",
        0.0,
        "%",
        same_time("step_20mm", "step_20mm_windup"),
        {"reproduced": near(abs=10.0)},
        "Difference; negative: sooner with anti-windup.",
    )
    claim(
        "M8b",
        "Anti-windup does not change the time to an error below 10 nm",
        0.0,
        "%",
        same_time("step_20mm_02", "step_20mm_02_windup"),
        {"reproduced": near(abs=10.0)},
        "But here the overshoot without anti-windup is 1 %, not 9.3 %: both claims do not hold at one ω_n T.",
        SLOWER,
    )
    claim(
        "M9",
        "With anti-windup the command saturates only in the reaching phase",
        "less",
        "s",
        several("saturated", 1.0, without="step_20mm_windup", **{"with": "step_20mm"}),
        {"reproduced": falling()},
        "Time in saturation.",
    )
    claim(
        "M10",
        "Positioning error from 100 nm to 20 mm",
        "less than 10 nm",
        "nm",
        steps("residual", NM),
        {"reproduced": at_most(10.0)},
        "Largest over 0.8 s to 1 s. The simulated sensor has its resolution but no noise.",
    )
    claim(
        "M11",
        "The rise time grows with the height of the step",
        "grows",
        "ms",
        steps("rise", MM, downwards=True),
        {"reproduced": FALLING_OR_EQUAL},
        "10 % to 90 %; 100 nm and 1 µm, both inside the elastic range of friction, take the same time.",
    )
    claim(
        "M12",
        "The resolution improves from compensator A to C, as ω_n T rises",
        "A < B < C",
        "ms",
        several("stair_time", 1e3, A="stairs_A", B="stairs_B", C="stairs_C"),
        {"reproduced": falling()},
        "Mean time until the table stays within 3 nm of a stair of 10 nm.",
        "Compensators A, B, C",
    )
    claim(
        "M13",
        "Stepwise inputs of 5 nm are resolved, before and after warming up",
        "5 nm",
        "nm",
        several("stair_error", NM, cold="stairs_cold", warm="stairs_warm"),
        {"reproduced": at_most(2.5)},
        "Largest mean error of a stair. Warm: Coulomb friction 13 %, viscous friction 24 % lower, as measured there.",
    )
    for delay, id, setting in ((1, "M14a", "One sample of delay"), (0, "M14b", "No delay")):
        claim(
            id,
            "Margins of safety above 30 % give good performance, smaller ones do not",
            "good from 30 % on",
            "%",
            several("overshoot", 100.0, **{f"{100 * m:g}_%": f"margin_{delay}_{m:g}" for m in MARGINS}),
            {"reproduced": GOOD_FROM_30},
            "Overshoot of 1 µm by margin. Without delay a margin of 10 % is good, too."
            if delay == 0
            else "Overshoot of 1 µm by margin, in per cent of the ultimate gain.",
            f"{setting}, object of fig. 17, 750 1/s",
        )
    found.append(
        Claim(
            "M15",
            "Average distance of ζ_prac from the limit over damping, friction and inclination of the NCT",
            {"damping": 10.0, "friction": 16.0, "inclination": 6.0},
            "%",
            limit_maps,
            {"reproduced": near(rel=0.2), "order only": at_most(20.0)},
            CLAIMS,
            "Cases 1 to 3",
            "Found by `cosim stability map` on the files in limits/. Points that are unstable from the start of the "
            "search count, too.",
        )
    )
    return found


def limit_maps(_: Outcomes) -> Numbers:
    """Mean distance of the practical limit from the one found by simulation, in per cent."""
    distances: dict[str, float] = {}
    for name in ("damping", "friction", "inclination"):
        file = read_map(Path(__file__).parent / "limits" / f"{name}.toml")
        distances[name] = 100.0 * limit_map(file.system, file.cases, K=file.K).mean_deviation
    return distances


def numbers() -> list[Claim]:
    found: list[Claim] = []

    def claim(
        id: str,
        text: str,
        published: float | Numbers,
        unit: str,
        measure: Measure,
        rule: Rule,
        setting: str = REFERENCE,
    ) -> None:
        found.append(Claim(id, text, published, unit, measure, {"reproduced": rule}, NUMBERS, setting))

    pulse = "Open loop, 6 A for 0.1 s"
    claim("N1a", "Position at rest", 25.8350, "mm", number("pulse", "rest", MM), near(rel=1e-4), pulse)
    claim("N1b", "Largest velocity", 134.473, "mm/s", number("pulse", "top_velocity", MM), near(rel=1e-3), pulse)
    claim(
        "N1c", "Distance from there to standstill", 18.4044, "mm", number("pulse", "reach", MM), near(rel=1e-3), pulse
    )
    claim(
        "N1d",
        "Spring-back",
        1.0464,
        "µm",
        lambda o: UM * (o.number("pulse", "stop") - o.number("pulse", "rest")),
        near(rel=0.01),
        pulse,
    )
    claim(
        "N2",
        "End of the NCT's linear part for an inclination in 1/s",
        {"250": 2.660, "505": 0.6426, "1010": 0.1600},
        "µm",
        lambda o: {f"{alpha:g}": UM * o.number("pulse", f"linear_{alpha:g}") for alpha in (250.0, 505.0, 1010.0)},
        near(rel=0.01),
        pulse,
    )
    claim(
        "N3",
        "Duration of 6 A for which K is 32.3 mm/(A·s)",
        32.88,
        "ms",
        pulse_length,
        near(rel=5e-3),
        "Open loop",
    )
    only = "Proportional only, step of 10 µm"
    claim("N6a", "Ultimate gain", 2.395, "A·s/mm", ultimate_gain(), near(rel=0.03), only)
    for id, what, suffix in (("N6b", "all FMUs in parallel", "_parallel"), ("N6c", "compute_delay = 1", "_delayed")):
        claim(id, f"Ultimate gain, {what}", 1.832, "A·s/mm", ultimate_gain(suffix), near(rel=0.03), only)
    claim("N7a", "Limit cycle at 2.6 A·s/mm", 7.0, "µm", number("limit_cycle", "swing", UM), near(rel=0.05), only)
    claim(
        "N7b",
        "Limit cycle at 2.6 A·s/mm: frequency",
        110.0,
        "Hz",
        number("limit_cycle", "swing_frequency"),
        near(abs=10.0),
        only,
    )
    claim(
        "N8a",
        "Step of 20 mm: overshoot",
        0.001,
        "%",
        number("step_20mm", "overshoot", 100.0),
        at_most(0.01),
    )
    claim("N8b", "Step of 20 mm: time to 10 nm", 0.550, "s", number("step_20mm", "settling_10nm"), near(rel=0.03))
    claim("N8c", "Step of 20 mm: rise time", 0.244, "s", number("step_20mm", "rise"), near(rel=0.02))
    claim(
        "N9",
        "Step of 20 mm without anti-windup: overshoot",
        10.96,
        "%",
        number("step_20mm_windup", "overshoot", 100.0),
        near(abs=0.7),
    )
    claim(
        "N10",
        "Residual of the seven steps",
        dict(zip((text for text, _ in STEPS.values()), (0.39, 0.58, 0.46, 0.63, 0.45, 0.68, 0.69), strict=True)),
        "nm",
        steps("residual", NM),
        at_most(2.0),
    )
    claim("N11a", "Step of 1 µm: overshoot", 19.5, "%", number("step_1um", "overshoot", 100.0), near(abs=0.8))
    claim("N11b", "Step of 10 µm: overshoot", 5.1, "%", number("step_10um", "overshoot", 100.0), near(abs=0.4))
    claim(
        "N11c",
        "Overshoot with one sample of delay",
        {"1 µm": 26.1, "10 µm": 8.7},
        "%",
        several("overshoot", 100.0, **{"1_µm": "step_1um_delayed", "10_µm": "step_10um_delayed"}),
        near(abs=0.4),
        "Compensator C, compute_delay = 1",
    )
    found.append(
        Claim(
            "N11d",
            "Overshoot, all FMUs in parallel",
            {"1 µm": 26.1, "10 µm": 8.7},
            "%",
            several("overshoot", 100.0, **{"1_µm": "step_1um_parallel", "10_µm": "step_10um_parallel"}),
            {"reproduced": near(abs=0.4), "order only": at_least(6.0)},
            NUMBERS,
            REFERENCE,
            "More than in sequence (19.5 and 5.1 %), less than with one sample of delay throughout: the first command, "
            "known after initialization, is applied at once and twice.",
        )
    )
    claim(
        "N12",
        "Stairs of 5 nm: largest mean error",
        {"cold": 0.48, "warm": 0.48},
        "nm",
        several("stair_error", NM, cold="stairs_cold", warm="stairs_warm"),
        at_most(1.0),
    )
    limits = (0.05, 0.1, 0.2, 0.25, 0.3)
    claim(
        "N13",
        "Largest damping ratio by ω_n T",
        {f"{W:g}": ZETA_LIMITS[W] for W in limits},
        "1",
        zeta_limits(*limits),
        near(rel=0.05),
        "Fixed K_I, rising K_P, step of 10 µm",
    )
    return found


# Pictures


def draw_windup(outcomes: Outcomes, path: Path) -> None:
    panels: list[plots.Panel] = []
    found = [("step_20mm", "With anti-windup"), ("step_20mm_windup", "Without")]
    results = [(text, outcomes.result(run)) for run, text in found]
    for quantity, unit, name in (("Position", "m", "plant.position"), ("Command", "A", "controller.command")):
        series = [plots.Series(text, result.time, result[name], i) for i, (text, result) in enumerate(results)]
        panels.append(plots.Panel(quantity, unit, tuple(series)))
    plots.plot_panels(path, panels)


def draw_steps(outcomes: Outcomes, path: Path) -> None:
    panels: list[plots.Panel] = []
    for i, (key, (text, size)) in enumerate(STEPS.items()):
        result = outcomes.result(f"step_{key}")
        relative = plots.Series(text, result.time, result["plant.position"] / size, i)
        panels.append(plots.Panel("Position over step", "1", (relative,)))
        part = metrics.window(result.time, 0.5)
        error = (result["plant.position"] - size)[part]
        panels.append(plots.Panel("Error", "m", (plots.Series(text, result.time[part], error, i),)))
    plots.plot_panels(path, panels, columns=2)


def draw_stairs(outcomes: Outcomes, path: Path) -> None:
    panels: list[plots.Panel] = []
    for i, (run, text) in enumerate((("stairs_cold", "Cold"), ("stairs_warm", "Warm"))):
        result = outcomes.result(run)
        series = (
            plots.Series(text, result.time, result["plant.position"], i),
            plots.Series("Reference", result.time, result["trajectory.position"], 6),
        )
        panels.append(plots.Panel("Position", "m", series))
    plots.plot_panels(path, panels)


def draw_resolution(outcomes: Outcomes, path: Path) -> None:
    panels: list[plots.Panel] = []
    for i, letter in enumerate(COMPENSATORS):
        result = outcomes.result(f"stairs_{letter}")
        part = metrics.window(result.time, 0.0, 0.6)
        series = (
            plots.Series(f"Compensator {letter}", result.time[part], result["plant.position"][part], i),
            plots.Series("Reference", result.time[part], result["trajectory.position"][part], 6),
        )
        panels.append(plots.Panel("Position", "m", series))
    plots.plot_panels(path, panels)


def draw_open_loop(outcomes: Outcomes, path: Path) -> None:
    result = outcomes.result("pulse")
    panels = [
        plots.Panel(quantity, unit, (plots.Series("6 A for 0.1 s", result.time, result[name], 0),))
        for quantity, unit, name in (
            ("Current", "A", "plant.command"),
            ("Velocity", "m/s", "plant.velocity"),
            ("Position", "m", "plant.position"),
        )
    ]
    plots.plot_panels(path, panels)


def draw_limit_cycle(outcomes: Outcomes, path: Path) -> None:
    result = outcomes.result("limit_cycle")
    part = metrics.window(result.time, 0.5)
    series = plots.Series("K_P = 2.6 A·s/mm", result.time[part], result["plant.position"][part], 0)
    plots.plot_panels(path, [plots.Panel("Position", "m", (series,))])


STUDY = Study(
    title="NCTF control of a ballscrew with nanometre resolution (Maeda and Sato 2008)",
    source=(
        "G. J. Maeda, K. Sato: Practical control method for ultra-precision positioning using a ballscrew mechanism. "
        "Precision Engineering 32, 2008."
    ),
    text="""
The paper positions a conventional ballscrew to 10 nm with a nominal characteristic trajectory (NCT) and a PI
compensator, in experiment and simulation. What it does not print had to be chosen, and what was chosen to give a
printed figure is called **fitted** below: the LuGre friction in place of the paper's stick rule (its stiffness from
the usual presliding distance, its damping from the ultimate gain), the open-loop run behind the NCT (6 A for 0.1 s),
and ω_n T of the three compensators (0.1, 0.175, 0.25). The gains use the paper's α = 505 1/s and K = 32.3 mm/(A·s),
which belong to another, shorter open-loop run than the NCT: no single run gives both and the printed overshoot.

The controller samples at 5 kHz a position rounded to 1.24 nm, without noise. Errors are position minus reference.
""",
    runs=runs(),
    claims=(*paper(), *numbers()),
    pictures={
        "open_loop": Picture("Open loop: 6 A for 0.1 s", draw_open_loop),
        "antiwindup": Picture("Step of 20 mm with and without anti-windup, compensator C", draw_windup),
        "steps": Picture("Seven steps, compensator C; right: error from 0.5 s on", draw_steps),
        "resolution": Picture("Stairs of 10 nm, compensators A, B, C", draw_resolution),
        "stairs": Picture("Stairs of 5 nm, cold and warm, compensator C", draw_stairs),
        "limit_cycle": Picture("Limit cycle above the ultimate gain, step of 10 µm", draw_limit_cycle),
    },
    groups={
        CLAIMS: "What the paper says, and the figure that decides.",
        NUMBERS: (
            "Published here are the figures of an independent simulation of the same equations (fixed-step RK4, other "
            "code), not of the paper, with the tolerances agreed for acceptance: they check these FMUs. Limits are "
            "searched in steps of 1 % around them; where the search does not enclose the limit, nothing is measured. "
            "The linear limits are eigenvalues of the sampled loop, not runs: they are tested with the components."
        ),
    },
)
