"""The tutorials as files to download: notebooks that open and compile, scripts that name no folder of a machine.

What they print and draw is checked where they run: in the build of the site, which fails if an assertion fails.
"""

from __future__ import annotations

import ast
import re
from pathlib import Path
from typing import Any

import pytest

TUTORIALS = sorted((Path(__file__).resolve().parents[2] / "docs" / "tutorials").glob("*.py"))
CELL_KEYS = {
    "code": {"cell_type", "execution_count", "metadata", "outputs", "source"},
    "markdown": {"cell_type", "metadata", "source"},
}
"""Keys of the cells of a notebook, format 4.5 without ids."""
MACHINE = re.compile(r"(?<![\w./`{])/(home|root|Users|usr|opt|tmp|work|var)/|\b[A-Z]:[\\/]")
"""The beginning of an absolute path."""

every_tutorial = pytest.mark.parametrize("path", TUTORIALS, ids=lambda path: path.stem)


def helpers(path: Path) -> dict[str, str]:
    """The functions run and show of a tutorial."""
    body = ast.parse(path.read_text(encoding="utf-8")).body
    functions = [node for node in body if isinstance(node, ast.FunctionDef)]
    return {node.name: ast.unparse(node) for node in functions if node.name in ("run", "show")}


@every_tutorial
def test_the_notebook_opens_and_its_cells_compile(path: Path, tmp_path: Path) -> None:
    pytest.importorskip("sphinx_gallery", reason="sphinx-gallery is not installed: install the extra docs")
    from sphinx_gallery.gen_gallery import DEFAULT_GALLERY_CONF
    from sphinx_gallery.notebook import jupyter_notebook
    from sphinx_gallery.py_source_parser import split_code_and_text_blocks

    _, blocks = split_code_and_text_blocks(path)
    notebook: dict[str, Any] = jupyter_notebook(blocks, {**DEFAULT_GALLERY_CONF}, str(tmp_path))
    assert notebook["nbformat"] == 4
    assert {"kernelspec", "language_info"} <= set(notebook["metadata"])
    assert notebook["cells"][0]["cell_type"] == "markdown"
    for cell in notebook["cells"]:
        assert set(cell) == CELL_KEYS[cell["cell_type"]]
        assert all(isinstance(line, str) for line in cell["source"])
        if cell["cell_type"] == "code":
            compile("".join(cell["source"]), path.name, "exec")


@every_tutorial
def test_the_script_names_no_folder_of_a_machine(path: Path) -> None:
    assert MACHINE.findall(path.read_text(encoding="utf-8")) == []


@every_tutorial
def test_the_helpers_are_those_of_the_other_tutorials(path: Path) -> None:
    first = {name: text for other in reversed(TUTORIALS) for name, text in helpers(other).items()}
    assert helpers(path).items() <= first.items()
    assert "run" in helpers(path)


@every_tutorial
def test_the_script_leaves_nothing_behind(path: Path) -> None:
    assert path.read_text(encoding="utf-8").splitlines()[-1] == "temporary.cleanup()"


@every_tutorial
def test_nothing_is_hidden_from_the_notebook(path: Path) -> None:
    assert "sphinx_gallery_start_ignore" not in path.read_text(encoding="utf-8")
