"""What is legal but suspicious: told once, as a warning, and the call goes well."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest
from conftest import WORKSPACE
from instances import OK, Instance

from cosim.commands.cli import main
from cosim.errors import TraceError
from cosim.export.page import documentation
from cosim.export.trace import trace
from cosim.model import Note, Plant, Record, parameter, variable
from fmus.physics.lugre import ALWAYS, passive_speed
from fmus.plant.ballscrew_stage_maxwell_slip import BallscrewStageMaxwellSlip

FLAVOURS = ("native", "python")
FRICTION = {"F_C": 6.0, "F_S": 6.0}


def run(fmu: Instance, torque: float, steps: int, h: float = 1e-3) -> list[str]:
    """Messages of steps under a constant torque and of the end."""
    fmu.set({"command": torque})
    for k in range(steps):
        fmu.step(k * h, h)
    assert fmu.status("Terminate") == OK
    return fmu.messages


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_a_run_beyond_the_passive_speed_is_told_when_it_ends(request: pytest.FixtureRequest, flavour: str) -> None:
    folder: Path = request.getfixturevalue(flavour)
    with Instance(folder / "BallscrewStage.fmu") as fmu:
        fmu.initialize(FRICTION)
        (message,) = run(fmu, 12.0, 3)
        largest = fmu.get(["largest_speed"])[0]
        assert message.startswith(
            f"test: fmi2Terminate: largest_speed = {largest:.4g} rad/s is above 4*min(F_C, F_S)/sigma_1 = "
            f"{24.0 / 316.22776601683796:.4g} rad/s: "
        )
        assert largest == max(largest, abs(fmu.get(["speed"])[0])) > 0.08


@pytest.mark.parametrize("start", [{}, {"v_d": 0.01}, {"v_d": 0.17}, {"sigma_1": 0.0}, {"sigma_1": 1.0}])
def test_a_passive_run_is_told_nothing(native: Path, start: dict[str, float]) -> None:
    with Instance(native / "BallscrewStage.fmu") as fmu:
        fmu.initialize(FRICTION | start)
        assert run(fmu, 12.0 if start else 3.0, 3) == []


def test_a_value_of_v_d_that_is_too_large_is_told(native: Path) -> None:
    with Instance(native / "BallscrewStage.fmu") as fmu:
        fmu.initialize(FRICTION | {"v_d": 0.18})
        assert "largest_speed" in run(fmu, 12.0, 3)[0]


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_friction_that_rises_with_speed_is_told_once_and_initialization_goes_well(
    request: pytest.FixtureRequest, flavour: str
) -> None:
    folder: Path = request.getfixturevalue(flavour)
    with Instance(folder / "BallscrewStage.fmu") as fmu:
        fmu.fmu.setupExperiment(startTime=0.0)
        fmu.set({"F_C": 6.0, "F_S": 5.0, "v_d": 0.01})
        fmu.fmu.enterInitializationMode()
        assert fmu.status("ExitInitializationMode") == OK
        assert fmu.messages == [
            "test: fmi2ExitInitializationMode: F_C = 6 N.m is above F_S = 5 N.m: friction rises with speed, against "
            "Stribeck's effect. Exchange F_C and F_S unless this is meant."
        ]
        assert len(run(fmu, 1.0, 2)) == 1
        fmu.fmu.reset()
        fmu.initialize({"F_C": 6.0, "F_S": 5.0})
        assert len(fmu.messages) == 2


def test_factors_for_negative_speed_are_told_by_their_names(native: Path) -> None:
    with Instance(native / "BallscrewStage.fmu") as fmu:
        fmu.initialize({"F_C": 6.0, "F_S": 7.0, "F_S_negative": 0.5})
        (message,) = fmu.messages
        assert "F_C*F_C_negative = 6 N.m is above F_S*F_S_negative = 3.5 N.m" in message


def test_notes_go_to_who_asks_for_warnings_only(native: Path) -> None:
    with Instance(native / "BallscrewStage.fmu", logging=False) as fmu:
        fmu.initialize({"F_C": 6.0, "F_S": 5.0})
        assert fmu.messages == []


def test_what_was_told_is_part_of_the_state(native: Path) -> None:
    with Instance(native / "BallscrewStage.fmu") as fmu:
        fmu.initialize(FRICTION)
        before = fmu.fmu.getFMUstate()
        assert len(run(fmu, 12.0, 3)) == 1
        fmu.fmu.setFMUstate(before)
        assert fmu.get(["largest_speed"]) == [0.0]
        assert len(run(fmu, 12.0, 3)) == 2
        fmu.fmu.freeFMUstate(before)


def test_the_guide_speaks_only_where_it_has_friction(native: Path) -> None:
    guide = {"guide_friction": 1.0, "guide_F_C": 20.0, "guide_F_S": 10.0}
    for start, expected in (({}, False), (guide, True)):
        with Instance(native / "CompliantBallscrew.fmu") as fmu:
            fmu.initialize({"guide_sigma_1": 1e5} | start)
            told = run(fmu, 3.0, 20)
            assert any("guide_F_C = 20 N is above guide_F_S = 10 N" in message for message in told) is expected
            assert any("largest_velocity" in message for message in told) is expected


def test_a_move_beyond_the_table_of_the_nct_is_told(native: Path) -> None:
    for size in (0.01, 0.02):  # the last node is at 18.4 mm
        with Instance(native / "NctfPi.fmu") as fmu:
            fmu.initialize()
            fmu.set({"position_ref": size})
            fmu.step(0.0, 2e-4)
            fmu.set({"position_ref": 0.0})
            fmu.step(2e-4, 2e-4)
            assert fmu.status("Terminate") == OK
            expected = f"largest_error = {size:.4g} m is above nct.error[128] = 0.0184 m"
            assert [expected in message for message in fmu.messages] == [True] * (size > 0.0184)


def test_the_passive_speed_is_where_the_damping_meets_its_bound() -> None:
    speeds = [10.0 ** (k / 2000.0) for k in range(-8000, 4000)]
    for v_d in (0.0, 1e-3, 0.0331, 0.0333, 0.1, 10.0):
        limit = passive_speed(4.0, 280.0, v_d)

        def damping(v: float, v_d: float = v_d) -> float:
            return 280.0 * v * (math.exp(-((v / v_d) ** 2)) if v_d else 1.0)

        assert all(damping(v) <= 4.0 * (1.0 + 1e-9) for v in speeds if v <= limit)
        largest = max(map(damping, speeds))
        assert (limit == ALWAYS) == (largest <= 4.0)
    assert passive_speed(0.0, 280.0, 0.0) == passive_speed(4.0, 0.0, 0.0) == ALWAYS


def test_the_bound_of_maxwell_slip_holds_for_each_element() -> None:
    plant = BallscrewStageMaxwellSlip(v_d=0.0, k=(3e4, 1e4, 0.0, 2e4), alpha=(0.5, 0.1, 0.2, 0.2))
    note = plant.notes(plant.State())[-1]
    bounds = [plant.F_C * a * sum(plant.k) / k for k, a in zip(plant.k, plant.alpha, strict=True) if k > 0.0]
    assert note.limit == pytest.approx(min(bounds) / plant.sigma_1, rel=1e-12)


# ---- commands ----


SYSTEM = """\
[instances.plant]
fmu = "BallscrewStage"
start = {{ F_C = 6.0, F_S = {F_S}, velocity_start = 1e-3, load_torque = 0.0, command = 0.0 }}

[experiment]
stop_time = 0.01
step_size = 1e-3

[record]
variables = ["plant.position"]
"""


@pytest.fixture
def system(tmp_path: Path, native: Path) -> Path:
    path = tmp_path / "system.toml"
    path.write_text(SYSTEM.format(F_S=5.0))
    return path


def test_check_and_run_tell_notes(system: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(system), "--json"]) == 0
    (note,) = [note for note in json.loads(capsys.readouterr().out)["notes"] if "F_C" in note]
    assert note.startswith("plant: fmi2ExitInitializationMode: F_C = 6 N.m is above F_S = 5 N.m")
    assert main(["run", str(system), "--json"]) == 0
    captured = capsys.readouterr()
    said = json.loads(captured.out)["notes"]
    assert note in said
    assert [text for text in said if text.startswith("plant: fmi2Terminate: largest_speed")]
    assert captured.err.count("F_C = 6 N.m") == 1


# ---- declaration ----


def component(made: Any) -> type[Plant]:
    class Suspicious(Plant):
        """For tests.

        Source: none.
        """

        a: float = parameter(1.0, "m", "A length")

        class State(Record):
            x: float = variable(0.0, "m", "Position")

        class Output(Record):
            y: float = variable(0.0, "m", "Position")

        def derivative(self, t: float, x: Any, u: Any) -> Any:
            return self.State(x=self.a)

        def output(self, t: float, x: Any, u: Any) -> Any:
            return self.Output(y=x.x)

        def notes(self, x: Any) -> Any:
            return made(self, x)

    return Suspicious


def test_notes_of_another_shape_are_refused() -> None:
    for made, text in (
        (lambda self, x: [], r"notes: returns \[\]\. Return a tuple of Note"),
        (lambda self, x: (Note("x", x.x, "a", self.a, "m", " "),), "give name, limit_name and text"),
    ):
        with pytest.raises(TraceError, match=text):
            trace(component(made))


def test_notes_are_on_the_page_of_the_fmu() -> None:
    page = documentation(trace(WORKSPACE.component("BallscrewStage")), "1").decode()
    assert "Warnings when initialization or a run ends" in page
    assert "<td>4*min(F_C, F_S)/sigma_1</td>" in page
    assert "Warnings when" not in documentation(trace(WORKSPACE.component("NominalStage")), "1").decode()
