"""What sphinx-gallery lacks: pictures that are no figures of pyplot, outputs that are always the same, and notebooks
that name the pages of the site.

A cell that ends with a picture shows it, as a notebook does. A picture is an object with ``_repr_png_`` or
``_repr_svg_``: that of ``cosim.plot``, or a file that a command wrote. Its title, its panels and their lines are the
text for readers who do not see it.
"""

from __future__ import annotations

import ast
import json
import re
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.errors import ExtensionError
from sphinx_gallery.scrapers import figure_rst

from docs.generate.markup import language_of
from docs.shell import cleaned, named

FILE = re.compile(
    r"""(?:write\(\s*|\(FOLDER\ /\ )"(?P<name>[^"]+)"(?:,\s*|\)\.write_text\(\s*)
    (?P<text>(?P<quotes>\'{3}|"{3}).*?(?P=quotes)),?\s*(?:encoding="utf-8",?\s*)?\)\n?""",
    re.DOTALL | re.VERBOSE,
)
"""A call of a tutorial that writes a file: write("loop.toml", ...) or (FOLDER / "loop.toml").write_text(...)."""

LINK = re.compile(r":(?:doc|download):`(?:(?P<text>[^`<]+) <[^`>]+>|(?P<page>[^`]+))`")
"""A link to a page or a file of the site, in a tutorial."""


def scrape(block: Any, block_vars: dict[str, Any], gallery_conf: dict[str, Any]) -> str:
    """The picture that the last expression of a cell gives, as reStructuredText. Empty without one."""
    body = ast.parse(block.content).body
    shown = block_vars["example_globals"].get("___") if body and isinstance(body[-1], ast.Expr) else None
    for ending in ("svg", "png"):
        content = getattr(shown, f"_repr_{ending}_", None)
        if content is None:
            continue
        alt = _alternative_text(shown)
        if not alt:
            place = f"{Path(block_vars['src_file']).name}:{block.lineno}"
            raise ExtensionError(f"{place}: a picture without title. Give it one: its readers may not see it.")
        path = Path(next(block_vars["image_path_iterator"])).with_suffix(f".{ending}")
        picture = content()
        path.write_bytes(picture if isinstance(picture, bytes) else picture.encode())
        return figure_rst([path], gallery_conf["src_dir"], alt)
    return ""


def _alternative_text(picture: Any) -> str:
    """The title, and each panel with the labels of its lines."""
    parts = [str(getattr(picture, "title", ""))]
    for panel in getattr(picture, "panels", ()):
        labels = ", ".join(series.label for series in panel.series if series.label)
        parts.append((panel.heading or panel.quantity) + (f": {labels}" if labels else ""))
    return "; ".join(part for part in parts if part)


def tidy(app: Any, doctree: nodes.document) -> None:
    """Take computing times and folders of this machine from outputs, and show files that cells write as files."""
    for block in list(doctree.findall(nodes.literal_block)):
        if "sphx-glr-script-out" in block["classes"]:
            text = cleaned(block.astext())
            block.rawsource = text  # Sphinx colours a block only if the two are equal
            block.children = [nodes.Text(text)]
            block.children[0].parent = block
        elif block.get("language") == "Python" and FILE.search(block.astext()):
            block.parent.replace(block, _files_and_code(block.astext(), doctree))


def name_pages(app: Any, env: Any) -> None:
    """In the notebooks, put the titles of pages in place of links, which sphinx-gallery leaves as they are."""

    def name(link: re.Match[str]) -> str:
        page = link["page"]
        return link["text"] or f"*{env.titles[page[1:] if page.startswith('/') else f'tutorial/{page}'].astext()}*"

    for path in Path(app.srcdir, "tutorial").glob("*.ipynb"):
        text = path.read_text(encoding="utf-8")
        path.write_text(LINK.sub(lambda link: json.dumps(name(link))[1:-1], text), encoding="utf-8")


def _files_and_code(code: str, doctree: nodes.document) -> list[nodes.Node]:
    """The code of a cell in pieces: each file that it writes, with its name and in its own colours."""
    parts: list[nodes.Node] = []
    begin = 0
    for found in FILE.finditer(code):
        parts += _listing(code[begin : found.start()], "Python")
        text = ast.literal_eval(found["text"])
        content = _listing(text, language_of(found["name"]))
        parts.append(named(found["name"], content, doctree))
        begin = found.end()
    return parts + _listing(code[begin:], "Python")


def _listing(text: str, language: str) -> list[nodes.Node]:
    """A block of code; none for blank text."""
    text = text.strip("\n")
    return [nodes.literal_block(text, text, language=language)] if text.strip() else []
