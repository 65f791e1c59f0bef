"""Ballscrew axis: with all options off the ballscrew stage, and each option against a closed form."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from motion_loops import rk4

from cosim.errors import DescriptionError
from fmus.plant.ballscrew_axis import BallscrewAxis
from fmus.plant.ballscrew_stage import BallscrewStage

AXIS, STAGE = BallscrewAxis(), BallscrewStage()
State, Input = BallscrewAxis.State, BallscrewAxis.Input
L_P = STAGE.l_p

angles = st.floats(-100.0, 100.0)
speeds = st.floats(-60.0, 60.0)
bristles = st.floats(-9.36e-5, 9.36e-5)
torques = st.floats(-100.0, 100.0)


@given(angles, speeds, bristles, torques, torques)
def test_with_all_options_off_it_is_the_ballscrew_stage(
    angle: float, speed: float, bristle: float, u: float, load: float
):
    x, y = State(angle=angle, speed=speed, bristle=bristle), STAGE.State(angle=angle, speed=speed, bristle=bristle)
    inputs = Input(command=u, load_torque=load)
    found = AXIS.derivative(0.3, x, inputs)
    expected = STAGE.derivative(0.3, y, inputs)
    assert (found.angle, found.speed, found.bristle) == (expected.angle, expected.speed, expected.bristle)
    assert list(AXIS.output(0.3, x, inputs))[:5] == list(STAGE.output(0.3, y, inputs))
    assert AXIS.output(0.3, x, inputs).drive_torque == u


def test_current_loop_is_a_first_order_lag():
    axis, u = BallscrewAxis(drive_lag=3.3e-4), Input(command=5.0)
    # Far below break-away; friction does not act on the drive.
    x = axis.initial()
    for k in range(500):
        x = rk4(axis, k * 2e-6, x, u, step=2e-6)
    expected = 5.0 * (1.0 - math.exp(-1e-3 / 3.3e-4))
    assert axis.output(1e-3, x, u).drive_torque == pytest.approx(expected, rel=1e-9)


@given(speeds, torques)
def test_voltage_of_the_drive_is_limited(speed: float, command: float):
    axis = BallscrewAxis(voltage_max=20.0, R=0.8, K_m=0.4)
    torque = axis.output(0.0, State(speed=speed), Input(command=command)).drive_torque
    voltage = 0.8 * torque / 0.4 + 0.4 * speed
    assert abs(voltage) <= 20.0 * (1.0 + 1e-12)
    wanted = 0.8 * command / 0.4 + 0.4 * speed
    if abs(wanted) <= 20.0:
        assert torque == command
    else:
        assert voltage == pytest.approx(math.copysign(20.0, wanted), rel=1e-12)


@given(angles, speeds, st.floats(-3.0, 3.0))
def test_friction_level_follows_the_angle(angle: float, speed: float, phase: float):
    """With the bristle at its steady value the friction torque has the ripple of the level and nothing else."""
    axis = BallscrewAxis(friction_ripple=(0.2, 0.1), friction_phase=(phase, 0.0), sigma_2=0.0)
    factor = 1.0 + 0.2 * math.sin(angle + phase) + 0.1 * math.sin(2.0 * angle)
    level = factor * axis.level(0.0, speed)
    x = State(angle=angle, speed=speed, bristle=math.copysign(level / axis.sigma_0, speed) if speed else 0.0)
    y = axis.output(0.0, x, Input())
    assert y.friction_torque == pytest.approx(math.copysign(level, speed) if speed else 0.0, rel=1e-9, abs=1e-7)


@given(angles, torques)
def test_torque_ripple_is_added_to_the_drive(angle: float, command: float):
    axis = BallscrewAxis(torque_ripple=(0.5, 0.25), torque_order=(6.0, 12.0), torque_phase=(0.2, 0.4))
    ripple = 0.5 * math.sin(6.0 * angle + 0.2) + 0.25 * math.sin(12.0 * angle + 0.4)
    x = State(angle=angle)
    expected = AXIS.derivative(0.0, x, Input(command=command + ripple)).speed
    assert axis.derivative(0.0, x, Input(command=command)).speed == pytest.approx(expected, rel=1e-9, abs=1e-6)


@given(angles, speeds)
def test_lead_error_shows_in_position_and_velocity(angle: float, speed: float):
    axis = BallscrewAxis(lead_error=20e-6, lead_ripple=3e-6, lead_phase=0.5)

    def place(angle: float) -> float:
        return L_P * (1.0 + 20e-6) * angle + 3e-6 * math.sin(angle + 0.5)

    y = axis.output(0.0, State(angle=angle, speed=speed), Input())
    assert y.position == pytest.approx(place(angle), rel=1e-12, abs=1e-18)
    slope = (place(angle + 1e-4) - place(angle - 1e-4)) / 2e-4
    # Differences of 1e-4 rad: 1.6e-7 m of 0.16 m is right to 1e-16/1e-7.
    assert y.velocity == pytest.approx(slope * speed, rel=1e-7, abs=1e-12)


@given(st.floats(-1e-3, 1e-3))
def test_interpolation_error_repeats_with_the_signal_period(position: float):
    axis = BallscrewAxis(encoder_error=(50e-9, 20e-9), encoder_period=20e-6)

    def error(at: float) -> float:
        return axis.output(0.0, State(angle=at / L_P), Input()).position - L_P * (at / L_P)

    assert error(position + 20e-6) == pytest.approx(error(position), abs=1e-15)
    expected = 50e-9 * math.sin(2e6 * math.pi / 20.0 * position) + 20e-9 * math.sin(4e6 * math.pi / 20.0 * position)
    assert error(position) == pytest.approx(expected, abs=1e-15)


def test_play_acts_behind_the_errors_of_the_lead():
    axis = BallscrewAxis(lead_ripple=3e-6, play_positive=5e-6, play_negative=5e-6)
    x: Any = axis.initial()
    for angle in (0.1, -0.1):
        x = axis.update(0.0, replace(x, angle=angle, speed=angle), Input())
        assert x.table == pytest.approx(L_P * angle + 3e-6 * math.sin(angle) - math.copysign(5e-6, angle), rel=1e-12)


def test_measured_axes_whose_friction_rises_with_speed_start_and_slide():
    """F_S/F_C of 0.65: the level rises from F_S to F_C, and a constant torque reaches its speed."""
    axis = BallscrewAxis(F_C=6.0, F_S=3.9, v_s=0.5, v_d=0.05)
    assert axis.level(0.0, 0.0) == pytest.approx(3.9)
    assert axis.level(0.0, 5.0) == pytest.approx(6.0)
    levels = [axis.level(0.0, v) for v in np.linspace(0.0, 3.0, 100).tolist()]
    assert np.all(np.diff(levels) >= 0.0)
    slow = axis.lugre(State(speed=0.1, bristle=axis.level(0.0, 0.1) / axis.sigma_0), axis.level(0.0, 0.1))
    assert slow[1] == pytest.approx(axis.level(0.0, 0.1) + 0.04, rel=1e-12)


@pytest.mark.parametrize(
    ("start", "message"),
    [
        ({"F_C": 0.0}, "F_C = 0 with F_S > 0"),
        ({"friction_ripple": (0.6, 0.4)}, "friction level falls to 0"),
        ({"lead_ripple": 2e-3}, "run backwards"),
        ({"drift_amplitude": 0.1}, "drift_amplitude needs"),
    ],
)
def test_contradicting_parameters_are_refused(start: dict[str, Any], message: str):
    with pytest.raises(DescriptionError, match=message):
        BallscrewAxis(**start)
