"""The pages of components on the site: whole, with a system that runs, and with every picture described."""

from __future__ import annotations

import html
import inspect
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT, WORKSPACE

from cosim.export.interface import variables_of
from cosim.fmu.places import find_system
from cosim.master.simulation import simulate
from cosim.system.system import read_system
from docs.generate import components

NAMES = sorted(WORKSPACE.components())
PICTURE = re.compile(r"!\[([^\]]*)\]\(([^)]*)\)")


@pytest.fixture(scope="module")
def folder(native: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the pages, as the build of the site has it."""
    site = tmp_path_factory.mktemp("site")
    shutil.copytree(ROOT / "docs" / "components", site / "components")
    components.write(site)
    return site / "components"


@pytest.mark.parametrize("name", NAMES)
def test_a_page_names_every_variable_with_its_meaning(folder: Path, name: str) -> None:
    page = (folder / f"{name}.md").read_text(encoding="utf-8")
    plain = html.unescape(" ".join(re.sub(r"\\(.)", r"\1", page).split()))
    for variable in variables_of(WORKSPACE.component(name)):
        if variable.role != "derivative":
            row = f"| `{variable.name}` |" if variable.array is None else f"| `{variable.array}[1 ... "
            assert row in plain, variable.name
            assert " ".join(variable.description.split()).replace("``", "`") in re.sub("</?code>", "`", plain)


@pytest.mark.parametrize("name", NAMES)
def test_a_page_holds_the_equations_of_the_docstring(folder: Path, name: str) -> None:
    page = (folder / f"{name}.md").read_text(encoding="utf-8")
    shown = "".join("".join(block.split()) for block in re.findall(r"```\{equations\}\n:text:\n(.*?)```", page, re.S))
    blocks = [block for block in (inspect.getdoc(WORKSPACE.component(name)) or "").split("\n\n") if block[:4] == "    "]
    assert shown == "".join("".join(block.split()) for block in blocks)
    assert shown


@pytest.mark.parametrize("name", [*NAMES, "index"])
def test_every_picture_is_there_and_says_what_it_shows(folder: Path, name: str) -> None:
    found = PICTURE.findall((folder / f"{name}.md").read_text(encoding="utf-8"))
    assert len(found) >= 2
    for text, file in found:
        assert len(text) > 8
        assert (folder / file).is_file()


def test_the_list_has_every_component_once_and_the_guide_leads_to_each(folder: Path) -> None:
    guide, listed = (folder / "index.md").read_text(encoding="utf-8").split("## Plants")
    for name in NAMES:
        assert f"[{name}]({name}.md)" in guide
        assert listed.count(f"[{name}]({name}.md)") == 1
    assert "%" not in listed


@pytest.mark.parametrize("name", NAMES)
def test_the_system_of_a_page_runs(native: Path, folder: Path, name: str, tmp_path: Path) -> None:
    text, place = components.example(name)
    assert not place or find_system(place).is_file()
    assert text.strip() in (folder / f"{name}.md").read_text(encoding="utf-8")
    file = tmp_path / f"{name}.toml"
    file.write_text(text, encoding="utf-8")
    system = read_system(file, fmus=native)
    used = [instance.name for instance in system.instances if instance.fmu.path.stem == name]
    assert used, "the system has the component"
    outputs = [f"{used[0]}.{output}" for output in system.instance(used[0]).fmu.outputs]
    result = simulate(system.changed(record=outputs))
    assert all(np.isfinite(result[output]).all() for output in outputs)
    assert any(np.ptp(result[output]) > 0.0 for output in outputs), "it moves"


def test_importers_of_a_page_are_those_of_the_last_conformance_run(folder: Path) -> None:
    rows = json.loads(components.IMPORTERS.read_text(encoding="utf-8"))
    assert {name for row in rows for name in row["components"]} == set(NAMES)
    for name in NAMES:
        page = (folder / f"{name}.md").read_text(encoding="utf-8").rsplit("## Importers", 1)[1]
        for row in rows:
            held = row["components"].get(name)
            agreed = held and held["difference"] is not None and held["ran"] == held["jobs"] and not held["problems"]
            if agreed:
                assert f"| {components.escaped(row['importer'])} | {components.escaped(row['version'])} |" in page
        assert page.count("\n| ") > 2, "some importer ran it"
