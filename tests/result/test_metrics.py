"""Figures of merit against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize

from cosim.errors import DescriptionError
from cosim.result import metrics

TIME = np.arange(100_001) * 1e-4  # 10 s at 10 kHz


def test_whole_periods_of_a_sine() -> None:
    signal = 3.0 * np.sin(2.0 * math.pi * TIME)  # ten periods
    assert metrics.max_abs(signal) == pytest.approx(3.0, rel=1e-7)
    # the last sample repeats the first, so the mean is over 100001 samples
    assert metrics.rms(signal) == pytest.approx(3.0 / math.sqrt(2.0), rel=1e-5)
    assert metrics.std(signal + 7.0) == pytest.approx(3.0 / math.sqrt(2.0), rel=1e-5)
    assert metrics.total_variation(TIME, signal) == pytest.approx(4.0 * 3.0 * 1.0, rel=1e-6)
    assert metrics.sine_amplitude(TIME, signal + 0.4 * TIME**0, 1.0) == pytest.approx(3.0, rel=1e-9)


def test_total_variation_does_not_depend_on_the_window_length() -> None:
    chatter = np.where(np.arange(TIME.size) % 2, 1.0, -1.0)
    for part in (metrics.window(TIME, 0.0, 1.0), metrics.window(TIME, 3.0, 10.0)):
        assert metrics.total_variation(TIME[part], chatter[part]) == pytest.approx(2.0 / 1e-4, rel=1e-9)


@given(st.floats(0.0, 9.0), st.floats(0.0, 0.9))
def test_window_holds_exactly_the_samples_between_its_ends(start: float, length: float) -> None:
    stop = start + length + 1e-3
    part = TIME[metrics.window(TIME, start, stop)]
    assert part[0] >= start - 1e-9
    assert part[0] < start + 1e-4 + 1e-9
    assert part[-1] <= stop + 1e-9
    assert part[-1] > stop - 1e-4 - 1e-9


def test_window_counts_ends_that_differ_by_rounding() -> None:
    part = metrics.window(TIME, 3 * 0.1, 0.1 + 0.2)  # 0.30000000000000004 twice, the sample is 0.3
    assert part == slice(3000, 3001)


def test_window_without_samples_is_refused() -> None:
    with pytest.raises(DescriptionError, match=r"no sample from 11 s to 12 s: the signal lasts from 0 s to 10 s"):
        metrics.window(TIME, 11.0, 12.0)


def test_empty_signals_are_refused() -> None:
    with pytest.raises(DescriptionError, match="0 samples in the window: give one with at least 1"):
        metrics.rms(TIME[:0])
    with pytest.raises(DescriptionError, match="1 samples in the window: give one with at least 2"):
        metrics.total_variation(TIME[:1], TIME[:1])


def test_step_response_of_an_underdamped_second_order_lag() -> None:
    zeta, omega = 0.4, 20.0
    damped = omega * math.sqrt(1.0 - zeta**2)
    decay = np.exp(-zeta * omega * TIME)
    signal = 2.0 - 2.0 * decay * (np.cos(damped * TIME) + zeta * omega / damped * np.sin(damped * TIME))
    peak = 2.0 * math.exp(-math.pi * zeta / math.sqrt(1.0 - zeta**2))
    assert metrics.overshoot(signal, 0.0, 2.0) == pytest.approx(peak, rel=1e-5)
    assert metrics.overshoot(-signal, 0.0, -2.0) == pytest.approx(peak, rel=1e-5)
    assert metrics.steady_value(TIME, signal, 1.0) == pytest.approx(2.0, abs=1e-12)
    # the envelope bounds the settling time from above, half an oscillation from below
    settled = metrics.settling_time(TIME, signal, 2.0, 0.02)
    envelope = -math.log(0.01 * math.sqrt(1.0 - zeta**2)) / (zeta * omega)
    assert envelope - math.pi / damped < settled <= envelope + 1e-4


def test_overdamped_steps_do_not_overshoot() -> None:
    assert metrics.overshoot(1.0 - np.exp(-TIME), 0.0, 1.0) == 0.0


def test_settling_and_rise_of_a_first_order_lag() -> None:
    tau = 0.25
    signal = 5.0 - 5.0 * np.exp(-TIME / tau)
    assert metrics.settling_time(TIME, signal, 5.0, 0.1) == pytest.approx(tau * math.log(50.0), abs=1e-4)
    assert metrics.settling_time(TIME, signal, 5.0, 0.1, start=0.5) == pytest.approx(
        tau * math.log(50.0) - 0.5, abs=1e-4
    )
    assert metrics.rise_time(TIME, signal, start=0.0, final=5.0) == pytest.approx(tau * math.log(9.0), rel=1e-6)


def test_a_signal_that_never_arrives_has_no_settling_or_rise_time() -> None:
    ramp = 0.05 * TIME
    assert math.isnan(metrics.settling_time(TIME, ramp, 5.0, 0.1))
    assert math.isnan(metrics.rise_time(TIME, ramp, start=0.0, final=5.0))
    assert metrics.settling_time(TIME, 0.0 * TIME, 0.0, 0.1) == 0.0


def test_reversals_of_a_cosine_are_its_extremes() -> None:
    times = metrics.reversal_times(TIME, np.cos(math.pi * TIME + 1e-9))
    assert times == pytest.approx(np.arange(1.0, 10.0), abs=1e-4)


def test_a_rest_between_two_senses_is_one_reversal_at_its_end() -> None:
    reference = np.interp(TIME, [0.0, 1.0, 2.0, 3.0, 4.0, 5.0], [0.0, 1.0, 1.0, 0.0, 0.0, -1.0])
    # at 1...2 s the sense turns; at 3...4 s the motion only pauses
    assert metrics.reversal_times(TIME, reference) == pytest.approx([2.0], abs=1e-4)


def test_reversal_peaks_of_a_known_error() -> None:
    reference = np.cos(math.pi * TIME)  # turns at 1, 2, ... s
    since = np.mod(TIME, 1.0)
    sense = np.where(np.floor(TIME) % 2 == 1, 1.0, -1.0)
    error = sense * (0.1 + 2.0 * np.exp(-since / 0.02) * (since < 0.5)) * (TIME >= 1.0 - 1e-9)
    peaks = metrics.reversal_peaks(TIME, error, reference)
    assert len(peaks) == 9
    for k, peak in enumerate(peaks, start=1):
        assert peak.time == pytest.approx(k, abs=1e-4)
        assert abs(peak.peak) == pytest.approx(2.1, rel=1e-2)
        assert peak.delay == pytest.approx(0.0, abs=2e-4)
        assert peak.base == pytest.approx(0.1, rel=1e-3)
        assert peak.decay == pytest.approx(0.02 * math.log(10.0), abs=1e-3)


def test_a_last_reversal_cut_short_does_not_count() -> None:
    reference = np.cos(math.pi * TIME)
    part = metrics.window(TIME, 0.0, 3.9)
    peaks = metrics.reversal_peaks(TIME[part], np.sin(TIME[part]), reference[part])
    assert [peak.time for peak in peaks] == pytest.approx([1.0, 2.0], abs=1e-4)


def test_what_leads_up_to_the_next_reversal_is_not_its_decay() -> None:
    reference = np.cos(math.pi * TIME)
    since = np.mod(TIME, 1.0)
    error = np.exp(-since / 0.01) + 0.5 * (since > 0.8)
    decays = [peak.decay for peak in metrics.reversal_peaks(TIME, error, reference)]
    assert decays == pytest.approx([0.01 * math.log(10.0)] * 9, abs=3e-4)


def test_an_error_that_stays_up_has_no_decay() -> None:
    reference = np.cos(math.pi * TIME)
    error = np.where(np.mod(TIME, 1.0) < 0.49999, 0.9, 1.0) * np.where(np.mod(TIME, 1.0) < 0.51, 1.0, 0.1)
    assert all(math.isnan(peak.decay) for peak in metrics.reversal_peaks(TIME, error, reference))


@pytest.mark.parametrize("scale", [1e-200, 1e-9, 1e200])
def test_mean_squares_neither_overflow_nor_vanish(scale: float) -> None:
    signal = scale * np.array([3.0, -4.0])
    assert metrics.rms(signal) == pytest.approx(scale * math.sqrt(12.5), rel=1e-12)
    assert metrics.std(signal) == pytest.approx(scale * 3.5, rel=1e-12)
    assert metrics.rms(0.0 * signal) == metrics.std(0.0 * signal) == 0.0


def test_no_reversal_no_peak() -> None:
    assert metrics.reversal_peaks(TIME, np.sin(TIME), TIME) == []


ANGLE = np.arange(3601) * math.radians(0.1)


def test_least_squares_circle_is_the_minimum_of_the_radial_residuals() -> None:
    rng = np.random.default_rng(7)
    angle = rng.uniform(0.0, 5.0, 200)  # not a full turn, noisy: algebraic and geometric fit differ
    x = 3.0 + 2.0 * np.cos(angle) + rng.normal(0.0, 0.1, 200)
    y = -1.0 + 2.0 * np.sin(angle) + rng.normal(0.0, 0.1, 200)

    def cost(p: np.ndarray) -> float:
        return float(np.sum((np.hypot(x - p[0], y - p[1]) - p[2]) ** 2))

    best = minimize(cost, [3.0, -1.0, 2.0], tol=1e-14, method="Nelder-Mead", options={"xatol": 1e-10, "fatol": 1e-16})
    assert metrics.least_squares_circle(x, y) == pytest.approx(tuple(best.x), abs=1e-6)


@given(st.floats(-1e-3, 1e-3), st.floats(-1e-3, 1e-3), st.floats(1e-3, 0.2))
def test_circular_deviation_does_not_see_the_centre(x_centre: float, y_centre: float, radius: float) -> None:
    lobes = 1e-6 * np.cos(3.0 * ANGLE[:-1])
    x = x_centre + (radius + lobes) * np.cos(ANGLE[:-1])
    y = y_centre + (radius + lobes) * np.sin(ANGLE[:-1])
    assert metrics.circular_deviation(x, y) == pytest.approx(2e-6, rel=2e-3)
    assert metrics.max_abs(metrics.radial_deviation(x, y, radius, (x_centre, y_centre))) == pytest.approx(
        1e-6, rel=1e-6
    )


def test_an_ellipse_has_the_difference_of_its_half_axes() -> None:
    # scales of the two axes differ by 1e-4: the classic oval of ISO 230-4
    assert metrics.circular_deviation(0.02 * np.cos(ANGLE[:-1]), 0.020002 * np.sin(ANGLE[:-1])) == pytest.approx(
        2e-6, rel=1e-4
    )


def test_two_samples_are_no_circle() -> None:
    with pytest.raises(DescriptionError, match="2 samples"):
        metrics.least_squares_circle(np.zeros(2), np.zeros(2))


def _turns(turns: float, radius: float, error_x: np.ndarray | float, error_y: np.ndarray | float, sense: float = 1.0):
    angle = np.arange(round(turns * 36000) + 1) * math.radians(0.01)
    x_ref, y_ref = radius * np.cos(angle), sense * radius * np.sin(angle)
    return angle, x_ref + error_x, y_ref + error_y, x_ref, y_ref


def test_circular_test_of_a_shrunken_shifted_circle() -> None:
    angle = np.arange(round(2.1 * 36000) + 1) * math.radians(0.01)
    x_ref, y_ref = 0.02 * np.cos(angle), 0.02 * np.sin(angle)
    found = metrics.circular_test(0.9999 * x_ref + 3e-6, 0.9999 * y_ref, x_ref, y_ref, radius=0.02)
    assert found.radial_mean == pytest.approx(-2e-6, rel=1e-3)
    assert found.radial_max == pytest.approx(1e-6, rel=1e-3)
    assert found.radial_min == pytest.approx(-5e-6, rel=1e-3)
    assert found.circular_deviation == pytest.approx(0.0, abs=1e-10)
    assert found.angle.size == 36000


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_lost_motion_of_one_axis_shows_as_steps_where_it_reverses(sense: float) -> None:
    angle = np.arange(round(2.05 * 36000) + 1) * math.radians(0.01)
    gap = 10e-6
    # play: the table lags the screw by half the gap in the sense of motion, dx/dangle = -sin
    lag = -0.5 * gap * np.sign(-np.sin(angle + 1e-9))
    _, x, y, x_ref, y_ref = _turns(2.05, 0.02, lag + 3e-6, 2e-6, sense)  # and a centre offset, which must not count
    found = metrics.circular_test(x, y, x_ref, y_ref, radius=0.02)
    assert found.reversals == pytest.approx((gap, 0.0, gap, 0.0), rel=1e-3, abs=1e-9)


def test_spikes_are_taken_at_their_quadrant_and_signed() -> None:
    heights = (5e-6, -3e-6, 2e-6, -1e-6)
    angle = np.arange(36000) * math.radians(0.01)
    deviation = np.full_like(angle, 7e-6)
    for axis, height in zip(metrics.QUADRANTS, heights, strict=True):
        deviation += height * np.exp(-(((angle - axis - math.radians(4.0)) / math.radians(1.0)) ** 2))
    assert metrics.quadrant_spikes(angle, deviation) == pytest.approx(heights, rel=1e-3)
    # a spike does not count as lost motion (a sample more on one side than on the other: 7e-5 of the offset)
    assert metrics.reversal_values(angle, deviation) == pytest.approx((0.0,) * 4, abs=1e-9)


def test_a_missing_turn_is_said() -> None:
    _, x, y, x_ref, y_ref = _turns(1.5, 0.02, 0.0, 0.0)
    with pytest.raises(DescriptionError, match=r"the path has 1\.5 turns, turn 2 is wanted: give a longer stop time"):
        metrics.circular_test(x, y, x_ref, y_ref, radius=0.02)


def test_circular_hysteresis_compares_equal_angles() -> None:
    angle = np.arange(3600) * math.radians(0.1)
    one = 1e-6 * np.cos(angle)
    other = 1e-6 * np.cos(-angle) + 4e-7  # the same path backwards, 0.4 um wider
    assert metrics.circular_hysteresis(angle, one, -angle, other) == pytest.approx(4e-7, rel=1e-6)
