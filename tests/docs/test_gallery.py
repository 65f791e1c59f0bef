"""What docs/gallery.py makes of the cells of tutorials."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("sphinx_gallery", reason="sphinx-gallery is not installed: install the extra docs")

from docutils import nodes
from docutils.frontend import get_default_settings
from docutils.utils import new_document
from sphinx.errors import ExtensionError
from sphinx_gallery.scrapers import ImagePathIterator

from docs.gallery import name_pages, scrape, tidy

PNG = b"\x89PNG"


def page(*blocks: nodes.literal_block) -> nodes.document:
    document = new_document("page", get_default_settings())
    document += blocks
    tidy(None, document)
    return document


def scraped(picture: Any, folder: Path, code: str = "picture") -> str:
    images = ImagePathIterator(folder / "sphx_glr_cell_{0:03}.png")
    variables = {"example_globals": {"___": picture}, "image_path_iterator": images, "src_file": "1_cell.py"}
    return scrape(SimpleNamespace(content=code, lineno=7), variables, {"src_dir": str(folder)})


def test_the_last_expression_is_shown_with_its_title_as_text(tmp_path: Path) -> None:
    lines = [SimpleNamespace(label="log"), SimpleNamespace(label="model")]
    panels = [SimpleNamespace(heading="", quantity="Position", series=lines)]
    rst = scraped(SimpleNamespace(_repr_png_=lambda: PNG, title="Before", panels=panels), tmp_path)
    assert ":alt: Before; Position: log, model\n" in rst
    assert (tmp_path / "sphx_glr_cell_001.png").read_bytes() == PNG


def test_a_picture_of_an_earlier_cell_is_not_shown_again(tmp_path: Path) -> None:
    assert scraped(SimpleNamespace(_repr_png_=lambda: PNG, title="Before"), tmp_path, "value = 1") == ""


def test_a_picture_without_title_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ExtensionError, match=r"1_cell.py:7: a picture without title"):
        scraped(SimpleNamespace(_repr_png_=lambda: PNG), tmp_path)


def test_notebooks_name_the_pages_that_tutorials_link(tmp_path: Path) -> None:
    notebook = tmp_path / "tutorial" / "1_cell.ipynb"
    notebook.parent.mkdir()
    notebook.write_text('["see :doc:`/systems`, :doc:`2_cell` and :download:`log.csv </examples/log.csv>`"]')
    titles = {"systems": nodes.title("", 'What "a system" is'), "tutorial/2_cell": nodes.title("", "Größe")}
    name_pages(SimpleNamespace(srcdir=tmp_path), SimpleNamespace(titles=titles))
    assert json.loads(notebook.read_text()) == ['see *What "a system" is*, *Größe* and log.csv']


def test_times_and_folders_are_taken_from_outputs() -> None:
    text = "$ cosim run loop.toml\nTime of the steps   0.1  s, 8 times real time\nWritten: /some/folder/run.png"
    (block,) = page(nodes.literal_block(text, text, classes=["sphx-glr-script-out"])).children
    assert block.astext() == "$ cosim run loop.toml\nWritten: run.png"


@pytest.mark.parametrize(
    "call",
    ['write(\n    "loop.toml",\n    """\\\na = 1\n""",\n)', '(FOLDER / "loop.toml").write_text("""\na = 1\n""")'],
)
def test_a_file_that_a_cell_writes_has_its_name_and_colours(call: str) -> None:
    code = f'import cosim\n\n{call}\nrun("cosim run loop.toml")'
    before, file, after = page(nodes.literal_block(code, code, language="Python")).children
    caption, content = file.children
    assert [part.astext() for part in (before, caption, content, after)] == [
        *("import cosim", "loop.toml", "a = 1", 'run("cosim run loop.toml")')
    ]
    assert isinstance(content, nodes.Element)
    assert content["language"] == "toml"
