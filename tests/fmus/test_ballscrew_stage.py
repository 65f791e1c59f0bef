"""Ballscrew stage: published numbers, reference traces, symmetry, energy, every option."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from motion_loops import rk4
from scipy.integrate import solve_ivp
from stage_loops import traces

from cosim.errors import DescriptionError
from cosim.model import unflatten
from fmus.plant.ballscrew_stage import BallscrewStage

STAGE = BallscrewStage()
State, Input = BallscrewStage.State, BallscrewStage.Input
L_P, J, SIGMA_0 = 1.5923e-3, 3.702102e-4, 1e5

angles = st.floats(-100.0, 100.0)
speeds = st.floats(-60.0, 60.0)
bristles = st.floats(-9.36e-5, 9.36e-5)
torques = st.floats(-100.0, 100.0)


def rates(stage: BallscrewStage, t: float, x: Any, **inputs: float) -> list[float]:
    """Rates of angle, speed and bristle."""
    state = State(angle=float(x[0]), speed=float(x[1]), bristle=float(x[2]))
    found = stage.derivative(t, state, Input(**inputs))
    return [found.angle, found.speed, found.bristle]


def test_inertia_is_the_published_one():
    assert 1.0 / rates(STAGE, 0.0, [0.0, 0.0, 0.0], command=1.0)[1] == pytest.approx(J, rel=1e-6)


def test_eigenvalues_at_rest_are_the_published_ones():
    h = 1e-9
    jacobian = np.array(
        [
            (np.array(rates(STAGE, 0.0, h * unit)) - np.array(rates(STAGE, 0.0, -h * unit))) / (2.0 * h)
            for unit in np.eye(3)
        ]
    ).T
    found = np.sort(np.linalg.eigvals(jacobian).real)
    assert found == pytest.approx([-854949.0, -315.9, 0.0], rel=1e-3, abs=1e-6)


@pytest.mark.parametrize(
    ("speed", "published"), [(1e-4, 9.329), (1e-3, 7.38818), (1e-2, 6.244), (1.0, 6.64), (5.0, 8.24)]
)
def test_start_in_steady_sliding_has_the_published_friction(speed: float, published: float):
    for v in (speed, -speed):
        stage = BallscrewStage(velocity_start=v * L_P, position_start=1e-3)
        x = stage.initial()
        assert x.angle == pytest.approx(1e-3 / L_P)
        y = stage.output(0.0, x, Input())
        assert y.friction_torque == pytest.approx(math.copysign(published, v), rel=6e-5)
        assert abs(stage.derivative(0.0, x, Input()).bristle) <= 1e-12 * speed
        assert (y.position, y.velocity) == pytest.approx((1e-3, v * L_P), rel=1e-12)


def test_start_with_undeflected_bristle():
    x = BallscrewStage(velocity_start=1e-3, bristle_start=0.0).initial()
    assert x.bristle == 0.0
    assert x.speed == pytest.approx(1e-3 / L_P)


def test_constant_torque_reaches_the_published_speed():
    solution = solve_ivp(
        lambda t, x: rates(STAGE, t, [0.0, *x], command=12.0)[1:],
        (0.0, 0.02),
        [0.0, 0.0],
        "Radau",
        rtol=1e-7,
        atol=[1e-9, 1e-12],
    )
    # 20 ms are 21 time constants J/sigma_2.
    assert solution.y[0, -1] == pytest.approx((12.0 - 6.24) / 0.4, rel=1e-6)


def test_open_loop_follows_the_reference():
    """8*sin(4 pi t) + 6*sin(1.4 pi t) N.m, up to and through two reversals, against Radau at 1e-10."""
    reference = traces("open_loop")
    last = 100
    times = reference["time"][: last + 1]

    def moving(t: float, x: Any) -> list[float]:
        command = 8.0 * math.sin(4.0 * math.pi * t) + 6.0 * math.sin(1.4 * math.pi * t)
        return rates(STAGE, t, [0.0, *x], command=command)[1:]

    solution = solve_ivp(moving, (0.0, times[-1]), [0.0, 0.0], "Radau", t_eval=times, rtol=1e-8, atol=[1e-10, 1e-14])
    expected = reference["continuous"][: last + 1]
    assert np.sum(np.diff(np.sign(expected[1:, 1])) != 0) >= 1
    # Radau at 1e-8 errs by 4e-9 rad of 3 rad in this run; speed at break-away is steeper.
    assert solution.y[0] == pytest.approx(expected[:, 1], abs=2e-5)
    assert solution.y[1] == pytest.approx(expected[:, 2], abs=2e-10)
    friction = [STAGE.output(0.0, State(speed=v, bristle=z), Input()).friction_torque for v, z in solution.y.T.tolist()]
    held = reference["held"][: last + 1, 3]
    # The held torque lags by half a sample: 0.05 ms times 130 N.m/s.
    assert friction == pytest.approx(held, abs=0.02)


@given(st.tuples(st.floats(0.0, 10.0), angles, speeds, bristles, torques, torques))
def test_equations_are_odd(values: tuple[float, ...]):
    t, angle, speed, bristle, command, load = values
    stage = BallscrewStage(
        command_max=50.0, drift_amplitude=0.2, drift_frequency=0.5, play_positive=1e-5, play_negative=1e-5
    )
    x = State(angle=angle, speed=speed, bristle=bristle, table=angle * L_P)
    u = Input(command=command, load_torque=load)
    x_mirrored = State(**{name: -value for name, value in vars(x).items()})
    u_mirrored = Input(command=-command, load_torque=-load)
    for method in (stage.derivative, stage.output):
        assert list(method(t, x_mirrored, u_mirrored)) == [-value for value in method(t, x, u)]
    one, other = stage.update(t, x, u), stage.update(t, x_mirrored, u_mirrored)
    assert (other.table, other.largest_speed) == (-one.table, one.largest_speed)


@given(st.floats(-0.0789, 0.0789), bristles, torques)
def test_power_taken_in_is_stored_or_dissipated(speed: float, bristle: float, command: float):
    """Below four levels over sigma_1: command*speed >= d/dt(J*speed^2/2 + sigma_0*bristle^2/2)."""
    rate = rates(STAGE, 0.0, [0.0, speed, bristle], command=command)
    stored = 3.70210163696e-4 * speed * rate[1] + SIGMA_0 * bristle * rate[2]
    assert command * speed - stored >= -1e-12 * (1.0 + abs(command * speed))


@given(speeds, bristles, torques)
def test_load_torque_and_friction_oppose_positive_motion(speed: float, bristle: float, command: float):
    x = [0.0, speed, bristle]
    shifted = rates(STAGE, 0.0, x, command=command, load_torque=3.0)
    assert shifted == pytest.approx(rates(STAGE, 0.0, x, command=command - 3.0), rel=1e-12, abs=1e-9)
    y = STAGE.output(0.0, State(speed=speed, bristle=bristle), Input())
    assert 3.70210163696e-4 * rates(STAGE, 0.0, x, command=command)[1] == pytest.approx(
        command - y.friction_torque, rel=1e-9, abs=1e-9
    )


@pytest.mark.parametrize("command", [12.0, 12.5, 1e6])
def test_torque_of_the_drive_is_limited(command: float):
    limited = BallscrewStage(command_max=12.0)
    x = [0.0, 1.0, 5e-5]
    for sign in (1.0, -1.0):
        assert rates(limited, 0.0, x, command=sign * command) == rates(STAGE, 0.0, x, command=sign * 12.0)
    assert rates(limited, 0.0, x, command=11.9) == rates(STAGE, 0.0, x, command=11.9)


@given(speeds, bristles)
def test_negative_direction_has_its_own_friction(speed: float, bristle: float):
    uneven = BallscrewStage(F_C_negative=0.8, F_S_negative=0.9, sigma_2_negative=1.5)
    same = BallscrewStage(F_C=0.8 * 6.24, F_S=0.9 * 9.36, sigma_2=0.6) if speed < 0.0 else STAGE
    x = [0.0, speed, bristle]
    assert rates(uneven, 0.0, x, command=5.0) == pytest.approx(rates(same, 0.0, x, command=5.0), rel=1e-12, abs=1e-12)


@given(speeds, bristles, st.integers(0, 3))
def test_friction_level_drifts_and_scales(speed: float, bristle: float, quarter: int):
    drifting = BallscrewStage(drift_amplitude=0.2, drift_frequency=0.5, friction_scale=1.3)
    factor = 1.3 * (1.0, 1.2, 1.0, 0.8)[quarter]
    scaled = BallscrewStage(F_C=factor * 6.24, F_S=factor * 9.36)
    x = [0.0, speed, bristle]
    # sin(pi*t) at t = 2 is 2e-16.
    assert rates(drifting, 0.5 * quarter, x, command=5.0) == pytest.approx(
        rates(scaled, 0.0, x, command=5.0), rel=1e-9, abs=1e-9
    )


@given(st.floats(-0.1, 0.1), speeds)
def test_encoder_rounds_the_position_only(position: float, speed: float):
    x = State(angle=position / L_P, speed=speed, table=position)
    y = BallscrewStage(resolution=1e-7).output(0.0, x, Input())
    exact = STAGE.output(0.0, x, Input())
    assert abs(y.position - exact.position) <= 0.5e-7 * (1.0 + 1e-6)
    assert y.position / 1e-7 == pytest.approx(round(y.position / 1e-7), abs=1e-6)
    assert (y.velocity, y.angle, y.speed) == (exact.velocity, exact.angle, exact.speed)


@given(angles, speeds)
def test_without_play_the_table_follows_the_screw(angle: float, speed: float):
    y = STAGE.output(0.0, State(angle=angle, speed=speed, table=7.0), Input())
    assert (y.position, y.velocity) == (L_P * angle, L_P * speed)


@given(st.lists(st.integers(-300, 300), min_size=2, max_size=30))
def test_play_is_the_play_operator(places: list[int]):
    """On a grid of 0.1 um, so that a flank touches within rounding or is far away."""
    path = [1e-7 * place for place in places]
    stage = BallscrewStage(play_positive=5e-6, play_negative=3e-6)
    x = stage.initial()
    table = 0.0
    for before, nut in zip([0.0, *path], path, strict=False):
        speed = math.copysign(1.0, nut - before) if nut != before else 0.0
        x = State(angle=nut / L_P, speed=speed, bristle=0.0, table=x.table)
        nut = L_P * x.angle  # noqa: PLW2901 (as rounded)
        # From the definition: pushed by the flank that would otherwise cut into the table.
        if table < nut - 5e-6:
            table = nut - 5e-6
        elif table > nut + 3e-6:
            table = nut + 3e-6
        assert stage.output(0.0, x, Input()).position == table
        x = stage.update(0.0, x, Input())
        assert x.table == table
        touching = abs(table - (nut - 5e-6 if speed > 0.0 else nut + 3e-6)) < 1e-15
        assert stage.output(0.0, x, Input()).velocity == (L_P * speed if touching else 0.0)


def test_lost_motion_is_the_whole_play():
    stage = BallscrewStage(play_positive=5e-6, play_negative=3e-6)
    x = stage.initial()
    found = []
    for nut in (20e-6, -20e-6, 20e-6):
        x = stage.update(0.0, replace(x, angle=nut / L_P), Input())
        found.append(x.table)
    assert found == pytest.approx([15e-6, -17e-6, 15e-6], rel=1e-9)


def test_play_and_other_discrete_states_do_not_move_the_screw():
    x = State(angle=1.0, speed=2.0, bristle=3e-5, table=0.5)
    with_play = BallscrewStage(play_positive=5e-6, play_negative=3e-6)
    u = Input(command=4.0)
    assert with_play.derivative(0.0, x, u) == STAGE.derivative(0.0, x, u)
    after = with_play.update(0.0, x, u)
    assert (after.angle, after.speed, after.bristle) == (x.angle, x.speed, x.bristle)


def test_frictionless_stage_is_a_double_integrator():
    """friction_scale may be 0; angle = u*t^2/(2*J) then."""
    stage = BallscrewStage(friction_scale=0.0, sigma_2=0.0)
    x, u = stage.initial(), Input(command=0.5)
    for k in range(10):
        x = rk4(stage, k * 1e-3, x, u, step=1e-3)
    assert x.angle == pytest.approx(0.5 * 0.01**2 / (2.0 * 3.70210163696e-4), rel=1e-12)
    assert x.bristle == 0.0


@pytest.mark.parametrize(
    ("start", "message"),
    [
        ({"F_C": 0.0}, "F_C = 0 with F_S > 0"),
        ({"F_C_negative": 0.0}, r"F_C\*F_C_negative = 0 with F_S\*F_S_negative > 0"),
        ({"F_S": 0.0}, "F_S = 0 with F_C > 0"),
        ({"F_S_negative": 0.0}, r"F_S\*F_S_negative = 0 with"),
        ({"drift_amplitude": 0.1}, "drift_amplitude needs a drift_frequency"),
    ],
)
def test_contradicting_parameters_are_refused(start: dict[str, float], message: str):
    with pytest.raises(DescriptionError, match=message):
        BallscrewStage(**start)


def test_no_dry_friction_at_all_is_allowed():
    stage = BallscrewStage(F_C=0.0, F_S=0.0)
    assert rates(stage, 0.0, [0.0, 2.0, 0.0], command=3.0)[1] == pytest.approx((3.0 - 0.8) / J, rel=1e-6)


@given(speeds, bristles)
def test_damping_of_the_bristles_falls_with_speed(speed: float, bristle: float):
    """v_d changes sigma_1 only, by exp(-(speed/v_d)^2); beyond the damping's range friction is bounded by its level."""
    damped = BallscrewStage(v_d=0.01)
    same = BallscrewStage(sigma_1=316.22776601683796 * math.exp(-min((speed / 0.01) ** 2, 700.0)))
    x = [0.0, speed, bristle]
    assert rates(damped, 0.0, x, command=5.0) == pytest.approx(rates(same, 0.0, x, command=5.0), rel=1e-12, abs=1e-12)


@given(speeds, bristles, torques)
def test_with_v_d_power_is_stored_or_dissipated_at_every_speed(speed: float, bristle: float, command: float):
    """sigma_1*v_d = 3.2 N.m is below 9.32*F_C: command*speed >= d/dt(J*speed^2/2 + sigma_0*bristle^2/2)."""
    rate = rates(BallscrewStage(v_d=0.01), 0.0, [0.0, speed, bristle], command=command)
    stored = 3.70210163696e-4 * speed * rate[1] + SIGMA_0 * bristle * rate[2]
    assert command * speed - stored >= -1e-9 * (1.0 + abs(command * speed) + abs(SIGMA_0 * bristle * rate[2]))


def test_states_survive_a_round_trip_through_flat_values():
    x = STAGE.initial()
    assert State(**unflatten(State, iter(list(x)))) == x
