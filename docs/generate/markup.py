"""Plain text of the code as Markdown: everything is shown as it stands, except ``code``."""

from __future__ import annotations

import re

_CODE = re.compile(r"``(.+?)``", re.DOTALL)
_MARKS = re.compile(r"([\\`*_{}\[\]<>#|$~^&!])")
_AT_START = re.compile(r"^(\d*)([-+:=.)])(?=\s|$)")


def literal(text: str) -> str:
    """``text`` as code within a line."""
    ticks = "`" * (1 + max((len(run) for run in re.findall("`+", text)), default=0))
    space = " " if text.startswith("`") or text.endswith("`") or not text.strip() else ""
    return f"{ticks}{space}{text}{space}{ticks}"


def escaped(text: str) -> str:
    """``text`` with every character that means something in Markdown escaped."""
    return _MARKS.sub(r"\\\1", text)


def markdown(text: str) -> str:
    """A paragraph of plain text: text between double backticks becomes code, all else is escaped."""
    parts = _CODE.split(" ".join(text.split()))
    marked = (literal(part) if number % 2 else escaped(part) for number, part in enumerate(parts))
    return _AT_START.sub(r"\1\\\2", "".join(marked))


def fenced(text: str, language: str = "text", *, wrapped: bool = False) -> str:
    """A block of code. With ``wrapped`` long lines are broken on a narrow page, for messages."""
    fence = "`" * max(3, 1 + max((len(run) for run in re.findall("`+", text)), default=0))
    options = ":class: wrapped\n\n" if wrapped else ""
    return f"{fence}{{code-block}} {language}\n{options}{text.rstrip()}\n{fence}\n"


def directive(name: str, argument: str = "", body: str = "", **options: str) -> str:
    """A directive of MyST. ``body`` may hold directives with fewer colons or backticks only."""
    fence = ":" * max(3, 1 + max((len(run) for run in re.findall("^:{3,}", body, re.MULTILINE)), default=0))
    lines = [f"{fence}{{{name}}} {argument}".rstrip(), *(f":{key}: {value}".rstrip() for key, value in options.items())]
    return "\n".join([*lines, *(["", body.rstrip(), ""] if body else []), fence]) + "\n"


def found_by(*words: str) -> str:
    """Entries of the index for what follows: a search for one of these words shows it first."""
    return "".join(directive("index", f"! single: {word}") for word in words)
