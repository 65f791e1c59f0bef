"""Runs in a process of their own: whatever an FMU does, the run is told, its rows are kept, and nothing is left."""

from __future__ import annotations

import contextlib
import json
import logging
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
from fmu_files import PROBE, probe_library, strays, write_fmu

from cosim import CallError, DescriptionError, Interrupted, ProcessError, SignalError, System, make_system, simulate
from cosim.master.isolation import simulate_isolated

pytestmark = pytest.mark.skipif(
    sys.platform != "linux", reason="the FMU of these tests misbehaves in the ways of Linux"
)

LIMIT = 5.0
"""Seconds for a call: far more than any call of the probe needs on a busy machine."""

STARTS = (True, False)
"""Whether the process is forked or started anew."""


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("hostile")
    write_fmu(folder / "Hostile.fmu", PROBE, binary=probe_library("hostile").read_bytes())
    write_fmu(folder / "Probe.fmu", PROBE, binary=probe_library().read_bytes())
    return folder


@pytest.fixture(autouse=True)
def nothing_is_left(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Generator[None]:
    """No folder and no process stays behind, whatever happened."""
    place = tmp_path / "temporary"
    place.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(place))
    monkeypatch.setenv("TMPDIR", str(place))
    before = set(psutil.Process().children(recursive=True))
    yield
    deadline = time.monotonic() + 10.0

    def left() -> list[Path | psutil.Process]:
        return [*place.glob("*"), *set(psutil.Process().children(recursive=True)) - before, *strays()]

    while left() and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not left()


def hostile(fmus: Path, how: str, *, at: float = 0.5) -> System:
    """Two instances, a lag of gain 2 that feeds the hostile one; steps of 0.01 s up to 1 s."""
    document: dict[str, Any] = {
        "connections": ["good.y -> bad.u"],
        "experiment": {"stop_time": 1.0, "step_size": 0.01},
        "instances": {
            "good": {"fmu": "Probe", "start": {"gain": 2.0, "y_start": 1.0}},
            "bad": {"fmu": "Hostile", "start": {"label": how, "fail_time": at}},
        },
        "record": {"variables": ["good.y", "bad.y", "bad.clock"]},
    }
    return make_system(document, name=how, fmus=fmus)


def harmless(fmus: Path) -> Any:
    """The rows that a good FMU gives."""
    return simulate(hostile(fmus, "good"))


def check_rows(result: Any, fmus: Path, count: int) -> None:
    """The first ``count`` rows are those of a run in which nothing happened."""
    whole = harmless(fmus)
    assert result.rows.shape == (count, 3)
    np.testing.assert_array_equal(result.rows, whole.rows[:count])
    np.testing.assert_array_equal(result.time, whole.time[:count])
    assert result.partial == (count < 101)


@pytest.mark.parametrize("fork", STARTS)
def test_a_good_run_is_the_same_in_another_process(fmus: Path, fork: bool) -> None:
    system = hostile(fmus, "good")
    seen: list[float] = []
    result = simulate_isolated(system, fork=fork, progress=seen.append)
    inside = simulate(system)
    check_rows(result, fmus, 101)
    assert result.solver == inside.solver
    assert result.columns == inside.columns
    times = ("total_seconds", "stepping_seconds")
    assert {k: v for k, v in result.metadata.items() if k not in times} == {
        k: v for k, v in inside.metadata.items() if k not in times
    }
    assert all(0.0 <= share <= 1.0 for share in seen)


@pytest.mark.parametrize("fork", STARTS)
@pytest.mark.parametrize(
    ("how", "status", "text"),
    [
        ("segv", "Crash", "crashed: SIGSEGV"),
        ("temporary folder", "Crash", "crashed: SIGSEGV"),
        ("abort", "Crash", "crashed: SIGABRT"),
        ("stack", "Crash", "crashed: SIGSEGV"),
        ("trap", "Crash", "crashed: SIGILL"),
        ("kill", "Crash", "crashed: SIGKILL"),
        ("alarm", "Crash", "crashed: SIGALRM"),
        ("exit 0", "Exit", "exit code 0, which an FMU must not do"),
        ("exit 3", "Exit", "exit code 3, which an FMU must not do"),
        ("_exit", "Exit", "exit code 0, which an FMU must not do"),
        ("hang", "Timeout", "had not come back after 5 s"),
        ("sleep", "Timeout", "had not come back after 5 s"),
        ("deaf", "Timeout", "had not come back after 5 s"),
    ],
)
def test_an_fmu_that_ends_the_process(fmus: Path, fork: bool, how: str, status: str, text: str) -> None:
    with pytest.raises(ProcessError) as caught:
        simulate_isolated(hostile(fmus, how), fork=fork, timeout=LIMIT)
    error = caught.value
    assert isinstance(error, CallError)
    assert (error.instance, error.function, error.status) == ("bad", "fmi2DoStep", status)
    assert error.time == pytest.approx(0.5)
    assert str(error).startswith("bad: fmi2DoStep at 0.5 s ")
    assert text in str(error)
    check_rows(error.result, fmus, 51)


@pytest.mark.parametrize(
    ("how", "function", "time", "rows"),
    [
        ("segv in initialization", "fmi2EnterInitializationMode", 0.0, 0),
        ("hang in initialization", "fmi2EnterInitializationMode", 0.0, 0),
        ("segv while freed", "fmi2FreeInstance", 1.0, 101),
        ("hang while freed", "fmi2FreeInstance", 1.0, 101),
    ],
)
def test_outside_of_the_steps(fmus: Path, how: str, function: str, time: float, rows: int) -> None:
    with pytest.raises(ProcessError) as caught:
        simulate(hostile(fmus, how), isolated=True, timeout=LIMIT)
    error = caught.value
    assert (error.instance, error.function, error.time) == ("bad", function, time)
    check_rows(error.result, fmus, rows)


@pytest.mark.parametrize(("how", "statuses"), [("thread", {"Crash"}), ("thread that exits", {"Crash", "Exit"})])
def test_threads_that_are_left_running(fmus: Path, how: str, statuses: set[str]) -> None:
    """The library is unloaded below a running thread; a thread that exits at any time may crash the others by it."""
    with pytest.raises(ProcessError) as caught:
        simulate(hostile(fmus, how), isolated=True)
    assert caught.value.status in statuses
    result = caught.value.result
    assert result is not None
    check_rows(result, fmus, len(result.time))


@pytest.mark.parametrize("how", ["chdir", "close", "close all", "rounding", "locale", "fork", "daemon"])
def test_what_an_fmu_changes_ends_with_its_process(fmus: Path, how: str, tmp_path: Path) -> None:
    place, text = Path.cwd(), f"{1e-3:.17g} {0.1 + 0.2:.17g}"
    result = simulate(hostile(fmus, how), isolated=True)
    assert Path.cwd() == place
    assert f"{1e-3:.17g} {0.1 + 0.2:.17g}" == text
    assert result.rows.shape == (101, 3)
    assert result.save(tmp_path / "a.csv").read_text().startswith('"time","good.y"')
    check_rows(simulate(hostile(fmus, "good"), isolated=True), fmus, 101)


def test_what_an_fmu_prints_becomes_messages(fmus: Path, capfd: pytest.CaptureFixture[str]) -> None:
    result = simulate(hostile(fmus, "print"), isolated=True)
    check_rows(result, fmus, 101)
    texts = [message.text for message in result.messages]
    assert texts[:3] == ["to stderr \x1b[2J", "line 0", "line 1"]
    assert {message.category for message in result.messages} == {"printed"}
    assert len(texts) == 1000
    assert result.dropped_messages == 20002 - 1000
    assert capfd.readouterr() == ("", "")


def test_many_messages_do_not_crowd_out_a_warning(fmus: Path) -> None:
    result = simulate(hostile(fmus, "storm"), isolated=True, debug=True)
    assert [m.text for m in result.messages if m.status == "Warning"] == ["the one that matters"]
    assert sum(message.status == "OK" for message in result.messages) == 10_000
    assert result.dropped_messages == 10_000


def test_a_huge_message_is_cut(fmus: Path) -> None:
    (message,) = simulate(hostile(fmus, "huge"), isolated=True).messages
    assert len(message.text) < 11_000
    assert message.text.startswith("mmm")


def test_messages_go_to_the_logger_of_python(fmus: Path, caplog: pytest.LogCaptureFixture) -> None:
    for isolated in (False, True):
        caplog.clear()
        with caplog.at_level(logging.INFO, logger="cosim"):
            simulate(hostile(fmus, "escape"), isolated=isolated)
        assert [(record.name, record.levelname) for record in caplog.records] == [("cosim.fmu", "WARNING")]


def test_an_error_that_an_fmu_returns_is_the_same_error(fmus: Path) -> None:
    system = hostile(fmus, "good").changed({"good.fail_time": 0.3})
    errors: list[CallError] = []
    for isolated in (False, True):
        with pytest.raises(CallError) as caught:
            simulate(system, isolated=isolated)
        errors.append(caught.value)
    inside, outside = errors
    assert str(inside) == str(outside)
    assert type(inside) is type(outside)
    assert inside.result is not None
    assert outside.result is not None
    np.testing.assert_array_equal(inside.result.rows, outside.result.rows)
    assert inside.result.messages == outside.result.messages


def test_what_is_not_finite_on_a_connection_ends_the_run(fmus: Path) -> None:
    system = hostile(fmus, "good").changed({"good.y_start": 1e5})
    document = {**system.document, "connections": [{"from": "good.y", "to": "bad.u", "factor": 1e308}]}
    system = make_system(document, fmus=fmus)
    messages: list[str] = []
    for isolated in (False, True):
        with pytest.raises(SignalError) as caught:
            simulate(system, isolated=isolated)
        messages.append(str(caught.value))
    assert messages[0] == messages[1]
    assert "good.y gives bad.u the value inf" in messages[0]


@pytest.mark.parametrize("record_bytes", [1, 24 * 30, 24 * 1000])
@pytest.mark.parametrize("decimation", [1, 3])
def test_rows_that_do_not_stay_in_memory(
    fmus: Path, record_bytes: int, decimation: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Windows of a few rows: every row comes once, in order, and every n-th is kept."""
    monkeypatch.setattr("cosim.master.isolation.WINDOW_BYTES", 24 * 7)
    system = hostile(fmus, "segv").changed(decimation=decimation)
    came: list[tuple[np.ndarray, np.ndarray]] = []

    class Sink:
        def write(self, times: Any, rows: Any) -> None:
            came.append((times.copy(), rows.copy()))

    with pytest.raises(ProcessError) as caught:
        simulate_isolated(system, sink=Sink(), most_bytes=record_bytes)
    result = caught.value.result
    assert result is not None
    whole = simulate(hostile(fmus, "good").changed(decimation=decimation))
    count = 50 // decimation + 1
    if came:
        np.testing.assert_array_equal(np.concatenate([times for times, _ in came]), whole.time[:count])
        np.testing.assert_array_equal(np.concatenate([rows for _, rows in came]), whole.rows[:count])
    every = result.metadata["decimation"] // decimation
    np.testing.assert_array_equal(result.rows, whole.rows[:count:every])
    np.testing.assert_array_equal(result.time, whole.time[:count:every])


@pytest.mark.parametrize("timeout", [0.0, -1.0])
def test_a_limit_that_is_none_is_refused(fmus: Path, timeout: float) -> None:
    with pytest.raises(DescriptionError, match="give a positive number of seconds"):
        simulate(hostile(fmus, "good"), isolated=True, timeout=timeout)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
@pytest.mark.parametrize("how", ["hang", "deaf", "hang in initialization", "hang while freed"])
def test_a_signal_ends_a_run_that_hangs(fmus: Path, number: signal.Signals, how: str) -> None:
    seen = {"hang": 0.5, "deaf": 0.5, "hang in initialization": 0.0, "hang while freed": 1.0}
    rows = {"hang": 51, "deaf": 51, "hang in initialization": 0, "hang while freed": 101}

    def progress(share: float) -> None:
        if share >= seen[how] and not sent:
            sent.append(number)
            os.kill(os.getpid(), number)

    sent: list[int] = []
    with _default(number), pytest.raises(Interrupted) as caught:
        simulate(hostile(fmus, how), isolated=True, progress=progress)
    assert caught.value.number == number
    assert caught.value.result.rows.shape == (rows[how], 3)


@contextlib.contextmanager
def _default(number: signal.Signals) -> Generator[None]:
    """The handler that a program has from the start."""
    before = signal.getsignal(number)
    signal.signal(number, signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL)
    try:
        yield
    finally:
        signal.signal(number, before)


def test_the_second_signal_kills_at_once(fmus: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cosim.master.isolation.GRACE_SECONDS", 1e9)
    sent: list[int] = []

    def progress(share: float) -> None:
        if share >= 0.5 and len(sent) < 2:
            sent.append(1)
            os.kill(os.getpid(), signal.SIGINT)

    with _default(signal.SIGINT), pytest.raises(Interrupted) as caught:
        simulate(hostile(fmus, "hang"), isolated=True, progress=progress)
    assert caught.value.result.rows.shape == (51, 3)


# The command


Cosim = Callable[..., "subprocess.CompletedProcess[str]"]


@pytest.fixture
def run(fmus: Path, tmp_path: Path) -> Cosim:
    def made(how: str, *options: str, command: str = "run") -> subprocess.CompletedProcess[str]:
        system = hostile(fmus, how)
        from cosim.system.toml_write import write_system

        write_system(system, tmp_path / "system.toml")
        arguments = [sys.executable, "-m", "cosim", command, "system.toml", *options]
        return subprocess.run(arguments, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=120)

    return made


@pytest.mark.parametrize(
    ("how", "text"),
    [
        ("segv", "error: bad: fmi2DoStep at 0.5 s crashed: SIGSEGV"),
        ("exit 0", "error: bad: fmi2DoStep at 0.5 s ended its process with exit code 0"),
        ("hang", "error: bad: fmi2DoStep at 0.5 s had not come back after 2 s"),
    ],
)
def test_the_command_keeps_the_rows(run: Cosim, tmp_path: Path, how: str, text: str) -> None:
    done = run(how, "--output", "a.csv", "--timeout", "2")
    assert done.returncode == 1
    assert text in done.stderr
    assert "Computed up to 0.5 s (51 rows), kept in a.csv." in done.stderr
    assert "Traceback" not in done.stderr
    assert len((tmp_path / "a.csv").read_text().splitlines()) == 52


@pytest.mark.parametrize(
    ("command", "code", "text"),
    [
        ("check", 2, "error: bad: fmi2EnterInitializationMode at 0 s crashed: SIGSEGV"),
        ("linearize", 1, "error: bad: fmi2EnterInitializationMode at 0 s crashed: SIGSEGV"),
    ],
)
def test_commands_without_a_run_outlive_a_crash(run: Cosim, command: str, code: int, text: str) -> None:
    done = run("segv in initialization", *(["--instance", "bad"] if command == "linearize" else []), command=command)
    assert (done.returncode, "Traceback" in done.stderr) == (code, False)
    assert text in done.stderr


@pytest.mark.parametrize("how", ["print", "storm", "escape", "close", "chdir"])
def test_standard_output_stays_that_of_the_command(run: Cosim, tmp_path: Path, how: str) -> None:
    done = run(how, "--json", "--output", "a.csv")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["steps"] == 100
    assert (tmp_path / "a.csv").is_file()
    assert not set(done.stderr) & set("\x1b\x07\x9b")
    assert len(done.stderr) < 20_000
    if how == "storm":
        assert "[Warning] the one that matters" in done.stderr
