"""Plants with a drive of their own: without options the plants they are made of, each option in closed form."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from motion_loops import rk4

from cosim.model import Plant
from fmus.plant.compliant_ballscrew import CompliantBallscrew
from fmus.plant.compliant_ballscrew_axis import CompliantBallscrewAxis
from fmus.plant.linear_motor import LinearMotor
from fmus.plant.linear_motor_axis import LinearMotorAxis

positions = st.floats(-0.1, 0.1)
speeds = st.floats(-60.0, 60.0)
commands = st.floats(-20.0, 20.0)


def same(kind: type[Plant], base: type[Plant], state: dict[str, float], inputs: dict[str, float], **start: Any) -> None:
    """Derivatives and outputs of ``kind`` with its options off are those of ``base``, to the last bit."""
    one, other = kind(**start), base(**start)
    made = (one, kind.State, kind.Input), (other, base.State, base.Input)
    found: list[list[dict[str, float]]] = []
    for plant, record, given_inputs in made:
        x, u = record(**state), given_inputs(**inputs)
        found.append([vars(plant.derivative(0.3, x, u)), vars(plant.output(0.3, x, u))])
    for axis, plain in zip(*found, strict=True):
        assert {name: value for name, value in axis.items() if name in plain} == plain


@given(positions, speeds, commands, st.booleans())
def test_without_options_the_compliant_axis_is_the_compliant_ballscrew(
    position: float, speed: float, command: float, backlash: bool
):
    state = {"position": position, "velocity": 3e-4 * speed, "deflection": 1e-5, "speed": speed, "bristle": 1e-3}
    inputs = {"command": command, "load_force": 3.0, "load_torque": -0.01}
    same(CompliantBallscrewAxis, CompliantBallscrew, state, inputs, backlash=backlash, sigma_1=0.05)


@given(positions, speeds, commands)
def test_without_options_the_linear_axis_is_the_linear_motor(position: float, speed: float, command: float):
    state = {"position": position, "velocity": 1e-3 * speed}
    inputs = {"command": command, "disturbance_force": 0.2}
    same(LinearMotorAxis, LinearMotor, state, inputs, feed_per_tooth=1e-6, force_max=30.0)


@pytest.mark.parametrize(
    ("plant", "command", "target"),
    [(CompliantBallscrewAxis(drive_lag=3.3e-4), 0.02, 0.02), (LinearMotorAxis(drive_lag=3.3e-4), 1.5, 3.0)],
    ids=["ballscrew", "motor"],
)
def test_current_follows_as_a_first_order_lag(plant: Any, command: float, target: float):
    u, x = plant.Input(command=command), plant.initial()
    for k in range(500):
        x = rk4(plant, k * 2e-6, x, u, step=2e-6)
    expected = target * (1.0 - math.exp(-1e-3 / 3.3e-4))
    assert plant.output(1e-3, x, u).current == pytest.approx(expected, rel=1e-9)


@given(commands)
def test_the_limit_of_the_command_is_before_the_lag(command: float):
    plant = CompliantBallscrewAxis(drive_lag=1e-3, command_max=4.0)
    rate = plant.derivative(0.0, plant.State(drive=1.0), plant.Input(command=command)).drive
    assert rate == pytest.approx((max(-4.0, min(4.0, command)) - 1.0) / 1e-3, rel=1e-12)


@given(speeds, st.floats(-5.0, 5.0))
def test_voltage_of_the_drive_is_limited(speed: float, command: float):
    plant = CompliantBallscrewAxis(voltage_max=8.0, R=1.3)
    current = plant.output(0.0, plant.State(speed=speed), plant.Input(command=command)).current
    wanted = 1.3 * command + plant.K_m * speed
    if abs(wanted) <= 8.0:
        assert current == command
    else:
        assert 1.3 * current + plant.K_m * speed == pytest.approx(math.copysign(8.0, wanted), rel=1e-12)


@given(st.floats(-20.0, 20.0), commands)
def test_torque_ripple_is_a_torque_over_the_angle(angle: float, command: float):
    plant = CompliantBallscrewAxis(torque_ripple=(0.05, 0.02), torque_order=(6.0, 12.0), torque_phase=(0.2, 0.4))
    ripple = 0.05 * math.sin(6.0 * angle + 0.2) + 0.02 * math.sin(12.0 * angle + 0.4)
    x = plant.State(position=0.7 * angle * plant.l_p, deflection=0.3 * angle * plant.l_p)
    plain = CompliantBallscrewAxis().derivative(0.0, x, plant.Input(command=command, load_torque=-ripple)).speed
    found = plant.derivative(0.0, x, plant.Input(command=command)).speed
    # The angle of 20 rad comes from sums that are right to 1e-15: 1e-13 of a ripple over J = 1.8e-4 kg.m2.
    assert found == pytest.approx(plain, rel=1e-9, abs=1e-9)


@given(positions, commands)
def test_cogging_is_a_force_over_the_position(position: float, command: float):
    plant = LinearMotorAxis(magnet_pitch=0.02, force_ripple=(3.0, 1.0), force_phase=(0.3, -0.5))
    turn = 2.0 * math.pi * position / 0.02
    ripple = 3.0 * math.sin(turn + 0.3) + math.sin(2.0 * turn - 0.5)
    y = plant.output(0.0, plant.State(position=position), plant.Input(command=command))
    assert y.motor_force == pytest.approx(plant.K_a * y.current + ripple, rel=1e-12, abs=1e-12)
    moved = plant.derivative(0.0, plant.State(position=position), plant.Input(command=command)).velocity
    assert moved == pytest.approx(y.motor_force / plant.m, rel=1e-12, abs=1e-15)
