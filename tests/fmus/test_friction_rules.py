"""Parameters of friction that cannot be integrated: refused by name before the first step, by every flavour alike."""

from __future__ import annotations

from pathlib import Path

import pytest
from conftest import Command
from instances import ERROR, Instance

from cosim.errors import DescriptionError
from fmus.plant.ballscrew_axis import BallscrewAxis
from fmus.plant.ballscrew_stage import BallscrewStage
from fmus.plant.ballscrew_stage_elasto_plastic import BallscrewStageElastoPlastic
from fmus.plant.ballscrew_stage_maxwell_slip import BallscrewStageMaxwellSlip
from fmus.plant.compliant_ballscrew import CompliantBallscrew
from fmus.plant.compliant_ballscrew_axis import CompliantBallscrewAxis

PLANTS = (
    BallscrewAxis,
    BallscrewStage,
    BallscrewStageElastoPlastic,
    BallscrewStageMaxwellSlip,
    CompliantBallscrew,
    CompliantBallscrewAxis,
)
REFUSED = (
    ({"F_C": 0.0}, "F_C = 0 with F_S > 0"),
    ({"F_C": -0.0}, "F_C = 0 with F_S > 0"),
    ({"F_S": 0.0}, "F_S = 0 with F_C > 0"),
    ({"F_C": 5e-324}, "F_C = 0 with F_S > 0, or below 1e-06 of it"),
    ({"F_C": 1e-12}, "F_C = 0 with F_S > 0, or below 1e-06 of it"),
    ({"F_S": 1e-100}, "F_S = 0 with F_C > 0, or below 1e-06 of it"),
    ({"F_C_negative": 0.0}, "F_C*F_C_negative = 0 with F_S*F_S_negative > 0"),
    ({"F_S_negative": 1e-9}, "F_S*F_S_negative = 0 with F_C*F_C_negative > 0"),
    ({"F_C": 1e-20, "F_S": 1e-20}, "friction_scale*F_C or friction_scale*F_S is so small"),
    ({"friction_scale": 1e-100}, "friction_scale*F_C or friction_scale*F_S is so small"),
    ({"v_d": 1e-300}, "v_d is above 0 but below 1e-12"),
)
ALLOWED = (
    {"F_C": 0.0, "F_S": 0.0},
    {"F_C_negative": 0.0, "F_S_negative": 0.0},
    {"friction_scale": 0.0},
    {"friction_scale": 1e-3},
    {"F_C": 1.0, "F_S": 1.0},
    {"v_d": 1e-6},
)


@pytest.mark.parametrize("plant", PLANTS, ids=lambda plant: plant.__name__)
def test_every_plant_refuses_friction_that_cannot_be_integrated(plant: type[BallscrewStage]) -> None:
    for start, text in REFUSED:
        with pytest.raises(DescriptionError) as caught:
            plant(**start)
        assert any(text in problem for problem in caught.value.problems), (start, caught.value.problems)
    for start in ALLOWED:
        plant(**start)


@pytest.mark.parametrize("flavour", ["native", "python"])
@pytest.mark.parametrize("name", ["BallscrewStageMaxwellSlip", "CompliantBallscrew"])
def test_fmus_of_every_flavour_refuse_it_before_the_first_step(
    request: pytest.FixtureRequest, flavour: str, name: str
) -> None:
    path: Path = request.getfixturevalue(flavour) / f"{name}.fmu"
    for start, text in REFUSED:
        with Instance(path) as fmu:
            fmu.set(start)
            fmu.fmu.enterInitializationMode()
            assert fmu.status("ExitInitializationMode") == ERROR, start
            assert text in fmu.messages[-1]
    for start in ALLOWED:
        with Instance(path) as fmu:
            fmu.initialize(start)
            for k in range(10):
                fmu.set({"command": 2.0 if k < 5 else -2.0})
                fmu.step(k * 1e-4, 1e-4)


@pytest.mark.parametrize("flavour", ["native", "fmi3", "python"])
def test_check_tells_it(request: pytest.FixtureRequest, cosim: Command, flavour: str) -> None:
    path: Path = request.getfixturevalue(flavour) / "BallscrewStage.fmu"
    code, out, err = cosim("check", path, "--set", "F_C=1e-12")
    assert code == 2
    assert "F_C = 0 with F_S > 0, or below 1e-06 of it" in out + err


@pytest.mark.parametrize("flavour", ["native", "python"])
@pytest.mark.parametrize(
    "name", ["BallscrewStage", "BallscrewStageElastoPlastic", "BallscrewStageMaxwellSlip", "CompliantBallscrew"]
)
def test_friction_that_is_scaled_to_0_in_motion_leaves_the_viscous_part(
    request: pytest.FixtureRequest, flavour: str, name: str
) -> None:
    """The bristles keep their deflection, but without contact it does not count."""
    with Instance(request.getfixturevalue(flavour) / f"{name}.fmu") as fmu:
        fmu.initialize()
        for k in range(4):
            fmu.set({"command": 12.0})
            fmu.step(k * 1e-4, 1e-4)
        sigma_2 = float(fmu.variables["sigma_2"].start)
        speed, friction = fmu.get(["speed", "friction_torque"])
        assert abs(friction) > 2.0 * sigma_2 * abs(speed)
        fmu.set({"friction_scale": 0.0})
        speed, friction = fmu.get(["speed", "friction_torque"])
        assert friction == pytest.approx(sigma_2 * speed, rel=1e-12)
