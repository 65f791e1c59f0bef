"""``cosim compare`` and ``cosim run --overlay``: what they print, write and return."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import Command
from fmu_files import write_probe

TIME = np.arange(1001) * 1e-3
SYSTEM = """
description = "A probe"
[experiment]
stop_time = 1.0
step_size = 0.1
[instances.a]
fmu = "Probe"
start = { y_start = 1.0, u = 0.5 }
"""


@pytest.fixture(autouse=True)
def in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def logs(tmp_path: Path) -> Path:
    """A position in mm and the same in m, 1 um away."""
    sine = np.sin(2.0 * np.pi * TIME)
    write_log(tmp_path / "log.csv", "t;x", "s;mm", TIME, sine)
    write_log(tmp_path / "other.csv", "time,pos", "s,m", TIME, 1e-3 * sine + 1e-6)
    return tmp_path


def write_log(path: Path, names: str, units: str, time: Any, values: Any) -> None:
    mark = ";" if ";" in names else ","
    lines = [f"{t!r}{mark}{value!r}" for t, value in zip(time.tolist(), values.tolist(), strict=True)]
    path.write_text("\n".join([names, units, *lines]) + "\n", encoding="utf-8")


@pytest.fixture
def system(tmp_path: Path) -> Path:
    folder = tmp_path / "build" / "fmus" / "native"
    folder.mkdir(parents=True)
    write_probe(folder)
    (tmp_path / "one.toml").write_text(SYSTEM, encoding="utf-8")
    return tmp_path


def test_two_records(logs: Path, cosim: Command) -> None:
    code, out, err = cosim("compare", "log.csv", "other.csv", "--signals", "x=pos")
    assert (code, err) == (0, "")
    for said in ("other.csv: pos is converted from m to mm", "both at the same 1001 times", "x / pos", "0.001", "mm"):
        assert said in out


def test_exit_code_follows_the_tolerance(logs: Path, cosim: Command) -> None:
    for tolerance, expected in (("x=2um", 0), ("0.5um", 1), ("0.1%", 0), ("1e-4", 1), ("x=0.01%", 1)):
        code, out, _ = cosim("compare", "log.csv", "other.csv", "--signals", "x=pos", "--tolerance", tolerance)
        assert code == expected, tolerance
        assert ("outside its tolerance" in out) == bool(expected)
    # Both kinds add up: 0.5 um and 0.05 % of 2 mm.
    both = ("--tolerance", "x=0.5um", "x=0.05%")
    assert cosim("compare", "log.csv", "other.csv", "--signals", "x=pos", *both)[0] == 0


def test_tolerances_of_one_signal_leave_the_others_free(logs: Path, cosim: Command) -> None:
    write_log(logs / "wild.csv", "time,x", "s,mm", TIME, np.zeros_like(TIME))
    code, out, _ = cosim("compare", "log.csv", "wild.csv", "--signals", "x", "--tolerance", "x=1nm")
    assert code == 1
    assert "Within their tolerances: 0 of 1" in out


def test_json_for_scripts(logs: Path, cosim: Command) -> None:
    code, out, _ = cosim("compare", "log.csv", "other.csv", "--signals", "x=pos", "--tolerance", "0.1um", "--json")
    found = json.loads(out)
    assert code == 1
    assert found["within"] is False
    (signal,) = found["signals"]
    assert signal["max"] == pytest.approx(1e-3)
    assert signal["rms"] == pytest.approx(1e-3)
    assert signal["fit_percent"] == pytest.approx(100.0 * (1.0 - 1e-3 * np.sqrt(2.0)), rel=1e-4)
    assert signal["outside"]["count"] == 1001
    assert found["plot"] is None


def test_all_that_is_wrong_is_told_before_anything_runs(logs: Path, cosim: Command) -> None:
    wrong = (
        *("--tolerance", "x=2 parsecs", "--delay", "soon", "--from", "now", "--time-tolerance=-1"),
        *("--plot", "a.doc", "--report", "a.doc", "--set-b", "y", "--sampling-time", "0.1"),
    )
    code, out, err = cosim("compare", "missing.csv", "nothing", *wrong)
    assert (code, out) == (2, "")
    for said in (
        *("parsecs", "--delay soon", "--from now", "--time-tolerance -1", "name of a picture", "name of a report"),
        *("--set-b y", "missing.csv", "nothing: no such file"),
    ):
        assert said in err


def test_names_that_do_not_fit_are_wrong_input(logs: Path, cosim: Command) -> None:
    code, _, err = cosim("compare", "log.csv", "other.csv")
    assert code == 2
    assert "say which belong together, as NAME=OTHER" in err
    code, _, err = cosim("compare", "log.csv", "other.csv", "--signals", "x=po")
    assert code == 2
    assert "Did you mean 'pos'?" in err


def test_options_of_runs_are_refused_for_records(logs: Path, cosim: Command) -> None:
    code, _, err = cosim(
        "compare", "log.csv", "other.csv", "--signals", "x=pos", "--set-b", "a.u=1", "--stop-time", "1"
    )
    assert code == 2
    assert "--set-b is of a run, and other.csv is a record" in err
    assert "both sides are records" in err


def test_units_that_a_record_does_not_say(logs: Path, cosim: Command) -> None:
    (logs / "bare.csv").write_text("time,x\n" + "".join(f"{t!r},{0.5 * t!r}\n" for t in range(9)))
    code, out, _ = cosim("compare", "bare.csv", "bare.csv", "--units", "x=mm", "--json")
    assert code == 0
    assert json.loads(out)["signals"][0]["unit"] == "mm"


def test_delay_is_estimated_said_and_taken_out(logs: Path, cosim: Command) -> None:
    late = np.sin(2.0 * np.pi * (TIME - 0.0123)) + 0.2 * np.sin(11.0 * (TIME - 0.0123))
    on_time = np.sin(2.0 * np.pi * TIME) + 0.2 * np.sin(11.0 * TIME)
    write_log(logs / "a.csv", "t,x", "s,m", TIME, on_time)
    write_log(logs / "b.csv", "t,x", "s,m", TIME, late)
    _, out, _ = cosim("compare", "a.csv", "b.csv")
    assert "b.csv lags behind by 0.0123 s" in out
    code, out, _ = cosim("compare", "a.csv", "b.csv", "--delay", "estimate", "--tolerance", "1e-5")
    assert code == 0
    assert "b.csv is moved back by 0.0123" in out


def test_a_window_that_ends_before_it_begins(logs: Path, cosim: Command) -> None:
    code, _, err = cosim("compare", "log.csv", "other.csv", "--signals", "x=pos", "--from", "0.5", "--to", "0.4")
    assert code == 2
    assert "--from 0.5 is after --to 0.4" in err


def test_pictures_and_pages(logs: Path, cosim: Command) -> None:
    code, out, _ = cosim(
        "compare", "log.csv", "other.csv", "--signals", "x=pos", "--plot", "a.png", "--report", "a.html"
    )
    assert code == 0
    assert "Written: a.png" in out
    assert "Written: a.html" in out
    assert (logs / "a.png").read_bytes().startswith(b"\x89PNG")
    page = (logs / "a.html").read_text(encoding="utf-8")
    assert "<h1>other.csv compared with log.csv</h1>" in page
    assert "fit (NRMSE)" in page


def test_two_runs_of_one_system(system: Path, cosim: Command) -> None:
    code, out, _ = cosim("compare", "one.toml", "one.toml", "--json")
    assert code == 0
    assert {signal["max"] for signal in json.loads(out)["signals"]} == {0.0}
    code, out, _ = cosim("compare", "one.toml", "one.toml", "--set-b", "a.y_start=2", "--tolerance", "1e-9", "--json")
    found = json.loads(out)
    assert code == 1
    assert found["b"] == "one.toml (a.y_start=2)"
    assert max(signal["max"] for signal in found["signals"]) > 0.1


def test_a_run_with_its_own_record_read_back(system: Path, cosim: Command) -> None:
    assert cosim("run", "one.toml", "--output", "a.csv")[0] == 0
    code, out, _ = cosim("compare", "a.csv", "one.toml", "--tolerance", "0", "--json")
    found = json.loads(out)
    assert code == 0
    assert found["notes"] == []
    assert all(signal["max"] == 0.0 for signal in found["signals"])


def test_a_run_that_fails_is_no_agreement(system: Path, cosim: Command) -> None:
    code, _, err = cosim("compare", "one.toml", "one.toml", "--set-b", "a.fail_time=0.4")
    assert code == 1
    assert "fmi2DoStep" in err


def test_overlay_of_a_run(system: Path, cosim: Command) -> None:
    cosim("run", "one.toml", "--output", "a.csv")
    code, out, _ = cosim("run", "one.toml", "--overlay", "a.csv", "--report", "a.html", "--plot", "a.png")
    assert code == 0
    assert "one.toml minus a.csv" in out
    page = (system / "a.html").read_text(encoding="utf-8")
    for said in ("Figures", "Signals and differences", "Provenance"):
        assert f"<h2>{said}" in page or said == "Figures"
    code, out, _ = cosim("run", "one.toml", "--overlay", "a.csv", "--signals", "a.y=a.y", "--json")
    (signal,) = json.loads(out)["overlay"]["signals"]
    assert (signal["name"], signal["max"]) == ("a.y", 0.0)


def test_overlay_is_checked_before_the_run(system: Path, logs: Path, cosim: Command) -> None:
    code, out, err = cosim("run", "one.toml", "--overlay", "log.csv", "--signals", "a.yy=x", "a.y=xx")
    assert (code, out) == (2, "")
    assert "one.toml: has no 'a.yy'" in err
    assert "log.csv: has no 'xx'" in err
    code, _, err = cosim("run", "one.toml", "--signals", "a.y=x")
    assert code == 2
    assert "belong to --overlay" in err
