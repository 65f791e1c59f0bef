"""XML names of SSP."""

from __future__ import annotations

import importlib
from typing import Any

ANNOTATION = "motion-cosim"

NAMESPACES = {
    "ssd": "http://ssp-standard.org/SSP1/SystemStructureDescription",
    "ssc": "http://ssp-standard.org/SSP1/SystemStructureCommon",
    "ssv": "http://ssp-standard.org/SSP1/SystemStructureParameterValues",
    "ssm": "http://ssp-standard.org/SSP1/SystemStructureParameterMapping",
    "cosim": "urn:motion-cosim:ssp:1",
    "osp": "http://opensimulationplatform.com/SSP/OSPAnnotations",
    "oms": "https://raw.githubusercontent.com/OpenModelica/OMSimulator/master/schema/oms.xsd",
}

lxml_etree: Any = importlib.import_module("lxml.etree")


def tag(name: str) -> str:
    """The full XML name of ``prefix:name``."""
    prefix, _, local = name.partition(":")
    return f"{{{NAMESPACES[prefix]}}}{local}"


def local_name(element: Any) -> str:
    """The name of an element without its namespace."""
    return str(element.tag).rpartition("}")[2]


def own_annotation(parent: Any, element: str) -> Any:
    """Our annotation in an element, or None."""
    if parent is None:
        return None
    for annotation in parent.findall(f"{tag('ssd:Annotations')}/{tag('ssc:Annotation')}"):
        if annotation.get("type") == ANNOTATION:
            return annotation.find(tag(element))
    return None
