"""The runtime as an importer meets it: life cycle, refusals, FMU state, sampling, any communication step."""

from __future__ import annotations

import ctypes
import math
import re
import threading
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from conftest import WORKSPACE
from instances import DISCARD, ERROR, OK, Instance, excite, run

COMPONENTS = sorted(WORKSPACE.components())
NAN, INF = math.nan, math.inf
PLANT, CONTROLLER = "BallscrewStage", "FuzzySlidingMode"


# ---- FMU state ----


@pytest.fixture(params=["native", "python"])
def fmus(request: pytest.FixtureRequest) -> Path:
    """The folder of the FMUs of each flavour."""
    return request.getfixturevalue(request.param)


@pytest.mark.parametrize("name", COMPONENTS)
def test_state_copied_in_mid_run_resumes_bitwise(fmus: Path, name: str) -> None:
    step = WORKSPACE.component(name).experiment.step_size
    half = 50 if fmus.name == "native" else 5
    with Instance(fmus / f"{name}.fmu") as fmu, Instance(fmus / f"{name}.fmu", "other") as other:
        fmu.initialize()
        run(fmu, 0, half, step)
        saved = fmu.fmu.getFMUstate()
        serial = fmu.fmu.serializeFMUstate(saved)
        expected = run(fmu, half, 2 * half, step)
        fmu.fmu.setFMUstate(saved)
        assert run(fmu, half, 2 * half, step) == expected
        other.fmu.setFMUstate(other.fmu.deSerializeFMUstate(serial))
        assert run(other, half, 2 * half, step) == expected


@pytest.mark.parametrize("name", COMPONENTS)
def test_reset_is_a_fresh_instance_bitwise(fmus: Path, name: str) -> None:
    step = WORKSPACE.component(name).experiment.step_size
    steps = 50 if fmus.name == "native" else 5
    with Instance(fmus / f"{name}.fmu") as fmu:
        fmu.initialize()
        expected = run(fmu, 0, steps, step)
        fmu.fmu.reset()
        fmu.initialize()
        assert run(fmu, 0, steps, step) == expected


@pytest.mark.parametrize("bytes_of", ["another FMU", "noise"])
def test_foreign_state_is_refused(fmus: Path, bytes_of: str) -> None:
    with Instance(fmus / "PPi.fmu") as one, Instance(fmus / f"{PLANT}.fmu") as other:
        serial = one.fmu.serializeFMUstate(one.fmu.getFMUstate()) if bytes_of == "another FMU" else b"x" * 100
        target = ctypes.c_void_p()
        status = other.status("DeSerializeFMUstate", serial, ctypes.c_size_t(len(serial)), ctypes.byref(target))
        assert status == ERROR
        assert "no state of this FMU" in other.messages[-1]


def test_freed_state_becomes_null_and_null_may_be_freed(fmus: Path) -> None:
    with Instance(fmus / "PPi.fmu") as fmu:
        saved = fmu.fmu.getFMUstate()
        assert fmu.status("FreeFMUstate", ctypes.byref(saved)) == OK
        assert not saved.value
        assert fmu.status("FreeFMUstate", ctypes.byref(saved)) == OK


# ---- any communication step ----


@pytest.mark.parametrize("factor", [0.25, 4.0])
@pytest.mark.parametrize("name", COMPONENTS)
def test_communication_step_is_free(native: Path, name: str, factor: float) -> None:
    """With inputs constant over 4 T_s, steps of T_s/4, T_s and 4 T_s agree: samples exactly, plants to tolerance."""
    step = WORKSPACE.component(name).experiment.step_size
    traces: list[list[float]] = []
    for h in (step, factor * step):
        with Instance(native / f"{name}.fmu") as fmu:
            fmu.initialize({"tolerance": 1e-9} if "tolerance" in fmu.variables else {})
            per_block = round(4 * step / h)
            for block in range(25):
                excite(fmu, block)
                for i in range(per_block):
                    fmu.step((block * per_block + i) * h, h)
            traces.append(fmu.get(fmu.names("output")))
    for one, other in zip(*traces, strict=True):
        assert one == pytest.approx(other, rel=1e-5, abs=1e-11)


def test_controller_samples_on_its_own_hits_only(native: Path) -> None:
    with Instance(native / "PPi.fmu") as fmu:
        fmu.initialize({"T_s": 1e-3})
        commands = []
        for k in range(8):
            fmu.set({"position_ref": 1e-6 * (k + 1)})
            fmu.step(k * 0.25e-3, 0.25e-3)
            commands.append(fmu.get(["command"])[0])
        assert commands[0] == commands[1] == commands[2] == commands[3] != commands[4]
        assert commands[4] == commands[5] == commands[6] == commands[7]


def test_controller_output_answers_new_inputs_at_a_hit_before_the_step(native: Path) -> None:
    with Instance(native / "PPi.fmu") as fmu, Instance(native / "PPi.fmu") as stepped:
        for each in (fmu, stepped):
            each.initialize()
            each.set({"position_ref": 1e-6})
        asked = fmu.get(["command"])
        stepped.step(0.0, 1e-4)
        assert asked == stepped.get(["command"])
        fmu.step(0.0, 1e-4)
        assert asked == fmu.get(["command"])
        fmu.set({"position_ref": 2e-6})
        assert fmu.get(["command"]) != asked


def test_sampling_counts_from_the_start_time(native: Path) -> None:
    traces = []
    for start in (0.0, 0.37):
        with Instance(native / "PPi.fmu") as fmu:
            fmu.initialize(start=start)
            trace = []
            for k in range(40):
                excite(fmu, k)
                fmu.step(start + k * 0.25e-4, 0.25e-4)
                trace.append(fmu.get(["command"])[0])
            traces.append(trace)
    assert traces[0] == traces[1]


# ---- refusals ----

Call = Callable[[Instance], int]


def initialized(fmu: Instance) -> Instance:
    fmu.initialize()
    return fmu


REFUSED: dict[str, tuple[str, Call, int, str]] = {
    "input is NaN": (
        PLANT,
        lambda f: initialized(f).set_status("command", NAN),
        DISCARD,
        "test: fmi2SetReal: command = nan N.m: must be finite. The previous value 0 is kept.",
    ),
    "input is infinite": (
        CONTROLLER,
        lambda f: initialized(f).set_status("position", -INF),
        DISCARD,
        "test: fmi2SetReal: position = -inf m: must be finite.",
    ),
    "parameter is NaN": (PLANT, lambda f: f.set_status("m", NAN), DISCARD, "m = nan kg: must be finite"),
    "parameter below its minimum": (PLANT, lambda f: f.set_status("m", -1.0), DISCARD, "m = -1 kg: below its minimum"),
    "enumeration out of range": (
        CONTROLLER,
        lambda f: f.set_status("velocity_source", 9),
        DISCARD,
        "above its maximum",
    ),
    "fixed parameter during the run": (
        PLANT,
        lambda f: initialized(f).set_status("m", 60.0),
        ERROR,
        "m is a fixed parameter. Set it before initialization ends.",
    ),
    "output set": (PLANT, lambda f: f.set_status("position", 1.0), ERROR, "position is computed by the FMU"),
    "zero step": (PLANT, lambda f: initialized(f).step_status(0.0, 0.0), ERROR, "communication step size 0 s"),
    "negative step": (PLANT, lambda f: initialized(f).step_status(0.0, -1e-4), ERROR, "Give a positive, finite one"),
    "step is NaN": (CONTROLLER, lambda f: initialized(f).step_status(0.0, NAN), ERROR, "communication step size nan s"),
    "step is infinite": (
        CONTROLLER,
        lambda f: initialized(f).step_status(0.0, INF),
        ERROR,
        "communication step size inf",
    ),
    "time is not where the last step ended": (
        PLANT,
        lambda f: initialized(f).step_status(0.5, 1e-4),
        ERROR,
        "current communication point 0.5 s, but the instance is at 0 s",
    ),
    "step before initialization": (
        PLANT,
        lambda f: f.step_status(0.0, 1e-4),
        ERROR,
        "fmi2DoStep: not allowed in state 'instantiated'. Follow the FMI 2.0 calling sequence, or reset",
    ),
    "initialization twice": (
        PLANT,
        lambda f: initialized(f).status("EnterInitializationMode"),
        ERROR,
        "fmi2EnterInitializationMode: not allowed in state 'step complete'",
    ),
    "unknown value reference": (
        PLANT,
        lambda f: initialized(f).status(
            "GetReal", (ctypes.c_uint * 1)(9999), ctypes.c_size_t(1), (ctypes.c_double * 1)()
        ),
        ERROR,
        "unknown value reference 9999. BallscrewStage has 0 to",
    ),
    "wrong type": (
        PLANT,
        lambda f: initialized(f).status(
            "GetInteger", (ctypes.c_uint * 1)(f.reference("m")), ctypes.c_size_t(1), (ctypes.c_int * 1)()
        ),
        ERROR,
        "is of type Real. Use fmi2GetReal",
    ),
    "NULL array": (
        PLANT,
        lambda f: initialized(f).status("GetReal", (ctypes.c_uint * 1)(0), ctypes.c_size_t(1), None),
        ERROR,
        "fmi2GetReal: an argument is NULL",
    ),
    "input derivatives": (
        PLANT,
        lambda f: initialized(f).status("SetRealInputDerivatives", None, ctypes.c_size_t(1), None, None),
        ERROR,
        "canInterpolateInputs is false",
    ),
    "cancel": (PLANT, lambda f: initialized(f).status("CancelStep"), ERROR, "no step is in progress"),
    "unknown log category": (
        PLANT,
        lambda f: f.status("SetDebugLogging", ctypes.c_int(1), ctypes.c_size_t(1), (ctypes.c_char_p * 1)(b"chatter")),
        ERROR,
        "unknown category 'chatter'",
    ),
    "stop before start": (
        PLANT,
        lambda f: f.status(
            "SetupExperiment",
            ctypes.c_int(0),
            ctypes.c_double(0.0),
            ctypes.c_double(1.0),
            ctypes.c_int(1),
            ctypes.c_double(0.5),
        ),
        ERROR,
        "give finite times, stop after start",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_bad_input_is_refused_with_a_message(native: Path, case: str) -> None:
    name, call, status, text = REFUSED[case]
    with Instance(native / f"{name}.fmu") as fmu:
        assert call(fmu) == status
        assert text in fmu.messages[-1]


def test_refused_value_leaves_the_instance_usable(native: Path) -> None:
    with Instance(native / f"{PLANT}.fmu") as fmu:
        fmu.initialize()
        fmu.set({"command": 7.0})
        assert fmu.set_status("command", NAN) == DISCARD
        assert fmu.get(["command"]) == [7.0]
        fmu.step(0.0, 1e-4)


def test_failed_instance_can_be_reset(native: Path) -> None:
    with Instance(native / f"{PLANT}.fmu") as fmu:
        assert fmu.step_status(0.0, 1e-4) == ERROR
        assert fmu.status("EnterInitializationMode") == ERROR
        fmu.fmu.reset()
        fmu.initialize()
        fmu.step(0.0, 1e-4)


def test_rule_between_parameters_is_checked_when_initialization_ends(native: Path) -> None:
    with Instance(native / f"{PLANT}.fmu") as fmu:
        fmu.fmu.setupExperiment()
        fmu.set({"F_S": 1.0, "F_C": 0.0})
        fmu.fmu.enterInitializationMode()
        assert fmu.status("ExitInitializationMode") == ERROR
        assert "F_S" in fmu.messages[-1]


def test_wrong_guid_gives_no_instance_and_a_message(native: Path) -> None:
    instance = Instance(native / "PPi.fmu", guid="{wrong %n}")
    with pytest.raises(Exception, match="instantiate"):
        instance.__enter__()
    # importers that format a message must not find a conversion in it
    assert "fmi2Instantiate: guid is '{wrong #n}', this FMU has" in instance.messages[0]


def test_errors_are_logged_even_when_logging_is_off_and_nothing_else(native: Path) -> None:
    with Instance(native / f"{PLANT}.fmu", logging=False) as fmu:
        assert fmu.set_status("m", -1.0) == DISCARD
        assert fmu.messages == []
        assert fmu.step_status(0.0, 1e-4) == ERROR
        assert len(fmu.messages) == 1
        fmu.fmu.reset()
        fmu.initialize()
        fmu.step(0.0, 1e-4)
        assert len(fmu.messages) == 1


def test_only_chosen_categories_are_logged(native: Path) -> None:
    with Instance(native / f"{PLANT}.fmu") as fmu:
        fmu.fmu.setDebugLogging(True, ["logStatusError"])
        assert fmu.set_status("m", -1.0) == DISCARD
        assert fmu.messages == []
        assert fmu.step_status(0.0, 1e-4) == ERROR
        assert len(fmu.messages) == 1


def test_integration_failure_is_discard_with_time_reached(native: Path) -> None:
    """A command of 1e300 N.m drives the speed beyond the range of doubles."""
    with Instance(native / f"{PLANT}.fmu") as fmu:
        fmu.initialize()
        fmu.set({"command": 1e306})
        status = next(s for k in range(100) if (s := fmu.step_status(k * 1.0, 1.0)) != OK)
        assert status == DISCARD
        assert re.search(r"integration with tolerance 5e-09 stopped at t = \S+ s, at ", fmu.messages[-1])
        assert fmu.messages[-1].endswith("Check inputs and parameters, or make the tolerance smaller.")
        assert 0.0 <= fmu.fmu.getRealStatus(2) < 100.0
        fmu.fmu.terminate()


def test_a_tolerance_that_rounding_does_not_reach_is_to_be_made_larger(native: Path) -> None:
    """Where an element of Maxwell slip begins to slip, its rate jumps."""
    with Instance(native / "BallscrewStageMaxwellSlip.fmu") as fmu:
        fmu.initialize({"tolerance": 1e-12})
        for k in range(100):
            fmu.set({"command": 12.0 * math.sin(0.1257 * k)})
            if fmu.step_status(k * 1e-2, 1e-2) != OK:
                break
        assert "with tolerance 1e-12 stopped" in fmu.messages[-1]
        assert (
            "the step size became too small. Check inputs and parameters, or make the tolerance larger."
            in (fmu.messages[-1])
        )


def test_a_step_of_too_much_work_is_to_be_made_shorter(native: Path) -> None:
    """A friction that swings a million times."""
    with Instance(native / f"{PLANT}.fmu") as fmu:
        fmu.initialize({"drift_amplitude": 0.5, "drift_frequency": 1e3})
        fmu.set({"command": 12.0})
        assert fmu.step_status(0.0, 1e3) == DISCARD
        assert fmu.messages[-1].endswith(
            "too many steps. Check inputs and parameters, or make the communication step shorter."
        )


# ---- tolerance, instances, threads ----


def test_tolerance_of_the_experiment_is_used_unless_the_parameter_is_set(native: Path) -> None:
    with Instance(native / f"{PLANT}.fmu") as fmu:
        default = fmu.description.defaultExperiment.tolerance
        for given, parameter, expected in ((1e-4, None, 1e-4), (1e-4, 1e-8, 1e-8), (None, None, float(default))):
            fmu.fmu.reset()
            fmu.initialize({} if parameter is None else {"tolerance": parameter}, tolerance=given)
            assert fmu.get(["tolerance"]) == [expected]


def test_instances_are_independent_in_threads(native: Path) -> None:
    step = 1e-4
    with Instance(native / f"{PLANT}.fmu") as alone:
        alone.initialize()
        expected = run(alone, 0, 200, step)
    results: dict[int, Any] = {}
    with ExitStack() as stack:
        instances = [stack.enter_context(Instance(native / f"{PLANT}.fmu", f"plant{i}")) for i in range(4)]

        def work(i: int) -> None:
            instances[i].initialize()
            results[i] = run(instances[i], 0, 200, step)

        threads = [threading.Thread(target=work, args=(i,)) for i in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert [results[i] == expected for i in range(4)] == [True] * 4


def test_many_instantiations_do_not_grow(native: Path) -> None:
    resource = pytest.importorskip("resource", reason="the resource module exists on POSIX only")
    with Instance(native / f"{PLANT}.fmu") as fmu:

        def cycle(times: int) -> int:
            for _ in range(times):
                fmu.fmu.fmi2FreeInstance(fmu.fmu.component)
                fmu.fmu.instantiate(callbacks=fmu.callbacks)
                fmu.initialize()
                fmu.step(0.0, 1e-3)
            return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss

        before = cycle(200)
        assert cycle(2000) - before < 1000  # kB; an instance leaked each time would be 2000 * 2 kB
