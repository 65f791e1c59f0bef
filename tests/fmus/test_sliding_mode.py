"""Sliding-mode controllers: reference traces, closed forms, symmetry, limits, anti-windup."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from motion_loops import Sampled
from stage_loops import CASES, CONTROLLERS, controller, stage_loop, start, traces

from fmus.controllers.complementary_sliding_mode import ComplementarySlidingMode
from fmus.controllers.fuzzy_sliding_mode import FuzzySlidingMode
from fmus.controllers.sliding_mode import SlidingMode
from fmus.physics.sampling import VelocitySource, filter_pole, saturate, velocity_estimate, winds_up
from fmus.physics.sliding import FrictionVelocity, SlidingController

L_P, J = 1.5923e-3, 3.70210163696e-4
LAWS: dict[str, Any] = {
    "smc": SlidingMode,
    "smc_integral": lambda **start: SlidingMode(integral_surface=True, **start),
    "csmc": ComplementarySlidingMode,
    "fsmc": FuzzySlidingMode,
}
OPTIONS: dict[str, dict[str, Any]] = {
    "default": {},
    "measured": {"friction_velocity": "measured"},
    "none": {"friction_velocity": "none"},
    "difference": {"velocity_source": "difference", "velocity_filter_time": 5e-4},
    "raw": {"velocity_source": "difference", "friction_velocity": "measured"},
    "limited": {"command_max": 8.0},
}
micrometres = st.floats(-50e-6, 50e-6)
velocities = st.floats(-0.05, 0.05)


@pytest.mark.parametrize("option", OPTIONS)
@pytest.mark.parametrize("law", LAWS)
def test_laws_replay_the_reference(law: str, option: str):
    """600 samples of recorded references and measurements; an independent implementation's commands."""
    recorded = traces("replay")
    control = Sampled(LAWS[law](**start(OPTIONS[option])))
    expected = recorded[f"{law}.{option}"]
    for k, (r, position, velocity) in enumerate(
        zip(recorded["references"].tolist(), recorded["position"].tolist(), recorded["velocity"].tolist(), strict=True)
    ):
        y = control(position_ref=r[0], velocity_ref=r[1], acceleration_ref=r[2], position=position, velocity=velocity)
        # Rounding of the difference of positions, 1e-18 m over 1e-4 s, and of cancelling friction terms.
        assert y.command == pytest.approx(expected[k, 0], rel=1e-9, abs=1e-8)
        assert y.sliding_surface == pytest.approx(expected[k, 1], rel=1e-9, abs=1e-8)
        assert y.error == r[0] - position


@pytest.mark.parametrize("name", CASES)
def test_closed_loops_start_as_the_reference(name: str):
    """The first 1.2 ms of every case; the whole runs belong to the FMUs."""
    recorded, case = traces("traces"), CASES[name]
    samples = 12
    rows = stage_loop(case, samples)
    times = recorded[f"{name}.time"][:samples]
    assert times == pytest.approx(np.arange(samples) * 1e-4)
    # Both solve at 1 us or finer; slow cases of the reference at 0.25 us.
    assert rows[:, 1] == pytest.approx(recorded[f"{name}.position"][:samples], abs=1e-13)
    assert rows[:, 2] == pytest.approx(recorded[f"{name}.command"][:samples], rel=1e-6, abs=1e-6)
    if f"{name}.table" in recorded:
        assert rows[:, 0] == pytest.approx(recorded[f"{name}.table"][:samples], abs=1e-13)


PUBLISHED = [
    ("smc_step", "error_end", 28.207e-6, 2e-4),
    ("smc_slow", "error_max", 13.57e-6, 1e-3),
    ("smc_slow", "error_rms", 9.08e-6, 1e-3),
    ("smc_middle", "error_rms", 8.485e-6, 1e-3),
    ("smc_fast", "error_max", 13.09e-6, 1e-3),
    ("smc_fast", "error_rms", 9.913e-6, 1e-3),
    ("csmc_step", "error_end", -6.662e-6, 1e-3),
    ("csmc_slow", "error_max", 10.37e-6, 1e-3),
    ("csmc_middle", "error_max", 2.965e-6, 1e-3),
    ("csmc_middle", "error_rms", 1.993e-6, 1e-3),
    ("csmc_fast", "error_max", 6.244e-6, 1e-3),
    ("csmc_fast", "error_rms", 4.705e-6, 1e-3),
    ("fsmc_middle", "error_max", 0.3045e-6, 1e-3),
    ("fsmc_middle", "error_rms", 0.0259e-6, 2e-3),
    ("fsmc_middle", "total_variation", 6.42, 1e-3),
    ("fsmc_fast", "error_max", 0.3427e-6, 1e-3),
    ("fsmc_fast", "total_variation", 89.0, 1e-3),
    ("fsmc_step", "settling_20um", 0.0319, 1e-9),
    ("fsmc_step", "position_peak", 1.2124e-3, 1e-4),
]


@pytest.mark.parametrize(("name", "figure", "published", "tolerance"), PUBLISHED)
def test_reference_traces_have_the_published_figures(name: str, figure: str, published: float, tolerance: float):
    """The references the components are held against are those of the specification, found a second time."""
    assert CASES[name]["figures"][figure] == pytest.approx(published, rel=tolerance)


@given(micrometres)
def test_sliding_mode_at_rest_is_a_saturated_spring(error: float):
    """At rest: friction_hat = 0, K = F_S_hat + J*eta, command = -K*sat(lambda*e/phi)."""
    y = Sampled(SlidingMode())(position_ref=error)
    gain = 9.36 + J * 120.0
    assert y.command == pytest.approx(gain * min(1.0, max(-1.0, 150.0 * error / L_P / 4.0)), rel=1e-12, abs=1e-15)


@given(st.floats(-0.05, 0.05).filter(lambda v: abs(v) > 1e-6))
def test_first_sample_in_motion_has_steady_friction(velocity: float):
    """A sine starts at full speed: the friction model starts at steady sliding, without a kick of its damping."""
    speed = velocity / L_P
    level = 6.24 + 3.12 * math.exp(-((speed / 5e-3) ** 2))
    expected = math.copysign(level, speed) + 1.2 * speed
    y = Sampled(SlidingMode())(velocity_ref=velocity, velocity=velocity)
    # sigma_1_hat/T_s = 6e6 N.m/rad times the rounding of the bristle's 1e-5 rad.
    assert y.friction_hat == pytest.approx(expected, rel=1e-9)
    assert y.command == pytest.approx(expected, rel=1e-9)


def test_friction_model_converges_to_the_stribeck_curve_of_its_velocity():
    for choice, velocity in ((FrictionVelocity.reference, 0.02), (FrictionVelocity.measured, -0.01)):
        control = Sampled(SlidingMode(friction_velocity=choice))
        control(velocity_ref=0.0, velocity=0.0)
        for _ in range(200):
            y = control(velocity_ref=0.02, velocity=-0.01)
        assert y.friction_hat == pytest.approx(math.copysign(6.24, velocity) + 1.2 * velocity / L_P, rel=1e-9)
    assert Sampled(SlidingMode(friction_velocity=FrictionVelocity.none))(velocity_ref=0.02).friction_hat == 0.0


@pytest.mark.parametrize("law", LAWS)
@given(data=st.data())
def test_laws_are_odd(law: str, data: st.DataObject):
    one, other = Sampled(LAWS[law](command_max=20.0)), Sampled(LAWS[law](command_max=20.0))
    for _ in range(3):
        inputs = {
            "position_ref": data.draw(micrometres),
            "velocity_ref": data.draw(velocities),
            "acceleration_ref": data.draw(velocities),
            "position": data.draw(micrometres),
            "velocity": data.draw(velocities),
        }
        y = one(**inputs)
        mirrored = other(**{name: -value for name, value in inputs.items()})
        assert list(mirrored) == [-value for value in y]


@pytest.mark.parametrize("law", LAWS)
@given(error=micrometres, velocity=velocities)
def test_limited_command_stays_within_its_limit(law: str, error: float, velocity: float):
    y = Sampled(LAWS[law](command_max=5.0))(position=error, velocity=velocity)
    free = Sampled(LAWS[law]())(position=error, velocity=velocity)
    assert y.command == min(5.0, max(-5.0, free.command))


@given(st.floats(-0.05, 0.05), st.floats(-0.01, 0.01))
def test_fuzzy_command_is_bounded(velocity: float, error: float):
    y = Sampled(FuzzySlidingMode(G_u=100.0))(position=error, velocity=velocity)
    assert abs(y.fuzzy_command) <= 100.0 * 5.0 / 6.0 + 1e-9
    assert y.command == pytest.approx(
        y.fuzzy_command - J * (3.0 * 150.0 * velocity / L_P + 3.0 * 150.0**2 * error / L_P), rel=1e-9, abs=1e-9
    )


@pytest.mark.parametrize("law", ["smc_integral", "csmc", "fsmc"])
def test_surfaces_keep_their_sums(law: str):
    """s + s_c = 2*(der_e + lambda*e) and s - s_c = 2*lambda*(e + lambda*xi), through several samples."""
    control = Sampled(LAWS[law]())
    xi = 0.0
    for k in range(20):
        e, rate = math.sin(0.7 * k) * 1e-3, math.cos(0.3 * k)
        xi += 1e-4 * e if k else 0.0
        y = control(position=L_P * e, velocity=L_P * rate)
        assert y.sliding_surface == pytest.approx(rate + 300.0 * e + 150.0**2 * xi, rel=1e-9, abs=1e-12)
        if law != "smc_integral":
            s, s_c = y.sliding_surface, y.complementary_surface
            assert s + s_c == pytest.approx(2.0 * (rate + 150.0 * e), rel=1e-9, abs=1e-12)
            assert s - s_c == pytest.approx(300.0 * (e + 150.0 * xi), rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("kind", CONTROLLERS.values())
def test_integral_is_held_while_it_would_drive_the_limit_further(kind: type[SlidingController]):
    control = Sampled(kind(command_max=2.0))
    control(position=0.0)
    for _ in range(5):
        y = control(position=-1e-3)
    assert y.command == 2.0
    assert control.x.integral == 0.0
    # On the other side of the reference at the same limit (fast return) the integral runs again.
    y = control(position=1e-6, velocity=-0.05)
    assert y.command == 2.0
    assert control.x.integral == pytest.approx(1e-4 * 1e-6 / L_P)


@pytest.mark.parametrize(
    ("name", "overshoot", "without"),
    [("saturation_fsmc", 5.05e-6, 811e-6), ("saturation_smc_integral", 110e-6, 711e-6)],
)
def test_reference_overshoot_with_anti_windup(name: str, overshoot: float, without: float):
    """At 12 N.m the specification has 811 um overshoot without anti-windup."""
    found = CASES[name]["figures"]["position_peak"] - 1e-3
    assert found == pytest.approx(overshoot, rel=0.01)
    assert found < 0.2 * without


def test_every_case_names_a_component_and_its_parameters():
    for name, case in CASES.items():
        assert type(controller(case)).__name__ == case["controller"], name


def test_velocity_of_a_differenced_ramp():
    """First-order lag of a constant velocity: v*(1 - a^k), from the velocity input at the first sample."""
    T_s, tau, v = 1e-4, 5e-4, 0.02
    a = math.exp(-T_s / tau)
    assert filter_pole(T_s, tau) == pytest.approx(a, rel=1e-15)
    assert filter_pole(T_s, 0.0) == 0.0
    last, found = (0.0, 0.0), []
    for k in range(20):
        estimate = velocity_estimate(
            VelocitySource.difference,
            float(k > 0),
            v * k * T_s,
            0.0,
            position_last=last[0],
            velocity_last=last[1],
            T_s=T_s,
            filter_time=tau,
        )
        last = (v * k * T_s, estimate)
        found.append(estimate)
    assert found == pytest.approx([v * (1.0 - a**k) for k in range(20)], rel=1e-9, abs=1e-15)


@given(st.floats(-10.0, 10.0), st.floats(0.1, 5.0), st.floats(-1.0, 1.0))
def test_saturation_and_its_hold(command: float, limit: float, push: float):
    assert saturate(command, limit) == min(limit, max(-limit, command))
    assert saturate(command, 0.0) == command
    realised = saturate(command, limit)
    assert winds_up(realised, limit, push) == (abs(command) >= limit and command * push > 0.0)
    assert not winds_up(command, 0.0, push)


@given(st.floats(-0.05, 0.05), st.floats(-0.05, 0.05))
def test_damping_of_the_friction_model_falls_with_its_velocity(before: float, now: float):
    """Two samples of a changing reference: only sigma_1_hat differs, by exp(-(v/v_d_hat)^2)."""
    falling, plain = SlidingMode(v_d_hat=0.01), SlidingMode()
    share = math.exp(-((now / 0.01) ** 2))
    same = SlidingMode(sigma_1_hat=share * plain.sigma_1_hat)
    l_p = plain.l_p

    def second(controller: SlidingMode) -> float:
        x, u = controller.initial(), controller.Input(velocity_ref=before * l_p)
        x = controller.update(0.0, x, u, controller.output(0.0, x, u))
        return controller.friction_hat(x, controller.Input(velocity_ref=now * l_p))

    assert second(falling) == pytest.approx(second(same), rel=1e-9, abs=1e-9)
