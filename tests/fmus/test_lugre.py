"""LuGre friction against closed forms: Stribeck curve, break-away, Dahl's hysteresis loop, bounds, passivity."""

from __future__ import annotations

import math
from typing import Any

import casadi
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from cosim.export.symbol import Symbol
from fmus.physics.lugre import (
    bristle_rate,
    friction,
    friction_level,
    observer_step,
    steady_bristle,
)

SIGMA_0, SIGMA_1, SIGMA_2 = 1e5, math.sqrt(1e5), 0.4
F_C, F_S, V_S = 6.24, 9.36, 1e-3
J = 3.702102e-4

speeds = st.floats(-100.0, 100.0)


def level(speed: float) -> float:
    return friction_level(speed, F_C, F_S, V_S)


def torque(z: float, speed: float) -> float:
    rate = bristle_rate(z, speed, level(speed), SIGMA_0)
    return friction(z, rate, speed, sigma_0=SIGMA_0, sigma_1=SIGMA_1, sigma_2=SIGMA_2)


@pytest.mark.parametrize(
    ("speed", "published"), [(1e-4, 9.329), (1e-3, 7.38818), (1e-2, 6.244), (1.0, 6.64), (5.0, 8.24)]
)
@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_steady_friction_is_the_stribeck_curve(speed: float, published: float, direction: float):
    v = direction * speed
    # The bristle settles within level/(sigma_0*v); 60 of these leave e^-60.
    end = 60.0 * F_S / (SIGMA_0 * speed)
    solution = solve_ivp(
        lambda _, z: [bristle_rate(z[0], v, level(v), SIGMA_0)], (0.0, end), [0.0], "Radau", rtol=1e-9, atol=1e-15
    )
    z = float(solution.y[0, -1])
    # The published values have four to six digits.
    assert torque(z, v) == pytest.approx(direction * published, rel=6e-5)
    # What is left of the bristle's motion counts sigma_1*speed/level times.
    assert direction * level(v) + SIGMA_2 * v == pytest.approx(torque(z, v), rel=1e-6)
    assert steady_bristle(v, level(v), SIGMA_0) == pytest.approx(z, rel=1e-8)


def test_stribeck_level_falls_from_static_to_coulomb_friction():
    assert friction_level(0.0, F_C, F_S, V_S) == F_S
    assert friction_level(V_S, F_C, F_S, V_S) == pytest.approx(F_C + (F_S - F_C) / math.e, rel=1e-15)
    assert friction_level(1.0, F_C, F_S, V_S) == F_C
    assert friction_level(0.3, F_C, F_C, V_S) == F_C


@pytest.mark.parametrize(("rise", "share_of_static"), [(0.5, 0.96), (0.02, 0.99)])
def test_rising_torque_breaks_away_below_static_friction(rise: float, share_of_static: float):
    """Under a slow ramp the bristles creep with der(z) = rise/sigma_0, which needs friction level*(1 - der(z)/v).

    The largest that any creep speed v can give is the break-away torque; it tends to F_S as the ramp gets slower.
    """
    v = np.geomspace(1e-6, 1e-2, 100001)
    creep = rise / SIGMA_0
    steady = (F_C + (F_S - F_C) * np.exp(-((v / V_S) ** 2))) * (1.0 - creep / v)
    break_away = float(np.max(steady)) + SIGMA_1 * creep

    def rates(t: float, state: Any) -> list[float]:
        speed, z = state.tolist()
        return [(rise * t - torque(z, speed)) / J, bristle_rate(z, speed, level(speed), SIGMA_0)]

    def slips(_: float, state: Any) -> float:
        return state[0] - 0.1

    slips.terminal = True  # type: ignore[attr-defined]
    solution = solve_ivp(
        rates, (0.0, 10.0 / rise), [0.0, 0.0], method="Radau", rtol=1e-6, atol=[1e-10, 1e-12], events=slips
    )
    assert len(solution.t_events[0]) == 1
    # The slip takes some ms to develop, sigma_2 adds less.
    assert rise * solution.t_events[0][0] == pytest.approx(break_away, rel=2e-3)
    assert share_of_static * F_S < break_away < F_S


@pytest.mark.parametrize("amplitude", [2e-5, 1e-4, 1e-3])
def test_hysteresis_loop_has_the_area_of_dahls_model(amplitude: float):
    """Without Stribeck effect and damping, z over a closed displacement cycle has a closed form:

    sigma_0*z at the ends is F_C*tanh(k*a), the area 4*F_C*(a - tanh(k*a)/k), with k = sigma_0/F_C.
    """

    def rates(t: float, x: Any) -> list[float]:
        v = amplitude * math.cos(t)
        return [bristle_rate(float(x[0]), v, F_C, SIGMA_0), SIGMA_0 * x[0] * v]

    # From an end of the displacement; a cycle forgets the start by exp(-4*k*a), a quarter at the smallest amplitude.
    start = 0.5 * math.pi
    cycles = [start + 2.0 * math.pi * n for n in (0, 7, 8)]
    solution = solve_ivp(
        rates, (start, cycles[2]), [0.0, 0.0], method="LSODA", t_eval=cycles, rtol=1e-8, atol=[1e-13, 1e-11]
    )
    z, work = solution.y
    k = SIGMA_0 / F_C
    assert SIGMA_0 * z[2] == pytest.approx(F_C * math.tanh(k * amplitude), rel=1e-3)
    assert work[2] - work[1] == pytest.approx(4.0 * F_C * (amplitude - math.tanh(k * amplitude) / k), rel=1e-3)


@given(speeds)
def test_bristle_stays_within_static_friction(speed: float):
    """On the bound abs(z) = F_S/sigma_0 the rate never points outwards."""
    edge = F_S / SIGMA_0
    assert bristle_rate(edge, speed, level(speed), SIGMA_0) <= 1e-12 * abs(speed)
    assert bristle_rate(-edge, speed, level(speed), SIGMA_0) >= -1e-12 * abs(speed)


def dissipation(z: float, speed: float, sigma_2: float) -> float:
    """Power taken in less the rate of the energy stored in the bristle."""
    rate = bristle_rate(z, speed, level(speed), SIGMA_0)
    force = friction(z, rate, speed, sigma_0=SIGMA_0, sigma_1=SIGMA_1, sigma_2=sigma_2)
    return force * speed - SIGMA_0 * z * rate


@given(st.floats(-1.0, 1.0), st.floats(-0.0789, 0.0789))
def test_friction_is_passive_below_four_levels_over_the_damping(part: float, speed: float):
    assert abs(speed) * SIGMA_1 < 4.0 * level(speed)
    assert dissipation(part * F_S / SIGMA_0, speed, 0.0) >= -1e-12


def test_friction_is_not_passive_beyond():
    speed = 0.1
    assert speed * SIGMA_1 > 4.0 * level(speed)
    z = 0.5 * SIGMA_1 * speed / SIGMA_0
    expected = SIGMA_1 * speed**2 * (1.0 - SIGMA_1 * speed / (4.0 * level(speed)))
    assert dissipation(z, speed, 0.0) == pytest.approx(expected, rel=1e-9)
    assert expected < 0.0


@given(st.floats(-1e-4, 1e-4), speeds, st.sampled_from([1e-6, 1e-4, 1e-2]))
def test_observer_step_is_backward_euler(z: float, speed: float, T_s: float):
    after = observer_step(z, speed, level(speed), SIGMA_0, T_s)
    rate = bristle_rate(after, speed, level(speed), SIGMA_0)
    assert after == pytest.approx(z + T_s * rate, abs=1e-12 * (1.0 + SIGMA_0 * abs(speed) * T_s / F_C) * (1e-3 + T_s))


@given(speeds, st.floats(1e-7, 1.0))
def test_observer_keeps_steady_sliding(speed: float, T_s: float):
    z = steady_bristle(speed, level(speed), SIGMA_0)
    assert observer_step(z, speed, level(speed), SIGMA_0, T_s) == pytest.approx(z, rel=1e-12)


@given(speeds, st.floats(-1e-4, 1e-4))
def test_friction_is_odd(speed: float, z: float):
    assert torque(-z, -speed) == -torque(z, speed)


def test_without_contact_only_viscous_friction_is_left():
    for speed in (-3.0, 0.0, 2.0):
        none = friction_level(speed, 0.0, 0.0, V_S)
        rate = bristle_rate(0.0, speed, none, SIGMA_0)
        assert rate == 0.0
        assert friction(0.0, rate, speed, sigma_0=SIGMA_0, sigma_1=SIGMA_1, sigma_2=SIGMA_2) == SIGMA_2 * speed
        assert steady_bristle(speed, none, SIGMA_0) == 0.0


@pytest.mark.parametrize("coulomb", [0.0, F_C])
@pytest.mark.parametrize("speed", [0.0, 1e-9, -1e-3, 60.0, -1e4])
def test_derivatives_are_finite_and_right(speed: float, coulomb: float):
    z_symbol, speed_symbol = casadi.SX.sym("z"), casadi.SX.sym("speed")
    z: Any = Symbol(z_symbol)
    v: Any = Symbol(speed_symbol)
    static = 1.5 * coulomb
    value: Any = bristle_rate(z, v, friction_level(v, coulomb, static, V_S), SIGMA_0)
    expression: Any = value.expression
    gradient = casadi.Function(
        "gradient", [z_symbol, speed_symbol], [casadi.gradient(expression, casadi.vertcat(z_symbol, speed_symbol))]
    )
    found = np.array(gradient(3e-5, speed)).ravel()
    assert np.all(np.isfinite(found))

    def rate(z: float, v: float) -> float:
        return bristle_rate(z, v, friction_level(v, coulomb, static, V_S), SIGMA_0)

    if speed != 0.0:
        h = 1e-6 * abs(speed)
        slope = (rate(3e-5, speed + h) - rate(3e-5, speed - h)) / (2.0 * h)
        assert found[1] == pytest.approx(slope, rel=1e-4, abs=1e-6)
    slope = (rate(4e-5, speed) - rate(2e-5, speed)) / 2e-5
    assert found[0] == pytest.approx(slope, rel=1e-6, abs=1e-6)
