"""FMI 3.0 FMUs in FMPy: valid, the same traces as FMI 2.0, arrays, event mode at sampling instants, refusals."""

from __future__ import annotations

import ctypes
import math
import subprocess
import sys
import zipfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import fmpy
import fmpy.validation
import lief
import numpy as np
import pytest
from conftest import ROOT, WORKSPACE
from fmpy.fmi3 import FMU3Model, FMU3Slave
from instances import DISCARD, ERROR, OK

from cosim.model import Controller

COMPONENTS = sorted(WORKSPACE.components())
PLANTS = ("BallscrewStage", "CompliantBallscrew", "LinearMotor", "NominalStage")
SAMPLED = [name for name in COMPONENTS if issubclass(WORKSPACE.component(name), Controller)]
CONTROLLER = "FuzzySlidingMode"


class Instance:
    """An FMI 3.0 co-simulation instance driven by names; messages are collected."""

    def __init__(self, path: Path, *, events: bool = False, early: bool = False, token: str | None = None) -> None:
        self.folder = TemporaryDirectory()
        fmpy.extract(path, unzipdir=self.folder.name)
        self.description = fmpy.read_model_description(path)
        self.variables = {v.name: v for v in self.description.modelVariables}
        self.messages: list[str] = []
        self.fmu = FMU3Slave(
            guid=token or self.description.instantiationToken,
            unzipDirectory=self.folder.name,
            modelIdentifier=self.description.coSimulation.modelIdentifier,
            instanceName="test",
        )
        self.options = {"eventModeUsed": events, "earlyReturnAllowed": early, "loggingOn": True}

    def __enter__(self) -> Instance:
        def log(_: object, status: int, category: bytes, message: bytes) -> None:
            self.messages.append(message.decode())

        self.fmu.instantiate(logMessage=log, **self.options)
        return self

    def __exit__(self, *_: object) -> None:
        self.fmu.freeInstance()
        self.folder.cleanup()

    def references(self, names: Sequence[str]) -> list[int]:
        return [self.variables[name].valueReference for name in names]

    def names(self, causality: str) -> list[str]:
        return [v.name for v in self.description.modelVariables if v.causality == causality]

    def get(self, names: Sequence[str]) -> list[float]:
        return self.fmu.getFloat64(self.references(names))

    def set(self, values: dict[str, float]) -> None:
        self.fmu.setFloat64(self.references(list(values)), list(values.values()))

    def status(self, function: str, *arguments: Any) -> int:
        raw = self.fmu.dll[f"fmi3{function}"]
        raw.restype = ctypes.c_int
        return raw(ctypes.c_void_p(self.fmu.component), *arguments)

    def initialize(self, values: dict[str, float] | None = None, start: float = 0.0) -> None:
        self.set(values or {})
        self.fmu.enterInitializationMode(startTime=start)
        self.fmu.exitInitializationMode()


def excitation(names: Sequence[str], k: int) -> dict[str, float]:
    return {name: 1e-3 * math.sin(0.1 * k + i) for i, name in enumerate(names)}


# ---- the file ----


@pytest.mark.parametrize("name", COMPONENTS)
def test_fmu_is_valid_and_complete(fmi3: Path, name: str) -> None:
    path = fmi3 / f"{name}.fmu"
    assert fmpy.validation.validate_fmu(str(path)) == []
    with zipfile.ZipFile(path) as archive:
        members = set(archive.namelist())
    assert {"sources/fmi3.c", "sources/fmi3.h", "documentation/licenses/license.txt"} <= members
    assert not any("fmi2" in member for member in members)
    variables = fmpy.read_model_description(path).modelVariables
    assert [v.name for v in variables if v.causality == "independent"] == ["time"]
    assert all(v.description for v in variables)


@pytest.mark.parametrize("name", COMPONENTS)
def test_only_fmi3_functions_are_exported(fmi3: Path, name: str) -> None:
    with zipfile.ZipFile(fmi3 / f"{name}.fmu") as archive:
        content = archive.read(f"binaries/{fmpy.platform_tuple}/{name}{fmpy.sharedLibraryExtension}")
    library = lief.parse(content)
    assert isinstance(library, lief.Binary)
    exported = {function.name for function in library.exported_functions}
    prototypes = {name for name in dir(FMU3Slave) if name.startswith("fmi3")}
    prototypes |= {name for name in dir(FMU3Model) if name.startswith("fmi3")}
    assert exported == prototypes


# ---- traces ----


@pytest.mark.parametrize("name", COMPONENTS)
def test_trace_is_that_of_fmi2_bitwise(native: Path, fmi3: Path, name: str) -> None:
    """FMPy's simulate_fmu with inputs that move, on both."""
    step = WORKSPACE.component(name).experiment.step_size
    description = fmpy.read_model_description(native / f"{name}.fmu")
    inputs = [v.name for v in description.modelVariables if v.causality == "input"]
    rows = [(k * step, *excitation(inputs, k).values()) for k in range(201)]
    signals = np.array(rows, dtype=[(n, float) for n in ("time", *inputs)]) if inputs else None
    traces = [
        fmpy.simulate_fmu(
            str(folder / f"{name}.fmu"),
            stop_time=200 * step,
            output_interval=step,
            input=signals,
            fmi_type="CoSimulation",
        )
        for folder in (native, fmi3)
    ]
    assert len(traces[0]) == 201
    assert traces[0].dtype.names == traces[1].dtype.names
    for signal in traces[0].dtype.names or ():
        assert np.array_equal(traces[0][signal], traces[1][signal]), signal


@pytest.mark.parametrize("name", PLANTS)
def test_plants_run_as_model_exchange(fmi3: Path, name: str) -> None:
    """FMPy's CVode at 1e-8 agrees with the FMU's own integrator at 5e-9."""
    start = {
        "command": {"BallscrewStage": 12.0, "CompliantBallscrew": 2.0, "LinearMotor": 0.2, "NominalStage": 0.5}[name]
    }
    common: dict[str, Any] = {"stop_time": 0.02, "output_interval": 1e-3, "start_values": start, "output": ["position"]}
    path = str(fmi3 / f"{name}.fmu")
    exchange = fmpy.simulate_fmu(path, fmi_type="ModelExchange", relative_tolerance=1e-8, **common)
    simulated = fmpy.simulate_fmu(path, fmi_type="CoSimulation", **common)
    assert len(exchange) == len(simulated) == 21
    assert abs(simulated["position"][-1]) > 1e-7
    assert exchange["position"] == pytest.approx(simulated["position"], rel=1e-5, abs=1e-12)


# ---- arrays ----


def test_parameter_array_is_one_variable(native: Path, fmi3: Path) -> None:
    with Instance(fmi3 / "NctfPi.fmu") as fmu:
        table = fmu.variables["nct.error"]
        flat = [v for v in fmpy.read_model_description(native / "NctfPi.fmu").modelVariables if "nct.error[" in v.name]
        assert table.shape == (len(flat),) == (128,)
        assert fmu.fmu.getFloat64([table.valueReference], len(flat)) == [float(v.start) for v in flat]
        longer = [1.5 * float(v.start) for v in flat]
        fmu.fmu.setFloat64([table.valueReference], longer)
        assert fmu.fmu.getFloat64([table.valueReference], len(flat)) == longer
        other = fmu.variables["T_s"].valueReference
        both = fmu.fmu.getFloat64([other, table.valueReference], len(flat) + 1)
        assert both == [float(fmu.variables["T_s"].start), *longer]


def test_table_set_as_array_works_as_its_elements_do(native: Path, fmi3: Path) -> None:
    flat = [
        v for v in fmpy.read_model_description(native / "NctfPi.fmu").modelVariables if v.name.startswith("nct.rate[")
    ]
    values = [1.3 * float(v.start) for v in flat]
    elements = dict(zip([v.name for v in flat], values, strict=True)) | {"position_ref": 1e-4}
    common: dict[str, Any] = {"stop_time": 0.01, "output_interval": 1e-3, "output": ["command"]}
    one = fmpy.simulate_fmu(str(native / "NctfPi.fmu"), start_values=elements, **common)
    whole = {"nct.rate": np.array(values), "position_ref": 1e-4}
    other = fmpy.simulate_fmu(str(fmi3 / "NctfPi.fmu"), start_values=whole, **common)
    assert np.array_equal(one["command"], other["command"])
    untouched = fmpy.simulate_fmu(str(fmi3 / "NctfPi.fmu"), start_values={"position_ref": 1e-4}, **common)
    assert not np.array_equal(one["command"], untouched["command"])


def test_every_table_is_an_array(fmi3: Path) -> None:
    shapes = {
        f"{name}.{v.name}": v.shape
        for name in SAMPLED
        for v in fmpy.read_model_description(fmi3 / f"{name}.fmu").modelVariables
        if v.dimensions
    }
    tables = {f"FrictionPulse.table.{column}": (60,) for column in ("acceleration", "amplitude", "duration")}
    assert shapes == tables | {f"NctfPi.nct.{column}": (128,) for column in ("error", "rate")}


# ---- event mode: sampling instants ----


def drive(fmu: Instance, steps: int, step: float) -> Iterator[tuple[float, list[float]]]:
    """Event mode at every event; the controller's answer to the inputs of a sampling instant, read there."""
    inputs, outputs = fmu.names("input"), fmu.names("output")
    fmu.fmu.enterInitializationMode()
    fmu.fmu.exitInitializationMode()
    time, k = 0.0, 0
    while True:
        fmu.set(excitation(inputs, k))
        yield time, fmu.get(outputs)
        needed, terminate, *_, defined, following = fmu.fmu.updateDiscreteStates()
        assert not needed
        assert not terminate
        assert defined
        k += 1
        assert following == pytest.approx(k * step, rel=1e-12)
        fmu.fmu.enterStepMode()
        if k > steps:
            return
        event, terminate, early, time = fmu.fmu.doStep(time, following - time)
        assert event
        assert not terminate
        assert not early
        fmu.fmu.enterEventMode()


@pytest.mark.parametrize("name", SAMPLED)
def test_event_mode_gives_the_answer_without_delay(native: Path, fmi3: Path, name: str) -> None:
    """In event mode outputs answer the inputs of that instant: what FMI 2.0 gives when read before the step."""
    from instances import Instance as Slave

    component: Any = WORKSPACE.component(name)()
    step = float(component.T_s)
    with Instance(fmi3 / f"{name}.fmu", events=True) as fmu, Slave(native / f"{name}.fmu") as slave:
        slave.initialize()
        rows = list(drive(fmu, 30, step))
        assert len(rows) == 31
        for k, (_, row) in enumerate(rows):
            slave.set(excitation(slave.names("input"), k))
            assert slave.get(slave.names("output")) == row, k
            slave.step(k * step, step)
        assert rows[0][1] != rows[-1][1]


@pytest.mark.parametrize("early", [True, False])
def test_step_over_sampling_instants_returns_at_the_first_if_allowed(fmi3: Path, early: bool) -> None:
    with Instance(fmi3 / f"{CONTROLLER}.fmu", events=True, early=early) as fmu:
        fmu.initialize({"T_s": 1e-3})
        fmu.fmu.updateDiscreteStates()
        fmu.fmu.enterStepMode()
        event, _, returned, time = fmu.fmu.doStep(0.0, 2.5e-3)
        assert (event, returned, time) == ((True, True, 1e-3) if early else (False, False, 2.5e-3))


def test_without_event_mode_there_are_no_events(fmi3: Path) -> None:
    with Instance(fmi3 / f"{CONTROLLER}.fmu", early=True) as fmu:
        fmu.initialize()
        assert fmu.fmu.doStep(0.0, 1e-3) == (False, False, False, 1e-3)
        assert fmu.status("EnterEventMode") == ERROR
        assert "Stay in step mode" in fmu.messages[-1]


def test_fmpy_with_event_mode_gives_the_same_outputs(fmi3: Path) -> None:
    """FMPy samples twice at an event; the values right before it are those of a run without event mode."""
    path = str(fmi3 / "PPi.fmu")
    times = np.linspace(0.0, 0.01, 101)
    signals = np.array(
        [(t, 1e-3 * math.sin(500.0 * t)) for t in times], dtype=[("time", float), ("position_ref", float)]
    )
    common: dict[str, Any] = {"stop_time": 0.01, "output_interval": 1e-4, "input": signals, "output": ["command"]}
    plain = fmpy.simulate_fmu(path, **common)
    events = fmpy.simulate_fmu(path, use_event_mode=True, **common)
    before = {round(1e6 * t): v for t, v in reversed(list(zip(events["time"], events["command"], strict=True)))}
    assert len(plain) == 101
    assert len(events) == 201
    assert [before[round(1e6 * t)] for t in plain["time"][1:]] == list(plain["command"][1:])


# ---- state, derivatives ----


@pytest.mark.parametrize("name", ["BallscrewStage", CONTROLLER, "Trajectory"])
def test_state_copied_in_mid_run_resumes_bitwise(fmi3: Path, name: str) -> None:
    step = WORKSPACE.component(name).experiment.step_size

    def run(fmu: Instance, first: int, last: int) -> list[list[float]]:
        rows: list[list[float]] = []
        for k in range(first, last):
            fmu.set(excitation(fmu.names("input"), k))
            fmu.fmu.doStep(k * step, step)
            rows.append([*fmu.get(fmu.names("output")), *fmu.get(["time"])])
        return rows

    with Instance(fmi3 / f"{name}.fmu") as fmu, Instance(fmi3 / f"{name}.fmu") as other:
        fmu.initialize()
        run(fmu, 0, 30)
        saved = fmu.fmu.getFMUState()
        serial = fmu.fmu.serializeFMUState(saved)
        expected = run(fmu, 30, 60)
        assert expected[-1][-1] == pytest.approx(60 * step)
        fmu.fmu.setFMUState(saved)
        assert run(fmu, 30, 60) == expected
        other.fmu.setFMUState(other.fmu.deserializeFMUState(serial))
        assert run(other, 30, 60) == expected
        fmu.fmu.freeFMUState(saved)


@pytest.mark.parametrize("name", ["LinearMotor", "PPi"])
def test_adjoint_and_directional_derivatives_are_one_matrix(fmi3: Path, name: str) -> None:
    with Instance(fmi3 / f"{name}.fmu") as fmu:
        fmu.initialize()
        fmu.set(excitation(fmu.names("input"), 3))
        names = [*fmu.names("output"), *(name for name in fmu.variables if name.startswith("der("))]
        unknowns, knowns = fmu.references(names), fmu.references(fmu.names("input"))
        columns = [fmu.fmu.getDirectionalDerivative(unknowns, [known], [1.0]) for known in knowns]
        rows = [fmu.fmu.getAdjointDerivative([unknown], knowns, [1.0], len(knowns)) for unknown in unknowns]
        assert np.array_equal(np.array(columns).T, np.array(rows))
        assert np.any(np.array(columns))
        # Along several knowns at once, and of several unknowns: sums, up to the rounding of their few terms.
        matrix = np.array(rows)
        seed, weights = 1.0 + np.arange(len(knowns)), 1.0 - 2.0 * np.arange(len(unknowns))
        along = fmu.fmu.getDirectionalDerivative(unknowns, knowns, seed.tolist())
        assert along == pytest.approx(matrix @ seed, rel=1e-14, abs=1e-14 * np.abs(matrix).max())
        adjoint = fmu.fmu.getAdjointDerivative(unknowns, knowns, weights.tolist(), len(knowns))
        assert adjoint == pytest.approx(weights @ matrix, rel=1e-14, abs=1e-14 * np.abs(matrix).max())


def test_notes_are_told_when_initialization_and_the_run_end(fmi3: Path) -> None:
    with Instance(fmi3 / "BallscrewStage.fmu") as fmu:
        fmu.initialize({"F_C": 6.0, "F_S": 5.0})
        assert "fmi3ExitInitializationMode: F_C = 6 N.m is above F_S = 5 N.m" in fmu.messages[0]
        fmu.set({"command": 12.0})
        for k in range(3):
            fmu.fmu.doStep(k * 1e-3, 1e-3)
        assert len(fmu.messages) == 1
        fmu.fmu.terminate()
        assert "fmi3Terminate: largest_speed = " in fmu.messages[1]


# ---- refusals ----


def refs(fmu: Instance, *names: str) -> Any:
    return (ctypes.c_uint * len(names))(*fmu.references(names))


def size(n: int) -> ctypes.c_size_t:
    return ctypes.c_size_t(n)


def set_real(name: str, value: float) -> Callable[[Instance], int]:
    return lambda fmu: fmu.status("SetFloat64", refs(fmu, name), size(1), (ctypes.c_double * 1)(value), size(1))


def wrong_size(fmu: Instance) -> int:
    return fmu.status("GetFloat64", refs(fmu, "m"), size(1), (ctypes.c_double * 2)(), size(2))


def wrong_type(fmu: Instance) -> int:
    return fmu.status("GetInt32", refs(fmu, "m"), size(1), (ctypes.c_int * 1)(), size(1))


def step(fmu: Instance) -> int:
    flags = [ctypes.byref(ctypes.c_bool()) for _ in range(3)]
    return fmu.status(
        "DoStep",
        ctypes.c_double(0.0),
        ctypes.c_double(math.nan),
        ctypes.c_bool(True),
        *flags,
        ctypes.byref(ctypes.c_double()),
    )


REFUSED: dict[str, tuple[Callable[[Instance], int], int, str]] = {
    "value out of bounds": (set_real("m", -1.0), DISCARD, "fmi3SetFloat64: m = -1 kg: below its minimum"),
    "value not finite": (set_real("command", math.inf), DISCARD, "command = inf N.m: must be finite"),
    "output set": (set_real("position", 1.0), ERROR, "position is computed by the FMU"),
    "time set": (set_real("time", 1.0), ERROR, "time is computed by the FMU"),
    "wrong number of values": (wrong_size, ERROR, "2 values, but the variables have 1 elements"),
    "wrong type": (wrong_type, ERROR, "is of type Float64. Use fmi3GetFloat64 or fmi3SetFloat64."),
    "step of nan": (
        step,
        ERROR,
        "fmi3DoStep: not allowed in state 'instantiated'. Follow the FMI 3.0 calling sequence",
    ),
    "configuration": (lambda f: f.status("EnterConfigurationMode"), ERROR, "there are no structural parameters"),
    "clock": (
        lambda f: f.status("GetIntervalDecimal", refs(f, "m"), size(1), (ctypes.c_double * 1)(), (ctypes.c_int * 1)()),
        ERROR,
        "there are no clocks, a sampling instant is an event",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_wrong_calls_are_refused_with_a_message(fmi3: Path, case: str) -> None:
    call, status, text = REFUSED[case]
    with Instance(fmi3 / "BallscrewStage.fmu") as fmu:
        assert call(fmu) == status
        assert text in fmu.messages[-1]


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"token": "wrong"}, "instantiationToken is 'wrong'"),
        ({"events": True}, "there is no event mode"),
    ],
)
def test_instance_that_cannot_be_is_refused(fmi3: Path, options: dict[str, Any], text: str) -> None:
    fmu = Instance(fmi3 / "BallscrewStage.fmu", **options)
    with pytest.raises(Exception, match="Failed to instantiate"):
        fmu.__enter__()
    assert text in fmu.messages[-1]
    fmu.fmu.freeLibrary()
    fmu.folder.cleanup()


def test_start_values_can_be_read_before_initialization(fmi3: Path) -> None:
    with Instance(fmi3 / "BallscrewStage.fmu") as fmu:
        assert fmu.get(["m"]) == [float(fmu.variables["m"].start)]
        assert fmu.status("Terminate") == ERROR
        assert fmu.status("Reset") == OK
        fmu.initialize()


def test_fmi3_and_pythonfmu_do_not_go_together() -> None:
    command = [sys.executable, str(ROOT / "build_fmus.py"), "--fmi", "3", "--flavour", "python"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "PythonFMU makes FMI 2.0 only" in done.stderr
