"""The master against closed forms and recursions written down here, and everything that can stop a run."""

from __future__ import annotations

import ctypes
import math
import os
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Mapping
from dataclasses import replace
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmu_files import PROBE, probe_library, write_fmu, write_probe

from cosim import (
    DescriptionError,
    Interrupted,
    Result,
    SignalError,
    Simulation,
    SimulationError,
    System,
    make_system,
    simulate,
)
from cosim.export.package import build
from cosim.master.instance import CallError
from cosim.model import Controller, Plant, Record, parameter, variable
from cosim.record.description import Column
from cosim.record.write import check_output

CACHE = Path(__file__).parents[2] / "build" / "cache"


class Lag(Plant):
    """First-order lag: der(position) = (gain*command - position)/time_constant."""

    gain: float = parameter(1.0, "m/V", "Static gain")
    time_constant: float = parameter(0.1, "s", "Time constant", min=1e-6)
    start: float = parameter(0.0, "m", "Position at the start")

    class State(Record):
        position: float = variable(0.0, "m", "Position")

    class Input(Record):
        command: float = variable(0.0, "V", "Command")

    class Output(Record):
        position: float = variable(0.0, "m", "Position")

    def initial(self) -> State:
        return self.State(position=self.start)

    def derivative(self, t: float, x: State, u: Input) -> State:
        return self.State(position=(self.gain * u.command - x.position) / self.time_constant)

    def output(self, t: float, x: State, u: Input) -> Output:
        return self.Output(position=x.position)


class Integrating(Controller):
    """PI: command = K*(reference - position) + sum, sum[k+1] = sum[k] + I*T_s*(reference - position)."""

    gain: float = parameter(2.0, "V/m", "Proportional gain K")
    integral: float = parameter(10.0, "V/(m.s)", "Integral gain I")
    start: float = parameter(0.0, "V", "Sum at the start")

    class State(Record):
        sum: float = variable(0.0, "V", "Sum")

    class Input(Record):
        reference: float = variable(0.0, "m", "Reference")
        position: float = variable(0.0, "m", "Measured position")

    class Output(Record):
        command: float = variable(0.0, "V", "Command")

    def initial(self) -> State:
        return self.State(sum=self.start)

    def output(self, t: float, x: State, u: Input) -> Output:
        return self.Output(command=self.gain * (u.reference - u.position) + x.sum)

    def update(self, t: float, x: State, u: Input, y: Output) -> State:
        return self.State(sum=x.sum + self.integral * self.T_s * (u.reference - u.position))


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("fmus")
    write_probe(folder)
    for kind in (Lag, Integrating):
        build(kind, folder, CACHE)
    return folder


Make = Callable[..., System]


@pytest.fixture
def make(fmus: Path) -> Make:
    def made(
        instances: Mapping[str, Mapping[str, Any]], *connections: Any, record: Any = None, **experiment: Any
    ) -> System:
        document: dict[str, Any] = {
            "connections": list(connections),
            "experiment": {"stop_time": 1.0, "step_size": 0.1, **experiment},
            "instances": {name: {"fmu": "Probe", **table} for name, table in instances.items()},
        }
        if record is not None:
            document["record"] = record
        return make_system(document, fmus=fmus)

    return made


def lag(gain: float, h: float = 0.1, time_constant: float = 0.1) -> tuple[float, float]:
    """(E, G) of a lag under a held input: y[k+1] = E*y[k] + G*u[k]."""
    decay = math.exp(-h / time_constant)
    return decay, gain * (1.0 - decay)


# Time and algorithm


def test_a_tenth_to_one_makes_ten_steps(make: Make) -> None:
    result = simulate(make({"a": {}}))
    assert result.metadata["steps"] == 10
    assert result.solver["a"]["steps"] == 10
    assert result.time.tolist() == [k * 0.1 for k in range(11)]


@pytest.mark.parametrize(("start", "step", "steps"), [("0.3", "0.1", 7), ("-1", "1e-3", 3000), ("0", "0.7", 30)])
def test_time_is_one_multiplication(make: Make, start: str, step: str, steps: int) -> None:
    stop = Decimal(start) + steps * Decimal(step)
    system = make({"a": {}}, start_time=Decimal(start), stop_time=stop, step_size=Decimal(step))
    result = simulate(system)
    expected = [float(start) + k * float(step) for k in range(steps + 1)]
    assert result.time.tolist() == expected
    ends = [t + float(step) for t in expected[:-1]]
    assert result["a.clock"].tolist() == [float(start), *ends]


@pytest.mark.parametrize("order", ["sequential", "parallel"])
def test_two_coupled_lags_follow_the_closed_form(make: Make, order: str) -> None:
    system = make(
        {"a": {"start": {"y_start": 1.0}}, "b": {"start": {"gain": -2.0, "time_constant": 0.3, "y_start": 0.5}}},
        "a.y -> b.u",
        "b.y -> a.u",
        stop_time=5.0,
        order=order,
    )
    result = simulate(system)
    (e, g), (f, h) = lag(1.0), lag(-2.0, time_constant=0.3)
    transition = np.array([[e, g], [h, f]])
    for k in range(51):
        expected = np.linalg.matrix_power(transition, k) @ [1.0, 0.5]
        assert (result["a.y"][k], result["b.y"][k]) == pytest.approx(expected, abs=1e-13)


@pytest.mark.parametrize("order", ["sequential", "parallel", ["plant", "controller"]])
def test_a_steady_state_stays_steady_from_the_first_sample(make: Make, order: Any) -> None:
    """The controller's output at the start is computed from the plant's real start, in every order."""
    system = make(
        {
            "controller": {"fmu": "Integrating", "start": {"T_s": 0.1, "start": 3.0, "reference": 3.0}},
            "plant": {"fmu": "Lag", "start": {"start": 3.0}},
        },
        "plant.position -> controller.position",
        "controller.command -> plant.command",
        order=order,
    )
    result = simulate(system)
    assert result["plant.position"] == pytest.approx(3.0, abs=1e-9)
    assert result["controller.command"] == pytest.approx(3.0, abs=1e-9)


def test_start_values_survive(make: Make) -> None:
    start = {
        "gain": 4.0,
        "time_constant": 0.5,
        "y_start": 7.0,
        "u": 1.5,
        "label": "mine",
        "flag_in": True,
        "count_in": 6,
    }
    record = {"variables": ["a.u", "a.gain", "a.time_constant", "a.y", "a.z", "a.count", "a.flag"]}
    result = simulate(make({"a": {"start": start}}, record=record))
    first = dict(zip(result.names, result.rows[0], strict=True))
    assert first == {
        "a.u": 1.5, "a.gain": 4.0, "a.time_constant": 0.5, "a.y": 7.0, "a.z": 6.0, "a.count": 7.0, "a.flag": 0.0
    }  # fmt: skip
    e, g = lag(4.0, time_constant=0.5)
    assert result["a.y"][1] == pytest.approx(e * 7.0 + g * 1.5, rel=1e-14)


def test_parallel_is_sequential_one_sample_late(make: Make) -> None:
    connection = {"from": "source.clock", "to": "gain.u", "factor": 1.0, "offset": 1.0}
    system = make({"source": {}, "gain": {"start": {"gain": 3.0}}}, connection)
    result = simulate(system)
    now, late = result["gain.z"], simulate(system, order="parallel")["gain.z"]
    assert now.tolist() == [3.0 * (t + 1.0) for t in result["source.clock"]]
    assert late[1:].tolist() == now[:-1].tolist()
    assert late[0] == now[0]


@pytest.mark.parametrize("delay", [0, 1])
def test_closed_loop_has_no_delay_or_one_sample(make: Make, delay: int) -> None:
    """y[k+1] = E*y[k] + G*c[k], c[k] = -1.5*y[k-delay]."""
    system = make(
        {"plant": {"start": {"y_start": 1.0}}, "controller": {"start": {"gain": -1.5}}},
        "plant.y -> controller.u",
        "controller.z -> plant.u",
        order="parallel" if delay else "sequential",
        record={"variables": ["plant.y", "controller.z", "plant.u"]},
    )
    result = simulate(system)
    e, g = lag(1.0)
    y, c = [1.0], [-1.5]
    for k in range(10):
        y.append(e * y[k] + g * c[k])
        c.append(-1.5 * y[max(k + 1 - delay, 0)])
    assert result["plant.y"] == pytest.approx(y, abs=1e-14)
    assert result["controller.z"] == pytest.approx(c, abs=1e-14)
    assert result["plant.u"].tolist() == result["controller.z"].tolist()


def test_an_order_against_feedthrough_delays_one_step(make: Make) -> None:
    """The plant is set before the controller is evaluated, so it gets the command of the point before."""
    instances = {"plant": {"start": {"y_start": 1.0}}, "controller": {"start": {"gain": -1.5}}}
    system = make(
        instances, "plant.y -> controller.u", "controller.z -> plant.u", order=["plant", "controller"],
        record={"variables": ["plant.y", "plant.u", "controller.z"]},
    )  # fmt: skip
    result = simulate(system)
    assert system.notes
    assert result["plant.u"][1:].tolist() == result["controller.z"][:-1].tolist()


def test_chain_of_feedthrough_has_no_delay(make: Make) -> None:
    system = make(
        {name: {"start": {"gain": 2.0}} for name in ("d", "c", "b", "a")} | {"s": {}},
        {"from": "s.clock", "to": "a.u", "factor": 1.0, "offset": 0.25},
        "a.z -> b.u",
        "b.z -> c.u",
        "c.z -> d.u",
    )
    result = simulate(system)
    assert result["d.z"].tolist() == [16.0 * (t + 0.25) for t in result["s.clock"]]


def test_a_slower_instance_sees_latched_inputs_and_is_never_early(make: Make) -> None:
    """Over 5 steps: y[k+5] = E*y[k] + G*u[k] with the input of point k; in between its output stands still."""
    system = make(
        {"fast": {"start": {"y_start": 1.0, "gain": -1.0}}, "slow": {"step_multiple": 5, "start": {"y_start": 2.0}}},
        "fast.y -> slow.u",
        "slow.y -> fast.u",
        stop_time=2.0,
        record={"variables": ["fast.y", "slow.y", "slow.u", "slow.clock"]},
    )
    result = simulate(system)
    (e, g), (f, h) = lag(-1.0), lag(1.0, h=0.5)
    fast, slow, held = [1.0], [2.0], 1.0
    for k in range(20):
        if k % 5 == 0:
            held = fast[k]
        fast.append(e * fast[k] + g * slow[k])
        slow.append(f * slow[k] + h * held if (k + 1) % 5 == 0 else slow[k])
    assert result["fast.y"] == pytest.approx(fast, abs=1e-14)
    assert result["slow.y"] == pytest.approx(slow, abs=1e-14)
    assert result["slow.u"].tolist() == [result["fast.y"][5 * (k // 5)] for k in range(21)]
    assert result.solver["slow"]["steps"] == 4
    assert result["slow.clock"] == pytest.approx([0.5 * (k // 5) for k in range(21)])


@pytest.mark.parametrize("steps_a_sample", [1, 4])
def test_sampled_controller_and_plant_from_declarations(make: Make, steps_a_sample: int) -> None:
    """Exported components: the loop of README's contract as a recursion, the controller sampling at its own hits."""
    h = 0.01
    system = make(
        {
            "plant": {"fmu": "Lag", "start": {"tolerance": 1e-10}},
            "controller": {"fmu": "Integrating", "start": {"T_s": h * steps_a_sample, "reference": 1.0}},
        },
        "plant.position -> controller.position",
        "controller.command -> plant.command",
        step_size=h,
    )
    result = simulate(system)
    e, g = lag(1.0, h)
    x, total, command = 0.0, 0.0, 0.0
    for k in range(100):
        if k % steps_a_sample == 0:
            error = 1.0 - x
            command, total = 2.0 * error + total, total + 10.0 * h * steps_a_sample * error
        assert result["plant.position"][k] == pytest.approx(x, abs=1e-8)
        assert result["controller.command"][k] == pytest.approx(command, abs=1e-8)
        x = e * x + g * command


def test_integers_and_booleans_travel_and_widen(make: Make) -> None:
    system = make(
        {"a": {"start": {"count_in": 4, "flag_in": False}}, "b": {}, "c": {"start": {"gain": 10.0}}, "d": {}},
        "a.count -> b.count_in",
        "a.flag -> b.flag_in",
        "b.count -> c.u",
        "a.flag -> d.count_in",
        "a.flag -> d.u",
        record={"variables": ["a.count", "a.flag", "b.count", "b.count_in", "b.flag", "c.z", "d.count", "d.u"]},
    )
    result = simulate(system)
    assert dict(zip(result.names, result.rows[-1], strict=True)) == {
        "a.count": 5, "a.flag": 1, "b.count": 6, "b.count_in": 5, "b.flag": 0, "c.z": 60, "d.count": 2, "d.u": 1
    }  # fmt: skip
    assert (result.rows == result.rows[0]).all()


def test_factor_and_offset(make: Make) -> None:
    connection = {"from": "a.clock", "to": "b.u", "factor": 628.3, "offset": -1.0}
    result = simulate(make({"a": {}, "b": {}}, connection))
    assert result["b.z"].tolist() == [628.3 * t - 1.0 for t in result["a.clock"]]


def test_decimation_keeps_every_nth_row(make: Make) -> None:
    system = make({"a": {"start": {"u": 1.0}}}, stop_time=10.0)
    full, thin = simulate(system), simulate(system.changed(decimation=7))
    assert thin.time.tolist() == full.time[::7].tolist()
    assert thin.rows.tolist() == full.rows[::7].tolist()


def test_experiment_can_be_changed_at_the_call(make: Make) -> None:
    result = simulate(make({"a": {}}), stop_time=2.0, step_size=0.5)
    assert result.time.tolist() == [0.0, 0.5, 1.0, 1.5, 2.0]


def test_loops_through_initial_values_settle_or_are_told(make: Make) -> None:
    """a.z = 0.5*b.z, b.z = 0.5*a.z + offset: a fixed point exists; with gains of 2 there is none to find."""

    def looped(gain: float) -> Result:
        both = {"a": {"start": {"gain": gain}}, "b": {"start": {"gain": gain}}}
        return simulate(make(both, {"from": "a.z", "to": "b.u", "offset": 1.0}, "b.z -> a.u", order="parallel"))

    settled = looped(0.5)
    assert settled["b.z"][0] == pytest.approx(2.0 / 3.0, abs=1e-14)
    assert settled.messages == ()
    assert "outputs still change after 50 passes" in looped(2.0).messages[0].text


# Instances, runs, threads


def test_many_runs_on_the_same_instances(make: Make) -> None:
    system = make({"a": {"start": {"u": 1.0}}, "b": {}}, "a.y -> b.u")
    with Simulation(system) as simulation:
        first = simulation.run()
        other = simulation.run(system.changed({"a.gain": 3.0}))
        again = simulation.run()
    assert again.rows.tolist() == first.rows.tolist()
    assert other["a.y"] == pytest.approx(3.0 * first["a.y"])
    with pytest.raises(DescriptionError, match="the simulation is closed"):
        simulation.run()


def test_simulation_runs_only_its_own_instances(make: Make) -> None:
    with (
        Simulation(make({"a": {}})) as simulation,
        pytest.raises(DescriptionError, match=r"system: not the instances of system. Make a new Simulation."),
    ):
        simulation.run(make({"b": {}}))


def memory() -> tuple[int, int]:
    """Mapped regions and open files of this process, where the system tells them."""
    maps, files = Path("/proc/self/maps"), Path("/proc/self/fd")
    if not maps.exists():
        return 0, 0
    return sum(".so" in line for line in maps.read_text(encoding="utf-8").splitlines()), len(list(files.iterdir()))


def test_hundred_runs_leave_nothing_behind(make: Make, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    system = make({"a": {}, "b": {}}, "a.y -> b.u")
    simulate(system)
    before = memory()
    results = [simulate(system).rows.tolist() for _ in range(100)]
    # There may be fewer: earlier tests may close a file late.
    assert all(now <= then for now, then in zip(memory(), before, strict=True))
    assert all(rows == results[0] for rows in results)
    assert list(tmp_path.iterdir()) == []


def test_threads_run_side_by_side(make: Make) -> None:
    systems = [make({"a": {"start": {"u": 1.0, "gain": float(n)}}}, stop_time=2000.0) for n in range(4)]
    alone = [simulate(system).rows for system in systems]
    together: dict[int, Result] = {}
    threads = [
        threading.Thread(target=lambda n=n: together.setdefault(n, simulate(systems[n]))) for n in range(len(systems))
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for n, rows in enumerate(alone):
        assert np.array_equal(together[n].rows, rows)


# What stops a run


class Live:
    """Counts the probes alive, by a second hold on the library that a simulation has unpacked."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.library: ctypes.CDLL | None = None

    def __call__(self, fraction: float = 0.0) -> None:
        if self.library is None:
            (path,) = (path for path in self.folder.rglob("*") if path.suffix in (".so", ".dll", ".dylib"))
            self.library = ctypes.CDLL(str(path))

    @property
    def count(self) -> int:
        assert self.library is not None
        return int(self.library.probe_live())


@pytest.fixture
def live(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Live:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return Live(tmp_path)


def failing(make: Make, status: int, function: int, time: float = 9.95) -> System:
    start = {"fail_time": time, "fail_status": status, "fail_function": function, "u": 1.0}
    return make({"good": {}, "bad": {"start": start}}, "good.y -> bad.u", stop_time=20.0)


@pytest.mark.parametrize(("status", "name"), [(2, "Discard"), (3, "Error")])
@pytest.mark.parametrize(("function", "called"), [(0, "fmi2DoStep"), (1, "fmi2SetReal"), (2, "fmi2GetReal")])
def test_a_failing_instance_frees_all_and_keeps_what_was_computed(
    make: Make, live: Live, status: int, name: str, *, function: int, called: str
) -> None:
    with pytest.raises(CallError) as caught:
        simulate(failing(make, status, function), progress=live)
    error = caught.value
    assert (error.instance, error.function, error.status) == ("bad", called, name)
    assert error.time == pytest.approx(9.9 if function == 2 else 10.0)
    assert error.message == f"{called} told to fail at 10 s"
    assert str(error) == f"bad: {called} at {error.time:.9g} s returned fmi2{name}. The FMU said: {error.message}"
    assert error.result is not None
    assert error.result.partial
    assert error.result.time[-1] == pytest.approx({0: 10.0, 1: 9.9, 2: 9.9}[function])
    complete = simulate(failing(make, status, function, time=1e9))
    count = error.result.time.size
    assert error.result["bad.y"].tolist() == complete["bad.y"][:count].tolist()
    assert error.result.messages[-1].text == error.message
    assert live.count == 0


def test_after_fatal_all_instances_of_that_fmu_are_left_alone(make: Make, live: Live) -> None:
    with pytest.raises(CallError, match=r"bad: fmi2DoStep at 10 s returned fmi2Fatal."):
        simulate(failing(make, 4, 0), progress=live)
    assert live.count == 2


def test_failure_in_initialization(make: Make) -> None:
    with pytest.raises(CallError, match=r"bad: fmi2ExitInitializationMode at 0 s returned fmi2Error") as caught:
        simulate(failing(make, 3, 3))
    assert caught.value.result is not None
    assert caught.value.result.time.size == 0


def test_a_failed_simulation_can_run_again(make: Make) -> None:
    system = failing(make, 3, 0)
    with Simulation(system) as simulation:
        with pytest.raises(CallError):
            simulation.run()
        assert simulation.run(system.changed({"bad.fail_time": 1e9})).metadata["steps"] == 200


def test_warnings_are_logged_and_the_run_goes_on(make: Make) -> None:
    result = simulate(failing(make, 1, 0, time=19.85))
    assert not result.partial
    assert result.metadata["steps"] == 200
    assert result.metadata["warnings"] == 2
    assert {message.instance for message in result.messages} == {"bad"}
    assert {message.status for message in result.messages} == {"Warning"}
    first = result.messages[0]
    assert (first.category, first.text) == ("logStatusWarning", "fmi2DoStep told to fail at 19.9 s")
    assert first.time == pytest.approx(19.9)
    assert str(first) == "19.9 s bad [Warning] fmi2DoStep told to fail at 19.9 s"


def test_messages_are_not_kept_without_end(make: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cosim.master.instance.MAX_MESSAGES", 5)
    result = simulate(failing(make, 1, 0, time=0.0))
    assert len(result.messages) == 5
    assert result.dropped_messages == 195


def test_wrong_guid(fmus: Path, tmp_path: Path) -> None:
    write_fmu(tmp_path / "Other.fmu", PROBE, binary=probe_library().read_bytes(), guid="{other}")
    system = make_system(
        {"experiment": {"stop_time": 1, "step_size": 1}, "instances": {"a": {"fmu": "Other"}}}, fmus=tmp_path
    )
    with pytest.raises(CallError, match=r"a: fmi2Instantiate at 0 s returned fmi2Error. The FMU said: guid {other} is"):
        simulate(system)


def test_library_that_does_not_load(tmp_path: Path) -> None:
    write_fmu(tmp_path / "Broken.fmu", PROBE, binary=b"not a library")
    system = make_system(
        {"experiment": {"stop_time": 1, "step_size": 1}, "instances": {"a": {"fmu": "Broken"}}}, fmus=tmp_path
    )
    place = Path.cwd()
    with pytest.raises(SimulationError, match="a: the library of Broken cannot be used: Failed to load"):
        simulate(system)
    assert Path.cwd() == place


def test_too_much_memory_is_told_before_the_run(make: Make) -> None:
    with pytest.raises(DescriptionError, match=r"rows of 5 variables need .* GiB of memory. Record fewer variables"):
        simulate(make({"a": {}}, stop_time=10**12, step_size=0.01))


def test_interrupt_keeps_what_was_computed(make: Make, live: Live) -> None:
    system = make({"a": {"start": {"sleep": 10}}}, stop_time=1e5)

    def press(fraction: float) -> None:
        live(fraction)
        if fraction > 1e-4:
            os.kill(os.getpid(), signal.SIGINT)

    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(Interrupted) as caught:
        simulate(system, progress=press)
    assert signal.getsignal(signal.SIGINT) is before
    result = caught.value.result
    assert result.partial
    assert 0 < result.time.size < 1e6
    assert result.metadata["steps"] == result.time.size
    assert live.count == 0


def test_interrupt_in_the_middle_of_the_compiled_loop(fmus: Path) -> None:
    """A signal while no Python runs: the loop comes back by itself."""
    code = f"""if True:
        import cosim
        instances = {{"a": {{"fmu": "Probe", "start": {{"sleep": 1000}}}}}}
        document = {{"experiment": {{"stop_time": 10**6, "step_size": 1}}, "instances": instances}}
        try:
            system = cosim.make_system(document, fmus={str(fmus)!r})
            cosim.simulate(system, progress=lambda f: print("going", flush=True))
        except cosim.Interrupted as e:
            print("kept", e.result.time.size > 0, e.result.partial)
    """
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "going\n"
    process.send_signal(signal.SIGINT)
    rest, _ = process.communicate(timeout=60)
    assert rest.splitlines()[-1] == "kept True True"


# Results


def test_result_knows_units_and_origin(make: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    system = make({"plant": {"fmu": "Lag"}, "a": {}}, "a.y -> plant.command")
    result = simulate(system)
    assert result.unit("plant.position") == "m"
    assert result.unit("a.count") == "1"
    assert "plant.position" in result
    assert result.metadata["system_digest"] == system.digest
    assert result.metadata["connections"] == ["a.y -> plant.command"]
    with pytest.raises(DescriptionError, match=r"'plant.positon' was not recorded. Did you mean 'plant.position'\?"):
        result["plant.positon"]
    frame = result.to_dataframe()
    assert frame["a.y"].to_numpy().tolist() == result["a.y"].tolist()
    assert frame.index.name == "time"
    assert frame.attrs["units"]["plant.position"] == "m"
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(DescriptionError, match="to_dataframe needs pandas"):
        result.to_dataframe()


def test_a_value_that_is_not_finite_on_a_connection_ends_the_run(make: Make) -> None:
    """a.y is not a number from the first step on; the row of the start stays."""
    system = make({"a": {"start": {"u": 10.0, "gain": 1e308}}, "b": {}}, "a.y -> b.u")
    with pytest.raises(SignalError) as failure:
        simulate(system)
    error = failure.value
    assert str(error).startswith("a.y gives b.u the value nan at 0.1 s: not finite. ")
    assert (error.time, str(error.connection)) == (0.1, "a.y -> b.u")
    assert math.isnan(error.value)
    assert error.result is not None
    assert error.result.partial
    assert error.result.time.tolist() == [0.0]
    assert np.isnan(simulate(system, keep_going=True)["a.y"][1:]).all()


def test_what_is_not_finite_may_be_recorded(make: Make) -> None:
    assert math.isnan(simulate(make({"a": {"start": {"u": 10.0, "gain": 1e308}}}))["a.y"][1])


def test_csv_reads_back_the_same(make: Make, tmp_path: Path) -> None:
    result = simulate(make({"a": {"start": {"u": 1.0 / 3.0}}}))
    lines = result.save(tmp_path / "new" / "a.csv").read_text(encoding="utf-8").splitlines()
    assert lines[0] == '"time","a.y","a.z","a.clock","a.count","a.flag"'
    rows = np.array([[float(cell) for cell in line.split(",")] for line in lines[1:]])
    assert rows.tolist() == np.column_stack([result.time, result.rows]).tolist()


def test_csv_takes_every_double(make: Make, tmp_path: Path) -> None:
    """Shortest digits that read back the same, more rows than are written at a time."""
    values = np.array([0.1, 5e-324, -1.7976931348623157e308, 1e22, 2.0**-1074 * 3, 0.0, 1 / 3] * 9000)
    result = replace(simulate(make({"a": {}})), time=np.arange(values.size) * 0.1, rows=values.reshape(-1, 1))
    result = replace(result, columns=(Column('a."x"', "1", "", "1"),))
    text = result.save(tmp_path / "a.csv").read_text(encoding="utf-8")
    head, first, *_ = lines = text.splitlines()
    assert (head, first) == ('"time","a.""x"""', "0.0,0.1")
    read = np.array([[float(cell) for cell in line.split(",")] for line in lines[1:]])
    assert read.tobytes() == np.column_stack((result.time, values)).tobytes()


def test_parquet_without_pyarrow_is_refused_before_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cosim.extras.find_spec", lambda name: None)
    with pytest.raises(DescriptionError, match=r'a.parquet: .* pyarrow, .* "motion-cosim\[parquet\]", or name a .csv'):
        check_output(Path("a.parquet"))
    check_output(Path("a.csv"))


def test_parquet_carries_units_and_hash(make: Make, tmp_path: Path) -> None:
    import pyarrow.parquet

    system = make({"a": {"start": {"u": 1.0 / 3.0}}})
    result = simulate(system)
    table = pyarrow.parquet.read_table(result.save(tmp_path / "a.parquet"))
    assert table.column_names == ["time", *result.names]
    assert table.column("a.y").to_pylist() == result["a.y"].tolist()
    assert table.schema.field("a.y").metadata[b"unit"] == b"V"
    assert table.schema.field("time").metadata[b"unit"] == b"s"
    assert table.schema.metadata[b"system_digest"].decode() == system.digest
    assert table.schema.metadata[b"partial"] == b"false"


def test_other_endings_are_refused(make: Make, tmp_path: Path) -> None:
    result = simulate(make({"a": {}}))
    with pytest.raises(DescriptionError, match=r"a.mat: the name must end in .csv or .parquet."):
        result.save(tmp_path / "a.mat")
    (tmp_path / "b.csv").mkdir()
    with pytest.raises(DescriptionError, match=r"b\.csv is a folder\. Name a file"):
        result.save(tmp_path / "b.csv")
