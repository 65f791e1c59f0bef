"""What a result knows about the run that made it."""

from __future__ import annotations

import json
from pathlib import Path

from cosim.master.metadata import system_metadata
from cosim.system.system import read_system


def test_start_values_that_differ_have_unit_and_value_of_the_fmu(native: Path) -> None:
    system = read_system("shams2010/fsmc_5sin", {"plant.m": 80.0, "trajectory.kind": "quintic"}, fmus=native)
    values = system_metadata(system)["start_values"]
    assert values["plant.m"] == {"value": 80.0, "fmu": 62.4, "unit": "kg"}
    assert values["trajectory.kind"]["value"] == "quintic"
    same = read_system("shams2010/fsmc_5sin", {"plant.m": 62.4}, fmus=native)
    assert "plant.m" not in system_metadata(same)["start_values"]


def test_wires_have_the_units_of_both_ends_and_their_factor(native: Path) -> None:
    wires = system_metadata(read_system("feng2015/circle", fmus=native))["wires"]
    angle = next(wire for wire in wires if wire["to"] == ["controller_x", "motor_position"])
    assert angle == {
        "from": ["plant_x", "angle"],
        "to": ["controller_x", "motor_position"],
        "units": ["rad", "m"],
        "factor": 0.0015915494309189536,
    }


def test_fmus_have_version_and_digest_and_all_of_it_is_json(native: Path) -> None:
    system = read_system("shams2010/fsmc_5sin", fmus=native)
    facts = system_metadata(system)
    assert facts["fmus"]["plant"]["fmu"] == "BallscrewStage"
    assert facts["fmus"]["plant"]["digest"] == system.instance("plant").fmu.digest
    assert facts["fmus"]["plant"]["version"] == system.instance("plant").fmu.version
    assert facts["evaluation_order"] == ["trajectory", "controller", "plant"]
    assert json.loads(json.dumps(facts)) == facts
