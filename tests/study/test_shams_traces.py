"""Closed loops of the ballscrew stage on the FMUs, full length, against traces of an independent solver."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from stage_loops import CASES, traces

import cosim

PAGE = """
connections = [
    "trajectory.position -> controller.position_ref",
    "trajectory.velocity -> controller.velocity_ref",
    "trajectory.acceleration -> controller.acceleration_ref",
    "controller.command -> plant.command",
    {feedback}
]
[experiment]
stop_time = {stop}
step_size = {step}
order = ["trajectory", "controller", "plant"]
[instances.trajectory]
fmu = "Trajectory"
[instances.controller]
fmu = "{controller}"
[instances.plant]
fmu = "BallscrewStage"
[record]
variables = ["plant.position", "plant.angle", "controller.command", "controller.error"]
"""
TABLE = '"plant.position -> controller.position", "plant.velocity -> controller.velocity",'
SCREW = (
    '{ from = "plant.angle", to = "controller.position", factor = 1.5923e-3 },'
    '{ from = "plant.speed", to = "controller.velocity", factor = 1.5923e-3 },'
)


@pytest.fixture(scope="module")
def loops(native: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, cosim.Result]:
    """Every case, run once at the default tolerance."""
    folder = tmp_path_factory.mktemp("systems")
    return {name: run(name, case, native, folder) for name, case in CASES.items()}


def run(name: str, case: dict[str, Any], fmus: Path, folder: Path) -> cosim.Result:
    path = folder / f"{name}.toml"
    feedback = SCREW if case["feedback"] == "screw" else TABLE
    path.write_text(
        PAGE.format(feedback=feedback, stop=case["stop_time"], step=case["step_size"], controller=case["controller"])
    )
    starts = {
        **{f"plant.{key}": value for key, value in case["plant_start"].items()},
        **{f"controller.{key}": value for key, value in case["controller_start"].items()},
        **{f"trajectory.{key}": value for key, value in case["trajectory_start"].items()},
        "plant.load_torque": case["load_torque"],
    }
    return cosim.simulate(cosim.read_system(path, overrides=starts, fmus=fmus))


@pytest.mark.parametrize("name", [name for name, case in CASES.items() if case["compare"] == "trace"])
def test_trace_is_that_of_the_independent_solver(loops: dict[str, cosim.Result], name: str) -> None:
    """1 nm is the accuracy promised for the default tolerance; the references are good to a few pm."""
    result, recorded, case = loops[name], traces("traces"), CASES[name]
    rows = np.round(recorded[f"{name}.time"] / case["step_size"]).astype(int)
    limit = 1e-9 + 10.0 * case["sensitivity"]["position"]
    screw = result["plant.angle"][rows] * case["plant_start"].get("l_p", 1.5923e-3)
    assert np.max(np.abs(screw - recorded[f"{name}.position"])) < limit
    if f"{name}.table" in recorded:
        assert np.max(np.abs(result["plant.position"][rows] - recorded[f"{name}.table"])) < limit


@pytest.mark.parametrize("name", CASES)
def test_figures_are_those_of_the_independent_solver(loops: dict[str, cosim.Result], name: str) -> None:
    result, case = loops[name], CASES[name]
    window = result.time >= case["window_start"] - 1e-9
    error, figures = result["controller.error"][window], case["figures"]
    # chattering and stick-slip agree in their statistics only
    relative = 1e-3 if case["compare"] == "trace" else 0.1
    assert np.sqrt(np.mean(error**2)) == pytest.approx(figures["error_rms"], rel=relative, abs=1e-10)
    assert np.max(np.abs(error)) == pytest.approx(figures["error_max"], rel=5 * relative, abs=1e-9)
