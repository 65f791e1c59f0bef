"""Cascade control: the feed drive axis of Feng et al. against an independent solver, saturation, starts at speed."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from motion_loops import Sampled, assert_limited_and_odd, reference, rk4

from fmus.controllers.cascade_pid import CascadePid, FeedForward
from fmus.controllers.disturbance_observer import DisturbanceObserver, ForceTiming
from fmus.controllers.friction_pulse import FrictionPulse, Mode
from fmus.physics.sampling import VelocitySource
from fmus.plant.ballscrew_stage import BallscrewStage

LEAD = 0.01 / (2.0 * math.pi)
AXIS_X = BallscrewStage(
    m=60.0,
    J_rot=320.0 * LEAD**2,
    l_p=LEAD,
    sigma_0=1.8e7 * LEAD**2,
    sigma_1=2.5e4 * LEAD**2,
    sigma_2=400.0 * LEAD**2,
    F_C=90.0 * LEAD,
    F_S=115.0 * LEAD,
    v_s=2e-3 / LEAD,
    position_start=0.025 * math.cos(-0.25 * math.pi),
)


def circle(k: int) -> float:
    """X at sample k of the circle in ``make_references.py``."""
    feed, t = 1.0 / 60.0, k * 2.5e-4
    ramp = feed / 0.2
    path = 0.1 * t**2 if t < ramp else 0.1 * ramp**2 + feed * (t - ramp)
    return 0.025 * math.cos(path / 0.025 - 0.25 * math.pi)


@pytest.mark.parametrize(("name", "g"), [("plain", 0.0), ("observer", 50.0)])
def test_axis_starts_a_circle_as_the_reference(name: str, g: float):
    expected = reference("feed_drive")[f"{name}_start"][:120]
    control = Sampled(CascadePid())
    observer = Sampled(
        DisturbanceObserver(
            force_timing=ForceTiming.present, g=g, m_hat=380.0, b_hat=400.0, T_s=2.5e-4, velocity_filter_time=5e-4
        )
    )
    x, found = AXIS_X.initial(), np.zeros((len(expected), 5))
    for k in range(len(expected)):
        y = AXIS_X.output(k * 2.5e-4, x, AXIS_X.Input())
        estimate = observer.output(position=y.position).disturbance_estimate
        sample = control(
            position_ref=circle(k),
            position_next=circle(k + 1),
            position=y.position,
            motor_position=y.position,
            disturbance_estimate=estimate,
        )
        observer.update(applied_force=sample.force)
        found[k] = y.position, y.velocity, sample.force, 0.0, -estimate
        x = rk4(AXIS_X, k * 2.5e-4, x, AXIS_X.Input(command=sample.command), step=2.5e-4, parts=8)
    # RK4 at 31 us where the reference has 1 us, over the break-away: measured 1e-12 m, 5e-6 N.
    assert np.max(np.abs(found[:, 0] - expected[:, 0])) < 1e-11
    assert np.max(np.abs(found[:, 2] - expected[:, 2])) < 1e-4
    assert np.max(np.abs(found[:, 4] - expected[:, 4])) < 1e-4
    assert np.max(np.abs(expected[:, 2])) > 100.0


def test_reversal_with_pulse_follows_the_reference():
    """The command of 600 samples from the measured positions of the reference: the law, without the plant."""
    expected = reference("feed_drive")["pulse_reversal"]
    first = 4879 - 99
    pulse = Sampled(FrictionPulse(mode=Mode.fixed, A=0.6e-3, T=0.0765, t_r=2e-3))
    for k in range(first):
        pulse(position_ref=circle(k), position_next=circle(k + 1))
    found = [
        pulse(position_ref=circle(first + k), position_next=circle(first + k + 1)).velocity_pulse
        for k in range(len(expected))
    ]
    # The reference of another libm may reverse a rounding apart; the pulse itself is exact.
    assert np.max(np.abs(np.array(found) - expected[:, 3])) < 1e-15
    assert np.max(np.abs(expected[:, 3])) == pytest.approx(0.6e-3)


def following_error(controller: CascadePid) -> float:
    """Largest error on a frictionless axis for 2 mm out and back, from rest."""
    control = Sampled(controller)
    x = v = worst = 0.0
    for k in range(629):
        now, following = (1e-3 * (1.0 - math.cos(0.01 * n)) for n in (k, k + 1))
        y = control(position_ref=now, position_next=following, position=x, velocity=v)
        worst = max(worst, abs(y.error))
        acceleration = y.force / 380.0
        x += v * 2.5e-4 + 0.5 * acceleration * 2.5e-4**2
        v += acceleration * 2.5e-4
    return worst


def test_feed_forward_removes_the_following_error():
    measured = VelocitySource.input
    with_both = following_error(CascadePid(velocity_source=measured))
    without = following_error(CascadePid(velocity_source=measured, k_vff=0.0, k_aff=0.0))
    # 1.6 m/s2: half a sample of acceleration through the loops is left, 0.2 mm/s at 40 1/s.
    assert with_both < 1.6 * 0.5 * 2.5e-4 / 40.0
    assert without > 0.04 / 40.0 * 0.5


def test_differences_equal_the_inputs_they_stand_for():
    T_s, a = 2.5e-4, 0.3
    ahead = Sampled(CascadePid(velocity_source=VelocitySource.input))
    given_ = Sampled(CascadePid(velocity_source=VelocitySource.input, feedforward_source=FeedForward.input))
    ahead(position_ref=0.0, position_next=0.5 * a * T_s**2)
    given_()
    r, following = 0.5 * a * T_s**2, 2.0 * a * T_s**2
    one = ahead(position_ref=r, position_next=following)
    # The mean velocity of the coming sample; the state before has seen half a step of velocity.
    other = given_(position_ref=r, velocity_ref=1.5 * a * T_s, acceleration_ref=a)
    seen = 380.0 * 250.0 / 0.02 * 0.5 * a * T_s * T_s
    assert one.force == pytest.approx(other.force + seen, rel=1e-9)


def test_start_at_speed_is_steady():
    controller = Sampled(CascadePid(integral_start=98.0))
    for k in range(200):
        position = 0.02 * 2.5e-4 * k
        y = controller(
            position_ref=position,
            position_next=0.02 * 2.5e-4 * (k + 1),
            position=position,
            motor_position=position,
            velocity=0.02,
        )
        assert y.force == pytest.approx(98.0, rel=1e-9)


def test_integrator_is_held_at_the_limit_and_leaves_it_at_once():
    controller = Sampled(CascadePid())
    for _ in range(100):
        assert controller(position_ref=1.0, position_next=1.0).command == CascadePid().command_max
    assert controller.x.integral == 0.0
    assert controller(position_ref=1.0, position_next=1.0).force == pytest.approx(4000.0)
    controller(position_ref=-1e-9, position_next=-1e-9)
    assert controller.x.integral < 0.0


def test_pulse_and_estimate_enter_with_their_signs():
    controller = CascadePid()
    force = controller.output(0.0, controller.initial(), controller.Input(velocity_pulse=1e-3)).force
    assert force == pytest.approx(380.0 * 250.0 * 1e-3)
    assert controller.output(0.0, controller.initial(), controller.Input(disturbance_estimate=-7.0)).force > 0.0


@given(values=st.lists(st.floats(-10.0, 10.0), min_size=9, max_size=9), limit=st.floats(1e-3, 1e3))
def test_command_is_finite_within_its_limit_and_odd(values: list[float], limit: float):
    for source in FeedForward:
        controller = CascadePid(command_max=limit, feedforward_source=source)
        assert_limited_and_odd(controller, values, limit, integral=values[0])


def test_zero_in_zero_out():
    controller = CascadePid()
    assert set(controller.output(0.0, controller.initial(), controller.Input())) == {0.0}
