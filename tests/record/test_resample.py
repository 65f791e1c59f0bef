"""Values between samples and beyond them, against numpy.interp and against the samples themselves."""

from __future__ import annotations

import numpy as np
import pytest

from cosim.record.resample import Resampler, usual_step

TIME = np.array([0.0, 0.1, 0.2, 0.3, 0.5])
VALUES = np.array([1.0, -2.0, 4.0, 0.0, 8.0])


@pytest.mark.parametrize("step", [0.1, 1e-3, 1e-4, 1 / 3, 1 / 30, 0.125])
@pytest.mark.parametrize(("digits", "linear"), [(17, False), (17, True), (9, False)])
def test_a_sample_at_a_communication_point_is_that_sample(step: float, digits: int, linear: bool) -> None:
    """Products such as 3*0.1 are not the decimals of a file, and files round: no sample comes late or early."""
    points = np.arange(20000)
    written = np.array([float(f"{k * step:.{digits}g}") for k in points.tolist()])
    values = np.sin(points)
    found = Resampler(written, linear=linear).values(values, points * step)
    assert found.tobytes() == values.tobytes()


def test_a_sample_holds_until_the_next() -> None:
    at = np.array([0.0, 0.05, 0.098, 0.1, 0.19, 0.2, 0.31, 0.49, 0.5])
    assert Resampler(TIME).values(VALUES, at).tolist() == [1.0, 1.0, 1.0, -2.0, -2.0, 4.0, 0.0, 0.0, 8.0]


def test_a_sample_of_a_slow_record_does_not_come_early() -> None:
    time = np.arange(5.0)
    at = np.arange(4000) * 1e-3
    found = Resampler(time, grid=1e-3).values(time, at)
    assert found.tolist() == [float(k // 1000) for k in range(4000)]


def test_linear_as_numpy_interpolates() -> None:
    at = np.linspace(-0.2, 0.8, 1001)
    found = Resampler(TIME, linear=True).values(VALUES, at)
    assert found == pytest.approx(np.interp(at, TIME, VALUES), abs=1e-12)


@pytest.mark.parametrize("linear", [False, True])
def test_beyond_the_ends_the_first_and_last_sample_hold(linear: bool) -> None:
    own = Resampler(TIME, linear=linear)
    assert own.values(VALUES, np.array([-9.0, -0.1, 0.6, 9.0])).tolist() == [1.0, 1.0, 8.0, 8.0]
    assert own.outside(np.array([-0.1, 0.0, 0.5, 0.6])).tolist() == [True, False, False, True]


@pytest.mark.parametrize("step", [0.1, 1e-3, 1 / 3])
@pytest.mark.parametrize("first", [0.0, 12.5, -3.0])
def test_a_record_repeats_itself_sample_by_sample(step: float, first: float) -> None:
    values = np.arange(7.0)
    at = first + np.arange(-70, 700) * step
    found = Resampler(first + np.arange(7) * step, repeat=True).values(values, at)
    assert found.tolist() == [float(k % 7) for k in range(-70, 700)]


def test_between_the_last_sample_and_the_first_of_the_next_round_values_are_interpolated() -> None:
    own = Resampler(np.array([0.0, 1.0, 2.0]), linear=True, repeat=True)
    values = np.array([0.0, 1.0, 4.0])
    assert own.values(values, np.array([2.5, 2.75, 3.0, 3.5])).tolist() == [2.0, 1.0, 0.0, 0.5]


def test_several_columns_at_once() -> None:
    both = np.column_stack((VALUES, 2.0 * VALUES))
    at = np.linspace(0.0, 0.5, 77)
    for linear in (False, True):
        own = Resampler(TIME, linear=linear)
        together = own.values(both, at)
        assert together[:, 1].tolist() == own.values(2.0 * VALUES, at).tolist()
        assert together[:, 0].tolist() == own.values(VALUES, at).tolist()


@pytest.mark.parametrize(("linear", "repeat"), [(False, False), (True, False), (True, True)])
def test_a_single_sample_holds_for_ever(linear: bool, repeat: bool) -> None:
    own = Resampler(np.array([0.3]), linear=linear, repeat=repeat)
    assert own.values(np.array([7.0]), np.array([0.0, 0.3, 1.0])).tolist() == [7.0, 7.0, 7.0]


def test_the_usual_step_of_rounded_times_is_their_mean_and_a_gap_does_not_count() -> None:
    rounded = np.round(np.arange(1001) / 300.0, 4)  # steps of 3.3 and 3.4 ms
    assert usual_step(rounded) == pytest.approx(1.0 / 300.0, rel=1e-4)
    gap = np.concatenate([np.arange(100.0), 150.0 + np.arange(100.0)])
    assert usual_step(gap) == 1.0
    assert usual_step(np.array([2.0])) == 0.0
