"""System files as editors write them, names as FMI allows them, values as people type them."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from decimal import Decimal
from pathlib import Path

import pytest
from conftest import Command
from fmu_files import PROBE, Variable, probe_library, write_fmu, write_probe

from cosim.commands.cli import main
from cosim.errors import DescriptionError
from cosim.fmu.places import find_fmu, find_fmus, find_system, fmus_in, shipped_studies, shipped_systems
from cosim.fmu.text import read_text, read_toml
from cosim.master.simulation import simulate
from cosim.result.summary import loops
from cosim.system.ssp_write import write_ssp
from cosim.system.system import make_system, read_system
from cosim.system.toml_write import write_system
from cosim.system.values import parse_settings, parse_value

SYSTEM = """
description = "Größe µm"
connections = ["a.y -> b.u"]
[experiment]
stop_time = 1.0
step_size = 0.1
[instances.a]
fmu = "./Probe.fmu"
[instances.b]
fmu = "./Probe.fmu"
"""


# Text


@pytest.mark.parametrize(
    "encode",
    [
        lambda text: b"\xef\xbb\xbf" + text.encode(),
        lambda text: text.encode("utf-16"),
        lambda text: b"\xfe\xff" + text.encode("utf-16-be"),
        lambda text: text.replace("\n", "\r\n").encode(),
        lambda text: text.replace("\n", "\r").encode(),
        lambda text: text.replace("\n", "\r\n").encode("utf-16"),
    ],
    ids=["BOM", "UTF-16", "UTF-16 BE", "CRLF", "CR", "UTF-16 CRLF"],
)
def test_text_of_other_editors_is_read(tmp_path: Path, encode: Callable[[str], bytes]) -> None:
    write_probe(tmp_path)
    (tmp_path / "s.toml").write_bytes(encode(SYSTEM))
    assert read_system(tmp_path / "s.toml").description == "Größe µm"


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (SYSTEM.encode("cp1252"), "line 2 is not UTF-8 text. Save the file as UTF-8."),
        (SYSTEM.encode("utf-16-le"), "is no text, or UTF-16 without a byte order mark. Save it as UTF-8."),
        (b"\xef\xbb\xbf\xff", "line 1 is not UTF-8-SIG text."),
    ],
)
def test_other_text_is_refused_with_the_line(tmp_path: Path, content: bytes, text: str) -> None:
    (tmp_path / "s.toml").write_bytes(content)
    with pytest.raises(DescriptionError, match=text.replace(".", r"\.")):
        read_system(tmp_path / "s.toml")


@pytest.mark.parametrize(
    ("content", "text"),
    [
        ("x = " + "9" * 5000, "not valid TOML: .*4300 digits"),
        ("x = 1e" + "9" * 30, "an exponent that is too large"),
        ("x = " + "[" * 3000 + "]" * 3000, "nested too deeply"),
        ('[a]\nfile = "a\\u0000b"', r"not valid TOML: 'a\\x00b' has the character U\+0000"),
        ('"a\\u0000" = [{b = 1}]', r"has the character U\+0000"),
    ],
)
def test_toml_that_no_reader_can_use_is_refused(tmp_path: Path, content: str, text: str) -> None:
    (tmp_path / "s.toml").write_text(content, encoding="utf-8")
    with pytest.raises(DescriptionError, match=rf"s\.toml: .*{text}"):
        read_toml(tmp_path / "s.toml")


def test_a_file_that_is_a_folder_is_said(tmp_path: Path) -> None:
    with pytest.raises(DescriptionError, match="cannot be read"):
        read_text(tmp_path)


# Names


ODD = ("in put", "out -> put", 'quo"te\\', "star*?", "a[b", "ümlaut", "-", "x=y", "k#1", "'")


@pytest.mark.parametrize("name", ODD)
@pytest.mark.parametrize("other", ["u", "plain -> arrow"])
def test_any_name_survives_every_form(tmp_path: Path, name: str, other: str) -> None:
    """Inputs, outputs and parameters of any name: run, exported as TOML and SSP, read again."""
    kinds = {"u": other, "z": name, "gain": f"{name} k"}
    variables = [replace(v, name=kinds[v.name]) for v in PROBE if v.name in kinds]
    variables = [v if not v.depends_on else replace(v, depends_on=(other,)) for v in variables]
    write_fmu(tmp_path / "Odd.fmu", variables, binary=probe_library().read_bytes())
    document = {
        "connections": [{"from": f"a.{name}", "to": f"b.{other}"}],
        "experiment": {"stop_time": 1, "step_size": 1},
        "instances": {
            "a": {"fmu": "./Odd.fmu", "start": {other: 2.0, f"{name} k": 3.0}},
            "b": {"fmu": "./Odd.fmu"},
        },
        "record": {"variables": [f"a.{name}", f"b.{name}"]},
    }
    system = make_system(document, folder=tmp_path)
    expected = simulate(system)
    assert expected[f"b.{name}"][-1] == 6.0
    packed = read_system(write_ssp(system, tmp_path / "s.ssp"))
    for read in (packed, read_system(write_system(packed, tmp_path / "s.toml"))):
        assert read.digest == system.digest
        assert simulate(read).rows.tolist() == expected.rows.tolist()


@pytest.mark.parametrize("name", ["a:b", "back\\slash", "tab\t", "what?*", "\udcfc", "a -> b = [1]", "100 %20"])
def test_fmu_files_of_any_name_are_exported(tmp_path: Path, name: str) -> None:
    path = write_probe(tmp_path).rename(tmp_path / f"{name}.fmu")
    document = {
        "experiment": {"stop_time": 1, "step_size": 1},
        "instances": {"a": {"fmu": str(path)}, "b": {"fmu": str(path)}},
    }
    system = make_system(document, folder=tmp_path)
    packed = read_system(write_ssp(system, tmp_path / "s.ssp"))
    for read in (packed, read_system(write_system(packed, tmp_path / "s.toml"))):
        assert read.digest == system.digest


def test_a_name_is_shown_as_it_is(tmp_path: Path, cosim: Command) -> None:
    """Even if it looks like an emoji or a style of the terminal library."""
    (tmp_path / "s.toml").write_text('[instances."a:b:"]\nfmu = "./P.fmu"\n[instances."x [red]"]\nfmu = "./P.fmu"\n')
    _, _, err = cosim("check", tmp_path / "s.toml")
    assert "instances.a:b:" in err
    assert "instances.x [red]" in err


def test_a_blank_may_stand_in_a_short_connection(tmp_path: Path) -> None:
    write_fmu(tmp_path / "P.fmu", [Variable("my y", "output", 0), Variable("my u", "input", 1, start="0")])
    document = {
        "connections": ["a.my y  ->  b.my u"],
        "experiment": {"stop_time": 1, "step_size": 1},
        "instances": {"a": {"fmu": "./P.fmu"}, "b": {"fmu": "./P.fmu"}},
    }
    assert make_system(document, folder=tmp_path).connections[0].target == ("b", "my u")
    document["connections"] = ["a.my y -> b.x -> y"]
    with pytest.raises(DescriptionError, match=r"more than one arrow.*write \{ from = "):
        make_system(document, folder=tmp_path)


def test_loops_are_found_behind_names_with_arrows() -> None:
    class Recording:
        names = ("t.a -> b", "p.x")

        @property
        def metadata(self) -> dict[str, list[str]]:
            return {"connections": ["t.a -> b -> c.position_ref", "p.x -> c.position"]}

        def unit(self, name: str) -> str:
            return "m"

    (loop,) = loops(Recording())  # type: ignore[arg-type]
    assert (loop.reference, loop.position) == ("t.a -> b", "p.x")


# Values


@pytest.mark.parametrize(
    ("text", "value"),
    [(".5", "0.5"), ("5.", "5"), ("+.5e-3", "0.0005"), ("-.25", "-0.25"), ("007", "7"), ("1E3", "1000"), ("0", "0")],
)
def test_numbers_as_people_type_them(text: str, value: str) -> None:
    assert parse_value(text) == Decimal(value)


@pytest.mark.parametrize("text", ["1e999999999999999999999", "9" * 5000, "[" * 3000])
def test_numbers_and_lists_beyond_every_measure_are_texts(tmp_path: Path, text: str) -> None:
    write_probe(tmp_path)
    (tmp_path / "s.toml").write_text(SYSTEM, encoding="utf-8")
    with pytest.raises(DescriptionError) as caught:
        read_system(tmp_path / "s.toml", parse_settings([f"a.time_constant={text}"]))
    assert len(str(caught.value)) < 400


def test_all_settings_that_are_wrong_come_at_once() -> None:
    with pytest.raises(DescriptionError) as caught:
        parse_settings(["a.k", "=5", "a.k=", "a.m = 2"])
    assert len(caught.value.problems) == 3
    assert parse_settings(["a.k=.5", "a.name=x=y"]) == {"a.k": Decimal("0.5"), "a.name": "x=y"}


def test_a_decimal_comma_is_told(tmp_path: Path) -> None:
    write_probe(tmp_path)
    (tmp_path / "s.toml").write_text(SYSTEM, encoding="utf-8")
    with pytest.raises(DescriptionError, match=r'"0,5" is not a number\. Write it with a point\. The unit is s\.'):
        read_system(tmp_path / "s.toml", parse_settings(["a.time_constant=0,5"]))


@pytest.mark.parametrize(
    ("text", "seconds"), [("250 ms", 0.25), ("2us", 2e-6), ("1e-3 min", 0.06), ("0.5 s", 0.5), ("+.5e1 s", 5.0)]
)
def test_a_start_value_may_have_a_unit(tmp_path: Path, text: str, seconds: float) -> None:
    write_probe(tmp_path)
    (tmp_path / "s.toml").write_text(SYSTEM, encoding="utf-8")
    system = read_system(tmp_path / "s.toml", parse_settings([f"a.time_constant={text}"]))
    assert system.instance("a").start["time_constant"] == seconds
    assert read_system(tmp_path / "s.toml").changed({"a.time_constant": text}).instance("a").start == {
        **system.instance("a").start
    }


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("5 mm", "'mm' cannot be converted. The unit is s."),
        ("5 sec", "unknown symbol 'sec'. Did you mean 's'?"),
        ("5 Ns/N", "unknown symbol 'Ns'. Did you mean 'N.s/N'?"),
        ("5 N*s/N", "cannot read '*s/N'. Did you mean 'N.s/N'?"),
        ("5 µs", "cannot read 'µs'. Did you mean 'us'?"),
        ("-1 ms", "-0.001 s is below its minimum 1e-06 s."),
        ('"5"', '"5" is not a number. Write it without quotes.'),
    ],
)
def test_a_unit_that_does_not_fit_is_told(tmp_path: Path, text: str, problem: str) -> None:
    write_probe(tmp_path)
    (tmp_path / "s.toml").write_text(SYSTEM, encoding="utf-8")
    with pytest.raises(DescriptionError) as caught:
        read_system(tmp_path / "s.toml", parse_settings([f"a.time_constant={text}"]))
    assert problem in str(caught.value)


def test_a_stop_time_of_zero_counts(tmp_path: Path) -> None:
    write_probe(tmp_path)
    text = SYSTEM.replace("stop_time", "start_time = -1.0\nstop_time")
    (tmp_path / "s.toml").write_text(text, encoding="utf-8")
    for stop in ("0", 0, 0.0, Decimal(0)):
        assert read_system(tmp_path / "s.toml", stop_time=stop).steps == 10


# Where things are found


@pytest.mark.parametrize("fmu", ["~/models/Probe.fmu", "models\\Probe.fmu", ".\\models\\Probe.fmu"])
def test_paths_with_a_home_folder_or_of_windows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fmu: str) -> None:
    (tmp_path / "models").mkdir()
    write_probe(tmp_path / "models")
    monkeypatch.setenv("HOME" if os.name == "posix" else "USERPROFILE", str(tmp_path))
    (tmp_path / "models" / "log.csv").write_text("t,x\n0,1\n1,2\n", encoding="utf-8")
    text = SYSTEM.replace("./Probe.fmu", fmu).replace('"a.y -> b.u"', '"a.y -> b.u", "log.x -> a.u"')
    text = text.replace('"./', "'./").replace(f'"{fmu}"', f"'{fmu}'")
    log = fmu.replace("Probe.fmu", "log.csv")
    (tmp_path / "s.toml").write_text(f"{text}\n[signals.log]\nfile = '{log}'\n", encoding="utf-8")
    assert read_system(tmp_path / "s.toml").instances[0].fmu.path == (tmp_path / "models" / "Probe.fmu").resolve()
    assert main(["check", f"--fmus={tmp_path}", str(tmp_path / "s.toml")]) == 0


def test_the_home_folder_is_known_behind_the_name_of_an_option(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME" if os.name == "posix" else "USERPROFILE", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    assert main(["run", str(write_probe(tmp_path)), "--stop-time=1", "--output=~/run.csv"]) == 0
    assert (tmp_path / "run.csv").is_file()
    assert not (tmp_path / "~").exists()


@pytest.mark.parametrize("fmu", ["./probe.fmu", "./Probe", "./Prob.FMU"])
def test_a_missing_file_is_told_with_the_nearest(tmp_path: Path, fmu: str) -> None:
    write_probe(tmp_path)
    (tmp_path / "s.toml").write_text(SYSTEM.replace("./Probe.fmu", fmu), encoding="utf-8")
    with pytest.raises(DescriptionError, match=r"no such file\. (Did you mean|Known:) .?Probe\.fmu"):
        read_system(tmp_path / "s.toml")


def test_endings_in_capitals(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_probe(tmp_path).rename(tmp_path / "Probe.FMU")
    (tmp_path / "s.TOML").write_text(SYSTEM.replace('"./Probe.fmu"', '"Probe.FMU"'), encoding="utf-8")
    system = read_system(tmp_path / "s.TOML")
    write_ssp(system, tmp_path / "s.SSP")
    assert read_system(tmp_path / "s.SSP").digest == system.digest
    assert list(fmus_in(tmp_path)) == ["Probe"]
    assert find_fmu("Probe", tmp_path) == tmp_path / "Probe.FMU"
    monkeypatch.chdir(tmp_path)
    assert simulate(system).save("out.CSV").read_text().startswith('"time"')


def test_fmus_of_the_checkout_are_found_from_everywhere(
    tmp_path: Path, native: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("cosim.fmu.places.PREBUILT", tmp_path / "none")
    assert find_fmus() == find_fmus(tmp_path) == native
    assert find_fmu("Trajectory") == native / "Trajectory.fmu"
    assert find_system("Trajectory") == native / "Trajectory.fmu"
    monkeypatch.setattr("cosim.fmu.places.PREBUILT", tmp_path)
    assert find_fmus() == tmp_path
    own = tmp_path / "build" / "fmus" / "native"
    own.mkdir(parents=True)
    assert find_fmus() == own


def test_names_that_are_nothing(tmp_path: Path, native: Path) -> None:
    with pytest.raises(DescriptionError, match=r"Trajctory: no such file, system or FMU\. Did you mean 'Trajectory'"):
        find_system("Trajctory", native)
    with pytest.raises(DescriptionError, match="Did you mean 'shams2010/fsmc_5sin'"):
        find_system("shams2010/fsmc_5sn", native)


def test_what_is_shipped() -> None:
    assert "ranking" in shipped_studies()
    assert "feng2015/learned" not in shipped_systems()
    assert "shams2010/fsmc_5sin" in shipped_systems()


def test_a_base_may_be_a_shipped_system(tmp_path: Path, native: Path) -> None:
    for base in ("shams2010/fsmc_5sin", "shams2010/fsmc_5sin.toml", "studies/shams2010/fsmc_5sin.toml"):
        (tmp_path / "mine.toml").write_text(f'base = "{base}"\n[instances.plant.start]\nm = 70\n', encoding="utf-8")
        system = read_system(tmp_path / "mine.toml", fmus=native)
        assert system.instance("plant").start["m"] == 70.0
        assert len(system.connections) == 6
    (tmp_path / "mine.toml").write_text('base = "shams2010/fsmc_5sn"\n', encoding="utf-8")
    with pytest.raises(DescriptionError, match=r"base: .*Did you mean 'shams2010/fsmc_5sin'"):
        read_system(tmp_path / "mine.toml")
