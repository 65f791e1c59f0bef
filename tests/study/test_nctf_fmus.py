"""NCTF as systems of FMUs: acceptance figures and verdicts of the two studies, independent traces, properties."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from instances import Instance
from nctf_reference import EXISTING, WARM, reference

from cosim.master.simulation import simulate
from cosim.result.result import Result
from cosim.study import Outcomes, Status, Study, judge, load_study, run_study
from cosim.system.system import read_system

STUDIES = Path(__file__).parents[2] / "studies"
T_S = 2e-4
QUANTUM = 1.24e-9
"""Resolution of the position sensor, m: one sample decided the other way moves a closed loop by about as much."""

VERDICTS: dict[str, dict[str, Status]] = {
    "maeda2008": {
        "M1": "fitted",
        "M2": "fitted",
        "M3": "fitted",
        "M4": "fitted",
        "M5": "order only",
        "M6": "fitted",
        "M7": "reproduced",
        "M8": "not reproduced",
        "M9": "reproduced",
        "M10": "reproduced",
        "M11": "reproduced",
        "M12": "reproduced",
        "M13": "reproduced",
        "M14": "not reproduced",
        "M15": "not reproduced",
        # all in parallel the first command acts at once and twice: between no delay and one sample of it
        "N11d": "differs",
    },
    "purtojo2015": {
        "T1": "fitted",
        "T2": "not reproduced",
        "T4a": "fitted",
        "T4b": "not reproduced",
        "C1": "fitted",
        "C2": "fitted",
        "C3": "fitted",
        "C4": "order only",
        "C5": "fitted",
        "C6": "fitted",
        "C7": "fitted",
    },
}
"""What is known of the papers' claims; the rest, figures of an independent simulation, must agree."""


@cache
def study(name: str) -> Study:
    return load_study(STUDIES / name)


@cache
def outcomes(name: str, native: Path) -> Outcomes:
    return run_study(STUDIES / name, fmus=native)


CLAIMS = [(name, claim.id) for name in VERDICTS for claim in study(name).claims]


@pytest.mark.parametrize(("name", "claim_id"), CLAIMS)
def test_claim_has_its_known_verdict(native: Path, name: str, claim_id: str) -> None:
    claim = next(claim for claim in study(name).claims if claim.id == claim_id)
    verdict = judge(claim, outcomes(name, native))
    assert verdict.status == VERDICTS[name].get(claim_id, "agrees"), f"{claim.text}: {dict(verdict.measured)}"


def test_every_row_of_the_acceptance_table_is_a_claim() -> None:
    """Rows 4 and 5 are eigenvalues: ``test_nctf_pi``."""
    rows = {claim_id[1:3].rstrip("abcd") for name, claim_id in CLAIMS if claim_id[0] in "NR"}
    assert {str(row) for row in range(1, 17)} - rows == {"4", "5"}


def closed_loop(native: Path, file: str, overrides: Mapping[str, object] | None = None, **experiment: Any) -> Result:
    return simulate(read_system(STUDIES / file, overrides, fmus=native, **experiment))


# Independent traces


@pytest.mark.parametrize("antiwindup", [True, False])
@pytest.mark.parametrize("number", range(7))
def test_step_follows_the_reference_to_a_quantum(native: Path, antiwindup: bool, number: int) -> None:
    data = reference("steps")
    result = closed_loop(
        native,
        "maeda2008/step.toml",
        {"trajectory.amplitude": float(data["steps"][number]), "controller.antiwindup": antiwindup},
    )
    position = result["plant.position"][:-1:10]
    assert np.max(np.abs(position - data[f"position_{antiwindup}"][number])) < 1.5e-9
    assert np.max(result["plant.position"]) == pytest.approx(data[f"largest_{antiwindup}"][number], abs=QUANTUM)


@pytest.mark.parametrize("name", ["cold", "warm"])
def test_stairs_follow_the_reference_to_a_quantum(native: Path, name: str) -> None:
    data = reference("stairs")
    changed = {f"plant.{key}": value for key, value in WARM.items()} if name == "warm" else {}
    result = closed_loop(native, "maeda2008/stairs.toml", changed)
    assert np.max(np.abs(result["plant.position"][:-1:10] - data[name])) < 1.5e-9


@pytest.mark.parametrize("name", ["proposed", "existing"])
def test_fuzzy_loops_have_the_errors_of_the_reference(native: Path, name: str) -> None:
    data = reference("fuzzy_loops")
    for number, (amplitude, omega) in enumerate(data["sines"]):
        sine = {"trajectory.amplitude": 1e-3 * amplitude, "trajectory.frequency": omega / (2.0 * math.pi)}
        result = closed_loop(native, f"purtojo2015/{name}_sine.toml", sine)
        error = (result["plant.position"] - result["trajectory.position"])[:-1]
        largest, rms = data[f"{name}_errors"][number]
        # The proposed controller chatters: its samples differ after a while, its figures hardly.
        assert np.max(np.abs(error)) == pytest.approx(largest, rel=0.01)
        assert np.sqrt(np.mean(error**2)) == pytest.approx(rms, rel=0.02)
        if name == "existing":
            assert np.max(np.abs(result["plant.position"][:-1:50] - data["existing_position"][number])) < 1e-10


def replay(native: Path, name: str, inputs: Mapping[str, np.ndarray], outputs: list[str], **start: Any) -> np.ndarray:
    """Outputs of one FMU after each step of ``step`` seconds with held inputs."""
    step = start.pop("step", T_S)
    with Instance(native / f"{name}.fmu") as fmu:
        fmu.initialize(numbers(fmu, start))
        rows = [fmu.get(outputs)]
        for k in range(len(next(iter(inputs.values())))):
            fmu.set({key: float(values[k]) for key, values in inputs.items()})
            fmu.step(k * step, step)
            rows.append(fmu.get(outputs))
    return np.array(rows)


def numbers(fmu: Instance, start: Mapping[str, Any]) -> dict[str, float]:
    """Start values with the names of enumeration items replaced by their numbers."""
    types = {item.name: item for item in fmu.description.typeDefinitions}
    found: dict[str, float] = {}
    for name, value in start.items():
        found[name] = value
        if isinstance(value, str):
            items = types[fmu.variables[name].declaredType.name].items
            found[name] = next(int(item.value) for item in items if item.name == value)
    return found


GUIDE = {"guide_friction": True, "guide_F_S": 18.0, "guide_F_C": 12.0, "guide_sigma_1": 2e3, "guide_sigma_2": 150.0}
GAPS = {"backlash": True, "gap_plus": 3e-6, "gap_minus": 7e-6}


@pytest.mark.parametrize(("tolerance", "distance"), [(1e-6, 1e-9), (1e-9, 5e-12)])
@pytest.mark.parametrize(("file", "start"), [("pulse", {}), ("guide", GUIDE), ("backlash", GAPS)])
def test_ballscrew_follows_the_open_loop_reference(
    native: Path, *, file: str, start: dict[str, Any], tolerance: float, distance: float
) -> None:
    """Below the sensor's quantum at the default tolerance; far below it where the integrator is asked for more."""
    data = reference(f"open_loop_{file}")
    inputs = {"command": data["current"]}
    if "force" in data:
        inputs |= {"load_force": data["force"], "load_torque": data["torque"]}
    outputs = ["position", "velocity", "motor_position"]
    rows = replay(native, "CompliantBallscrew", inputs, outputs, tolerance=tolerance, **start)
    states, l_p = data["states"], 2e-3 / (2.0 * math.pi)
    assert np.max(np.abs(rows[:, 0] - states[:, 2])) < distance
    assert np.max(np.abs(rows[:, 1] - states[:, 3])) < 500.0 * distance
    assert np.max(np.abs(rows[:, 2] - l_p * states[:, 0])) < distance
    assert np.ptp(states[:, 2]) > 1e-5


@pytest.mark.parametrize("step", [1e-5, 2e-4, 1e-3, 2e-2])
def test_ballscrew_rests_at_the_same_place_at_any_communication_step(native: Path, step: float) -> None:
    n = round(0.6 / step)
    current = np.where(np.arange(n) < round(0.1 / step), 6.0, 0.0)
    rows = replay(native, "CompliantBallscrew", {"command": current}, ["position"], step=step)
    assert rows[-1, 0] == pytest.approx(25.8350e-3, rel=1e-4)
    assert rows[-1, 0] == pytest.approx(25.83497826e-3, abs=1e-9)


def test_nominal_stage_follows_the_matrix_exponential(native: Path) -> None:
    data = reference("nominal_stage")
    inputs = {"command": data["command"], "disturbance": data["disturbance"]}
    rows = replay(native, "NominalStage", inputs, ["position", "velocity"], step=1e-3)
    assert np.max(np.abs(rows - data["states"])[:, 0]) < 1e-9
    assert np.max(np.abs(rows - data["states"])[:, 1]) < 1e-7


@pytest.mark.parametrize("name", ["antiwindup_True", "antiwindup_False", "proposed", "existing"])
def test_controllers_answer_recorded_inputs(native: Path, name: str) -> None:
    pi = name.startswith("antiwindup")
    data = reference("nctf_pi_replay" if pi else "nctf_fuzzy_replay")
    signals = ["position_ref", "position"] if pi else ["position_ref", "velocity_ref", "position", "velocity"]
    start: dict[str, Any] = {"antiwindup": name.endswith("True")} if pi else EXISTING if name == "existing" else {}
    rows = replay(
        native,
        "NctfPi" if pi else "NctfFuzzy",
        {signal: data[signal] for signal in signals},
        ["command"],
        step=T_S if pi else 1e-4,
        **start,
    )
    assert np.max(np.abs(rows[1:, 0] - data[name])) < 1e-10


# Properties over random parameters

QUICK = settings(max_examples=25, deadline=None, phases=(Phase.explicit, Phase.reuse, Phase.generate))
BALLSCREW = {
    "J": st.floats(1e-5, 1e-2),
    "m": st.floats(0.1, 500.0),
    "K_n": st.floats(1e5, 1e9),
    "C_n": st.floats(10.0, 1e5),
    "sigma_0": st.floats(1.0, 1e5),
    "sigma_1": st.floats(0.0, 300.0),
    "sigma_2": st.floats(0.0, 1.0),
    "F_C": st.one_of(st.just(0.0), st.floats(1e-4, 5.0)),
    "backlash": st.booleans(),
    "gap_plus": st.floats(0.0, 1e-4),
    "gap_minus": st.floats(0.0, 1e-4),
    "F_C_negative": st.floats(0.5, 1.0),
    "friction_scale": st.floats(0.5, 2.0),
}
PI = {
    "K_P": st.floats(0.0, 1e4),
    "K_I": st.floats(0.0, 1e6),
    "command_max": st.floats(0.1, 6.0),
    "antiwindup": st.booleans(),
    "compute_delay": st.integers(0, 1),
    "sensor_resolution": st.sampled_from([0.0, 1.24e-9, 1e-6]),
}
FUZZY = {
    "variant": st.integers(1, 2),
    "defuzzification": st.integers(1, 3),
    "w_z": st.floats(0.0, 2.0),
    "grid_points": st.integers(1, 500).map(lambda n: 2 * n + 1),
    "K_f": st.floats(0.0, 3.0),
    "command_max": st.floats(0.1, 10.0),
    "h_zero": st.floats(1e-5, 5e-2),
}


def march(plant: Instance, controller: Instance, target: float, T_s: float, samples: range) -> list[list[float]]:
    """All outputs of both at some samples of a closed loop."""
    rows: list[list[float]] = []
    for k in samples:
        position, velocity = plant.get(["position", "velocity"])
        controller.set({"position_ref": target, "position": position, "velocity": velocity})
        controller.step(k * T_s, T_s)
        plant.set({"command": controller.get(["command"])[0]})
        plant.step(k * T_s, T_s)
        rows.append(plant.get(plant.names("output")) + controller.get(controller.names("output")))
    return rows


@QUICK
@given(
    st.fixed_dictionaries(BALLSCREW),
    st.fixed_dictionaries(PI),
    st.sampled_from([-1e-2, -1e-7, 0.0, 1e-6, 2e-2]),
)
def test_any_ballscrew_loop_stays_finite_and_limited_and_resumes_bitwise(
    native: Path, plant_values: dict[str, Any], controller_values: dict[str, Any], target: float
) -> None:
    values = plant_values | {"F_S": plant_values["F_C"]}
    with Instance(native / "CompliantBallscrew.fmu") as plant, Instance(native / "NctfPi.fmu") as controller:
        plant.initialize(values)
        controller.initialize(controller_values)
        assert_resumes(plant, controller, target, T_S, controller_values["command_max"])


@QUICK
@given(st.fixed_dictionaries(FUZZY), st.floats(1.0, 1e3), st.sampled_from([-5e-3, -1e-6, 0.0, 1e-3]))
def test_any_fuzzy_loop_stays_finite_and_limited_and_resumes_bitwise(
    native: Path, values: dict[str, Any], alpha: float, target: float
) -> None:
    with Instance(native / "NominalStage.fmu") as plant, Instance(native / "NctfFuzzy.fmu") as controller:
        plant.initialize({"alpha": alpha})
        controller.initialize(values)
        assert_resumes(plant, controller, target, 1e-4, values["command_max"])


def assert_resumes(plant: Instance, controller: Instance, target: float, T_s: float, limit: float) -> None:
    rows = march(plant, controller, target, T_s, range(40))
    saved = [(fmu, fmu.fmu.getFMUstate()) for fmu in (plant, controller)]
    after = march(plant, controller, target, T_s, range(40, 60))
    for fmu, state in saved:
        fmu.fmu.setFMUstate(state)
    assert march(plant, controller, target, T_s, range(40, 60)) == after
    for fmu, state in saved:
        fmu.fmu.freeFMUstate(state)
    values = np.array(rows + after)
    command = values[:, len(plant.names("output"))]
    assert np.all(np.isfinite(values))
    assert np.all(np.abs(command) <= limit)
    if target == 0.0:
        assert not np.any(command)
