"""Tuning: a parameter whose best value is known, limits, failing runs, threads, files."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from fmu_files import write_probe

from cosim.design.tune import Trial, Tuned, Tuning, make_tuning, read_tuning, tune, write_start
from cosim.errors import DescriptionError
from cosim.system.system import read_system

STUDY = Path(__file__).parents[2] / "studies" / "maeda2008"
METRICS = {
    "end": {"of": "last", "signal": "plant.position"},
    "swing": {"of": "peak_to_peak", "signal": "plant.position"},
}


@pytest.fixture
def make(native: Path) -> Callable[..., Tuning]:
    """Tunings of the linear stage, driven by the reference alone: its position is velocity*time."""

    def made(**more: Any) -> Tuning:
        document: dict[str, Any] = {
            "system": "nominal.toml",
            "experiment": {"stop_time": 0.1},
            "parameters": {"controller.K_P": {"from": 10.0, "to": 800.0, "log": True}},
            "objective": "error_rms",
            "generations": 6,
            "population": 8,
        }
        return make_tuning({**document, **more}, folder=STUDY, fmus=native)

    return made


def test_the_best_of_a_scan_is_found(make: Callable[..., Tuning], native: Path) -> None:
    """The gain with the least rms error, against a fine scan."""
    from cosim.master.simulation import Simulation
    from cosim.result.summary import tracking

    tuned = tune(make(generations=12))
    system = read_system(STUDY / "nominal.toml", fmus=native, stop_time=0.1)
    with Simulation(system) as simulation:
        scan = {
            gain: tracking(simulation.run(system.changed({"controller.K_P": gain})), (-math.inf, math.inf))["error_rms"]
            for gain in (10.0 * 80.0 ** (i / 200) for i in range(201))
        }
    best = min(scan, key=lambda gain: scan[gain])
    assert tuned.feasible
    assert 10.0 < best < 800.0
    assert tuned.best.figures["error_rms"] <= 1.001 * scan[best]
    assert tuned.parameters["controller.K_P"] == pytest.approx(best, rel=0.1)


def test_a_value_at_the_end_of_its_range_is_told(make: Callable[..., Tuning]) -> None:
    """The best gain is above 20; within 10 to 800 it is inside."""
    narrow = tune(make(parameters={"controller.K_P": {"from": 10.0, "to": 20.0}}))
    assert len(narrow.notes) == 1
    assert 19.7 < narrow.parameters["controller.K_P"] <= 20.0
    assert narrow.notes[0].startswith("controller.K_P = ")
    assert "is at the end of its range, 10 to 20" in narrow.notes[0]
    assert tune(make()).notes == ()


def test_limits_are_kept_where_they_bind(make: Callable[..., Tuning]) -> None:
    free = tune(make())
    least = free.best.figures["command_max"]
    bound = tune(make(limits={"command_max": 0.5 * least}))
    assert bound.feasible
    assert bound.best.figures["command_max"] <= 0.5 * least
    assert bound.best.figures["command_max"] > 0.4 * least  # on the limit, not far below it
    assert bound.best.figures["error_rms"] > free.best.figures["error_rms"]
    impossible = tune(make(limits={"command_max": 1e-6}))
    assert not impossible.feasible
    assert impossible.best.excess == min(trial.excess for trial in impossible.trials)


def test_failing_runs_lose_against_all_others(tmp_path: Path) -> None:
    """A run whose FMU fails before the end is no candidate; the best point fails after it."""
    write_probe(tmp_path)
    (tmp_path / "probe.toml").write_text(
        "connections = []\n[experiment]\nstop_time = 1.0\nstep_size = 0.01\n"
        '[instances.h]\nfmu = "Probe"\nstart = { y_start = 1.0 }\n',
        encoding="utf-8",
    )

    def made(last: float) -> Tuning:
        document = {
            "system": "probe.toml",
            "objective": "end",
            "generations": 3,
            "parameters": {"h.fail_time": {"from": 0.1, "to": last}},
            "metrics": {"end": {"of": "last", "signal": "h.y"}},
        }
        return make_tuning(document, folder=tmp_path, fmus=tmp_path)

    tuned = tune(made(2.0))
    assert any(trial.error for trial in tuned.trials)
    assert tuned.feasible
    assert tuned.parameters["h.fail_time"] >= 0.99
    with pytest.raises(DescriptionError, match="no run of"):
        tune(made(0.5))


def test_threads_change_nothing(make: Callable[..., Tuning]) -> None:
    alone, shared = tune(make(generations=3)), tune(make(generations=3), workers=2)
    assert alone.trials == shared.trials
    seen: list[int] = []
    tune(make(generations=3), progress=lambda done, best: seen.append(done))
    assert seen == sorted(seen)
    assert seen[-1] == len(alone.trials)


def test_everything_wrong_is_said(make: Callable[..., Tuning], tmp_path: Path) -> None:
    for more, text in (
        ({"objective": "swin", "metrics": METRICS}, "Did you mean 'swing'"),
        ({"limits": {"swin": 1.0}, "metrics": METRICS, "objective": "end"}, "Did you mean 'swing'"),
        ({"objective": None}, "objective: missing"),
        ({"generations": 0}, "generations: must be greater than or equal to 1"),
        ({"parameters": {"controller.K_P": [1.0, 2.0]}}, "write { from"),
        ({"parameters": {"controller.K_P": {"from": -1.0, "to": 2.0}}}, "below its minimum"),
    ):
        with pytest.raises(DescriptionError, match=text):
            make(**more)
    with pytest.raises(DescriptionError, match="is no metric of this system"):
        tune(make(objective="error_rsm"))
    with pytest.raises(DescriptionError, match="no such file"):
        read_tuning(tmp_path / "none.toml")


def test_the_start_file_completes_its_base(tmp_path: Path) -> None:
    best = Trial((1.5, 2.5, 3.5), {}, 0.0)
    tuned = Tuned({"controller.K_P": 1.5, "plant.m": 2.5, "controller.nct.x": 3.5}, best, True, (best,), 1, "")
    write_start(tuned, tmp_path / "start.toml", base="step.toml")
    document = tomllib.loads((tmp_path / "start.toml").read_text(encoding="utf-8"))
    assert document["base"] == "step.toml"
    assert document["instances"]["controller"]["start"] == {"K_P": 1.5, "nct.x": 3.5}
    assert document["instances"]["plant"]["start"] == {"m": 2.5}
