"""documentation/index.html of the FMUs: complete, well-formed, right about what it shows."""

from __future__ import annotations

import html
import inspect
import json
import zipfile
from html.parser import HTMLParser
from pathlib import Path, PurePosixPath
from typing import Any

import pytest
from conftest import WORKSPACE

from cosim.export.assets import MEASURED, folder
from cosim.export.interface import variables_of
from cosim.export.page import documentation
from cosim.export.trace import trace
from cosim.model import Choice, Record, Source, parameter, variable

COMPONENTS = sorted(WORKSPACE.components())
VOID = {"meta", "img", "link", "br"}


class Reader(HTMLParser):
    """Checks that every element is closed where it should be; keeps text, links and equations.

    A formula of MathML counts as its alternative text.
    """

    def __init__(self, page: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.links: list[str] = []
        self.seen: list[str] = []
        self.text = ""
        self.blocks: list[str] = []
        self.depth = 0
        self.feed(page)
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.seen.append(tag)
        self.links += [str(value) for name, value in attrs if name in ("src", "href")]
        if tag == "img":
            assert dict(attrs).get("alt")
        if ("class", "equations") in attrs:
            self.blocks.append("")
            self.depth = len(self.open) + 1
        if tag == "math":
            self.blocks[-1] += str(dict(attrs)["alttext"])
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag
        self.depth = 0 if len(self.open) < self.depth else self.depth

    def handle_data(self, data: str) -> None:
        self.text += data
        if self.depth and len(self.open) >= self.depth and "math" not in self.open:
            self.blocks[-1] += data


def page_of(path: Path) -> tuple[str, set[str]]:
    with zipfile.ZipFile(path) as archive:
        return archive.read("documentation/index.html").decode(), set(archive.namelist())


@pytest.mark.parametrize("flavour", ["native", "python", "fmi3"])
@pytest.mark.parametrize("name", COMPONENTS)
def test_pages_are_well_formed_and_every_link_leads_into_the_fmu(
    flavour: str, name: str, request: pytest.FixtureRequest
) -> None:
    page, members = page_of(request.getfixturevalue(flavour) / f"{name}.fmu")
    reader = Reader(page)
    assert page.startswith("<!DOCTYPE html>")
    assert "script" not in reader.seen
    icon = "../terminalsAndIcons/icon.png" if flavour == "fmi3" else "../model.png"
    assert {icon, "validation.png", "fmi-ls-ref.txt"} < set(reader.links)
    for link in reader.links:
        target = PurePosixPath("documentation") / link
        assert str(target).replace("documentation/../", "") in members, link
    assert ("resources/motion_cosim" in page) == (flavour == "python")
    assert f"cosim verify {name}.fmu" in reader.text


@pytest.mark.parametrize("name", COMPONENTS)
def test_pages_say_all_that_the_docstring_and_the_declaration_say(native: Path, name: str) -> None:
    kind = WORKSPACE.component(name)
    reader = Reader(page_of(native / f"{name}.fmu")[0])
    doc = inspect.getdoc(kind) or ""
    equations = [block for block in doc.split("\n\n") if block.startswith("    ")]
    assert ["".join(block.split()) for block in reader.blocks] == ["".join(block.split()) for block in equations]
    said = " ".join(reader.text.split())
    for paragraph in doc.split("\n\n"):
        if not paragraph.startswith("    "):
            words = " ".join(paragraph.replace("``", "").split()).removeprefix("Source: ")
            assert words in said
    assert {"Source", "Equations", "Parameters", "Outputs", "Validation"} <= set(reader.text.splitlines())
    for v in variables_of(kind):
        if v.role != "derivative" and "[" not in v.name:
            assert v.name in said
            assert " ".join(v.description.split()) in said


@pytest.mark.parametrize("name", COMPONENTS)
def test_measured_differences_are_those_of_the_last_validation(native: Path, name: str) -> None:
    page = page_of(native / f"{name}.fmu")[0]
    facts: Any = json.loads((folder(WORKSPACE.components()[name], name) / MEASURED).read_text())
    for experiment in facts["experiments"]:
        for signal in experiment["signals"]:
            cells = (
                experiment["name"],
                *(f"{signal[key]:.{n}g}" for key, n in (("largest_value", 3), ("largest_difference", 2))),
            )
            row = f'<th scope="row">{signal["name"]}</th><td>{cells[0]}</td>'
            assert f'{row}<td class="n">{cells[1]}</td><td class="n">{cells[2]}</td>' in page


class Form(Choice):
    """A choice."""

    round_one = 1, "Round & <smooth>"
    square = 2, "Square"


class Plain(Source):
    """A component without references, with signs that HTML must escape: a < b & c.

        y = a*x < 1 & "quoted"

    Source: nobody, ``code``.
    """

    form: Form = parameter(Form.square, "1", "Form <of it>")
    T_s: float = parameter(2e-3, "s", "Time", min=0.0, max=1.0, display_unit="ms")
    table: tuple[float, ...] = parameter((0.0, 1.0, 4.0), "um/s2", "Table")

    class Output(Record):
        y: float = variable(0.0, "N.m/rad", "Result")

    def output(self, t: float) -> Output:
        return self.Output(y=self.table[2] * t)


def test_a_component_without_references_has_a_page_without_validation() -> None:
    page = documentation(trace(Plain), "1.0").decode()
    reader = Reader(page)
    assert "Validation" not in reader.text
    assert reader.links == ["licenses/license.txt"]
    assert [block.strip() for block in reader.blocks] == ['y = a*x < 1 & "quoted"']
    assert html.escape("Form <of it>: round_one = Round & <smooth>; square = Square") in page
    assert '<td class="n">0.002</td><td>s</td><td class="n">2 ms</td><td>0 ... 1</td>' in page
    assert '<th scope="row">table[1 ... 3]</th><td class="n">0 ... 4</td><td>&micro;m/s<sup>2</sup></td>' in page
    assert "<td>N&middot;m/rad</td>" in page
    assert "nobody, <code>code</code>." in page
