"""Reuse of loaded FMUs: runs after reset, runs from a checkpoint, changed start values without a second check."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cosim.errors import DescriptionError
from cosim.master.simulation import Simulation, simulate
from cosim.system.system import System, make_system, read_system

STEP = Path(__file__).parents[2] / "studies" / "maeda2008" / "step.toml"


@pytest.fixture(scope="module")
def system(native: Path) -> System:
    return read_system(STEP, {"trajectory.amplitude": 1e-4}, fmus=native, stop_time=0.1)


@pytest.mark.parametrize(("pause", "decimation"), [(0.02, 1), (0.0502, 1), (0.0502, 5), (0.0998, 1)])
def test_a_paused_run_goes_on_bit_by_bit(system: System, pause: float, decimation: int) -> None:
    variant = system.changed(decimation=decimation)
    whole = simulate(variant)
    with Simulation(variant) as simulation:
        checkpoint = simulation.pause(pause)
        rest = [simulation.resume(checkpoint) for _ in range(3)]
    assert checkpoint.time == pytest.approx(pause)
    for result in rest:
        assert np.array_equal(np.concatenate((checkpoint.result.time, result.time)), whole.time)
        assert np.array_equal(np.vstack((checkpoint.result.rows, result.rows)), whole.rows)


def test_runs_do_not_leave_traces(system: System) -> None:
    other = system.changed({"controller.K_P": 500.0, "plant.F_C": 0.04, "plant.F_S": 0.04})
    expected, changed = simulate(system), simulate(other)
    with Simulation(system) as simulation:
        checkpoint = simulation.pause(0.03)
        simulation.resume(checkpoint, {"plant.load_force": 20.0}, stop_time=0.05)
        assert np.array_equal(simulation.run(other).rows, changed.rows)
        assert np.array_equal(simulation.run().rows, expected.rows)
        simulation.release(checkpoint)
    assert not np.array_equal(expected.rows, changed.rows)


def test_inputs_and_tunable_parameters_change_from_the_checkpoint_on(system: System) -> None:
    with Simulation(system) as simulation:
        checkpoint = simulation.pause(0.05)
        plain = simulation.resume(checkpoint)["plant.position"]
        pushed = simulation.resume(checkpoint, {"plant.load_force": 5.0})["plant.position"]
        rubbed = simulation.resume(checkpoint, {"plant.friction_scale": 2.0})["plant.position"]
    assert pushed[0] == plain[0]
    assert pushed[1] < plain[1]  # a positive load pushes back
    assert rubbed[0] == plain[0]
    assert np.max(np.abs(rubbed - plain)) > 1e-9


def test_what_cannot_change_is_said(system: System) -> None:
    with Simulation(system) as simulation:
        checkpoint = simulation.pause(0.05)
        changes = {"plant.m": 4.0, "plant.command": 1.0, "plant.friction_scale": -1.0}
        with pytest.raises(DescriptionError) as refusal:
            simulation.resume(checkpoint, changes)
        for text in (
            "plant.m: a fixed parameter cannot",
            "plant.command: this input is connected",
            "below its minimum",
        ):
            assert text in str(refusal.value)
        with pytest.raises(DescriptionError, match="no communication point"):
            simulation.pause(0.00013)
        with pytest.raises(DescriptionError, match="not after the checkpoint"):
            simulation.resume(checkpoint, stop_time=0.05)
    with pytest.raises(DescriptionError, match="closed"):
        simulation.restore(checkpoint)


def test_partial_derivatives_are_difference_quotients(system: System) -> None:
    """Nut force and table acceleration from the equations of the two inertias: K_n, C_n, m of the plant."""
    with Simulation(system) as simulation:
        simulation.restore(simulation.pause(0.02))
        found = simulation.partial_derivatives(
            "plant", ["der(state.velocity)", "nut_force"], ["deflection", "state.velocity", "command"]
        )
        assert simulation.value("plant", "position") > 0.0
        with pytest.raises(DescriptionError, match="Did you mean 'plant'"):
            simulation.value("plnt", "position")
    assert found == pytest.approx(np.array([[8.3e5 / 3.57, -1700.0 / 3.57, 0.0], [8.3e5, -1700.0, 0.0]]))


def test_changed_start_values_make_the_same_system_as_a_full_check(system: System) -> None:
    changes = {"controller.K_P": 700.0, "plant.F_C": 0.03, "controller.antiwindup": False}
    quick = system.changed(changes)
    full = make_system(quick.document, name=quick.name, folder=quick.folder, fmus=quick.fmus)
    assert quick.digest == full.digest != system.digest
    assert quick == full
