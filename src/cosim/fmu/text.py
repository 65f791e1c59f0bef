"""Text files as editors, spreadsheets and measuring tools write them."""

from __future__ import annotations

import codecs
import contextlib
import os
import tomllib
from decimal import Decimal
from pathlib import Path
from typing import Any, cast

from ..errors import DescriptionError, suggest
from .toml_errors import explained, line_with

FRACTION = r"\s*([+-]?\d+(?:\.\d*)?)\s*/\s*(\d+(?:\.\d*)?)\s*"
"""A number that is written as a quotient, such as ``1/30``."""

_MARKS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
"""Byte order marks and the encodings that they announce."""


def read_text(path: Path, fallback: str = "") -> str:
    """The text of a file in UTF-8, or in UTF-16 with a byte order mark. All line ends become ``\\n``.

    Text that is not UTF-8 is read in the encoding ``fallback``, if one is given.
    Raises DescriptionError if the file is missing, cannot be read, or has another encoding.
    """
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        raise no_such_file(path) from None
    except OSError as error:
        raise DescriptionError(f"{path}: cannot be read ({error.strerror}).") from None
    encoding = next((name for mark, name in _MARKS if content.startswith(mark)), "utf-8")
    if content.startswith(b"PK\x03\x04"):
        raise DescriptionError(
            f"{path}: is a zip archive, not text. Give an FMU, an SSP or a spreadsheet the ending of its kind."
        )
    # UTF-16 without a mark can be valid UTF-8: its text is then full of zeros.
    if encoding == "utf-8" and b"\0" in content[:1000]:
        raise DescriptionError(f"{path}: is no text, or UTF-16 without a byte order mark. Save it as UTF-8.")
    try:
        text = content.decode(encoding)
    except UnicodeDecodeError as error:
        if fallback and encoding == "utf-8":
            with contextlib.suppress(UnicodeDecodeError):
                return _with_line_ends(content.decode(fallback))
        line = content.count(b"\n", 0, error.start) + 1
        raise DescriptionError(f"{path}: line {line} is not {encoding.upper()} text. Save the file as UTF-8.") from None
    return _with_line_ends(text)


def _with_line_ends(text: str) -> str:
    return text.replace("\r\n", "\n").replace("\r", "\n")


def named_path(text: str | Path, folder: Path | None = None) -> Path:
    """The path of a file that a user names, relative to ``folder``; ``~`` is the home folder.

    If there is no such file, backslashes divide folders, as on Windows.
    """
    path = Path(os.path.expanduser(text)) if folder is None else folder / os.path.expanduser(text)
    other = Path(str(path).replace("\\", "/"))
    return other if other.exists() and not path.exists() else path


def no_such_file(path: Path, *endings: str) -> DescriptionError:
    """The error for a missing file, with the nearest name of a file beside it that has one of ``endings``.

    The default is the ending of ``path``. Upper and lower case count as equal.
    """
    wanted = [ending.lower() for ending in endings or (path.suffix,)]
    with contextlib.suppress(OSError):
        beside = [file.name for file in path.parent.iterdir() if file.suffix.lower() in wanted]
        return DescriptionError(f"{path}: no such file.{suggest(path.name, beside)}")
    return DescriptionError(f"{path}: no such file.")


def read_toml(path: Path) -> dict[str, Any]:
    """The document of a TOML file. Numbers with a point are read as Decimal, exactly as they are written.

    Raises DescriptionError if the file cannot be read or is not valid TOML.
    """
    text = read_text(path)
    try:
        document = tomllib.loads(text, parse_float=Decimal)
        _check_characters(document)
    except RecursionError:
        raise DescriptionError(f"{path.name}: tables or lists are nested too deeply.") from None
    except ArithmeticError:
        where = line_with(text, r"[eE][-+]?\d{10}")
        raise DescriptionError(f"{path.name}: a number has an exponent that is too large{where}.") from None
    except ValueError as error:
        # Also raised for whole numbers with thousands of digits.
        raise DescriptionError(f"{path.name}: not valid TOML: {explained(text, error)}") from None
    return document


def _check_characters(value: Any) -> None:
    """Raise ValueError if a text or key has the character U+0000, which no name and no path can have."""
    if isinstance(value, str) and "\0" in value:
        raise ValueError(f"{value!r} has the character U+0000")
    if isinstance(value, dict):
        _check_characters(list(cast("dict[str, Any]", value)))
        value = list(cast("dict[str, Any]", value).values())
    if isinstance(value, list):
        for item in cast("list[Any]", value):
            _check_characters(item)
