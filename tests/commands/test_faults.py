"""Commands whose files fail at any moment: no traceback, no lost older file, and what is whole is kept."""

from __future__ import annotations

import errno
import re
from collections.abc import Callable
from pathlib import Path

import pytest
from faults import Faults
from fmu_files import PROBE, probe_library, write_fmu

from cosim.commands import cli
from cosim.commands.console import Bar
from cosim.design.dataset import DataSet
from cosim.errors import FileError

SYSTEM = """
[experiment]
stop_time = 0.3
step_size = 0.1
[instances.a]
fmu = "a.fmu"
start = { gain = 0.5 }
"""
SWEEP = """
system = "system.toml"
[parameters]
"a.gain" = [0.1, 0.2, 0.3, 0.4]
[metrics]
last = { of = "rms", signal = "a.y" }
"""
TUNING = """
system = "system.toml"
objective = "last"
generations = 1
population = 2
[parameters]
"a.gain" = { from = 0.1, to = 0.4 }
[metrics]
last = { of = "rms", signal = "a.y" }
"""
OLDER = "the older file"
Capture = pytest.CaptureFixture[str]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    write_fmu(tmp_path / "a.fmu", PROBE, binary=probe_library().read_bytes())
    (tmp_path / "system.toml").write_text(SYSTEM, encoding="utf-8")
    (tmp_path / "sweep.toml").write_text(SWEEP, encoding="utf-8")
    (tmp_path / "tuning.toml").write_text(TUNING, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def operations(monkeypatch: pytest.MonkeyPatch, command: Callable[[], int]) -> int:
    """How many operations a command needs when none fails."""
    with monkeypatch.context() as patched:
        faults = Faults(patched, 0, errno.EIO, stays=False)
        assert command() == 0
    return faults.count


@pytest.mark.parametrize("fault", [(errno.ENOSPC, True), (errno.EIO, False)])
@pytest.mark.parametrize("apart", [False, True])
def test_a_run(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture, apart: bool, fault: tuple[int, bool]
) -> None:
    arguments = ["run", "system.toml", "--output", "out.csv", "--plot", "out.svg", *([] if apart else ["--in-process"])]
    number = operations(monkeypatch, lambda: cli.main(arguments))
    whole = {name: (folder / name).read_bytes() for name in ("out.csv", "out.svg")}
    capsys.readouterr()
    assert number > 10
    for n in range(1, number + 1):
        for name in whole:
            (folder / name).write_text(OLDER, encoding="utf-8")
        with monkeypatch.context() as patched:
            Faults(patched, n, fault[0], stays=fault[1])
            code = cli.main(arguments)
        printed = capsys.readouterr()
        assert "Traceback" not in printed.err, n
        for name, content in whole.items():
            assert (folder / name).read_bytes() in (content, OLDER.encode()), (n, name)
        if code == 0:
            assert all((folder / name).read_bytes() == content for name, content in whole.items()), n
        else:
            assert code in (1, 2), n
            assert printed.err.strip(), n


@pytest.mark.parametrize("stays", [False, True])
def test_a_sweep(folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture, stays: bool) -> None:
    def command(place: str) -> int:
        return cli.main(["sweep", "sweep.toml", "--output", place, "--workers", "0"])

    number = operations(monkeypatch, lambda: command("counted"))
    assert number > 10
    for n in range(1, number + 1):
        place = f"data_{n}"
        with monkeypatch.context() as patched:
            Faults(patched, n, errno.EIO, stays=stays)
            code = command(place)
        printed = capsys.readouterr()
        assert "Traceback" not in printed.err, n
        assert code in (0, 1, 2), n
        assert code == 0 or printed.err.strip(), n
        # The same command without faults goes on where it was.
        assert command(place) == 0, n
        assert DataSet(folder / place).read().to_pydict()["run"] == [0, 1, 2, 3], n


RESULTS: dict[str, tuple[list[str], str, str]] = {
    "tune": (["tune", "tuning.toml", "--start", "start.toml"], "cosim.design.tune.write_start", "a.gain"),
    "sweep": (["sweep", "sweep.toml", "--workers", "0"], "cosim.design.sweep_report.write_report", "Data set"),
    "run": (["run", "system.toml", "--plot", "a.png"], "cosim.result.plots.plot_run", "Time of the steps"),
    "report": (["run", "system.toml", "--report", "a.html"], "cosim.result.run_report.report_run", "Time of the steps"),
    "compare": (
        ["compare", "system.toml", "system.toml", "--set-b", "a.gain=0.1", "--plot", "a.png"],
        "cosim.result.compare_report.plot_comparison",
        "minus system.toml",
    ),
}
"""For each command: its arguments, the function that writes its file, and a text that it shows."""


@pytest.mark.parametrize("case", RESULTS)
@pytest.mark.parametrize("stopped", [False, True])
def test_a_result_is_shown_before_its_file_is_written(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture, case: str, stopped: bool
) -> None:
    arguments, writer, shown = RESULTS[case]
    before: list[str] = []

    def fail(*given: object, **keywords: object) -> None:
        before.append(capsys.readouterr().out)
        raise KeyboardInterrupt if stopped else FileError("the file: cannot be written: no space is left on the disk.")

    monkeypatch.setattr(writer, fail)
    assert cli.main(arguments) == (130 if stopped else 1)
    assert shown in before[0]
    assert ("Interrupted." if stopped else "error: the file: cannot be written") in capsys.readouterr().err


def test_an_interrupted_tuning_tells_the_best_so_far(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    def interrupt(bar: Bar, done: float, total: float | None, note: str = "") -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Bar, "update", interrupt)
    assert cli.main(["tune", "tuning.toml"]) == 130
    assert re.search(r"interrupted after \d+ runs\. The best so far: a\.gain = 0\.[1-4]", capsys.readouterr().err)
