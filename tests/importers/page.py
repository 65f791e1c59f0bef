"""Follows pages of docs literally: runs their code blocks, compares what they print with what the page says.

A block marked ``run`` needs this project and FMPy, one marked ``run-importers`` the tools of requirements.txt. The
``text`` block that comes next holds lines of its output. A block marked with a file's name is that file.
"""

from __future__ import annotations

import math
import os
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from markdown_it import MarkdownIt

DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGE = DOCS / "use-in-your-tool.md"
FMI3_PAGE = DOCS / "fmi3.md"
TOLERANCE = 0.02
"""A delayed loop differs from tool to tool by 1 %, the figures that the page tells apart by 15 % or more."""


@dataclass(frozen=True)
class Block:
    """A code block and what it has to print."""

    section: str
    line: int
    language: str
    mark: str
    content: str
    expected: tuple[str, ...] = ()


def blocks(text: str) -> list[Block]:
    """The code blocks of a page that are marked, with the text blocks that follow them."""
    found: list[Block] = []
    section = ""
    heading = False
    for token in MarkdownIt().parse(text):
        if token.type == "heading_open":
            heading = True
        elif token.type == "inline" and heading:
            section, heading = token.content, False
        elif token.type == "fence":
            language, _, mark = token.info.strip().partition(" ")
            line = token.map[0] + 1 if token.map else 0
            if mark:
                found.append(Block(section, line, language, mark, token.content))
            elif language == "text":
                last = found.pop()
                found.append(Block(**{**vars(last), "expected": tuple(token.content.splitlines())}))
    return found


def user_folder(place: Path, native: Path) -> Path:
    """An empty folder below which the native FMUs are found."""
    (place / "build" / "fmus").mkdir(parents=True)
    (place / "build" / "fmus" / "native").symlink_to(native)
    (place / "user").mkdir()
    return place / "user"


def follow(chosen: Sequence[Block], folder: Path, programs: Mapping[str, Path]) -> Iterator[tuple[Block, str]]:
    """Run blocks one after the other in ``folder``; yields each with what is wrong with it, or "".

    ``programs`` holds, by mark, the folder of the Python and of the programs to take.
    """
    for block in chosen:
        if "." in block.mark:
            (folder / block.mark).write_text(block.content, encoding="utf-8")
            continue
        place = programs[block.mark]
        command = (
            ["bash", "-e", "-c", block.content] if block.language == "sh" else [place / "python", "-c", block.content]
        )
        path = os.pathsep.join([str(place), os.environ["PATH"]])
        done = subprocess.run(
            command,
            cwd=folder,
            env=os.environ | {"PATH": path},
            capture_output=True,
            text=True,
            check=False,
            timeout=300,
        )
        wrong = done.stderr[-1000:] if done.returncode else missing(block.expected, done.stdout)
        yield block, wrong


def missing(expected: Sequence[str], printed: str) -> str:
    """The first expected line that was not printed, in order; "" if all were."""
    lines = iter(printed.splitlines())
    for line in expected:
        if not any(alike(line, other) for other in lines):
            return f"'{line}' was not printed, but:\n{printed[-1000:]}"
    return ""


def alike(line: str, other: str) -> bool:
    """Whether two lines have the same words, and numbers within the tolerance."""
    words, others = line.split(), other.split()
    return len(words) == len(others) and all(map(_same, words, others))


def _same(word: str, other: str) -> bool:
    try:
        return math.isclose(float(word), float(other), rel_tol=TOLERANCE)
    except ValueError:
        return word == other
