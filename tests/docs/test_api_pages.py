"""The pages of the Python API show every public name, and of each the words that help() shows."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from types import FunctionType, ModuleType

import pytest

import cosim

core = pytest.importorskip("docutils.core", reason="docutils is not installed: install the extra docs")
pytest.importorskip("sphinx", reason="Sphinx is not installed: install the extra docs")

from docs.docstrings import restructured  # noqa: E402
from docs.generate.api import PACKAGE, PAGES, exceptions, public, write  # noqa: E402

MODULES = [import_module(page.source) for page in PAGES]


def documented() -> Iterator[tuple[str, object]]:
    """Every public module, function, class and method: its name, and the object."""
    yield "cosim", cosim
    for module in MODULES:
        yield module.__name__, module
    named = [(f"cosim.{name}", getattr(cosim, name)) for name in cosim.__all__]
    named += [(f"{module.__name__}.{name}", found) for module in MODULES for name, found in public(module)]
    for path in (path for page in PAGES for path in page.also):
        place, _, name = path.rpartition(".")
        named.append((path, getattr(import_module(place), name)))
    for path, found in named:
        if isinstance(found, ModuleType):
            continue
        yield path, found
        if inspect.isclass(found):
            for name, member in vars(found).items():
                if not name.startswith("_") and isinstance(member, FunctionType | property | classmethod):
                    yield f"{path}.{name}", member


DOCUMENTED = dict(documented())


def test_every_public_object_has_a_docstring() -> None:
    assert len(DOCUMENTED) > 250  # the walk finds them
    assert not [name for name, found in DOCUMENTED.items() if not (inspect.getdoc(found) or "").strip()]


@pytest.mark.parametrize("name", DOCUMENTED)
def test_the_site_says_what_help_says(name: str) -> None:
    text = inspect.getdoc(DOCUMENTED[name]) or ""
    source = "\n".join(restructured(text))
    # A word of the docstring that reStructuredText took for markup would be missing, or make docutils complain.
    settings = {"report_level": 2, "halt_level": 2, "syntax_highlight": "none"}
    shown = core.publish_doctree(source, settings_overrides=settings).astext()
    plain = re.sub(r"``(.+?)``", r"\1", text, flags=re.DOTALL)
    assert shown.replace(":", "").split() == plain.replace(":", "").split()


def test_indented_blocks_stay_as_they_are() -> None:
    block = ["   run(1)", "", "   if x:", "       y_ = 2"]
    text = "Do it::\n\n    run(1)\n\n    if x:\n        y_ = 2\n\nAs |here|,\n`so`_.\n\n    a = *b*\n"
    code, equation = [".. code-block:: python", ""], [".. code-block:: text", "", "   a = *b*", ""]
    assert restructured(text) == [r"\ Do it:", "", *code, *block, "", r"\ As \|here\|, \`so\`\_.", "", *equation]


def test_the_pages_name_every_public_object(tmp_path: Path) -> None:
    write(tmp_path)
    pages = {path.stem: path.read_text(encoding="utf-8") for path in (tmp_path / "reference" / "python").iterdir()}
    grouped = [name for names in PACKAGE.values() for name in names] + exceptions()
    modules = {name for name in cosim.__all__ if isinstance(getattr(cosim, name), ModuleType)}
    assert sorted(grouped) == sorted(set(cosim.__all__) - modules)
    for name in grouped:
        assert re.search(rf"^\.\. auto\w+:: cosim\.{name}$", pages["cosim"], re.MULTILINE), name
    for page, module in zip(PAGES, MODULES, strict=True):
        for name, _ in public(module):
            assert re.search(rf"^\.\. auto\w+:: {re.escape(page.name)}\.{name}$", pages[page.name], re.MULTILINE), name
    listed = (Path(cosim.__file__).parents[2] / "docs" / "reference" / "python" / "index.rst").read_text("utf-8")
    assert set(pages) == set(re.findall(r"^   (cosim\S*)$", listed, re.MULTILINE))
