"""Procedures in SI units on FMUs that state other units: values are converted, or the FMU is refused by name."""

from __future__ import annotations

import math
import shutil
import tomllib
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim.design import identify, pulse, stability
from cosim.design.quantities import gain_factor, quotient_factor, si_factor
from cosim.design.reversals import Axis, AxisRuns, Reversals, axis_system, reversal_errors
from cosim.design.search import Limit
from cosim.design.workers import unload
from cosim.errors import DescriptionError
from cosim.system.system import System, read_system

etree: Any = import_module("lxml.etree")

STUDIES = Path(__file__).parents[2] / "studies"
BASE_UNITS = {
    "mm": 'm="1" factor="0.001"',
    "um": 'm="1" factor="1e-6"',
    "mm/s": 'm="1" s="-1" factor="0.001"',
    "mm/s2": 'm="1" s="-2" factor="0.001"',
    "deg": f'rad="1" factor="{math.pi / 180.0!r}"',
    "ms": 's="1" factor="0.001"',
    "kN": 'kg="1" m="1" s="-2" factor="1000"',
    "kg": 'kg="1"',
    "degC": 'K="1" offset="273.15"',
    "A.s/mm": 'A="1" s="1" m="-1" factor="1000"',
    "A/mm": 'A="1" m="-1" factor="1000"',
    "pixel": "",
    "V/m": 'kg="1" m="1" s="-3" A="-1"',
}
Restate = Callable[..., System]


@pytest.fixture
def restated(native: Path, tmp_path: Path) -> Restate:
    """A function: a shipped system with FMUs that state other units of variables ``{FMU: {VARIABLE: UNIT}}``."""

    def restate(name: str, units: Mapping[str, Mapping[str, str]]) -> System:
        folder = tmp_path / "fmus"
        shutil.copytree(native, folder)
        for fmu, stated in units.items():
            with zipfile.ZipFile(native / f"{fmu}.fmu") as source:
                members = {entry.filename: source.read(entry) for entry in source.infolist()}
            root = etree.fromstring(members["modelDescription.xml"])
            for variable in root.iterfind("ModelVariables/ScalarVariable"):
                unit = stated.get(variable.get("name").partition("[")[0])
                if unit is not None:
                    (real,) = variable.iterfind("Real")
                    real.attrib.pop("displayUnit", None)
                    real.set("unit", unit)
            known = root.find("UnitDefinitions")
            for unit in set(stated.values()) - {each.get("name") for each in known}:
                base = f"<BaseUnit {BASE_UNITS[unit]}/>" if BASE_UNITS[unit] else ""
                known.append(etree.fromstring(f'<Unit name="{unit}">{base}</Unit>'))
            members["modelDescription.xml"] = etree.tostring(root)
            with zipfile.ZipFile(folder / f"{fmu}.fmu", "w") as target:
                for member, content in members.items():
                    target.writestr(member, content)
        return read_system(STUDIES / name, fmus=folder)

    return restate


CIRCLE = "feng2015/circle.toml"
OTHER = {
    "Trajectory": {"radius": "mm", "feed": "mm/s", "phase": "deg"},
    "FrictionPulse": {
        "A": "mm/s",
        "T": "ms",
        "t_r": "ms",
        "table.acceleration": "mm/s2",
        "table.amplitude": "mm/s",
        "table.duration": "ms",
    },
    "BallscrewStage": {"position_start": "um", "velocity_start": "mm/s"},
    "CascadePid": {"integral_start": "kN"},
}


def test_learning_sets_values_in_the_units_of_their_variables(restated: Restate, native: Path) -> None:
    axis = Axis.named("x")
    plain = Reversals.of(axis_system(read_system(STUDIES / CIRCLE, fmus=native), axis), axis, 0.05)
    other = Reversals.of(axis_system(restated(CIRCLE, OTHER), axis), axis, 0.05)
    values = {**axis.circle(0.05, 0.01), **axis.one_pulse(0.5e-3, 0.08)}
    assert plain.in_units(values) == values
    scale = {"radius": 1e3, "feed": 1e3, "phase": 180.0 / math.pi, "A": 1e3, "T": 1e3}
    scale |= {"position_start": 1e6, "velocity_start": 1e3}
    given = {path: scale[path.partition(".")[2]] * value for path, value in values.items()}
    assert other.in_units(values) == pytest.approx(given, rel=1e-14)
    assert (plain.friction, other.friction) == (1.0, pytest.approx(1e-3, rel=1e-15))


def test_learning_reads_errors_in_metres(native: Path) -> None:
    with AxisRuns(read_system(STUDIES / CIRCLE, fmus=native), Axis.named("x")) as runs:
        given = runs.given
    job = 10e-3, [(0.0, 0.0)], 0.1
    (plain,) = reversal_errors(given, job)
    millimetres = {**given.factors, **dict.fromkeys(given.axis.recorded, 1e-3)}
    (scaled,) = reversal_errors(replace(given, factors=millimetres), job)
    unload()
    assert np.max(np.abs(plain)) > 1e-6
    assert scaled == pytest.approx(1e-3 * plain, rel=1e-9, abs=1e-15)


def test_learned_tables_are_in_the_units_of_their_variables(restated: Restate, tmp_path: Path) -> None:
    nodes = np.geomspace(2e-3, 120e-3, 60)
    tables = pulse.Tables(nodes, 0.1 * nodes, 1.0 / nodes)
    one = np.ones(4)
    learned = {"pulse_x": pulse.Learned(one, one, one, one, one, 1.0, tables, one, {}, 0.0)}
    pulse.write_start(learned, tmp_path / "si.toml")
    pulse.write_start(learned, tmp_path / "other.toml", system=restated(CIRCLE, OTHER))
    si, other = (
        tomllib.loads((tmp_path / f"{name}.toml").read_text(encoding="utf-8"))["instances"]["pulse_x"]["start"]
        for name in ("si", "other")
    )
    for name in ("acceleration", "amplitude", "duration"):
        assert other[f"table.{name}"] == pytest.approx([1e3 * value for value in si[f"table.{name}"]], rel=1e-8)


def test_learning_refuses_units_that_do_not_fit_before_the_first_run(restated: Restate) -> None:
    units = {"Trajectory": {"radius": "kg"}, "FrictionPulse": {"A": "pixel"}}
    system = restated(CIRCLE, {**units, "BallscrewStage": {"velocity_start": "degC"}})
    with pytest.raises(DescriptionError) as caught:
        pulse.learn_friction_pulse(system, "x", progress=lambda *given: pytest.fail("a run was made"))
    assert caught.value.problems == (
        "circle.toml: trajectory_x.radius is in kg: it must be in m, or a multiple.",
        "circle.toml: plant_x.velocity_start is in degC: it must be in m/s, or a multiple.",
        "circle.toml: pulse_x.A is in pixel: nothing says what this unit is.",
    )


def test_learning_refuses_a_lead_that_gives_another_quantity(restated: Restate) -> None:
    system = restated(CIRCLE, {"CascadePid": {"l_p": "ms"}})
    with pytest.raises(DescriptionError, match=r"friction_torque in N\.m divided by controller_x\.l_p in ms does not"):
        pulse.learn_friction_pulse(system, "x")


NCTF = {"NctfPi": {"nct.error": "um", "nct.rate": "mm/s", "K_P": "A.s/mm", "K_I": "A/mm", "T_s": "ms"}}
CURVE = {"alpha": 500.0, "e_lin": 1e-6, "K": 0.03, "u_r": 1.0, "t_r": 0.1, "rest": 1e-3, "stop": 1e-3, "h_max": 1e-2}


def curve() -> identify.Nct:
    error = np.concatenate(([0.0], np.geomspace(1e-6, 1e-3, 400)))
    rate = 1e-2 * (1.0 - np.exp(-500.0 / 1e-2 * error))
    return identify.Nct(**CURVE, reach=1e-3, error=error, rate=rate, measured_error=error, measured_rate=rate)


def test_an_nct_is_written_in_the_units_of_its_controller(restated: Restate, tmp_path: Path) -> None:
    nct = curve()
    identify.write_start(nct, tmp_path / "si.toml", gains=(960.0, 9e4))
    identify.write_start(nct, tmp_path / "other.toml", gains=(960.0, 9e4), system=restated("maeda2008/step.toml", NCTF))
    si, other = (
        tomllib.loads((tmp_path / f"{name}.toml").read_text(encoding="utf-8"))["instances"]["controller"]["start"]
        for name in ("si", "other")
    )
    assert other["nct.error"] == pytest.approx([1e6 * value for value in si["nct.error"]], rel=1e-9)
    assert other["nct.rate"] == pytest.approx([1e3 * value for value in si["nct.rate"]], rel=1e-9)
    assert (si["K_P"], si["K_I"], other["K_P"], other["K_I"]) == pytest.approx((960.0, 9e4, 0.96, 90.0))


def test_an_nct_is_refused_by_a_controller_of_other_quantities(restated: Restate, tmp_path: Path) -> None:
    system = restated("maeda2008/step.toml", {"NctfPi": {"nct.error": "kg"}})
    with pytest.raises(
        DescriptionError, match=r"controller\.nct\.error is in kg: it must be in m or rad, or a multiple"
    ):
        identify.write_start(curve(), tmp_path / "start.toml", system=system)
    assert not (tmp_path / "start.toml").exists()


def test_a_map_counts_gains_and_times_in_their_units(
    restated: Restate, native: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    integrals: list[Any] = []

    def oscillates(self: Any, changes: Mapping[str, object]) -> Callable[[float], bool]:
        integrals.append(changes["controller.K_I"])
        return lambda gain: False

    monkeypatch.setattr(stability._Trials, "oscillates", oscillates)
    monkeypatch.setattr(stability, "search_limit", lambda oscillates, first, last: Limit(100.0, 100.0, 1))
    cases = [stability.Case("one", {}, [0.1, 0.2], 505.0)]
    # a sampling time of 2e-4 s
    plain = stability.limit_map(read_system(STUDIES / "maeda2008/step.toml", fmus=native), cases, K=0.03)
    other = restated("maeda2008/step.toml", NCTF).changed({"controller.T_s": 0.2})
    found = stability.limit_map(other, cases, K=0.03)
    # a case sets the integral gain to 0, and then to that of each W
    assert integrals[3:] == pytest.approx([1e-3 * value for value in integrals[:3]], rel=1e-12)
    assert integrals[1] > 0.0
    # the same number stands for a gain that is 1000 times as large
    assert [point.practical for point in found.points] == pytest.approx([1e3 * p.practical for p in plain.points])
    assert [point.linear for point in found.points] == pytest.approx([point.linear for point in plain.points])


@pytest.mark.parametrize(("unit", "factor"), [("um", 1e6), ("mm", 1e3), ("m", 1.0), ("deg", 180.0 / math.pi)])
def test_the_practical_limit_takes_its_swing_in_the_unit_of_the_position(
    restated: Restate, unit: str, factor: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    swings: list[float] = []

    def oscillates(self: Any, changes: Mapping[str, object]) -> Callable[[float], bool]:
        swings.append(self.swing)
        return lambda gain: False

    monkeypatch.setattr(stability._Trials, "oscillates", oscillates)
    # an output that nothing is connected to
    system = restated("maeda2008/step.toml", {"NctfPi": {"error": unit}})
    stability.practical_limit(system, position="controller.error", swing=5e-8)
    assert swings == pytest.approx([factor * 5e-8])


def test_the_practical_limit_refuses_what_is_no_position(native: Path) -> None:
    system = read_system(STUDIES / "maeda2008/step.toml", fmus=native)
    with pytest.raises(DescriptionError, match=r"controller\.command is in A: it must be in m or rad, or a multiple"):
        stability.practical_limit(system, position="controller.command")


def test_factors(restated: Restate) -> None:
    system = restated("maeda2008/step.toml", {"NctfPi": {"K_P": "V/m", "command_max": "1"}})
    assert si_factor(system, "controller.T_s", "s") == 1.0
    assert si_factor(system, "controller.command_max", "m") == 1.0
    assert gain_factor(system, "controller.K_P", "plant.command", "m/s") == 1.0
    assert gain_factor(system, "controller.command_max", "plant.command", "m") == 1.0
    assert quotient_factor(system, "controller.command_max", "controller.T_s", "controller.K_I") == 1.0
    with pytest.raises(DescriptionError, match="no instance 'motor'"):
        si_factor(system, "motor.x", "m")
