"""P-PI control: traces of the loop on the exact linear motor, stability limit, saturation."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from motion_loops import Sampled, assert_follows, assert_limited_and_odd, motor_loop

from fmus.controllers.p_pi import PPi
from fmus.physics.sampling import VelocitySource


def test_loop_follows_the_reference():
    # RK4 over a sample is exact to (b*T_s/m)^5 = 1e-13.
    assert_follows(motor_loop(PPi(), 1001), "p_pi_start", 1e-9)


def test_loop_under_a_slow_force_follows_the_reference():
    # Held at the middle of the sample instead of an eighth of it: (4.83*1e-4)^2/24 of the force.
    assert_follows(motor_loop(PPi(), 1001, disturbed=True), "p_pi_disturbed_start", 1e-6)


def state_matrix(controller: PPi) -> np.ndarray:
    """One sample of the linear loop at zero reference, column by column; the motor by its exact solution."""
    m, b, T_s = 10.0, 250.0, controller.T_s
    q = math.exp(-b * T_s / m)

    def step(vector: list[float]) -> list[float]:
        x, v, integral, position_last, velocity_last = vector
        state = controller.State(
            integral=integral, started=1.0, position_last=position_last, velocity_last=velocity_last
        )
        u = controller.Input(position=x, velocity=v)
        y = controller.output(0.0, state, u)
        after: Any = controller.update(0.0, state, u, y)
        travel = (1.0 - q) * (m / b) * v + (T_s - (1.0 - q) * m / b) / b * y.force
        return [x + travel, q * v + (1.0 - q) / b * y.force, after.integral, after.position_last, after.velocity_last]

    return np.array([step(column) for column in np.eye(5).tolist()]).T


def limit(make: Any, low: float, high: float) -> float:
    """Integral gain at which the loop turns unstable, by bisection."""
    for _ in range(40):
        middle = 0.5 * (low + high)
        stable = np.max(np.abs(np.linalg.eigvals(state_matrix(make(middle))))) < 1.0
        low, high = (middle, high) if stable else (low, middle)
    return low


def test_integral_gain_at_the_limit_of_stability():
    exact = limit(lambda gain: PPi(K_i=gain, T_s=1e-6, velocity_source=VelocitySource.input), 1.0, 20.0)
    # Routh: (K_p + b - b_hat)*(K_v + K_i) = m*K_i*K_v
    routh = 45.0 * 30.0 / (10.0 * 30.0 - 45.0)
    assert exact == pytest.approx(routh, rel=1e-3)
    assert routh == pytest.approx(5.294, abs=5e-4)
    # Found by an earlier simulation on the edge of growth; 1 %.
    assert limit(lambda gain: PPi(K_i=gain, T_s=2e-4), 1.0, 20.0) == pytest.approx(5.095, rel=0.01)
    assert limit(
        lambda gain: PPi(K_i=gain, T_s=2e-4, velocity_source=VelocitySource.input), 1.0, 20.0
    ) == pytest.approx(5.248, rel=0.01)


def test_too_large_an_estimate_of_damping_destabilises():
    def radius(b_hat: float) -> float:
        return float(np.max(np.abs(np.linalg.eigvals(state_matrix(PPi(b_hat=b_hat))))))

    assert radius(255.0) < 1.0 < radius(301.0)


def test_integrator_is_held_at_the_limit_and_leaves_it_at_once():
    controller = Sampled(PPi(command_max=0.01))
    for _ in range(200):
        assert controller(position_ref=1.0).command == 0.01
    assert controller.x.integral == 0.0
    controller(position_ref=-1e-9)
    assert controller.x.integral < 0.0


def test_disturbance_estimate_is_subtracted():
    controller = PPi()
    u = controller.Input(disturbance_estimate=2.0)
    assert controller.output(0.0, controller.initial(), u).force == -2.0


def test_velocity_from_the_input():
    controller = PPi(velocity_source=VelocitySource.input)
    y = controller.output(0.0, controller.initial(), controller.Input(velocity=2e-3))
    assert y.velocity_estimate == 2e-3
    assert y.force == pytest.approx(50.0 * -2e-3 + 255.0 * 2e-3)


@given(values=st.lists(st.floats(-1e3, 1e3), min_size=6, max_size=6), limit=st.floats(1e-6, 1e3))
def test_command_is_finite_within_its_limit_and_odd(values: list[float], limit: float):
    assert_limited_and_odd(PPi(command_max=limit), values, limit, integral=values[0])


def test_zero_in_zero_out():
    controller = PPi()
    y = controller.output(0.0, controller.initial(), controller.Input())
    assert set(y) == {0.0}
