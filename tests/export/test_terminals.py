"""Terminals name variables of their FMU; wiring those of one name gives the connections of the shipped systems."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree

import fmpy
import pytest
from conftest import ROOT, WORKSPACE

from cosim.export.terminals import terminals
from cosim.system.system import read_system

COMPONENTS = sorted(WORKSPACE.components())


@pytest.mark.parametrize("flavour", ["native", "python", "fmi3"])
def test_file_names_variables(request: pytest.FixtureRequest, flavour: str) -> None:
    folder: Path = request.getfixturevalue(flavour)
    for name in COMPONENTS:
        path = folder / f"{name}.fmu"
        with zipfile.ZipFile(path) as archive:
            content = archive.read("terminalsAndIcons/terminalsAndIcons.xml")
        causalities = {v.name: v.causality for v in fmpy.read_model_description(path).modelVariables}
        for terminal in ElementTree.fromstring(content).iter("Terminal"):
            members = [member.attrib for member in terminal]
            assert {causalities[m["variableName"]] for m in members} <= {"input", "output"}, name
            assert len({m["memberName"] for m in members}) == len(members)


def wired(kinds: Mapping[str, str]) -> set[tuple[str, str]]:
    """Connections between instances, given by component: terminals of one name, members of one name."""
    ends = {
        instance: {
            (terminal.name, member): variable
            for terminal in terminals(WORKSPACE.component(kind))
            for member, variable in terminal.members.items()
        }
        for instance, kind in kinds.items()
    }
    roles = {
        (instance, v.name): v.causality
        for instance, kind in kinds.items()
        for v in fmpy.read_model_description(ROOT / "build" / "fmus" / "native" / f"{kind}.fmu").modelVariables
    }
    return {
        (f"{source}.{ends[source][place]}", f"{target}.{ends[target][place]}")
        for source in kinds
        for target in kinds
        for place in ends[source].keys() & ends[target].keys()
        if roles[source, ends[source][place]] == "output" and roles[target, ends[target][place]] == "input"
    }


VELOCITY = {("plant.velocity", "controller.velocity")}


@pytest.mark.parametrize(
    ("path", "names", "single", "unused"),
    [
        # system, instances, connections that are no part of a terminal, members that this system leaves open
        ("shams2010/fsmc_5sin", ["trajectory", "controller", "plant"], set(), set()),
        ("maeda2008/step", ["trajectory", "controller", "plant"], set(), VELOCITY),
        ("rubio2015/super_twisting", ["controller", "plant"], set(), VELOCITY),
        (
            "feng2015/circle_pulse",
            ["trajectory_x", "pulse_x", "controller_x", "plant_x"],
            {("plant_x.angle", "controller_x.motor_position")},
            {
                ("plant_x.velocity", "controller_x.velocity"),
                ("trajectory_x.acceleration", "controller_x.acceleration_ref"),
                ("trajectory_x.velocity", "controller_x.velocity_ref"),
            },
        ),
    ],
)
def test_terminals_wire_a_shipped_system(
    native: Path, path: str, names: list[str], single: set[tuple[str, str]], unused: set[tuple[str, str]]
) -> None:
    system = read_system(ROOT / "studies" / f"{path}.toml", fmus=native)
    kinds = {name: system.instance(name).fmu.name for name in names}
    connected = {
        (".".join(c.source), ".".join(c.target))
        for c in system.connections
        if c.source[0] in kinds and c.target[0] in kinds
    }
    found = wired(kinds)
    assert connected - found == single
    assert found - connected == unused
