"""XML names of SSP."""

from __future__ import annotations

import importlib
from typing import Any

ANNOTATION = "motion-cosim"


NAMESPACES = {
    "ssd": "http://ssp-standard.org/SSP1/SystemStructureDescription",
    "ssc": "http://ssp-standard.org/SSP1/SystemStructureCommon",
    "ssv": "http://ssp-standard.org/SSP1/SystemStructureParameterValues",
    "cosim": "urn:motion-cosim:ssp:1",
    "osp": "http://opensimulationplatform.com/SSP/OSPAnnotations",
    "oms": "https://raw.githubusercontent.com/OpenModelica/OMSimulator/master/schema/oms.xsd",
}


lxml_etree: Any = importlib.import_module("lxml.etree")


def tag(name: str) -> str:
    """The full XML name of ``prefix:name``."""
    prefix, _, local = name.partition(":")
    return f"{{{NAMESPACES[prefix]}}}{local}"
