"""FMUs for importers that do not support enumerations.

The binary stays the same. The model description declares integers in place of enumerations.
"""

from __future__ import annotations

import io
import zipfile
from typing import Any

from ..fmu.archive import checked_members
from ..fmu.xml import parse
from .ssp_names import lxml_etree

DESCRIPTION = "modelDescription.xml"


def with_integers(fmu: bytes) -> bytes:
    """The content of the FMU file ``fmu`` with Enumeration variables declared as Integer (FMI 2.0) or Int64 (FMI 3.0).

    The same FMI functions set and get an enumeration and such an integer. Therefore the binary still fits.
    """
    written = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(fmu)) as source, zipfile.ZipFile(written, "w") as archive:
        for member in checked_members(source, lambda _: False):
            content = source.read(member)
            archive.writestr(member, _description(content) if member.filename == DESCRIPTION else content)
    return written.getvalue()


def _description(content: bytes) -> bytes:
    root = parse(content)
    variables = root.find("ModelVariables")
    numbers = "Int64" if root.get("fmiVersion", "").startswith("3") else "Integer"
    for element in variables.iter("Enumeration"):
        element.tag = numbers
        element.attrib.pop("declaredType", None)
    found: Any = lxml_etree.tostring(root, xml_declaration=True, encoding="UTF-8")
    return bytes(found)
