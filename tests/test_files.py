"""Files that are there whole or not at all, whatever fails at any moment; folders of processes that were killed."""

from __future__ import annotations

import errno
import os
import stat
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from faults import FAULTS, Faults

from cosim.errors import CosimError, DescriptionError, FileError
from cosim.files import Replacement, check_writable, temporary_folder, write_file
from cosim.record.description import Column
from cosim.result.plots import save
from cosim.result.result import Result


def result() -> Result:
    """A record of several pieces, see the test."""
    time = np.arange(1000, dtype=float)
    columns = (Column("a.x", "m", "Position", "mm", 1000.0), Column("a.y", "V", "Voltage", "V"))
    values = np.column_stack((np.sin(time), time / 3.0))
    return Result(time, values, columns, False, (), 0, {}, {"system": "test"})


def write_record(path: Path) -> None:
    result().save(path)


def write_picture(path: Path) -> None:
    save(path, lambda figure: figure.add_subplot().plot([0.0, 1.0]), (2.0, 1.0))


def write_text(path: Path) -> None:
    write_file(path, "text\n")


@pytest.mark.parametrize("stays", [False, True])
@pytest.mark.parametrize("error", FAULTS)
@pytest.mark.parametrize(
    ("name", "write"),
    [("a.csv", write_record), ("a.parquet", write_record), ("a.png", write_picture), ("a.txt", write_text)],
)
def test_a_fault_at_any_moment_leaves_the_older_file(
    tmp_path: Path, name: str, write: Callable[[Path], None], error: int, stays: bool
) -> None:
    """One sentence as the error, the older file to the last byte, and nothing beside it.

    A CSV file has its description beside it, which gets its name last: what happens then costs that name only.
    """
    if name.endswith(".parquet"):
        pytest.importorskip("pyarrow")
    path, described = tmp_path / name, tmp_path / "a.csv-metadata.json"
    refused = 0
    for number in range(1, 1000):
        path.write_bytes(b"older")
        with pytest.MonkeyPatch.context() as monkeypatch:
            monkeypatch.setattr("cosim.record.write.CSV_BYTES", 8000)
            monkeypatch.setattr("cosim.record.write.PARQUET_BYTES", 8000)
            faults = Faults(monkeypatch, number, error, stays=stays)
            text = ""
            try:
                write(path)
            except FileError as caught:
                text = str(caught)
        if text:
            refused += 1
            assert "\n" not in text
            assert text.startswith((f"{path}: cannot be written: ", f"{described}: cannot be written: "))
            assert text.endswith("The file that was there before is unchanged.") or text.startswith(str(described))
        # Without an error, the fault was in what does not matter: names reach the disk later, say.
        older = path.read_bytes() == b"older"
        assert older or not text.startswith(f"{path}: "), f"fault {number}"
        assert not older or text, f"fault {number}"
        assert older or name != "a.csv" or path.read_bytes().count(b"\n") == 1001, f"fault {number}"
        expected = {path, described} if described.exists() and not text else {path}
        assert set(tmp_path.iterdir()) == expected, f"fault {number}"
        described.unlink(missing_ok=True)
        if faults.count < number:
            break
    assert refused >= 5
    assert faults.count < number


def test_a_replacement_keeps_the_rights_and_follows_links(tmp_path: Path) -> None:
    (tmp_path / "target.txt").write_text("older")
    (tmp_path / "target.txt").chmod(0o640)
    (tmp_path / "link.txt").symlink_to("target.txt")
    write_file(tmp_path / "link.txt", "newer")
    assert (tmp_path / "link.txt").is_symlink()
    assert (tmp_path / "target.txt").read_text() == "newer"
    assert stat.S_IMODE((tmp_path / "target.txt").stat().st_mode) == 0o640


def test_an_exception_while_writing_leaves_nothing(tmp_path: Path) -> None:
    def interrupted() -> None:
        with Replacement(tmp_path / "a.txt") as new:
            new.file.write(b"half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["folder", "file/a.csv", "n" * 256 + ".csv", "locked/a.csv", "locked.csv"])
def test_what_cannot_be_written_is_known_before(tmp_path: Path, name: str) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").write_text("")
    (tmp_path / "locked").mkdir()
    (tmp_path / "locked").chmod(0o555)
    (tmp_path / "locked.csv").write_text("older")
    (tmp_path / "locked.csv").chmod(0o444)
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(DescriptionError, match=r": cannot be written: .*\. Name another file\.|is a folder"):
        check_writable(tmp_path / name)
    assert sorted(tmp_path.rglob("*")) == before
    (tmp_path / "locked").chmod(0o755)


@pytest.mark.parametrize("name", ["a.csv", "new/folder/a.csv", "n" * 251 + ".csv"])
def test_checking_changes_nothing(tmp_path: Path, name: str) -> None:
    check_writable(tmp_path / name)
    assert not list(tmp_path.iterdir())
    write_file(tmp_path / name, "text")
    assert (tmp_path / name).read_text() == "text"


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGKILL")
def test_folders_of_killed_processes_are_removed_by_the_next(tmp_path: Path) -> None:
    code = (
        "import os, signal, sys\nfrom cosim.files import temporary_folder\n"
        "with temporary_folder() as folder:\n    (folder / 'a').mkdir()\n    os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    environment = {**os.environ, "TMPDIR": str(tmp_path)}
    subprocess.run([sys.executable, "-c", code], env=environment, check=False)
    assert len(list(tmp_path.iterdir())) == 1
    (tmp_path / "cosim-of-somebody-else").mkdir()
    (tmp_path / "cosim-1-2-3").mkdir()
    code = (
        "import os, sys\nfrom cosim.files import temporary_folder\n"
        "with temporary_folder() as folder:\n    print(sorted(os.listdir(folder.parent)) == sorted(\n"
        "        [folder.name, 'cosim-of-somebody-else', 'cosim-1-2-3']))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], env=environment, check=True, capture_output=True, text=True)
    assert done.stdout == "True\n"


def test_the_folder_of_a_living_process_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with temporary_folder() as folder:
        code = "from cosim.files import temporary_folder\nwith temporary_folder():\n    pass\n"
        subprocess.run([sys.executable, "-c", code], env={**os.environ, "TMPDIR": str(tmp_path)}, check=True)
        assert folder.is_dir()
    assert not list(tmp_path.iterdir())


def test_a_full_disk_under_a_temporary_folder_is_named() -> None:
    told = r"cosim-.*: no space is left on the disk\. The variable TMPDIR names another"
    with pytest.raises(FileError, match=told), temporary_folder():
        raise OSError(errno.ENOSPC, "No space left on device")
    with pytest.raises(IsADirectoryError), temporary_folder() as folder:
        folder.write_text("")


def test_an_unusable_folder_for_temporary_files_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(**_: object) -> str:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("tempfile.mkdtemp", refuse)
    with (
        pytest.raises(CosimError, match=r"cannot make a temporary folder there: no space is left on the disk\."),
        temporary_folder(),
    ):
        pass
