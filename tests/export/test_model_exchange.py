"""Plants as FMI 2.0 model exchange: integrated by others' solvers they run as in co-simulation."""

from __future__ import annotations

import ctypes
import math
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import fmpy
import numpy as np
import pytest
from conftest import WORKSPACE
from fmpy.fmi2 import FMU2Model, fmi2CallbackFunctions, fmi2CallbackLoggerTYPE, fmi2EventInfo
from instances import DISCARD, ERROR, OK, Instance
from scipy.integrate import Radau, solve_ivp

PLANTS = {
    "BallscrewStage": {"command": 12.0, "load_torque": 0.5},
    "CompliantBallscrew": {"command": 2.0, "load_force": 5.0},
    "LinearMotor": {"command": 0.2, "disturbance_force": 0.3},
    "NominalStage": {"command": 0.5},
}
"""Inputs, held, that move each plant."""
STOP = 0.02


class Model:
    """A model-exchange instance; messages are collected."""

    def __init__(self, path: Path, folder: str) -> None:
        fmpy.extract(path, unzipdir=folder)
        self.description = fmpy.read_model_description(folder)
        self.references = {v.name: v.valueReference for v in self.description.modelVariables}
        self.messages: list[str] = []
        self.fmu = FMU2Model(
            guid=self.description.guid,
            unzipDirectory=folder,
            modelIdentifier=self.description.modelExchange.modelIdentifier,
            instanceName="model",
        )
        self._log = fmi2CallbackLoggerTYPE(lambda *said: self.messages.append(said[4].decode()))
        self.callbacks = fmi2CallbackFunctions(logger=self._log)
        self.fmu.instantiate(callbacks=self.callbacks, loggingOn=True)
        self.n = self.description.numberOfContinuousStates

    def initialize(self, values: dict[str, float], start: float = 0.0) -> None:
        self.fmu.setupExperiment(startTime=start)
        self.fmu.setReal([self.references[name] for name in values], list(values.values()))
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()

    def go_on(self) -> None:
        info = fmi2EventInfo()
        self.fmu.fmi2NewDiscreteStates(self.fmu.component, ctypes.byref(info))
        assert not info.newDiscreteStatesNeeded
        assert not info.nextEventTimeDefined
        self.fmu.enterContinuousTimeMode()

    def states(self) -> np.ndarray:
        x = (ctypes.c_double * self.n)()
        self.fmu.getContinuousStates(x, self.n)
        return np.array(x)

    def derivative(self, t: float, x: np.ndarray) -> np.ndarray:
        self.fmu.setTime(t)
        self.fmu.setContinuousStates((ctypes.c_double * self.n)(*x), self.n)
        rates = (ctypes.c_double * self.n)()
        self.fmu.getDerivatives(rates, self.n)
        return np.array(rates)

    def status(self, function: str, *arguments: object) -> int:
        raw = self.fmu.dll[f"fmi2{function}"]
        raw.restype = ctypes.c_int
        return raw(ctypes.c_void_p(self.fmu.component), *arguments)


@contextmanager
def model(path: Path) -> Iterator[Model]:
    with TemporaryDirectory() as folder:
        instance = Model(path, folder)
        try:
            yield instance
        finally:
            instance.fmu.freeInstance()


def co_simulated(path: Path, inputs: dict[str, float], tolerance: float) -> dict[str, float]:
    """Outputs at STOP after one communication step."""
    with Instance(path) as fmu:
        fmu.initialize({"tolerance": tolerance, **inputs})
        fmu.step(0.0, STOP)
        names = fmu.names("output")
        return dict(zip(names, fmu.get(names), strict=True))


@pytest.mark.parametrize("name", sorted(PLANTS))
def test_description_offers_both(native: Path, name: str) -> None:
    description = fmpy.read_model_description(native / f"{name}.fmu")
    assert description.modelExchange.modelIdentifier == description.coSimulation.modelIdentifier == name
    assert description.numberOfEventIndicators == 0
    assert description.modelExchange.providesDirectionalDerivative
    with zipfile.ZipFile(native / f"{name}.fmu") as archive:
        text = archive.read("modelDescription.xml").decode()
    needed = "false" if "Ballscrew" in name else "true"  # these have discrete states
    assert f'completedIntegratorStepNotNeeded="{needed}"' in text


@pytest.mark.parametrize("name", sorted(PLANTS))
def test_fmpy_integrates_to_the_co_simulated_outputs(native: Path, name: str) -> None:
    """CVode at 1e-8 against RODAS at 1e-10: equal to 1e-5 of each output, friction and all."""
    path = native / f"{name}.fmu"
    expected = co_simulated(path, PLANTS[name], 1e-10)
    result = fmpy.simulate_fmu(
        str(path),
        fmi_type="ModelExchange",
        stop_time=STOP,
        output_interval=1e-3,
        relative_tolerance=1e-8,
        start_values=PLANTS[name],
        output=list(expected),
    )
    assert result["time"][-1] == pytest.approx(STOP)
    for output, value in expected.items():
        assert result[output][-1] == pytest.approx(value, rel=1e-5, abs=1e-9), output


@pytest.mark.parametrize("name", sorted(PLANTS))
def test_scipy_integrates_to_the_co_simulated_outputs(native: Path, name: str) -> None:
    """Radau at 1e-9 on fmi2GetDerivatives, absolute tolerances from the nominals that the FMU gives."""
    path = native / f"{name}.fmu"
    expected = co_simulated(path, PLANTS[name], 1e-10)
    with model(path) as instance:
        instance.initialize(PLANTS[name])
        instance.go_on()
        nominals = (ctypes.c_double * instance.n)()
        assert instance.status("GetNominalsOfContinuousStates", nominals, ctypes.c_size_t(instance.n)) == OK
        assert min(nominals) > 0.0
        solution = solve_ivp(
            instance.derivative,
            (0.0, STOP),
            instance.states(),
            method="Radau",
            rtol=1e-9,
            atol=[1e-11 * nominal for nominal in nominals],
        )
        assert solution.success
        instance.derivative(STOP, solution.y[:, -1])
        instance.fmu.completedIntegratorStep()
        for output, value in expected.items():
            found = instance.fmu.getReal([instance.references[output]])[0]
            assert found == pytest.approx(value, rel=1e-6, abs=1e-10), output


def test_discrete_states_follow_completed_steps_only(native: Path) -> None:
    """The table with play stays until a step is completed; trial points of a solver leave it alone."""
    with model(native / "BallscrewStage.fmu") as instance:
        instance.initialize({"play_positive": 1e-6, "play_negative": 1e-6})
        instance.go_on()
        table = instance.references["table"]
        moved = instance.states()
        moved[0] = 1.0
        instance.derivative(1e-3, moved)
        assert instance.fmu.getReal([table])[0] == 0.0
        assert instance.fmu.completedIntegratorStep() == (0, 0)
        lead = instance.fmu.getReal([instance.references["l_p"]])[0]
        assert instance.fmu.getReal([table])[0] == pytest.approx(lead - 1e-6, rel=1e-12)


def test_directional_derivatives_are_those_of_the_derivatives(native: Path) -> None:
    with model(native / "LinearMotor.fmu") as instance:
        instance.initialize(PLANTS["LinearMotor"])
        instance.go_on()
        x = instance.states() + 1e-3
        rows = [v for v in instance.description.modelVariables if v.derivative is not None]
        step = 1e-6
        for k, column in enumerate(rows):
            moved = x.copy()
            moved[k] += step
            difference = (instance.derivative(0.0, moved) - instance.derivative(0.0, x)) / step
            found = instance.fmu.getDirectionalDerivative(
                [row.valueReference for row in rows], [column.derivative.valueReference], [1.0]
            )
            assert found == pytest.approx(difference, rel=1e-4, abs=1e-6)


def test_state_is_saved_and_belongs_to_its_kind(native: Path) -> None:
    path = native / "LinearMotor.fmu"
    with model(path) as instance, Instance(path) as other:
        instance.initialize(PLANTS["LinearMotor"])
        instance.go_on()
        expected = instance.derivative(0.0, instance.states())
        saved = instance.fmu.getFMUstate()
        instance.derivative(1.0, instance.states() + 1.0)
        instance.fmu.setFMUstate(saved)
        rates = (ctypes.c_double * instance.n)()
        instance.fmu.getDerivatives(rates, instance.n)
        assert list(rates) == list(expected)
        other.initialize()
        assert other.status("SetFMUstate", saved) == ERROR
        assert "that of an instance for model exchange" in other.messages[-1]


def test_reset_begins_again(native: Path) -> None:
    with model(native / "LinearMotor.fmu") as instance:
        instance.initialize(PLANTS["LinearMotor"])
        instance.go_on()
        first = instance.states()
        instance.derivative(1.0, first + 1.0)
        instance.fmu.reset()
        instance.initialize(PLANTS["LinearMotor"])
        instance.go_on()
        assert (instance.states() == first).all()


# ---- refusals ----


def test_controllers_and_sources_are_for_co_simulation_only(native: Path) -> None:
    for name, path in WORKSPACE.components().items():
        if path.parent.name == "plant":
            continue
        description = fmpy.read_model_description(native / f"{name}.fmu")
        assert description.modelExchange is None
    with TemporaryDirectory() as folder:
        fmpy.extract(native / "PPi.fmu", unzipdir=folder)
        fmu = FMU2Model(guid=description.guid, unzipDirectory=folder, modelIdentifier="PPi", instanceName="model")
        with pytest.raises(Exception, match="instantiate"):
            fmu.instantiate()


def test_wrong_lengths_and_values_are_refused(native: Path) -> None:
    with model(native / "LinearMotor.fmu") as instance:
        instance.initialize({})
        instance.go_on()
        kept = instance.states()
        bad = (ctypes.c_double * instance.n)(*([math.nan] * instance.n))
        assert instance.status("SetContinuousStates", bad, ctypes.c_size_t(instance.n)) == DISCARD
        assert "must be finite" in instance.messages[-1]
        assert (instance.states() == kept).all()
        assert instance.status("GetEventIndicators", bad, ctypes.c_size_t(0)) == OK
        assert instance.status("GetDerivatives", bad, ctypes.c_size_t(instance.n + 1)) == ERROR
        assert "Pass one of that length" in instance.messages[-1]


@pytest.mark.parametrize(
    ("function", "arguments"),
    [
        ("DoStep", (ctypes.c_double(0.0), ctypes.c_double(1e-3), ctypes.c_int(1))),
        ("EnterContinuousTimeMode", ()),
        ("NewDiscreteStates", (ctypes.byref(fmi2EventInfo()),)),
        ("EnterInitializationMode", ()),
    ],
)
def test_calls_out_of_place_are_errors(native: Path, function: str, arguments: tuple[object, ...]) -> None:
    with model(native / "LinearMotor.fmu") as instance:
        instance.initialize({})
        instance.go_on()
        assert instance.status(function, *arguments) == ERROR
        assert f"fmi2{function}: not allowed in state 'continuous-time mode'" in instance.messages[-1]


def test_tunable_parameters_wait_for_event_mode(native: Path) -> None:
    with model(native / "BallscrewStage.fmu") as instance:
        instance.initialize({})
        instance.go_on()
        instance.fmu.enterEventMode()
        scale = instance.references["friction_scale"]
        instance.fmu.setReal([scale], [1.1])
        instance.go_on()
        value = (ctypes.c_double * 1)(1.2)
        assert instance.status("SetReal", (ctypes.c_uint * 1)(scale), ctypes.c_size_t(1), value) == ERROR
        assert "Set it in event mode" in instance.messages[-1]


def test_time_must_be_finite(native: Path) -> None:
    with model(native / "NominalStage.fmu") as instance:
        instance.initialize({})
        instance.go_on()
        assert instance.status("SetTime", ctypes.c_double(math.nan)) == ERROR
        assert "Give a finite time" in instance.messages[-1]


def test_maxwell_slip_runs_where_every_step_is_completed(native: Path) -> None:
    """Its elements' flags are discrete states that follow each step: Radau of 5 us, each step told to the FMU.

    Steps of a solver that knows no events straddle the four changes of mode: an error of the order of 1e-4 is left.
    """
    path, inputs = native / "BallscrewStageMaxwellSlip.fmu", {"command": 12.0}
    expected = co_simulated(path, inputs, 1e-9)
    with model(path) as instance:
        instance.initialize(inputs)
        instance.go_on()
        solver = Radau(
            instance.derivative, 0.0, instance.states(), STOP, max_step=5e-6, rtol=1e-8, atol=1e-12, first_step=1e-7
        )
        while solver.status == "running":
            assert solver.step() is None
            instance.derivative(solver.t, solver.y)
            instance.fmu.completedIntegratorStep()
        slips = instance.fmu.getReal([instance.references[f"slips[{i}]"] for i in range(1, 5)])
        found = instance.fmu.getReal([instance.references[name] for name in expected])
    assert slips == [1.0] * 4
    assert found == pytest.approx(list(expected.values()), rel=1e-3)
