"""Every command that runs FMUs outlives them, and says instance, function and time with the same words."""

from __future__ import annotations

import math
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import psutil
import pytest
from fmu_files import PROBE, probe_library, write_fmu

from cosim.commands.cli import main

pytestmark = pytest.mark.skipif(
    sys.platform != "linux", reason="the FMU of these tests misbehaves in the ways of Linux"
)

SYSTEM = """
connections = []
[experiment]
stop_time = 1.0
step_size = 0.01
[instances.h]
fmu = "Hostile.fmu"
start = { label = "HOW", fail_time = 0.5, u = 1.0 }
"""
FIT = """
system = "bad.toml"
[records.a]
file = "record.csv"
time = "t"
[outputs.y]
signal = "h.y"
noise = 1e-3
[parameters]
"h.time_constant" = { from = 0.01, to = 1.0 }
"""
STUDY = """
from cosim.study import Run, Study
figures = lambda result, window: {"last": float(result["h.y"][-1])}
runs = {name: Run(f"../{name}.toml", window=(0.0, 1.0), measure=figures) for name in ("good", "bad")}
STUDY = Study(title="A study", source="-", text="-", runs=runs, claims=(), pictures={})
"""
IN_STEPS = {
    "run": ["run", "bad.toml"],
    "compare": ["compare", "good.toml", "bad.toml"],
    "nct": ["identify", "nct", "bad.toml", "--alpha", "5", "--position", "h.y", "--velocity", "", "--input", "h.u"],
    "practical": ["stability", "practical", "bad.toml", "--gain", "h.gain", "--position", "h.y", "--stop-time", "1.0"],
    "fit": ["fit", "fit.toml", "--workers", "1"],
    "linearize": ["linearize", "bad.toml", "--instance", "h", "--at", "0.9"],
    "study": ["study", "./study", "--output", "report"],
}
"""Commands that meet an FMU which misbehaves in a step; sweeps are in the tests of the sweep."""
WATCHED = ("run", "compare", "nct", "study")
"""Commands whose ``--timeout`` is for a call of an FMU; that of the others is for a run."""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], Path]:
    """A working folder with the files of all commands, whose FMU misbehaves in a way."""

    def made(how: str) -> Path:
        write_fmu(tmp_path / "Hostile.fmu", PROBE, binary=probe_library("hostile").read_bytes())
        for name, label in (("good", "good"), ("bad", how)):
            (tmp_path / f"{name}.toml").write_text(SYSTEM.replace("HOW", label), encoding="utf-8")
        (tmp_path / "fit.toml").write_text(FIT, encoding="utf-8")
        rows = [f"{k / 100},{1.0 - math.exp(-k / 20):.6f}" for k in range(101)]
        (tmp_path / "record.csv").write_text("\n".join(["t,y", *rows, ""]), encoding="utf-8")
        (tmp_path / "study").mkdir()
        (tmp_path / "study" / "study.py").write_text(STUDY, encoding="utf-8")
        monkeypatch.chdir(tmp_path)
        return tmp_path

    return made


@pytest.mark.parametrize("command", IN_STEPS)
def test_a_crash_names_instance_function_and_time(
    folder: Callable[[str], Path], command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    folder("segv")
    assert main(IN_STEPS[command]) == 1
    assert "h: fmi2DoStep at 0.5 s crashed: SIGSEGV, it used memory" in capsys.readouterr().err


@pytest.mark.parametrize("command", WATCHED)
def test_a_call_that_hangs_is_ended(
    folder: Callable[[str], Path], command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    folder("hang")
    assert main([*IN_STEPS[command], "--timeout", "2"]) == 1
    said = "h: fmi2DoStep at 0.5 s had not come back after 2 s, the limit for a call, and was ended."
    assert said in capsys.readouterr().err


@pytest.mark.parametrize(
    ("command", "code", "of"),
    [
        (["check", "bad.toml"], 2, "the initialization"),
        (["linearize", "bad.toml", "--instance", "h"], 1, "a run"),
        (IN_STEPS["practical"], 1, "a run"),
    ],
    ids=("check", "linearize", "practical"),
)
def test_a_run_that_hangs_is_ended(
    folder: Callable[[str], Path], command: list[str], code: int, of: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """The limit is long, because a busy machine takes seconds to start the process."""
    folder("hang in initialization")
    assert main([*command, "--timeout", "10"]) == code
    said = f"h: fmi2EnterInitializationMode at 0 s had not come back when 10 s had passed, the limit for {of}, and was"
    assert said in capsys.readouterr().err


@pytest.mark.parametrize("command", [*IN_STEPS, "check"])
def test_ctrl_c_ends_a_command_whose_fmu_hangs(folder: Callable[[str], Path], command: str) -> None:
    place = folder("hang in initialization")
    arguments = [sys.executable, "-m", "cosim", *IN_STEPS.get(command, ["check", "bad.toml"])]
    running = subprocess.Popen(arguments, cwd=place, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    while not psutil.Process(running.pid).children() and running.poll() is None:
        time.sleep(0.05)
    running.send_signal(signal.SIGINT)
    try:
        said, _ = running.communicate(timeout=60.0)
    finally:
        running.kill()
    assert (running.returncode, "Interrupted." in said, "Traceback" in said) == (130, True, False), said
