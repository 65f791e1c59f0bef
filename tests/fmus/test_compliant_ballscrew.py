"""Compliant ballscrew: derivatives of an independent model, equilibria, backlash, frictions, options."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from motion_loops import rk4
from nctf_reference import module, reference

from cosim.errors import DescriptionError
from fmus.plant.compliant_ballscrew import CompliantBallscrew

State = CompliantBallscrew.State
Input = CompliantBallscrew.Input
GUIDE = {"guide_friction": True, "guide_F_C": 12.0, "guide_F_S": 18.0, "guide_sigma_1": 2e3, "guide_sigma_2": 150.0}


def state_of(row: Any, l_p: float) -> State:
    """A state of the independent model: angle, speed, position, velocity, bristles."""
    angle, speed, position, velocity, bristle, guide = (float(value) for value in row)
    return State(
        position=position,
        velocity=velocity,
        deflection=l_p * angle - position,
        speed=speed,
        bristle=bristle,
        guide_bristle=guide,
    )


def test_derivatives_are_those_of_the_independent_model():
    independent = module("independent")
    rates = getattr(independent.ballscrew_rates, "py_func", independent.ballscrew_rates)
    generator = np.random.default_rng(3)
    parameters = independent.plant_vector(**independent.GUIDE, T_S=0.06)
    plant = CompliantBallscrew(**GUIDE, F_S=0.06)
    scale = np.array([1e-3, 10.0, 3e-7, 3e-3, 3e-3, 1e-6])
    for _ in range(200):
        row = scale * generator.normal(size=6) * 10.0 ** generator.uniform(-2, 1, 6)
        current, force, torque = generator.uniform(-8.0, 8.0), generator.normal(), 0.01 * generator.normal()
        expected = np.empty(6)
        rates(row, current, force, torque, parameters, expected)
        x = state_of(row, plant.l_p)
        rate = plant.derivative(0.0, x, Input(command=current, load_force=force, load_torque=torque))
        # The deflection is a difference: 1e-16 of the position in 1e-7 m of deflection.
        assert rate.speed == pytest.approx(expected[1], rel=1e-8)
        assert rate.velocity == pytest.approx(expected[3], rel=1e-7, abs=1e-7)
        assert rate.position == expected[2]
        assert rate.bristle == pytest.approx(expected[4], rel=1e-12)
        assert rate.guide_bristle == pytest.approx(expected[5], rel=1e-12)
        assert rate.deflection == pytest.approx(plant.l_p * x.speed - x.velocity, rel=1e-15)


def test_pulse_follows_the_reference_while_it_accelerates():
    data, plant = reference("open_loop_pulse"), CompliantBallscrew()
    x = plant.initial()
    for k in range(100):
        x = rk4(plant, 0.0, x, Input(command=float(data["current"][k])), step=2e-4, parts=10)
    y = plant.output(0.0, x, Input())
    row = data["states"][100]
    # Runge-Kutta at 20 us: 4e-13 m (measured by halving the step) of 1.5 mm.
    assert y.position == pytest.approx(row[2], abs=1e-11)
    assert y.velocity == pytest.approx(row[3], abs=1e-10)
    assert y.angle == pytest.approx(row[0], abs=1e-8)
    assert y.motor_velocity == pytest.approx(plant.l_p * row[1], rel=1e-9)


@given(speed=st.floats(0.01, 400.0), direction=st.sampled_from([-1.0, 1.0]))
def test_steady_sliding_needs_the_torque_of_its_friction(speed: float, direction: float):
    plant = CompliantBallscrew(velocity_start=direction * speed * CompliantBallscrew.l_p)
    torque = direction * (plant.F_C + plant.sigma_2 * speed)
    rate = plant.derivative(0.0, plant.initial(), Input(command=torque / plant.K_m))
    assert rate.speed == pytest.approx(0.0, abs=1e-9)
    assert rate.velocity == pytest.approx(0.0, abs=1e-9)
    assert rate.bristle == pytest.approx(0.0, abs=1e-12)


def test_factors_for_negative_velocity_and_scale_act_on_the_steady_friction():
    factors = {"F_C_negative": 1.5, "F_S_negative": 2.0, "sigma_2_negative": 3.0, "friction_scale": 0.8}
    for v, level, viscous in ((0.01, 1.0, 1.0), (-0.01, 1.5, 3.0)):
        plant = CompliantBallscrew(velocity_start=v, **factors)
        speed = v / plant.l_p
        expected = math.copysign(0.8 * level * 0.046, v) + viscous * plant.sigma_2 * speed
        assert plant.output(0.0, plant.initial(), Input()).friction_torque == pytest.approx(expected, rel=1e-12)


def test_static_friction_has_its_own_factor_at_the_limit_of_standstill():
    plant = CompliantBallscrew(F_S=0.06, F_C_negative=1.5, F_S_negative=2.0, friction_scale=0.8)
    assert plant.screw_level(0.0, 1e-9) == pytest.approx(0.8 * 0.06)
    assert plant.screw_level(0.0, -1e-9) == pytest.approx(0.8 * 2.0 * 0.06)
    assert plant.screw_level(0.0, -1e3) == pytest.approx(0.8 * 1.5 * 0.046)
    guide = CompliantBallscrew(**GUIDE, F_C_negative=1.5, F_S_negative=2.0, friction_scale=0.8)
    assert guide.guide_level(0.0, -1e-12) == pytest.approx(0.8 * 2.0 * 18.0)
    assert guide.guide_level(0.0, -1.0) == pytest.approx(0.8 * 1.5 * 12.0)


def test_drift_moves_the_level_by_its_amplitude():
    plant = CompliantBallscrew(drift_amplitude=0.2, drift_frequency=0.5)
    assert plant.screw_level(0.5, 100.0) == pytest.approx(1.2 * 0.046)
    assert plant.screw_level(1.5, 100.0) == pytest.approx(0.8 * 0.046)


def test_motor_friction_saturates_at_its_level():
    plant = CompliantBallscrew(motor_friction=True, T_cm=0.03, F_C=0.0, F_S=0.0, sigma_2=0.0)
    for speed, expected in ((0.1, 0.03 * math.tanh(1.0)), (50.0, 0.03), (-50.0, -0.03)):
        y = plant.output(0.0, State(speed=speed), Input())
        assert y.friction_torque == pytest.approx(expected, rel=1e-12)


def test_feed_drive_of_two_masses_is_a_choice_of_parameters():
    """Linear coordinates, force on the motor's mass: Feng et al. 2015, X axis as it stands in the specification."""
    r, M_1, M_2, k, c, F_cm, B_1 = 0.01 / (2.0 * math.pi), 320.0, 60.0, 8e7, 8e3, 30.0, 50.0
    plant = CompliantBallscrew(
        K_m=r,
        command_max=0.0,
        J=M_1 * r**2,
        m=M_2,
        l_p=r,
        K_n=k,
        C_n=c,
        F_C=0.0,
        F_S=0.0,
        sigma_2=B_1 * r**2,
        motor_friction=True,
        T_cm=F_cm * r,
        omega_cm=0.2e-3 / r,
        guide_friction=True,
        guide_F_C=90.0,
        guide_F_S=115.0,
        guide_v_s=2e-3,
        guide_sigma_0=1.8e7,
        guide_sigma_1=2.5e4,
        guide_sigma_2=400.0,
    )
    u, d, v_1, v_2, z = 250.0, 1.5e-6, 0.3e-3, -1.1e-3, -2e-6
    x = State(deflection=d, velocity=v_2, speed=v_1 / r, guide_bristle=z)
    rate = plant.derivative(0.0, x, Input(command=u))
    coupling = k * d + c * (v_1 - v_2)
    z_rate = v_2 - 1.8e7 * abs(v_2) * z / (90.0 + 25.0 * math.exp(-((v_2 / 2e-3) ** 2)))
    friction = 1.8e7 * z + 2.5e4 * z_rate + 400.0 * v_2
    motor = u - coupling - F_cm * math.tanh(v_1 / 0.2e-3) - B_1 * v_1
    assert r * rate.speed == pytest.approx(motor / M_1, rel=1e-12)
    assert rate.velocity == pytest.approx((coupling - friction) / M_2, rel=1e-12)
    assert rate.guide_bristle == pytest.approx(z_rate, rel=1e-12)


def test_without_friction_only_the_motor_changes_the_momentum():
    plant = CompliantBallscrew(F_C=0.0, F_S=0.0, sigma_2=0.0, backlash=True)
    x = State(velocity=0.01, deflection=2e-5, speed=40.0)
    rate = plant.derivative(0.0, x, Input(command=1.0))
    total = plant.J * rate.speed / plant.l_p + plant.m * rate.velocity
    assert plant.output(0.0, x, Input()).nut_force != 0.0
    assert total == pytest.approx(plant.K_m / plant.l_p, rel=1e-12)


@given(
    deflection=st.floats(-3e-5, 3e-5),
    rate=st.floats(-0.1, 0.1),
    gap_plus=st.floats(0.0, 1e-5),
    gap_minus=st.floats(0.0, 1e-5),
)
def test_backlash_pushes_outside_its_gap_and_never_pulls(
    deflection: float, rate: float, gap_plus: float, gap_minus: float
):
    plant = CompliantBallscrew(backlash=True, gap_plus=gap_plus, gap_minus=gap_minus)
    force = plant.output(0.0, State(deflection=deflection, speed=rate / plant.l_p), Input()).nut_force
    if deflection > gap_plus:
        expected = max(0.0, 8.3e5 * (deflection - gap_plus) + 1700.0 * rate)
    elif deflection < -gap_minus:
        expected = min(0.0, 8.3e5 * (deflection + gap_minus) + 1700.0 * rate)
    else:
        expected = 0.0
    assert force == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_measured_positions_are_rounded_and_current_is_limited():
    plant = CompliantBallscrew(position_resolution=1e-7, motor_resolution=1e-8)
    y = plant.output(0.0, State(position=1.26e-6, deflection=3.4e-8), Input(command=-9.0))
    assert y.position == pytest.approx(1.3e-6, rel=1e-12)
    assert y.motor_position == pytest.approx(1.29e-6, rel=1e-12)
    assert y.current == -6.0
    assert CompliantBallscrew(command_max=0.0).output(0.0, State(), Input(command=-9.0)).current == -9.0


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"F_C": 0.0}, "F_C = 0 with F_S > 0"),
        ({"guide_friction": True, "guide_F_S": 20.0}, "guide_F_C = 0 with guide_F_S > 0"),
        ({"F_S_negative": 0.0}, r"F_S\*F_S_negative = 0 with F_C\*F_C_negative > 0"),
        ({"guide_F_S": 20.0}, "guide_friction is false"),
        ({"T_cm": 0.1}, "motor_friction is false"),
        ({"drift_amplitude": 0.1}, "drift_frequency"),
        ({"m": 0.0}, "m = 0 kg"),
    ],
)
def test_contradicting_parameters_are_refused(values: dict[str, float], text: str):
    with pytest.raises(DescriptionError, match=text):
        CompliantBallscrew(**values)  # type: ignore[arg-type]


@given(st.floats(-3.0, 3.0), st.floats(-0.02, 0.02))
def test_damping_of_both_contacts_falls_with_their_velocity(speed: float, velocity: float):
    falling = CompliantBallscrew(**GUIDE, v_d=0.7, guide_v_d=5e-3)
    same = CompliantBallscrew(
        **{**GUIDE, "guide_sigma_1": 2e3 * math.exp(-((velocity / 5e-3) ** 2))},
        sigma_1=0.072 * math.exp(-((speed / 0.7) ** 2)),
    )
    x = State(speed=speed, velocity=velocity, bristle=1e-3, guide_bristle=4e-7)
    found, expected = falling.derivative(0.0, x, Input(command=0.1)), same.derivative(0.0, x, Input(command=0.1))
    assert list(found) == pytest.approx(list(expected), rel=1e-9, abs=1e-9)
