"""Learning of friction pulses on the FMUs, against tables that an independent loop has learned (feng2015)."""

from __future__ import annotations

import tomllib
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim.design.pulse import (
    ACCELERATIONS,
    RELEARN,
    SHARES,
    Learned,
    Tables,
    best_spread,
    coarse_grid,
    learn_friction_pulse,
    load,
    monitor,
    peak_time,
    plot_learned,
    regression,
    save,
    write_start,
)
from cosim.design.reversals import Axis, AxisRuns, reversal, reversal_errors
from cosim.design.workers import unload
from cosim.errors import DescriptionError
from cosim.master.simulation import simulate
from cosim.result import metrics
from cosim.result.result import Result
from cosim.system.system import read_system

FENG = Path(__file__).parents[2] / "studies" / "feng2015"
FINE_STEP = 0.036e-3  # m/s
PUBLISHED = {"x": (0.38e-3, 0.56e-3, 0.812e-3, 0.848e-3), "y": (0.38e-3, 0.776e-3, 1.028e-3, 1.136e-3)}
"""Amplitudes in m/s at 2, 10, 40, 120 mm/s2 of the first independent simulation."""


@cache
def learned(native: Path, axis: str) -> Learned:
    return learn_friction_pulse(FENG / "circle.toml", axis, fmus=native)


@cache
def independent(axis: str) -> dict[str, Any]:
    return tomllib.loads((FENG / "learned.toml").read_text(encoding="utf-8"))[axis]["nominal"]


@pytest.mark.parametrize("axis", ["x", "y"])
def test_learned_pulses_are_those_of_the_independent_loop(native: Path, axis: str) -> None:
    found, expected = learned(native, axis), independent(axis)
    assert found.t_c == pytest.approx(expected["t_c"], rel=0.01)
    step = np.array(expected["t_c"]) / 8.0
    assert np.all(np.abs(found.durations - expected["duration"]) <= step)
    assert np.all(np.diff(found.durations) < 0.0)
    assert found.accelerations == pytest.approx(expected["acceleration"])
    assert np.max(np.abs(found.amplitudes - expected["amplitude"])) <= 2.0 * FINE_STEP + 1e-12
    assert found.costs == pytest.approx(expected["cost"], rel=0.03)
    for acceleration, amplitude in zip(ACCELERATIONS, PUBLISHED[axis], strict=True):
        at = int(np.argmin(np.abs(found.accelerations - acceleration)))
        assert found.amplitudes[at] == pytest.approx(amplitude, abs=2.0 * FINE_STEP)


@pytest.mark.parametrize("axis", ["x", "y"])
def test_every_stage_has_its_number_of_runs(native: Path, axis: str) -> None:
    assert dict(learned(native, axis).runs) == {"peak": 4, "duration": 360, "coarse": 143, "fine": 275}


def test_threads_change_nothing(native: Path) -> None:
    alone, shared = learned(native, "x"), learn_friction_pulse(FENG / "circle.toml", "x", fmus=native, workers=2)
    assert np.array_equal(alone.costs, shared.costs)
    assert np.array_equal(alone.tables.amplitude, shared.tables.amplitude)


def test_runs_from_the_reversal_are_runs_from_the_start(native: Path) -> None:
    """The same reversal run as a whole, the pulse given as a start value, gives the same error bit by bit."""
    with AxisRuns(read_system(FENG / "circle.toml", fmus=native), Axis.named("x")) as runs:
        job = 10e-3, [(0.0, 0.0), (0.5e-3, 0.08)], 0.3
        plain, pushed = runs.errors([job])[0]
        here = reversal_errors(runs.given, job)
        checkpoint = reversal(runs.given, 10e-3)
        names = [".".join(end) for end in checkpoint.system.record]
    unload()
    assert np.array_equal(pushed, here[1])
    whole = simulate(checkpoint.system.changed({"pulse_x.A": 0.5e-3, "pulse_x.T": 0.08}))
    error = whole[names[0]] - whole[names[1]]
    assert np.array_equal(pushed, error[checkpoint.point : checkpoint.point + pushed.size])
    assert np.max(np.abs(pushed)) < 0.7 * np.max(np.abs(plain))


def test_start_at_speed_has_no_transient(native: Path) -> None:
    """The error stays below a um; with an empty integrator friction makes many um of it."""
    with AxisRuns(read_system(FENG / "circle.toml", fmus=native), Axis.named("x")) as runs:
        checkpoint = reversal(runs.given, 40e-3)
    unload()
    empty = simulate(checkpoint.system.changed({"controller_x.integral_start": 0.0}, stop_time=0.1)).rows
    steady, transient = (np.max(np.abs(rows[:400, 0] - rows[:400, 1])) for rows in (checkpoint.result.rows, empty))
    assert steady < 0.8e-6
    assert transient > 3e-6


def test_changed_friction_is_noticed_and_learned_anew(native: Path) -> None:
    nominal = learned(native, "x")
    same = monitor(FENG / "circle.toml", nominal, "x", fmus=native)
    assert [point.ratio for point in same] == pytest.approx([1.0] * 4)
    for scale in (1.3, 0.7):
        found = monitor(FENG / "circle.toml", nominal, "x", overrides={"plant_x.friction_scale": scale}, fmus=native)
        assert min(point.ratio for point in found) > RELEARN
    anew = learn_friction_pulse(FENG / "circle.toml", "x", overrides={"plant_x.friction_scale": 1.3}, fmus=native)
    assert np.all(anew.nominal < 1.3 * nominal.nominal)
    assert np.all(anew.tables.amplitude >= nominal.tables.amplitude - 1e-6)


# On circles, with the tables learned


def reductions(off: Result, on: Result, axis: str, seconds: float, which: int) -> dict[str, float]:
    """Reduction of peak, rms and mean of the error of an axis after a reversal, and of the contour's peak."""
    begin = float(metrics.reversal_times(off.time, off[f"trajectory_{axis}.position"])[which])
    found: dict[str, list[float]] = {}
    for result in (off, on):
        part = metrics.window(result.time, begin, begin + seconds)
        error = (result[f"plant_{axis}.position"] - result[f"trajectory_{axis}.position"])[part]
        contour = np.hypot(result["plant_x.position"], result["plant_y.position"])[part] - 0.025
        values = {"peak": error, "contour": contour}
        for name, signal in values.items():
            found.setdefault(name, []).append(metrics.max_abs(signal))
        found.setdefault("rms", []).append(metrics.rms(error))
        found.setdefault("mean", []).append(float(np.mean(np.abs(error))))
    return {name: 1.0 - after / before for name, (before, after) in found.items()}


@pytest.mark.parametrize("feed", [500, 1000, 2000, 3000])
def test_learned_pulses_reduce_quadrant_errors(native: Path, tmp_path: Path, feed: int) -> None:
    (tmp_path / "circle.toml").write_bytes((FENG / "circle.toml").read_bytes())
    both = {f"pulse_{axis}": learned(native, axis) for axis in "xy"}
    write_start(both, tmp_path / "tables.toml", base="circle.toml")
    speed = feed / 60e3
    overrides = {f"trajectory_{axis}.feed": speed for axis in "xy"}
    # Half a turn and a little more: Y reverses at 90, X at 180 degrees.
    stop = round((np.pi * 0.025 * 1.3) / speed + speed / 0.2, 2)
    off, on = (
        simulate(read_system(tmp_path / name, overrides, fmus=native, stop_time=stop))
        for name in ("circle.toml", "tables.toml")
    )
    for axis, which in (("x", 1), ("y", 0)):
        seconds = both[f"pulse_{axis}"].monitoring_time(speed**2 / 0.025)
        found = reductions(off, on, axis, seconds, which)
        assert min(found.values()) >= 0.54, (axis, found)
        assert found["rms"] >= 0.75, (axis, found)


# Parts


def test_grids() -> None:
    grid = coarse_grid()
    assert grid.size == 13
    assert np.diff(grid) == pytest.approx([2e-3] * 4 + [7.5e-3] * 4 + [20e-3] * 4)
    assert len(SHARES) == 9
    assert (SHARES[0], SHARES[4], SHARES[-1]) == (0.5, 1.0, 1.5)


def test_peak_of_rounded_errors() -> None:
    at = np.arange(400)
    smooth = -10e-6 * np.exp(-(((at - 180.3) / 60.0) ** 2))
    assert peak_time(smooth) == pytest.approx(180.3, abs=0.01)
    assert peak_time(1e-7 * np.round(smooth / 1e-7)) == pytest.approx(180.3, abs=1.0)
    with pytest.raises(DescriptionError, match="no friction"):
        peak_time(np.zeros(100))


def test_regression_keeps_constants_and_interpolates_with_a_small_spread() -> None:
    points = np.geomspace(2e-3, 120e-3, 9)
    assert regression(np.array([5e-3, 1.0]), points, np.full(9, 3.0), 0.3) == pytest.approx([3.0, 3.0])
    values = np.arange(9.0)
    assert regression(points, points, values, 1e-3) == pytest.approx(values)
    # Halfway between two points, their mean; the others are too far to count.
    between = np.array([np.sqrt(points[3] * points[4])])
    assert regression(between, points, values, 0.05) == pytest.approx([3.5])


def test_spread_is_that_of_the_independent_search(native: Path) -> None:
    expected = independent("y")
    found = best_spread(np.array(expected["acceleration"]), np.array(expected["amplitude"]))
    assert found == pytest.approx(expected["spread"], rel=1e-6)


def test_tables_hold_their_ends() -> None:
    tables = Tables(np.array([1.0, 2.0]), np.array([3.0, 5.0]), np.array([0.2, 0.1]))
    assert tables.at(1.5) == pytest.approx((4.0, 0.15))
    assert tables.at(0.1) == (3.0, 0.2)
    assert tables.at(9.0) == (5.0, 0.1)


def test_what_was_learned_is_kept(native: Path, tmp_path: Path) -> None:
    found = learned(native, "x")
    save(found, tmp_path / "x.json")
    again = load(tmp_path / "x.json")
    assert np.array_equal(again.tables.amplitude, found.tables.amplitude)
    assert np.array_equal(again.nominal, found.nominal)
    assert again.monitoring_time(10e-3) == found.monitoring_time(10e-3)
    plot_learned({"x": found}, tmp_path / "x.png")
    assert (tmp_path / "x.png").stat().st_size > 5000
    (tmp_path / "bad.json").write_text("{}", encoding="utf-8")
    with pytest.raises(DescriptionError, match="holds nothing learned"):
        load(tmp_path / "bad.json")


def test_wrong_names_are_said(native: Path) -> None:
    with pytest.raises(DescriptionError, match="Did you mean"):
        learn_friction_pulse(FENG / "circle.toml", "z", fmus=native)
    with pytest.raises(DescriptionError, match="not connected"):
        learn_friction_pulse(
            FENG / "circle.toml", Axis("trajectory_x", "pulse_y", "controller_x", "plant_x"), fmus=native
        )
    with pytest.raises(DescriptionError, match=r"write plant\.VARIABLE"):
        learn_friction_pulse(FENG / "circle.toml", Axis.named("x", position="angle"), fmus=native)
