"""Make the reference traces of the NCTF components (``*.npz`` beside this file); about a minute::

    python tests/references/nctf/make_references.py

Ballscrew: Runge-Kutta at 1 us (see ``independent``), except with backlash: there scipy's DOP853 at 1e-11, stopped at
every contact and separation. Linear stage: ``expm`` of its equations. Each trace is computed twice, the second time
at half the step or another tolerance; the largest difference is printed and kept in the file as ``accuracy``.
Traces are in SI.
"""

from __future__ import annotations

from pathlib import Path

import independent as ref
import numpy as np
from nct_table import table
from scipy.integrate import solve_ivp
from scipy.linalg import expm

HERE = Path(__file__).parent
T = 2e-4
"""Sampling time of all ballscrew traces, s."""
SUBSTEPS = 200
STEPS_MM = (1e-4, 1e-3, 1e-2, 0.1, 1.0, 10.0, 20.0)
GAINS = np.array([T, ref.COMPENSATOR_C["K_P"], ref.COMPENSATOR_C["K_I"], 6.0, 1.24e-6])
SINES = ((1.0, np.pi), (1.5, np.pi), (5.0, np.pi), (1.0, 2.0 * np.pi), (1.0, 4.0 * np.pi))
"""Amplitude in mm and frequency in rad/s of the sine references."""
T_FUZZY = 1e-4


def save(name: str, accuracy: float, **arrays: np.ndarray) -> None:
    """Write one file of traces and say how far they can be trusted."""
    print(f"{name}: {accuracy:.1e}")  # noqa: T201
    np.savez_compressed(HERE / f"{name}.npz", accuracy=accuracy, **arrays)


def nct_mm() -> tuple[np.ndarray, np.ndarray]:
    """The reference NCT's nodes in mm and mm/s."""
    error, rate, _ = table()
    return error * 1e3, rate * 1e3


def open_loops() -> None:
    """6 A for 0.1 s; a varied current and loads on a stage whose guide has friction too."""
    n = 1500
    time = np.arange(n) * T
    pulse = np.where(time < 0.1 - 1e-9, 6.0, 0.0)
    varied = 2.0 * np.sin(2.0 * np.pi * 7.0 * time) + 1.5 * np.sin(2.0 * np.pi * 31.0 * time)
    force = np.where(time > 0.1, 5.0, 0.0)
    torque = np.where(time > 0.2, -0.02, 0.0)
    none = np.zeros(n)
    for name, current, loads, changes in (
        ("open_loop_pulse", pulse, (none, none), {}),
        ("open_loop_guide", varied, (force, torque), ref.GUIDE),
    ):
        p = ref.plant_vector(**changes)
        rows = ref.open_loop(current, *loads, p, T, SUBSTEPS)
        finer = ref.open_loop(current, *loads, p, T, 2 * SUBSTEPS)
        worst = np.max(np.abs(finer - rows)[:, 2])
        save(name, worst, current=current, force=loads[0], torque=loads[1], states=finer)


BACKLASH = {"gap_plus": 3e-6, "gap_minus": 7e-6}


def backlash_trace(tolerance: float, current: np.ndarray) -> np.ndarray:
    """States at the samples; contact is a mode that ends at the zero of an event function."""
    p = ref.plant_vector()
    inertia, mass, r, k_n, c_n = p[1], p[2], p[3], p[4], p[5]
    gaps = {1: BACKLASH["gap_plus"], -1: -BACKLASH["gap_minus"]}

    def contact_force(s: np.ndarray, side: int) -> float:
        return k_n * (r * s[0] - s[2] - gaps[side]) + c_n * (r * s[1] - s[3])

    def rates(_t: float, s: np.ndarray, i: float, side: int) -> list[float]:
        nut = contact_force(s, side) if side else 0.0
        dz = s[1] - p[7] * abs(s[1]) * s[4] / p[10]
        friction = p[7] * s[4] + p[8] * dz + p[9] * s[1]
        return [s[1], (p[0] * i - friction - r * nut) / inertia, s[3], nut / mass, dz]

    def leave(_t: float, s: np.ndarray, _i: float, side: int) -> float:
        return side * contact_force(s, side) if side else 1.0

    def touch(side: int):
        def event(_t: float, s: np.ndarray, _i: float, mode: int) -> float:
            inside = side * (r * s[0] - s[2] - gaps[side])
            return min(inside, side * contact_force(s, side) / k_n) if mode == 0 else -1.0

        return event

    events = [leave, touch(1), touch(-1)]
    for event, direction in zip(events, (-1, 1, 1), strict=True):
        event.terminal, event.direction = True, direction

    s, mode = np.zeros(5), 0
    rows = [s]
    for k, i in enumerate(current):
        t, end = k * T, (k + 1) * T
        while t < end:
            run = solve_ivp(
                rates, (t, end), s, "DOP853", events=events, args=(i, mode), rtol=tolerance, atol=tolerance * 1e-4
            )
            t, s = run.t[-1], run.y[:, -1]
            if run.status == 1:
                hit = [len(times) > 0 for times in run.t_events]
                mode = 0 if hit[0] else (1 if hit[1] else -1)
        rows.append(s)
    return np.array(rows)


def backlash() -> None:
    """A reversing current drives the table through a gap of 3 and 7 um."""
    time = np.arange(750) * T
    current = np.round(1.2 * np.sin(2.0 * np.pi * 20.0 * time), 6)
    rows = backlash_trace(1e-11, current)
    other = backlash_trace(1e-9, current)
    save("open_loop_backlash", np.max(np.abs(rows - other)[:, 2]), current=current, states=rows)


def linear_stage() -> None:
    """Random held commands and disturbances on the linear stage."""
    gain, alpha = ref.STAGE[0] * 1e-3, ref.STAGE[1]
    generator = np.random.default_rng(1)
    n, step = 400, 1e-3
    command = np.round(generator.uniform(-10.0, 10.0, n), 3)
    disturbance = np.round(generator.uniform(-5.0, 5.0, n), 3)
    dynamics = np.array([[0.0, 1.0, 0.0, 0.0], [0.0, -alpha, alpha * gain, -1.0], [0.0] * 4, [0.0] * 4])
    whole, half = expm(dynamics * step), expm(dynamics * step / 2.0)
    rows, twice = np.zeros((n + 1, 2)), np.zeros((n + 1, 2))
    for k in range(n):
        inputs = [command[k], disturbance[k]]
        rows[k + 1] = (whole @ [*rows[k], *inputs])[:2]
        twice[k + 1] = (half @ [*(half @ [*twice[k], *inputs])[:2], *inputs])[:2]
    worst = np.max(np.abs(rows - twice)[:, 0])
    save("nominal_stage", worst, command=command, disturbance=disturbance, states=rows, step=np.array(step))


def controllers() -> None:
    """Commands of the controllers for recorded inputs that visit saturation, freezing and both signs."""
    generator = np.random.default_rng(2)
    n = 2000
    time = np.arange(n) * T
    target = np.repeat(np.round(generator.uniform(-5.0, 5.0, 10) * 10.0 ** generator.uniform(-4, 0, 10), 6), 200)
    position = np.zeros(n)
    for k in range(1, n):  # a slow, wandering approach
        position[k] = position[k - 1] + 0.01 * (target[k - 1] - position[k - 1])
    position = np.round(position + 1e-4 * np.sin(300.0 * time), 9)
    nct = nct_mm()
    arrays = {"position_ref": target * 1e-3, "position": position * 1e-3}
    for antiwindup in (True, False):
        arrays[f"antiwindup_{antiwindup}"] = ref.nctf_pi_replay(target, position, GAINS, *nct, antiwindup)
    save("nctf_pi_replay", 0.0, **arrays)

    velocity_ref = np.round(generator.uniform(-15.0, 15.0, n), 4)
    velocity = np.round(velocity_ref + generator.normal(0.0, 1.0, n) * 10.0 ** generator.uniform(-3, 1.5, n), 6)
    near = np.round(target + generator.normal(0.0, 1.0, n) * 10.0 ** generator.uniform(-4, 0, n), 7)
    arrays = {
        "position_ref": target * 1e-3,
        "velocity_ref": velocity_ref * 1e-3,
        "position": near * 1e-3,
        "velocity": velocity * 1e-3,
    }
    for name, design in (("proposed", ref.PROPOSED), ("existing", ref.EXISTING)):
        arrays[name] = ref.fuzzy_replay(target, velocity_ref, near, velocity, design, ref.NCT_SHAPE, T_FUZZY)
    save("nctf_fuzzy_replay", 0.0, **arrays)


def ballscrew_loops() -> None:
    """Compensator C: seven steps with and without anti-windup, 1 s each; 5 nm stairs, cold and warm."""
    nct = nct_mm()
    worst = 0.0
    arrays: dict[str, np.ndarray] = {"steps": np.array(STEPS_MM) * 1e-3, "decimation": np.array(10)}
    for antiwindup in (True, False):
        traces = []
        for step in STEPS_MM:
            target = np.full(5000, step)
            run = ref.nctf_pi_loop(target, ref.plant_vector(), GAINS, *nct, antiwindup, 0, SUBSTEPS)
            other = ref.nctf_pi_loop(target, ref.plant_vector(), GAINS, *nct, antiwindup, 0, SUBSTEPS // 2)
            worst = max(worst, float(np.max(np.abs(run[0] - other[0]))) * 1e-3)
            traces.append(run)
        arrays[f"position_{antiwindup}"] = np.array([run[0][::10] for run in traces]) * 1e-3
        arrays[f"command_{antiwindup}"] = np.array([run[1][::10] for run in traces])
        arrays[f"largest_{antiwindup}"] = np.array([run[0].max() for run in traces]) * 1e-3
    save("steps", worst, **arrays)

    levels = 5e-6 * np.array([1, 2, 3, 4, 5, 4, 3, 2, 1, 0])
    target = np.repeat(levels, 1000)
    arrays = {"levels": levels * 1e-3, "decimation": np.array(10)}
    worst = 0.0
    for name, changes in (("cold", {}), ("warm", ref.WARM)):
        p = ref.plant_vector(**changes)
        run = ref.nctf_pi_loop(target, p, GAINS, *nct, True, 0, SUBSTEPS)
        other = ref.nctf_pi_loop(target, p, GAINS, *nct, True, 0, SUBSTEPS // 2)
        worst = max(worst, float(np.max(np.abs(run[0] - other[0]))) * 1e-3)
        arrays[name] = run[0][::10] * 1e-3
    save("stairs", worst, **arrays)


def fuzzy_loops() -> None:
    """Five sines and two steps with both variants at 0.1 ms, 2 s each: traces and figures."""
    time = np.arange(20000) * T_FUZZY
    arrays: dict[str, np.ndarray] = {
        "sines": np.array(SINES),
        "steps": np.array([1e-3, 5e-3]),
        "decimation": np.array(50),
    }
    for name, design in (("proposed", ref.PROPOSED), ("existing", ref.EXISTING)):
        errors, traces, overshoot = [], [], []
        for amplitude, omega in SINES:
            target = amplitude * np.sin(omega * time)
            rate = amplitude * omega * np.cos(omega * time)
            position, _, _ = ref.fuzzy_loop(target, rate, design, ref.NCT_SHAPE, *ref.STAGE, T_FUZZY)
            error = (target - position) * 1e-3
            errors.append((np.max(np.abs(error)), np.sqrt(np.mean(error**2))))
            traces.append(position[::50] * 1e-3)
        for step in (1.0, 5.0):
            target = np.full(20000, step)
            position, _, _ = ref.fuzzy_loop(target, 0.0 * target, design, ref.NCT_SHAPE, *ref.STAGE, T_FUZZY)
            overshoot.append(position.max() / step - 1.0)
            traces.append(position[::50] * 1e-3)
        arrays |= {
            f"{name}_errors": np.array(errors),
            f"{name}_overshoot": np.array(overshoot),
            f"{name}_position": np.array(traces),
        }
    save("fuzzy_loops", 0.0, **arrays)


if __name__ == "__main__":
    open_loops()
    backlash()
    linear_stage()
    controllers()
    ballscrew_loops()
    fuzzy_loops()
