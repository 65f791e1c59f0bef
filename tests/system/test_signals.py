"""Records in system files: what is refused, what is told, and what every form of a system keeps."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmu_files import write_probe

from cosim.commands.cli import main
from cosim.errors import DescriptionError
from cosim.fmu.tables import write_toml
from cosim.record.description import Column, description_path
from cosim.record.write import RecordWriter
from cosim.system.ssp_write import lost_elsewhere, write_ssp
from cosim.system.system import System, make_system, read_system
from cosim.system.toml_write import write_system

LOG = "t [ms],force [kN],x [mm],note\n" + "".join(f"{k},{k * 0.5},{k * k},ok\n" for k in range(11))
"""11 samples, 1 ms apart."""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_probe(tmp_path)
    write_probe(tmp_path, "Meter", u="m")
    (tmp_path / "log.csv").write_text(LOG, encoding="utf-8")
    return tmp_path


def document(signal: Mapping[str, Any] | None = None, **more: Any) -> dict[str, Any]:
    columns = {"force": {"column": "force", "factor": 2.0, "unit": "V"}, "x": "x"}
    return {
        "connections": ["log.force -> a.u"],
        "experiment": {"stop_time": 0.01, "step_size": 0.001},
        "instances": {"a": {"fmu": "Probe"}, "m": {"fmu": "./Meter.fmu"}},
        "signals": {"log": {"file": "log.csv", "columns": columns, **(signal or {})}},
        **more,
    }


def made(folder: Path, signal: Mapping[str, Any] | None = None, **more: Any) -> System:
    return make_system(document(signal, **more), name="s.toml", folder=folder, fmus=folder)


def problems(folder: Path, signal: Mapping[str, Any] | None = None, **more: Any) -> tuple[str, ...]:
    with pytest.raises(DescriptionError) as caught:
        made(folder, signal, **more)
    return caught.value.problems


# What is read


def test_columns_are_scaled_and_have_units(folder: Path) -> None:
    columns = {
        "force": {"column": "force", "factor": 2.0, "offset": -1.0, "unit": "V"},
        "same": "x [mm]",
        "x": {"column": "x", "unit": "m"},
        "raw": {"column": "force", "unit": "kN", "offset": 3.0},
    }
    (log,) = made(folder, {"columns": columns}).signals
    assert {name: variable.unit for name, variable in log.variables.items()} == {
        "force": "V",
        "same": "mm",
        "x": "m",
        "raw": "kN",
    }
    k = np.arange(11)
    assert log.columns["force"].tolist() == (k * 0.5 * 2.0 - 1.0).tolist()
    assert log.columns["same"].tolist() == (k * k).astype(float).tolist()
    assert log.columns["x"] == pytest.approx(k * k * 1e-3, rel=1e-15)
    assert log.columns["raw"].tolist() == (k * 0.5 + 3.0).tolist()
    assert log.resampler.time == pytest.approx(k * 1e-3, rel=1e-15)


def test_without_columns_all_are_there_by_their_names(folder: Path) -> None:
    (folder / "plain.csv").write_text("time,plant.position,b\n0,1,2\n0.01,3,4\n", encoding="utf-8")
    table = {"file": "plain.csv"}
    system = made(folder, connections=["log.plant.position -> a.u"], signals={"log": table})
    assert system.signals[0].outputs == ("plant.position", "b")
    # By default a record is recorded where it feeds something.
    assert [entry for entry in system.record if entry[0] == "log"] == [("log", "plant.position")]
    assert system.variable("log", "plant.position").unit == "V"
    assert any("nothing says the unit of 'plant.position': its values are taken as V" in note for note in system.notes)


def test_derivatives_have_names_and_units(folder: Path) -> None:
    columns = {"x": {"column": "x", "derivatives": 2, "smoothing": "none"}}
    (log,) = made(folder, {"columns": columns}, connections=[]).signals
    assert {name: variable.unit for name, variable in log.variables.items()} == {
        "x": "mm",
        "der(x)": "mm/s",
        "der(x,2)": "mm/s2",
    }
    # x = k^2 mm at k ms: central differences are exact for it.
    assert log.columns["der(x)"] == pytest.approx(2e3 * np.arange(11), abs=1e-6)
    assert log.columns["der(x,2)"] == pytest.approx(np.full(11, 2e6), rel=1e-9)


def test_a_record_of_a_run_keeps_its_units_in_every_form(
    folder: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """They stand beside the CSV file."""
    target = tmp_path_factory.mktemp("exported")
    with RecordWriter(folder / "run.csv", [Column("p.x", "mm", "", "mm")], {"system": "s"}) as writer:
        writer.write(np.array([0.0, 1.0]), np.array([[1.0], [2.0]]))
        writer.finish({})
    table = {"file": "run.csv", "columns": {"x": {"column": "p.x", "unit": "m"}}}
    system = made(folder, connections=["run.x -> m.u"], signals={"run": table})
    assert system.signals[0].columns["x"].tolist() == [1e-3, 2e-3]
    for path in (write_system(system, target / "s.toml"), write_ssp(system, target / "s.ssp")):
        read = read_system(path)
        assert read.digest == system.digest
        assert read.signals[0].columns["x"].tolist() == [1e-3, 2e-3]
    # Without what stands beside it, the file says no unit: the numbers are taken as m, and that is another system.
    description_path(folder / "run.csv").unlink()
    without = made(folder, connections=["run.x -> m.u"], signals={"run": table})
    assert without.signals[0].columns["x"].tolist() == [1.0, 2.0]
    assert without.digest != system.digest


# What is refused, with what to write instead


@pytest.mark.parametrize(
    ("signal", "text"),
    [
        ({"file": "lg.csv"}, "signals.log: {folder}/lg.csv: no such file. Did you mean 'log.csv'?"),
        ({"fille": "log.csv"}, "signals.log.fille: unknown key. Did you mean 'file'?"),
        (
            {"interpolation": "lin"},
            "signals.log.interpolation: 'lin' is not one of the values allowed. Did you mean 'linear'?",
        ),
        ({"extend": "zero"}, "signals.log.extend: 'zero' is not one of the values allowed. Known: hold, repeat, stop."),
        ({"time": "x"}, "column x: 'mm' is no unit of time."),
        ({"time_unit": "m"}, "column t: 'm' is no unit of time."),
        ({"sampling_time": "often"}, "signals.log.sampling_time: must be a number of seconds, or a quotient"),
        ({"time": "t", "sampling_time": 1e-3}, "give a column of time or a sampling time, not both"),
        ({"columns": {"f": "forc"}}, "no column 'forc'. Did you mean 'force'?"),
        ({"columns": {"f": {"colum": "force"}}}, "signals.log.columns.f.colum: unknown key. Did you mean 'column'?"),
        ({"columns": {"n": "note"}}, "line 2, row 1, column note: 'ok' is not a number."),
        ({"columns": {"f": {"column": "force", "factor": 2.0}}}, "the file says kN: say the unit after the factor"),
        ({"columns": {"f": {"column": "force", "unit": "m"}}}, "the file says kN, which cannot be converted to m."),
        ({"columns": {"f": {"column": "force", "unit": "Newton"}}}, "unit 'Newton': unknown symbol 'Newton'"),
        ({"columns": {"f": {"column": "force", "factor": "2"}}}, "columns.f.factor: must be a number"),
        ({"columns": {"f": {"column": "force", "derivatives": 1}}}, "say how derivatives are computed"),
        ({"columns": {"f": {"column": "force", "derivatives": 3, "smoothing": "none"}}}, "columns.f.derivatives"),
        ({"columns": {"f": {"column": "force", "smoothing": "none"}}}, "smoothing needs derivatives"),
        (
            {"columns": {"f": {"column": "force", "derivatives": 1, "smoothing": {"window": 1.0}}}},
            "smoothing.window = 1 s is longer than the record, 11 samples of 0.001 s.",
        ),
        ({"derivatives": 2}, "signals.log.derivatives: unknown key."),
        ({"extend": "stop", "start_time": -1.0}, "the record begins at 1 s, after the start of the run at 0 s"),
    ],
)
def test_a_record_that_cannot_serve(folder: Path, signal: dict[str, Any], text: str) -> None:
    found = problems(folder, signal, connections=[])
    assert any(text.format(folder=folder) in problem for problem in found), found


@pytest.mark.parametrize(
    ("connection", "text"),
    [
        ("log.forc -> a.u", "log has no column 'forc'. Did you mean 'force'?"),
        ("log.der(x,2) -> a.u", "no column 'der(x,2)'. Write derivatives = 2 and smoothing in signals.log.columns.x."),
        ("lg.force -> a.u", "no instance 'lg'. Did you mean 'log'?"),
        ("a.y -> log.force", "'log.force' is of causality output; the right end must be an input."),
        ("a.y -> log.f", "'log' is a record: nothing can be connected to it."),
        ("log.force -> m.u", "unit V does not match m."),
        ("log.x -> m.u", "unit mm does not match m. To convert, write"),
        ("log.force -> a.count_in", "an output of type Real cannot feed an input of type Integer"),
    ],
)
def test_connections_from_a_record_are_checked_as_any_other(folder: Path, connection: str, text: str) -> None:
    (problem,) = problems(folder, connections=[connection])
    assert text in problem


def test_all_problems_come_at_once(folder: Path) -> None:
    signals = {
        "log": {"file": "missing.csv"},
        "a": {"file": "log.csv"},
        "2nd": {"file": "log.csv"},
        "bad": {"file": "log.csv", "extend": "no"},
    }
    found = "\n".join(problems(folder, signals=signals, connections=["log.x -> a.v"]))
    for text in ("missing.csv: no such file", "signals.a: an instance has this name", "signals.2nd", "bad.extend"):
        assert text in found
    assert "Probe has no input 'v'" in found


# Sums and noise


@pytest.mark.parametrize(
    ("entry", "text"),
    [
        ({"from": [], "to": "a.u"}, "give both ends"),
        ({"from": ["a.y", 3], "to": "a.u"}, "give both ends"),
        ({"from": ["log.force", "a.y"], "to": "a.u", "factor": 2.0}, "a sum has a factor for each source"),
        ({"from": ["log.force", "a.y"], "to": "a.u", "factors": [1.0]}, "must be a list of 2 numbers"),
        ({"from": ["log.force", "a.y"], "to": "a.u", "factors": [1.0, "x"]}, '"x" is not a finite number'),
        ({"from": ["a.y", "a.y"], "to": "a.u"}, "'a.y' is in the sum 2 times."),
        ({"from": "a.y", "to": "a.u", "factors": [1.0]}, "belongs to a sum"),
        ({"from": ["log.force", "log.x"], "to": "a.u"}, "unit mm does not match V."),
        (
            {"from": ["a.count", "m.count"], "to": "a.count_in"},
            "sums and noise need an input of type Real, not Integer",
        ),
        ({"from": "a.y", "to": "a.u", "noise": 2e-9}, "must be a table: noise = { rms = 2e-9, seed = 1 }"),
        ({"from": "a.y", "to": "a.u", "noise": {"rms": 1.0}}, "seed missing"),
        ({"from": "a.y", "to": "a.u", "noise": {"rms": -1.0, "seed": 1}}, "noise.rms: -1 must not be negative"),
        ({"from": "a.y", "to": "a.u", "noise": {"rms": 1.0, "seed": 1.5}}, "noise.seed: 1.5: give a whole number"),
        ({"from": "a.y", "to": "a.u", "noise": {"rms": 1.0, "seed": -1}}, "noise.seed: -1: give a whole number"),
        ({"from": "a.y", "to": "a.u", "noise": {"rms": 1.0, "sed": 1}}, "unknown key. Did you mean 'seed'?"),
    ],
)
def test_sums_and_noise_that_cannot_be(folder: Path, entry: dict[str, Any], text: str) -> None:
    found = problems(folder, connections=[entry])
    assert any(text in problem for problem in found), found


@pytest.mark.parametrize(
    "entries",
    [
        ["log.force -> a.u", "a.y -> a.u"],
        [{"from": ["log.force", "a.y"], "to": "a.u"}, "a.y -> a.u"],
        ["a.y -> a.u", {"from": ["log.force", "a.y"], "to": "a.u"}],
    ],
)
def test_an_input_connected_twice_without_a_sum_is_a_problem(folder: Path, entries: list[Any]) -> None:
    (problem,) = problems(folder, connections=entries)
    assert "input 'a.u' is connected already" in problem
    assert "For their sum, write" in problem


def test_a_loop_through_an_addend_is_found(folder: Path) -> None:
    (problem,) = problems(folder, connections=[{"from": ["log.force", "a.z"], "to": "a.u"}])
    assert "algebraic loop" in problem


def test_the_same_seed_twice_is_noted(folder: Path) -> None:
    noisy = [{"from": "log.force", "to": f"{name}.u", "factor": 1, "noise": {"rms": 1.0, "seed": 3}} for name in "am"]
    notes = made(folder, connections=noisy).notes
    assert any("noise of the same seed as that of log.force -> a.u" in note for note in notes)
    noisy[0]["noise"] = {"rms": 1.0, "seed": 4}
    assert not any("seed" in note for note in made(folder, connections=noisy).notes)


# The record and the times of the run


@pytest.mark.parametrize(
    ("signal", "experiment", "text"),
    [
        ({}, {"stop_time": 0.02}, "the record ends at 0.01 s, before the end of the run at 0.02 s"),
        ({"start_time": -0.005}, {}, "the record begins at 0.005 s, after the start of the run at 0 s"),
        ({}, {"step_size": 0.002}, "the record has a sample every 0.001 s, the run a communication step every 0.002 s"),
    ],
)
def test_records_that_do_not_fit_the_run_are_noted(
    folder: Path, signal: dict[str, Any], experiment: dict[str, Any], text: str
) -> None:
    given = {"stop_time": 0.01, "step_size": 0.001, **experiment}
    notes = made(folder, signal, experiment=given).notes
    assert any(text in note for note in notes), notes
    if "step_size" not in experiment:
        assert not any(text in note for note in made(folder, {**signal, "extend": "hold"}, experiment=given).notes)


def test_a_record_whose_times_are_no_seconds_is_noted(folder: Path) -> None:
    lines = [f"{i},{i},{i}" for i in range(1001)]  # 1 kHz, in ms
    (folder / "log.csv").write_text("\n".join(["time,force,x", *lines]) + "\n", encoding="utf-8")
    run = {"stop_time": 1.0, "step_size": 0.001}
    short = "the record has a sample every 1 s, so the run of 1 s sees only 2 of its 1001 samples."
    assert any(short in note for note in made(folder, experiment=run).notes)
    assert not any("sees only" in note for note in made(folder, {"time_unit": "ms"}, experiment=run).notes)


@pytest.mark.parametrize(
    ("column", "text"),
    [
        (
            {"factor": 1.02, "unit": "m"},
            "factor = 1.02 is all that is done from mm to m; the units alone convert by fac",
        ),
        ({"factor": 1e-3, "unit": "m"}, ""),
        ({"factor": -0.001, "unit": "m"}, ""),
        ({"factor": 1.02, "unit": "mm"}, ""),
        ({"factor": 1.02, "unit": "V"}, ""),
        ({"unit": "m"}, ""),
    ],
)
def test_a_factor_on_a_column_that_its_units_do_not_explain_is_noted(
    folder: Path, column: dict[str, Any], text: str
) -> None:
    columns = {"force": {"column": "force", "factor": 2.0, "unit": "V"}, "x": {"column": "x", **column}}
    found = [note for note in made(folder, {"columns": columns}).notes if "all that is done" in note]
    assert len(found) == bool(text)
    assert all(text in note and note.endswith("write factor = 0.00102.") for note in found)


def test_the_advised_start_is_exact(folder: Path) -> None:
    lines = [f"{1700000123.4 + i / 8!r},{i},{i}" for i in range(9)]
    (folder / "log.csv").write_text("\n".join(["time,force,x", *lines]) + "\n", encoding="utf-8")
    (note,) = [n for n in made(folder, experiment={"stop_time": 1.0, "step_size": 0.125}).notes if "would begin" in n]
    assert "start_time = 1700000123.4 would begin with it" in note


def test_a_gap_in_the_record_is_noted(folder: Path) -> None:
    lines = LOG.splitlines()
    (folder / "log.csv").write_text("\n".join([*lines[:4], *lines[6:]]) + "\n", encoding="utf-8")
    (note,) = [note for note in made(folder).notes if "usual" in note]
    assert "1 of 8 steps of time are not the usual 0.001 s: the first is 0.003 s, from 0.002 s (row 3)" in note


@pytest.mark.parametrize(
    ("experiment", "steps"),
    [
        ({"stop_time": 1.0}, 10),
        ({}, 10),
        ({"stop_time": 0.005}, 5),
        ({"stop_time": 1.0, "step_size": "3/1000"}, 3),
        ({"start_time": 0.004, "stop_time": 1.0}, 6),
    ],
)
def test_a_record_ends_the_run(folder: Path, experiment: dict[str, Any], steps: int) -> None:
    system = made(folder, {"extend": "stop"}, experiment={"step_size": 0.001, **experiment})
    assert system.steps == steps
    told = [note for note in system.notes if "where the record ends, not at stop_time" in note]
    assert bool(told) == (experiment.get("stop_time") == 1.0)


def test_a_record_that_cannot_be_read_is_the_only_problem(folder: Path) -> None:
    (problem,) = problems(folder, {"file": "lg.csv", "extend": "stop"}, experiment={"step_size": 0.001}, connections=[])
    assert "no such file" in problem
    (problem,) = problems(folder, experiment={"step_size": 0.001})
    assert "experiment.stop_time: missing" in problem


def test_a_run_that_a_record_ends_has_whole_steps_of_every_instance(folder: Path) -> None:
    instances = {"a": {"fmu": "Probe", "step_multiple": 4}}
    system = made(folder, {"extend": "stop"}, experiment={"step_size": 0.001}, instances=instances)
    assert system.steps == 8


def test_the_record_may_begin_at_another_time_than_the_run(folder: Path) -> None:
    system = made(folder, {"extend": "stop", "start_time": 0.003}, experiment={"step_size": 0.001, "start_time": 5.0})
    assert (float(system.start_time), system.steps) == (5.0, 7)


# Digest, overrides, files that build on others, exports

SUM = {
    "from": ["log.force", "a.y"],
    "to": "a.u",
    "factors": [-1.0, 0.5],
    "offset": 0.25,
    "noise": {"rms": 1e-3, "seed": 7},
}


def full(folder: Path) -> System:
    columns = {
        "force": {"column": "force", "factor": 2.0, "unit": "V"},
        "x": {"column": "x", "derivatives": 1, "smoothing": {"window": 0.005, "polynomial": 2}},
    }
    connections = [SUM, {"from": "log.x", "to": "m.u", "units": "convert"}]
    record = {"variables": ["a.*", "log.der(x)"]}
    return made(folder, {"columns": columns, "extend": "repeat"}, connections=connections, record=record)


@pytest.mark.parametrize("form", ["s.toml", "s.ssp", "again.toml"])
def test_every_form_keeps_the_system(folder: Path, tmp_path_factory: pytest.TempPathFactory, form: str) -> None:
    system, target = full(folder), tmp_path_factory.mktemp("exported")
    if form == "s.ssp":
        path = write_ssp(system, target / form)
    elif form == "s.toml":
        path = write_system(system, target / form)
    else:
        path = write_system(read_system(write_ssp(system, target / "s.ssp")), target / form)
    (folder / "log.csv").unlink()
    read = read_system(path)
    assert read.digest == system.digest
    assert read.connections == system.connections
    assert read.record == system.record
    assert {n: v.tobytes() for n, v in read.signals[0].columns.items()} == {
        n: v.tobytes() for n, v in system.signals[0].columns.items()
    }


def test_an_export_holds_the_record_and_says_what_others_leave_out(folder: Path) -> None:
    system = full(folder)
    path = write_ssp(system, folder / "s.ssp")
    with zipfile.ZipFile(path) as package:
        assert package.read("resources/log.csv").decode() == LOG
    assert [lost.split(":")[1] for lost in lost_elsewhere(system)] == [
        " other tools leave a.u, m.u unconnected. The package holds the records as resources."
    ]
    quiet = made(folder, connections=[{"from": "a.y", "to": "m.u", "factor": 1, "noise": {"rms": 1.0, "seed": 1}}])
    assert lost_elsewhere(quiet) == ["noise is beyond SSP 1.0: other tools leave out that on m.u."]
    assert lost_elsewhere(made(folder, connections=["a.y -> a.u"], signals={})) == []


def test_the_export_command_tells_it(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_system(full(folder), folder / "s.toml")
    assert main(["export", str(path), "-o", str(folder / "s.ssp")]) == 0
    assert "other tools leave a.u, m.u unconnected" in capsys.readouterr().err.replace("\n", " ")


def test_the_digest_changes_with_the_record_and_with_how_it_is_read(folder: Path) -> None:
    digests = {
        made(folder).digest,
        made(folder, {"interpolation": "linear"}).digest,
        made(folder, {"start_time": 0.001, "extend": "hold"}).digest,
        made(folder, connections=[{"from": "log.force", "to": "a.u", "noise": {"rms": 1.0, "seed": 1}}]).digest,
        made(folder, connections=[{"from": "log.force", "to": "a.u", "noise": {"rms": 1.0, "seed": 2}}]).digest,
        made(folder, connections=[{"from": ["log.force", "a.y"], "to": "a.u"}]).digest,
    }
    before = made(folder).digest
    (folder / "log.csv").write_text(LOG.replace("10,5.0", "10,5.5"), encoding="utf-8")
    assert len(digests | {made(folder).digest}) == 7
    (folder / "log.csv").write_text(LOG, encoding="utf-8")
    assert made(folder).digest == before
    # Where a record lies makes no difference.
    (folder / "other.csv").write_text(LOG, encoding="utf-8")
    assert made(folder, {"file": "other.csv"}).digest == before


def test_signals_are_changed_by_name(folder: Path) -> None:
    (folder / "other.csv").write_text(LOG.replace("10,5.0", "10,7.0"), encoding="utf-8")
    system = made(folder).changed({"log.file": "other.csv", "log.columns.force.factor": 3.0, "a.gain": 2.0})
    assert system.signals[0].columns["force"][-1] == 21.0
    assert system.instance("a").start["gain"] == 2.0
    with pytest.raises(DescriptionError, match=r"signals\.log\.fil: unknown key\. Did you mean 'file'"):
        made(folder).changed({"log.fil": "other.csv"})


def test_signals_are_set_at_the_prompt_and_shown(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "other.csv").write_text(LOG, encoding="utf-8")
    path = write_toml(folder / "s.toml", document())
    arguments = ["check", str(path), "--fmus", str(folder), "--json", "--set", "log.file=other.csv"]
    assert main([*arguments, "--set", "log.interpolation=linear"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["signals"]["log"]["file"].endswith("other.csv")
    assert facts["signals"]["log"]["columns"] == {"force": "V", "x": "mm"}
    assert facts["problems"] == []


@pytest.mark.parametrize("signals", ['[signals.log]\ninterpolation = "linear"\n', ""])
def test_a_file_builds_on_one_with_signals(folder: Path, signals: str) -> None:
    write_toml(folder / "base.toml", document())
    (folder / "s.toml").write_text(f'base = "base.toml"\n{signals}', encoding="utf-8")
    system = read_system(folder / "s.toml", fmus=folder)
    assert system.signals[0].resampler.linear == bool(signals)
    assert system.signals[0].path == folder / "log.csv"


def test_the_example_of_the_page_is_a_system(native: Path, tmp_path: Path) -> None:
    page = (Path(__file__).parents[2] / "docs" / "systems.md").read_text(encoding="utf-8")
    stage, fed = (page.split(f"```{{file}} {name}.toml\n")[1].split("```")[0] for name in ("stage", "fed"))
    (tmp_path / "stage.toml").write_text(stage, encoding="utf-8")
    (tmp_path / "fed.toml").write_text(fed, encoding="utf-8")
    time = np.arange(200) * 1e-3
    rows = np.column_stack((time, 1e-3 * np.sin(10.0 * time), 0.1 * np.cos(time)))
    header = "t [s],position [mm],current [A]"
    np.savetxt(tmp_path / "stage.csv", rows, delimiter=",", header=header, comments="")
    system = read_system(tmp_path / "fed.toml", fmus=native)
    assert system.signals[0].outputs == ("x", "der(x)", "der(x,2)", "load")
    # The file says mm, the system m.
    assert system.signals[0].columns["x"] == pytest.approx(rows[:, 1] * 1e-3, rel=1e-12)
    assert not system.notes
