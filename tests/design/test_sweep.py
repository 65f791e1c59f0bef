"""Sweeps: designs of runs, the data set, failures, interruption and resumption, workers that die."""

from __future__ import annotations

import errno
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import distributed
import numpy as np
import psutil
import pytest
from fmu_files import PROBE, probe_library, strays, write_fmu

from cosim.design import crew
from cosim.design.dataset import DataSet
from cosim.design.plan import Sweep, make_sweep, read_sweep
from cosim.design.sweep import SweepProgress, report, sweep
from cosim.design.workers import LEAST_SECONDS, LONGEST_TIMES, UNKNOWN_SECONDS, Limit, Loadable, LoadError, Worker
from cosim.errors import CosimError, DescriptionError, FileError
from cosim.master.child import HIGH
from cosim.system.system import read_system

linux = pytest.mark.skipif(sys.platform != "linux", reason="the FMU of this test misbehaves in the ways of Linux")
STEP = Path(__file__).parents[2] / "studies" / "maeda2008" / "step.toml"
GAINS = {"from": 300.0, "to": 1200.0, "count": 4}


@pytest.fixture
def make(native: Path) -> Callable[..., Sweep]:
    def made(parameters: dict[str, Any], **more: Any) -> Sweep:
        document = {"system": STEP.name, "parameters": parameters, "experiment": {"stop_time": 0.02}, **more}
        return make_sweep(document, folder=STEP.parent, fmus=native)

    return made


def rows_of(folder: Path) -> dict[str, list[Any]]:
    return DataSet(folder).read().to_pydict()


def assert_complete(folder: Path, plan: Sweep) -> None:
    """Every run once, and with its own values."""
    rows = rows_of(folder)
    assert rows["run"] == list(range(len(plan.points)))
    assert list(zip(*(rows[path] for path in plan.parameters), strict=True)) == list(plan.points)


# Designs


def test_a_grid_has_every_combination(make: Callable[..., Sweep]) -> None:
    plan = make({"controller.K_P": GAINS, "plant.m": {"from": 1.0, "to": 100.0, "count": 3, "log": True}})
    assert [point[0] for point in plan.points[::3]] == pytest.approx([300.0, 600.0, 900.0, 1200.0])
    assert [point[1] for point in plan.points[:3]] == pytest.approx([1.0, 10.0, 100.0])
    assert len(set(plan.points)) == 12


def test_a_list_goes_through_its_values_together(make: Callable[..., Sweep]) -> None:
    plan = make({"controller.K_P": [1.0, 2.0], "controller.velocity_source": ["input", "difference"]}, method="list")
    assert plan.points == ((1.0, "input"), (2.0, "difference"))


@pytest.mark.parametrize("method", ["latin", "sobol"])
def test_random_designs_fill_every_stratum_and_repeat(make: Callable[..., Sweep], method: str) -> None:
    """Both put one of 2^m points into each of 2^m equal intervals of every parameter."""
    given = {"controller.K_P": {"from": 0.0, "to": 32.0}, "plant.m": {"from": 1.0, "to": 16.0, "log": True}}
    plan = make(given, method=method, count=32, seed=3)
    gains, masses = np.array(plan.points).T
    assert sorted(np.floor(gains)) == list(range(32))
    assert sorted(np.floor(8.0 * np.log2(masses))) == list(range(32))
    assert make(given, method=method, count=32, seed=3).points == plan.points
    assert make(given, method=method, count=32, seed=4).points != plan.points


def test_everything_wrong_is_said_at_once(make: Callable[..., Sweep]) -> None:
    with pytest.raises(DescriptionError) as refusal:
        make(
            {"plant.mas": [1.0]},
            metrics={"a": {"of": "rmss", "signal": "plant.position"}, "b": {"of": "rms", "signal": "plant.positon"}},
            colour="red",
        )
    for text in ("colour: unknown key", "no variable 'mas'", "Did you mean 'rms'", "Did you mean 'position'"):
        assert text in str(refusal.value)
    for parameters, more, text in (
        ({"plant.m": [-1.0]}, {}, "below its minimum"),
        ({"plant.m": {"from": 1.0}}, {}, "write { from = 1.0"),
        ({"plant.m": {"from": 0.0, "to": 1.0, "count": 3, "log": True}}, {}, "log needs positive ends"),
        ({"plant.m": [1.0], "plant.J": [1.0, 2.0]}, {"method": "list"}, "equally many"),
        ({"plant.m": {"from": 1.0, "to": 2.0}}, {"method": "sobol"}, "needs a number of runs"),
        ({"plant.position": [1.0]}, {}, "cannot be set"),
        ({}, {}, "none given"),
        ({"plant.m": [1.0]}, {"method": "sobel"}, "Did you mean 'sobol'"),
    ):
        with pytest.raises(DescriptionError, match=text):
            make(parameters, **more)


# Results


def test_figures_are_those_of_single_runs(make: Callable[..., Sweep], tmp_path: Path) -> None:
    from cosim.master.simulation import simulate

    metrics = {"window": [0.01, 0.02], "top": {"of": "max", "signal": "plant.position"}}
    plan = make({"controller.K_P": GAINS}, metrics=metrics)
    outcome = sweep(plan, tmp_path / "data", workers=0)
    assert (outcome.runs, outcome.new, outcome.failed) == (4, 4, 0)
    rows = rows_of(tmp_path / "data")
    for gain, top in zip(rows["controller.K_P"], rows["top"], strict=True):
        result = simulate(read_system(STEP, {"controller.K_P": gain}, fmus=plan.system.fmus, stop_time=0.02))
        assert top == np.max(result["plant.position"][50:])


def test_without_metrics_the_loop_is_judged(make: Callable[..., Sweep], tmp_path: Path) -> None:
    sweep(make({"controller.K_P": GAINS, "trajectory.amplitude": [1e-4]}), tmp_path / "data", workers=0)
    rows = rows_of(tmp_path / "data")
    assert rows["error_max"] == [1e-4] * 4  # the reference steps at the start
    assert len(set(rows["error_rms"])) == 4


def test_a_failing_run_is_recorded_and_stops_no_other(make: Callable[..., Sweep], tmp_path: Path) -> None:
    """F_S = 0 with F_C above 0 breaks a rule of the plant, which it finds when it is initialized."""
    plan = make({"plant.F_S": [0.05, 0.0, 0.06]})
    outcome = sweep(plan, tmp_path / "data", workers=0)
    rows = rows_of(tmp_path / "data")
    assert outcome.failed == 1
    assert rows["run"] == [0, 1, 2]
    assert "F_S = 0 with F_C > 0" in rows["error"][1]
    assert rows["error_rms"][1] is None
    assert rows["error"][0] is rows["error"][2] is None
    assert "Failed runs" in report(tmp_path / "data").read_text(encoding="utf-8")


def test_the_report_shows_heat_maps(make: Callable[..., Sweep], tmp_path: Path) -> None:
    figures = {name: {"of": name, "signal": "plant.position"} for name in ("rms", "last")}
    masses = {"from": 1.0, "to": 100.0, "count": 3, "log": True}
    sweep(make({"controller.K_P": GAINS, "plant.m": masses}, metrics=figures), tmp_path / "data", workers=0)
    text = report(tmp_path / "data").read_text(encoding="utf-8")
    assert "12 runs are recorded, 0 of them failed" in text
    rows = rows_of(tmp_path / "data")
    for name in figures:
        values = rows[name]
        spread = f"| {name} | m | {min(values):.6g} | {float(np.median(values)):.6g} | {max(values):.6g} |"
        assert f"{spread} {values.index(max(values))} |" in text
        assert f"]({name}.png)" in text
        assert (tmp_path / "data" / f"{name}.png").stat().st_size > 5000


def test_a_figure_that_would_be_lost_under_another_column_is_refused(make: Callable[..., Sweep]) -> None:
    metrics = {name: {"of": "rms", "signal": "plant.position"} for name in ("error", "seconds", "rms")}
    with pytest.raises(DescriptionError) as caught:
        make({"controller.K_P": GAINS}, metrics=metrics)
    assert [problem.partition("metrics.")[2].partition(":")[0] for problem in caught.value.problems] == [
        *("error", "seconds")
    ]
    assert "Take another, such as error_rms." in str(caught.value)


# Interruption


class Stop(Exception):
    pass


def test_an_interrupted_sweep_goes_on_where_it_was(make: Callable[..., Sweep], tmp_path: Path) -> None:
    plan = make({"controller.K_P": {"from": 300.0, "to": 1200.0, "count": 30}})
    sweep(plan, tmp_path / "whole", workers=0)

    def stop(progress: SweepProgress) -> None:
        if progress.done > 3:
            raise Stop

    with pytest.raises(Stop):
        sweep(plan, tmp_path / "data", workers=0, progress=stop)
    held = len(rows_of(tmp_path / "data")["run"])
    assert 3 < held < 30
    outcome = sweep(plan, tmp_path / "data", workers=0)
    assert outcome.new == 30 - held
    assert_complete(tmp_path / "data", plan)
    assert rows_of(tmp_path / "data")["error_rms"] == rows_of(tmp_path / "whole")["error_rms"]
    assert sweep(plan, tmp_path / "data", workers=0).new == 0


def test_another_sweep_does_not_mix_in(make: Callable[..., Sweep], tmp_path: Path) -> None:
    sweep(make({"controller.K_P": [1.0]}), tmp_path / "data", workers=0)
    other = make({"controller.K_P": [2.0]})
    with pytest.raises(DescriptionError, match="another sweep"):
        sweep(other, tmp_path / "data", workers=0)
    assert sweep(other, tmp_path / "data", workers=0, restart=True).runs == 1
    assert rows_of(tmp_path / "data")["controller.K_P"] == [2.0]
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis.tex").touch()
    with pytest.raises(DescriptionError, match="not empty"):
        sweep(other, tmp_path / "full", workers=0)
    assert [path.name for path in (tmp_path / "full").iterdir()] == ["thesis.tex"]


def test_a_full_disk_ends_the_sweep_and_loses_nothing(
    make: Callable[..., Sweep], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = make({"controller.K_P": {"from": 300.0, "to": 1200.0, "count": 30}})
    written = 0
    real = os.fsync

    def full(file: int) -> None:
        nonlocal written
        written += 1
        if written > 6:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        real(file)

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(FileError, match="no space is left"):
        sweep(plan, tmp_path / "data", workers=0)
    monkeypatch.undo()
    assert not list(tmp_path.rglob("*.part"))
    held = rows_of(tmp_path / "data")["run"]
    assert 0 < len(held) < 30
    sweep(plan, tmp_path / "data", workers=0)
    assert_complete(tmp_path / "data", plan)


SWEEP_FILE = """
system = {system}
[parameters]
"controller.K_P" = {{ from = 300.0, to = 1200.0, count = 60 }}
[experiment]
stop_time = 0.6
"""


def test_a_killed_sweep_goes_on(native: Path, tmp_path: Path) -> None:
    file = tmp_path / "gains.toml"
    file.write_text(SWEEP_FILE.format(system=json.dumps(str(STEP))), encoding="utf-8")
    call = f"from cosim.design.sweep import sweep; sweep({str(file)!r}, {str(tmp_path / 'data')!r}, "
    call += f"fmus={str(native)!r}, workers=0)"
    process = subprocess.Popen([sys.executable, "-c", call])
    try:
        deadline = time.monotonic() + 60.0
        while len(list((tmp_path / "data" / "runs").glob("*.parquet"))) < 2:
            assert time.monotonic() < deadline
            assert process.poll() is None
            time.sleep(0.005)
        process.send_signal(signal.SIGKILL)
    finally:
        process.kill()
        process.wait()
    held = len(rows_of(tmp_path / "data")["run"])
    assert 0 < held < 60
    plan = read_sweep(file, fmus=native)
    assert sweep(plan, tmp_path / "data", workers=0).new == 60 - held
    assert_complete(tmp_path / "data", plan)


def test_damaged_files_are_set_aside_and_their_runs_done_again(make: Callable[..., Sweep], tmp_path: Path) -> None:
    plan = make({"controller.K_P": {"from": 300.0, "to": 1200.0, "count": 30}})
    sweep(plan, tmp_path / "data", workers=0)
    whole = rows_of(tmp_path / "data")["error_rms"]
    first, second, *_ = sorted((tmp_path / "data" / "runs").glob("*.parquet"))
    first.write_bytes(first.read_bytes()[:-100])
    second.write_bytes(b"")
    (tmp_path / "data" / "sweep.json").write_text('{"digest": ', encoding="utf-8")
    with pytest.raises(DescriptionError, match=r"sweep\.json is damaged"):
        report(tmp_path / "data")
    outcome = sweep(plan, tmp_path / "data", workers=0)
    assert len(outcome.notes) == 3
    assert "it is not whole" in "".join(outcome.notes)
    assert 0 < outcome.new < 30
    assert_complete(tmp_path / "data", plan)
    assert rows_of(tmp_path / "data")["error_rms"] == whole
    assert sweep(plan, tmp_path / "data", workers=0).notes == ()


def test_rows_of_another_sweep_are_known_without_its_description(make: Callable[..., Sweep], tmp_path: Path) -> None:
    sweep(make({"controller.K_P": [1.0]}), tmp_path / "data", workers=0)
    (tmp_path / "data" / "sweep.json").write_text("", encoding="utf-8")
    with pytest.raises(DescriptionError, match="another sweep"):
        sweep(make({"controller.K_P": [2.0]}), tmp_path / "data", workers=0)


@linux
def test_what_an_fmu_does_to_its_process_meets_no_other_run(hostile: Callable[..., Sweep], tmp_path: Path) -> None:
    """Rounding, locale and folder are changed in the middle of a run; the runs after it are as before."""
    ways = ["good", "rounding", "good", "chdir", "good"]
    sweep(hostile(*ways, metrics={"y": {"of": "rms", "signal": "h.y"}}, method="list"), tmp_path / "data", workers=1)
    rows = rows_of(tmp_path / "data")
    assert rows["error"] == [None] * 5
    assert rows["y"][0] == rows["y"][2] == rows["y"][4]


@linux
def test_two_sweeps_do_not_write_into_one_folder(make: Callable[..., Sweep], tmp_path: Path) -> None:
    plan = make({"controller.K_P": [1.0]})
    with DataSet(tmp_path / "data").locked(), pytest.raises(DescriptionError, match="another sweep is writing"):
        sweep(plan, tmp_path / "data", workers=0)


# Workers


def workers() -> list[psutil.Process]:
    """Processes for runs that this one has started, and those that FMUs have started away from them."""
    return strays() + [
        child
        for child in psutil.Process().children(recursive=True)
        if "cosim.design.workers" in " ".join(child.cmdline())
    ]


def test_a_worker_killed_on_the_way_costs_no_run(make: Callable[..., Sweep], tmp_path: Path) -> None:
    plan = make({"controller.K_P": {"from": 300.0, "to": 1200.0, "count": 80}}, experiment={"stop_time": 0.2})
    sweep(plan, tmp_path / "whole", workers=0)
    killed: list[int] = []

    def kill(progress: SweepProgress) -> None:
        if progress.done > 4 and not killed:
            victim = workers()[0]
            killed.append(victim.pid)
            victim.kill()

    outcome = sweep(plan, tmp_path / "data", workers=2, progress=kill)
    assert killed
    assert outcome.failed == 0
    assert_complete(tmp_path / "data", plan)
    assert rows_of(tmp_path / "data")["error_rms"] == rows_of(tmp_path / "whole")["error_rms"]
    assert not workers()


@pytest.fixture
def hostile(tmp_path: Path) -> Callable[..., Sweep]:
    """A sweep over the ways in which an FMU misbehaves. Its limit is far above what a run needs on a busy machine."""
    write_fmu(tmp_path / "Hostile.fmu", PROBE, binary=probe_library("hostile").read_bytes())
    (tmp_path / "hostile.toml").write_text(
        "connections = []\n[experiment]\nstop_time = 1.0\nstep_size = 0.01\n"
        '[instances.h]\nfmu = "Hostile"\nstart = { fail_time = 0.5 }\n',
        encoding="utf-8",
    )

    def made(*ways: str, **more: Any) -> Sweep:
        document = {
            "system": "hostile.toml",
            "timeout": 100.0,
            "parameters": {"h.label": list(ways)},
            "metrics": {"last": {"of": "last", "signal": "h.clock"}},
            **more,
        }
        return make_sweep(document, folder=tmp_path, fmus=tmp_path)

    return made


@linux
def test_runs_that_crash_or_exit_are_recorded_and_stop_no_other(hostile: Callable[..., Sweep], tmp_path: Path) -> None:
    reasons = {
        "segv": "h: fmi2DoStep at 0.5 s crashed: SIGSEGV",
        "exit 0": "h: fmi2DoStep at 0.5 s ended its process with exit code 0",
        "close all": "closed or damaged the connection",
        "write all": "closed or damaged the connection",
        "background": "exit code 0",
        "kill": "killed 3 times",
    }
    plan = hostile("good", *reasons, "daemon")
    outcome = sweep(plan, tmp_path / "data", workers=2)
    assert_complete(tmp_path / "data", plan)
    rows = rows_of(tmp_path / "data")
    for run, reason in enumerate(reasons.values(), start=1):
        assert reason in rows["error"][run]
    assert outcome.failed == len(reasons)
    assert rows["last"] == [pytest.approx(1.0), *(None for _ in reasons), pytest.approx(1.0)]
    assert not workers()
    assert sweep(plan, tmp_path / "data", workers=2).new == 0


@linux
def test_runs_that_hang_are_recorded_and_the_sweep_ends(hostile: Callable[..., Sweep], tmp_path: Path) -> None:
    plan = hostile("hang", "sleep", "deaf", timeout=1.0)
    outcome = sweep(plan, tmp_path / "data", workers=2)
    assert_complete(tmp_path / "data", plan)
    # On a busy machine a run may reach its limit before the call that hangs.
    assert all("when 1 s had passed, the limit for a run" in text for text in rows_of(tmp_path / "data")["error"])
    assert outcome.failed == 3
    assert not workers()


@linux
def test_a_run_that_closes_the_connection_for_calls_costs_no_later_run() -> None:
    with Worker() as worker:
        before = worker.call(os.getpid, limit=Limit(100.0))
        worker.call(os.close, HIGH, limit=Limit(100.0))
        assert worker.call(os.getpid, limit=Limit(100.0)) != before


def test_the_limit_of_a_run_is_one_for_loading_too(
    hostile: Callable[..., Sweep], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cosim.design.workers.LEAST_SECONDS", 0.0)
    with Worker() as worker, pytest.raises(LoadError, match=r"loading the FMUs: .* when 1e-09 s had passed, the limit"):
        worker.prepare(Loadable.of(hostile("good").system), 1e-9)


def test_without_a_limit_given_it_follows_from_the_runs_measured() -> None:
    limit = Limit()
    assert limit.seconds == UNKNOWN_SECONDS
    limit.learn(0.1)
    assert limit.seconds == LEAST_SECONDS
    limit.learn(3.0)
    limit.learn(1.0)
    assert limit.seconds == LONGEST_TIMES * 3.0
    assert Limit(2.0).seconds == 2.0


def test_fmus_that_cannot_be_loaded_end_the_sweep_with_a_sentence(
    hostile: Callable[..., Sweep], tmp_path: Path
) -> None:
    (tmp_path / "Hostile.fmu").unlink()
    write_fmu(tmp_path / "Hostile.fmu", PROBE, binary=b"no library")
    with pytest.raises(CosimError, match="cannot be loaded"):
        sweep(hostile("good", "good"), tmp_path / "data", workers=2)
    assert not workers()


def test_a_cluster_given_by_its_scheduler_does_the_runs(make: Callable[..., Sweep], tmp_path: Path) -> None:
    plan = make({"controller.K_P": GAINS})
    cluster = distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, protocol="tcp://", dashboard_address="127.0.0.1:0"
    )
    with cluster:
        outcome = sweep(plan, tmp_path / "data", scheduler=cluster.scheduler_address)
    assert (outcome.runs, outcome.failed, outcome.workers) == (4, 0, 1)
    assert_complete(tmp_path / "data", plan)


def test_no_scheduler_is_said(make: Callable[..., Sweep], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(crew, "CONNECT_SECONDS", 0.5)
    with pytest.raises(DescriptionError, match=r"no dask scheduler at tcp://127\.0\.0\.1:9"):
        sweep(make({"plant.m": [3.0]}), tmp_path / "data", scheduler="tcp://127.0.0.1:9")
