"""Reference results of FMUs replayed: FMUs of foreign make, right, wrong, damaged and hostile."""

from __future__ import annotations

import json
import math
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from fmu_files import PROBE, Variable, description, library_name, probe_library, write_fmu, write_zip

from cosim.commands.cli import main
from cosim.errors import DescriptionError
from cosim.reference import fmi_ls_ref as lsref
from cosim.reference import replay as module
from cosim.reference.fmi_ls_ref import ReferenceExperiment, Related, Tolerance
from cosim.reference.jobs import Job
from cosim.reference.replay import verify

STEP = 0.125
ROWS = 9
INPUTS = [0.0, 1.0, 1.0, -2.0, 0.5, 0.5, 3.0, 0.0, 1.0]
FORMER = """<Experiments name="smoke"><Experiment name="lag" startTime="0" stopTime="1" stepSize="0.125">
<Parameters source="gain.ssv"/><Stimuli source="in.csv"/><References source="out.csv"/></Experiment></Experiments>"""
"""An experiments file of the earlier draft."""


def response(gain: float = 2.0, sense: float = 1.0) -> list[tuple[float, float]]:
    """State and feedthrough of the probe at each row, in closed form: outputs read before new inputs are set."""
    y, rows = 0.0, [(0.0, sense * gain * INPUTS[0])]
    for u in INPUTS[:-1]:
        end = sense * gain * u
        y = end + (y - end) * math.exp(-STEP / 0.1)
        rows.append((y, end))
    return rows


def table(names: tuple[str, ...], rows: list[tuple[float, ...]], step: float = STEP) -> bytes:
    return lsref.write_csv(names, [[repr(k * step), *map(repr, row)] for k, row in enumerate(rows)])


def parameters(inner: str) -> str:
    return (
        '<ssv:ParameterSet xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues" version="1.0" '
        f'name="start"><ssv:Parameters>{inner}</ssv:Parameters></ssv:ParameterSet>'
    )


GAIN = parameters('<ssv:Parameter name="gain"><ssv:Real value="2.0"/></ssv:Parameter>')
EXPERIMENT = ReferenceExperiment(
    "lag",
    "A lag",
    start_time=0.0,
    stop_time=1.0,
    step_size=STEP,
    parameters="gain.ssv",
    stimuli="in.csv",
    references="out.csv",
    held=True,
    tolerances={"y": Tolerance(0.0, 1e-9), "z": Tolerance(1e-12, 0.0)},
)
RELATED = (
    Related("e.exp", "experiment/validation", lsref.EXPERIMENTS_TYPE),
    Related("gain.ssv", "parameter", lsref.SSV_TYPE),
    Related("in.csv", "other", lsref.CSV_TYPE),
    Related("out.csv", "result", lsref.CSV_TYPE),
)
GOOD: dict[str, bytes | str] = {
    lsref.MANIFEST: lsref.write_manifest(RELATED),
    "e.exp": lsref.write_experiments("probe", "", [EXPERIMENT]),
    "gain.ssv": GAIN,
    "in.csv": table(("u",), [(u,) for u in INPUTS]),
    "out.csv": table(("y", "z"), list(response())),
}


def probe(folder: Path, files: Mapping[str, bytes | str | None], library: str = "probe", name: str = "Probe") -> Path:
    """The probe with reference files; None leaves out one of ``GOOD``."""
    members: dict[str, bytes | str] = {
        "modelDescription.xml": description(PROBE, name=name),
        library_name(): probe_library(library).read_bytes(),
    }
    for file, content in {**GOOD, **files}.items():
        if content is not None:
            members[f"{lsref.FOLDER}/{file}"] = content
    return write_zip(folder / f"{name}.fmu", members)


def only_results(source: str = "Probe_out.csv") -> bytes:
    return lsref.write_manifest([Related(source, "result", lsref.CSV_TYPE, "Output of the default experiment")])


def test_an_experiment_with_parameters_stimuli_and_tolerances_is_replayed(tmp_path: Path) -> None:
    report = verify(probe(tmp_path, {}))
    assert report.code == 0
    assert report.problems == ()
    (outcome,) = report.outcomes
    assert (outcome.rows, [signal.name for signal in outcome.signals]) == (ROWS, ["y", "z"])
    y, z = outcome.signals
    assert (y.unit, y.stated) == ("V", True)
    assert y.largest < 1e-12
    assert y.limit == pytest.approx(1e-9 * max(abs(row[0]) for row in response()))
    assert z.limit == 1e-12


def test_times_as_attributes_are_read_and_the_default_tolerance_holds(tmp_path: Path) -> None:
    report = verify(probe(tmp_path, {"e.exp": FORMER}), tolerance=1e-6)
    (outcome,) = report.outcomes
    assert report.code == 0
    assert [signal.stated for signal in outcome.signals] == [False, False]
    assert outcome.signals[1].limit == pytest.approx(1e-6 * 6.0)


def test_held_stimuli_stay_between_rows_and_others_are_interpolated(tmp_path: Path) -> None:
    # rows twice as far apart as steps: a held input is that of the row before, another one the mean of both
    experiment = ReferenceExperiment("half", step_size=STEP / 2, stop_time=1.0, stimuli="in.csv", references="out.csv")
    for held, middle in ((True, 0.0), (False, 0.5)):
        changed = ReferenceExperiment(**{**experiment.__dict__, "held": held})
        files: dict[str, bytes | str | None] = {
            "e.exp": lsref.write_experiments("probe", "", [changed]),
            "out.csv": lsref.write_csv(("z",), [["0", "0"], [repr(STEP), repr(middle)]]),
        }
        report = verify(probe(tmp_path, files))
        assert report.code == 0, report.outcomes[0].signals[0].replay


def test_a_foreign_fmu_with_a_result_file_only_runs_its_default_experiment(tmp_path: Path) -> None:
    plain: dict[str, bytes | str | None] = {
        **dict.fromkeys(GOOD),
        lsref.MANIFEST: only_results(),
        "Probe_out.csv": table(("y", "z"), list(response(gain=1.0))),
        "Probe_in.csv": GOOD["in.csv"],
    }
    report = verify(probe(tmp_path, plain))
    assert (report.code, report.outcomes[0].experiment.name) == (0, "default")
    assert len(report.outcomes[0].signals) == 2


def test_a_wrong_trace_is_found_with_signal_and_time(tmp_path: Path) -> None:
    rows = response()
    rows[5] = (rows[5][0] + 0.01, rows[5][1])
    report = verify(probe(tmp_path, {"out.csv": table(("y", "z"), list(rows))}))
    worst = report.outcomes[0].worst
    assert worst is not None
    assert (report.code, worst.name, worst.at) == (1, "y", 5 * STEP)
    assert worst.largest == pytest.approx(0.01)
    assert [signal.within for signal in report.outcomes[0].signals] == [False, True]


def test_other_parameters_and_other_stimuli_are_found(tmp_path: Path) -> None:
    assert verify(probe(tmp_path, {"gain.ssv": GAIN.replace("2.0", "2.001")})).code == 1
    late = table(("u",), [(u,) for u in [0.0, *INPUTS[:-1]]])
    assert verify(probe(tmp_path, {"in.csv": late})).code == 1


@pytest.mark.parametrize(
    ("files", "said"),
    [
        (dict.fromkeys(GOOD), "no reference results"),
        ({lsref.MANIFEST: None}, "no reference results"),
        ({lsref.MANIFEST: "<fmiReferences"}, "not valid XML"),
        ({lsref.MANIFEST: "<other/>"}, "root element is 'other'"),
        ({lsref.MANIFEST: "<fmiReferences><Related role='result'/></fmiReferences>"}, "Related without source"),
        ({lsref.MANIFEST: only_results("../../../etc/passwd")}, "points outside the FMU"),
        ({lsref.MANIFEST: only_results("http://example.com/out.csv")}, "only files inside the FMU"),
        ({"e.exp": None}, "'e.exp' is not in the FMU"),
        ({"e.exp": "<Experiments/>"}, "no experiment in it"),
        ({"e.exp": FORMER.replace('stepSize="0.125"', 'stepSize="no"')}, "stepSize = 'no' is not a finite number"),
        ({"e.exp": FORMER.replace('stepSize="0.125"', 'stepSize="0.3"')}, "no communication point"),
        ({"e.exp": FORMER.replace('stopTime="1"', 'stopTime="0.5"')}, "no communication point"),
        ({"e.exp": FORMER.replace('<References source="out.csv"/>', "")}, "no references to compare with"),
        ({"e.exp": FORMER.replace("<Parameters", "<SteadyState/><Parameters")}, "only TransientSimulation"),
        ({"out.csv": None}, "'out.csv' is not in the FMU"),
        ({"in.csv": None}, "'in.csv' is not in the FMU"),
        ({"out.csv": b"time,y\n0,0\n0.125,NaN\n"}, "row 2: y = 'NaN' is not a finite number"),
        ({"out.csv": b"time,y\n0,0\n0.125,one\n"}, "row 2: y = 'one' is not a finite number"),
        ({"out.csv": b"t,y\n0,0\n"}, "the first column is 't'"),
        ({"out.csv": b"time,y\n0,0\n0.1,0\n"}, "row 2: time 0.1 s is no communication point"),
        ({"out.csv": b"time,y\n0,0\n0.125\n"}, "line 3: 1 cells, the header has 2"),
        ({"out.csv": b"time,y\n0.125,0\n0,0\n"}, "is before"),
        ({"out.csv": b"time,y,y\n0,0,0\n"}, "column 'y' is there twice"),
        ({"out.csv": b""}, "the first column is ''"),
        ({"out.csv": b"time,v,w\n0,0,0\n0.125,0,0\n"}, "the FMU has no variable 'v', 'w'"),
        ({"in.csv": b"time,v\n0,0\n1,0\n"}, "the FMU has no input 'v'"),
        ({"gain.ssv": GAIN.replace('"gain"', '"gian"')}, "no variable 'gian'. Did you mean 'gain'?"),
        ({"gain.ssv": "<ssv:"}, "gain.ssv: not valid XML"),
    ],
)
def test_what_is_wrong_with_the_files_is_said(tmp_path: Path, files: dict[str, bytes | str | None], said: str) -> None:
    report = verify(probe(tmp_path, files))
    assert report.code == 2
    assert said in "\n".join(report.problems)
    assert all(problem.startswith("Probe.fmu: ") for problem in report.problems)


@pytest.mark.parametrize("names", [("y", "w"), ("Float32_output", "y", "z"), ("v", "w", "z")])
def test_columns_of_other_fmus_are_a_remark(tmp_path: Path, names: tuple[str, ...]) -> None:
    rows = [{"y": y, "z": z} for y, z in response()]
    out = table(names, [[row.get(name, 1e9) for name in names] for row in rows])
    experiment = ReferenceExperiment(**{**EXPERIMENT.__dict__, "tolerances": {}})
    report = verify(probe(tmp_path, {"e.exp": lsref.write_experiments("probe", "", [experiment]), "out.csv": out}))
    (outcome,) = report.outcomes
    others = ", ".join(f"'{name}'" for name in names if name not in ("y", "z"))
    assert report.code == 0
    assert [signal.name for signal in outcome.signals] == [name for name in names if name in ("y", "z")]
    assert outcome.notes == (f"the FMU has no variable {others}: not compared.",)


@pytest.mark.parametrize(
    ("header", "write"),
    [
        ('"time","z","y"', lambda t, y, z: f'{t},"{z}",{y}'),
        ('"time", "y", "z"', lambda t, y, z: f"{t}, {y}, {z}"),
        ("Time;y;z", lambda t, y, z: f"{t};{y};{z}"),
        ("time\ty\tz", lambda t, y, z: f"{t}\t{y}\t{z}"),
        ("time,y,z,", lambda t, y, z: f"{t:.4g},{y},{z},"),
        ("\ufefftime,z,y", lambda t, y, z: f"{t + 1e-6:.7f},{z},{y}\r"),
    ],
)
def test_reference_files_as_other_tools_write_them(
    tmp_path: Path, header: str, write: Callable[[float, float, float], str]
) -> None:
    rows = [write(k * STEP, y, z) for k, (y, z) in enumerate(response())]
    report = verify(probe(tmp_path, {"out.csv": "\n".join([header, *rows, ""])}))
    assert report.code == 0, report.problems
    assert {signal.name for signal in report.outcomes[0].signals} == {"y", "z"}


def test_inputs_of_other_fmus_are_a_remark(tmp_path: Path) -> None:
    """As in the Reference FMUs, whose files of inputs have the types of every version of FMI."""
    stimuli = table(("Int8_input", "u", "label"), [(1e9, u, 0.0) for u in INPUTS])
    report = verify(probe(tmp_path, {"in.csv": stimuli}))
    assert report.code == 0, report.problems
    (outcome,) = report.outcomes
    assert any("the FMU has no input 'Int8_input'" in note for note in outcome.notes)


def test_all_problems_of_an_experiment_are_told_and_others_run(tmp_path: Path) -> None:
    second = ReferenceExperiment(
        **{**EXPERIMENT.__dict__, "name": "second", "stimuli": "gone.csv", "parameters": "lost.ssv"}
    )
    report = verify(probe(tmp_path, {"e.exp": lsref.write_experiments("probe", "", [second, EXPERIMENT])}))
    assert report.code == 2
    assert sum("experiment 'second'" in problem for problem in report.problems) == 2
    assert [(outcome.experiment.name, outcome.within) for outcome in report.outcomes] == [("lag", True)]


def test_a_failing_fmu_is_an_outcome_with_its_words(tmp_path: Path) -> None:
    failing = GAIN.replace("</ssv:Parameters>", _real("gain2", 0.0)).replace("gain2", "fail_time").replace("0.0", "0.5")
    assert 'name="fail_time"><ssv:Real value="0.5"' in failing
    report = verify(probe(tmp_path, {"gain.ssv": failing}))
    assert report.code == 1
    assert "fmi2DoStep" in report.outcomes[0].failure


def _real(name: str, value: float) -> str:
    return f'<ssv:Parameter name="{name}"><ssv:Real value="{value}"/></ssv:Parameter></ssv:Parameters>'


def test_a_crashing_fmu_ends_its_own_process_only_and_each_experiment_is_tried(tmp_path: Path) -> None:
    second = ReferenceExperiment(**{**EXPERIMENT.__dict__, "name": "second"})
    files: dict[str, bytes | str | None] = {"e.exp": lsref.write_experiments("probe", "", [EXPERIMENT, second])}
    report = verify(probe(tmp_path, files, "crash"))
    assert report.code == 1
    assert len(report.outcomes) == 2
    for outcome in report.outcomes:
        assert outcome.failure.startswith("probe: fmi2DoStep at 0 s crashed: SIGABRT"), outcome.failure


def test_a_hanging_fmu_is_ended(tmp_path: Path) -> None:
    slow = GAIN.replace(
        "</ssv:Parameters>",
        '<ssv:Parameter name="sleep"><ssv:Integer value="2000000000"/></ssv:Parameter></ssv:Parameters>',
    )
    report = verify(probe(tmp_path, {"gain.ssv": slow}), timeout=3.0)
    assert report.code == 1
    assert report.outcomes[0].failure.startswith("probe: fmi2")
    assert "had not come back when 3 s had passed, the limit for a run" in report.outcomes[0].failure


def test_files_that_are_no_fmu_or_hostile_are_refused(tmp_path: Path) -> None:
    text = tmp_path / "text.fmu"
    text.write_text("no zip")
    empty = write_zip(tmp_path / "empty.fmu", {"readme.txt": "nothing"})
    outside = write_zip(tmp_path / "outside.fmu", {"../evil.txt": "", "modelDescription.xml": description(PROBE)})
    damaged = write_zip(tmp_path / "damaged.fmu", {"modelDescription.xml": "<fmiModelDescription"})
    for path, said in (
        (text, "not a readable zip archive"),
        (empty, "no modelDescription.xml"),
        (outside, "points outside the archive. Refused."),
        (damaged, "modelDescription.xml cannot be read"),
        (tmp_path / "none.fmu", "cannot be read"),
    ):
        report = verify(path)
        assert (report.code, said in report.problems[0]) == (2, True), report.problems
    assert not (tmp_path.parent / "evil.txt").exists()


def test_an_interface_that_is_missing_is_said(tmp_path: Path) -> None:
    report = verify(probe(tmp_path, {}), interface="me")
    assert report.problems == ("Probe.fmu: has no model exchange. It offers: cs.",)


def test_a_library_that_cannot_be_loaded_is_a_failed_run(tmp_path: Path) -> None:
    path = write_fmu(tmp_path / "Probe.fmu", PROBE, binary=b"no library")
    with zipfile.ZipFile(path, "a") as archive:
        for file, content in GOOD.items():
            archive.writestr(f"{lsref.FOLDER}/{file}", content)
    report = verify(path)
    assert report.code == 1
    assert report.outcomes[0].failure


def test_fmi_3_with_arrays_enumerations_and_booleans(tmp_path: Path) -> None:
    xml = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="Probe3" instantiationToken="probe">
<CoSimulation modelIdentifier="probe3" canHandleVariableCommunicationStepSize="true"/>
<TypeDefinitions><EnumerationType name="Mode"><Item name="plain" value="1"/><Item name="inverted" value="2"/>
</EnumerationType></TypeDefinitions>
<DefaultExperiment startTime="0" stopTime="1" stepSize="0.125"/>
<ModelVariables><Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>
<Float64 name="u" valueReference="1" causality="input" start="0"/>
<Float64 name="y" valueReference="2" causality="output"><Dimension start="2"/></Float64>
<Float64 name="gain" valueReference="3" causality="parameter" variability="fixed" start="1"/>
<Enumeration name="mode" valueReference="4" causality="parameter" variability="fixed" declaredType="Mode" start="1"/>
<Boolean name="positive" valueReference="5" causality="output"/></ModelVariables>
<ModelStructure><Output valueReference="2"/><Output valueReference="5"/></ModelStructure></fmiModelDescription>"""
    values = parameters(
        '<ssv:Parameter name="gain"><ssv:Real value="2.0"/></ssv:Parameter>'
        '<ssv:Parameter name="mode"><ssv:Enumeration value="inverted"/></ssv:Parameter>'
    )
    rows = response(sense=-1.0)
    signs = [INPUTS[0] > 0.0, *(u > 0.0 for u in INPUTS[:-1])]
    cells = [
        [repr(k * STEP), f"{y!r} {z!r}", str(sign).lower()]
        for k, ((y, z), sign) in enumerate(zip(rows, signs, strict=True))
    ]
    elements = [[repr(k * STEP), repr(z), repr(y)] for k, (y, z) in enumerate(rows)]
    experiment = ReferenceExperiment(**{**EXPERIMENT.__dict__, "tolerances": {}})
    files = {**GOOD, "e.exp": lsref.write_experiments("probe", "", [experiment]), "gain.ssv": values}
    library = f"binaries/{_tuple()}/probe3{Path(library_name()).suffix}"
    for out in (lsref.write_csv(("y", "positive"), cells), lsref.write_csv(("y[2]", "y[1]"), elements)):
        members = {f"{lsref.FOLDER}/{file}": content for file, content in {**files, "out.csv": out}.items()}
        path = write_zip(
            tmp_path / "Probe3.fmu",
            {"modelDescription.xml": xml, library: probe_library("probe3").read_bytes(), **members},
        )
        report = verify(path, tolerance=1e-12)
        assert (report.code, report.fmi) == (0, "3.0"), report
    rows[3] = (rows[3][0], rows[3][1] + 1e-3)
    cells[3][1] = "{!r} {!r}".format(*rows[3])
    members[f"{lsref.FOLDER}/out.csv"] = lsref.write_csv(("y", "positive"), cells)
    write_zip(path, {"modelDescription.xml": xml, library: probe_library("probe3").read_bytes(), **members})
    worst = verify(path, tolerance=1e-12).outcomes[0].worst
    assert worst is not None
    assert (worst.name, worst.at) == ("y", 3 * STEP)


def _tuple() -> str:
    from fmpy import platform_tuple

    return platform_tuple


def test_text_outputs_are_told_as_not_compared(tmp_path: Path) -> None:
    label = Variable("words", "output", 0, type="String", depends_on=())
    members: dict[str, bytes | str] = {
        "modelDescription.xml": description((*PROBE, label), name="Probe"),
        library_name(): probe_library().read_bytes(),
        **{f"{lsref.FOLDER}/{file}": content for file, content in GOOD.items()},
    }
    rows = [[repr(k * STEP), repr(y), "probe"] for k, (y, _) in enumerate(response())]
    members[f"{lsref.FOLDER}/out.csv"] = lsref.write_csv(("y", "words"), rows)
    members[f"{lsref.FOLDER}/e.exp"] = FORMER
    report = verify(write_zip(tmp_path / "Probe.fmu", members))
    assert report.code == 0
    assert report.outcomes[0].notes == ("'words' is of type String and not compared.",)


def test_a_difference_of_an_array_is_that_of_its_widest_element() -> None:
    from cosim.reference.replay import Signal

    times = np.arange(2.0)
    replay = np.array([[1.0, 2.0], [3.0, np.nan]])
    signal = Signal("y", "", times, np.zeros((2, 2)), replay, 1.0, True)
    assert (signal.differences[0], signal.largest, signal.at, signal.within) == (2.0, math.inf, 1.0, False)


@pytest.mark.parametrize(
    ("held", "times", "expected"),
    [
        (True, [0.0, 1.0, 2.0], [0.0, 1.0, 3.0]),  # before the event
        (False, [0.0, 1.0, 2.0], [0.0, 2.0, 3.0]),  # after it
        (True, [0.0, 1.0, 1.0, 2.0], [0.0, 1.0, 2.0, 3.0]),
        (False, [0.0, 1.0, 1.0, 2.0], [0.0, 1.0, 2.0, 3.0]),
    ],
)
def test_rows_at_an_event(held: bool, times: list[float], expected: list[float]) -> None:
    y = SimpleNamespace(name="y", unit="V", declaredType=None, shape=())
    references = lsref.Table(("y",), tuple(times), tuple((repr(value),) for value in expected))
    experiment = ReferenceExperiment("event", step_size=1.0, held=held)
    job = Job(experiment, references, variables={"y": (y, None)})
    columns = {"time": np.array([0.0, 1.0, 1.0, 2.0]), "y": np.array([0.0, 1.0, 2.0, 3.0])}
    assert module._compared(job, columns, 1e-9).within
    short = {name: values[:-1] for name, values in columns.items()}
    assert "no values at 2 s; its last are those of 1 s" in module._compared(job, short, 1e-9).failure


def test_the_command_shows_all_fmus_and_ends_with_the_highest_code(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    good, wrong = tmp_path / "good", tmp_path / "wrong"
    for folder in (good, wrong):
        folder.mkdir()
    probe(good, {}, name="Right")
    rows = [(y + 0.01, z) for y, z in response()]
    other = probe(wrong, {"out.csv": table(("y", "z"), list(rows))}, name="Wrong")
    assert main(["verify", str(good)]) == 0
    assert "within" in capsys.readouterr().out
    assert main(["verify", str(good), str(other)]) == 1
    shown = capsys.readouterr().out
    assert "1 of 2 outside" in shown
    assert "Right" in shown
    bad = probe(wrong, {"out.csv": None}, name="Bad")
    assert main(["verify", str(bad), str(other), str(good)]) == 2
    told = capsys.readouterr()
    assert "'out.csv' is not in the FMU" in told.err
    assert "1 of 2 outside" in told.out
    assert main(["verify", "Right", "--fmus", str(good)]) == 0


def test_the_command_as_json_and_with_a_picture(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    probe(tmp_path, {}, name="One")
    probe(tmp_path, {}, name="Two")
    picture = tmp_path / "shown.png"
    assert main(["verify", str(tmp_path), "--json", "--plot", str(picture)]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert [fact["name"] for fact in facts] == ["One", "Two"]
    (experiment,) = facts[0]["experiments"]
    assert experiment["within"] is True
    assert {signal["name"] for signal in experiment["signals"]} == {"y", "z"}
    assert (tmp_path / "shown_One.png").stat().st_size > 5000
    assert (tmp_path / "shown_Two.png").exists()


def test_wrong_arguments_are_all_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    given = ["verify", str(tmp_path / "none.fmu"), str(tmp_path), "--tolerance", "-1", "--timeout", "nan"]
    assert main(given) == 2
    told = capsys.readouterr().err
    for said in ("no such file", "no .fmu file in this folder", "--tolerance -1", "--timeout nan"):
        assert said in told


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    path = tmp_path / "e.exp"
    path.write_bytes(lsref.write_experiments("probe", "all", [EXPERIMENT]))
    assert lsref.read_experiments(path) == [EXPERIMENT]
    (tmp_path / lsref.FOLDER).mkdir(parents=True)
    (tmp_path / lsref.FOLDER / lsref.MANIFEST).write_bytes(lsref.write_manifest(RELATED))
    assert tuple(lsref.read_manifest(tmp_path)) == RELATED
    table_file = tmp_path / "t.csv"
    table_file.write_bytes(lsref.write_csv(("a[1]", 'b"c'), [["0", "1", "2"]]))
    assert lsref.read_csv(table_file).names == ("a[1]", 'b"c')


def test_negative_tolerances_and_repeated_names_are_problems(tmp_path: Path) -> None:
    path = tmp_path / "e.exp"
    twice = ReferenceExperiment(**{**EXPERIMENT.__dict__, "tolerances": {"y": Tolerance(-1.0, 0.0)}})
    path.write_bytes(lsref.write_experiments("probe", "", [EXPERIMENT, twice]))
    with pytest.raises(DescriptionError) as error:
        lsref.read_experiments(path)
    assert "is there twice" in str(error.value)
    assert "tolerance of 'y' is negative" in str(error.value)
