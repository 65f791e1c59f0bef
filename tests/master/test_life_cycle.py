"""Life cycles that are not ideal: an FMU that ends the simulation, cannot be reset, or does not choose what it logs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmu_files import PROBE, probe_library, write_fmu, write_probe

from cosim import CallError, DescriptionError, Simulation, SimulationError, System, make_system, simulate


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("stubborn")
    write_fmu(folder / "Stubborn.fmu", PROBE, binary=probe_library("stubborn").read_bytes())
    write_probe(folder)
    return folder


def lags(fmus: Path, name: str, *, end: float = 1e9, multiple: int = 1, **start: Any) -> System:
    """The stubborn lag ``name`` feeds a second one, and a third feeds it; steps of 0.125 s up to 2 s."""
    document: dict[str, Any] = {
        "instances": {
            "before": {"fmu": "Probe", "start": {"gain": 3.0, "u": 1.0}},
            name: {"fmu": "Stubborn", "start": {"fail_time": end, **start}, "step_multiple": multiple},
            "behind": {"fmu": "Probe", "start": {"gain": 2.0}},
        },
        "connections": [f"before.y -> {name}.u", f"{name}.y -> behind.u"],
        "experiment": {"stop_time": 2.0, "step_size": 0.125},
        "record": {"variables": ["before.y", f"{name}.y", "behind.y", "behind.z"]},
    }
    return make_system(document, name="lags", fmus=fmus)


@pytest.mark.parametrize("isolated", [False, True])
@pytest.mark.parametrize(("end", "multiple"), [(0.125, 1), (1.0, 1), (1.0, 2), (2.0, 1)])
def test_an_fmu_ends_the_simulation_where_it_got_to(fmus: Path, end: float, multiple: int, isolated: bool) -> None:
    result = simulate(lags(fmus, "ends", end=end, multiple=multiple), isolated=isolated)
    whole = simulate(lags(fmus, "goes", multiple=multiple))
    rows = round(end / 0.125) + 1
    assert not result.partial
    assert result.time[-1] == end
    assert np.array_equal(result.rows, whole.rows[:rows])
    (message,) = [message for message in result.messages if message.category == "terminated"]
    assert str(message).endswith(f"asked to end the simulation at {end:g} s; the run ends at {end:g} s")


@pytest.mark.parametrize("end", [0.125, 0.3, 1.0])
def test_an_fmu_that_did_not_move_ends_the_run_at_the_point_before(fmus: Path, end: float) -> None:
    result = simulate(lags(fmus, "stays", end=end))
    rows = int(np.ceil(end / 0.125))
    assert not result.partial
    assert np.array_equal(result.rows, simulate(lags(fmus, "goes")).rows[:rows])


def test_a_checkpoint_behind_the_end_is_refused(fmus: Path) -> None:
    with (
        Simulation(lags(fmus, "ends", end=0.5)) as simulation,
        pytest.raises(DescriptionError, match=r"an FMU ended the simulation at 0.5 s, before 1 s"),
    ):
        simulation.pause(1.0)


@pytest.mark.parametrize("status", [2, 3])
def test_an_fmu_that_cannot_choose_what_it_logs_runs(fmus: Path, status: int, caplog: pytest.LogCaptureFixture) -> None:
    result = simulate(lags(fmus, f"logging_{status}"))
    assert np.array_equal(result.rows, simulate(lags(fmus, "goes")).rows)
    assert f"SetDebugLogging returned {('Discard', 'Error')[status - 2]}. The run goes on" in caplog.text


def test_an_fmu_that_dies_of_its_logging_does_not_run(fmus: Path) -> None:
    with pytest.raises(CallError, match="fmi2SetDebugLogging at 0 s returned fmi2Fatal"):
        simulate(lags(fmus, "logging_4"))


@pytest.mark.parametrize("status", [2, 3, 4])
def test_an_fmu_that_cannot_be_reset_is_made_anew(fmus: Path, status: int) -> None:
    with Simulation(lags(fmus, f"reset_{status}")) as simulation:
        for gain in (1.0, 2.0, 1.0):
            result = simulation.run(lags(fmus, f"reset_{status}", gain=gain))
            assert np.array_equal(result.rows, simulate(lags(fmus, "goes", gain=gain)).rows)


@pytest.mark.parametrize("status", [3, 4])
def test_after_a_failure_the_next_run_is_as_the_first(fmus: Path, status: int) -> None:
    with Simulation(lags(fmus, "goes")) as simulation:
        for _ in range(2):
            with pytest.raises(CallError, match=r"fmi2DoStep at 0\.5 s"):
                simulation.run(lags(fmus, "goes", end=0.5, fail_status=status))
            assert np.array_equal(simulation.run().rows, simulate(lags(fmus, "goes")).rows)


def test_after_fatal_nothing_is_called(fmus: Path) -> None:
    with Simulation(lags(fmus, "goes", end=0.5, fail_status=4)) as simulation:
        with pytest.raises(CallError, match="fmi2Fatal"):
            simulation.run()
        with pytest.raises(SimulationError, match="no call of fmi2GetReal any more"):
            simulation.value("goes", "y")


@pytest.mark.parametrize("gain", [1.0, 3.0, -0.5])
def test_start_values_lost_at_initialization_are_set_again(tmp_path: Path, gain: float) -> None:
    write_fmu(tmp_path / "Forgetful.fmu", PROBE, binary=probe_library("forgetful").read_bytes())
    document: dict[str, Any] = {
        "instances": {"lag": {"fmu": "Forgetful", "start": {"gain": gain, "u": 2.0, "label": "x", "flag_in": True}}},
        "experiment": {"stop_time": 1.0, "step_size": 0.5},
        "record": {"variables": ["lag.z"]},
    }
    result = simulate(make_system(document, fmus=tmp_path))
    assert result["lag.z"].tolist() == [2.0 * gain] * 3


def test_a_library_without_the_functions_of_capabilities_runs(tmp_path: Path) -> None:
    write_fmu(tmp_path / "Lean.fmu", PROBE, binary=probe_library("lean").read_bytes())
    write_probe(tmp_path)
    experiment = {"stop_time": 1.0, "step_size": 0.1}
    lean, whole = (
        make_system({"instances": {"a": {"fmu": name, "start": {"u": 1.0}}}, "experiment": experiment}, fmus=tmp_path)
        for name in ("Lean", "Probe")
    )
    assert np.array_equal(simulate(lean).rows, simulate(whole).rows)
    with Simulation(lean) as simulation, pytest.raises(SimulationError, match="a: the library has no fmi2GetFMUstate"):
        simulation.pause(0.5)
