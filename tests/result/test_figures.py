"""Figures of merit: each in its loop's unit, from the last change of the reference, or with the reason why not."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from cosim.errors import DescriptionError
from cosim.result import metrics
from cosim.result.summary import not_finite, summary, tracking

Array = NDArray[np.float64]


@dataclass
class Recording:
    """A run of one loop, or of two with ``axes``."""

    time: Array
    columns: Mapping[str, Array]
    units: Mapping[str, str]
    connections: Sequence[str] = ("t.position -> c.position_ref", "p.position -> c.position")
    transformations: Mapping[str, Sequence[float]] = field(default_factory=dict)

    @property
    def names(self) -> Sequence[str]:
        return tuple(self.columns)

    @property
    def metadata(self) -> Mapping[str, Any]:
        return {"connections": self.connections, "transformations": self.transformations}

    def unit(self, name: str) -> str:
        return self.units[name]

    def __getitem__(self, name: str, /) -> Array:
        return self.columns[name]


TIME = np.arange(1001) * 1e-3


def loop(reference: Array, position: Array, unit: str = "m", **more: Any) -> Recording:
    columns = {"t.position": reference, "p.position": position}
    return Recording(TIME, columns, dict.fromkeys(columns, unit), **more)


def rows(recording: Recording) -> dict[str, Any]:
    return {row.name: row for row in summary(recording)}


@pytest.mark.parametrize(
    ("unit", "shown", "value"), [("m", "um", 2e6), ("mm", "um", 2e3), ("rad", "rad", 2.0), ("deg", "deg", 2.0)]
)
def test_figures_have_the_unit_of_their_loop(unit: str, shown: str, value: float) -> None:
    found = rows(loop(np.zeros_like(TIME), np.full_like(TIME, 2.0), unit))
    row = found["Position error, at the end"]
    assert (row.value, row.unit) == (pytest.approx(value), shown)


def test_units_that_only_a_file_knows_are_told_as_they_are() -> None:
    assert rows(loop(np.zeros_like(TIME), np.ones_like(TIME), "widget"))["Position error, at the end"].unit == "widget"


def test_signals_of_two_units_are_compared_as_the_controller_sees_them() -> None:
    recording = Recording(
        TIME,
        {"t.position": np.full_like(TIME, 90.0), "p.position": np.full_like(TIME, 1.5)},
        {"t.position": "deg", "p.position": "rad"},
        transformations={"t.position -> c.position_ref": (math.pi / 180.0, 0.0)},
    )
    row = rows(recording)["Position error, at the end"]
    assert (row.value, row.unit) == (pytest.approx(1.5 - math.pi / 2), "rad")
    recording.transformations = {
        "t.position -> c.position_ref": (2.0, 1.0),
        "p.position -> c.position": (10.0, 3.0),
    }
    assert rows(recording)["Position error, at the end"].value == pytest.approx(1.5 - (2.0 * 90.0 + 1.0 - 3.0) / 10.0)
    recording.transformations = {}
    (missing,) = summary(recording)
    assert missing.reason == "t.position in deg and p.position in rad differ in unit"


def test_a_position_without_unit_has_that_of_its_reference() -> None:
    """Many foreign FMUs state no units; both signals reach the controller as they are."""
    columns = {"t.position": np.full_like(TIME, 90.0), "p.position": np.full_like(TIME, 1.5)}
    row = rows(Recording(TIME, columns, {"t.position": "deg", "p.position": "1"}))["Position error, at the end"]
    assert (row.value, row.unit) == (pytest.approx(1.5 - 90.0), "deg")


# Steps


def response(start: float, tau: float, since: float) -> Array:
    return np.where(start > TIME, 0.0, 1.0 - np.exp(-np.maximum(TIME - start, 0.0) / tau)) * since


@pytest.mark.parametrize("start", [0.0, 0.1, 0.4, 0.6])
@pytest.mark.parametrize("unit", ["m", "rad"])
def test_settling_counts_from_the_last_change_of_the_reference(start: float, unit: str) -> None:
    reference = np.where(start - 1e-9 <= TIME, 1.0, 0.0)
    found = rows(loop(reference, response(start, 0.05, 1.0), unit))
    assert found["Settling into 2 % of the step"].value == pytest.approx(50.0 * math.log(50.0), abs=1.0)
    assert found["Overshoot"].value == 0.0


def test_the_last_of_two_steps_is_judged() -> None:
    reference = np.where(TIME >= 0.5 - 1e-9, 3.0, np.where(TIME >= 0.1 - 1e-9, 1.0, 0.0))
    position = response(0.1, 0.02, 1.0) + response(0.5, 0.02, 2.0)
    position[600] = 3.5
    found = rows(loop(reference, position))
    assert found["Settling into 2 % of the step"].value == pytest.approx(101.0, abs=1e-6)
    assert found["Overshoot"].value == pytest.approx(0.5e6)


def test_a_smooth_motion_is_one_step() -> None:
    reference = np.clip((TIME - 0.2) / 0.3, 0.0, 1.0)
    lag = np.clip((TIME - 0.3) / 0.3, 0.0, 1.0)  # 0.1 s late: within 2 % at 0.594 s
    found = rows(loop(reference, lag))
    assert found["Settling into 2 % of the step"].value == pytest.approx(94.0, abs=1.01)


def test_a_position_that_does_not_arrive_never_settles() -> None:
    row = rows(loop(np.ones_like(TIME), 0.5 * TIME))["Settling into 2 % of the step"]
    assert math.isnan(row.value)
    assert row.reason == "never: outside at the end"


def test_a_reference_that_moves_at_the_end_has_no_step() -> None:
    found = rows(loop(np.sin(TIME), np.sin(TIME)))
    assert "Overshoot" not in found


@pytest.mark.parametrize("rest", [0, 100])
@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_a_reference_that_goes_beyond_its_end_is_no_overshoot(rest: int, sense: float) -> None:
    """Out to 10 and back to 5, with a rest between them or without: the last move is the step."""
    reference = sense * np.interp(TIME, (0.2, 0.4, 0.4 + 1e-3 * rest, 0.6, 1.0), (0.0, 10.0, 10.0, 5.0, 5.0))
    assert rows(loop(reference, reference))["Overshoot"].value == 0.0
    position = reference.copy()
    position[650] -= 0.3 * sense
    found = rows(loop(reference, position, "rad"))
    assert found["Overshoot"].value == pytest.approx(0.3)
    assert found["Settling into 2 % of the step"].value == pytest.approx(51.0)


@pytest.mark.parametrize(
    ("reference", "offset", "peak"),
    [(0.3, 2.0**-54, 0.0), (0.0, 1e-15, 1e-6), (0.3, 2.0**-54, 1e-3)],
)
def test_a_start_off_the_reference_by_rounding_is_no_step(reference: float, offset: float, peak: float) -> None:
    position = reference + offset + peak * np.exp(-(((TIME - 0.5) / 0.05) ** 2))
    assert position[0] != reference
    assert "Settling into 2 % of the step" not in rows(loop(np.full_like(TIME, reference), position))


def test_rounding_of_a_reference_is_no_motion() -> None:
    reference = np.where(TIME >= 0.4 - 1e-9, 0.1, 0.0)
    reference[500:900:2] = 0.1 + 2.0**-56
    found = rows(loop(reference, response(0.4, 0.05, 0.1)))
    assert found["Settling into 2 % of the step"].value == pytest.approx(50.0 * math.log(50.0), abs=1.0)


# Reasons


def test_what_is_not_recorded_is_told() -> None:
    recording = loop(np.zeros_like(TIME), np.zeros_like(TIME))
    recording.columns = {"t.position": recording.columns["t.position"]}
    (row,) = summary(recording)
    assert (row.name, row.reason) == ("Position error", "p.position was not recorded: add it with --record")


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("signal", ["t.position", "p.position"])
def test_no_figure_comes_from_values_that_are_not_finite(wrong: float, signal: str) -> None:
    recording = loop(np.ones_like(TIME), response(0.0, 0.05, 1.0))
    recording.columns[signal][600:] = wrong
    (row,) = summary(recording)
    assert row.reason == f"{signal} is not finite from 0.6 s on"
    assert not_finite(recording) == {signal: 0.6}
    assert all(math.isnan(value) for value in tracking(recording, (0.0, 1.0)).values())


def test_a_command_that_is_not_finite_leaves_the_errors() -> None:
    recording = loop(np.ones_like(TIME), np.ones_like(TIME))
    command = np.ones_like(TIME)
    command[-1] = math.nan
    recording = replace(
        recording, columns={**recording.columns, "c.command": command}, units={**recording.units, "c.command": "N"}
    )
    found = rows(recording)
    assert found["Position error, at the end"].value == 0.0
    assert found["Command"].reason == "c.command is not finite from 1 s on"


def circle(decimation: int, unit: str = "m", turns: float = 2.25) -> Recording:
    angle = np.linspace(0.0, 2.0 * math.pi * turns, 20001)[::decimation]
    columns = {"tx": np.cos(angle), "px": 1.001 * np.cos(angle), "ty": np.sin(angle), "py": np.sin(angle)}
    columns = {f"{name}.position": values for name, values in columns.items()}
    connections = [
        f"{a}{axis}.position -> c{axis}.position{end}" for axis in "xy" for a, end in (("t", "_ref"), ("p", ""))
    ]
    return Recording(angle, columns, dict.fromkeys(columns, unit), connections)


def test_a_circle_sampled_too_coarsely_says_so() -> None:
    fine, coarse = rows(circle(1)), rows(circle(2000))
    assert fine["Circular deviation G, turn 2"].value == pytest.approx(1e3, rel=1e-3)
    assert fine["Circular deviation G, turn 2"].unit == "um"
    assert coarse["Circular test"].reason == "less than 8 samples a turn were recorded: take a smaller decimation"
    assert coarse["cx: Position error, at the end"].unit == "um"
    middling = rows(circle(1000))
    assert middling["Circular test"].reason.startswith("too few samples were recorded: no sample from")
    assert rows(circle(1, "rad"))["Circular deviation G, turn 2"].unit == "rad"


@pytest.mark.parametrize("centre", [(-1.0, 0.0), (3.0, 4.0), (1e-3, -2e-3)])
def test_a_circle_may_have_its_centre_anywhere(centre: tuple[float, float]) -> None:
    plain, moved = circle(1), circle(1)
    moved.columns = {n: v + centre["xy".index(n[1])] for n, v in moved.columns.items()}
    expected, found = rows(plain), rows(moved)
    assert "Radial deviation F_max, turn 2" in found
    for name, row in expected.items():
        assert found[name].value == pytest.approx(row.value, abs=1e-6), name  # um, on a radius of 1 m


def test_axes_in_different_lengths_have_a_path() -> None:
    plain, mixed = circle(1), circle(1)
    mixed.columns = {n: v * 1e3 if n[1] == "y" else v for n, v in mixed.columns.items()}
    mixed.units = {n: "mm" if n[1] == "y" else "m" for n in mixed.columns}
    expected, found = rows(plain), rows(mixed)
    assert "Contour error, maximum of the whole run" in found
    for name, row in expected.items():
        assert found[name].value == pytest.approx(row.value, abs=1e-6), name
    mixed.units = {n: "rad" if n[1] == "y" else "m" for n in mixed.columns}
    assert not any(name.startswith(("Contour", "Circular")) for name in rows(mixed))


def test_a_circle_that_is_not_whole_says_so() -> None:
    reason = "the circle has 0.9 turns, one is needed: take a later stop time"
    assert rows(circle(1, turns=0.9))["Circular test"].reason == reason
    assert "Circular test" not in rows(circle(1, turns=0.25))  # an arc, and no circle cut short


def test_a_run_of_one_row_has_no_window_for_a_variation() -> None:
    columns = {"t.position": np.ones(1), "p.position": np.ones(1), "c.command": np.ones(1)}
    found = rows(Recording(np.zeros(1), columns, {**dict.fromkeys(columns, "m"), "c.command": "N"}))
    assert found["Position error, at the end"].value == 0.0
    assert found["Command, total variation from 0 s"].reason == "1 samples in the window: give one with at least 2."
    assert summary(Recording(np.zeros(0), {name: v[:0] for name, v in columns.items()}, {})) == []


# Metrics


@pytest.mark.parametrize("wrong", [math.nan, math.inf])
def test_metrics_of_values_that_are_not_finite(wrong: float) -> None:
    signal = np.ones_like(TIME)
    signal[500] = wrong
    for value in (
        metrics.max_abs(signal),
        metrics.rms(signal),
        metrics.std(signal),
        metrics.steady_value(TIME, signal, 0.8),
        metrics.total_variation(TIME, signal),
        metrics.overshoot(signal, 0.0, 1.0),
        metrics.rise_time(TIME, signal, start=0.0, final=1.0),
        metrics.sine_amplitude(TIME, signal, 1.0),
    ):
        assert math.isnan(value)
    assert metrics.settling_time(TIME, signal, 1.0, 0.1) == pytest.approx(0.501)
    signal[-1] = wrong
    assert math.isnan(metrics.settling_time(TIME, signal, 1.0, 0.1))
    for test in (
        lambda: metrics.reversal_times(TIME, signal),
        lambda: metrics.least_squares_circle(signal, signal),
        lambda: metrics.circular_test(signal, signal, signal, signal, radius=1.0),
    ):
        with pytest.raises(DescriptionError, match="not finite"):
            test()


@pytest.mark.parametrize("target", ["c.position_ref", "c.position"])
def test_a_loop_whose_signals_are_sums_has_no_figures(target: str) -> None:
    time = np.linspace(0.0, 1.0, 11)
    columns = dict.fromkeys(("t.position", "p.position", "log.d"), time)
    connections = (*Recording.connections, f"log.d -> {target}")
    (row,) = summary(Recording(time, columns, dict.fromkeys(columns, "m"), connections))
    assert row.reason == f"{target} is a sum, not one recorded signal"
