"""Opens SSP packages and SSD files: unpacks them, finds their files and checks their XML."""

from __future__ import annotations

import atexit
import contextlib
import hashlib
import io
import os.path
import re
import zipfile
from dataclasses import dataclass
from functools import cache
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import unquote, urlsplit

import fmpy.ssp

from ..errors import DescriptionError
from ..files import temporary_folder
from ..fmu.archive import unpack
from ..fmu.xml import parse
from .ssp_names import NAMESPACES, lxml_etree, tag

DESCRIPTION = "SystemStructure.ssd"
"""The file of a package that describes its system."""

_schemas = Path(fmpy.ssp.__file__).parent / "schema"

_unpacked: dict[str, Path] = {}

_folders = contextlib.ExitStack()
"""Folders of unpacked packages, which last as long as the process."""
atexit.register(_folders.close)


@dataclass(frozen=True)
class Package:
    """An unpacked .ssp, or an .ssd with the files around it."""

    name: str
    folder: Path
    """The folder where relative paths of the description start."""
    description: bytes
    packed: bool
    """Whether this is an .ssp, which contains all its files."""

    def file(self, uri: str) -> str:
        """The path of a file that the description names, relative to the folder.

        Raises DescriptionError if ``uri`` is not the path of a file, or leads out of an .ssp.
        """
        parts = urlsplit(uri)
        path = unquote(parts.path)
        inside = os.path.normpath(path) if path else ".."
        local = parts.scheme in ("", "file") and parts.netloc in ("", "localhost") and not parts.fragment
        absolute = PurePosixPath(path).is_absolute() or parts.scheme == "file"
        if local and not self.packed and path:
            return path if absolute else f"./{path}"
        if not local or absolute or PurePosixPath(inside).parts[:1] == ("..",):
            where = "a path inside the package" if self.packed else "a path of a file"
            raise DescriptionError(f"source '{uri}' is not {where}.")
        return f"./{inside}"


def open_package(path: Path) -> Package:
    """Open the package at ``path``. An .ssp is unpacked into a temporary folder that lasts as long as the process.

    Raises DescriptionError if the file cannot be read or is not an SSP.
    """
    try:
        if path.suffix.lower() == ".ssd":
            return Package(path.name, path.parent, path.read_bytes(), packed=False)
        folder = _unpack(path)
        description = folder / DESCRIPTION
        if not description.is_file():
            raise DescriptionError(f"{path.name}: no {DESCRIPTION} inside. This is not an SSP file.")
        return Package(path.name, folder, description.read_bytes(), packed=True)
    except FileNotFoundError:
        raise DescriptionError(f"{path}: no such file.") from None
    except OSError as error:
        raise DescriptionError(f"{path}: cannot be read ({error.strerror}).") from None


def _unpack(path: Path) -> Path:
    packed = path.read_bytes()
    digest = hashlib.sha256(packed).hexdigest()
    if digest not in _unpacked:
        with contextlib.ExitStack() as resources:
            folder = resources.enter_context(temporary_folder())
            try:
                with zipfile.ZipFile(io.BytesIO(packed)) as archive:
                    archive.filename = path.name
                    unpack(archive, folder)
            except (zipfile.BadZipFile, RuntimeError, NotImplementedError, EOFError) as error:
                raise DescriptionError(f"{path.name}: not a readable zip archive ({error}).") from None
            _unpacked[digest] = folder
            _folders.push(resources.pop_all())
    return _unpacked[digest]


# Documents

_VERSIONED = tuple(
    map(tag, ("ssd:SystemStructureDescription", "ssv:ParameterSet", "ssm:ParameterMapping"))
)  # the elements that state their version of SSP


def read_document(content: bytes, schema: str = "SystemStructureDescription") -> Any:
    """The root of an XML document that is valid against its SSP 1.0 schema.

    A document of SSP 2.0 is accepted if it uses only elements of SSP 1.0.
    Raises DescriptionError with all errors and their lines.
    """
    try:
        root = parse(content)
    except lxml_etree.XMLSyntaxError as error:
        raise DescriptionError(f"line {error.lineno}: not valid XML: {error.msg}") from None
    newer = ""
    for element in root.iter(*_VERSIONED):
        version = element.get("version", "")
        if version.startswith("2."):
            element.set("version", "1.0")
            newer = " (SSP 2.0 is read as far as SSP 1.0 goes)"
        elif version and not version.startswith("1."):
            line = f"line {element.sourceline}"
            raise DescriptionError(f"{line}: SSP {version} is not read. Write it as SSP 1.0.")
    validator = _schema(schema)
    if not validator.validate(root):
        raise DescriptionError([f"line {entry.line}: {_plain(entry.message)}{newer}" for entry in validator.error_log])
    return root


@cache
def _schema(name: str) -> Any:
    return lxml_etree.XMLSchema(lxml_etree.parse(str(_schemas / f"{name}.xsd")))


def _plain(message: str) -> str:
    """A message of the schema validator, with short XML names and without regular expressions."""
    for prefix, uri in NAMESPACES.items():
        message = message.replace(f"{{{uri}}}", f"{prefix}:")
    message = re.sub(r"\[facet '\w+'\] ", "", message)
    return re.sub(r" is not accepted by the pattern .*", " is not of the form that SSP asks for.", message)
