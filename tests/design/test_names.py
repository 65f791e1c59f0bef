"""Procedures of ``cosim.design`` take names of variables from files and arguments; none is written in them."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

from cosim.design.names import axis_names, nctf_names
from cosim.system.signals import SignalData
from cosim.system.system import read_system

ROOT = Path(__file__).parents[2]
DESIGN = sorted((ROOT / "src" / "cosim" / "design").glob("*.py"))
FMUS = [path for path in (ROOT / "fmus").glob("*/*.py") if path.parent.name != "references"]


def declared() -> set[str]:
    """Names of fields in the classes of components: no single letter, no plain word, and no key of a system file."""
    names: set[str] = set()
    for path in FMUS:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef):
                names |= {
                    item.target.id
                    for item in node.body
                    if isinstance(item, ast.AnnAssign) and isinstance(item.target, ast.Name)
                }
    return {name for name in names - {*SignalData.model_fields} if not re.fullmatch(r"[a-z]+|.", name)}


def texts(path: Path) -> list[str]:
    """The strings in a file that are no docstrings."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    said = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    return [
        node.value
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in said
    ]


def test_there_are_names_to_look_for() -> None:
    assert {"K_P", "K_I", "T_s", "F_C", "l_p", "velocity_start", "integral_start"} <= declared()


@pytest.mark.parametrize("path", DESIGN, ids=lambda path: path.name)
def test_no_procedure_names_a_variable_of_a_component(path: Path) -> None:
    named = {text.rpartition(".")[2] for text in texts(path) if re.fullmatch(r"[\w.]+", text)}
    assert not named & declared()


def test_the_names_of_the_studies_are_those_of_their_systems(native: Path) -> None:
    nctf = nctf_names()
    system = read_system(ROOT / "studies" / "maeda2008" / "step.toml", fmus=native)
    controller = nctf.controller
    for variable in (controller.proportional, controller.integral, controller.sampling_time):
        system.variable(controller.instance, variable)
    for array in (controller.nct_error, controller.nct_rate):
        assert array in system.instance(controller.instance).fmu.arrays
    for signal in (nctf.position, nctf.velocity, nctf.command):
        system.variable(*signal.split(".", 1))
    axis = axis_names()
    circle = read_system(ROOT / "studies" / "feng2015" / "circle.toml", fmus=native)
    for role, variables in (
        ("trajectory_x", [axis.trajectory.reference, axis.trajectory.radius, *axis.trajectory.start]),
        ("pulse_x", [axis.pulse.amplitude, axis.pulse.duration, axis.pulse.rise_time, *axis.pulse.single]),
        ("controller_x", [axis.controller.velocity, axis.controller.integral_start, axis.controller.lead]),
        ("plant_x", [axis.plant.position_start, axis.plant.friction, *axis.plant.start]),
    ):
        for variable in variables:
            circle.variable(role, variable)
