"""Disturbance observer: closed form, both papers' sign conventions, the loop of the linear motor."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from motion_loops import Sampled, assert_follows, motor_loop

from fmus.controllers.disturbance_observer import DisturbanceObserver, ForceTiming
from fmus.controllers.p_pi import PPi
from fmus.physics.sampling import VelocitySource


def test_estimate_of_a_constant_force_rises_as_the_filter_does():
    # Exact mass and damping 0, held acceleration: the estimate is d*(1 - exp(-g*t)) but for the ramp within a sample.
    g, m, d, T_s = 100.0, 11.0, 2.0, 1e-5
    observer = Sampled(DisturbanceObserver(g=g, b_hat=0.0, T_s=T_s, velocity_source=VelocitySource.input))
    for k in range(3001):
        estimate = observer(velocity=(5.0 + d) / m * k * T_s, applied_force=5.0).disturbance_estimate
        assert estimate == pytest.approx(d * (1.0 - math.exp(-g * k * T_s)), abs=(5.0 + d) * g * T_s)
    assert estimate == pytest.approx(d, rel=0.06)


def test_friction_at_positive_velocity_is_estimated_negative():
    observer = Sampled(DisturbanceObserver(velocity_source=VelocitySource.input))
    for _ in range(2000):
        # Steady motion at 10 mm/s: the motor overcomes damping 2.55 N and 4 N of friction.
        estimate = observer(velocity=0.01, applied_force=6.55).disturbance_estimate
    assert estimate == pytest.approx(-4.0, rel=1e-6)


MEASURED = {"velocity_source": VelocitySource.input}
DRIVE = {"m_hat": 380.0, "b_hat": 400.0, "g": 50.0, "T_s": 2.5e-4, **MEASURED}


def motion(k: int) -> tuple[float, float]:
    """Some velocity and force."""
    return 0.02 * math.sin(0.05 * k), 120.0 * math.sin(0.05 * k + 0.3)


def test_load_observer_of_feed_drives_is_the_same_with_the_opposite_sign():
    observer = Sampled(DisturbanceObserver(force_timing=ForceTiming.present, **DRIVE))
    E, y = math.exp(-50.0 * 2.5e-4), None
    for k in range(400):
        velocity, force = motion(k)
        y = 50.0 * 380.0 * velocity if y is None else y
        load = y - 50.0 * 380.0 * velocity
        assert observer(velocity=velocity, applied_force=force).disturbance_estimate == pytest.approx(-load, abs=1e-9)
        y = E * y + (1.0 - E) * (force - 400.0 * velocity + 50.0 * 380.0 * velocity)


def test_force_of_the_sample_before_costs_only_its_last_change():
    present = Sampled(DisturbanceObserver(force_timing=ForceTiming.present, **DRIVE))
    before = Sampled(DisturbanceObserver(**DRIVE))
    E = math.exp(-50.0 * 2.5e-4)
    for k in range(400):
        velocity, force = motion(k)
        one = present(velocity=velocity, applied_force=force).disturbance_estimate
        other = before(velocity=velocity, applied_force=motion(k - 1)[1]).disturbance_estimate
        if k > 1:
            change = motion(k - 1)[1] - motion(k - 2)[1]
            assert other - one == pytest.approx((1.0 - E) * change, abs=1e-9)


def test_loop_with_observer_follows_the_reference():
    found = motor_loop(PPi(), 1001, disturbed=True, observer=DisturbanceObserver(force_timing=ForceTiming.present))
    assert_follows(found, "p_pi_observer_start", 1e-6)


@given(start=st.floats(-1.0, 1.0), force=st.floats(-1e3, 1e3))
def test_first_estimate_is_zero_whatever_the_velocity(start: float, force: float):
    observer = DisturbanceObserver(velocity_source=VelocitySource.input)
    u = observer.Input(velocity=start, applied_force=force)
    assert observer.output(0.0, observer.initial(), u).disturbance_estimate == 0.0


@given(force=st.floats(-1e6, 1e6))
def test_applied_force_does_not_feed_through(force: float):
    observer = DisturbanceObserver()
    x = observer.State(y=3.0, started=1.0, velocity_last=1e-3, position_last=2e-6)
    one = observer.output(0.0, x, observer.Input(position=3e-6, applied_force=force))
    other = observer.output(0.0, x, observer.Input(position=3e-6))
    assert one == other
