"""Docstrings on the site: plain text as ``help()`` shows it, turned into reStructuredText without losing a word.

A docstring of this project is paragraphs; an indented block is code or equations and stays as it is; text between
double backticks is code. Within a paragraph a line that begins with an argument and a colon is the entry of this
argument, and a line that begins with ``Raises`` stands apart. Nothing else has a meaning.
"""

from __future__ import annotations

import ast
import re
import textwrap
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sphinx.application import Sphinx

_CODE = re.compile(r"``(.+?)``")
_ENTRY = re.compile(r"``\w+``(, ``\w+``)*:")
_SIGNATURE = re.compile(r'<span class="sig-paren">\(</span>\s*<dl>.*?</dl>', re.DOTALL)
_MARKS = re.compile(r"([\\*`|_<>\[\]])")


def restructured(text: str) -> list[str]:
    """The lines of a docstring as reStructuredText."""
    lines: list[str] = []
    for indented, block in _blocks(text):
        if indented:
            lines += [f".. code-block:: {_language(block)}", "", *textwrap.indent(block, "   ").splitlines(), ""]
        else:
            for part in re.split(r"\n(?=Raises |``\w+``(?:, ``\w+``)*:)", block):
                start = "* " if _ENTRY.match(part) else ""
                lines += [f"{start}\\ {_escaped(re.sub(r'::$', ':', ' '.join(part.split())))}", ""]
    return lines


def _blocks(text: str) -> Iterator[tuple[bool, str]]:
    """Paragraphs and indented blocks in turn, each with whether it is indented. A block may hold empty lines."""
    waiting: list[str] = []
    inside = False
    for line in [*text.expandtabs().splitlines(), ""]:
        indented = line.startswith(" ")
        if waiting and line.strip() and (indented != inside or (not inside and not waiting[-1].strip())):
            yield inside, _trimmed(waiting)
            waiting = []
        if line.strip():
            inside = indented
        if line.strip() or waiting:
            waiting.append(line)
    if waiting:
        yield inside, _trimmed(waiting)


def _trimmed(lines: list[str]) -> str:
    return textwrap.dedent("\n".join(lines)).rstrip()


def _language(block: str) -> str:
    """Python if the block is that and more than a name or an equation, else plain text."""
    try:
        tree = ast.parse(block)
    except SyntaxError:
        return "text"
    code = (ast.Call, ast.ClassDef, ast.FunctionDef, ast.Import, ast.ImportFrom)
    return "python" if any(isinstance(node, code) for node in ast.walk(tree)) else "text"


def _escaped(paragraph: str) -> str:
    parts = _CODE.split(paragraph)
    return "".join(rf"\ ``{part}``\ " if number % 2 else _MARKS.sub(r"\\\1", part) for number, part in enumerate(parts))


def _process(*arguments: Any) -> None:
    """Called by autodoc, which takes the lines as they are left in the last argument."""
    lines: list[str] = arguments[-1]
    lines[:] = restructured("\n".join(lines))


def _arguments(app: Sphinx, page: str, template: str, context: dict[str, Any], doctree: Any) -> None:
    """Turns the list of arguments of a long signature, which HTML reads as definitions without terms, into lines."""
    del app, page, template, doctree
    if "body" in context:
        context["body"] = _SIGNATURE.sub(
            lambda found: (
                found[0]
                .replace("<dl>", '<span class="sig-arguments">')
                .replace("</dl>", "</span>")
                .replace("<dd>", '<span class="sig-argument">')
                .replace("</dd>", "</span>")
            ),
            context["body"],
        )


def setup(app: Sphinx) -> dict[str, Any]:
    """Called by Sphinx."""
    app.connect("autodoc-process-docstring", _process)
    app.connect("html-page-context", _arguments)
    return {"version": "1", "parallel_read_safe": True}
