"""The systems of the linear motor, feed drive and ranking studies are those that their scripts write."""

from __future__ import annotations

import importlib.util
import shutil
import sys
import tomllib
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import tomli_w

from cosim.errors import DescriptionError
from cosim.master.simulation import simulate
from cosim.study import Run, load_study, run_one, run_system
from cosim.system.system import read_system

STUDIES = Path(__file__).parents[2] / "studies"


def script(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(f"studies_{path.stem}", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


TUNE = script(STUDIES / "ranking" / "tune.py")


@pytest.mark.parametrize("study", ["rubio2015", "feng2015", "ranking"])
def test_every_system_of_the_study_can_be_read(native: Path, study: str) -> None:
    """Of the runs of a system the one with the most changed values."""
    folder = STUDIES / study
    runs: dict[str, Run] = {}
    for run in load_study(folder).runs.values():
        if run.system not in runs or len(run.overrides) > len(runs[run.system].overrides):
            runs[run.system] = run
    for run in runs.values():
        run_system(folder, run, native)


RANKED = [
    (controller, plant, model)
    for controller in TUNE.controllers()
    for plant, data in TUNE.PLANTS.items()
    for model in TUNE.columns(data)
]


@pytest.mark.parametrize(("controller", "plant", "model"), RANKED)
def test_ranked_system_follows_from_the_gains(controller: str, plant: str, model: bool) -> None:
    path = STUDIES / "ranking" / "systems" / f"{TUNE.system_name(controller, plant, model)}.toml"
    row = TUNE.read_gains()[controller][plant][TUNE.COLUMNS[model]]["1"]
    gains = TUNE.Gains(*row["gains"])
    wanted = TUNE.document(TUNE.controllers()[controller], TUNE.PLANTS[plant], gains, model)
    assert tomllib.loads(path.read_text(encoding="utf-8")) == wanted


def test_both_columns_differ_in_the_model_and_in_nothing_else() -> None:
    gains, plant = TUNE.Gains(500.0, 100.0, 50.0), TUNE.PLANTS["feng"]
    for name, controller in TUNE.controllers().items():
        starts = [TUNE.starts(controller, plant, gains, model) for model in (False, True)]
        changed = {
            f"{instance}.{variable}"
            for instance in starts[0]
            for variable, value in starts[0][instance].items()
            if starts[1][instance][variable] != value
        }
        assert changed in ({"feedforward.share"}, {"controller.friction_velocity"}), name


LOST = ("nctf_fuzzy", "shams")
"""The search finds no gains that stand one sample of delay: its costs in ``gains.toml`` are millimetres."""


def test_one_controller_has_no_gains_for_one_plant() -> None:
    costs = {
        (controller, plant): min(row["cost"] for column in columns.values() for row in column.values())
        for controller, plants in TUNE.read_gains().items()
        for plant, columns in plants.items()
    }
    assert {pair for pair, cost in costs.items() if cost > 1e-4} == {LOST}


def test_every_ranked_loop_holds_its_reference(native: Path) -> None:
    """Half a second of each: position errors below the 5 mm of the sine show signs and gains right."""
    for controller, plant, model in RANKED:
        if (controller, plant) == LOST:
            continue
        path = STUDIES / "ranking" / "systems" / f"{TUNE.system_name(controller, plant, model)}.toml"
        result = simulate(read_system(path, fmus=native, stop_time=0.5))
        error = result["plant.position"] - result["trajectory.position"]
        assert np.max(np.abs(error)) < 1.5e-3, path.name


MINE = """
TITLE = "Mine"
FMU = "PATH/CascadePid.fmu"
INPUTS = {
    "position_ref": "trajectory.position",
    "position_next": "trajectory.position_next",
    "position": "plant.position",
    "motor_position": "plant.position",
}


def start(plant, gains, model):
    return {"K_pos": gains.position, "omega_v": gains.fast, "T_i": 1e3, "M": plant.M, "l_p": 1.0}
"""


def test_a_controller_enters_the_ranking_with_one_file(
    native: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "ranking"
    shutil.copytree(STUDIES / "ranking", folder, ignore=shutil.ignore_patterns("__pycache__", "*_*_*.toml"))
    (folder / "controllers" / "mine.py").write_text(MINE.replace("PATH", native.as_posix()), encoding="utf-8")
    module = script(folder / "tune.py")
    for name, value in {"FMUS": native, "BUDGET": 3, "DIAGONAL": 3, "SEEDS": (1,)}.items():
        monkeypatch.setattr(module, name, value)
    with pytest.raises(DescriptionError, match=r"no gains for mine\. Run python tune\.py --controllers mine"):
        load_study(folder)
    best, diagonal, least = module.search("mine", "nominal", False, 1)
    assert least <= diagonal < 1e-3
    row = {"1": {"gains": list(best), "cost_diagonal": diagonal, "cost": least}}
    row["2"] = row["1"]
    gains = {"mine": {p: dict.fromkeys(("without", "with"), row) for p in module.PLANTS}, **module.read_gains(folder)}
    module.write(["mine"], gains, folder)
    (folder / "gains.toml").write_text(tomli_w.dumps(gains), encoding="utf-8")
    study = load_study(folder)
    outcome = run_one(folder, "mine_nominal_fast", study.runs["mine_nominal_fast"], native)
    assert not outcome.failure
    assert outcome.numbers["error_rms"] < 1e-3
    assert outcome.numbers["command_tv"] > 0.0


def learned() -> dict[str, Any]:
    return tomllib.loads((STUDIES / "feng2015" / "learned.toml").read_text(encoding="utf-8"))


@pytest.mark.parametrize(("name", "axes"), [("circle", "xy"), ("out_and_back", "y")])
def test_pulse_tables_are_the_learned_ones(native: Path, name: str, axes: str) -> None:
    document = tomllib.loads((STUDIES / "feng2015" / f"{name}_pulse.toml").read_text(encoding="utf-8"))
    for axis in axes:
        start = document["instances"][f"pulse_{axis}"]["start"]
        for column in ("acceleration", "amplitude", "duration"):
            assert start[f"table.{column}"] == learned()[axis]["nominal"][f"table_{column}"]


@pytest.mark.parametrize(
    ("axis", "durations", "amplitudes"),
    [
        ("x", (130.6, 82.8, 49.8, 38.3), (0.38, 0.56, 0.812, 0.848)),
        ("y", (168.3, 81.8, 56.0, 42.2), (0.38, 0.776, 1.028, 1.136)),
    ],
)
def test_learned_points_are_the_published_ones(
    axis: str, durations: tuple[float, ...], amplitudes: tuple[float, ...]
) -> None:
    """Another implementation of the same procedure; its tolerances are a grid step and two fine steps."""
    found = learned()[axis]["nominal"]
    t_c = np.array(found["t_c"])
    assert np.all(np.abs(np.array(found["duration"]) - 1e-3 * np.array(durations)) <= t_c / 8.0)
    at = np.interp([2e-3, 10e-3, 40e-3, 120e-3], found["acceleration"], found["amplitude"])
    assert np.all(np.abs(at - 1e-3 * np.array(amplitudes)) <= 0.072e-3)
    assert found["runs"] == {"peak": 4, "duration": 360, "coarse": 143, "fine": 275}


def test_learning_gives_the_shipped_amplitude_again() -> None:
    module = script(STUDIES / "feng2015" / "learn_tables.py")
    learner = module.Learner(module.AXES["x"], {})
    found = learned()["x"]["nominal"]
    assert module.peak_time(learner, 10e-3) == pytest.approx(found["t_c"][1])
    costs = {
        factor: learner.cost(10e-3, (factor * 0.56e-3, found["duration"][1]), found["t_c"][1], "fine")
        for factor in (0.5, 1.0, 1.5)
    }
    assert costs[1.0] == pytest.approx(found["cost"][found["acceleration"].index(10e-3)], rel=1e-4)
    assert costs[1.0] < 0.5 * min(costs[0.5], costs[1.5])
