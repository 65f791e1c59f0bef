"""Plain text of the code as Markdown: everything is shown as it stands, except ``code``."""

from __future__ import annotations

import re

_CODE = re.compile(r"``(.+?)``", re.DOTALL)
_MARKS = re.compile(r"([\\`*_{}\[\]<>#|$~^&!])")
_AT_START = re.compile(r"^(\s*)([-+:=]|\d+[.)])(?=\s|$)", re.MULTILINE)


def literal(text: str) -> str:
    """``text`` as code within a line."""
    ticks = "`" * (1 + max((len(run) for run in re.findall("`+", text)), default=0))
    space = " " if text.startswith("`") or text.endswith("`") or not text.strip() else ""
    return f"{ticks}{space}{text}{space}{ticks}"


def escaped(text: str) -> str:
    """``text`` with every character that means something in Markdown escaped."""
    return _AT_START.sub(lambda match: f"{match[1]}\\{match[2]}", _MARKS.sub(r"\\\1", text))


def markdown(text: str) -> str:
    """A paragraph of plain text: text between double backticks becomes code, all else is escaped."""
    parts = _CODE.split(text)
    return "".join(literal(" ".join(part.split())) if odd % 2 else escaped(part) for odd, part in enumerate(parts))


def fenced(text: str, language: str = "text") -> str:
    """A block of code."""
    fence = "`" * max(3, 1 + max((len(run) for run in re.findall("`+", text)), default=0))
    return f"{fence}{{code-block}} {language}\n{text.rstrip()}\n{fence}\n"


def directive(name: str, argument: str = "", body: str = "", **options: str) -> str:
    """A directive of MyST. ``body`` may hold directives with fewer colons or backticks only."""
    fence = ":" * max(3, 1 + max((len(run) for run in re.findall("^:{3,}", body, re.MULTILINE)), default=0))
    lines = [f"{fence}{{{name}}} {argument}".rstrip(), *(f":{key}: {value}".rstrip() for key, value in options.items())]
    return "\n".join([*lines, *(["", body.rstrip(), ""] if body else []), fence]) + "\n"
