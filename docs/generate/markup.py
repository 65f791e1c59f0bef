"""Plain text of the code as Markdown: everything is shown as it stands, except ``code``."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import PurePath

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


def language_of(file: str) -> str:
    """The language in which a file of this name is coloured."""
    return {".json": "json", ".py": "python", ".toml": "toml"}.get(PurePath(file).suffix, "text")


def table(heads: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """A table. The cells are Markdown; numbers with a point are shown with six digits."""
    lines = [heads, ["---"] * len(heads), *rows]
    cells = [[f"{cell:g}" if isinstance(cell, float) else str(cell) for cell in line] for line in lines]
    return "\n".join(f"| {' | '.join(line)} |" for line in cells)


def directive(name: str, argument: str = "", body: str = "", **options: str) -> str:
    """A directive of MyST. ``body`` may hold directives with fewer colons or backticks only."""
    fence = ":" * max(3, 1 + max((len(run) for run in re.findall("^:{3,}", body, re.MULTILINE)), default=0))
    lines = [f"{fence}{{{name}}} {argument}".rstrip(), *(f":{key}: {value}".rstrip() for key, value in options.items())]
    return "\n".join([*lines, *(["", body.rstrip(), ""] if body else []), fence]) + "\n"


def found_by(*words: str) -> str:
    """Entries of the index for what follows: a search for one of these words shows it first."""
    return "".join(directive("index", f"! single: {word}") for word in words)
