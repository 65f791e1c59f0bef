"""Opens SSP packages and SSD files: unpacks them, finds their files and checks their XML."""

from __future__ import annotations

import atexit
import contextlib
import hashlib
import os.path
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import quote, unquote, urlsplit

import fmpy.ssp

from ..errors import DescriptionError, suggest
from ..files import temporary_folder
from ..fmu.archive import opened, unpack
from ..fmu.text import no_such_file
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
    file_name: str
    """The name of the file with the description."""
    description: bytes
    packed: bool
    """Whether this is an .ssp, which contains all its files."""
    others: tuple[str, ...] = ()
    """The names of other descriptions in an .ssp: variants of the system."""

    def path(self, uri: str) -> str:
        """The path that ``uri`` means, relative to the folder.

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

    def file(self, uri: str) -> str:
        """The path of a file that the description names, relative to the folder.

        Some tools write a path as it is, and not as a URI, or with backslashes. If there is such a file, it is meant.
        Raises DescriptionError as ``path`` does, and if an .ssp has no such file.
        """
        for meant in (uri, quote(uri), quote(uri.replace("\\", "/"))):
            with contextlib.suppress(DescriptionError):
                path = self.path(meant)
                if (self.folder / path).is_file():
                    return path
        path = self.path(uri)
        if self.packed:
            known = (file.relative_to(self.folder).as_posix() for file in self.folder.rglob("*") if file.is_file())
            raise DescriptionError(f"no file '{path.removeprefix('./')}' in the package.{suggest(path, known)}")
        return path


def open_package(path: Path) -> Package:
    """Open the package at ``path``. An .ssp is unpacked into a temporary folder that lasts as long as the process.

    Raises DescriptionError if the file cannot be read or is not an SSP.
    """
    try:
        if path.suffix.lower() == ".ssd":
            return Package(path.name, path.parent, path.name, path.read_bytes(), packed=False)
        description, others = _description(path.name, _unpack(path))
        return Package(
            path.name, description.parent, description.name, description.read_bytes(), packed=True, others=others
        )
    except FileNotFoundError:
        raise no_such_file(path) from None
    except OSError as error:
        raise DescriptionError(f"{path}: cannot be read ({error.strerror}).") from None


def _description(name: str, folder: Path) -> tuple[Path, tuple[str, ...]]:
    """The description in an unpacked .ssp, and the names of others. Raises DescriptionError.

    It is the file ``DESCRIPTION``. If there is none, it is the only .ssd of the package.
    """
    found = sorted(file for file in folder.rglob("*") if file.suffix.lower() == ".ssd" and file.is_file())
    default = folder / DESCRIPTION
    names = {file: file.relative_to(folder).as_posix() for file in found}
    if default not in found and len(found) > 1:
        raise DescriptionError(
            f"{name}: no {DESCRIPTION} inside, but {', '.join(names.values())}. Unpack the package and name one."
        )
    if not found:
        raise DescriptionError(f"{name}: no {DESCRIPTION} inside. This is not an SSP file.")
    chosen = default if default in found else found[0]
    return chosen, tuple(names[file] for file in found if file != chosen and file.parent == folder)


def _unpack(path: Path) -> Path:
    packed = path.read_bytes()
    digest = hashlib.sha256(packed).hexdigest()
    if digest not in _unpacked:
        with contextlib.ExitStack() as resources:
            folder = resources.enter_context(temporary_folder())
            with opened(path, packed) as archive:
                unpack(archive, folder)
            _unpacked[digest] = folder
            _folders.push(resources.pop_all())
    return _unpacked[digest]


# Documents

_VERSIONED = tuple(map(tag, ("ssd:SystemStructureDescription", "ssv:ParameterSet", "ssm:ParameterMapping")))
"""The elements that documents begin with. They state their version of SSP."""


_ROOT = re.compile(rb"<(?:\w+:)?(?:SystemStructureDescription|ParameterSet|ParameterMapping)\b")


def read_document(
    content: bytes, schema: str = "SystemStructureDescription", note: Callable[[str], None] = lambda text: None
) -> Any:
    """The root of an XML document that is valid against its SSP 1.0 schema.

    A document of SSP 2.0 is accepted if it uses only elements of SSP 1.0. A prefix of ``NAMESPACES`` that the document
    does not declare has its usual meaning; ``note`` is called with a remark.
    Raises DescriptionError with all errors and their lines.
    """
    root = _parsed(content, note)
    if root.tag not in _VERSIONED:
        raise DescriptionError(
            f"line {root.sourceline}: the file begins with {root.tag}, which is not of SSP 1.0. Write it as SSP 1.0."
        )
    newer = ""
    for element in root.iter(*_VERSIONED):
        version = element.get("version", "")
        if version.startswith(("1.", "2.")):
            element.set("version", "1.0")  # the schema knows no "1.0.1"
            newer = " (SSP 2.0 is read as far as SSP 1.0 goes)" if version.startswith("2.") else newer
        elif version:
            line = f"line {element.sourceline}"
            raise DescriptionError(f"{line}: SSP {version} is not read. Write it as SSP 1.0.")
    validator = _schema(schema)
    if not validator.validate(root):
        raise DescriptionError([f"line {entry.line}: {_plain(entry.message)}{newer}" for entry in validator.error_log])
    return root


def _parsed(content: bytes, note: Callable[[str], None]) -> Any:
    """The root of an XML document. Declares the prefixes of ``NAMESPACES`` that are used without a declaration."""
    try:
        return parse(content)
    except lxml_etree.XMLSyntaxError as error:
        missing = [p for p in NAMESPACES if f"<{p}:".encode() in content and f"xmlns:{p}=".encode() not in content]
        declared = "".join(f' xmlns:{prefix}="{NAMESPACES[prefix]}"' for prefix in missing).encode()
        if missing:
            with contextlib.suppress(lxml_etree.XMLSyntaxError):
                root = parse(_ROOT.sub(lambda start: start[0] + declared, content, count=1))
                note(f"prefixes without a declaration have their usual meaning: {', '.join(missing)}.")
                return root
        raise DescriptionError(f"line {error.lineno}: not valid XML: {error.msg}") from None


@cache
def _schema(name: str) -> Any:
    return lxml_etree.XMLSchema(lxml_etree.parse(str(_schemas / f"{name}.xsd")))


def _plain(message: str) -> str:
    """A message of the schema validator, with short XML names and without regular expressions."""
    for prefix, uri in NAMESPACES.items():
        message = message.replace(f"{{{uri}}}", f"{prefix}:")
    message = re.sub(r"\[facet '\w+'\] ", "", message)
    return re.sub(r" is not accepted by the pattern .*", " is not of the form that SSP asks for.", message)
