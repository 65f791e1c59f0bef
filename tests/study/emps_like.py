"""Files like those of the benchmark EMPS, made up: an axis of two laps, solved by Radau from plain equations."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp
from scipy.io import savemat

T_S, LAP, LAPS = 1e-3, 1.56, 2
M, FC, FV, OFFSET = 95.0, 20.0, 200.0, -3.0
FORCE, K_POS, K_VEL = 35.1507, 160.18, 243.45
SIGMA_0, SIGMA_1 = 6.9e6, 10.0
"""N/m and N.s/m, of bristles after Canudas de Wit et al. 1995."""


def reference(time: np.ndarray) -> np.ndarray:
    """Out and back, once a lap, with rests."""
    phase = np.mod(time, LAP)
    s = np.clip((phase - 0.05) / 0.6, 0.0, 1.0) - np.clip((phase - 0.8) / 0.6, 0.0, 1.0)
    return 0.04 * s**3 * (10.0 - s * (15.0 - 6.0 * s))


def write(folder: Path, *, pulses: bool = False) -> Path:
    """The record of the made-up axis; with pulses of force that push towards positive position."""
    time = T_S * np.arange(round(LAPS * LAP / T_S) + 1)
    wanted = reference(time)
    push = np.where((time > 0.9) & (time < 0.93), 15.0, 0.0) if pulses else np.zeros_like(time)
    x, before, last = np.zeros(3), 0.0, 0.0
    position, command = np.zeros(len(time)), np.zeros(len(time))
    for k, goal in enumerate(wanted):
        position[k] = x[0]
        velocity = (x[0] - before) / (2.0 * T_S)
        command[k] = K_VEL * (K_POS * (goal - x[0]) - velocity)
        before, last = last, x[0]
        force = FORCE * command[k] + push[k]

        def rate(t: float, y: np.ndarray, force: float = force) -> list[float]:
            bristle = y[1] - SIGMA_0 * abs(y[1]) * y[2] / FC
            friction = SIGMA_0 * y[2] + SIGMA_1 * bristle + FV * y[1]
            return [y[1], (force - friction - OFFSET) / M, bristle]

        x = solve_ivp(rate, (0.0, T_S), x, method="Radau", rtol=1e-8, atol=[1e-12, 1e-10, 1e-13]).y[:, -1]
    random = np.random.default_rng(0)
    content = {
        "t": time,
        "qg": wanted,
        "qm": position + 5e-8 * random.standard_normal(len(time)),
        "vir": command + 2e-3 * random.standard_normal(len(time)),
    }
    path = folder / ("DATA_EMPS_PULSES.mat" if pulses else "DATA_EMPS.mat")
    savemat(path, content | ({"pulses_N": push} if pulses else {}))
    return path
