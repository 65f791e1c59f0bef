"""``cosim fmus copy``, and what ``cosim list`` says of FMUs."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from cosim.commands.cli import main
from cosim.errors import DescriptionError, FileError
from cosim.fmu.copies import copy_fmus


def test_all_or_some_fmus_are_copied_byte_by_byte(native: Path, tmp_path: Path) -> None:
    some = copy_fmus(native, tmp_path / "a" / "b", ["Trajectory", "PPi"])
    assert [path.name for path in some] == ["Trajectory.fmu", "PPi.fmu"]
    assert sorted(path.name for path in (tmp_path / "a" / "b").iterdir()) == ["PPi.fmu", "Trajectory.fmu"]
    rest = copy_fmus(native, tmp_path / "a" / "b")
    assert len(rest) == len(list(native.glob("*.fmu"))) - 2
    assert all((tmp_path / "a" / "b" / path.name).read_bytes() == path.read_bytes() for path in native.glob("*.fmu"))
    assert copy_fmus(native, tmp_path / "a" / "b") == []


def test_everything_in_the_way_is_told_at_once_and_nothing_copied(native: Path, tmp_path: Path) -> None:
    (tmp_path / "PPi.fmu").write_bytes(b"mine")
    (tmp_path / "Trajectory.fmu").mkdir()
    with pytest.raises(DescriptionError) as caught:
        copy_fmus(native, tmp_path, ["BalscrewStage", "PPi", "Trajectory", "NctfPi"])
    problems = caught.value.problems
    assert len(problems) == 3
    first, second, third = problems
    assert first == f"no FMU 'BalscrewStage' in {native}. Did you mean 'BallscrewStage'?"
    assert second == f"{tmp_path / 'PPi.fmu'}: is another FMU. Give --force to replace it, or another folder."
    assert third.startswith(f"{tmp_path / 'Trajectory.fmu'}: is a folder.")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["PPi.fmu", "Trajectory.fmu"]
    assert (tmp_path / "PPi.fmu").read_bytes() == b"mine"
    assert copy_fmus(native, tmp_path, ["PPi"], force=True) == [tmp_path / "PPi.fmu"]
    assert (tmp_path / "PPi.fmu").read_bytes() == (native / "PPi.fmu").read_bytes()


def test_folders_that_cannot_serve_are_refused(native: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(DescriptionError, match="file: is not a folder"):
        copy_fmus(native, tmp_path / "file", ["PPi"])
    with pytest.raises(FileError, match=r"cannot be written: a part of the path is a file"):
        copy_fmus(native, tmp_path / "file" / "below", ["PPi"])
    with pytest.raises(DescriptionError, match=r"nowhere: there is no FMU\. Build"):
        copy_fmus(tmp_path / "nowhere", tmp_path)


def test_command(
    native: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    place = tmp_path / "build" / "fmus" / "native"
    place.mkdir(parents=True)
    shutil.copy(native / "PPi.fmu", place)
    monkeypatch.chdir(tmp_path)
    assert main(["fmus", "copy", "mine"]) == 0
    assert capsys.readouterr().out.split() == f"Copied from {place} to mine: PPi".split()
    assert (tmp_path / "mine" / "PPi.fmu").read_bytes() == (native / "PPi.fmu").read_bytes()
    assert main(["fmus", "copy", "mine", "PPi", "--fmus", str(native)]) == 0
    assert capsys.readouterr().out == "Nothing to copy: mine holds them already.\n"
    (tmp_path / "mine" / "PPi.fmu").write_bytes(b"other")
    assert main(["fmus", "copy", "mine"]) == 2
    assert "is another FMU" in capsys.readouterr().err
    assert main(["fmus", "copy", "mine", "--force"]) == 0


def test_list_says_where_fmus_come_from_and_for_which_platforms(
    native: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copy(native / "PPi.fmu", tmp_path)
    assert main(["list", "--fmus", str(tmp_path)]) == 0
    heading, row = capsys.readouterr().out.splitlines()[:2]
    assert heading.startswith(f"FMUs in {tmp_path}, for ")
    assert row.split()[0] == "PPi"
    assert row.split()[3] == "kB"
    monkeypatch.setattr("cosim.fmu.places.PREBUILT", tmp_path)
    monkeypatch.chdir(tmp_path)
    assert main(["list"]) == 0
    assert capsys.readouterr().out.startswith(f"FMUs in {tmp_path}, installed with cosim, for ")
