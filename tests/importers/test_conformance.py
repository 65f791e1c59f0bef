"""The part of the conformance suite whose importers install in seconds; ``make conformance`` runs all."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import zipfile
from pathlib import Path
from platform import machine

import pytest
from conftest import WORKSPACE

from . import conform
from .cases import MULTIPLES, Case, compare, fmu_case, multiple_case, system_case
from .conform import (
    EXCHANGE_TOLERANCE,
    FMU_IMPORTERS,
    ROOT,
    SYSTEM_IMPORTERS,
    SYSTEM_TOLERANCE,
    Conformance,
    results,
    run,
    selected,
    shipped_systems,
)
from .report import Outcome, Run, data, table

LOAD = "from libcosimpy.CosimManipulator import CosimManipulator"
"""libcosimpy loads its library when it is first used, not when it is imported."""


def why_not_libcosim() -> str:
    """The reason why libcosimpy cannot run on this machine; empty if it can, or if it fails for another reason."""
    if sys.platform == "darwin" or machine() not in ("x86_64", "AMD64"):
        return "libcosimpy has wheels for Linux and Windows on x86-64 only"
    command = [sys.executable, "-c", f"{LOAD}; CosimManipulator.create_override()"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    missing = re.search(r"(lib[\w.+-]+): cannot open shared object file", done.stderr)
    if missing is None:
        return ""
    package = {"libatomic.so.1": "libatomic1"}.get(missing[1])
    return f"libcosimpy needs {missing[1]} of the system" + (f": apt-get install {package}" if package else "")


REASON = why_not_libcosim()
needs_libcosim = pytest.mark.skipif(bool(REASON), reason=REASON)
BREAK = {
    "fmilibrary": lambda xml: xml.replace(b'variability="fixed"', b'variability="continuous"'),
    "fmutool": lambda xml: xml.replace(b'fmiVersion="2.0"', b'fmiVersion="2.0" wrong="1"'),
}
"""What each checker must find: a parameter that is continuous; an unknown attribute."""


@pytest.fixture(scope="module")
def cases(native: Path) -> list[Case]:
    return [fmu_case(path) for path in sorted(native.glob("*.fmu"))]


@pytest.mark.parametrize(
    "importer", ["fmpy", "fmpy.simulate_fmu", "fmuloader", pytest.param("libcosim", marks=needs_libcosim)]
)
def test_native_fmus_run_as_in_cosim(cases: list[Case], importer: str) -> None:
    outcome = run(importer, cases, sys.executable, "native")
    assert outcome.problems == []
    assert outcome.ran == outcome.traces == len(cases) == len(WORKSPACE.components())


@pytest.mark.parametrize("checker", [pytest.param("fmilibrary", marks=needs_libcosim), "fmutool"])
def test_checkers_report_nothing(cases: list[Case], checker: str) -> None:
    outcome = run(checker, cases, sys.executable, "native")
    assert outcome.problems == []
    assert outcome.ran == len(cases) == len(WORKSPACE.components())


@pytest.mark.parametrize("checker", [pytest.param("fmilibrary", marks=needs_libcosim), "fmutool"])
def test_checkers_report_what_is_wrong(native: Path, tmp_path: Path, checker: str) -> None:
    target = tmp_path / "PPi.fmu"
    with zipfile.ZipFile(native / "PPi.fmu") as source, zipfile.ZipFile(target, "w") as archive:
        for member in source.infolist():
            content = source.read(member)
            if member.filename == "modelDescription.xml":
                content = BREAK[checker](content)
            archive.writestr(member, content)
    case = fmu_case(native / "PPi.fmu", 5)
    case.job["path"] = str(target)
    outcome = run(checker, [case], sys.executable, "broken")
    assert outcome.ran == 0
    assert len(outcome.problems) == 1


@pytest.fixture(scope="module")
def systems(native: Path, tmp_path_factory: pytest.TempPathFactory) -> list[Case]:
    folder = tmp_path_factory.mktemp("ssp")
    return [system_case(path, folder, native) for path in shipped_systems()]


@needs_libcosim
def test_every_system_runs_in_libcosim_as_in_cosim(systems: list[Case]) -> None:
    """As SSP, in parallel order; libcosim knows no Enumeration, so FMUs that set one declare it as Integer."""
    importer = next(i for i in SYSTEM_IMPORTERS if i.function == "libcosim")
    outcome = run("libcosim", systems, sys.executable, "systems", tolerance=SYSTEM_TOLERANCE, extra=importer.package)
    assert outcome.problems == []
    assert outcome.ran == outcome.traces == len(systems) == len(shipped_systems())
    assert any(case.set_enumerations for case in systems)


@needs_libcosim
def test_systems_with_step_multiples_run_in_libcosim_as_in_cosim(native: Path, tmp_path: Path) -> None:
    cases = [multiple_case(name, ROOT / "studies", tmp_path, native) for name in MULTIPLES]
    outcome = run("libcosim", cases, sys.executable, "multiples", tolerance=SYSTEM_TOLERANCE)
    assert outcome.problems == []
    assert outcome.traces == len(MULTIPLES)


def test_systems_run_in_a_container_as_in_cosim(systems: list[Case], tmp_path: Path) -> None:
    """One system of each study without factors; the container is an FMU that ``cosim run`` takes."""
    importer = next(i for i in SYSTEM_IMPORTERS if i.function == "fmucontainer")
    chosen, _ = selected(importer, systems)
    studies = {case.job["name"].partition("/")[0]: case for case in chosen}
    suite = Conformance({"importers": sys.executable}, {}, tmp_path)
    for outcome in (
        suite.one(importer, list(studies.values()), "systems", fmus="native"),
        suite.containers(list(studies.values()), "systems"),
    ):
        assert outcome.problems == []
        assert outcome.traces == len(studies) >= 3


def test_python_fmus_run_in_fmpy_as_in_cosim(python: Path) -> None:
    cases = [fmu_case(path, 20) for path in sorted(python.glob("*.fmu"))]
    outcome = run("fmpy.simulate_fmu", cases, sys.executable, "python")
    assert outcome.problems == []
    assert outcome.ran == len(cases) == len(WORKSPACE.components())


def test_plants_run_in_fmpy_as_model_exchange(cases: list[Case]) -> None:
    plants = [case for case in cases if case.job["continuous_states"]]
    outcome = run("fmpy.simulate_fmu ME", plants, sys.executable, "plants", tolerance=EXCHANGE_TOLERANCE)
    assert outcome.problems == []
    assert outcome.ran == len(plants) >= 4


def test_comparison_sees_a_wrong_trace() -> None:
    """A plant's output must be in its row; a controller's may be that of the sample before or after, no other."""
    job = {"outputs": ["y"], "steps": 4}
    rows = [[1.0], [4.0], [9.0], [16.0]]
    plant = Case(job, rows, [0.0], (False,))
    assert compare(plant, rows) == (0.0, "")
    assert compare(plant, [[0.0], [1.0], [4.0], [9.0]]) == (7.0 / 16.0, "y")
    assert compare(plant, rows[:3])[0] == float("inf")
    assert compare(plant, [*rows[:3], [float("nan")]]) == (float("inf"), "y")
    controller = Case(job, rows, [0.0], (True,))
    assert compare(controller, [[0.0], [1.0], [4.0], [9.0]]) == (0.0, "")
    assert compare(controller, [[4.0], [9.0], [16.0], [25.0]]) == (0.0, "")
    assert compare(controller, [[1.0], [4.0], [9.0], [15.0]]) == (1.0 / 16.0, "y")


def test_a_crash_loses_one_job_and_a_hang_ends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    script = tmp_path / "importer.py"
    script.write_text(
        "import json, os, sys, time\n"
        "for job in json.load(sys.stdin):\n"
        "    if job == 'crash': os.abort()\n"
        "    if job == 'hang': time.sleep(600)\n"
        "    print(json.dumps({'rows': job}), flush=True)\n"
    )
    command = [sys.executable, str(script)]
    found = results(command, ["a", "crash", "b"], {})
    assert [f.get("rows") for f in found] == ["a", None, "b"]
    assert "process ended (-6)" in found[1]["error"]
    found = results(command, ["crash"] * 5, {})
    assert [f["error"].partition(" (")[0] for f in found[:3]] == ["its process ended"] * 3
    assert {f["error"] for f in found[3:]} == {"not tried after 3 crashes"}
    monkeypatch.setattr(conform, "SECONDS_A_JOB", 1.0)
    assert results(command, ["hang"], {}) == [{"error": "no end within 3 s"}]


def test_a_program_without_a_path_is_named() -> None:
    suite = Conformance({"importers": sys.executable}, {"fmusim": None}, Path())
    importer = next(i for i in FMU_IMPORTERS if i.program == "fmusim")
    line = table([suite.one(importer, [], "FMUs", fmus="native")])[2]
    assert "not run: give --fmusim PATH" in line


def test_failures_of_an_importer_are_reported(native: Path) -> None:
    case = fmu_case(native / "PPi.fmu", 5)
    case.job["references"] = dict.fromkeys(case.job["references"], 10**6)
    outcome = run("fmpy", [case], sys.executable, "wrong", tolerance=1e-9)
    assert outcome.ran == 0
    assert outcome.problems[0].startswith("PPi: FMICallException")


def test_data_tells_what_became_of_a_component() -> None:
    """By itself or in systems: the largest difference, what failed, and nothing of Reference FMUs."""
    runs = [
        Run("one", ("Plant", "Source"), 1e-9, "plant.y"),
        Run("two", ("Plant",), 0.5, "plant.y", differs=True),
        Run("three", ("Source",), error="no start"),
    ]
    own = Outcome("Tool", "systems", fmus="native", version="1.0", runs=runs)
    foreign = Outcome("Tool", "others", fmus="reference", runs=runs)
    checker = Outcome("Checker", "FMUs", fmus="python", runs=[Run("Plant", ("Plant",))])
    missing = Outcome("Program", "FMUs", fmus="native", missing="not run: give --program PATH")
    systems, checks, absent = json.loads(data([("Systems", "", [own, foreign]), ("Checkers", "", [checker, missing])]))
    assert (systems["section"], systems["importer"], systems["version"]) == ("Systems", "Tool", "1.0")
    assert systems["components"] == {
        "Plant": {
            "jobs": 2,
            "ran": 2,
            "difference": 0.5,
            "problems": ["two: plant.y differs by 0.5 of its largest value"],
        },
        "Source": {"jobs": 2, "ran": 1, "difference": 1e-9, "problems": ["three: no start"]},
    }
    assert checks["components"] == {"Plant": {"jobs": 1, "ran": 1, "difference": None, "problems": []}}
    assert absent["missing"] == "not run: give --program PATH"
    assert absent["components"] == {}
