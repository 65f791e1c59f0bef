"""Trajectories: derivatives against finite differences, limits, end values, the papers' profiles."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.errors import DescriptionError
from fmus.sources.trajectory import Trajectory, TrajectoryKind

KIND = TrajectoryKind
MOVES = (KIND.quintic, KIND.trapezoidal, KIND.jerk_limited)

CASES: dict[str, tuple[dict[str, Any], float]] = {
    "sine": ({"kind": KIND.sine, "phase": 0.4, "offset": 1e-3}, 8.0),
    "sine soft": ({"kind": KIND.sine, "frequency": 1.0, "soft_start": 0.5, "turns": 2.0, "start_time": 0.1}, 3.0),
    "ramp": ({"kind": KIND.ramp, "soft_start": 0.2, "start_time": 0.1}, 1.2),
    "ramp down": ({"kind": KIND.ramp, "feed": -0.02, "amplitude": 1e-3, "soft_start": 0.2}, 0.6),
    "ramp short": ({"kind": KIND.ramp, "feed": 0.02, "amplitude": 1e-3, "soft_start": 0.2}, 0.6),
    "ramp without end": ({"kind": KIND.ramp, "amplitude": 0.0, "soft_start": 0.2}, 0.6),
    "circle": ({"kind": KIND.circle, "feed": 0.05, "soft_start": 0.5, "phase": -0.5 * math.pi}, 3.0),
    "circle clockwise": ({"kind": KIND.circle, "feed": -0.2, "soft_start": 0.5, "turns": 1.0}, 1.5),
    "circle tangential": ({"kind": KIND.circle, "feed": 0.05, "tangential_acceleration": 0.2, "turns": 1.25}, 3.6),
    "circle short": ({"kind": KIND.circle, "feed": 0.5, "tangential_acceleration": 0.2, "turns": 0.25}, 1.0),
    "quintic": ({"kind": KIND.quintic, "start_time": 0.1}, 0.6),
    "quintic back": ({"kind": KIND.quintic, "out_and_back": True, "dwell": 0.05, "repetitions": 2.0}, 1.2),
    "trapezoidal": ({"kind": KIND.trapezoidal, "offset": -2e-3}, 0.4),
    "trapezoidal short": ({"kind": KIND.trapezoidal, "amplitude": -1e-3}, 0.2),
    "trapezoidal back": ({"kind": KIND.trapezoidal, "out_and_back": True, "amplitude": 0.01}, 0.8),
    "jerk limited": ({"kind": KIND.jerk_limited, "amplitude": 0.01}, 0.5),
    "jerk limited thrice": ({"kind": KIND.jerk_limited, "repetitions": 3.0, "dwell": 0.02}, 0.8),
    "jerk limited back": ({"kind": KIND.jerk_limited, "out_and_back": True, "repetitions": 0.0}, 1.5),
}


def rows(trajectory: Trajectory, times: np.ndarray) -> np.ndarray:
    """Position, velocity, acceleration, position_next; one row a time."""
    return np.array([list(trajectory.output(float(t))) for t in times])


@pytest.mark.parametrize("name", CASES)
def test_derivatives_are_those_of_the_position(name: str):
    """The outputs integrate to each other over every interval of 2.5 ms, jumps of acceleration or jerk included."""
    start, stop = CASES[name]
    trajectory = Trajectory(**start)
    # A part with a jump of acceleration or jerk errs by no more than acceleration changes within a part.
    nodes, weights = np.polynomial.legendre.leggauss(5)
    edges = np.linspace(-0.05, stop, round(400 * stop) + 1)
    if not start.get("soft_start", 0.0) and start["kind"] in {KIND.sine, KIND.ramp}:
        edges = np.linspace(0.0, stop, round(400 * stop) + 1)
    h = np.diff(edges)
    inner = edges[:-1, None] + 0.5 * h[:, None] * (nodes + 1.0)
    values = rows(trajectory, inner.ravel()).reshape(*inner.shape, 4)
    at = rows(trajectory, edges)
    integrals = 0.5 * h[:, None] * np.einsum("n,ink->ik", weights, values)
    scale = np.max(np.abs(at), axis=0)
    limit = np.max(np.abs(np.diff(at[:, 2]))) * h[0] + 1e-12 * scale[1]
    velocity_gap = np.abs(np.diff(at[:, 1]) - integrals[:, 2])
    assert np.max(velocity_gap) <= limit
    assert np.quantile(velocity_gap, 0.75) <= 1e-9 * scale[1]
    assert np.max(np.abs(np.diff(at[:, 0]) - integrals[:, 1])) <= limit * h[0] + 1e-12 * scale[0]


@pytest.mark.parametrize("name", CASES)
def test_velocity_and_acceleration_match_finite_differences(name: str):
    start, stop = CASES[name]
    trajectory = Trajectory(**start)
    rng = np.random.default_rng(7)
    times = rng.uniform(1e-3, stop, 200)
    h = 1e-5
    before, at, after = (rows(trajectory, times + d) for d in (-h, 0.0, h))
    scale = np.max(np.abs(at), axis=0)
    velocity = (after[:, 0] - before[:, 0]) / (2.0 * h)
    acceleration = (after[:, 1] - before[:, 1]) / (2.0 * h)
    # At a jump of acceleration or jerk within 10 us of a time the difference quotient means nothing.
    assert np.mean(np.abs(velocity - at[:, 1]) < 1e-5 * scale[1]) > 0.97
    assert np.mean(np.abs(acceleration - at[:, 2]) < 1e-4 * scale[2]) > 0.97


@pytest.mark.parametrize("name", CASES)
def test_position_next_is_the_position_one_sample_later(name: str):
    start, stop = CASES[name]
    trajectory = Trajectory(T_s=2.5e-4, **start)
    for t in np.linspace(-0.01, stop, 101).tolist():
        assert trajectory.output(t).position_next == trajectory.output(t + 2.5e-4).position


@pytest.mark.parametrize("name", [n for n, (s, _) in CASES.items() if s["kind"] in MOVES])
def test_moves_keep_their_limits_and_reach_one(name: str):
    start, stop = CASES[name]
    trajectory = Trajectory(**start)
    times = np.linspace(0.0, stop, 5001)
    _, v, a, _ = rows(trajectory, times).T
    jerk = np.diff(a) / np.diff(times)
    used = [np.max(np.abs(v)) / trajectory.velocity_max, np.max(np.abs(a)) / trajectory.acceleration_max]
    if trajectory.kind is not KIND.trapezoidal:
        used.append(np.max(np.abs(jerk)) / trajectory.jerk_max)
    assert max(used) <= 1.0 + 1e-9
    # The sampled jerk of a quintic misses its peak at the very start.
    assert max(used) >= 0.98


@pytest.mark.parametrize("kind", MOVES)
@pytest.mark.parametrize("amplitude", [3e-3, -3e-3, 0.0])
def test_moves_start_and_end_at_rest(kind: TrajectoryKind, amplitude: float):
    trajectory = Trajectory(kind=kind, amplitude=amplitude, offset=1e-3, start_time=0.25)
    for t in (-1.0, 0.0, 0.2499):
        assert list(trajectory.output(t))[:3] == [1e-3, 0.0, 0.0]
    for t in (1.0, 10.0, 1e4):
        assert list(trajectory.output(t))[:3] == [1e-3 + amplitude, 0.0, 0.0]


@pytest.mark.parametrize(
    ("a", "v", "distance"), [(0.01, 0.01, 0.03), (0.02, 0.02, 0.03), (0.02, 0.03, 0.05), (0.03, 0.03, 0.08)]
)
def test_out_and_back_profiles_of_feng(a: float, v: float, distance: float):
    """S1 to S4: trapezoidal out and back without dwell; the reversal is passed at full deceleration."""
    trajectory = Trajectory(
        kind=KIND.trapezoidal, amplitude=distance, velocity_max=v, acceleration_max=a, out_and_back=True
    )
    way = distance / v + v / a
    assert trajectory.output(way).position == pytest.approx(distance, rel=1e-12)
    for t in (way - 1e-3, way, way + 1e-3):
        assert trajectory.output(t).acceleration == -a
        assert trajectory.output(t).velocity == pytest.approx(-a * (t - way), abs=1e-15)
    assert list(trajectory.output(2.0 * way))[:3] == pytest.approx([0.0, 0.0, 0.0], abs=1e-15)
    assert trajectory.output(0.5 * way).velocity == v


@pytest.mark.parametrize(
    ("distance", "duration"),
    [
        # v = 0.05, a = 1, j = 50: v*j = a^2*2.5, so a is reached; D/v + v/a + a/j.
        (0.02, 0.02 / 0.05 + 0.05 + 0.02),
        # v not reached, a reached: D = v_p*(v_p/a + a/j) at v_p = 0.03.
        (0.03 * (0.03 + 0.02), 2.0 * (0.03 + 0.02)),
        # Neither reached: D = 2*j*t^3, four phases of t.
        (2.0 * 50.0 * 0.01**3, 0.04),
    ],
)
def test_duration_of_jerk_limited_moves(distance: float, duration: float):
    trajectory = Trajectory(kind=KIND.jerk_limited, amplitude=distance)
    assert trajectory.duration(distance) == pytest.approx(duration, rel=1e-12)


def test_duration_of_a_jerk_limited_move_with_low_velocity():
    # v*j < a^2: a is not reached; D/v + 2*sqrt(v/j).
    trajectory = Trajectory(kind=KIND.jerk_limited, amplitude=0.02, velocity_max=0.01)
    assert trajectory.duration(0.02) == pytest.approx(2.0 + 2.0 * math.sqrt(0.01 / 50.0), rel=1e-12)


@given(
    st.floats(1e-6, 1.0),
    st.floats(1e-3, 1.0),
    st.floats(1e-2, 10.0),
    st.floats(1e-1, 1e3),
    st.sampled_from(MOVES),
    st.floats(0.0, 1.0),
)
def test_any_move_is_point_symmetric_and_arrives(  # noqa: PLR0917
    distance: float, v: float, a: float, j: float, kind: TrajectoryKind, part: float
):
    trajectory = Trajectory(kind=kind, amplitude=distance, velocity_max=v, acceleration_max=a, jerk_max=j)
    T = trajectory.duration(distance)
    one, other = trajectory.output(part * T), trajectory.output((1.0 - part) * T)
    assert one.position + other.position == pytest.approx(distance, rel=1e-9)
    assert one.velocity == pytest.approx(other.velocity, rel=1e-6, abs=1e-9 * distance / T)
    assert trajectory.output(T * (1.0 + 1e-9) + 1e-9).position == pytest.approx(distance, rel=1e-12)
    assert one.velocity <= v * (1.0 + 1e-9)
    assert abs(one.acceleration) <= a * (1.0 + 1e-9)


def test_quintic_is_the_polynomial():
    trajectory = Trajectory(kind=KIND.quintic, amplitude=1e-3, velocity_max=1.0, acceleration_max=100.0, jerk_max=60.0)
    T = 0.1  # (60*1e-3/60)^(1/3)
    assert trajectory.duration(1e-3) == pytest.approx(T, rel=1e-12)
    for s in (0.1, 0.5, 0.8):
        y = trajectory.output(s * T)
        assert y.position == pytest.approx(1e-3 * (10 * s**3 - 15 * s**4 + 6 * s**5), rel=1e-12)
        assert y.velocity == pytest.approx(1e-3 / T * (30 * s**2 - 60 * s**3 + 30 * s**4), rel=1e-12)
        assert y.acceleration == pytest.approx(1e-3 / T**2 * (60 * s - 180 * s**2 + 120 * s**3), rel=1e-9, abs=1e-15)


def test_sine_is_that_of_the_paper_from_the_first_sample():
    trajectory = Trajectory()
    for k in (0, 1, 12345, 99999):
        t = k * 1e-4
        expected = [5e-3 * math.sin(t), 5e-3 * math.cos(t), -5e-3 * math.sin(t)]
        assert list(trajectory.output(t))[:3] == pytest.approx(expected, rel=1e-12, abs=1e-16)


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_axes_of_a_circle(direction: float):
    """Two phases make a circle; soft start over 0.5 s as in the double ball bar definition."""
    feed, radius = direction * 1000e-3 / 60.0, 0.02
    common: dict[str, Any] = {"kind": KIND.circle, "feed": feed, "radius": radius, "soft_start": 0.5}
    x, y = Trajectory(**common), Trajectory(phase=-0.5 * math.pi, **common)
    rate = feed / radius
    for t in (0.0, 0.1, 0.3, 0.5, 2.0, 7.7):
        s = t / 0.5
        psi = rate * 0.5 * (s**3 - s**4 / 2.0) if t < 0.5 else rate * (t - 0.25)
        assert x.output(t).position == pytest.approx(radius * math.cos(psi), rel=1e-12)
        assert y.output(t).position == pytest.approx(radius * math.sin(psi), rel=1e-12, abs=1e-17)
        speed = math.hypot(x.output(t).velocity, y.output(t).velocity)
        assert speed == pytest.approx(abs(feed) * (3 * s**2 - 2 * s**3 if t < 0.5 else 1.0), rel=1e-9, abs=1e-15)


def test_circle_of_feng():
    """From -45 degrees counter-clockwise over 1.25 turns, tangential acceleration 0.2 m/s2 at both ends."""
    feed, radius, along = 3000e-3 / 60.0, 0.025, 0.2
    common: dict[str, Any] = {"kind": KIND.circle, "feed": feed, "radius": radius, "turns": 1.25}
    x = Trajectory(phase=-0.25 * math.pi, tangential_acceleration=along, **common)
    y = Trajectory(phase=-0.75 * math.pi, tangential_acceleration=along, **common)
    end = 2.5 * math.pi * radius / feed + feed / along

    def state(t: float) -> tuple[float, float, float, float]:
        """Angle in degrees, speed, tangential and centripetal acceleration."""
        p, q = x.output(t), y.output(t)
        v = math.hypot(p.velocity, q.velocity)
        tangential = (p.acceleration * p.velocity + q.acceleration * q.velocity) / v if v else 0.0
        centripetal = -(p.acceleration * p.position + q.acceleration * q.position) / radius
        assert math.hypot(p.position, q.position) == pytest.approx(radius, rel=1e-12)
        return math.degrees(math.atan2(q.position, p.position)), v, tangential, centripetal

    assert state(0.0)[:2] == (pytest.approx(-45.0), 0.0)
    for t, sign in ((0.1, 1.0), (0.24, 1.0), (end - 0.1, -1.0)):
        _, v, tangential, centripetal = state(t)
        assert tangential == pytest.approx(sign * along, rel=1e-9)
        assert centripetal == pytest.approx(v**2 / radius, rel=1e-9)
        assert v == pytest.approx(along * min(t, end - t), rel=1e-9)
    assert state(1.0)[1:] == pytest.approx((feed, 0.0, feed**2 / radius), abs=1e-12)
    assert state(end)[:2] == (pytest.approx(45.0), 0.0)


def test_jumps_fall_on_their_sample_in_spite_of_rounding():
    stairs = Trajectory(kind=KIND.stairs, amplitude=5e-9, dwell=0.2, repetitions=6.0)
    step = Trajectory(kind=KIND.step, amplitude=1e-3, start_time=0.3)
    heights = [round(stairs.output(k * 1e-4).position / 5e-9) for k in range(-100, 14000)]
    assert heights == [0] * 100 + [min(1 + k // 2000, 6) for k in range(14000)]
    assert [step.output(k * 0.1).position for k in range(5)] == [0.0, 0.0, 0.0, 1e-3, 1e-3]


def test_stairs_go_up_and_down():
    stairs = Trajectory(kind=KIND.stairs, amplitude=1.0, dwell=1.0, repetitions=3.0, out_and_back=True)
    assert [stairs.output(t + 0.5).position for t in range(-1, 8)] == [0.0, 1.0, 2.0, 3.0, 2.0, 1.0, 0.0, 0.0, 0.0]
    endless = Trajectory(kind=KIND.stairs, amplitude=1.0, dwell=1.0, repetitions=0.0)
    assert [endless.output(float(t)).position for t in (-1, 0, 1, 1000)] == [0.0, 1.0, 2.0, 1001.0]


def test_repeated_moves_add_up_and_returning_ones_alternate():
    common: dict[str, Any] = {"kind": KIND.trapezoidal, "amplitude": 1e-3, "dwell": 0.1}
    on = Trajectory(repetitions=3.0, **common)
    way = on.duration(1e-3) + 0.1
    rests = [on.output(n * way - 0.05).position for n in range(1, 6)]
    assert rests == pytest.approx([1e-3, 2e-3, 3e-3, 3e-3, 3e-3], rel=1e-12)
    back = Trajectory(repetitions=2.0, out_and_back=True, **common)
    rests = [back.output(n * way - 0.05).position for n in range(1, 7)]
    assert rests == pytest.approx([1e-3, 0.0, 1e-3, 0.0, 0.0, 0.0], rel=1e-12, abs=1e-18)


def test_full_speed_start_and_stop_without_soft_start():
    sine = Trajectory(frequency=1.0, turns=2.0, start_time=0.5)
    assert [sine.output(t).velocity for t in (0.4999, 2.5)] == [0.0, 0.0]
    assert sine.output(0.5).velocity == pytest.approx(5e-3 * 2.0 * math.pi)
    assert sine.output(2.4999).velocity == pytest.approx(5e-3 * 2.0 * math.pi, rel=1e-6)
    assert sine.output(3.0).position == pytest.approx(0.0, abs=1e-17)
    ramp = Trajectory(kind=KIND.ramp, feed=0.01, amplitude=1e-3)
    assert [ramp.output(t).position for t in (0.0, 0.05, 0.1, 1.0)] == pytest.approx([0.0, 5e-4, 1e-3, 1e-3])


def test_stairs_without_dwell_are_refused():
    with pytest.raises(DescriptionError, match="stairs need a dwell"):
        Trajectory(kind=KIND.stairs)
