"""Friction pulse: shape in closed form, what counts as a reversal, tables."""

from __future__ import annotations

import itertools
import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from motion_loops import Sampled

from fmus.controllers.friction_pulse import FrictionPulse, Mode

T_S = 2.5e-4
FIXED = FrictionPulse(mode=Mode.fixed, A=1e-3, T=0.02, t_r=2e-3)


def run(component: FrictionPulse, positions: list[float]) -> list[Any]:
    pulse = Sampled(component)
    return [pulse(position_ref=a, position_next=b) for a, b in itertools.pairwise(positions)]


def pulses(component: FrictionPulse, positions: list[float]) -> list[float]:
    return [y.velocity_pulse for y in run(component, positions)]


def parabola(a: float, top: int, samples: int) -> list[float]:
    """Up and down with the acceleration -a; the increment of sample ``top`` is the first one back."""
    return [-0.5 * a * ((k - top + 0.25) * T_S) ** 2 for k in range(samples + 1)]


def trapezoid(t: float, A: float, T: float, t_r: float) -> float:
    rise = min(t_r, 0.5 * T)
    if t < rise:
        return A * t / rise
    if t < T - rise:
        return A
    return A * (T - t) / rise if t < T else 0.0


@pytest.mark.parametrize("sense", [1.0, -1.0])
@pytest.mark.parametrize(("A", "T", "t_r"), [(1e-3, 0.02, 2e-3), (2e-3, 0.003, 2e-3), (1e-3, 0.01, 1e-9)])
def test_pulse_is_the_trapezoid_in_the_new_direction(sense: float, A: float, T: float, t_r: float):
    component = FrictionPulse(mode=Mode.fixed, A=A, T=T, t_r=t_r)
    found = pulses(component, [sense * p for p in parabola(0.04, 50, 400)])
    assert found[:50] == [0.0] * 50
    for k, value in enumerate(found[50:]):
        assert value == pytest.approx(-sense * trapezoid(k * T_S, A, T, t_r), abs=1e-9 * A)


def test_reverse_acceleration_is_that_of_the_reference():
    y = run(FIXED, parabola(0.04, 50, 60))
    assert y[-1].reverse_acceleration == pytest.approx(0.04, rel=1e-9)
    assert y[-1].time_since_reversal == pytest.approx(9 * T_S)


def test_first_motion_is_no_reversal():
    for sense in (1.0, -1.0):
        rest_then_move = [0.0] * 20 + [sense * 1e-6 * k for k in range(100)]
        y = run(FIXED, rest_then_move)
        assert {item.velocity_pulse for item in y} == {0.0}
        assert y[-1].reversals == 0.0


def test_rest_between_two_moves_in_one_direction_is_no_reversal():
    up, rest = [1e-6 * k for k in range(50)], [49e-6] * 30
    assert set(pulses(FIXED, up + rest + [49e-6 + p for p in up[1:]])) == {0.0}


def test_reversal_through_a_flat_top_fires_once_when_motion_resumes():
    up, rest = [1e-6 * k for k in range(50)], [49e-6] * 30
    found = run(FIXED, up + rest + up[::-1][1:])
    first = next(k for k, y in enumerate(found) if y.reversals > 0.0)
    assert first == 49 + 30
    assert found[-1].reversals == 1.0
    assert min(y.velocity_pulse for y in found) == pytest.approx(-1e-3)


def test_reversal_during_a_pulse_starts_the_new_one():
    # 20 samples down, then up again: the first pulse lasts 80 samples.
    positions = [1e-6 * k for k in range(31)] + [1e-6 * (30 - k) for k in range(1, 21)]
    positions += [1e-6 * (10 + k) for k in range(1, 200)]
    found = pulses(FIXED, positions)
    for k, value in enumerate(found[:30]):
        assert value == 0.0, k
    for k, value in enumerate(found[30:50]):
        assert value == pytest.approx(-trapezoid(k * T_S, 1e-3, 0.02, 2e-3), abs=1e-12)
    for k, value in enumerate(found[50:]):
        assert value == pytest.approx(trapezoid(k * T_S, 1e-3, 0.02, 2e-3), abs=1e-12)


def test_mode_off_finds_reversals_but_does_nothing():
    y = run(FrictionPulse(mode=Mode.off), parabola(0.04, 50, 400))
    assert {item.velocity_pulse for item in y} == {0.0}
    assert y[-1].reversals == 1.0


@pytest.mark.parametrize("a", [1e-3, 2e-3, 0.0233, 0.12, 0.5])
def test_tables_are_linear_and_held_at_their_ends(a: float):
    nodes = tuple(2e-3 * 60.0 ** (i / 59) for i in range(60))
    component = FrictionPulse(
        mode=Mode.table,
        acceleration_table=nodes,
        amplitude_table=tuple(0.02 * node for node in nodes),
        duration_table=tuple(0.05 + 0.1 * node for node in nodes),
        t_r=1e-9,
    )
    found = pulses(component, parabola(a, 50, 500))
    inside = min(max(a, 2e-3), 0.12)
    assert min(found) == pytest.approx(-0.02 * inside, rel=1e-6)
    lasting = sum(value < 0.0 for value in found)
    assert lasting == pytest.approx((0.05 + 0.1 * inside) / T_S, abs=1.0)


def test_start_tables_pass_through_the_learned_points():
    component = FrictionPulse(t_r=1e-9)
    for a, amplitude, duration in ((2e-3, 0.38e-3, 0.1306), (0.01, 0.56e-3, 0.0828), (0.12, 0.848e-3, 0.0383)):
        found = pulses(component, parabola(a, 50, 700))
        assert -min(found) == pytest.approx(amplitude, rel=2e-3)
        assert sum(value < 0.0 for value in found) == pytest.approx(duration / T_S, abs=2.0)


@given(increments=st.lists(st.floats(-1e-4, 1e-4), min_size=3, max_size=40))
def test_pulse_stays_within_its_amplitude_and_is_odd(increments: list[float]):
    positions = [0.0]
    for increment in increments:
        positions.append(positions[-1] + increment)
    for mode in Mode:
        component = FrictionPulse(mode=mode)
        limit = {Mode.off: 0.0, Mode.fixed: component.A, Mode.table: max(component.amplitude_table)}[mode]
        found = pulses(component, positions)
        assert all(math.isfinite(value) and abs(value) <= limit * (1.0 + 1e-12) for value in found)
        assert pulses(component, [-p for p in positions]) == [-value for value in found]
