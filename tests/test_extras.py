"""Packages of extras: the sentence that names a missing one, before anything runs, and that pyproject.toml has it."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
from conftest import ROOT

import cosim.extras
from cosim.commands import cli
from cosim.errors import DescriptionError
from cosim.extras import EXTRAS, import_extra, missing, require

STEP = str(ROOT / "studies" / "maeda2008" / "step.toml")
LOG = str(ROOT / "docs" / "examples" / "your_machine" / "stage.csv")


@pytest.fixture
def without_matplotlib(monkeypatch: pytest.MonkeyPatch) -> None:
    find = cosim.extras.find_spec
    monkeypatch.setattr("cosim.extras.find_spec", lambda name: None if name == "matplotlib" else find(name))


def packages(extra: str) -> set[str]:
    """Names of the packages that pyproject.toml lists for an extra."""
    project: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return {re.split(r"[><=;\[ ]", line)[0] for line in project["optional-dependencies"][extra]}


@pytest.mark.parametrize("package", EXTRAS)
def test_the_named_extra_installs_the_package(package: str) -> None:
    assert package in packages(EXTRAS[package])


def test_a_missing_package_is_named_with_the_command_that_installs_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cosim.extras.find_spec", lambda name: None)
    with pytest.raises(DescriptionError) as caught:
        require("pyarrow", "a.parquet: to write Parquet", "name a .csv file")
    assert str(caught.value) == (
        "a.parquet: to write Parquet needs pyarrow, which is not installed: "
        'pip install "motion-cosim[parquet]", or name a .csv file.'
    )


def test_a_package_that_misses_one_of_its_own_is_not_called_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    """The remedy would be wrong: the extra is there, its installation is damaged."""

    def damaged(name: str) -> None:
        raise ModuleNotFoundError("No module named 'contourpy'", name="contourpy")

    monkeypatch.setattr("cosim.extras.import_module", damaged)
    with pytest.raises(ModuleNotFoundError, match="contourpy"):
        import_extra("matplotlib", "to draw")


@pytest.mark.parametrize(
    "command",
    [
        ["run", STEP, "--plot", "a.png"],
        ["compare", LOG, LOG, "--plot", "a.png"],
        ["identify", "friction", LOG, "--plot", "a.png"],
        ["identify", "nct", STEP, "--plot", "a.png"],
        ["learn", "friction-pulse", STEP, "--plot", "a.png"],
        ["linearize", STEP, "--plot", "a.png"],
        ["stability", "map", str(ROOT / "studies" / "maeda2008" / "limits" / "friction.toml"), "--plot", "a.png"],
        ["study", "maeda2008"],
        ["sweep", STEP],
        ["verify", "PPi", "--plot", "a.png"],
    ],
    ids=lambda command: " ".join(command[:2]),
)
@pytest.mark.usefixtures("without_matplotlib", "native")
def test_a_picture_without_matplotlib_is_refused_before_the_run(
    command: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.main(command) == 2
    said = capsys.readouterr()
    assert 'needs matplotlib, which is not installed: pip install "motion-cosim[plots]".' in said.err
    assert len(said.err.splitlines()) == 1
    assert said.out == ""
    assert not list(tmp_path.iterdir())


@pytest.mark.usefixtures("without_matplotlib")
def test_pictures_in_python_name_the_extra() -> None:
    from cosim.result.plots import rendered

    with pytest.raises(DescriptionError, match=re.escape(missing("matplotlib", "to draw a picture"))):
        rendered(lambda figure: None, (1.0, 1.0))
