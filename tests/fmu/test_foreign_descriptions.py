"""FMUs whose files break a rule: shown, told, and run where the facts are there that a run needs."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmu_files import PROBE, description, library_name, probe_library, write_fmu, write_probe, write_zip

from cosim import DescriptionError, make_system, simulate
from cosim.commands.cli import main
from cosim.fmu.description import read_fmu
from cosim.record.description import Column
from cosim.result.result import Result

Change = Callable[[str], str]


def replaced(old: str, new: str) -> Change:
    def change(text: str) -> str:
        assert old in text
        return text.replace(old, new, 1)

    return change


def document(path: Path, **start: Any) -> dict[str, Any]:
    return {
        "instances": {"a": {"fmu": str(path), "start": {"u": 1.0, **start}}},
        "experiment": {"stop_time": 1.0, "step_size": 0.1},
        "record": {"variables": ["a.y", "a.count", "a.flag"]},
    }


def variable(name: str, change: str) -> Change:
    """Another tail of the ScalarVariable element of ``name``."""

    def changed(text: str) -> str:
        begin = text.index(f'name="{name}"')
        end = text.index("</ScalarVariable>", begin)
        old = text[begin:end]
        new = change if change.startswith("name=") else old.replace(*change.split(" => "))
        assert new != old
        return text[:begin] + new + text[end:]

    return changed


VOLT = '<Unit name="V"></Unit>'
UNDECLARED = 'variability="discrete"> => >'

BROKEN: dict[str, tuple[Change, str]] = {
    "version 2.0.4": (replaced('fmiVersion="2.0"', 'fmiVersion="2.0.4"'), 'fmiVersion is "2.0.4"'),
    "version 2.0.1": (replaced('fmiVersion="2.0"', 'fmiVersion="2.0.1"'), 'fmiVersion is "2.0.1"'),
    "version 2": (replaced('fmiVersion="2.0"', 'fmiVersion="2"'), 'fmiVersion is "2"'),
    "version with blanks": (replaced('fmiVersion="2.0"', 'fmiVersion=" 2.0"'), 'fmiVersion is " 2.0"'),
    "blank line at the start": (lambda text: f"\n{text}", "begins with blanks, which XML does not allow. Left out."),
    "version 2.0-x": (replaced('fmiVersion="2.0"', 'fmiVersion="2.0.5-dev"'), 'fmiVersion is "2.0.5-dev"'),
    "Integer input without variability": (variable("count_in", UNDECLARED), "Read as discrete."),
    "Boolean input without variability": (variable("flag_in", UNDECLARED), "Read as discrete."),
    "Integer output without variability": (variable("count", UNDECLARED), "Read as discrete."),
    "Integer parameter without variability": (
        variable("fail_status", 'variability="fixed"> => >'),
        "variable 'fail_status' has no variability, which means continuous, and is no such parameter. Read as fixed.",
    ),
    "String parameter without variability": (variable("label", 'variability="fixed"> => >'), "Read as fixed."),
    "unit not defined": (replaced(VOLT, ""), 'The unit "V" of variable "u"'),
    "unit of a parameter not defined": (
        replaced('<Unit name="s"></Unit>', ""),
        'The unit "s" of variable "time_constant"',
    ),
    "display unit of a unit not defined": (
        lambda text: variable("y", '<Real unit => <Real displayUnit="kV" unit')(replaced(VOLT, "")(text)),
        "FMPy cannot validate it",
    ),
    "parameter without start": (variable("gain", ' start="1.0" => '), 'Variable "gain" (line 2) has no start value.'),
    "Integer parameter without start": (variable("sleep", ' start="0" => '), 'Variable "sleep" (line 2) has no start'),
    "input without start": (variable("count_in", ' start="0" => '), 'Variable "count_in" (line 2) has no start value.'),
    "start that is no number": (variable("gain", 'start="1.0" => start="one"'), "start is 'one', which is no number"),
    "bound that is no number": (
        variable("time_constant", 'min="1e-6" => min="small"'),
        "variable 'time_constant': min is 'small', which is no number of its type. Left out.",
    ),
    "type not defined": (
        variable("gain", '<Real  => <Real declaredType="Gain" '),
        "variable 'gain': its declaredType 'Gain' is not defined. Left out.",
    ),
    "output that is not there": (
        replaced("<Outputs>", '<Outputs><Unknown index="99"/>'),
        "ModelStructure: there is no variable of index 99. Left out.",
    ),
    "dependency that is not there": (
        replaced('<Unknown index="3" dependencies="1"/>', '<Unknown index="3" dependencies="99"/>'),
        "the unknown of index 3 depends on a variable that is not there",
    ),
    "derivative that is not there": (
        variable("y", '<Real unit => <Real derivative="99" unit'),
        "variable 'y' is the derivative of a variable of index 99, which is not there. Left out.",
    ),
    "element that no schema knows": (replaced("<LogCategories>", "<Vendor/><LogCategories>"), "Vendor"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_a_broken_rule_is_told_and_the_fmu_runs(tmp_path: Path, case: str, capsys: pytest.CaptureFixture[str]) -> None:
    change, said = BROKEN[case]
    members = {"modelDescription.xml": change(description(PROBE)), library_name(): probe_library().read_bytes()}
    path = write_zip(tmp_path / "Probe.fmu", members)
    assert any(said in finding for finding in read_fmu(path).findings)
    system = make_system(document(path), name="broken")
    assert any("Probe.fmu: " in note for note in system.notes)
    whole = make_system(document(write_probe(tmp_path, "Whole")), name="whole")
    assert np.array_equal(simulate(system).rows, simulate(whole).rows)
    assert main(["info", str(path)]) == 0
    assert "time_constant" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("declared", "encoding", "told"),
    [
        ("UTF-8", "cp1252", ["line 2 is not UTF-8 text. Read as Windows-1252."]),
        ("", "latin-1", ["line 2 is not UTF-8 text. Read as Windows-1252."]),
        ("ISO-8859-1", "latin-1", []),
        ("Windows-1252", "cp1252", []),
        ("UTF-16", "utf-16", []),
        ("UTF-8", "utf-8-sig", []),
    ],
)
def test_descriptions_in_any_encoding(tmp_path: Path, declared: str, encoding: str, told: list[str]) -> None:
    said = f' encoding="{declared}"' if declared else ""
    text = description(PROBE).replace(' encoding="UTF-8"', said).replace('modelName="Probe"', 'modelName="Größe in µm"')
    members = {"modelDescription.xml": text.encode(encoding), library_name(): probe_library().read_bytes()}
    path = write_zip(tmp_path / "Probe.fmu", members)
    fmu = read_fmu(path)
    assert (fmu.name, list(fmu.findings)) == ("Größe in µm", told)
    assert simulate(make_system(document(path), name="encoded")).rows.shape == (11, 3)


@pytest.mark.parametrize("name", ["Probe/modelDescription.xml", "ModelDescription.xml"])
def test_a_description_of_another_name_or_place_is_told(tmp_path: Path, name: str) -> None:
    path = write_zip(tmp_path / "Probe.fmu", {name: description(PROBE)})
    with pytest.raises(DescriptionError, match=rf"no modelDescription\.xml inside\. It has {name}: zip the content"):
        read_fmu(path)


def test_a_description_without_variables_is_told(tmp_path: Path) -> None:
    text = re.sub("<ModelVariables>.*</ModelVariables>", "", description(PROBE))
    with pytest.raises(DescriptionError, match=r"modelDescription\.xml: has no ModelVariables"):
        read_fmu(write_zip(tmp_path / "Probe.fmu", {"modelDescription.xml": text}))


def test_variables_of_one_name_are_left_out(tmp_path: Path) -> None:
    text = description(PROBE).replace('name="z"', 'name="clock"')
    members = {"modelDescription.xml": text, library_name(): probe_library().read_bytes()}
    path = write_zip(tmp_path / "Probe.fmu", members)
    fmu = read_fmu(path)
    assert "more than one variable has the name 'clock'. Left out." in fmu.findings
    assert fmu.outputs == ("y", "count", "flag")
    assert simulate(make_system(document(path), name="twice")).rows.shape == (11, 3)


def test_backslashes_between_the_names_of_folders(tmp_path: Path) -> None:
    path = tmp_path / "Probe.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in {
            "modelDescription.xml": description(PROBE).encode(),
            library_name(): probe_library().read_bytes(),
            "resources/": b"",
        }.items():
            member = zipfile.ZipInfo()
            member.filename = name.replace("/", "\\")  # the constructor would write slashes on Windows
            archive.writestr(member, content)
    assert simulate(make_system(document(path), name="backslashes")).rows.shape == (11, 3)


@pytest.mark.parametrize("form", ["./{}", ".//{}", "{}", ".\\{}"])
def test_names_of_members_with_dots_and_empty_parts(tmp_path: Path, form: str) -> None:
    """As ``zip -r x.fmu .`` of some programs writes them, with an entry for the folder itself."""
    path = tmp_path / "Probe.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("./", b"")
        archive.writestr(form.format("modelDescription.xml"), description(PROBE))
        archive.writestr(form.format(library_name().replace("/", "//")), probe_library().read_bytes())
    assert simulate(make_system(document(path), name="dots")).rows.shape == (11, 3)


def test_a_member_that_is_a_file_and_a_folder_is_refused(tmp_path: Path) -> None:
    members = {"modelDescription.xml": description(PROBE), library_name(): probe_library().read_bytes()}
    path = write_zip(tmp_path / "Probe.fmu", {**members, "resources/a": b"1", "resources/a/b": b"2"})
    with pytest.raises(DescriptionError, match=r"'resources/a' is a file, but other members lie in a folder of this"):
        read_fmu(path)


def test_a_right_file_has_no_findings(tmp_path: Path) -> None:
    fmu = read_fmu(write_probe(tmp_path))
    assert (fmu.findings, fmu.obstacles) == ((), ())


@pytest.mark.parametrize("identifier", ["watertank-c", "model.v2", "3d"])
def test_an_identifier_that_c_does_not_know_runs(tmp_path: Path, identifier: str) -> None:
    path = write_fmu(tmp_path / "Probe.fmu", PROBE, binary=probe_library().read_bytes(), identifier=identifier)
    assert f"modelIdentifier {identifier!r} is not a C identifier." in read_fmu(path).findings
    assert simulate(make_system(document(path), name="named")).rows.shape == (11, 3)


@pytest.mark.parametrize("identifier", ["../probe", "/tmp/probe", "..", ""])
def test_an_identifier_leads_nowhere_else(tmp_path: Path, identifier: str) -> None:
    text = description(PROBE, identifier=identifier)
    path = write_zip(tmp_path / "Probe.fmu", {"modelDescription.xml": text, library_name(): b""})
    assert read_fmu(path).library is None


@pytest.mark.parametrize("name", ["other", "probe_x64", "Probe"])
def test_a_binary_of_another_name_is_told(tmp_path: Path, name: str) -> None:
    path = write_zip(
        tmp_path / "Probe.fmu",
        {"modelDescription.xml": description(PROBE), library_name(name): probe_library().read_bytes()},
    )
    with pytest.raises(DescriptionError) as caught:
        make_system(document(path), name="other")
    wanted = library_name().rpartition("/")[2]
    said = (
        f"the binary for this platform is {library_name(name)}, but by the modelIdentifier it must be called {wanted}."
    )
    assert said in str(caught.value)


@pytest.mark.parametrize("member", ["resources/table.txt", "documentation/index.html", "sources/model.c"])
@pytest.mark.parametrize("same", [False, True])
def test_a_member_that_is_there_twice(tmp_path: Path, member: str, same: bool) -> None:
    path = write_probe(tmp_path)
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr(member, "one")
        with pytest.warns(UserWarning, match="Duplicate name"):
            archive.writestr(member, "one" if same else "two")
    told = f"'{member}' is in the archive more than once, with different content. The last counts."
    expected = () if same else (told,)
    fmu = read_fmu(path)
    assert fmu.findings == expected
    folder = tmp_path / "there"
    fmu.extract(folder)
    if member.startswith("resources/"):
        assert (folder / member).read_text(encoding="utf-8") == ("one" if same else "two")


@pytest.mark.parametrize("members", [{}, {"resources/": b""}, {"resources/inner/": b""}])
def test_the_folder_of_resources_is_there(tmp_path: Path, members: dict[str, bytes]) -> None:
    text = description(PROBE)
    path = write_zip(tmp_path / "Probe.fmu", {"modelDescription.xml": text, library_name(): b"", **members})
    folder = tmp_path / "there"
    read_fmu(path).extract(folder)
    assert (folder / "resources").is_dir()
    assert all((folder / name).is_dir() for name in members)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            '<fmiModelDescription fmiVersion="1.0" modelName="Old" modelIdentifier="old" guid="g" '
            'numberOfContinuousStates="0" numberOfEventIndicators="0"><ModelVariables>'
            '<ScalarVariable name="time_constant" valueReference="0"><Real/></ScalarVariable>'
            "</ModelVariables></fmiModelDescription>",
            "cannot run here: FMI 1.0.",
        ),
        (
            description(PROBE)
            .replace("<CoSimulation ", "<ModelExchange ")
            .replace('canHandleVariableCommunicationStepSize="true"', ""),
            "cannot run here: only for model exchange.",
        ),
        (description(PROBE), "cannot run here: no binary for this platform"),
    ],
)
def test_info_shows_what_cannot_run(tmp_path: Path, text: str, said: str, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_zip(tmp_path / "Shown.fmu", {"modelDescription.xml": text})
    assert main(["info", str(path)]) == 0
    shown = capsys.readouterr()
    assert "time_constant" in shown.out
    assert said in " ".join(shown.err.split())
    assert main(["run", str(path), "--stop-time", "1", "--step-size", "0.1"]) == 2


@pytest.mark.parametrize(
    ("experiment", "left_out", "said"),
    [
        ('tolerance="2"', "tolerance", "tolerance is 2; a relative tolerance lies between 0 and 1. Left out."),
        ('tolerance="1"', "tolerance", "tolerance is 1; a relative tolerance lies between 0 and 1. Left out."),
        ('tolerance="-1e-6"', "tolerance", "tolerance is -1e-06; a relative tolerance lies between 0 and 1. Left out."),
        ('tolerance="0"', "tolerance", "tolerance is 0; a relative tolerance lies between 0 and 1. Left out."),
        ('tolerance="NaN"', "tolerance", "tolerance is 'NaN', which is no finite number. Left out."),
        ('startTime="2" stopTime="1"', "stop_time", "stopTime is 1 s, before startTime = 2 s. Left out."),
        ('stopTime="-1"', "stop_time", "stopTime is -1 s, before startTime = 0 s. Left out."),
        ('stopTime="INF"', "stop_time", "stopTime is 'INF', which is no finite number. Left out."),
        ('startTime="NaN" stopTime="1"', "start_time", "startTime is 'NaN', which is no finite number. Left out."),
        ('stopTime="1" stepSize="0"', "step_size", "stepSize is 0 s; a step is longer than 0 s. Left out."),
        ('stepSize="-0.1"', "step_size", "stepSize is -0.1 s; a step is longer than 0 s. Left out."),
        ('stopTime="1" stepSize="2"', "step_size", "stepSize is 2 s, longer than the experiment of 1 s. Left out."),
        ('stepSize="NaN"', "step_size", "stepSize is 'NaN', which is no finite number. Left out."),
    ],
)
def test_an_experiment_that_cannot_be_meant_is_told(
    tmp_path: Path, experiment: str, left_out: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "Probe.fmu"
    library = probe_library().read_bytes()
    write_zip(path, {"modelDescription.xml": description(PROBE, experiment=experiment), library_name(): library})
    fmu = read_fmu(path)
    assert getattr(fmu, left_out) is None
    assert [text for text in fmu.findings if text.startswith("DefaultExperiment")] == [f"DefaultExperiment: {said}"]
    main(["info", str(path)])
    assert f"DefaultExperiment: {said}" in " ".join(capsys.readouterr().err.split())
    make_system(document(path), name="told")


@pytest.mark.parametrize(
    "experiment",
    ['startTime="-2" stopTime="-1" stepSize="1" tolerance="1e-9"', 'stopTime="0"', 'stepSize="5"', 'tolerance="0.5"'],
)
def test_an_experiment_that_can_be_meant_is_no_finding(tmp_path: Path, experiment: str) -> None:
    path = write_zip(tmp_path / "P.fmu", {"modelDescription.xml": description(PROBE, experiment=experiment)})
    assert read_fmu(path).findings == ()


FMI_3 = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="Car" instantiationToken="car">
<CoSimulation modelIdentifier="probe3"/>
<UnitDefinitions><Unit name="l/m"><BaseUnit m="2" factor="0.001"/>
<DisplayUnit name="km/l" factor="0.001" {attributes}/><DisplayUnit name="l/100km" factor="1e5"/></Unit>
</UnitDefinitions>
<ModelVariables><Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>
<Float64 name="use" valueReference="1" causality="output" unit="l/m" displayUnit="{shown}"/></ModelVariables>
<ModelStructure><Output valueReference="1"/></ModelStructure></fmiModelDescription>"""


@pytest.mark.parametrize(
    ("attributes", "shown", "expected", "findings"),
    [
        ('inverse="true"', "km/l", 12.5, []),
        ('inverse="1"', "km/l", 12.5, []),
        ('inverse="true" offset="0.0"', "km/l", 12.5, []),
        ('inverse="true" offset="3"', "km/l", 12.5, ["display unit 'km/l' is inverse and has an offset."]),
        ('inverse="true"', "l/100km", 8.0, []),
        ('inverse="false" offset="3"', "km/l", 0.001 * 8e-5 + 3.0, []),
    ],
)
def test_inverse_display_units(
    tmp_path: Path, attributes: str, shown: str, expected: float, findings: list[str]
) -> None:
    """FMI 3.0, 2.4.3: factor*v + offset, or factor/v for an inverse display unit."""
    text = FMI_3.format(attributes=attributes, shown=shown)
    fmu = read_fmu(write_zip(tmp_path / "Car.fmu", {"modelDescription.xml": text}))
    assert [finding.partition(". ")[0] + "." for finding in fmu.findings] == findings
    display = fmu.variables["use"].display_unit
    assert display is not None
    column = Column("car.use", "l/m", "", display.name, display.factor, display.offset, display.inverse)
    result = Result(np.array([0.0, 1.0]), np.array([[8e-5], [0.0]]), (column,), False, (), 0, {}, {})
    assert result.displayed("car.use")[0] == pytest.approx(expected, rel=1e-14)
    assert np.isfinite(result.displayed("car.use")[1]) != display.inverse
