"""FMUs of FMI 3.0 in systems: with the results of FMI 2.0, also side by side; arrays and all types of numbers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmu_files import PROBE, TYPES3, probe_library, write_echo3, write_fmu

from cosim import DescriptionError, RunError, SignalError, Simulation, make_system, read_system, simulate
from cosim.fmu.description import read_fmu
from cosim.fmu.places import shipped_systems

INTEGERS = {name: np.iinfo(name.lower()) for name in TYPES3 if "Int" in name}


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("three")
    write_echo3(folder / "Echo.fmu")
    write_fmu(folder / "Probe.fmu", PROBE, binary=probe_library().read_bytes())
    return folder


def run(fmus: Path, connections: list[str], record: list[str], **start: Any) -> Any:
    """The echo, and a lag of FMI 2.0 named ``lag`` with input 1; steps of 0.125 s up to 1 s."""
    document: dict[str, Any] = {
        "instances": {
            "echo": {"fmu": "Echo", "start": start},
            "lag": {"fmu": "Probe", "start": {"u": 1.0, "y_start": 0.25, "count_in": 6, "flag_in": False}},
        },
        "connections": connections,
        "experiment": {"stop_time": 1.0, "step_size": 0.125},
        "record": {"variables": record},
    }
    return simulate(make_system(document, name="echo", fmus=fmus))


@pytest.mark.parametrize("mixed", [False, True])
@pytest.mark.parametrize(
    "name", ["maeda2008/pulse", "rubio2015/p_pi_observer", "shams2010/dbb_fsmc", "feng2015/circle_two_mass"]
)
def test_results_are_those_of_fmi2_to_the_last_bit(native: Path, fmi3: Path, name: str, mixed: bool) -> None:
    given = read_system(shipped_systems()[name])
    instances = {
        instance.name: {
            **given.document["instances"][instance.name],
            "fmu": str((native if mixed and number % 2 else fmi3) / instance.fmu.path.name),
        }
        for number, instance in enumerate(given.instances)
    }
    stop = given.start_time + min(given.steps, 1000) * given.step_size
    two = make_system(given.document, name=name, folder=given.folder, fmus=native).changed(stop_time=stop)
    three = make_system({**given.document, "instances": instances}, name=name, folder=given.folder)
    versions = {instance.fmu.fmi for instance in three.instances}
    assert versions == ({2, 3} if mixed else {3})
    expected, found = simulate(two), simulate(three.changed(stop_time=stop))
    assert np.array_equal(found.rows, expected.rows)
    assert found.solver == expected.solver


@pytest.mark.parametrize("type_name", TYPES3)
def test_elements_of_every_type_are_fed_and_read(fmus: Path, type_name: str) -> None:
    source = {"Boolean": "flag", "Float64": "y", "Float32": "y"}.get(type_name, "count")
    first, last = (True, False) if type_name == "Boolean" else (1, 3)
    u, y = f"u_{type_name}", f"y_{type_name}"
    connections, record = [f"lag.{source} -> echo.{u}[2]"], [f"echo.{y}", f"lag.{source}"]
    result = run(fmus, connections, record, **{f"{u}[1]": first, f"{u}[3]": last})
    given = result[f"lag.{source}"]
    assert result[f"echo.{y}[1]"].tolist() == [first] * 9
    assert result[f"echo.{y}[3]"].tolist() == [last] * 9
    expected = given.astype(np.float32) if type_name == "Float32" else given
    assert given.any()
    assert np.array_equal(result[f"echo.{y}[2]"], expected)


@pytest.mark.parametrize("type_name", INTEGERS)
def test_start_values_reach_to_the_ends_of_their_type(fmus: Path, type_name: str) -> None:
    ends = INTEGERS[type_name]
    u, y = f"u_{type_name}", f"y_{type_name}"
    result = run(fmus, [], [f"echo.{y}"], **{u: [int(ends.min), int(ends.max), 0]})
    assert result.rows[-1].tolist() == [float(ends.min), float(ends.max), 0.0]
    for wrong in (int(ends.min) - 1, int(ends.max) + 1):
        with pytest.raises(DescriptionError, match=rf"{wrong} does not fit {type_name}, which is"):
            run(fmus, [], [f"echo.{y}"], **{f"{u}[1]": wrong})


def test_an_array_of_the_description_starts_with_its_values(tmp_path: Path) -> None:
    write_echo3(tmp_path / "Echo.fmu", starts={"Int8": "1 -2 3", "Float64": "0.5", "UInt16": "1 2"})
    fmu = read_fmu(tmp_path / "Echo.fmu")
    assert [fmu.variables[f"u_Int8[{i}]"].start for i in (1, 2, 3)] == [1, -2, 3]
    assert [fmu.variables[f"u_Float64[{i}]"].start for i in (1, 2, 3)] == [0.5] * 3
    assert fmu.arrays["u_Int8"].shape == (3,)
    assert "variable 'u_UInt16' has 2 start values for 3 elements. Left out." in fmu.findings


@pytest.mark.parametrize("type_name", ["UInt8", "UInt64", "Int16", "Float32"])
def test_bounds_of_every_number_count(tmp_path: Path, type_name: str) -> None:
    attributes = 'valueReference="999" causality="parameter" variability="fixed" start="5" min="2" max="9"'
    write_echo3(tmp_path / "Echo.fmu", more=f'<{type_name} name="p" {attributes}/>')
    variable = read_fmu(tmp_path / "Echo.fmu").variables["p"]
    assert (variable.min, variable.max) == (2.0, 9.0)


@pytest.mark.parametrize(("type_name", "given"), [("UInt8", 300), ("Int8", 127), ("UInt16", 65535)])
def test_a_value_beyond_its_type_is_told(fmus: Path, type_name: str, given: int) -> None:
    document: dict[str, Any] = {
        "instances": {"echo": {"fmu": "Echo"}, "lag": {"fmu": "Probe", "start": {"count_in": given}}},
        "connections": [f"lag.count -> echo.u_{type_name}[1]"],
        "experiment": {"stop_time": 1.0, "step_size": 0.125},
    }
    with pytest.raises(SignalError, match=rf"the value {given + 1} at 0 s: beyond what {type_name} can be"):
        simulate(make_system(document, name="echo", fmus=fmus))


@pytest.mark.parametrize("isolated", [False, True])
@pytest.mark.parametrize("end", [0.125, 0.5, 1.0])
def test_terminate_ends_the_run(fmus: Path, end: float, isolated: bool) -> None:
    def system(at: float) -> Any:
        document: dict[str, Any] = {
            "instances": {
                "lag": {"fmu": "Probe", "start": {"u": 1.0}},
                "echo": {"fmu": "Echo", "start": {"terminate_at": at}},
            },
            "connections": ["lag.y -> echo.u"],
            "experiment": {"stop_time": 2.0, "step_size": 0.125},
            "record": {"variables": ["echo.y", "lag.y"]},
        }
        return make_system(document, name="echo", fmus=fmus)

    result, whole = simulate(system(end), isolated=isolated), simulate(system(1e9))
    assert not result.partial
    assert result.time[-1] == end
    assert np.array_equal(result.rows, whole.rows[: result.time.size])
    assert any(m.instance == "echo" and m.category == "terminated" for m in result.messages)


@pytest.mark.parametrize("at", [0.125, 0.5, 1.0])
def test_an_early_return_is_told(fmus: Path, at: float) -> None:
    before = at - 0.125
    text = rf"echo: fmi3DoStep at {before:g} s returned early, at {before + 0.0625:g} s, though told not to"
    with pytest.raises(RunError, match=text) as caught:
        run(fmus, [], ["echo.y"], early_at=at)
    assert caught.value.result is not None
    assert caught.value.result.time[-1] == before


CLOCK = '<Clock name="tick" valueReference="90" causality="input" intervalVariability="triggered"/>'


@pytest.mark.parametrize(
    ("header", "said"),
    [
        ({"more": CLOCK}, "its model has clocks (tick), and cosim activates no clocks"),
        ({"interface": "ScheduledExecution"}, "only for scheduled execution"),
        ({"interface": "ModelExchange"}, "only for model exchange"),
    ],
)
def test_what_cannot_run_is_said_and_shown(tmp_path: Path, header: dict[str, Any], said: str) -> None:
    path = write_echo3(tmp_path / "Echo.fmu", **header)
    assert "u_Int8[2]" in read_fmu(path).variables
    document = {"instances": {"echo": {"fmu": str(path)}}, "experiment": {"stop_time": 1.0, "step_size": 0.125}}
    with pytest.raises(DescriptionError) as caught:
        make_system(document, name="echo")
    assert said in str(caught.value)


def test_states_and_derivatives_of_fmi3(native: Path, fmi3: Path) -> None:
    given = read_system(shipped_systems()["maeda2008/step"])
    matrices: list[Any] = []
    for folder in (native, fmi3):
        system = make_system(given.document, name="step", folder=given.folder, fmus=folder)
        with Simulation(system) as simulation:
            middle = float(system.start_time + system.steps // 4 * system.step_size)
            checkpoint = simulation.pause(middle)
            rows = simulation.resume(checkpoint, stop_time=2 * middle).rows
            simulation.restore(checkpoint)
            plant = next(i for i in system.instances if any(v.derivative_of for v in i.fmu.variables.values()))
            rates = {v.name: v.derivative_of for v in plant.fmu.variables.values() if v.derivative_of is not None}
            matrices.append((rows, simulation.partial_derivatives(plant.name, list(rates), list(rates.values()))))
    assert np.array_equal(matrices[0][0], matrices[1][0])
    assert np.array_equal(matrices[0][1], matrices[1][1])
    assert matrices[0][1].any()


def test_an_alias_is_a_variable_of_its_own_name(tmp_path: Path) -> None:
    """As in the Reference FMU BouncingBall, whose height has another name for another unit."""
    level = '<UInt8 name="level" valueReference="40" causality="local" max="9"><Alias name="level_alias"/></UInt8>'
    path = write_echo3(tmp_path / "Alias.fmu", more=level)
    variables = read_fmu(path).variables
    assert (variables["level"].max, variables["level_alias"].max) == (9.0, 9.0)
    assert variables["level_alias"].reference == variables["level"].reference
    assert simulate(read_system(path, stop_time=1)).time[-1] == 1.0
