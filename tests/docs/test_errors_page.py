"""The page of errors: every wrong input fails as it says, with a message and without a traceback."""

from __future__ import annotations

from pathlib import Path

import pytest

import cosim
from cosim.errors import CosimError
from docs.generate.errors import Wrong, exceptions, told, write, wrong_inputs


def test_there_are_many_and_each_title_is_used_once() -> None:
    assert len(wrong_inputs()) >= 50
    stages = [wrong.stage for wrong in wrong_inputs()]
    assert stages == sorted(stages, key=stages.index), "the inputs of a stage stand together"
    assert len({(wrong.stage, wrong.title) for wrong in wrong_inputs()}) == len(stages)


@pytest.mark.parametrize("wrong", wrong_inputs(), ids=lambda wrong: wrong.title)
def test_the_input_fails_as_the_page_says(wrong: Wrong, native: Path) -> None:
    code, said = told(wrong)
    assert code == wrong.code
    assert "Traceback" not in said
    first = next(line for line in said.splitlines() if not line.startswith(("note:", "usage:", " ")))
    assert first.startswith(("error: ", "cosim: error: ", "cosim.errors."))
    assert str(Path.home()) not in said
    assert "/tmp" not in said


def test_every_exception_says_what_it_means() -> None:
    for name, kind in exceptions().items():
        assert (kind.__doc__ or "").strip(), name
        assert issubclass(kind, CosimError | cosim.Interrupted)
    public = {f"cosim.{name}" for name in cosim.__all__ if name.endswith("Error") or name == "Interrupted"}
    assert public <= exceptions().keys()


def test_the_page_holds_every_input(tmp_path: Path, native: Path) -> None:
    page = tmp_path / "reference" / "errors.md"
    page.parent.mkdir()
    page.write_text("# Errors\n", encoding="utf-8")
    write(tmp_path)
    text = page.read_text(encoding="utf-8")
    for wrong in wrong_inputs():
        assert f"### {wrong.title}\n" in text
        assert (wrong.run or wrong.python.strip()) in text
    for name in exceptions():
        assert f"`{name}`" in text
