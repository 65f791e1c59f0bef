"""Ballscrew stage under three sliding-mode controllers: what the chapter says against what its equations do."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import numpy as np

from cosim.result import metrics, plots
from cosim.result.metrics import Array
from cosim.result.result import Result
from cosim.study import (
    Claim,
    Numbers,
    Outcomes,
    Picture,
    Run,
    Study,
    at_least,
    at_most,
    between,
    both,
    falling,
    near,
)

Window = tuple[float, float]
Measure = Callable[[Outcomes], Numbers]

CONTROLLERS = {"smc": "SMC", "csmc": "CSMC", "fsmc": "FSMC"}
REFERENCES = {"step": "step 1 mm", "slow": "0.01 sin t", "5sin": "5 sin t", "2pi": "sin 2πt"}
SINES = ("slow", "5sin", "2pi")
TRACKED = ("5sin", "2pi")
FREQUENCIES: Mapping[str, float] = {"slow": 0.5 / math.pi, "5sin": 0.5 / math.pi, "2pi": 1.0}
UM = 1e6
LEAD = 1.5923e-3
"""Lead of the screw, m/rad."""

WINDOWS_I: Mapping[str, Window] = {"step": (0.5, 1.0), "slow": (3.7, 10.0), "5sin": (3.7, 10.0), "2pi": (1.0, 3.0)}
WINDOWS_P: Mapping[str, Window] = {"step": (0.4, 0.6), "slow": (1.2, 5.2), "5sin": (1.2, 5.2), "2pi": (0.5, 2.0)}
FEEDS = {"r10_f150": (10.0, 150.0), "r20_f500": (20.0, 500.0), "r20_f1000": (20.0, 1000.0), "r20_f3000": (20.0, 3000.0)}
FEED_TEXT = {"r10_f150": "R10 F150", "r20_f500": "R20 F500", "r20_f1000": "R20 F1000", "r20_f3000": "R20 F3000"}
GAPS = (5, 10)
"""Total backlash in um."""
RADIUS_FREQUENCIES = (0.5, 1.0, 2.0, 4.0)
SPEEDS = (1e-4, 1e-3, 1e-2, 1.0, 5.0)
RULE_POINTS = {
    (1.0, -1.0): -0.833333333,
    (1.0, 0.0): -0.5,
    (0.0, -1.0): -0.5,
    (1.0, 1.0): 0.0,
    (0.5, -0.5): -0.310606061,
    (0.25, -0.75): -0.370726496,
    (0.5, 0.0): -0.25,
    (0.1, -0.1): -0.070700152,
    (0.01, -0.01): -0.007450781,
    (0.3, 0.2): -0.044326241,
    (-0.6, 0.1): 0.293105756,
    (0.05, 0.02): -0.02058548,
}


# What is measured in a run, SI units


def error(result: Result) -> Array:
    """Position error, m."""
    return result["plant.position"] - result["trajectory.position"]


def measure_step(result: Result, window: Window) -> dict[str, float]:
    """Overshoot and settling of a step of 1 mm."""
    position, time = result["plant.position"], result.time
    return {
        "overshoot": metrics.overshoot(position, 0.0, 1e-3),
        "settling_1um": metrics.settling_time(time, position, 1e-3, 1e-6),
        "settling_20um": metrics.settling_time(time, position, 1e-3, 20e-6),
    }


def measure_sine(result: Result, window: Window) -> dict[str, float]:
    """What happens at the reversals of a sine, and the table's top speed over that of the reference."""
    part = metrics.window(result.time, *window)
    time, reference, position = result.time[part], result["trajectory.position"][part], result["plant.position"][part]
    peaks = metrics.reversal_peaks(time, position - reference, reference)
    return {
        "reversal_peak": max((abs(peak.peak) for peak in peaks), default=math.nan),
        "reversal_base": max((peak.base for peak in peaks), default=math.nan),
        "reversal_delay": max((peak.delay for peak in peaks), default=math.nan),
        "reversal_decay": max((peak.decay for peak in peaks), default=math.nan),
        "slip": metrics.max_abs(np.diff(position)) / metrics.max_abs(np.diff(reference)),
    }


def measure_amplitude(frequency: float) -> Callable[[Result, Window], dict[str, float]]:
    """The error of the amplitude at ``frequency`` Hz."""

    def measure(result: Result, window: Window) -> dict[str, float]:
        part = metrics.window(result.time, *window)
        time = result.time[part]
        amplitude, wanted = (
            metrics.sine_amplitude(time, result[name][part], frequency)
            for name in ("plant.position", "trajectory.position")
        )
        return {"amplitude_error": amplitude - wanted}

    return measure


def measure_circle(radius: float) -> Callable[[Result, Window], dict[str, float]]:
    """The circular test of the second turn."""

    def measure(result: Result, window: Window) -> dict[str, float]:
        test = circle(result, radius)
        return {
            "G": test.circular_deviation,
            "F_max": test.radial_max,
            "F_min": test.radial_min,
            "mean_deviation": test.radial_mean,
            **{f"spike_{90 * i}": spike for i, spike in enumerate(test.spikes)},
        }

    return measure


def circle(result: Result, radius: float) -> metrics.CircularTest:
    """The second turn of two axes."""
    return metrics.circular_test(
        result["plant_x.position"],
        result["plant_y.position"],
        result["trajectory_x.position"],
        result["trajectory_y.position"],
        radius=radius,
    )


def measure_stage(result: Result, window: Window) -> dict[str, float]:
    """Acceleration, speed and friction torque of the stage alone, at start and end."""
    speed = result["plant.speed"]
    late = metrics.window(result.time, 5e-3, 15e-3)
    ends = np.abs(speed[late][[0, -1]])
    return {
        "acceleration_start": float(result["plant.der(state.speed)"][0]),
        "speed_start": float(speed[0]),
        "speed_end": float(speed[-1]),
        "friction_start": float(result["plant.friction_torque"][0]),
        "decay_rate": math.log(ends[0] / ends[1]) / 0.01 if ends[1] > 0.0 else math.nan,
    }


def measure_rules(result: Result, window: Window) -> dict[str, float]:
    """The surfaces and the fuzzy output at the start."""
    names = {"s": "sliding_surface", "s_c": "complementary_surface", "fz": "fuzzy_command"}
    return {short: float(result[f"controller.{name}"][0]) for short, name in names.items()}


def measure_backlash(result: Result, window: Window) -> dict[str, float]:
    """Lost motion between screw and table, the error of each, variation of the command."""
    part = metrics.window(result.time, *window)
    reference, screw, table = (
        result[name][part] for name in ("trajectory.position", "plant.motor_position", "plant.position")
    )
    return {
        "lost_motion": float(np.ptp(screw - table)),
        "screw_error": metrics.max_abs(screw - reference),
        "table_error": metrics.max_abs(table - reference),
        "variation": metrics.total_variation(result.time[part], result["controller.command"][part]),
    }


# Runs


def runs() -> dict[str, Run]:
    """All runs by name."""
    found: dict[str, Run] = {}
    for reference in REFERENCES:
        measure = measure_step if reference == "step" else measure_sine
        for controller in CONTROLLERS:
            name = f"{controller}_{reference}"
            found[name] = Run(f"{name}.toml", window=WINDOWS_I[reference], measure=measure)
            found[f"{name}_2us"] = Run(f"{name}_2us.toml", window=WINDOWS_P[reference], measure=measure, keep_every=50)
        found[f"smci_{reference}"] = Run(
            f"smc_{reference}.toml", {"controller.integral_surface": True}, None, WINDOWS_I[reference], measure
        )
    for controller in ("smc", "csmc"):
        found[f"{controller}_5sin_chatter"] = Run(
            f"{controller}_5sin_chatter.toml", window=WINDOWS_I["5sin"], measure=measure_sine
        )
    for controller in CONTROLLERS:
        measured = {"controller.friction_velocity": "measured"}
        found[f"{controller}_5sin_measured"] = Run(
            f"{controller}_5sin.toml", measured, window=WINDOWS_I["5sin"], measure=measure_sine
        )
        found[f"{controller}_step_measured"] = Run(f"{controller}_step.toml", measured, 0.4, (0.35, 0.4))
        for frequency in RADIUS_FREQUENCIES:
            found[f"{controller}_{frequency:g}Hz"] = Run(
                f"{controller}_2pi.toml",
                {"trajectory.frequency": frequency},
                5.0,
                (1.0, 5.0),
                measure_amplitude(frequency),
            )
        for feed, (millimetres, millimetres_a_minute) in FEEDS.items():
            radius, speed = 1e-3 * millimetres, millimetres_a_minute / 60e3
            turn = 2.0 * math.pi * radius / speed
            overrides: dict[str, float | int | bool | str] = {"plant_x.position_start": radius}
            for axis in ("trajectory_x", "trajectory_y"):
                overrides |= {f"{axis}.radius": radius, f"{axis}.feed": speed}
            found[f"dbb_{controller}_{feed}"] = Run(
                f"dbb_{controller}.toml",
                overrides,
                math.ceil(10.0 * (2.0 * turn + 0.25)) / 10.0,
                (turn + 0.25, 2.0 * turn + 0.25),
                measure_circle(radius),
                keep_every=10,
            )
    for gap in GAPS:
        halves = {"plant.gap_plus": 0.5e-6 * gap, "plant.gap_minus": 0.5e-6 * gap}
        for controller, system in (("smc", "backlash_smc.toml"), ("fsmc", "backlash.toml")):
            found[f"{controller}_backlash_{gap}"] = Run(system, halves, None, (2.0, 6.0), measure_backlash)
    turn = 2.0 * math.pi * 0.015 / 0.01
    second = (turn + 0.25, 2.0 * turn + 0.25)
    rigid = {"plant_x.position_start": 0.015}
    for axis in ("trajectory_x", "trajectory_y"):
        rigid |= {f"{axis}.radius": 0.015, f"{axis}.feed": 0.01}
    found["circle_rigid"] = Run("dbb_fsmc.toml", rigid, 19.2, second, measure_circle(0.015), keep_every=10)
    found["circle_backlash"] = Run("dbb_backlash.toml", window=second, measure=measure_circle(0.015), keep_every=10)
    found["stage_inertia"] = Run("stage.toml", {"plant.command": 1.0}, measure=measure_stage)
    found["stage_poles"] = Run(
        "stage.toml",
        {"plant.velocity_start": 1e-6 * LEAD, "plant.bristle_start": 0.0, "plant.tolerance": 1e-12},
        measure=measure_stage,
    )
    found["stage_12Nm"] = Run("stage.toml", {"plant.command": 12.0}, measure=measure_stage)
    for speed in SPEEDS:
        found[f"stage_{speed:g}"] = Run("stage.toml", {"plant.velocity_start": speed * LEAD}, measure=measure_stage)
    for s, s_c in RULE_POINTS:
        # without integral s_c = der_e and s = der_e + 2*lambda*e, lambda = 150 1/s
        found[rule_run(s, s_c)] = Run(
            "rules.toml",
            {"controller.velocity_ref": -s_c * LEAD, "controller.position_ref": -(s - s_c) / 300.0 * LEAD},
            measure=measure_rules,
        )
    return found


def rule_run(s: float, s_c: float) -> str:
    """Name of the run at a point of the rules."""
    return f"rules_{s:g}_{s_c:g}"


# What claims measure: functions of all outcomes


def each(
    name: str, controllers: tuple[str, ...], references: tuple[str, ...], profile: str = "", factor: float = 1.0
) -> Measure:
    """A figure's magnitude in the runs of controllers and references, labelled by whichever there are several of."""

    def measure(outcomes: Outcomes) -> Numbers:
        found: dict[str, float] = {}
        for controller in controllers:
            for reference in references:
                parts = [CONTROLLERS[controller]] if len(controllers) > 1 else []
                parts += [REFERENCES[reference]] if len(references) > 1 else []
                run = f"{controller}_{reference}{profile}"
                found[" ".join(parts)] = abs(factor * outcomes.number(run, name))
        return found

    return measure


def of(name: str, runs: Mapping[str, str], factor: float = 1.0) -> Measure:
    """A figure's magnitude in single runs: label -> run."""
    return lambda outcomes: {label: abs(factor * outcomes.number(run, name)) for label, run in runs.items()}


def ratio(one: Measure, other: Measure) -> Measure:
    """The values of one measure over those of another, place by place, labelled as the first."""

    def measure(outcomes: Outcomes) -> Numbers:
        divisors = other(outcomes).values()
        return {label: value / by for (label, value), by in zip(one(outcomes).items(), divisors, strict=True)}

    return measure


def join(parts: Mapping[str, Measure]) -> Measure:
    """Several measures, each label preceded by the name of its part."""
    return lambda outcomes: {
        f"{name} {label}".strip(): value for name, part in parts.items() for label, value in part(outcomes).items()
    }


def both_profiles(name: str, controllers: tuple[str, ...], references: tuple[str, ...], factor: float = 1.0) -> Measure:
    """``each`` in profile P and in profile I."""
    return join(
        {"P": each(name, controllers, references, "_2us", factor), "I": each(name, controllers, references, "", factor)}
    )


def growth(controllers: tuple[str, ...], profile: str) -> Measure:
    """Largest error at sin 2 pi t over that at 5 sin t."""
    slow, fast = (each("error_max", controllers, (reference,), profile) for reference in ("5sin", "2pi"))
    return ratio(fast, slow)


def per_reversal(profile: str) -> Measure:
    """Variation of the command of FSMC for one reversal, N.m."""
    return lambda outcomes: {
        REFERENCES[reference]: outcomes.number(f"fsmc_{reference}{profile}", "command_tv") / (2.0 * frequency)
        for reference, frequency in FREQUENCIES.items()
    }


def circles(name: str, controller: str, feeds: tuple[str, ...] = tuple(FEEDS)) -> Measure:
    """A length of the double ball bar at several feeds, um."""
    return lambda outcomes: {FEED_TEXT[feed]: UM * outcomes.number(f"dbb_{controller}_{feed}", name) for feed in feeds}


def spikes(outcomes: Outcomes) -> Numbers:
    """The smallest of the four reversal spikes as a share of the circular deviation."""
    found: dict[str, float] = {}
    for feed in ("r10_f150", "r20_f500"):
        run = f"dbb_fsmc_{feed}"
        smallest = min(abs(outcomes.number(run, f"spike_{angle}")) for angle in (0, 90, 180, 270))
        found[FEED_TEXT[feed]] = smallest / outcomes.number(run, "G")
    return found


def amplitudes(controller: str) -> Measure:
    """Amplitude errors of sines of 1 mm, um."""
    return lambda outcomes: {
        f"{frequency:g} Hz": UM * outcomes.number(f"{controller}_{frequency:g}Hz", "amplitude_error")
        for frequency in RADIUS_FREQUENCIES
    }


def poles(outcomes: Outcomes) -> Numbers:
    """Poles at rest: their sum from the acceleration of a moving stage, bristles straight, the slow from its decay."""
    start = outcomes["stage_poles"].numbers
    slow = -start["decay_rate"]
    return {"fast": start["acceleration_start"] / start["speed_start"] - slow, "slow": slow}


def fuzzy(outcomes: Outcomes) -> Numbers:
    """The fuzzy output at the points of the table; NaN where the controller did not see the surfaces wanted."""
    found: dict[str, float] = {}
    for s, s_c in RULE_POINTS:
        numbers = outcomes[rule_run(s, s_c)].numbers
        seen = math.isclose(numbers["s"], s, abs_tol=1e-12) and math.isclose(numbers["s_c"], s_c, abs_tol=1e-12)
        found[f"({s:g}, {s_c:g})"] = numbers["fz"] if seen else math.nan
    return found


# Claims

PROFILES = {
    "P": ("Profile P: 2 µs, φ = 0.1 rad/s as in the chapter", "_2us"),
    "I": ("Profile I: 10 kHz, φ = 4 rad/s", ""),
}
PROFILE_P, PROFILE_I = PROFILES["P"][0], PROFILES["I"][0]
BOTH = "Both profiles"
MEASURED = "Profile I, friction model fed with the measured velocity"
LITERAL = "Profile I, surface with integral: eqs. (8) to (11) literally"
CHATTER = "10 kHz with the chapter's φ = 0.1 rad/s"
SCALING = "The chapter's scaling factors (its fig. 10) are lost; those used were chosen on these very references."
CLAIMS = "Claims of the chapter"
NUMBERS = "Reference numbers"
BACKLASH = "Backlash"
AT_SCREW = "2 sin 3t, 10 kHz, controlled at the screw"

ALL = tuple(CONTROLLERS)
STEP = ("step",)


def chapter() -> Iterator[Claim]:
    """What the chapter says in words, in the order of its sections 6 and 7."""
    order = "Step: SMC has the largest positioning error, FSMC the smallest"
    for profile, (setting, suffix) in PROFILES.items():
        yield Claim(
            f"C1 {profile}",
            order,
            "SMC > CSMC > FSMC",
            "µm",
            each("error_end", ALL, STEP, suffix, UM),
            {"fitted": falling()},
            CLAIMS,
            setting,
            f"At the end; on its way FSMC overshoots most (A7). {SCALING}",
        )
    yield Claim(
        "C1 measured",
        order,
        "SMC > CSMC > FSMC",
        "µm",
        each("error_max", ALL, STEP, "_measured", UM),
        {"fitted": falling()},
        CLAIMS,
        MEASURED,
        "From 0.35 s to 0.4 s: the loop of FSMC diverges, its run ends before it overflows.",
    )
    for profile, (setting, suffix) in PROFILES.items():
        yield Claim(
            f"C2 {profile}",
            "Step: SMC has a steady-state error",
            "a steady-state error",
            "µm",
            each("error_end", ("smc",), STEP, suffix, UM),
            {"reproduced": at_least(0.1)},
            CLAIMS,
            setting,
            "With the surface without integral, to which the bound (13) belongs.",
        )
    yield Claim(
        "C2 literal",
        "Step: SMC has a steady-state error",
        "a steady-state error",
        "µm",
        of("error_max", {"": "smci_step"}, UM),
        {"reproduced": at_least(0.1)},
        CLAIMS,
        LITERAL,
    )
    for profile, (setting, suffix) in PROFILES.items():
        yield Claim(
            f"C3 {profile}",
            "Step: CSMC eliminates the steady-state error",
            "eliminated",
            "µm",
            each("error_end", ("csmc",), STEP, suffix, UM),
            {"reproduced": at_most(0.05)},
            CLAIMS,
            setting,
            "A quarter of that of SMC and all but frozen: the bristles hold the table like a spring.",
        )
    for profile, (setting, suffix) in PROFILES.items():
        yield Claim(
            f"C4 {profile}",
            "Step: FSMC eliminates the steady-state error",
            "eliminated",
            "µm",
            each("error_max", ("fsmc",), STEP, suffix, UM),
            {"fitted": at_most(0.05)},
            CLAIMS,
            setting,
            SCALING,
        )
    yield Claim(
        "C5",
        "Step: the commands of SMC and CSMC do not return to zero",
        "not zero: friction acts as a spring",
        "N·m",
        both_profiles("command_mean", ("smc", "csmc"), STEP),
        {"reproduced": at_least(1.0)},
        CLAIMS,
        BOTH,
        "Mean over the window.",
    )
    yield Claim(
        "C6",
        "Step: FSMC sets the command to zero",
        "zero",
        "N·m",
        both_profiles("command_mean", ("fsmc",), STEP),
        {"reproduced": at_most(0.1)},
        CLAIMS,
        BOTH,
        "Mean over the window. At rest the command equals the force of the bristles, with zero error too.",
    )
    yield Claim(
        "C7",
        "Step: the command of FSMC oscillates",
        "an oscillating behaviour",
        "N·m/s",
        each("command_tv", ("fsmc",), STEP),
        {"reproduced": at_least(0.1)},
        CLAIMS,
        PROFILE_I,
        "Variation of the command a second; that of SMC is 0.",
    )
    for profile, (setting, suffix) in PROFILES.items():
        yield Claim(
            f"C8 {profile}",
            "Tracking: the error of CSMC is half that of SMC",
            "ratio at most 0.5",
            "1",
            ratio(each("error_max", ("csmc",), SINES, suffix), each("error_max", ("smc",), SINES, suffix)),
            {"reproduced": at_most(0.55), "order only": at_most(0.95)},
            CLAIMS,
            setting,
            "Ratio of the largest errors; the chapter derives it from the bounds (13) and (16).",
        )
    for name, setting, one, other, smooth in (
        ("P", PROFILE_P, "smc_5sin_2us", "csmc_5sin_2us", "fsmc_5sin_2us"),
        ("10 kHz", CHATTER, "smc_5sin_chatter", "csmc_5sin_chatter", "fsmc_5sin"),
        ("measured", MEASURED, "smc_5sin_measured", "csmc_5sin_measured", "fsmc_5sin"),
    ):
        yield Claim(
            f"C9 {name}",
            "Tracking: SMC and CSMC chatter, CSMC less",
            "fluctuations and chatter, lower for CSMC",
            "1",
            ratio(of("command_tv", {"SMC": one, "CSMC": other}), of("command_tv", {"SMC": smooth, "CSMC": smooth})),
            {"reproduced": both(at_least(5.0), falling())},
            CLAIMS,
            f"{setting}; 5 sin t",
            "Variation of the command over that of the smooth FSMC.",
        )
    for profile, (setting, suffix) in PROFILES.items():
        yield Claim(
            f"C10 {profile}",
            "Tracking: the command of FSMC is smooth",
            "no fluctuations, no chattering",
            "N·m",
            per_reversal(suffix),
            {"fitted": at_most(56.0)},
            CLAIMS,
            setting,
            "Variation of the command for one reversal: static friction alone swings by 18.7 N·m, three times that is "
            f"allowed. {SCALING}",
        )
    yield Claim(
        "C10 measured",
        "Tracking: the command of FSMC is smooth",
        "no fluctuations, no chattering",
        "N·m",
        of("command_tv", {"": "fsmc_5sin_measured"}, math.pi),
        {"fitted": at_most(56.0)},
        CLAIMS,
        f"{MEASURED}; 5 sin t",
        "Variation of the command for one reversal.",
    )
    for controller in ("csmc", "fsmc"):
        yield Claim(
            f"C11 {CONTROLLERS[controller]}",
            f"Tracking: the error of {CONTROLLERS[controller]} peaks where the motion reverses",
            "peaks at reversals",
            "1",
            ratio(each("reversal_peak", (controller,), ("5sin",)), each("reversal_base", (controller,), ("5sin",))),
            {"reproduced": at_least(3.0)},
            CLAIMS,
            f"{PROFILE_I}; 5 sin t",
            "Peak over the median magnitude.",
        )
    for reference in ("5sin", "2pi", "slow"):
        yield Claim(
            f"C12 {REFERENCES[reference]}",
            f"{REFERENCES[reference]}: the error of FSMC after a reversal is damped in less than 0.1 s",
            "less than 0.1 s",
            "s",
            both_profiles("reversal_decay", ("fsmc",), (reference,)),
            {"reproduced": at_most(0.1)},
            CLAIMS,
            BOTH,
            "Until it stays below a tenth of the peak above the median magnitude.",
        )
    for profile, (setting, suffix) in PROFILES.items():
        yield Claim(
            f"C13 {profile}",
            "High frequency: the error of FSMC does not grow drastically",
            "no drastic growth",
            "1",
            growth(("fsmc",), suffix),
            {"reproduced": at_most(1.5)},
            CLAIMS,
            setting,
            "Largest error, sin 2πt over 5 sin t.",
        )
    for profile, (setting, suffix) in PROFILES.items():
        yield Claim(
            f"C14 {profile}",
            "High frequency: SMC and CSMC suffer from large errors",
            "large errors",
            "1",
            growth(("smc", "csmc"), suffix),
            {"reproduced": at_least(2.0)},
            CLAIMS,
            setting,
            "Largest error, sin 2πt over 5 sin t.",
        )
    yield Claim(
        "C15",
        "FSMC positions and tracks with less than a micrometre of error",
        "submicrometre",
        "µm",
        both_profiles("error_max", ("fsmc",), tuple(REFERENCES), UM),
        {"fitted": at_most(1.0)},
        CLAIMS,
        BOTH,
        SCALING,
    )
    remarks = {
        "fsmc": "Amplitude error; it goes with the square of the frequency.",
        "csmc": "Amplitude error.",
        "smc": "Amplitude error. The friction model over-compensates viscous friction, so the table leads.",
    }
    for controller, remark in remarks.items():
        yield Claim(
            f"C16 {CONTROLLERS[controller]}",
            f"The circle driven with {CONTROLLERS[controller]} shrinks as the frequency rises",
            "diameter becomes smaller",
            "µm",
            amplitudes(controller),
            {"reproduced": both(at_most(0.0), falling())},
            CLAIMS,
            f"{PROFILE_I}; sines of 1 mm",
            remark,
        )
    yield Claim(
        "C17",
        "The circle has stick-motion spikes at the reversals",
        "spikes at 0, 90, 180, 270°",
        "1",
        spikes,
        {"reproduced": at_least(0.25)},
        CLAIMS,
        f"{PROFILE_I}; FSMC",
        "Smallest of the four spikes over the circular deviation G.",
    )
    yield Claim(
        "C18",
        "Stick-slip cannot be seen in the simulations",
        "not seen",
        "1",
        each("slip", ALL, ("slow",)),
        {"reproduced": at_most(10.0)},
        CLAIMS,
        f"{PROFILE_I}; 0.01 sin t",
        "Top speed of the table over that of the reference: it sticks, then jumps.",
    )
    yield Claim(
        "C19",
        "Double-ball-bar experiments agree with the simulations",
        "no figures",
        group=CLAIMS,
        note="The chapter prints no measurement.",
    )


def reference_numbers() -> Iterator[Claim]:
    """Figures of another simulation of the same equations, A1 to A15 with the tolerances agreed for acceptance."""

    def number(
        name: str,
        text: str,
        published: float | Numbers,
        unit: str,
        measure: Measure,
        tolerance: float,
        setting: str = PROFILE_I,
    ) -> Claim:
        return Claim(name, text, published, unit, measure, {"reproduced": near(rel=tolerance)}, NUMBERS, setting)

    stage = "Stage alone"
    yield number(
        "A1a",
        "Inertia at the screw",
        3.702102e-4,
        "kg·m²",
        lambda o: {"": 1.0 / o.number("stage_inertia", "acceleration_start")},
        1e-6,
        stage,
    )
    yield number("A1b", "Poles at rest beside 0", {"fast": -8.5495e5, "slow": -315.9}, "1/s", poles, 1e-3, stage)
    friction = dict(zip((f"{v:g}" for v in SPEEDS), (9.329, 7.38818, 6.244, 6.64, 8.24), strict=True))
    yield number(
        "A2",
        "Steady friction torque at speeds of the screw in rad/s",
        friction,
        "N·m",
        lambda o: {f"{v:g}": o.number(f"stage_{v:g}", "friction_start") for v in SPEEDS},
        1e-4,
        stage,
    )
    yield number(
        "A3", "Final speed at 12 N·m", 14.4, "rad/s", lambda o: {"": o.number("stage_12Nm", "speed_end")}, 1e-3, stage
    )
    yield Claim(
        "A4",
        "Nine fuzzy rules, exact centroid, at (G_s s, G_c s_c)",
        {f"({s:g}, {s_c:g})": value for (s, s_c), value in RULE_POINTS.items()},
        "1",
        fuzzy,
        {"reproduced": near(abs=1e-6)},
        NUMBERS,
        "Controller alone",
    )
    yield number("A5a", "SMC, step: error at the end", 28.207, "µm", each("error_end", ("smc",), STEP, "", UM), 0.02)
    yield number("A5b", "SMC, 5 sin t: rms", 8.485, "µm", each("error_rms", ("smc",), ("5sin",), "", UM), 0.02)
    yield number(
        "A5c",
        "SMC, sin 2πt",
        {"max": 13.09, "rms": 9.913},
        "µm",
        join(
            {"max": each("error_max", ("smc",), ("2pi",), "", UM), "rms": each("error_rms", ("smc",), ("2pi",), "", UM)}
        ),
        0.02,
    )
    yield number("A6a", "CSMC, step: error at 1 s", 6.662, "µm", each("error_end", ("csmc",), STEP, "", UM), 0.02)
    largest_and_rms = {
        controller: join(
            {
                "max": each("error_max", (controller,), TRACKED, "", UM),
                "rms": each("error_rms", (controller,), TRACKED, "", UM),
            }
        )
        for controller in CONTROLLERS
    }
    yield number(
        "A6b",
        "CSMC",
        {"max 5 sin t": 2.965, "max sin 2πt": 6.244, "rms 5 sin t": 1.993, "rms sin 2πt": 4.705},
        "µm",
        largest_and_rms["csmc"],
        0.02,
    )
    yield number(
        "A7a",
        "FSMC",
        {"max 5 sin t": 0.3045, "max sin 2πt": 0.3427, "rms 5 sin t": 0.0259, "rms sin 2πt": 0.1530},
        "µm",
        largest_and_rms["fsmc"],
        0.05,
    )
    yield number("A7b", "FSMC, step: overshoot", 212.4, "µm", each("overshoot", ("fsmc",), STEP, "", UM), 0.05)
    yield number("A7c", "FSMC, step: settling into ±20 µm", 0.0319, "s", each("settling_20um", ("fsmc",), STEP), 0.05)
    yield number(
        "A8",
        "FSMC: variation of the command",
        {"5 sin t": 6.42, "sin 2πt": 89.0},
        "N·m/s",
        each("command_tv", ("fsmc",), TRACKED),
        0.05,
    )
    yield Claim(
        "A9",
        "FSMC, step: largest error from 0.5 s on",
        0.0099,
        "µm",
        each("error_max", ("fsmc",), STEP, "", UM),
        {"reproduced": at_most(0.05)},
        NUMBERS,
        PROFILE_I,
    )
    yield number(
        "A10",
        "0.01 sin t",
        {"max SMC": 13.57, "max CSMC": 10.37, "rms SMC": 9.08, "rms CSMC": 5.07},
        "µm",
        join(
            {
                "max": each("error_max", ("smc", "csmc"), ("slow",), "", UM),
                "rms": each("error_rms", ("smc", "csmc"), ("slow",), "", UM),
            }
        ),
        0.03,
    )
    yield Claim(
        "A11",
        "FSMC, 0.01 sin t: largest error",
        0.566,
        "µm",
        each("error_max", ("fsmc",), ("slow",), "", UM),
        {"reproduced": at_most(1.2)},
        NUMBERS,
        PROFILE_I,
        "Stick-slip makes it sensitive: an upper bound only.",
    )
    yield Claim(
        "A12",
        "Largest error, CSMC over SMC",
        {"0.01 sin t": 0.516, "5 sin t": 0.495, "sin 2πt": 0.507},
        "1",
        ratio(each("error_max", ("csmc",), SINES, "_2us"), each("error_max", ("smc",), SINES, "_2us")),
        {"reproduced": between(0.45, 0.55)},
        NUMBERS,
        PROFILE_P,
    )
    for letter, controller, error_end, tolerance in (("a", "smc", 0.717, 0.03), ("b", "csmc", 0.177, 0.05)):
        yield number(
            f"A13{letter}",
            f"{CONTROLLERS[controller]}, step: error at the end",
            error_end,
            "µm",
            each("error_end", (controller,), STEP, "_2us", UM),
            tolerance,
            PROFILE_P,
        )
    two = ("r20_f500", "r20_f1000")
    yield number(
        "A14",
        "Double ball bar, FSMC: G and mean radial deviation",
        {"G R20 F500": 0.785, "G R20 F1000": 0.245, "mean R20 F500": -0.019, "mean R20 F1000": -0.081},
        "µm",
        join({"G": circles("G", "fsmc", two), "mean": circles("mean_deviation", "fsmc", two)}),
        0.1,
    )
    yield number(
        "A15a",
        "SMC, 5 sin t: variation of the command in chatter",
        1.32e5,
        "N·m/s",
        of("command_tv", {"": "smc_5sin_chatter"}),
        0.1,
        CHATTER,
    )
    yield number(
        "A15b", "SMC, 5 sin t: rms in chatter", 5.6, "µm", of("error_rms", {"": "smc_5sin_chatter"}, UM), 0.1, CHATTER
    )
    tables = {
        "smc": ((0.314, 0.283, 0.327), (0.204, 0.193, 0.248), (8.1, 8.5, 83.0)),
        "csmc": ((0.162, 0.140, 0.166), (0.105, 0.095, 0.124), (8.0, 8.0, 78.0)),
        "fsmc": ((0.0122, 0.0323, 0.0453), (0.0026, 0.0017, 0.0043), (7.8, 8.0, 78.0)),
    }
    labels = [REFERENCES[reference] for reference in SINES]
    for controller, (largest, rms, variation) in tables.items():
        for name, text, published, unit, factor in (
            ("error_max", "largest error", largest, "µm", UM),
            ("error_rms", "rms", rms, "µm", UM),
            ("command_tv", "variation of the command", variation, "N·m/s", 1.0),
        ):
            yield number(
                f"P {CONTROLLERS[controller]} {text.split()[0]}",
                f"{CONTROLLERS[controller]}: {text}",
                dict(zip(labels, published, strict=True)),
                unit,
                each(name, (controller,), SINES, "_2us", factor),
                0.05,
                PROFILE_P,
            )
    yield number(
        "I literal",
        "SMC with integral surface: largest error",
        dict(zip(labels, (9.04, 0.501, 1.01), strict=True)),
        "µm",
        each("error_max", ("smci",), SINES, "", UM),
        0.06,
        LITERAL,
    )
    deviations = {
        "smc": (5.77, 3.96, 9.08, 20.8),
        "csmc": (3.02, 0.795, 4.53, 173.0),
        "fsmc": (3.16, 0.785, 0.245, 0.653),
    }
    for controller, published in deviations.items():
        yield number(
            f"DBB {CONTROLLERS[controller]}",
            f"Double ball bar, {CONTROLLERS[controller]}: G",
            dict(zip(FEED_TEXT.values(), published, strict=True)),
            "µm",
            circles("G", controller),
            0.1,
        )


def backlash() -> Iterator[Claim]:
    """Figures of another simulation of the two inertias on either side of a dead band."""

    def claim(
        name: str,
        text: str,
        published: float | Numbers,
        measure: Measure,
        *,
        unit: str = "µm",
        rel: float = 0.1,
        setting: str = AT_SCREW,
        note: str = "",
    ) -> Claim:
        return Claim(name, text, published, unit, measure, {"reproduced": near(rel=rel)}, BACKLASH, setting, note)

    def by_gap(controller: str, name: str) -> Measure:
        return of(name, {f"{gap} µm": f"{controller}_backlash_{gap}" for gap in GAPS}, UM)

    yield claim(
        "B1",
        "SMC: lost motion between screw and table",
        {"5 µm": 5.95, "10 µm": 10.95},
        by_gap("smc", "lost_motion"),
        rel=0.02,
        note="Beyond the gap by the wind-up of the nut.",
    )
    yield claim(
        "B2",
        "FSMC: lost motion between screw and table",
        {"5 µm": 6.18, "10 µm": 11.19},
        by_gap("fsmc", "lost_motion"),
        note="With impacts and a command that chatters only such figures can be compared, not traces.",
    )
    yield claim(
        "B3",
        "FSMC: largest error of the table",
        {"5 µm": 3.1, "10 µm": 5.6},
        by_gap("fsmc", "table_error"),
        note="Half the gap and the wind-up, while the screw follows closely.",
    )
    yield claim("B4", "FSMC: largest error of the screw", {"5 µm": 0.19, "10 µm": 0.19}, by_gap("fsmc", "screw_error"))
    yield claim(
        "B5",
        "FSMC: variation of the command",
        1.07e4,
        of("variation", {"": "fsmc_backlash_10"}),
        unit="N·m/s",
        note="It chatters: the screw alone has 57 % of the inertia that the controller expects.",
    )
    circle_text = "Circle R15 F600, second turn, FSMC at the screws"
    yield claim(
        "B6",
        "Double ball bar: G without and with backlash of 10 µm",
        {"without": 0.443, "with": 10.0},
        of("G", {"without": "circle_rigid", "with": "circle_backlash"}, UM),
        setting=circle_text,
    )
    angles = (0, 90, 180, 270)
    yield claim(
        "B7",
        "Double ball bar with backlash of 10 µm: spike after each reversal",
        {f"{angle}°": 5.2 for angle in angles},
        lambda o: {f"{angle}°": UM * o.number("circle_backlash", f"spike_{angle}") for angle in angles},
        setting=circle_text,
    )


# Pictures


def draw_tracking(reference: str, profile: str) -> Callable[[Outcomes, Path], None]:
    """Error and command of the three controllers, one row each."""

    def draw(outcomes: Outcomes, path: Path) -> None:
        panels: list[plots.Panel] = []
        for i, (controller, text) in enumerate(CONTROLLERS.items()):
            result = outcomes.result(f"{controller}_{reference}{profile}")
            begin = 0.0 if reference == "step" else (WINDOWS_P if profile else WINDOWS_I)[reference][0]
            part = metrics.window(result.time, begin, 0.1 if reference == "step" else math.inf)
            time = result.time[part]
            panels.append(plots.Panel("Error", "m", (plots.Series(text, time, error(result)[part], i),)))
            command = plots.Series(f"{text}, command", time, result["controller.command"][part], i)
            panels.append(plots.Panel("Command", "N.m", (command,)))
        plots.plot_panels(path, panels, columns=2)

    return draw


def draw_reversals(outcomes: Outcomes, path: Path) -> None:
    """Errors about one reversal of 5 sin t."""
    panels: list[plots.Panel] = []
    for i, (controller, text) in enumerate(CONTROLLERS.items()):
        result = outcomes.result(f"{controller}_5sin")
        reversal = 1.5 * math.pi
        part = metrics.window(result.time, reversal - 0.1, reversal + 0.4)
        series = plots.Series(text, result.time[part] - reversal, error(result)[part], i)
        panels.append(plots.Panel("Error", "m", (series,)))
    plots.plot_panels(path, panels, x_quantity="Time after the reversal")


def draw_chatter(outcomes: Outcomes, path: Path) -> None:
    """The command of SMC with a thin and a thick boundary layer."""
    series: list[plots.Series] = []
    for run, text in {"smc_5sin_chatter": "φ = 0.1 rad/s", "smc_5sin": "φ = 4 rad/s"}.items():
        result = outcomes.result(run)
        part = metrics.window(result.time, 4.0, 4.01)
        series.append(plots.Series(text, result.time[part] - 4.0, result["controller.command"][part]))
    plots.plot_panels(path, [plots.Panel("Command", "N.m", tuple(series))], x_quantity="Time after 4 s")


def draw_circles(outcomes: Outcomes, path: Path) -> None:
    """Polar plots, one a controller."""
    drawn: list[plots.Polar] = []
    for controller, text in CONTROLLERS.items():
        series: list[plots.Series] = []
        for i, feed in enumerate(("r20_f500", "r20_f1000")):
            test = circle(outcomes.result(f"dbb_{controller}_{feed}"), 0.02)
            series.append(plots.Series(FEED_TEXT[feed].split()[1] + " mm/min", test.angle, test.deviation, i))
        drawn.append(plots.Polar(text, 0.02, tuple(series)))
    plots.plot_polar(path, drawn)


def draw_backlash(outcomes: Outcomes, path: Path) -> None:
    """Screw less table, and the error of the table."""
    panels: list[plots.Panel] = []
    for i, (controller, text) in enumerate((("smc", "SMC"), ("fsmc", "FSMC"))):
        result = outcomes.result(f"{controller}_backlash_10")
        part = metrics.window(result.time, 2.0, 4.1)
        time = result.time[part]
        lost = (result["plant.motor_position"] - result["plant.position"])[part]
        panels.append(plots.Panel("Screw less table", "m", (plots.Series(text, time, lost, i),)))
        series = plots.Series(f"{text}, table", time, error(result)[part], i)
        panels.append(plots.Panel("Error", "m", (series,)))
    plots.plot_panels(path, panels, columns=2)


def draw_phase(outcomes: Outcomes, path: Path) -> None:
    """The step in the phase plane."""
    series: list[plots.Series] = []
    for i, (controller, text) in enumerate(CONTROLLERS.items()):
        result = outcomes.result(f"{controller}_step")
        part = metrics.window(result.time, 0.0, 0.1)
        deviation = error(result)[part]
        series.append(plots.Series(text, deviation, np.gradient(deviation, result.time[part]), i))
    plots.plot_phase_plane(path, series)


def pictures() -> dict[str, Picture]:
    """All pictures by file name."""
    found: dict[str, Picture] = {}
    for reference, text in REFERENCES.items():
        unit = "" if reference == "step" else " mm"
        found[f"tracking_{reference}"] = Picture(f"{text}{unit}, profile I", draw_tracking(reference, ""))
    found["tracking_5sin_2us"] = Picture("5 sin t mm, profile P", draw_tracking("5sin", "_2us"))
    found["reversal"] = Picture("Error about a reversal, 5 sin t mm, profile I", draw_reversals)
    found["phase_plane"] = Picture("Step of 1 mm in the phase plane, profile I", draw_phase)
    found["chatter"] = Picture("Command of SMC with and without chatter, 5 sin t mm, 10 kHz", draw_chatter)
    found["backlash"] = Picture("Backlash of 10 µm, 2 sin 3t mm, controlled at the screw, 10 kHz", draw_backlash)
    found["circles"] = Picture("Double ball bar, radius 20 mm, second turn, profile I", draw_circles)
    return found


STUDY = Study(
    title="Ballscrew stage under sliding-mode controllers (Shams and Safdari 2010)",
    source=(
        "M. Shams, M. Safdari: Fuzzy sliding mode control of a ball screw driven stage. In: F. Casolo (ed.), Motion "
        "Control, IntechOpen 2010, ISBN 978-953-7619-55-8."
    ),
    text="""
The chapter compares a sliding-mode controller with boundary layer (SMC), a complementary one (CSMC) and a fuzzy one
(FSMC) on a ballscrew stage with LuGre friction, by simulation. It prints no figures of its results and not all of its
settings: its claims are words, and several readings of its equations exist. The reading used (surface of SMC without
integral, friction model fed with the reference velocity, switching gain in N·m) was **chosen after the fact** because
it gives the order of errors that the chapter states; no single reading satisfies all of its claims. The scaling
factors of FSMC were scanned on the same four references that it is then compared on, while SMC and CSMC were not tuned.

Two profiles: **I**, everything sampled at 10 kHz with φ = 4 rad/s, and **P**, 2 µs with φ = 0.1 rad/s, which the
chapter's gains need in order not to chatter. Errors are position minus reference.
""",
    runs=runs(),
    claims=(*chapter(), *reference_numbers(), *backlash()),
    pictures=pictures(),
    groups={
        CLAIMS: "What the chapter says in words, and the figure that decides.",
        NUMBERS: (
            "Published here are the figures of an independent simulation of the same equations (RK4 at 1 µs, other "
            "code), not of the chapter: they check these FMUs. A1 to A15 have the tolerances agreed for acceptance."
        ),
        BACKLASH: (
            "The chapter describes backlash as a dead band with elastic impact and does not simulate it. Published "
            "here are figures of the other simulation, with two inertias on either side of the dead band."
        ),
    },
)
