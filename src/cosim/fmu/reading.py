"""Reads a modelDescription.xml with FMPy and lists the rules of FMI that it breaks.

Many tools write descriptions that break some rule. A broken rule is only a finding as long as the file holds all that a
run needs. Parts that FMPy cannot read are mended first. Every such change is a finding, too.
"""

from __future__ import annotations

import codecs
import re
from importlib import import_module
from typing import Any

from ..errors import DescriptionError
from ..files import temporary_folder
from .variables import DisplayUnit
from .xml import parse

fmi: Any = import_module("fmpy.model_description")

RULES: dict[str, tuple[str, ...]] = {
    "parameter": ("fixed", "tunable"),
    "calculatedParameter": ("fixed", "tunable"),
    "input": ("discrete", "continuous"),
    "output": ("constant", "discrete", "continuous"),
    "local": ("constant", "fixed", "tunable", "discrete", "continuous"),
    "independent": ("continuous",),
}
"""For each causality, the variabilities that FMI 2.0 allows. The first one replaces one that is not allowed."""


def read_description(source: str, xml: bytes) -> tuple[Any, list[str]]:
    """FMPy's ModelDescription and the findings. Raises DescriptionError if ``xml`` is not the description of an FMU.

    ``source`` is the name of the FMU in messages.
    """
    said = f"{source}: modelDescription.xml"
    xml, findings = _readable(xml)
    try:
        root = parse(xml)
    except Exception as error:  # a damaged file can raise any exception of lxml
        raise DescriptionError(f"{said}: cannot be read: {error}") from None
    if root.tag != "fmiModelDescription" or root.get("fmiVersion") is None:
        raise DescriptionError(f"{said}: this is not the description of an FMU.")
    if root.find("ModelVariables") is None:
        raise DescriptionError(f"{said}: has no ModelVariables. Export the FMU again.")
    findings += _mend(root)
    with temporary_folder() as folder:
        file = folder / "modelDescription.xml"
        # If nothing was mended, the file is written unchanged: findings then have the line numbers of the original.
        file.write_bytes(import_module("lxml.etree").tostring(root) if findings else xml)
        broken: list[str] = []
        try:
            return _completed(fmi.read_model_description(str(file), validate=True), root), findings
        except fmi.ValidationError as error:
            broken += error.problems
        except Exception as error:  # FMPy raises bare exceptions
            broken.append(f"FMPy cannot validate it: {_text(error, str(file))}")
        try:
            return _completed(fmi.read_model_description(str(file), validate=False), root), [*findings, *broken]
        except Exception as error:
            # A broken rule tells more than the exception that follows from it.
            wrong = broken if isinstance(error, TypeError | ValueError) else []
            reasons = wrong or [_text(error, str(file))]
            raise DescriptionError([f"{said}: cannot be read: {text}" for text in (*reasons, *findings)]) from None


def _readable(xml: bytes) -> tuple[bytes, list[str]]:
    """A description with the blanks before it removed, and read as Windows-1252 if it is not the UTF-8 that it claims.

    Also returns one finding for each change.
    """
    findings: list[str] = []
    if xml[:1].isspace():
        xml = xml.lstrip()
        findings.append("begins with blanks, which XML does not allow. Left out.")
    stated = re.match(rb"""<\?xml[^>]*encoding=["']([\w-]+)""", xml)
    if stated is None or stated[1].lower() == b"utf-8":
        try:
            xml.decode()
        except UnicodeDecodeError as error:
            if not xml.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
                line = xml.count(b"\n", 0, error.start) + 1
                xml = xml.decode("cp1252", "replace").encode()
                findings.append(f"line {line} is not UTF-8 text. Read as Windows-1252.")
    return xml, findings


def _text(error: Exception, file: str) -> str:
    text = str(error).replace(file, "modelDescription.xml").strip()
    return f"{type(error).__name__} {text}".strip() if isinstance(error, LookupError) else text or type(error).__name__


def _completed(model: Any, root: Any) -> Any:
    """FMPy's ModelDescription with the attributes that FMPy does not read.

    These are relativeQuantity of all variables, the bounds of unsigned integers, and inverse of display units.
    """
    elements = {element.get("name"): element for element in root.iterfind("ModelVariables/*")}
    aliases = {alias.get("name"): alias.getparent() for alias in root.iterfind("ModelVariables/*/Alias")}
    inverse = {(e.getparent().get("name"), e.get("name")) for e in _inverse(root)}
    for unit in model.unitDefinitions:
        unit.displayUnits = [
            DisplayUnit(shown.name, shown.factor, shown.offset, (unit.name, shown.name) in inverse)
            for shown in unit.displayUnits
        ]
    for variable in model.modelVariables:
        element = elements.get(variable.name, aliases.get(variable.name))
        if element is None:
            continue
        value = next((child for child in element if child.tag == variable.type), element)
        if value.get("relativeQuantity") is not None:
            variable.relativeQuantity = value.get("relativeQuantity") in ("true", "1")
        if variable.type.startswith("UInt"):
            variable.min, variable.max = value.get("min"), value.get("max")
    return model


def _mend(root: Any) -> list[str]:
    """Change the parts of a description that FMPy cannot read. Returns one finding for each change."""
    findings: list[str] = []
    version = root.get("fmiVersion")
    if re.fullmatch(r"\s*2(\.0(\..+)?)?\s*", version) and version != "2.0":
        root.set("fmiVersion", "2.0")
        findings.append(f'fmiVersion is "{version}". FMI 2.0 wants "2.0" for all its releases; read as such.')
    defined = {element.get("name") for element in root.iterfind("TypeDefinitions/*")}
    variables = root.findall("ModelVariables/*")
    for variable in variables:
        name = variable.get("name")
        for value in (variable, *variable):
            declared = value.get("declaredType")
            if declared is not None and declared not in defined:
                del value.attrib["declaredType"]
                findings.append(f"variable '{name}': its declaredType '{declared}' is not defined. Left out.")
    for shown in _inverse(root):
        if shown.attrib.pop("offset", "0").strip(" 0.") != "":
            findings.append(f"display unit '{shown.get('name')}' is inverse and has an offset. The offset is left out.")
    if root.get("fmiVersion") == "2.0":
        for variable in variables:
            findings += _mend_variability(variable)
        findings += _mend_structure(root, len(variables))
    return findings


def _inverse(root: Any) -> list[Any]:
    """The display units of FMI 3.0 that show ``factor / value``."""
    return [
        shown for shown in root.iterfind("UnitDefinitions/Unit/DisplayUnit") if shown.get("inverse") in ("true", "1")
    ]


def _mend_variability(variable: Any) -> list[str]:
    """Give a variable of FMI 2.0 a variability that its causality allows. Returns a finding if it had another."""
    causality, given = variable.get("causality", "local"), variable.get("variability")
    allowed = RULES.get(causality, ())
    chosen = given or "continuous"
    if chosen == "continuous" and variable.find("Real") is None and causality in ("input", "output", "local"):
        chosen = "discrete"
    elif chosen not in allowed and allowed:
        chosen = allowed[0]
    if chosen == (given or "continuous"):
        return []
    variable.set("variability", chosen)
    had = f'variability "{given}"' if given else "no variability, which means continuous,"
    return [f"variable '{variable.get('name')}' has {had} and is no such {causality}. Read as {chosen}."]


def _mend_structure(root: Any, count: int) -> list[str]:
    """Remove indices of missing variables from ModelStructure and from ``derivative`` attributes.

    Returns one finding for each change.
    """
    findings: list[str] = []
    for unknown in root.findall("ModelStructure/*/Unknown"):
        if not _in_range(unknown.get("index"), count):
            unknown.getparent().remove(unknown)
            findings.append(f"ModelStructure: there is no variable of index {unknown.get('index')}. Left out.")
        elif not all(_in_range(number, count) for number in (unknown.get("dependencies") or "").split()):
            unknown.attrib.pop("dependencies")
            unknown.attrib.pop("dependenciesKind", None)
            findings.append(
                f"ModelStructure: the unknown of index {unknown.get('index')} depends on a variable that is not there. "
                "Taken to depend on all inputs."
            )
    for value in root.findall("ModelVariables/*/Real"):
        if value.get("derivative") is not None and not _in_range(value.get("derivative"), count):
            findings.append(
                f"variable '{value.getparent().get('name')}' is the derivative of a variable of index "
                f"{value.get('derivative')}, which is not there. Left out."
            )
            del value.attrib["derivative"]
    return findings


def _in_range(text: str | None, count: int) -> bool:
    return text is not None and text.isdecimal() and 1 <= int(text) <= count
