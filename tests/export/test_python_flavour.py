"""Python FMUs: the same declaration, traces and refusals as native ones, whatever else runs in the process."""

from __future__ import annotations

import ctypes
import gc
import json
import math
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import fmpy
import pytest
from conftest import ROOT, WORKSPACE
from fmpy.fmi2 import FMU2Slave
from fmpy.validation import validate_fmu
from instances import DISCARD, ERROR, OK, Instance, excite, run

from cosim.export.package import build_python
from cosim.export.python.python_package import resources
from cosim.fmu.archive import write_zip
from cosim.master.simulation import simulate
from cosim.system.system import read_system

COMPONENTS = sorted(WORKSPACE.components())
PLANTS = ("BallscrewStage", "CompliantBallscrew", "LinearMotor", "NominalStage")
PLANT = "LinearMotor"


def edited(source: Path, target: Path, old: str, new: str) -> Path:
    """A copy of an FMU in which the text of its own Python files is changed."""
    with zipfile.ZipFile(source) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    changed = {
        name: content.replace(old.encode(), new.encode()) if name.startswith("resources/motion_cosim/fmus") else content
        for name, content in files.items()
    }
    assert changed != files
    write_zip(target, changed, "modelDescription.xml")
    return target


# ---- declaration ----


@pytest.mark.parametrize("name", COMPONENTS)
def test_description_differs_from_the_native_one_as_declared(native: Path, python: Path, name: str) -> None:
    def text(path: Path) -> str:
        with zipfile.ZipFile(path) as archive:
            found = archive.read("modelDescription.xml").decode()
        found = re.sub(r' (guid|numberOfEventIndicators)="[^"]*"', "", found, count=2)
        found = re.sub(r"<CoSimulation[^>]*?/>|<CoSimulation.*?</CoSimulation>", "", found, flags=re.DOTALL)
        return re.sub(r"<ModelExchange.*?</ModelExchange>", "", found, flags=re.DOTALL).replace("\n  \n", "\n")

    one, other = text(native / f"{name}.fmu"), text(python / f"{name}.fmu")
    assert [line for line in one.splitlines() if line.strip()] == [line for line in other.splitlines() if line.strip()]
    options = fmpy.read_model_description(python / f"{name}.fmu").coSimulation
    assert options.needsExecutionTool
    assert options.canNotUseMemoryManagementFunctions
    assert not options.providesDirectionalDerivative
    assert options.canSerializeFMUstate
    assert options.canHandleVariableCommunicationStepSize


@pytest.mark.parametrize("name", COMPONENTS)
def test_fmpy_finds_no_problem(python: Path, name: str) -> None:
    assert validate_fmu(str(python / f"{name}.fmu")) == []


def test_equal_sources_give_equal_bytes(tmp_path: Path) -> None:
    kind = WORKSPACE.component("PPi")
    one = build_python(kind, tmp_path / "one", WORKSPACE.cache).read_bytes()
    other = build_python(kind, tmp_path / "other", WORKSPACE.cache).read_bytes()
    assert one == other


def test_files_of_the_fmu_need_nothing_of_this_project() -> None:
    for name, content in resources(WORKSPACE.component("NctfPi")).items():
        absolute = re.findall(rb"^\s*(?:from|import) (?:cosim|fmus|pythonfmu|casadi|fmpy)\b.*", content, re.MULTILINE)
        assert absolute == [], name


# ---- traces ----


@pytest.mark.parametrize("name", sorted(set(COMPONENTS) - set(PLANTS)))
def test_controllers_and_sources_run_as_native(native: Path, python: Path, name: str) -> None:
    step = WORKSPACE.component(name).experiment.step_size
    with Instance(native / f"{name}.fmu") as one, Instance(python / f"{name}.fmu") as other:
        one.initialize()
        other.initialize()
        for expected, found in zip(run(one, 0, 100, step), run(other, 0, 100, step), strict=True):
            assert found == pytest.approx(expected, rel=1e-12, abs=1e-15)


@pytest.mark.parametrize("name", PLANTS)
def test_plants_run_as_native_to_the_tolerance(native: Path, python: Path, name: str) -> None:
    """Local tolerance 1e-9 over 20 steps: the traces differ by no more than 1e-6 of their largest value.

    Signals near zero are held to the absolute tolerance of 20 steps, 1e-11 of the nominals (1e-2) each.
    """
    step = WORKSPACE.component(name).experiment.step_size
    traces: list[list[list[float]]] = []
    for folder in (native, python):
        with Instance(folder / f"{name}.fmu") as fmu:
            fmu.initialize({"tolerance": 1e-9})
            traces.append(run(fmu, 0, 20, step))
    for expected, found in zip(zip(*traces[0], strict=True), zip(*traces[1], strict=True), strict=True):
        scale = max(map(abs, expected))
        assert found == pytest.approx(expected, rel=0.0, abs=1e-6 * scale + 2e-12)


@pytest.mark.parametrize("factor", [0.25, 4.0])
@pytest.mark.parametrize("name", ["NctfPi", "SuperTwisting", "FrictionPulse"])
def test_sampling_is_that_of_native_for_any_step(native: Path, python: Path, name: str, factor: float) -> None:
    step = factor * WORKSPACE.component(name).experiment.step_size
    with Instance(native / f"{name}.fmu") as one, Instance(python / f"{name}.fmu") as other:
        one.initialize(start=0.3)
        other.initialize(start=0.3)
        for k in range(40):
            for fmu in (one, other):
                excite(fmu, k)
                fmu.step(0.3 + k * step, step)
            outputs = one.names("output")
            assert other.get(outputs) == pytest.approx(one.get(outputs), rel=1e-12, abs=1e-15)


@pytest.mark.parametrize("step", [1e-19, 2e-18])
def test_step_too_short_to_tell_times_apart_changes_nothing(native: Path, python: Path, step: float) -> None:
    """Importers that add steps up make such a last one: 1e-19 s leaves the time as it is, 2e-18 s is one last bit."""
    for folder in (native, python):
        with Instance(folder / f"{PLANT}.fmu") as fmu:
            fmu.initialize({"command": 12.0})
            fmu.step(0.0, 0.01)
            before = fmu.get(fmu.names("output"))
            fmu.step(0.01, step)
            assert fmu.get(fmu.names("output")) == pytest.approx(before, rel=1e-12)
            fmu.step(0.01 + step, 0.01)
            assert fmu.get(["position"])[0] > before[0]


def test_master_runs_a_system_of_python_fmus(native: Path, python: Path) -> None:
    """The closed loop of two controllers' traces: command and position agree to the plant's tolerance."""
    path = ROOT / "studies" / "rubio2015" / "super_twisting.toml"
    results = [simulate(read_system(path, fmus=folder, stop_time="0.005")) for folder in (native, python)]
    for name in ("plant.position", "controller.command"):
        expected, found = (result[name] for result in results)
        assert abs(found - expected).max() <= 1e-4 * abs(expected).max()
        assert abs(expected).max() > 0.0


def test_counters_count(python: Path) -> None:
    with Instance(python / f"{PLANT}.fmu") as fmu:
        fmu.initialize()
        fmu.step(0.0, 1e-4)
        steps, _, evaluations, *_ = fmu.get([name for name in fmu.variables if name.startswith("solver.")])
        assert 0 < steps < evaluations


# ---- several in one process ----


def test_fmus_of_one_process_run_their_own_code(python: Path, tmp_path: Path) -> None:
    """One, an edited copy under the same names, a different component, and the first again; interleaved."""
    old, new = "1.0 - pole", "0.5 - pole"
    other = edited(python / "PPi.fmu", tmp_path / "PPi.fmu", old, new)

    def trace(path: Path) -> list[list[float]]:
        with Instance(path) as fmu:
            fmu.initialize()
            return run(fmu, 0, 10, 1e-4)

    alone = trace(python / "PPi.fmu")
    assert trace(other) != alone
    with Instance(other) as changed, Instance(python / "PPi.fmu") as fmu, Instance(python / "NctfPi.fmu") as third:
        for each in (changed, fmu, third):
            each.initialize()
        assert run(fmu, 0, 5, 1e-4) == alone[:10]
        assert run(changed, 0, 5, 1e-4) != alone[:10]
        run(third, 0, 5, 2e-4)
        assert run(fmu, 5, 10, 1e-4) == alone[10:]


def test_nothing_is_left_on_the_import_path(python: Path) -> None:
    before = list(sys.path)
    with Instance(python / "PPi.fmu") as fmu:
        fmu.initialize()
    assert sys.path == before


def test_references_of_the_entry_module_stay_balanced(python: Path) -> None:
    """PythonFMU drops a reference to the module's globals for each instance; fewer than are held is a crash to come."""
    for _ in range(5):
        with Instance(python / "PPi.fmu"):
            pass
    gc.collect()
    modules = [module for name, module in sys.modules.items() if name.startswith("motion_cosim_PPi_")]
    assert modules
    for module in modules:
        assert sys.getrefcount(vars(module)) - 1 >= len(gc.get_referrers(vars(module)))


# ---- refusals ----


@pytest.mark.parametrize(
    ("variable", "value", "refusal"),
    [
        ("F_S", math.nan, (DISCARD, "must be finite")),
        ("J_rot", -1.0, (DISCARD, "below its minimum")),
        ("tolerance", 1.0, (DISCARD, "above its maximum")),
        ("position", 1.0, (ERROR, "is computed by the FMU")),
        ("command", math.inf, (DISCARD, "must be finite")),
    ],
)
def test_refused_values_are_said_as_native_says_them(
    native: Path, python: Path, variable: str, value: float, refusal: tuple[int, str]
) -> None:
    status, text = refusal
    said: list[list[str]] = []
    for folder in (native, python):
        with Instance(folder / "BallscrewStage.fmu") as fmu:
            assert fmu.set_status(variable, value) == status
            said.append(fmu.messages)
    assert text in said[0][0]
    assert said[0] == said[1]


def test_broken_rule_ends_initialization(native: Path, python: Path) -> None:
    said: list[list[str]] = []
    for folder in (native, python):
        with Instance(folder / "BallscrewStage.fmu") as fmu:
            fmu.fmu.setupExperiment()
            fmu.set({"F_S": 0.0})
            fmu.fmu.enterInitializationMode()
            assert fmu.status("ExitInitializationMode") == ERROR
            said.append(fmu.messages)
    assert "F_S = 0 with F_C > 0" in said[0][0]
    assert said[0] == said[1]


@pytest.mark.parametrize(
    ("time", "step", "text"),
    [(0.0, -1e-4, "Give a positive, finite one"), (0.0, math.nan, "Give a positive"), (0.5, 1e-4, "Continue where")],
)
def test_wrong_steps_are_errors(python: Path, time: float, step: float, text: str) -> None:
    with Instance(python / "PPi.fmu") as fmu:
        fmu.initialize()
        assert fmu.step_status(time, step) == ERROR
        assert text in fmu.messages[-1]
        assert "not allowed in state 'error'" not in fmu.messages[-1]
        assert fmu.step_status(0.0, 1e-4) == ERROR
        assert "not allowed in state 'error'" in fmu.messages[-1]


def test_failed_integration_is_discarded_with_its_time(python: Path) -> None:
    with Instance(python / f"{PLANT}.fmu") as fmu:
        fmu.initialize()
        fmu.step(0.0, 1e-4)
        fmu.set({"command": 1e308, "disturbance_force": -1e308})
        assert fmu.step_status(1e-4, 1e-4) == DISCARD
        assert "integration with tolerance 5e-09 stopped at t = 0.0001 s, at " in fmu.messages[-1]
        reached = ctypes.c_double()
        assert fmu.status("GetRealStatus", ctypes.c_int(2), ctypes.byref(reached)) == OK
        assert reached.value == pytest.approx(1e-4, abs=0.0)


def test_error_in_edited_equations_is_one_readable_line(python: Path, tmp_path: Path) -> None:
    path = edited(python / "PPi.fmu", tmp_path / "PPi.fmu", "1.0 - pole", "1.0 - pule")
    with Instance(path) as fmu:
        fmu.fmu.setupExperiment()
        fmu.fmu.enterInitializationMode()
        assert fmu.status("ExitInitializationMode") == ERROR
        assert (
            fmu.messages[-1]
            == "test: fmi2ExitInitializationMode: PPi failed in Python: NameError: name 'pule' is not defined"
        )


def test_wrong_guid_gives_no_instance(python: Path) -> None:
    instance = Instance(python / "PPi.fmu", guid="{wrong}")
    with pytest.raises(Exception, match="instantiate"):
        instance.__enter__()
    assert "guid is '{wrong}', this FMU has" in instance.messages[0]


def test_logging_off_says_nothing(python: Path) -> None:
    with Instance(python / "PPi.fmu", logging=False) as fmu:
        assert fmu.set_status("command_max", math.nan) == DISCARD
        assert fmu.messages == []


@pytest.mark.parametrize("folder", ["plain", "with space", "Größe 100 % (ä#?;&+)", "'quotes'"])
def test_unpacked_anywhere(python: Path, tmp_path: Path, folder: str) -> None:
    place = tmp_path / folder
    fmpy.extract(python / "PPi.fmu", unzipdir=place)
    description = fmpy.read_model_description(place)
    fmu = FMU2Slave(guid=description.guid, unzipDirectory=str(place), modelIdentifier="PPi", instanceName="test")
    fmu.instantiate()
    fmu.setupExperiment()
    fmu.enterInitializationMode()
    fmu.exitInitializationMode()
    fmu.doStep(0.0, 1e-4)
    fmu.terminate()
    fmu.freeInstance()


_WITHOUT_PACKAGES = """
import json, sys
import fmpy
sys.path.insert(0, {tests!r})
from pathlib import Path
from instances import Instance
instance = Instance(Path({fmu!r}))
before = set(sys.modules)
sys.modules["scipy"] = None
with instance as fmu:
    fmu.initialize()
    fmu.step(0.0, 1e-4)
print(json.dumps(sorted({{name.split(".")[0] for name in set(sys.modules) - before}})))
"""


def test_a_plant_needs_no_package(python: Path) -> None:
    """Nothing outside of the FMU and of Python is imported."""
    script = _WITHOUT_PACKAGES.format(tests=str(ROOT / "tests"), fmu=str(python / f"{PLANT}.fmu"))
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=ROOT)
    assert {name for name in json.loads(done.stdout) if not name.startswith("motion_cosim")} <= {
        "scipy",
        *sys.stdlib_module_names,
    }


def counters(fmu: Instance) -> dict[str, int]:
    names = [name for name in fmu.variables if name.startswith("solver.")]
    return dict(zip(names, fmu.fmu.getInteger([fmu.reference(name) for name in names]), strict=True))


@pytest.mark.parametrize("name", PLANTS)
def test_plants_integrate_step_by_step_as_native(native: Path, python: Path, name: str) -> None:
    """The same method with the same Jacobian: equal counts, and traces that differ by rounding."""
    step = WORKSPACE.component(name).experiment.step_size
    traces: list[list[list[float]]] = []
    counts: list[dict[str, int]] = []
    for folder in (native, python):
        with Instance(folder / f"{name}.fmu") as fmu:
            fmu.initialize()
            rows: list[list[float]] = []
            for k in range(100):
                fmu.set({n: 3.0 * math.sin(0.1 * k + i) for i, n in enumerate(fmu.names("input"))})
                fmu.step(k * step, step)
                rows.append(fmu.get(fmu.names("output")))
            traces.append(rows)
            counts.append(counters(fmu))
    assert counts[0] == counts[1]
    assert counts[0]["solver.steps"] >= 100
    for expected, found in zip(zip(*traces[0], strict=True), zip(*traces[1], strict=True), strict=True):
        assert found == pytest.approx(expected, rel=0.0, abs=1e-10 * max(map(abs, expected)) + 1e-300)


def test_a_long_run_leaves_nothing_behind(python: Path) -> None:
    """Blocks of memory that Python holds, after steps whose number is ten times that of the first ones."""
    with Instance(python / "NominalStage.fmu") as fmu:
        fmu.initialize()
        held: list[int] = []
        k = 0
        for last in (200, 400, 2400):
            while k < last:
                fmu.set({n: math.sin(0.1 * k) for n in fmu.names("input")})
                fmu.step(k * 1e-4, 1e-4)
                k += 1
            gc.collect()
            held.append(sys.getallocatedblocks())
    assert held[2] - held[1] < 200, held


def test_dependencies_are_documented(python: Path) -> None:
    with zipfile.ZipFile(python / f"{PLANT}.fmu") as archive:
        text = archive.read("documentation/externalDependencies.txt").decode()
    assert "Python: 3.11 or later" in text
    assert "Python packages: none." in text
    assert "COSIM_LIBPYTHON" in text
