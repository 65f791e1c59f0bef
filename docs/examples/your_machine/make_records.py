"""Makes the records of this folder: ``python make_records.py``. They are made up, so what is true is known.

Nothing here comes from the project: the plain equations stand below once more, and scipy's Radau solves them, sample by
sample. ``STAGE`` and ``MOTOR`` are the truth that a fit should find.

* ``stage.csv``, ``stage_other.csv``: a ballscrew stage with LuGre friction (Canudas de Wit et al. 1995) in a position
  loop of two proportional controllers. The two files hold other motions of the same machine.
* ``motor.csv``: a linear motor on viscous guides, driven without a loop.

Each position comes late by the delay of its sensor, with noise, and rounded to the resolution; commands have noise,
too. The loop itself sees the position without these: noise is in the record only.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

Array = NDArray[np.float64]
FOLDER = Path(__file__).resolve().parent

T_S = 1e-3
"""Sampling time of records and loop, s."""

STAGE: Mapping[str, float] = {
    "m": 60.0,  # kg
    "J_rot": 2e-4,  # kg.m2
    "l_p": 0.01 / (2.0 * math.pi),  # m/rad
    "F_C": 0.5,  # N.m
    "F_S": 0.7,  # N.m
    "v_s": 2.0,  # rad/s
    "sigma_0": 2000.0,  # N.m/rad
    "sigma_1": 1.0,  # N.m.s/rad
    "sigma_2": 0.012,  # N.m.s/rad
    "K_pos": 100.0,  # 1/s, of the position controller
    "K_vel": 400.0,  # V.s/m, of the velocity controller
    "torque": 0.2,  # N.m/V, of the drive
    "delay": 0.4e-3,  # s, by which the position comes late in the record
}
STAGE_NOISE: Mapping[str, float] = {"position": 20e-9, "command": 5e-3}
"""Standard deviations in m and V."""
STAGE_RESOLUTION: Mapping[str, float] = {"position": 10e-9, "command": 2e-3}

MOTOR: Mapping[str, float] = {
    "m": 12.0,  # kg
    "b": 180.0,  # N.s/m
    "force": 100.0,  # N/V
    "delay": 0.25e-3,  # s
    "velocity_start": 2e-3,  # m/s
}
MOTOR_NOISE: Mapping[str, float] = {"position": 100e-9}
MOTOR_RESOLUTION: Mapping[str, float] = {"position": 50e-9}


# ---- motions ----


def smooth(time: Array, begin: float, length: float, distance: float) -> Array:
    """A move by ``distance``: polynomial of fifth order."""
    s = np.clip((time - begin) / length, 0.0, 1.0)
    return distance * s**3 * (10.0 - s * (15.0 - 6.0 * s))


def burst(time: Array, begin: float, length: float, amplitude: float, frequency: float) -> Array:
    """Some periods of a sine that begin and end gently; it ends where it began."""
    s = np.clip((time - begin) / length, 0.0, 1.0)
    return amplitude * np.sin(math.pi * s) ** 2 * np.sin(2.0 * math.pi * frequency * (time - begin))


def stage_reference(time: Array) -> Array:
    """Presliding, slow motion through the falling part of the friction curve, fast moves."""
    return (
        burst(time, 0.05, 0.45, 40e-6, 20.0)
        + burst(time, 0.5, 0.5, 70e-6, 10.0)
        + smooth(time, 1.0, 0.5, 0.5e-3)
        + smooth(time, 1.5, 0.5, -2e-3)
        + smooth(time, 2.0, 0.4, 6e-3)
        + smooth(time, 2.4, 0.3, -15e-3)
        + smooth(time, 2.7, 0.3, 30e-3)
        + smooth(time, 3.1, 0.2, -20e-3)
        + burst(time, 3.4, 0.6, 0.4e-3, 10.0)
    )


def other_reference(time: Array) -> Array:
    """Another motion of the same kind, for validation."""
    return (
        burst(time, 0.05, 0.45, 50e-6, 15.0)
        + smooth(time, 0.5, 0.6, 1e-3)
        + smooth(time, 1.2, 0.25, -12e-3)
        + burst(time, 1.5, 0.5, 1e-3, 8.0)
    )


def motor_command(time: Array) -> Array:
    """Five sines between 1 and 40 Hz, V."""
    parts = ((0.2, 1.0, 0.3), (0.3, 3.0, 1.9), (0.4, 8.0, 4.0), (0.6, 18.0, 0.8), (0.8, 40.0, 2.6))
    return sum((a * np.sin(2.0 * math.pi * f * time + p) for a, f, p in parts), np.zeros_like(time))


# ---- the plain equations, solved by Radau ----


def solved(rate: Callable[[float, Array], Array], begin: float, end: float, x: Array, *, scale: Array) -> Any:
    """One sample: the solution as a function of time."""
    found = solve_ivp(rate, (begin, end), x, method="Radau", rtol=1e-9, atol=1e-12 * scale, dense_output=True)
    assert found.success, found.message
    return found.sol


def stage_signals(reference: Array, truth: Mapping[str, float] = STAGE) -> dict[str, Array]:
    """Position, late by its delay [m], and command [V] of the stage in its loop, without noise."""
    p = truth
    J = p["J_rot"] + p["m"] * p["l_p"] ** 2

    def rate(torque: float) -> Callable[[float, Array], Array]:
        def right(t: float, x: Array) -> Array:
            _, speed, bristle = x
            level = p["F_C"] + (p["F_S"] - p["F_C"]) * math.exp(-((speed / p["v_s"]) ** 2))
            bristle_rate = speed - p["sigma_0"] * abs(speed) * bristle / level
            friction = p["sigma_0"] * bristle + p["sigma_1"] * bristle_rate + p["sigma_2"] * speed
            return np.array([speed, (torque - friction) / J, bristle_rate])

        return right

    x = np.zeros(3)
    scale = np.array([1.0, 100.0, 1e-3])
    late, command = np.zeros(len(reference)), np.zeros(len(reference))
    last = before = 0.0
    for k, wanted in enumerate(reference):
        position = p["l_p"] * x[0]
        # The velocity is the difference of the means of two positions; the stage stood still before the record.
        velocity = (position - before) / (2.0 * T_S) if k else 0.0
        command[k] = p["K_vel"] * (p["K_pos"] * (wanted - position) - velocity)
        before, last = (last, position) if k else (position, position)
        begin = k * T_S
        solution = solved(rate(p["torque"] * command[k]), begin, begin + T_S, x, scale=scale)
        if k + 1 < len(reference):
            late[k + 1] = p["l_p"] * solution(begin + T_S - p["delay"])[0]
        x = solution(begin + T_S)
    return {"position": late, "command": command}


def motor_signals(command: Array, truth: Mapping[str, float] = MOTOR) -> dict[str, Array]:
    """Position of the motor, late by its delay [m], without noise."""
    p = truth
    x = np.array([0.0, p["velocity_start"]])
    late = np.zeros(len(command))
    late[0] = -p["velocity_start"] * p["delay"]
    for k, volt in enumerate(command[:-1]):
        force, begin = p["force"] * volt, k * T_S

        def rate(t: float, x: Array, force: float = force) -> Array:
            return np.array([x[1], (force - p["b"] * x[1]) / p["m"]])

        solution = solved(rate, begin, begin + T_S, x, scale=np.array([1.0, 1.0]))
        late[k + 1] = solution(begin + T_S - p["delay"])[0]
        x = solution(begin + T_S)
    return {"position": late}


# ---- records ----


def measured(
    signals: Mapping[str, Array], noise: Mapping[str, float], resolution: Mapping[str, float], seed: int
) -> dict[str, Array]:
    """The signals as a record has them: with noise, rounded; the same seed gives the same record."""
    random = np.random.default_rng(seed)
    return {
        name: np.round((values + noise[name] * random.standard_normal(len(values))) / resolution[name])
        * resolution[name]
        for name, values in signals.items()
    }


def write(name: str, columns: Mapping[str, tuple[str, Array]]) -> None:
    """A CSV file: names, units, rows with ten digits."""
    lines = [",".join(columns), ",".join(unit for unit, _ in columns.values())]
    rows = zip(*(values for _, values in columns.values()), strict=True)
    lines += [",".join(f"{value:.10g}" for value in row) for row in rows]
    (FOLDER / name).write_text("\n".join(lines) + "\n", encoding="utf-8")


def sampled(duration: float) -> Array:
    """The times of a record."""
    return T_S * np.arange(round(duration / T_S) + 1)


def write_stage(name: str, reference: Callable[[Array], Array], duration: float, seed: int) -> None:
    """A record of the stage."""
    time = sampled(duration)
    wanted = reference(time)
    rows = measured(stage_signals(wanted), STAGE_NOISE, STAGE_RESOLUTION, seed)
    columns = {"t": ("s", time), "reference": ("m", wanted), "position": ("m", rows["position"])}
    write(name, {**columns, "command": ("V", rows["command"])})


if __name__ == "__main__":
    write_stage("stage.csv", stage_reference, 4.0, seed=1)
    write_stage("stage_other.csv", other_reference, 2.1, seed=2)
    time = sampled(2.0)
    command = motor_command(time)
    rows = measured(motor_signals(command), MOTOR_NOISE, MOTOR_RESOLUTION, seed=3)
    write("motor.csv", {"t": ("s", time), "command": ("V", command), "position": ("m", rows["position"])})
