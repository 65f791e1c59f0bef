"""Super-twisting control: traces of the loop, both forms of switching, units, saturation."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from motion_loops import Sampled, assert_follows, assert_limited_and_odd, motor_loop

from fmus.controllers.super_twisting import SuperTwisting, Switching
from fmus.physics.sampling import VelocitySource

FIT = SuperTwisting(mu=0.25, lambda_=3.5, Lambda=0.18, W=3.4e-3)


def test_design_follows_the_reference():
    # sign(S) turns rounding into a step of W*T_s*1e-4 of the force; measured 1e-6.
    assert_follows(motor_loop(SuperTwisting(), 1001), "design_start", 1e-4)


def test_fitted_gains_under_a_slow_force_follow_the_reference():
    assert_follows(motor_loop(FIT, 1001, disturbed=True), "fit_disturbed_start", 1e-4)


def test_relay_follows_the_reference_until_it_chatters():
    assert_follows(motor_loop(SuperTwisting(switching=Switching.relay), 200), "relay_start", 1e-6)


def test_integral_form_steps_far_less_than_the_relay():
    def step(controller: SuperTwisting) -> float:
        force = motor_loop(controller, 1500)[1000:, 2]
        return float(np.sqrt(np.mean(np.diff(force) ** 2)))

    smooth = step(FIT)
    relay = step(SuperTwisting(mu=0.25, lambda_=3.5, Lambda=0.18, W_relay=3.4e-3, switching=Switching.relay))
    # An earlier simulation of 20 s: 0.51 against 2.5e3 uN a sample; here the order of magnitude of the ratio.
    assert relay / smooth > 1e3


def test_law_on_one_sample_in_other_units():
    # The gains in um and uN, 180 and 3400, give the same force.
    controller = SuperTwisting(mu=2.0, lambda_=3.5, Lambda=0.18, W=3.4e-3, velocity_source=VelocitySource.input)
    x = controller.State(v=7e-6, integral_error=0.4e-6, started=1.0)
    u = controller.Input(position_ref=1e-6, velocity_ref=2e-6, acceleration_ref=3e-6, position=0.7e-6, velocity=1.5e-6)
    e, S = 0.3, 0.5 + 2.0 * 0.3 + 3.5 * 0.4
    force = 11.0 * (3.0 + 3.5 * e) + 255.0 * 2.0 + 180.0 * math.sqrt(S) + 7.0
    y = controller.output(0.0, x, u)
    assert y.sliding_surface == pytest.approx(S * 1e-6)
    assert y.force == pytest.approx(force * 1e-6)
    after = controller.update(0.0, x, u, y)
    assert after.v == pytest.approx((7.0 + 3400.0 * 1e-4) * 1e-6)
    assert after.integral_error == pytest.approx((0.4 + e * 1e-4) * 1e-6)


def test_integrals_are_held_at_the_limit():
    controller = Sampled(SuperTwisting(command_max=1e-3))
    for _ in range(100):
        assert controller(position_ref=1.0).command == 1e-3
    assert controller.x.v == 0.0
    assert controller.x.integral_error == 0.0
    controller(position_ref=-1e-12)
    assert controller.x.v < 0.0


@given(values=st.lists(st.floats(-10.0, 10.0), min_size=6, max_size=6), limit=st.floats(1e-6, 1e3))
def test_command_is_finite_within_its_limit_and_odd(values: list[float], limit: float):
    for switching in Switching:
        controller = SuperTwisting(command_max=limit, switching=switching)
        assert_limited_and_odd(controller, values, limit, v=values[0], integral_error=values[1])


def test_zero_in_zero_out():
    for switching in Switching:
        controller = SuperTwisting(switching=switching)
        y = controller.output(0.0, controller.initial(), controller.Input())
        assert set(y) == {0.0}
