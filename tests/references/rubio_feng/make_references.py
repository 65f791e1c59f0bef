"""Reference traces of the linear motor, the feed drive axis, their controllers and the cutting force.

Nothing of ``fmus`` is imported. The equations are written again, in SI, and solved by other means:

- linear motor under a held force: the exact solution of m*x'' + b*x' = F over a sample;
- linear motor under the cutting force: RK4 at 0.1 us, chip thickness as the minimum over the four last passages;
- cutting force: a surface kept in angle bins, cut and ploughed tooth by tooth;
- feed drive axis with LuGre friction: RK4 at 1 us. ``verify`` compares it with scipy's Radau at rtol 1e-10.

Run ``python make_references.py`` to write ``linear_motor.npz``, ``milling.npz`` and ``feed_drive.npz`` here.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

Array = NDArray[np.float64]
HERE = Path(__file__).parent

# Linear motor of Rubio et al., all loops at 0.1 ms with a velocity filter of 1 ms, reference sin(3 t) um.
T_S, FILTER, MASS, DAMPING, MASS_HAT, DAMPING_HAT = 1e-4, 1e-3, 10.0, 250.0, 11.0, 255.0
SLOW_FORCE = (-26e-6, 46e-6, 4.83, 2.65)
NO_FORCE = (0.0, 0.0, 0.0, 0.0)
FIT = (0.25, 3.5, 0.18, 3.4e-3)
DESIGN = (25.0, 156.25, 0.18, 3.4e-3)


@numba.njit
def linear_motor_loop(samples, law, surface, force, tuning):  # type: ignore[no-untyped-def]
    """Position error, velocity error and motor force at each sample of a loop on the exact linear motor."""
    pid, relay, late = law
    g, T_s, filter_time, K_v, K_p, K_i = tuning
    mu, lambda_, Lambda, W = surface
    constant, amplitude, omega, phase = force
    error, velocity_error, applied = np.zeros(samples), np.zeros(samples), np.zeros(samples)
    x = v = integral = second = integral_error = filtered = v_hat = x_last = 0.0
    a = math.exp(-T_s / filter_time) if filter_time > 0.0 else 0.0
    E = math.exp(-g * T_s)
    parts = 8
    h = T_s / parts
    q = math.exp(-DAMPING * h / MASS)
    for k in range(samples):
        t = k * T_s
        v_hat = v if k == 0 else a * v_hat + (1.0 - a) * (x - x_last) / T_s
        x_last = x
        ref = 1e-6 * math.sin(3.0 * t)
        ref_1 = 3e-6 * math.cos(3.0 * t)
        ref_2 = -9e-6 * math.sin(3.0 * t)
        e = ref - x
        error[k] = e
        velocity_error[k] = ref_1 - v
        if k == 0:
            filtered = g * MASS_HAT * v_hat
        estimate = g * MASS_HAT * v_hat - filtered
        if pid:
            beta = K_v * e + ref_1 - v_hat
            u = MASS_HAT * ref_2 + K_p * beta + integral + DAMPING_HAT * v_hat - estimate
            integral += K_p * K_i * beta * T_s
        else:
            S = ref_1 - v_hat + mu * e + lambda_ * integral_error
            switch = W * np.sign(S) if relay else second
            u = MASS_HAT * (ref_2 + lambda_ * e) + DAMPING_HAT * ref_1 - estimate
            u += Lambda * math.sqrt(abs(S)) * np.sign(S) + switch
            second += W * np.sign(S) * T_s
            integral_error += e * T_s
        applied[k] = u
        acting = applied[k - 1] if late and k > 0 else u
        filtered = E * filtered + (1.0 - E) * (u - DAMPING_HAT * v_hat + g * MASS_HAT * v_hat)
        for j in range(parts):
            f = acting + constant + amplitude * math.sin(omega * (t + (j + 0.5) * h) + phase)
            x += (1.0 - q) * (MASS / DAMPING) * v + (h - (1.0 - q) * MASS / DAMPING) / DAMPING * f
            v = q * v + (1.0 - q) / DAMPING * f
    return error, velocity_error, applied


def motor(
    seconds: float,
    *,
    pid: bool = True,
    surface: tuple[float, ...] = DESIGN,
    relay: bool = False,
    late: bool = False,
    g: float = 0.0,
    force: tuple[float, ...] = NO_FORCE,
    T_s: float = T_S,
    filter_time: float = FILTER,
    gains: tuple[float, float, float] = (30.0, 50.0, 0.5),
) -> tuple[Array, Array, Array]:
    """One loop on the linear motor from rest; ``late`` commands act one sample later, but the first one."""
    samples = round(seconds / T_s) + 1
    return linear_motor_loop(samples, (pid, relay, late), surface, force, (g, T_s, filter_time, *gains))


CASES: dict[str, dict[str, Any]] = {
    "p_pi": {},
    "p_pi_disturbed": {"force": SLOW_FORCE},
    "p_pi_observer": {"force": SLOW_FORCE, "g": 100.0},
    "design": {"pid": False},
    "fit_disturbed": {"pid": False, "surface": FIT, "force": SLOW_FORCE},
    "fit_observer": {"pid": False, "surface": FIT, "force": SLOW_FORCE, "g": 100.0},
}


# Cutting force: data of one cut in m, N, Pa.
FEED, DEPTH, SPEED, K_TANGENTIAL, K_NORMAL, P_T, P_N, H_0 = 1e-6, 50e-6, 192.0, 3.5e9, 2.1e9, 0.25, 0.35, 1e-6


@numba.njit
def tooth_force(h, h_min, phi):  # type: ignore[no-untyped-def]
    """Force in x and y of a tooth that cuts, or ploughs, a chip h at the angle phi."""
    if h <= 0.0:
        return 0.0, 0.0
    at = max(h, h_min)
    tangential = K_TANGENTIAL * (at / H_0) ** -P_T * DEPTH * h
    normal = K_NORMAL * (at / H_0) ** -P_N * DEPTH * h
    if h < h_min:
        normal *= 1.5
    return (
        -tangential * math.cos(phi) - normal * math.sin(phi),
        tangential * math.sin(phi) - normal * math.cos(phi),
    )


@numba.njit
def cut_in_bins(revolutions, bins, feed, run_out, h_min):  # type: ignore[no-untyped-def]
    """Force in x, y and both chips at the middle of each bin; the surface of each angle is kept and cut.

    It starts as tooth 1 leaves it; tooth 2 of the revolution before the first one passes, then counting starts.
    """
    offset = (run_out, -run_out)
    half = bins // 2
    surface = np.full(half, run_out)
    out = np.zeros((revolutions * bins, 4))
    for step in range(-half, revolutions * bins):
        for tooth in range(2):
            bin_ = (step + bins + tooth * half) % bins
            if bin_ >= half or (step < 0 and tooth == 0):
                continue
            phi = (bin_ + 0.5) / bins * 2.0 * math.pi
            surface[bin_] -= feed * math.sin(phi)
            h = offset[tooth] - surface[bin_]
            if h >= h_min and h > 0.0:
                surface[bin_] = offset[tooth]
            if step >= 0:
                x, y = tooth_force(max(h, 0.0), h_min, phi)
                out[step, 0] += x
                out[step, 1] += y
                out[step, 2 + tooth] = max(h, 0.0)
    return out


MILLING: dict[str, tuple[float, float, float]] = {
    "slot": (1e-6, 0.2e-6, 0.0),
    "ploughing": (1e-6, 0.2e-6, 0.3e-6),
    "thin": (0.25e-6, 0.2e-6, 0.3e-6),
    "even_teeth": (1e-6, 0.01e-6, 0.9e-6),
    "one_tooth": (1e-6, 0.6e-6, 0.3e-6),
}
"""Feed per tooth, run-out, minimum chip."""


@numba.njit
def force_x(t):  # type: ignore[no-untyped-def]
    """Force in x of the slot without ploughing: the chip is the least of four passages back, in steady state."""
    total = 0.0
    for tooth in range(2):
        phi = (2.0 * math.pi * SPEED * t - math.pi * tooth) % (2.0 * math.pi)
        if phi >= math.pi:
            continue
        own = 0.2e-6 if tooth == 0 else -0.2e-6
        h = 1.0
        for q in range(1, 5):
            other = own if q % 2 == 0 else -own
            h = min(h, q * FEED * math.sin(phi) + own - other)
        total += tooth_force(max(h, 0.0), 0.0, phi)[0]
    return total


@numba.njit
def milled_loop(samples, parts, K_p, K_v):  # type: ignore[no-untyped-def]
    """Position, velocity and motor force of a P-PI loop with cutting force, RK4 with ``parts`` steps a sample."""
    out = np.zeros((samples, 4))
    x = v = integral = v_hat = x_last = 0.0
    a = math.exp(-T_S / FILTER)
    h = T_S / parts
    for k in range(samples):
        t = k * T_S
        v_hat = v if k == 0 else a * v_hat + (1.0 - a) * (x - x_last) / T_S
        x_last = x
        ref, ref_1, ref_2 = 1e-6 * math.sin(3.0 * t), 3e-6 * math.cos(3.0 * t), -9e-6 * math.sin(3.0 * t)
        beta = K_v * (ref - x) + ref_1 - v_hat
        u = MASS_HAT * ref_2 + K_p * beta + integral + DAMPING_HAT * v_hat
        integral += K_p * 0.5 * beta * T_S
        out[k, 0], out[k, 1], out[k, 2], out[k, 3] = x, v, u, force_x(t)
        for j in range(parts):
            s = t + j * h
            f_0, f_1, f_2 = u + force_x(s), u + force_x(s + 0.5 * h), u + force_x(s + h)
            a_1 = (f_0 - DAMPING * v) / MASS
            v_2 = v + 0.5 * h * a_1
            a_2 = (f_1 - DAMPING * v_2) / MASS
            v_3 = v + 0.5 * h * a_2
            a_3 = (f_1 - DAMPING * v_3) / MASS
            v_4 = v + h * a_3
            a_4 = (f_2 - DAMPING * v_4) / MASS
            x += h / 6.0 * (v + 2.0 * v_2 + 2.0 * v_3 + v_4)
            v += h / 6.0 * (a_1 + 2.0 * a_2 + 2.0 * a_3 + a_4)
    return out


# Feed drive of Feng et al., axis X: mass, F_C, F_S, v_s, sigma_0, sigma_1, sigma_2 at the table.
AXIS = (380.0, 90.0, 115.0, 2e-3, 1.8e7, 2.5e4, 400.0)
DRIVE_T_S, K_POS, OMEGA_V, T_I, DRIVE_FILTER = 2.5e-4, 40.0, 250.0, 0.02, 5e-4


@numba.njit
def axis_rates(v, z, u, axis):  # type: ignore[no-untyped-def]
    """Rates of velocity and bristle of the rigid axis under the force u."""
    mass, F_C, F_S, v_s, sigma_0, sigma_1, sigma_2 = axis
    level = F_C + (F_S - F_C) * math.exp(-((v / v_s) ** 2))
    z_rate = v - sigma_0 * abs(v) * z / level
    return (u - sigma_0 * z - sigma_1 * z_rate - sigma_2 * v) / mass, z_rate


@numba.njit
def rk4_axis(x, v, z, u, how):  # type: ignore[no-untyped-def]
    """The axis a sample later, under the held force u; ``how`` has axis, step and number of steps."""
    axis, h, steps = how
    for _ in range(steps):
        a_1, r_1 = axis_rates(v, z, u, axis)
        v_2, z_2 = v + 0.5 * h * a_1, z + 0.5 * h * r_1
        a_2, r_2 = axis_rates(v_2, z_2, u, axis)
        v_3, z_3 = v + 0.5 * h * a_2, z + 0.5 * h * r_2
        a_3, r_3 = axis_rates(v_3, z_3, u, axis)
        v_4, z_4 = v + h * a_3, z + h * r_3
        a_4, r_4 = axis_rates(v_4, z_4, u, axis)
        x += h / 6.0 * (v + 2.0 * v_2 + 2.0 * v_3 + v_4)
        v += h / 6.0 * (a_1 + 2.0 * a_2 + 2.0 * a_3 + a_4)
        z += h / 6.0 * (r_1 + 2.0 * r_2 + 2.0 * r_3 + r_4)
    return x, v, z


@numba.njit
def feed_drive_loop(ref, axis, parts, g, trapezoid):  # type: ignore[no-untyped-def]
    """Position, velocity, motor force, pulse and load estimate at each sample of the cascade on one axis."""
    amplitude, duration, rise = trapezoid
    samples = len(ref) - 1
    out = np.zeros((samples, 5))
    x, v, z, integral = ref[0], 0.0, 0.0, 0.0
    v_hat = x_last = filtered = 0.0
    a = math.exp(-DRIVE_T_S / DRIVE_FILTER)
    E = math.exp(-g * DRIVE_T_S)
    mass, sigma_2 = axis[0], axis[6]
    K_vel = mass * OMEGA_V
    h = DRIVE_T_S / parts
    moving, since, sense, increment_last = 0.0, -1, 0.0, ref[1] - ref[0]
    for k in range(samples):
        increment = ref[k + 1] - ref[k]
        v_hat = v if k == 0 else a * v_hat + (1.0 - a) * (x - x_last) / DRIVE_T_S
        x_last = x
        if increment != 0.0:
            if moving != 0.0 and np.sign(increment) != moving:
                since, sense = 0, np.sign(increment)
            moving = np.sign(increment)
        pulse = 0.0
        if since >= 0:
            time = since * DRIVE_T_S
            if time < rise:
                pulse = sense * amplitude * time / rise
            elif time < duration - rise:
                pulse = sense * amplitude
            elif time < duration:
                pulse = sense * amplitude * (duration - time) / rise
            since += 1
        if k == 0:
            filtered = g * mass * v_hat
        load = filtered - g * mass * v_hat
        command = K_POS * (ref[k] - x) + increment / DRIVE_T_S + pulse
        u = K_vel * (command - v_hat) + integral + mass * (increment - increment_last) / DRIVE_T_S**2 + load
        integral += K_vel / T_I * (command - v_hat) * DRIVE_T_S
        filtered = E * filtered + (1.0 - E) * (u - sigma_2 * v_hat + g * mass * v_hat)
        increment_last = increment
        out[k, 0], out[k, 1], out[k, 2], out[k, 3], out[k, 4] = x, v, u, pulse, load
        x, v, z = rk4_axis(x, v, z, u, (axis, h, parts))
    return out


def circle(samples: int, feed: float, radius: float = 0.025) -> Array:
    """X of a circle from -45 degrees with 0.2 m/s2 along the path up to ``feed`` in m/s, at each sample."""
    t = np.arange(samples) * DRIVE_T_S
    ramp = feed / 0.2
    path = np.where(t < ramp, 0.1 * t**2, 0.1 * ramp**2 + feed * (t - ramp))
    return radius * np.cos(path / radius - 0.25 * math.pi)


PULSE = (0.6e-3, 0.0765, 2e-3)
"""Amplitude, duration and rise of the pulse: near the best at F 1000."""
REVERSAL = 4879
"""Sample of the circle at F 1000 whose increment is the first one back."""
NO_PULSE = (0.0, 0.0, 1e-3)


def feed_drives(seconds: float, parts: int = 250) -> dict[str, Array]:
    """The loop on a circle of 25 mm at F 1000 without compensation, with observer, with pulse."""
    ref = circle(round(seconds / DRIVE_T_S) + 2, 1.0 / 60.0)
    return {
        "plain": feed_drive_loop(ref, AXIS, parts, 0.0, NO_PULSE),
        "observer": feed_drive_loop(ref, AXIS, parts, 50.0, NO_PULSE),
        "pulse": feed_drive_loop(ref, AXIS, parts, 0.0, PULSE),
    }


def verify() -> tuple[float, float]:
    """Largest difference in m of the RK4 axis to Radau over a reversal, and to half its step."""
    force = 250.0 * np.sin(2.0 * math.pi * 5.0 * np.arange(800) * DRIVE_T_S)
    worst, x, v, z = 0.0, 0.0, 0.0, 0.0
    state = np.zeros(3)
    h = DRIVE_T_S / 250
    for u in force:
        solution = solve_ivp(
            lambda _t, s, u=u: (s[1], *axis_rates(s[1], s[2], u, AXIS)),
            (0.0, DRIVE_T_S),
            state,
            method="Radau",
            rtol=1e-10,
            atol=(1e-15, 1e-13, 1e-15),
        )
        state = solution.y[:, -1]
        x, v, z = rk4_axis(x, v, z, u, (AXIS, h, 250))
        worst = max(worst, abs(x - state[0]))
    coarse, fine = feed_drives(3.0, 250), feed_drives(3.0, 500)
    halved = max(float(np.max(np.abs(coarse[name][:, 0] - fine[name][:, 0]))) for name in coarse)
    return worst, halved


def write() -> None:
    """Write the three files."""
    traces: dict[str, Array] = {}
    for name, case in CASES.items():
        columns = np.stack(motor(20.0, **case), axis=1)
        traces[f"{name}_start"] = columns[:1001]
        traces[f"{name}_whole"] = columns[::400]
    traces["relay_start"] = np.stack(motor(0.1, pid=False, relay=True), axis=1)
    traces["milled"] = milled_loop(1001, 1000, 5000.0, 30.0)
    np.savez_compressed(HERE / "linear_motor.npz", allow_pickle=False, **traces)
    cuts = {name: cut_in_bins(6, 360, *case) for name, case in MILLING.items()}
    np.savez_compressed(HERE / "milling.npz", allow_pickle=False, **cuts)
    drives: dict[str, Array] = {}
    for name, columns in feed_drives(2.0).items():
        drives[f"{name}_start"] = columns[:241]
        drives[f"{name}_whole"] = columns[::20]
        drives[f"{name}_reversal"] = columns[REVERSAL - 99 : REVERSAL + 501]
    np.savez_compressed(HERE / "feed_drive.npz", allow_pickle=False, **drives)


if __name__ == "__main__":
    write()
