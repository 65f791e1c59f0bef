"""Comparison of recordings whose differences are known in closed form."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from recordings import result

from cosim.errors import DescriptionError
from cosim.record.read import Record
from cosim.result.align import estimate_delay, pair, side_of
from cosim.result.compare import Tolerance, compare, spectrum
from cosim.result.compare_report import comparison_panels, comparison_rows, plot_comparison

Array = NDArray[np.float64]
TIME = np.arange(10_001) * 1e-3
SINE = 5e-3 * np.sin(2.0 * math.pi * TIME)


def record(time: Array, columns: dict[str, Array], **units: str) -> Record:
    return Record(Path("log.csv"), time, columns, {name: units.get(name, "") for name in columns}, {})


def run(values: Array = SINE, unit: str = "m", time: Array = TIME, name: str = "p.position") -> object:
    return result(time, {name: (values, unit)}, connections=[])


# Figures.


def test_figures_of_a_difference_of_known_shape() -> None:
    off = 1e-6 * np.cos(2.0 * math.pi * 7.0 * TIME) + 3e-7
    found = compare(run(), run(SINE + off))["p.position"]
    assert found.maximum == pytest.approx(1.3e-6, rel=1e-9)
    assert found.at == 0.0
    assert found.rms == pytest.approx(math.hypot(1e-6 / math.sqrt(2.0), 3e-7), rel=1e-3)
    assert found.mean == pytest.approx(3e-7, rel=1e-3)
    assert found.relative == pytest.approx(found.rms / (5e-3 / math.sqrt(2.0)), rel=1e-3)
    # norm(off)/norm(a) with rms of a 5e-3/sqrt(2)
    assert found.fit == pytest.approx(100.0 * (1.0 - found.rms / (5e-3 / math.sqrt(2.0))), rel=1e-6)
    assert found.unit == "m"
    assert found.spectrum is not None
    assert found.spectrum.peak_frequency == pytest.approx(7.0, rel=1e-3)
    assert found.spectrum.peak_amplitude == pytest.approx(1e-6, rel=1e-3)


def test_fit_of_the_mean_of_a_is_zero_and_of_a_itself_a_hundred() -> None:
    assert compare(run(), run(np.full_like(SINE, np.mean(SINE))))["p.position"].fit == pytest.approx(0.0, abs=1e-9)
    assert compare(run(), run())["p.position"].fit == 100.0


def test_a_reference_that_does_not_vary_has_no_fit() -> None:
    found = compare(run(np.ones_like(TIME)), run())
    assert math.isnan(found["p.position"].fit)
    rows = {row.name: row for row in comparison_rows(found)}
    assert rows["p.position: fit (NRMSE)"].reason == "stage.toml (1) does not vary"


def test_spectrum_of_white_noise_integrates_to_its_variance() -> None:
    noise = np.random.default_rng(1).normal(0.0, 2.0, 100_000)
    found = spectrum(np.arange(noise.size) * 1e-3, noise)
    assert np.median(found.density) == pytest.approx(2.0 / math.sqrt(500.0), rel=0.05)  # flat up to 500 Hz
    step = found.frequency[1] - found.frequency[0]
    assert np.sum(found.density**2) * step == pytest.approx(4.0, rel=0.02)


def test_a_sample_that_is_not_finite_has_no_figure_and_is_outside() -> None:
    values = SINE.copy()
    values[17] = math.nan
    found = compare(run(), run(values), tolerance=Tolerance(absolute=1.0))
    entry = found["p.position"]
    assert math.isnan(entry.maximum)
    assert entry.outside is not None
    assert (entry.outside.count, entry.outside.first) == (1, TIME[17])
    assert not found.within
    assert comparison_rows(found)[0].reason == "a signal is not finite everywhere"


# Names and units.


def test_units_are_converted_and_said() -> None:
    found = compare(run(), record(TIME, {"x": 1e3 * SINE}, x="mm"), {"p.position": "x"})
    assert found["p.position"].maximum < 1e-17
    assert "log.csv: x is converted from mm to m." in found.notes


def test_temperatures_are_converted_with_their_zero() -> None:
    found = compare(run(SINE + 300.0, "K"), run(SINE + 26.85, "degC"))
    assert found["p.position"].maximum < 1e-12


def test_a_unit_that_is_not_said_is_taken_from_the_other_side_and_said() -> None:
    found = compare(run(), record(TIME, {"x": SINE}), {"p.position": "x"})
    assert found["p.position"].unit == "m"
    assert "log.csv: x says no unit: taken as m." in found.notes


def test_units_of_different_kinds_are_refused_together_with_names_that_are_missing() -> None:
    with pytest.raises(DescriptionError) as caught:
        compare(run(), record(TIME, {"x": SINE}, x="N"), {"p.position": "x", "p.positon": "x"})
    assert len(caught.value.problems) == 2
    assert "stage.toml: p.position in m and log.csv: x in N are of different kinds" in caught.value.problems[0]
    assert "Did you mean 'p.position'?" in caught.value.problems[1]


def test_without_common_names_the_mapping_is_asked_for() -> None:
    with pytest.raises(DescriptionError, match="say which belong together, as NAME=OTHER"):
        compare(run(), record(TIME, {"x": SINE}))


# Times.


def test_the_coarser_side_keeps_its_samples() -> None:
    coarse = TIME[::10]
    line = 2.0 * TIME
    found = compare(run(line), run(2.0 * coarse, time=coarse), labels=("a", "b"))
    assert found["p.position"].time.tolist() == coarse.tolist()
    assert found["p.position"].maximum < 1e-14
    assert found.how == "a (every 0.001 s) interpolated linearly at the 1001 times of b, 0 s to 10 s"
    other = compare(run(2.0 * coarse, time=coarse), run(line), labels=("a", "b"))
    assert other.how == "b (every 0.001 s) interpolated linearly at the 1001 times of a, 0 s to 10 s"


def test_held_signals_are_held() -> None:
    """A staircase sampled between its steps: linear would round the corners."""
    stairs = np.floor(TIME / 0.1 + 1e-9)
    between = np.arange(0.05, 9.9, 0.1)
    expected = np.floor(between / 0.1 + 1e-9)
    found = compare(run(expected, time=between), run(stairs), interpolation="hold")
    assert found["p.position"].maximum == 0.0


def test_times_written_with_fewer_digits_are_the_same_times() -> None:
    found = compare(run(), run(time=TIME + 1e-10))
    assert found.how.startswith("both at the same 10001 times")
    assert found["p.position"].maximum == 0.0


def test_only_the_common_part_within_the_window_counts() -> None:
    found = compare(run(), run(SINE[2000:6000], time=TIME[2000:6000]), start=3.0, stop=4.0)
    assert (found["p.position"].time[0], found["p.position"].time[-1]) == (3.0, 4.0)


def test_clocks_that_do_not_meet_are_told() -> None:
    with pytest.raises(DescriptionError, match="have no two times in common"):
        compare(run(), run(time=TIME + 1000.0))


@pytest.mark.parametrize("lag", [3.7e-3, -0.1234567, 0.0])
def test_delay_is_estimated_between_samples(lag: float) -> None:
    chirp = np.sin(3.0 * TIME**2)
    later = np.sin(3.0 * np.maximum(TIME - lag, 0.0) ** 2) if lag > 0 else np.sin(3.0 * (TIME - lag) ** 2)
    found = compare(run(chirp), run(later + 0.3))
    # A hundredth of a sample; the chirp's last period has 105 samples.
    assert found.estimated_delay == pytest.approx(lag, abs=1e-5)
    assert found.delay == 0.0
    said = [note for note in found.notes if "as it fits best" in note]
    assert len(said) == (lag != 0.0)


def test_gain_and_offset_are_no_delay() -> None:
    found = compare(run(np.sin(TIME)), run(2.0 * np.sin(TIME) + 0.3))
    assert found.estimated_delay == pytest.approx(0.0, abs=1e-6)
    assert not [note for note in found.notes if "fits best" in note]


def test_ramps_fit_at_every_delay_and_none_is_said() -> None:
    found = compare(run(3.0 * TIME), run(3.0 * TIME + 0.5))
    assert found.estimated_delay == 0.0
    assert found.notes == ()


def test_delay_beyond_the_common_time_is_found_when_it_is_asked_for() -> None:
    chirp = np.sin(3.0 * TIME**2)
    found = compare(run(chirp), run(chirp, time=TIME + 1000.0004), delay="estimate")
    assert found.delay == pytest.approx(1000.0004, abs=1e-6)
    assert found["p.position"].rms < 1e-5
    assert "stage.toml (2) is moved back by 1000 s before it is compared." in found.notes


def test_two_rests_that_meet_are_no_fit() -> None:
    """A step late in one and early in the other: only the lag that joins the steps counts."""
    one, other = (TIME >= 8.0) * 1.0, (TIME >= 2.0) * 1.0
    pairs = pair(side_of(run(one), "a"), side_of(run(other), "b"), None)
    assert estimate_delay(pairs, everywhere=True) == pytest.approx(-5.0, abs=1.01)
    found = estimate_delay(pair(side_of(run(one), "a"), side_of(run((TIME >= 7.0) * 1.0), "b"), None), everywhere=True)
    assert found == pytest.approx(-1.0, abs=2e-3)


def test_a_given_delay_is_taken_out() -> None:
    found = compare(run(), run(5e-3 * np.sin(2.0 * math.pi * (TIME - 0.25))), delay=0.25)
    assert found["p.position"].maximum < 1e-15
    assert found["p.position"].time[-1] == 9.75


def test_signals_that_do_not_vary_have_no_delay() -> None:
    constant = run(np.ones_like(TIME))
    assert math.isnan(compare(constant, constant).estimated_delay)
    with pytest.raises(DescriptionError, match="cannot be estimated"):
        compare(constant, constant, delay="estimate")


# Tolerances.


def test_tube_of_an_absolute_tolerance() -> None:
    off = np.where(np.abs(TIME - 5.0) < 0.0105, 2e-6, 0.5e-6)
    found = compare(run(), run(SINE + off), tolerance={"p.position": Tolerance(absolute=1e-6)})
    outside = found["p.position"].outside
    assert outside is not None
    assert (outside.count, outside.first) == (21, TIME[4990])
    assert outside.excess == pytest.approx(1e-6, rel=1e-6)
    assert outside.share == 21 / TIME.size
    assert compare(run(), run(SINE + off), tolerance=Tolerance(absolute=2.001e-6)).within


def test_relative_tolerance_is_of_the_range_of_a() -> None:
    assert compare(run(), run(SINE + 9.9e-6), tolerance=Tolerance(relative=1e-3)).within
    assert not compare(run(), run(SINE + 10.1e-6), tolerance=Tolerance(relative=1e-3)).within


def test_tolerance_of_time_takes_a_late_edge_but_no_later_one() -> None:
    edge = (TIME >= 5.0) * 1.0
    late = (TIME >= 5.02) * 1.0
    assert compare(run(edge), run(late), tolerance=Tolerance(time=0.0205)).within
    found = compare(run(edge), run(late), tolerance=Tolerance(time=0.0105))
    outside = found["p.position"].outside
    assert outside is not None
    assert outside.first == pytest.approx(5.011, abs=1.1e-3)


def test_tube_of_time_agrees_with_a_plain_search() -> None:
    values = np.random.default_rng(3).normal(size=300)
    time = np.cumsum(np.random.default_rng(4).uniform(0.5e-3, 1.5e-3, 300))
    width = 4.2e-3
    found = compare(run(values, time=time), run(values, time=time), tolerance=Tolerance(time=width))["p.position"]
    assert found.tube is not None
    for k in range(300):
        inside = values[np.abs(time - time[k]) <= width]
        ends = np.interp([time[k] - width, time[k] + width], time, values)
        assert found.tube[0][k] == min(*inside, *ends)
        assert found.tube[1][k] == max(*inside, *ends)


def test_wrong_tolerances_are_refused() -> None:
    with pytest.raises(DescriptionError, match=r"'p\.x' is not compared"):
        compare(run(), run(), tolerance={"p.x": Tolerance(1.0)})
    with pytest.raises(DescriptionError, match="not negative"):
        compare(run(), run(), tolerance=Tolerance(-1.0))


# Loops and pictures.


def test_difference_of_the_tracking_errors() -> None:
    """Both follow references of their own: the errors differ by less than the positions."""

    def loop(reference: Array, error: Array) -> object:
        return result(
            TIME,
            {"t.position": (reference, "m"), "p.position": (reference + error, "m")},
            connections=["t.position -> c.position_ref", "p.position -> c.position"],
        )

    found = compare(loop(SINE, 1e-6 * np.ones_like(TIME)), loop(1.1 * SINE, 3e-6 * np.ones_like(TIME)))
    (tracking,) = found.tracking
    assert (tracking.rms_a, tracking.rms_b) == (pytest.approx(1e-6, rel=1e-6), pytest.approx(3e-6, rel=1e-6))
    assert (tracking.rms, tracking.maximum) == (pytest.approx(2e-6, rel=1e-6), pytest.approx(2e-6, rel=1e-6))


def test_a_record_gets_its_loop_from_the_run() -> None:
    reference = result(
        TIME,
        {"t.position": (SINE, "m"), "p.position": (SINE + 1e-6, "m")},
        connections=["t.position -> c.position_ref", "p.position -> c.position"],
    )
    log = record(TIME, {"r": 1e3 * SINE, "x": 1e3 * (SINE + 4e-6)}, r="mm", x="mm")
    found = compare(log, reference, {"r": "t.position", "x": "p.position"})
    (tracking,) = found.tracking
    assert tracking.unit == "mm"
    assert (tracking.rms_a, tracking.rms_b, tracking.rms) == (
        *(pytest.approx(4e-3, rel=1e-6), pytest.approx(1e-3, rel=1e-6), pytest.approx(3e-3, rel=1e-6)),
    )


def test_picture_shows_both_the_difference_and_the_tube(tmp_path: Path) -> None:
    found = compare(run(), run(SINE + 1e-6), tolerance=Tolerance(absolute=2e-6), labels=("log", "model"))
    both, difference = comparison_panels(found)
    assert [line.label for line in both.series] == ["log", "model"]
    assert [line.label for line in difference.series] == ["model minus log", "tolerance", ""]
    assert difference.series[1].y == pytest.approx(np.full_like(TIME, -2e-6))
    plot_comparison(found, tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")


def test_of_many_signals_those_that_differ_most_are_drawn() -> None:
    names = [f"p.x{i}" for i in range(20)]
    one = result(TIME, dict.fromkeys(names, (SINE, "m")), connections=[])
    other = result(TIME, {name: (SINE * (1.0 + 1e-3 * i), "m") for i, name in enumerate(names)}, connections=[])
    panels = comparison_panels(compare(one, other))
    assert [panel.heading for panel in panels[::2]] == names[-8:]
