"""The study of a measured axis: on made-up files like those of the benchmark, and without files."""

from __future__ import annotations

import math
import sys
import tomllib
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from cosim.commands.cli import main
from cosim.errors import DescriptionError
from cosim.study import find_study, judge, load_study, run_study

sys.path.insert(0, str(Path(__file__).parent))
import emps_like as axis


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a user with both files."""
    folder = tmp_path_factory.mktemp("emps")
    axis.write(folder)
    axis.write(folder, pulses=True)
    return folder


@pytest.fixture
def study() -> ModuleType:
    load_study(find_study("emps"))
    return sys.modules["cosim_study_emps"]


def test_without_data_the_figures_that_come_with_it_are_shown(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert main(["study", "emps", "--output", str(tmp_path)]) == 0
    shown = capsys.readouterr().out
    assert "Mass of the symmetric form" in shown
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "nonlinearbenchmark.org" in page
    assert "not part of this project" in page


def test_a_folder_without_the_file_is_refused_with_where_it_is_to_be_had(tmp_path: Path) -> None:
    with pytest.raises(DescriptionError, match=r"no DATA_EMPS\.mat\. The benchmark EMPS is to be had"):
        run_study(find_study("emps"), data=tmp_path)


def test_other_studies_read_no_data(tmp_path: Path) -> None:
    with pytest.raises(DescriptionError, match="reads no data of yours"):
        run_study(find_study("rubio2015"), data=tmp_path)


def test_the_symmetric_axis_is_found_and_predicts_the_record_with_pulses(
    study: ModuleType, data: Path, native: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    end = axis.LAPS * axis.LAP
    monkeypatch.setattr(study, "WHOLE", {"all": {"window": [0.049, end], "period": axis.LAP}})
    halves = {"first": {"window": [0.049, axis.LAP]}, "second": {"window": [axis.LAP, end], "use": "validate"}}
    monkeypatch.setattr(study, "LAPS", halves)
    symmetric = study.plants()["symmetric"]
    monkeypatch.setattr(study, "plants", lambda: {"symmetric": symmetric})
    told: list[str] = []
    found = study.outcomes(data, native, lambda outcome: told.append(outcome.name), 2)
    assert told == ["least_squares", "published_symmetric", "published_asymmetric", "symmetric", "symmetric_pulses"]
    numbers = found["symmetric"].numbers
    # The noise is small, and two laps tell each value to less than a hundredth.
    for name, truth in (("M", axis.M), ("Fc", axis.FC), ("Fv", axis.FV), ("offset", axis.OFFSET)):
        assert numbers[name] == pytest.approx(truth, rel=0.01), name
    assert numbers["position_rms"] < 0.5e-6
    assert numbers["predicted_position_rms"] < 0.5e-6
    assert numbers["position_rms"] < found["published_asymmetric"].numbers["position_rms"]
    pulses = found["symmetric_pulses"].numbers
    assert pulses["sign_of_pulses"] == 1.0
    assert pulses["position_rms"] < 1e-6
    assert found["least_squares"].numbers["M"] == pytest.approx(axis.M, rel=0.02)


def test_the_ripple_of_a_turn_is_seen_in_the_residual_of_the_command(study: ModuleType) -> None:
    position = np.linspace(0.0, 0.1, 4000)
    angle = position / study.L_P
    torque = 3e-4 * np.sin(angle + 0.5) + 1e-4 * np.sin(2.0 * angle - 1.0)
    off = -torque / (study.FORCE * study.L_P)
    compared = type("Compared", (), {"measured": off, "expected": np.zeros_like(off)})
    found = study.ripple_starts(compared, position)
    wanted = {
        "plant.torque_ripple[1]": 3e-4,
        "plant.torque_phase[1]": 0.5,
        "plant.torque_ripple[2]": 1e-4,
        "plant.torque_phase[2]": -1.0,
    }
    assert found == pytest.approx(wanted, rel=1e-3)


def test_values_free_before_stay_free_and_start_where_they_ended(study: ModuleType) -> None:
    rising = study.plants()["rising"]
    free = [
        type("Free", (), {"name": "plant.F_C", "variables": ("plant.F_C", "plant.F_S"), "log": False}),
        type("Free", (), {"name": "plant.m", "variables": ("plant.m",), "log": False}),
    ]
    ends = [type("End", (), {"value": value}) for value in (8e-3, 95.0)]
    before = type("Fitted", (), {"fit": type("Fit", (), {"free": free}), "estimates": ends})
    found = study.parameters_of(rising, before, {})
    # F_S is free on its own now, so F_C no longer sets it.
    assert found["plant.F_C"] == {"start": 8e-3, "also": [], "log": False}
    assert found["plant.m"]["start"] == 95.0
    assert set(rising.parameters) <= set(found)


def test_shipped_figures_hold_no_signal(study: ModuleType) -> None:
    shipped = tomllib.loads((find_study("emps") / "figures.toml").read_text(encoding="utf-8"))
    assert all(isinstance(value, float) for numbers in shipped.values() for value in numbers.values())
    assert max(len(numbers) for numbers in shipped.values()) < 50


def test_every_claim_has_a_measure_on_the_shipped_figures() -> None:
    folder = find_study("emps")
    outcomes = run_study(folder)
    for claim in load_study(folder).claims:
        verdict = judge(claim, outcomes)
        assert verdict.measured, claim.id
        assert not any(math.isnan(value) for value in verdict.measured.values())
