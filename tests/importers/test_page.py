"""docs/use-in-your-tool.md, as far as it needs no tool but FMPy; ``make conformance`` follows the rest."""

from __future__ import annotations

import sys
from pathlib import Path

from .page import FMI3_PAGE, PAGE, alike, blocks, follow, missing, user_folder

FIGURES = 6
"""Blocks with a figure that FMPy and cosim alone must show."""


def test_the_page_is_right_for_cosim_and_fmpy(native: Path, tmp_path: Path) -> None:
    chosen = [block for block in blocks(PAGE.read_text(encoding="utf-8")) if block.mark == "run"]
    followed = list(follow(chosen, user_folder(tmp_path, native), {"run": Path(sys.executable).parent}))
    assert [f"line {block.line}: {wrong}" for block, wrong in followed if wrong] == []
    assert len(followed) == len(chosen)
    assert sum(bool(block.expected) for block in chosen) == FIGURES


def test_the_page_of_fmi3_is_right(fmi3: Path, tmp_path: Path) -> None:
    (block,) = blocks(FMI3_PAGE.read_text(encoding="utf-8"))
    (tmp_path / "build" / "fmus").mkdir(parents=True)
    (tmp_path / "build" / "fmus" / "fmi3").symlink_to(fmi3)
    assert block.expected
    assert [wrong for _, wrong in follow([block], tmp_path, {"run": Path(sys.executable).parent})] == [""]


def test_every_tool_of_the_page_says_how_it_was_checked() -> None:
    for section in PAGE.read_text(encoding="utf-8").split("\n## ")[1:]:
        title, _, text = section.partition("\n")
        literally = text.lstrip().startswith("*Followed literally here")
        assert literally or "not run here" in text[:300], title
        marks = {block.mark for block in blocks(f"## {section}")}
        assert bool(marks) == literally, title


def test_comparison_sees_another_figure() -> None:
    assert alike("rms error 0.0391 um", "rms  error 0.0393 um")
    assert not alike("rms error 0.0391 um", "rms error 0.0646 um")
    assert not alike("rms error 0.0391 um", "rms error nan um")
    assert not alike("rms error 0.0391 um", "error 0.0391 um")
    assert missing(("b 1", "c 2"), "a\nb 1\nc 2\n") == ""
    assert missing(("c 2", "b 1"), "a\nb 1\nc 2\n").startswith("'b 1' was not printed")


def test_blocks_go_with_the_text_that_follows_them() -> None:
    page = "# A\n```sh run\none\n```\n```text\n1\n2\n```\n## B\n```python\nnever\n```\n```csv f.csv\n3\n```\n"
    first, second = blocks(page)
    assert (first.section, first.language, first.mark, first.content) == ("A", "sh", "run", "one\n")
    assert first.expected == ("1", "2")
    assert (second.section, second.mark, second.expected) == ("B", "f.csv", ())
