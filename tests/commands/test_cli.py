"""The command line: what it prints, writes and returns."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from fmu_files import write_probe

from cosim import read_system, simulate
from cosim.commands.cli import main

SYSTEM = """
description = "Two probes"
connections = ["a.y -> b.u"]
[experiment]
stop_time = 1.0
step_size = 0.1
[instances.a]
fmu = "Probe"
start = { y_start = 1.0, u = 0.5 }
[instances.b]
fmu = "Probe"
"""

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "build" / "fmus" / "native"
    folder.mkdir(parents=True)
    write_probe(folder)
    (tmp_path / "two.toml").write_text(SYSTEM, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def cosim(capsys: pytest.CaptureFixture[str]) -> Run:
    def called(*arguments: str) -> tuple[int, str, str]:
        try:
            code = main(arguments)
        except SystemExit as ended:
            code = int(ended.code or 0)
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return called


def table(path: Path) -> tuple[list[str], np.ndarray]:
    lines = path.read_text(encoding="utf-8").splitlines()
    rows = [[float(cell) for cell in line.split(",")] for line in lines[1:]]
    return [name.strip('"') for name in lines[0].split(",")], np.array(rows)


def test_run_shows_a_summary_and_writes_the_record(place: Path, cosim: Run) -> None:
    code, out, err = cosim("run", "two.toml", "--output", "out/a.csv")
    assert code == 0
    assert err == ""
    for text in ("Two probes", "Simulated", "times real time", "Written: out/a.csv"):
        assert text in out
    names, rows = table(place / "out" / "a.csv")
    result = simulate(read_system("two.toml"))
    assert names == ["time", *result.names]
    assert rows.tolist() == np.column_stack([result.time, result.rows]).tolist()


def test_options_reach_the_run(place: Path, cosim: Run) -> None:
    code, _, _ = cosim(
        "run", "two.toml", "--set", "a.gain=2.0", "--set", "b.label=mine", "--stop-time", "2", "--step-size=0.05",
        "--order", "b,a", "--record", "a.y", "--record", "b.u", "--decimation", "4", "--output", "a.csv",
    )  # fmt: skip
    assert code == 0
    names, rows = table(place / "a.csv")
    assert names == ["time", "a.y", "b.u"]
    expected = simulate(
        read_system("two.toml", {"a.gain": 2.0}, stop_time=2, step_size=0.05, order=["b", "a"], record=["a.y", "b.u"])
    )
    assert rows[:, 1].tolist() == expected["a.y"][::4].tolist()
    assert rows[:, 2].tolist() == expected["b.u"][::4].tolist()
    assert rows[:, 0].tolist() == [k * 0.05 for k in range(0, 41, 4)]


def test_summary_as_json(place: Path, cosim: Run) -> None:
    code, out, err = cosim("run", "two.toml", "--json", "--order", "parallel")
    summary = json.loads(out)
    assert (code, err) == (0, "")
    assert summary["steps"] == 10
    assert summary["solver"] == {"a": {"steps": 10.0}, "b": {"steps": 10.0}}
    assert summary["partial"] is False
    assert summary["system_digest"] == read_system("two.toml", order="parallel").digest


def test_plot_is_drawn(place: Path, cosim: Run) -> None:
    code, out, _ = cosim("run", "two.toml", "--plot", "a.png")
    assert code == 0
    assert "Written: a.png" in out
    assert (place / "a.png").read_bytes().startswith(b"\x89PNG")


def test_report_is_written(place: Path, cosim: Run) -> None:
    code, out, _ = cosim("run", "two.toml", "--report", "a.html", "--set", "a.gain=2.5")
    assert code == 0
    assert "Written: a.html" in out
    page = (place / "a.html").read_text(encoding="utf-8")
    assert "<h1>Two probes</h1>" in page
    assert "<td>a.gain</td>" in page


def test_report_of_a_run_that_failed_says_why(place: Path, cosim: Run) -> None:
    code, _, _ = cosim("run", "two.toml", "--report", "a.html", "--set", "a.fail_time=0.45")
    assert code == 1
    page = (place / "a.html").read_text(encoding="utf-8")
    assert "The run ended early at" in page
    assert "told to fail at 0.5 s" in page


def test_report_of_another_kind_is_refused_before_the_run(place: Path, cosim: Run) -> None:
    code, _, err = cosim("run", "two.toml", "--report", "a.pdf", "--plot", "a.xyz")
    assert code == 2
    assert "a.pdf: the name of a report must end in .html" in err
    assert "a.xyz" in err


def test_fmus_from_another_folder(place: Path, cosim: Run) -> None:
    (place / "build" / "fmus" / "native").rename(place / "others")
    code, _, err = cosim("run", "two.toml", "--fmus", "others")
    assert (code, err) == (0, "")
    code, _, err = cosim("run", "two.toml", "--fmus", "nowhere")
    assert code == 2
    assert "no FMU 'Probe' in nowhere" in err


def test_published_loop_ends_with_its_tracking_figures(native: Path, cosim: Run) -> None:
    code, out, err = cosim("run", "shams2010/fsmc_5sin", "--stop-time", "0.1", "--fmus", str(native))
    assert code == 0
    assert "plant [Warning] fmi2Terminate: largest_speed" in err
    assert err.count("\n") == 1
    for text in ("plant: equations evaluated", "Position error, rms", "um", "Command, maximum", "N.m"):
        assert text in out


def test_sampling_time_between_communication_points_is_refused(native: Path, cosim: Run) -> None:
    code, _, err = cosim("check", "shams2010/fsmc_5sin", "--fmus", str(native), "--set", "controller.T_s=1.5e-4")
    assert code == 2
    assert "instances.controller: T_s = 0.00015 s against a communication step of 0.0001 s" in err


def test_all_problems_are_listed_and_nothing_runs(place: Path, cosim: Run) -> None:
    code, out, err = cosim(
        "run", "two.toml", "--set", "a.gan=1", "--set", "c.gain=1", "--step-size", "0.3", "--output", "a.csv"
    )
    assert (code, out) == (2, "")
    assert err.splitlines() == [
        "error: 3 problems:",
        "error: two.toml: value for c.gain: no instance 'c'. Known: a, b.",
        "error: two.toml: instances.a.start.gan: Probe has no variable 'gan'. Did you mean 'gain'?",
        "error: two.toml: experiment.step_size: 0.3 s does not divide stop_time - start_time = 1.0 s into whole steps "
        "(3.33333). Change step_size, or take stop_time = 0.9 or 1.2.",
    ]
    assert not (place / "a.csv").exists()


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["run", "tow.toml"], "tow.toml: no such file. Did you mean 'two.toml'?"),
        (["run", "shams2010/fsmc_5sn"], "Did you mean 'shams2010/fsmc_5sin'?"),
        (["run", "two.toml", "--set", "a.gain"], "--set a.gain: write INSTANCE.VARIABLE=VALUE, such as plant.m=70."),
        (["run", "two.toml", "--output", "a.mat"], "a.mat: the name must end in .csv or .parquet."),
        (["run", "two.toml", "--order", "a,c"], "experiment.order: no instance 'c'. Known: a, b."),
        (["run", "two.toml", "--stop-time", "soon"], 'experiment.stop_time: "soon" is not a finite number of seconds.'),
        (["run", "two.toml", "--decimation", "0"], "record.decimation: 0 is not a count."),
        (["check", "two.toml", "--record", "a.yy"], "'a.yy': Probe has no variable 'yy'"),
        (["info", "Prob"], "Did you mean 'Probe'?"),
        (["info", "two.toml/x.fmu"], "x.fmu"),
        (["study", "sham2010"], "Did you mean 'shams2010'?"),
        (["run"], "the following arguments are required: SYSTEM"),
        ([], "run a system, or an FMU alone"),
        (["runn"], "Did you mean 'run'?"),
        (["identify", "frition"], "Did you mean 'friction'?"),
        (["run", "two.toml", "--stoptime", "1"], "Did you mean '--stop-time'?"),
    ],
)
def test_what_is_wrong_with_the_arguments(place: Path, cosim: Run, arguments: list[str], text: str) -> None:
    code, _, err = cosim(*arguments)
    assert code == 2
    assert text in err
    assert "Traceback" not in err


def test_failure_keeps_what_was_computed(place: Path, cosim: Run) -> None:
    code, out, err = cosim("run", "two.toml", "--set", "b.fail_time=0.5", "--output", "a.csv")
    assert (code, out) == (1, "")
    lines = err.splitlines()
    assert "error: b: fmi2DoStep at 0.5 s returned fmi2Error. The FMU said: fmi2DoStep told to fail at 0.5 s" in lines
    assert "Computed up to 0.5 s (6 rows), kept in a.csv." in lines
    assert table(place / "a.csv")[1][:, 0].tolist() == [k * 0.1 for k in range(6)]


def test_failure_without_output_says_how_to_keep(place: Path, cosim: Run) -> None:
    code, _, err = cosim("run", "two.toml", "--set", "b.fail_time=0.5")
    assert code == 1
    assert "Computed up to 0.5 s (6 rows); name a file with --output to keep them." in err


def test_warnings_of_fmus_are_shown(place: Path, cosim: Run) -> None:
    code, out, err = cosim("run", "two.toml", "--set", "b.fail_time=0.85", "--set", "b.fail_status=1")
    assert code == 0
    assert "0.9 s b [Warning] fmi2DoStep told to fail at 0.9 s" in err.splitlines()
    assert "Simulated" in out


def unpacked(place: Path) -> bool:
    """Whether the library of an FMU is unpacked; other temporary folders may vanish while this looks."""
    try:
        return any(place.glob("cosim-*/*/binaries/*/*"))
    except FileNotFoundError:
        return False


def test_interrupt_exits_130_and_keeps_what_was_computed(place: Path) -> None:
    options = ["--set", "a.sleep=100", "--stop-time", "100000", "--record", "a.y", "--output", "a.csv"]
    process = subprocess.Popen(
        [sys.executable, "-m", "cosim", "run", "two.toml", *options],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env={**os.environ, "TMPDIR": str(place)},
    )  # fmt: skip
    while process.poll() is None and not unpacked(place):
        pass
    while process.poll() is None:
        # The library is unpacked a moment before the run begins: until then Ctrl-C ends with nothing computed.
        try:
            process.wait(0.5)
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGINT)
            break
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    assert "error: Interrupted.\nComputed up to " in err
    assert "kept in a.csv." in err
    assert "Traceback" not in err
    assert table(place / "a.csv")[1].shape[0] > 1


def test_check_says_how_it_will_run(place: Path, cosim: Run) -> None:
    code, out, _ = cosim("check", "two.toml", "--order", "b,a")
    assert code == 0
    assert "a.y -> b.u" in out
    assert "Order: b, a" in out
    assert "10 steps of 0.1 s from 0 s to 1.0 s, 10 variables recorded, 11 rows" in out
    assert "No problems." in out
    text = SYSTEM.replace('"a.y -> b.u"', '"a.y -> b.u", "b.z -> a.u"')
    (place / "loop.toml").write_text(text, encoding="utf-8")
    code, out, _ = cosim("check", "loop.toml", "--order", "a,b")
    assert code == 0
    assert "note: connection b.z -> a.u: one step of delay" in " ".join(out.split())


def test_info_shows_variables(place: Path, cosim: Run) -> None:
    code, out, _ = cosim("info", "Probe")
    assert code == 0
    lines = {line.split()[0]: line.split() for line in out.splitlines() if line.strip()}
    assert lines["time_constant"] == ["time_constant", "s", "0.1", "1e-06", ".."]
    assert "  z: u" in out.splitlines()
    assert cosim("info", str(place / "build/fmus/native/Probe.fmu"))[0] == 0


def test_info_shows_arrays_as_one_line(native: Path, cosim: Run) -> None:
    code, out, _ = cosim("info", "NctfPi", "--fmus", str(native))
    assert code == 0
    assert "nct.error[1..128]" in out
    assert "nct.error[2]" not in out


def test_info_breaks_no_word_of_a_description(native: Path, cosim: Run) -> None:
    code, out, _ = cosim("info", "BallscrewAxis", "--fmus", str(native))
    assert code == 0
    lines = out.splitlines()
    at = next(i for i, line in enumerate(lines) if line.startswith("torque_order[1..2]"))
    assert lines[at + 1] == "    Periods of torque_ripple in a turn"
    assert max(len(line) for line in lines if "BallscrewAxis.fmu" not in line) <= 80


def test_figures_of_two_axes_stand_below_their_axis_and_are_not_broken(native: Path, cosim: Run) -> None:
    code, out, _ = cosim("run", "feng2015/circle", "--fmus", str(native), "--stop-time", "1.0")
    assert code == 0
    lines = [line.strip() for line in out.splitlines()]
    heads = [lines.index(name) for name in ("controller_x", "controller_y", "path of both axes")]
    assert heads == sorted(heads)
    for start in heads[:2]:
        assert lines[start + 1].startswith("Position error, maximum from 0.5 s ")
    assert lines[heads[2] + 1].startswith("Contour error, maximum from 0.5 s ")


def test_list_shows_fmus_and_systems(place: Path, cosim: Run) -> None:
    code, out, _ = cosim("list")
    assert code == 0
    assert "Probe" in out
    assert "shams2010/fsmc_5sin" in out
    (place / "build/fmus/native/Broken.fmu").write_bytes(b"")
    code, out, _ = cosim("list")
    assert code == 0
    assert "Broken.fmu: not a readable zip archive" in out


def test_every_option_is_explained() -> None:
    run = subprocess.run([sys.executable, "-m", "cosim", "run", "--help"], capture_output=True, text=True, check=True)
    for text in ("such as plant.m=70", "such as 2.5", "such as 1e-4", "examples:\n  cosim run"):
        assert text in run.stdout


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signal")
def test_ctrl_c_while_modules_are_imported_shows_no_traceback() -> None:
    code = (
        "import os, signal, sys, types\n"
        "class Importing(types.ModuleType):\n"
        "    def __getattr__(self, name):\n"
        "        os.kill(os.getpid(), signal.SIGINT)\n"
        "sys.modules['cosim.commands.cli'] = Importing('cosim.commands.cli')\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "from cosim.__main__ import main\n"
        "main()\n"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stderr) == (-signal.SIGINT, "")
