"""What surrounds a command: encodings, the working folder, temporary files, a user without a home."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

import pytest
from fmu_files import write_probe

from cosim.commands import cli
from cosim.commands.surroundings import explain
from cosim.errors import DescriptionError
from cosim.files import forbidden_library
from cosim.fmu.archive import unpack

SYSTEM = """
description = "Prüfstand, µm → mm"
[experiment]
stop_time = 1.0
step_size = 0.1
[instances.a]
fmu = "Probe"
"""


@pytest.fixture
def place(tmp_path: Path) -> Path:
    folder = tmp_path / "build" / "fmus" / "native"
    folder.mkdir(parents=True)
    write_probe(folder)
    (tmp_path / "größe.toml").write_text(SYSTEM, encoding="utf-8")
    return tmp_path


def cosim(place: Path, *arguments: str, **variables: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "cosim", *arguments]
    environment = {**os.environ, **variables}
    return subprocess.run(command, cwd=place, env=environment, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("command", ["check", "run"])
def test_characters_that_the_encoding_lacks_are_shown_by_number(place: Path, command: str) -> None:
    done = cosim(place, command, "größe.toml", PYTHONIOENCODING="ascii")
    assert done.returncode == 0, done.stderr
    assert "Pr\\xfcfstand, \\xb5m \\u2192 mm" in done.stdout
    done = cosim(place, command, "größer.toml", PYTHONIOENCODING="ascii")
    assert done.returncode == 2
    assert "gr\\xf6\\xdfer.toml: no such file." in done.stderr


@pytest.mark.parametrize("columns", ["0", "1", "20", "many"])
def test_help_fits_every_width(place: Path, columns: str) -> None:
    done = cosim(place, "run", "--help", COLUMNS=columns)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.skipif(os.name == "nt", reason="the shell of Windows does not close streams")
@pytest.mark.parametrize("arguments", [["run", "größe.toml", "--json"], ["check", "größe.toml"]])
def test_a_closed_standard_output_loses_only_what_is_shown(place: Path, arguments: list[str]) -> None:
    code = "import os, sys; os.close(1); os.execv(sys.executable, [sys.executable, '-m', 'cosim', *sys.argv[1:]])"
    done = subprocess.run([sys.executable, "-c", code, *arguments], cwd=place, stderr=-1, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.skipif(os.name == "nt", reason="Windows does not let a working folder be deleted")
@pytest.mark.parametrize("arguments", [["list"], ["run", "{place}/größe.toml"], ["info", "Probe"]])
def test_a_deleted_working_folder_is_named(place: Path, arguments: list[str]) -> None:
    (place / "gone").mkdir()
    code = "import os, sys; os.rmdir(os.getcwd()); from cosim.commands import cli; sys.exit(cli.main(sys.argv[1:]))"
    command = [sys.executable, "-c", code, *(text.format(place=place) for text in arguments)]
    done = subprocess.run(command, cwd=place / "gone", capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr == (
        "error: the working folder cannot be used (No such file or directory): it was deleted, or may not be entered. "
        "Change to another folder.\n"
    )


def test_a_user_without_home_and_name_can_run(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As the user id of a container that no passwd knows."""
    code = "import pwd, sys; pwd.getpwuid = {}.__getitem__; from cosim.commands import cli; "
    code += "sys.exit(cli.main(sys.argv[1:]))"
    for name in ("HOME", "XDG_CACHE_HOME", "MPLCONFIGDIR"):
        monkeypatch.delenv(name, raising=False)
    command = [sys.executable, "-c", code, "run", "größe.toml", "--output", "a.csv", "--plot", "a.png"]
    done = subprocess.run(command, cwd=place, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "Written: a.png" in done.stdout


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have no names of folders that are not UTF-8")
def test_a_folder_for_temporary_files_whose_name_cannot_be_read_is_named(place: Path) -> None:
    folder = place / "lat\udcfc"
    folder.mkdir()
    done = cosim(place, "run", "größe.toml", TMPDIR=str(folder))
    assert done.returncode != 0
    assert "the name of this folder for temporary files is not UTF-8. Set TMPDIR." in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_a_folder_where_no_program_may_run_is_named() -> None:
    text = "P.fmu/binaries/linux64/P.so: failed to map segment from shared object"
    assert "(noexec): the variable TMPDIR" in forbidden_library(text)
    assert forbidden_library("P.so: undefined symbol: f") == ""


def test_wrong_settings_of_matplotlib_are_a_sentence(place: Path) -> None:
    done = cosim(place, "run", "größe.toml", "--plot", "p.png", MPLBACKEND="nonsense")
    assert done.returncode != 0
    assert "Steps" in done.stdout
    assert "matplotlib: " in done.stderr
    assert "Correct the variable MPLBACKEND" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full, which stands for a full disk")
def test_a_full_disk_for_temporary_files_is_named(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "A.fmu", "w") as archive:
        archive.writestr("binaries/linux64/A.so", "library")
    (tmp_path / "to/binaries/linux64").mkdir(parents=True)
    (tmp_path / "to/binaries/linux64/A.so").symlink_to("/dev/full")
    with (
        zipfile.ZipFile(tmp_path / "A.fmu") as archive,
        pytest.raises(DescriptionError, match=r"A\.fmu: cannot be unpacked into .*: No space left .* variable TMPDIR"),
    ):
        unpack(archive, tmp_path / "to")


def test_only_what_is_needed_is_unpacked_empty_folders_too(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "A.fmu", "w") as archive:
        archive.writestr("resources/", "")
        archive.writestr("documentation/index.html", "")
    with zipfile.ZipFile(tmp_path / "A.fmu") as archive:
        unpack(archive, tmp_path / "to", lambda name: name.startswith("resources/"))
    assert list((tmp_path / "to").rglob("*")) == [tmp_path / "to" / "resources"]


def test_errors_of_the_system_are_one_sentence(
    place: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(errno.EACCES, "Permission denied", "/locked/a.csv")

    monkeypatch.setattr("os.getcwd", refuse)
    assert cli.main(["list"]) == 2
    assert "the working folder cannot be used (Permission denied)" in capsys.readouterr().err
    assert explain(PermissionError(errno.EACCES, "Permission denied", "/locked/a.csv")) == (
        "/locked/a.csv: Permission denied."
    )
    assert explain(OSError(errno.ENOSPC, "No space left on device")) == (
        f"No space left on device. Temporary files go to {tempfile.gettempdir()}; "
        "the variable TMPDIR names another folder."
    )
