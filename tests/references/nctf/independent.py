# ruff: noqa: PLR0917
"""NCTF plants and controllers written a second time, for references: nothing of ``fmus`` or ``cosim`` is used.

Equations of Maeda & Sato 2008 (two-inertia ballscrew, NCTF with PI) and Purtojo et al. 2015 (linear stage, fuzzy
NCTF), with LuGre friction; classical Runge-Kutta of fixed step, compiled. Plants are in SI, controllers in the
papers' mm, mm/s, A and V. A command is held from the sample at which it is computed.
"""

from __future__ import annotations

import numpy as np

try:
    from numba import njit
except ModuleNotFoundError:
    # The functions are plain Python; the long runs of make_references.py want numba (extra "references").
    def njit(**_):
        return lambda function: function


BALLSCREW = {
    "K_m": 0.172,
    "J": 1.81e-4,
    "m": 3.57,
    "l_p": 2e-3 / (2.0 * np.pi),
    "K_n": 8.3e5,
    "C_n": 1700.0,
    "i_max": 6.0,
    "sigma_0": 14.6,
    "sigma_1": 0.072,
    "sigma_2": 9.7e-4,
    "T_C": 0.046,
    "T_S": 0.046,
    "omega_s": 1.0,
    "guide_sigma_0": 2e7,
    "guide_sigma_1": 0.0,
    "guide_sigma_2": 0.0,
    "F_C": 0.0,
    "F_S": 0.0,
    "v_s": 2e-3,
}
"""The reference plant. States: screw angle, speed, table position, velocity, bristles of screw and guide."""

WARM = {"T_C": 0.87 * 0.046, "T_S": 0.87 * 0.046, "sigma_2": 0.76 * 9.7e-4}
GUIDE = {"F_C": 12.0, "F_S": 18.0, "guide_sigma_1": 2e3, "guide_sigma_2": 150.0}
"""A guide with friction, Stribeck effect included, used for the trace ``guide``."""

COMPENSATOR_C = {"K_P": 0.96, "K_I": 1250.0**2 / 16311.5}
"""A.s/mm and A/mm: omega_n*T = 0.25 at 5 kHz, alpha*K = 505*32.3 mm/(A.s2)."""


def plant_vector(**changes: float) -> np.ndarray:
    """Parameters of the ballscrew in the order of ``BALLSCREW``."""
    return np.array(list((BALLSCREW | changes).values()))


@njit(cache=True)
def ballscrew_rates(s, i, force, torque, p, out):
    """Derivatives of the six states at current ``i``; ``force`` and ``torque`` load table and screw."""
    k_m, inertia, mass, r, k_n, c_n = p[0], p[1], p[2], p[3], p[4], p[5]
    theta, w, x, v, z, zg = s
    level = p[10] + (p[11] - p[10]) * np.exp(-((w / p[12]) ** 2))
    dz = w - p[7] * abs(w) * z / level if level > 0.0 else 0.0
    friction = p[7] * z + p[8] * dz + p[9] * w
    guide_level = p[16] + (p[17] - p[16]) * np.exp(-((v / p[18]) ** 2))
    dzg = v - p[13] * abs(v) * zg / guide_level if guide_level > 0.0 else 0.0
    guide = p[13] * zg + p[14] * dzg + p[15] * v
    nut = k_n * (r * theta - x) + c_n * (r * w - v)
    current = min(p[6], max(-p[6], i))
    out[0] = w
    out[1] = (k_m * current - friction - torque - r * nut) / inertia
    out[2] = v
    out[3] = (nut - guide - force) / mass
    out[4] = dz
    out[5] = dzg


@njit(cache=True)
def advance(s, i, force, torque, p, duration, substeps):
    """The state after ``duration`` with held inputs."""
    h = duration / substeps
    a, b, c, d = np.empty(6), np.empty(6), np.empty(6), np.empty(6)
    for _ in range(substeps):
        ballscrew_rates(s, i, force, torque, p, a)
        ballscrew_rates(s + 0.5 * h * a, i, force, torque, p, b)
        ballscrew_rates(s + 0.5 * h * b, i, force, torque, p, c)
        ballscrew_rates(s + h * c, i, force, torque, p, d)
        s = s + h / 6.0 * (a + 2.0 * b + 2.0 * c + d)
    return s


@njit(cache=True)
def open_loop(current, force, torque, p, T, substeps):
    """States at k*T, k = 0 ... n, for currents and loads held over each T."""
    n = len(current)
    rows = np.zeros((n + 1, 6))
    for k in range(n):
        rows[k + 1] = advance(rows[k], current[k], force[k], torque[k], p, T, substeps)
    return rows


@njit(cache=True)
def nctf_pi_sample(ref, x, memory, gains, nct_e, nct_v, antiwindup):
    """One sample in mm; ``memory`` holds integral, last position, whether started; ``gains`` T, K_P, K_I, limit, q.

    Returns the command and sets the memory.
    """
    T, k_p, k_i, limit, q = gains
    xm = q * np.floor(x / q + 0.5) if q > 0.0 else x
    vm = (xm - memory[1]) / T if memory[2] > 0.0 else 0.0
    e = ref - xm
    up = np.sign(e) * np.interp(abs(e), nct_e, nct_v) - vm
    uo = k_p * up
    if not (antiwindup and abs(uo + memory[0]) > limit and up * memory[0] >= 0.0):
        memory[0] += T * k_i * up
    memory[1], memory[2] = xm, 1.0
    return min(limit, max(-limit, uo + memory[0]))


@njit(cache=True)
def nctf_pi_replay(ref, x, gains, nct_e, nct_v, antiwindup):
    """Commands for recorded references and positions in mm."""
    memory = np.zeros(3)
    command = np.empty(len(ref))
    for k in range(len(ref)):
        command[k] = nctf_pi_sample(ref[k], x[k], memory, gains, nct_e, nct_v, antiwindup)
    return command


@njit(cache=True)
def nctf_pi_loop(ref, p, gains, nct_e, nct_v, antiwindup, delay, substeps):
    """Closed loop from rest: positions [mm] and held commands [A] at the samples; ``delay`` samples of computing."""
    memory, s = np.zeros(3), np.zeros(6)
    position, command = np.empty(len(ref)), np.empty(len(ref))
    pending = 0.0
    for k in range(len(ref)):
        position[k] = 1e3 * s[2]
        new = nctf_pi_sample(ref[k], position[k], memory, gains, nct_e, nct_v, antiwindup)
        command[k] = pending if delay > 0 else new
        pending = new
        s = advance(s, command[k], 0.0, 0.0, p, gains[0], substeps)
    return position, command


@njit(cache=True)
def fuzzy_nct(e, slope, e_1, reach, h_max):
    """Velocity [mm/s] at error ``e`` [mm]: line to e_1, square-root arc to ``reach``, constant beyond."""
    a = abs(e)
    if a <= e_1:
        return slope * e
    v_1 = slope * e_1
    if a >= reach:
        return np.sign(e) * h_max
    return np.sign(e) * np.sqrt(v_1**2 + (h_max**2 - v_1**2) * (a - e_1) / (reach - e_1))


@njit(cache=True)
def area_and_moment(h, u_r):
    """Of the s-shape over 0 ... u_r cut at height ``h``."""
    if h <= 0.5:
        t = np.sqrt(h / 2.0)
        return u_r * (2.0 * t**3 / 3.0 + h * (1.0 - t)), u_r**2 * (t**4 / 2.0 + h * (1.0 - t**2) / 2.0)
    s = np.sqrt((1.0 - h) / 2.0)
    t = 1.0 - s
    g_0 = (0.5 - 2.0 * 0.5**3 / 3.0) - (s - 2.0 * s**3 / 3.0)
    g_1 = (0.5 - 0.125 - 2.0 * 0.5**3 / 3.0 + 0.5**4 / 2.0) - (s - s**2 / 2.0 - 2.0 * s**3 / 3.0 + s**4 / 2.0)
    return u_r * (1.0 / 12.0 + g_0 + h * (1.0 - t)), u_r**2 * (1.0 / 32.0 + g_1 + h * (1.0 - t**2) / 2.0)


@njit(cache=True)
def fuzzy_command(up, ui, up_zero, ui_zero, up_max, ui_max, u_r, w_z, singletons):
    """Defuzzified output [V]; exact centroid with singleton weight ``w_z``, or mean of singletons."""
    a = min(up_max, max(-up_max, up))
    b = min(ui_max, max(-ui_max, ui))
    first = (max(0.0, -a) / up_max, max(0.0, 1.0 - abs(a) / up_zero), max(0.0, a) / up_max)
    second = (max(0.0, -b) / ui_max, max(0.0, 1.0 - abs(b) / ui_zero), max(0.0, b) / ui_max)
    h = np.zeros(3)
    for i in range(3):
        for j in range(3):
            k = min(1, max(-1, i + j - 2)) + 1
            h[k] = max(h[k], min(first[i], second[j]))
    if singletons:
        total = h[0] + h[1] + h[2]
        return u_r * (h[2] - h[0]) / total if total > 0.0 else 0.0
    area_n, moment_n = area_and_moment(h[0], u_r)
    area_p, moment_p = area_and_moment(h[2], u_r)
    total = area_n + area_p + w_z * h[1]
    return (moment_p - moment_n) / total if total > 0.0 else 0.0


STAGE = (5.672, 215.2)
"""Gain [mm/(s.V)] and pole [1/s] of the linear stage."""

PROPOSED = np.array([1.0, 0.2152, 0.0008, 56.72, 38.4, 10.0, 0.2, 0.0, 1.0])
EXISTING = np.array([0.0, 28.36, 0.384, 56.72, 38.4, 10.0, 0.2, 1.0, 0.53])
"""Fuzzy NCTF: whether the reference's rate is used, half widths of Z of u_p and u_i, ranges of both, u_r, w_z,
whether outputs are singletons, gain K_f."""

NCT_SHAPE = np.array([215.2, 0.1, 1.354, 56.72])
"""Slope [1/s], end of the line [mm], end of the arc [mm], largest velocity [mm/s]."""


@njit(cache=True)
def fuzzy_sample(ref, ref_rate, x, v, ui, c, shape, T):
    """Command [V] and integral [mm] of one sample."""
    up = fuzzy_nct(ref - x, shape[0], shape[1], shape[2], shape[3]) - v
    if c[0] > 0.0:
        up += ref_rate
    ui += T * up
    return c[8] * fuzzy_command(up, ui, c[1], c[2], c[3], c[4], c[5], c[6], c[7] > 0.0), ui


@njit(cache=True)
def fuzzy_replay(ref, ref_rate, x, v, c, shape, T):
    """Commands for recorded inputs in mm and mm/s."""
    command = np.empty(len(ref))
    ui = 0.0
    for k in range(len(ref)):
        command[k], ui = fuzzy_sample(ref[k], ref_rate[k], x[k], v[k], ui, c, shape, T)
    return command


@njit(cache=True)
def fuzzy_loop(ref, ref_rate, c, shape, gain, alpha, T):
    """Closed loop on the linear stage from rest, its held response exact: positions [mm], velocities, commands."""
    n = len(ref)
    position, velocity, command = np.empty(n), np.empty(n), np.empty(n)
    x = v = ui = 0.0
    decay = np.exp(-alpha * T)
    for k in range(n):
        position[k], velocity[k] = x, v
        u, ui = fuzzy_sample(ref[k], ref_rate[k], x, v, ui, c, shape, T)
        command[k] = u
        x += gain * u * T + (v - gain * u) * (1.0 - decay) / alpha
        v = gain * u + (v - gain * u) * decay
    return position, velocity, command
