"""Make the reference traces of the ballscrew stage and its sliding-mode controllers; about five minutes::

    python tests/references/shams/make_references.py

An implementation of its own, from the equations of Shams & Safdari 2010: classic Runge-Kutta at 1 us or less, the
fuzzy centroid integrated between sorted breakpoints. It shares no code with the components. The open loop is solved a
second time by scipy's Radau at 1e-10, each closed loop a second and third time with half the step and with a start
moved by 1 pm; the largest differences are kept as ``accuracy`` and ``sensitivity``.

``cases.json`` says what was run, in the names and units of the FMUs, with figures of merit over all samples; its
``compare`` says whether traces may be compared or, where switching makes them diverge, only these figures.
``traces.npz`` holds ``NAME.time``, ``NAME.position`` (l_p*angle), ``NAME.command`` and, with play, ``NAME.table``: the
first 100 samples and some 400 more. ``open_loop.npz`` has the plant alone, ``replay.npz`` the controllers alone.
"""

from __future__ import annotations

import json
from math import exp, pi, sin, sqrt
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit
from scipy.integrate import solve_ivp

HERE = Path(__file__).parent
L_P = 1.5923e-3
J = 2.12e-4 + 62.4 * L_P**2
T_S = 1e-4

PLANT = {
    "sigma_0": 1e5,
    "sigma_1": sqrt(1e5),
    "sigma_2": 0.4,
    "F_C": 6.24,
    "F_S": 9.36,
    "v_s": 1e-3,
    "F_C_negative": 1.0,
    "F_S_negative": 1.0,
    "sigma_2_negative": 1.0,
    "friction_scale": 1.0,
    "drift_amplitude": 0.0,
    "drift_frequency": 0.0,
    "command_max": 0.0,
    "resolution": 0.0,
    "play_positive": 0.0,
    "play_negative": 0.0,
    "position_start": 0.0,
    "velocity_start": 0.0,
    "bristle_start": 1.0,
}
CONTROLLER = {
    "lambda_": 150.0,
    "sigma_0_hat": 2e5,
    "sigma_1_hat": 2.0 * sqrt(1e5),
    "sigma_2_hat": 1.2,
    "F_C_hat": 6.24,
    "F_S_hat": 9.36,
    "v_s_hat": 5e-3,
    "sigma_2_tilde": 1.0,
    "phi": 4.0,
    "eta": 120.0,
    "G_s": 0.09,
    "G_c": 0.045,
    "G_u": 100.0,
    "command_max": 0.0,
    "velocity_filter_time": 0.0,
    "friction_velocity": 1.0,
    "velocity_source": 1.0,
    "law": 0.0,
}
"""``law`` 0 SMC, 1 SMC with integral surface, 2 CSMC, 3 FSMC."""
CHOICES = {
    "friction_velocity": ("reference", "measured", "none"),
    "velocity_source": ("input", "difference"),
}
(S0, S1, S2, FC, FS, VS, FCN, FSN, S2N, SCALE, DA, DF, PMAX, RES, BP, BN, X0, V0, Z0) = range(len(PLANT))
(LAM, H0, H1, H2, HC, HS, HV, T2, PHI, ETA, GS, GC, GU, CMAX, TAU, FV, SRC, LAW) = range(len(CONTROLLER))


@njit(cache=True)
def fuzzy(s: float, c: float) -> float:
    """Centroid of the nine rules, integrated piece by piece between sorted breakpoints."""
    s, c = min(1.0, max(-1.0, s)), min(1.0, max(-1.0, c))
    a = (max(0.0, -s), 1.0 - abs(s), max(0.0, s))
    b = (max(0.0, -c), 1.0 - abs(c), max(0.0, c))
    heights = np.zeros(5)
    for i in range(3):
        for j in range(3):
            out = 2 - i + j
            heights[out] = max(heights[out], min(a[i], b[j]))
    area, moment = 0.0, 0.0
    for cell in range(4):
        left, right = heights[cell], heights[cell + 1]
        breaks = np.sort(np.array([0.0, 1.0, left, right, 1.0 - left, 1.0 - right, 0.5]))
        for i in range(6):
            y, w = breaks[i], breaks[i + 1] - breaks[i]
            if w > 0.0:
                m = max(min(1.0 - y, left), min(y, right))
                n = max(min(1.0 - y - w, left), min(y + w, right))
                u, v = -1.0 + 0.5 * (cell + y), -1.0 + 0.5 * (cell + y + w)
                area += w * (m + n) / 2.0
                moment += w * (2.0 * u * m + u * n + v * m + 2.0 * v * n) / 6.0
    return moment / area


@njit(cache=True)
def level(t: float, w: float, p: np.ndarray) -> float:
    coulomb, static = p[FC], p[FS]
    if w < 0.0:
        coulomb, static = coulomb * p[FCN], static * p[FSN]
    drift = 1.0 + p[DA] * sin(2.0 * pi * p[DF] * t)
    return p[SCALE] * drift * (coulomb + (static - coulomb) * exp(-((w / p[VS]) ** 2)))


@njit(cache=True)
def slope(t: float, w: float, z: float, drive: float, p: np.ndarray) -> tuple[float, float, float]:
    """Rates of speed and bristle, friction torque."""
    rate = w - p[S0] * abs(w) * z / level(t, w, p)
    viscous = p[S2] * w * (p[S2N] if w < 0.0 else 1.0)
    friction = p[S0] * z + p[S1] * rate + viscous
    return (drive - friction) / (2.12e-4 + 62.4 * 1.5923e-3**2), rate, friction


@njit(cache=True)
def advance(  # noqa: PLR0917 (numba calls by position)
    t: float, x: np.ndarray, command: float, load: float, p: np.ndarray, span: float, parts: int
) -> None:
    """Runge-Kutta of the plant over ``span`` in ``parts``; the play follows each part."""
    h = span / parts
    drive = command
    if p[PMAX] > 0.0:
        drive = min(p[PMAX], max(-p[PMAX], drive))
    drive -= load
    for i in range(parts):
        s, w, z = t + i * h, x[1], x[2]
        a1, b1, _ = slope(s, w, z, drive, p)
        w2, z2 = w + 0.5 * h * a1, z + 0.5 * h * b1
        a2, b2, _ = slope(s + 0.5 * h, w2, z2, drive, p)
        w3, z3 = w + 0.5 * h * a2, z + 0.5 * h * b2
        a3, b3, _ = slope(s + 0.5 * h, w3, z3, drive, p)
        w4, z4 = w + h * a3, z + h * b3
        a4, b4, _ = slope(s + h, w4, z4, drive, p)
        x[0] += h / 6.0 * (w + 2.0 * w2 + 2.0 * w3 + w4)
        x[1] += h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
        x[2] += h / 6.0 * (b1 + 2.0 * b2 + 2.0 * b3 + b4)
        x[3] = min(max(x[3], L_P * x[0] - p[BP]), L_P * x[0] + p[BN])


@njit(cache=True)
def control(  # noqa: PLR0917
    k: int, r: np.ndarray, position: float, velocity: float, c: np.ndarray, m: np.ndarray, T: float
):
    """Command and surface of sample ``k``; ``m``: bristle, integral, last position, last velocity."""
    jh, lam = 2.12e-4 + 62.4 * 1.5923e-3**2, c[LAM]
    if c[SRC] == 2.0 and k > 0:
        a = exp(-T / c[TAU]) if c[TAU] > 0.0 else 0.0
        velocity = a * m[3] + (1.0 - a) * (position - m[2]) / T
    m[2], m[3] = position, velocity
    e, de = (position - r[0]) / L_P, (velocity - r[1]) / L_P
    v = r[1] / L_P if c[FV] == 1.0 else velocity / L_P
    g = c[HC] + (c[HS] - c[HC]) * exp(-((v / c[HV]) ** 2))
    last = m[0]
    if k == 0:
        last = np.sign(v) * g / c[H0]
    z = (last + T * v) / (1.0 + T * abs(v) * c[H0] / g)
    friction = c[H0] * z + c[H1] * (z - last) / T + c[H2] * v
    m[0] = z
    if c[FV] == 3.0:
        friction = 0.0
    before = m[1]
    if k > 0:
        m[1] += T * e
    xi = m[1]
    s, s_c = de + 2.0 * lam * e + lam**2 * xi, de - lam**2 * xi
    feed = friction + jh * (r[2] / L_P - 3.0 * lam * de - 3.0 * lam**2 * e - lam**3 * xi)
    gain = g + c[T2] * abs(v) + jh * c[ETA]
    if c[LAW] == 0.0:
        s = de + lam * e
        u = friction + jh * (r[2] / L_P - lam * de) - gain * min(1.0, max(-1.0, s / c[PHI]))
    elif c[LAW] == 1.0:
        u = feed - gain * min(1.0, max(-1.0, s / c[PHI]))
    elif c[LAW] == 2.0:
        u = feed - gain * min(1.0, max(-1.0, (s + s_c) / c[PHI]))
    else:
        u = feed + c[GU] * fuzzy(c[GS] * s, c[GC] * s_c)
    if c[CMAX] > 0.0:
        u = min(c[CMAX], max(-c[CMAX], u))
        if abs(u) >= c[CMAX] and -e * u > 0.0:
            m[1] = before
    return u, s


@njit(cache=True)
def closed_loop(  # noqa: PLR0917
    refs: np.ndarray, p: np.ndarray, c: np.ndarray, load: float, screw: bool, parts: int, nudge: float
):
    """Rows of table position, screw position, command, error of table; one a sample."""
    n = len(refs)
    rows = np.zeros((n, 4))
    w = p[V0] / L_P
    z = p[Z0] * np.sign(w) * level(0.0, w, p) / p[S0]
    x = np.array([(p[X0] + nudge) / L_P, w, z, p[X0] + nudge])
    m = np.zeros(4)
    for k in range(n):
        nut = L_P * x[0]
        table = min(max(x[3], nut - p[BP]), nut + p[BN])
        seen = nut if screw else table
        if p[RES] > 0.0:
            seen = p[RES] * np.floor(seen / p[RES] + 0.5)
        u, _ = control(k, refs[k], seen, L_P * x[1], c, m, 1e-4)
        rows[k] = table, nut, u, refs[k, 0] - seen
        advance(k * 1e-4, x, u, load, p, 1e-4, parts)
    return rows


def sine(t: np.ndarray, amplitude: float, omega: float) -> np.ndarray:
    s, c = amplitude * np.sin(omega * t), amplitude * np.cos(omega * t)
    return np.stack([s, omega * c, -(omega**2) * s], axis=1)


STEP = {"kind": "step", "amplitude": 1e-3}
SLOW = {"kind": "sine", "amplitude": 1e-5, "frequency": 1.0 / (2.0 * pi)}
MIDDLE = {"kind": "sine", "amplitude": 5e-3, "frequency": 1.0 / (2.0 * pi)}
FAST = {"kind": "sine", "amplitude": 1e-3, "frequency": 1.0}
TWO_MM = {"kind": "sine", "amplitude": 2e-3, "frequency": 3.0 / (2.0 * pi)}
SMC: dict[str, Any] = {"controller": "SlidingMode"}
SMCI: dict[str, Any] = {"controller": "SlidingMode", "controller_start": {"integral_surface": True}}
CSMC: dict[str, Any] = {"controller": "ComplementarySlidingMode"}
FSMC: dict[str, Any] = {"controller": "FuzzySlidingMode"}
WINDOWS = {"step": (1.0, 0.5), "slow": (10.0, 3.7), "middle": (10.0, 3.7), "fast": (3.0, 1.0)}
"""Stop time and start of the window of the figures of merit, s."""
REFERENCES = {"step": STEP, "slow": SLOW, "middle": MIDDLE, "fast": FAST}


def cases() -> dict[str, dict[str, Any]]:
    found: dict[str, dict[str, Any]] = {}

    def add(
        name: str, base: dict[str, Any], reference: dict[str, Any], stop: float, window: float, **more: Any
    ) -> None:
        entry = {"trajectory_start": reference, "stop_time": stop, "window_start": window, "step_size": T_S}
        case = (
            {"controller_start": {}, "plant_start": {}, "load_torque": 0.0, "feedback": "table", "compare": "trace"}
            | base
            | entry
        )
        for key, value in more.items():
            case[key] = case[key] | value if isinstance(value, dict) else value
        found[name] = case

    for short, base in (("smc", SMC), ("smc_integral", SMCI), ("csmc", CSMC), ("fsmc", FSMC)):
        for name, (stop, window) in WINDOWS.items():
            # A stick-slip event of this case comes or not with the last digits of any solver.
            compare = "figures" if (short, name) == ("smc_integral", "slow") else "trace"
            add(f"{short}_{name}", base, REFERENCES[name], stop, window, compare=compare)
    add("saturation_smc_integral", SMCI, STEP, 0.5, 0.25, controller_start={"command_max": 12.0})
    add("saturation_csmc", CSMC, STEP, 0.5, 0.25, controller_start={"command_max": 12.0})
    add("saturation_fsmc", FSMC, STEP, 0.5, 0.25, controller_start={"command_max": 12.0})
    add("saturated_drive", CSMC, STEP, 0.5, 0.25, plant_start={"command_max": 12.0})
    add(
        "encoder",
        SMC,
        MIDDLE,
        3.0,
        1.0,
        plant_start={"resolution": 1e-8},
        controller_start={"velocity_source": "difference", "velocity_filter_time": 2e-4, "phi": 8.0},
    )
    add(
        "direction",
        FSMC,
        MIDDLE,
        7.0,
        3.7,
        plant_start={"F_C_negative": 0.8, "F_S_negative": 0.9, "sigma_2_negative": 1.5},
    )
    add("drift", CSMC, MIDDLE, 7.0, 3.7, plant_start={"drift_amplitude": 0.2, "drift_frequency": 0.5})
    add("scale", FSMC, FAST, 2.0, 1.0, plant_start={"friction_scale": 1.3})
    add("load", FSMC, FAST, 2.0, 1.0, load_torque=3.0)
    add(
        "play",
        SMC,
        TWO_MM,
        3.0,
        1.0,
        plant_start={"play_positive": 5e-6, "play_negative": 3e-6},
        feedback="screw",
    )
    add("measured_smc", SMC, MIDDLE, 3.0, 1.0, controller_start={"friction_velocity": "measured"}, compare="figures")
    add("none_fsmc", FSMC, MIDDLE, 3.0, 1.0, controller_start={"friction_velocity": "none"})
    add("moving_start", FSMC, MIDDLE, 2.0, 0.5, plant_start={"velocity_start": 5e-3})
    add("undeflected_start", SMC, MIDDLE, 2.0, 0.5, plant_start={"velocity_start": 5e-3, "bristle_start": 0.0})
    return found


def settings(start: dict[str, Any], defaults: dict[str, float]) -> np.ndarray:
    values = dict(defaults)
    for name, value in start.items():
        if name == "integral_surface":
            continue
        assert name in values, name
        values[name] = 1.0 + CHOICES[name].index(value) if name in CHOICES else value
    return np.array(list(values.values()))


def solve(case: dict[str, Any], parts: int, nudge: float = 0.0) -> np.ndarray:
    start = dict(case["controller_start"])
    law = {"SlidingMode": 0, "ComplementarySlidingMode": 2, "FuzzySlidingMode": 3}[case["controller"]]
    defaults = CONTROLLER | {"law": law + bool(start.get("integral_surface")), "eta": 20.0 if law == 2 else 120.0}
    r = case["trajectory_start"]
    t = np.arange(round(case["stop_time"] / T_S) + 1) * T_S
    refs = np.array([[r["amplitude"], 0.0, 0.0]] * len(t))
    if r["kind"] == "sine":
        refs = sine(t, r["amplitude"], 2.0 * pi * r["frequency"])
    plant, controller = settings(case["plant_start"], PLANT), settings(start, defaults)
    return closed_loop(refs, plant, controller, case["load_torque"], case["feedback"] == "screw", parts, nudge)


def figures(case: dict[str, Any], rows: np.ndarray) -> dict[str, float]:
    """Figures of merit from the window on, over every sample; SI."""
    first = round(case["window_start"] / T_S)
    error, command = rows[first:, 3], rows[first:-1, 2]
    height = case["trajectory_start"]["amplitude"]
    return {
        "error_max": float(np.max(np.abs(error))),
        "error_rms": float(np.sqrt(np.mean(error**2))),
        "total_variation": float(np.sum(np.abs(np.diff(command))) / (len(command) * T_S)),
        "error_end": float(error[-1]),
        "command_peak": float(np.max(np.abs(rows[:, 2]))),
        "position_peak": float(np.max(rows[:, 0])),
    } | (
        {"settling_20um": T_S * float(np.max(np.flatnonzero(np.abs(rows[:, 0] - height) > 20e-6)) + 1)}
        if case["trajectory_start"]["kind"] == "step" and np.max(np.abs(error)) < 20e-6
        else {}
    )


def make_closed_loops() -> None:
    book: dict[str, Any] = {}
    traces: dict[str, np.ndarray] = {}
    for name, case in cases().items():
        parts = 400 if "slow" in name else 100
        rows = solve(case, parts)
        accuracy = np.max(np.abs(solve(case, 2 * parts) - rows), axis=0)
        sensitivity = np.max(np.abs(solve(case, parts, 1e-12) - rows), axis=0)
        last = len(rows) - 1
        kept = np.unique(np.concatenate([np.arange(100), np.arange(0, last, max(1, last // 400)), [last]]))
        traces[f"{name}.time"] = kept * T_S
        traces[f"{name}.position"] = rows[kept, 1]
        traces[f"{name}.command"] = rows[kept, 2]
        if case["plant_start"].get("play_positive"):
            traces[f"{name}.table"] = rows[kept, 0]
        book[name] = case | {
            "figures": figures(case, rows),
            "accuracy": {"position": accuracy[0], "command": accuracy[2]},
            "sensitivity": {"position": sensitivity[0], "command": sensitivity[2]},
        }
        f = {key: f"{value:.5g}" for key, value in book[name]["figures"].items()}
        print(name, f, "half step", accuracy[[0, 2]], "1 pm", sensitivity[[0, 2]])  # noqa: T201
    (HERE / "cases.json").write_text(json.dumps(book, indent=1) + "\n")
    np.savez_compressed(HERE / "traces.npz", **traces)


def torque(t: float) -> float:
    return 8.0 * sin(4.0 * pi * t) + 6.0 * sin(1.4 * pi * t)


def make_open_loop() -> None:
    """The stage alone, 2 s: torque held for 0.1 ms, then continuous torque; angle, speed, bristle, friction."""
    p = np.array(list(PLANT.values()))
    n, every = 20000, 40

    def held(parts: int) -> np.ndarray:
        x, rows = np.zeros(4), np.zeros((n // every + 1, 4))
        for k in range(n + 1):
            if k % every == 0:
                rows[k // every] = *x[:3], slope(0.0, x[1], x[2], 0.0, p)[2]
            advance(k * T_S, x, torque(k * T_S), 0.0, p, T_S, parts)
        return rows

    rows = held(200)
    accuracy = np.max(np.abs(held(400) - rows), axis=0)

    def rates(t: float, x: np.ndarray) -> list[float]:
        a, b, _ = slope(t, x[1], x[2], torque(t), p)
        return [x[1], a, b]

    def jacobian(t: float, x: np.ndarray) -> np.ndarray:
        w, z = x[1], x[2]
        bump = exp(-((w / p[VS]) ** 2)) * (p[FS] - p[FC])
        g, dg = p[FC] + bump, -2.0 * w / p[VS] ** 2 * bump
        rate_w = 1.0 - p[S0] * z * (np.sign(w) / g - abs(w) * dg / g**2)
        rate_z = -p[S0] * abs(w) / g
        return np.array(
            [
                [0.0, 1.0, 0.0],
                [0.0, -(p[S1] * rate_w + p[S2]) / J, -(p[S0] + p[S1] * rate_z) / J],
                [0.0, rate_w, rate_z],
            ]
        )

    times = np.arange(n // every + 1) * every * T_S
    solution = solve_ivp(
        rates,
        (0.0, times[-1]),
        [0.0, 0.0, 0.0],
        method="Radau",
        t_eval=times,
        jac=jacobian,
        rtol=1e-10,
        atol=[1e-12, 1e-12, 1e-16],
    )
    assert solution.success, solution.message
    continuous = solution.y.T
    x, parts, worst = np.zeros(4), 400, 0.0
    for k in range(n + 1):
        if k % every == 0:
            worst = max(worst, abs(x[0] - continuous[k // every, 0]))
        for i in range(parts):
            # Torque of the middle of a quarter of a microsecond: second order in it.
            advance(0.0, x, torque(k * T_S + (i + 0.5) * T_S / parts), 0.0, p, T_S / parts, 1)
    print(f"open loop: half step {accuracy[0]:.1e} rad; Radau against Runge-Kutta {worst:.1e} rad")  # noqa: T201
    np.savez_compressed(
        HERE / "open_loop.npz", time=times, held=rows, accuracy=accuracy, continuous=continuous, methods_differ=worst
    )


REPLAYS: dict[str, dict[str, Any]] = {
    "smc": SMC,
    "smc_integral": SMCI,
    "csmc": CSMC,
    "fsmc": FSMC,
}
REPLAY_OPTIONS: dict[str, dict[str, Any]] = {
    "default": {},
    "measured": {"friction_velocity": "measured"},
    "none": {"friction_velocity": "none"},
    "difference": {"velocity_source": "difference", "velocity_filter_time": 5e-4},
    "raw": {"velocity_source": "difference", "friction_velocity": "measured"},
    "limited": {"command_max": 8.0},
}


def make_replay() -> None:
    """The controllers alone on recorded inputs: a fast sine from standstill, errors of up to some 30 um."""
    t = np.arange(600) * T_S
    refs = sine(t, 1e-3, 2.0 * pi * 20.0)
    refs[:100] = [refs[0, 0], 0.0, 0.0]
    rng = np.random.default_rng(2010)
    deviation = 2e-5 * np.sin(2.0 * pi * 47.0 * t) + 1e-8 * rng.standard_normal(len(t))
    position = refs[:, 0] + deviation
    velocity = refs[:, 1] + 2e-5 * 2.0 * pi * 47.0 * np.cos(2.0 * pi * 47.0 * t)
    arrays: dict[str, np.ndarray] = {"references": refs, "position": position, "velocity": velocity}
    for name, base in REPLAYS.items():
        for option, start in REPLAY_OPTIONS.items():
            law = {"SlidingMode": 0, "ComplementarySlidingMode": 2, "FuzzySlidingMode": 3}[base["controller"]]
            law += bool(base.get("controller_start"))
            defaults = CONTROLLER | {"law": law, "eta": 20.0 if law == 2 else 120.0}
            c, m = settings(start, defaults), np.zeros(4)
            rows = [control(k, refs[k], position[k], velocity[k], c, m, T_S) for k in range(len(t))]
            arrays[f"{name}.{option}"] = np.array(rows)
    np.savez_compressed(HERE / "replay.npz", **arrays)


if __name__ == "__main__":
    make_open_loop()
    make_replay()
    make_closed_loops()
