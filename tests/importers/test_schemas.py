"""Every XML file in an FMU against the schemas of FMI that FMPy ships."""

from __future__ import annotations

import re
import zipfile
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

import fmpy
import pytest
from conftest import WORKSPACE

etree: Any = import_module("lxml.etree")
SCHEMAS = Path(fmpy.__file__).parent / "schema"
FILES = (
    (r"modelDescription\.xml", "{version}ModelDescription"),
    (r"sources/buildDescription\.xml", "fmi3BuildDescription"),
    (r"terminalsAndIcons/terminalsAndIcons\.xml", "fmi3TerminalsAndIcons"),
)
"""Path in an FMU -> schema; buildDescription and terminalsAndIcons of FMI 2.0.4 are those of FMI 3.0."""
MANIFEST = r"extra/[^/]+/fmi-ls-manifest\.xml"
MANIFEST_SPACE = "{http://fmi-standard.org/fmi-ls-manifest}"
EXTRA = r"extra/.+"
"""Other files under extra/ follow standards of their own, which have no schema here."""


@cache
def schema(name: str) -> Any:
    return etree.XMLSchema(etree.parse(str(SCHEMAS / name[:4] / f"{name}.xsd")))


def manifest_attributes() -> set[str]:
    """Attributes that the manifest of a layered standard must have; the schema declares no root element."""
    space = {"xs": "http://www.w3.org/2001/XMLSchema"}
    document = etree.parse(str(SCHEMAS / "fmi3" / "fmi3LayeredStandardManifest.xsd"))
    return {MANIFEST_SPACE + element.get("name") for element in document.findall("xs:attribute", space)}


def problems(path: Path) -> list[str]:
    """What is wrong with the XML files of an FMU."""
    found: list[str] = []
    with zipfile.ZipFile(path) as archive:
        version = "fmi3" if b'fmiVersion="3' in archive.read("modelDescription.xml") else "fmi2"
        for name in archive.namelist():
            if not name.endswith(".xml"):
                continue
            try:
                document = etree.fromstring(archive.read(name))
            except etree.XMLSyntaxError as error:
                found.append(f"{name}: {error}")
                continue
            known = [s.format(version=version) for pattern, s in FILES if re.fullmatch(pattern, name)]
            if known and not schema(known[0]).validate(document):
                found += [f"{name}, line {entry.line}: {entry.message}" for entry in schema(known[0]).error_log]
            elif re.fullmatch(MANIFEST, name):
                missing = sorted(manifest_attributes() - set(document.attrib))
                found += [f"{name}: {attribute} is missing" for attribute in missing]
            elif not known and not re.fullmatch(EXTRA, name):
                found.append(f"{name}: no schema is known for it")
    return found


@pytest.mark.parametrize("flavour", ["native", "python", "fmi3"])
def test_fmus_follow_the_schemas(request: pytest.FixtureRequest, flavour: str) -> None:
    folder: Path = request.getfixturevalue(flavour)
    paths = sorted(folder.glob("*.fmu"))
    assert len(paths) == len(WORKSPACE.components())
    assert {path.name: found for path in paths if (found := problems(path))} == {}


WRONG = {
    "modelDescription.xml": (b'<fmiModelDescription fmiVersion="2.0"/>', "modelName"),
    "sources/buildDescription.xml": (
        b'<fmiBuildDescription fmiVersion="3.0"><Nothing/></fmiBuildDescription>',
        "Nothing",
    ),
    "terminalsAndIcons/terminalsAndIcons.xml": (
        b'<fmiTerminalsAndIcons fmiVersion="3.0"><No/></fmiTerminalsAndIcons>',
        "No",
    ),
    "extra/org.fmi-standard.fmi-ls-ref/fmi-ls-manifest.xml": (b"<fmiReferences/>", "fmi-ls-version"),
    "extra/org.example/broken.xml": (b"<open>", "open"),
    "elsewhere.xml": (b"<any/>", "no schema"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_file_is_found(native: Path, tmp_path: Path, name: str) -> None:
    content, word = WRONG[name]
    target = tmp_path / "PPi.fmu"
    with zipfile.ZipFile(native / "PPi.fmu") as source, zipfile.ZipFile(target, "w") as archive:
        for member in source.infolist():
            if member.filename != name:
                archive.writestr(member, source.read(member))
        archive.writestr(name, content)
    assert word in " ".join(problems(target))
