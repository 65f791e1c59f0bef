"""Runs fed by records, sums and noise: what an input gets, to the last bit, whatever runs it and in whatever parts."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmu_files import write_echo3, write_probe

from cosim.errors import DescriptionError
from cosim.master import loop, tables
from cosim.master.run import SignalError
from cosim.master.simulation import Simulation, simulate
from cosim.result.result import Result
from cosim.system.system import System, make_system

STEP = 0.125
ROWS = np.column_stack((np.arange(9) * STEP, np.array([3.0, -1.0, 4.0, 1.0, -5.0, 9.0, 2.0, -6.0, 5.0])))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("records")
    write_probe(folder)
    np.savetxt(folder / "log.csv", ROWS, delimiter=",", header="t,x [V]", comments="", fmt="%.17g")
    return folder


def made(folder: Path, connections: list[Any], signal: Mapping[str, Any] | None = None, **more: Any) -> System:
    """Probes ``a`` and ``b``: z is what u gets (gain 1), y follows with a lag."""
    document: dict[str, Any] = {
        "connections": connections,
        "experiment": {"stop_time": 1.0, "step_size": STEP},
        "instances": {"a": {"fmu": "Probe"}, "b": {"fmu": "Probe"}},
        "signals": {"log": {"file": "log.csv", "extend": "hold", **(signal or {})}},
        "record": {"variables": ["a.u", "a.z", "a.y", "b.*"]},
        **more,
    }
    return make_system(document, name="s.toml", folder=folder, fmus=folder)


def plain(system: System, monkeypatch: pytest.MonkeyPatch) -> Result:
    with monkeypatch.context() as patch:
        patch.setattr(loop, "compiled", lambda: None)
        return simulate(system)


def in_small_parts(system: System, monkeypatch: pytest.MonkeyPatch) -> Result:
    with monkeypatch.context() as patch:
        patch.setattr(tables, "POINTS", 2)
        patch.setattr("cosim.master.run.POINTS", 2)
        return simulate(system)


def isolated(system: System, monkeypatch: pytest.MonkeyPatch) -> Result:
    return simulate(system, isolated=True)


def again(system: System, monkeypatch: pytest.MonkeyPatch) -> Result:
    with Simulation(system) as simulation:
        simulation.run()
        return simulation.run()


WAYS: tuple[Callable[[System, pytest.MonkeyPatch], Result], ...] = (plain, in_small_parts, isolated, again)

EVERYTHING: list[Any] = [
    {"from": ["log.x", "b.y", "log.der(x)"], "to": "a.u", "factors": [1.0, -0.3, 1e-3], "offset": 0.1},
    {"from": "a.y", "to": "b.u", "noise": {"rms": 0.01, "seed": 5}},
]
DERIVED = {"columns": {"x": {"column": "x", "derivatives": 1, "smoothing": "none"}}}


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("order", ["sequential", "parallel"])
@pytest.mark.parametrize("interpolation", ["hold", "linear"])
def test_every_way_of_running_gives_the_same_bits(
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    way: Callable[[System, pytest.MonkeyPatch], Result],
    order: str,
    interpolation: str,
) -> None:
    experiment = {"stop_time": 3.0, "step_size": "1/32", "order": order}
    if order == "sequential":
        # u feeds z directly: the loop over y has none.
        experiment["order"] = ["a", "b"]
    signal = {**DERIVED, "interpolation": interpolation, "extend": "repeat"}
    derived = {"from": EVERYTHING[0]["from"], "to": "a.u", "factors": [1.0, -0.3, 0.001], "units": "suppress"}
    system = made(folder, [derived, EVERYTHING[1]], signal, experiment=experiment)
    expected = simulate(system)
    assert np.ptp(expected["a.y"]) > 1.0
    assert way(system, monkeypatch).rows.tobytes() == expected.rows.tobytes()


# What an input gets


@pytest.mark.parametrize("order", ["sequential", "parallel"])
def test_a_sample_acts_over_the_step_that_begins_at_it(folder: Path, order: str) -> None:
    """z at t_k is the sample at t_k; y at t_k+1 is the exact answer of the lag to it, held over the step."""
    experiment = {"stop_time": 1.0, "step_size": STEP, "order": order}
    result = simulate(made(folder, ["log.x -> a.u"], experiment=experiment))
    samples = ROWS[:, 1]
    assert result["a.u"].tolist() == samples.tolist()
    if order == "sequential":
        assert result["a.z"].tolist() == samples.tolist()
    y = [0.0]
    for sample in samples[:-1]:
        y.append(sample + (y[-1] - sample) * math.exp(-STEP / 0.1))
    assert result["a.y"] == pytest.approx(y, rel=1e-12)


@pytest.mark.parametrize(
    ("signal", "expected"),
    [
        ({"start_time": 0.25}, [4.0, 1.0, -5.0, 9.0, 2.0, -6.0, 5.0, 5.0, 5.0]),
        ({"start_time": -0.25}, [3.0, 3.0, 3.0, -1.0, 4.0, 1.0, -5.0, 9.0, 2.0]),
        ({"start_time": 0.75, "extend": "repeat"}, [2.0, -6.0, 5.0, 3.0, -1.0, 4.0, 1.0, -5.0, 9.0]),
        ({"start_time": 0.0625, "interpolation": "linear"}, [1.0, 1.5, 2.5, -2.0, 2.0, 5.5, -2.0, -0.5, 5.0]),
        ({"start_time": 0.5, "extend": "stop"}, [-5.0, 9.0, 2.0, -6.0, 5.0]),
    ],
)
def test_what_comes_between_and_beyond_the_samples(folder: Path, signal: dict[str, Any], expected: list[float]) -> None:
    assert simulate(made(folder, ["log.x -> a.u"], signal))["a.u"].tolist() == expected


def test_where_the_record_holds_its_derivatives_are_zero(folder: Path) -> None:
    system = made(
        folder,
        [{"from": "log.der(x)", "to": "a.u", "units": "suppress"}],
        {**DERIVED, "start_time": -0.25},
        experiment={"stop_time": 2.0, "step_size": STEP},
    )
    found = simulate(system)["a.u"]
    expected = np.gradient(ROWS[:, 1], ROWS[:, 0], edge_order=2)
    assert found.tolist() == [0.0, 0.0, *expected.tolist(), *[0.0] * 6]


def test_a_slower_instance_gets_the_sample_at_its_own_steps(folder: Path) -> None:
    instances = {"a": {"fmu": "Probe", "step_multiple": 4}, "b": {"fmu": "Probe"}}
    result = simulate(made(folder, ["log.x -> a.u"], instances=instances))
    assert result["a.u"].tolist() == [3.0] * 4 + [-5.0] * 4 + [5.0]


def test_one_column_feeds_many_inputs_each_in_its_own_way(folder: Path) -> None:
    connections = ["log.x -> a.u", {"from": "log.x", "to": "b.u", "factor": -2.0, "offset": 1.0}]
    result = simulate(made(folder, connections))
    assert result["b.u"].tolist() == (-2.0 * ROWS[:, 1] + 1.0).tolist()


def test_record_columns_are_recorded_with_their_units(folder: Path) -> None:
    result = simulate(made(folder, ["log.x -> a.u"], record={"variables": ["log.*", "a.u"]}))
    assert result.names == ("log.x", "a.u")
    assert result.unit("log.x") == "V"
    assert result["log.x"].tolist() == ROWS[:, 1].tolist()
    assert result.metadata["signals"]["log"]["digest"] == made(folder, []).signals[0].digest


@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_a_run_replayed_from_its_own_file_is_the_same(folder: Path, ending: str) -> None:
    """Instance b in place, and b fed by the record of what fed it."""
    direct = made(folder, ["log.x -> a.u", "a.y -> b.u"], experiment={"stop_time": 1.0, "step_size": "1/30"})
    first = simulate(direct)
    first.save(folder / f"run.{ending}")
    replay = made(
        folder,
        ["run.a.y -> b.u"],
        signals={"run": {"file": f"run.{ending}"}},
        experiment={"stop_time": 1.0, "step_size": "1/30"},
        instances={"b": {"fmu": "Probe"}},
        record={"variables": ["b.*"]},
    )
    second = simulate(replay)
    for name in second.names:
        assert second[name].tobytes() == first[name].tobytes(), name


# Sums


@pytest.mark.parametrize("factors", [[1.0, 1.0], [1.0, -1.0], [0.5, 3.0]])
def test_a_sum_is_the_sum(folder: Path, factors: list[float]) -> None:
    entry = {"from": ["log.x", "a.y"], "to": "b.u", "factors": factors, "offset": 0.5}
    result = simulate(made(folder, ["log.x -> a.u", entry]))
    x = ROWS[:, 1]
    assert result["b.u"].tolist() == ((factors[0] * x + 0.5) + factors[1] * result["a.y"]).tolist()


def test_each_addend_is_converted_to_the_unit_of_the_input(folder: Path) -> None:
    (folder / "mv.csv").write_text("t,x [mV]\n0,1500\n1,1500\n", encoding="utf-8")
    entry = {"from": ["log.x", "mv.x"], "to": "a.u", "units": "convert"}
    signals = {"log": {"file": "log.csv"}, "mv": {"file": "mv.csv"}}
    assert simulate(made(folder, [entry], signals=signals))["a.u"].tolist() == (ROWS[:, 1] + 1.5).tolist()


def test_the_start_of_a_run_sees_the_sum(folder: Path) -> None:
    with Simulation(made(folder, [{"from": ["log.x", "b.y"], "to": "a.u"}])) as simulation:
        simulation.initialize()
        assert simulation.value("a", "z") == ROWS[0, 1]


@pytest.mark.parametrize("way", [plain, None])
def test_a_sum_that_is_too_large_ends_the_run(
    folder: Path, monkeypatch: pytest.MonkeyPatch, way: Callable[[System, pytest.MonkeyPatch], Result] | None
) -> None:
    entry = {"from": ["log.x", "b.y"], "to": "a.u", "factors": [5e307, 1.0]}
    instances = {"a": {"fmu": "Probe"}, "b": {"fmu": "Probe", "start": {"y_start": 1e308, "time_constant": 1e9}}}
    system = made(folder, [entry], instances=instances)
    with pytest.raises(SignalError, match=r"gives a\.u the value inf at 0 s: not finite"):
        simulate(system) if way is None else way(system, monkeypatch)


# Noise


def noisy(folder: Path, seed: int, rms: float = 0.25, **more: Any) -> np.ndarray:
    entry = {"from": "log.x", "to": "a.u", "noise": {"rms": rms, "seed": seed}}
    system = made(folder, [entry], {"extend": "hold", "start_time": 100.0}, **more)
    return simulate(system)["a.u"] - ROWS[-1, 1]


LONG = {"experiment": {"stop_time": 2000.0, "step_size": STEP}}


def test_noise_has_its_rms_and_is_white(folder: Path) -> None:
    noise = noisy(folder, 1, **LONG)
    n = noise.size
    assert n == 16001
    # Four standard errors of rms, mean and correlation of n independent normal numbers.
    assert np.sqrt(np.mean(noise**2)) == pytest.approx(0.25, rel=4.0 / math.sqrt(2.0 * n))
    assert abs(np.mean(noise)) < 4.0 * 0.25 / math.sqrt(n)
    for lag in (1, 2, tables.BLOCK):
        assert abs(np.mean(noise[lag:] * noise[:-lag])) < 4.0 * 0.25**2 / math.sqrt(n - lag)


def test_noise_is_the_same_for_a_seed_and_another_for_another(folder: Path) -> None:
    assert noisy(folder, 1).tobytes() == noisy(folder, 1).tobytes()
    assert not np.any(noisy(folder, 1) == noisy(folder, 2))
    # A longer run begins with the same noise, and rms scales it.
    assert noisy(folder, 1, **LONG)[:9].tobytes() == noisy(folder, 1).tobytes()
    assert noisy(folder, 1, rms=0.5) == pytest.approx(2.0 * noisy(folder, 1), rel=1e-12, abs=1e-14)


def test_noise_on_two_inputs_is_independent(folder: Path) -> None:
    entries = [
        {"from": "log.x", "to": f"{name}.u", "noise": {"rms": 1.0, "seed": seed}} for name, seed in (("a", 1), ("b", 2))
    ]
    result = simulate(made(folder, entries, {"start_time": 100.0}, **LONG))
    one, other = (result[f"{name}.u"] - ROWS[-1, 1] for name in "ab")
    assert abs(np.mean(one * other)) < 4.0 / math.sqrt(one.size)


# Variants of a system share a simulation


def test_variants_run_on_the_same_instances(folder: Path) -> None:
    np.savetxt(folder / "two.csv", ROWS * [1.0, 2.0], delimiter=",", header="t,x [V]", comments="", fmt="%.17g")
    system = made(folder, ["log.x -> a.u"])
    with Simulation(system) as simulation:
        first = simulation.run()["a.u"]
        second = simulation.run(system.changed({"log.file": "two.csv"}))["a.u"]
        third = simulation.run(system.changed({"a.gain": 2.0}))
        shorter = simulation.run(system.changed(stop_time=0.5))["a.u"]
    assert second.tolist() == (2.0 * first).tolist()
    assert third["a.z"].tolist() == (2.0 * first).tolist()
    assert shorter.tolist() == first[:5].tolist()


def test_a_run_goes_on_from_a_checkpoint_with_the_samples_and_the_noise_of_there(native: Path, folder: Path) -> None:
    columns = {"x": {"column": "x", "factor": 1e-6, "unit": "m", "derivatives": 1, "smoothing": "none"}}
    document: dict[str, Any] = {
        "connections": [
            "log.x -> c.position_ref",
            "log.der(x) -> c.velocity_ref",
            {"from": "p.position", "to": "c.position", "noise": {"rms": 2e-9, "seed": 1}},
            {"from": ["c.command", "log.x"], "to": "p.command", "factors": [1.0, 2.0]},
        ],
        "experiment": {"stop_time": 2.0, "step_size": 1e-3},
        "instances": {"c": {"fmu": "CascadePid", "start": {"T_s": 1e-3}}, "p": {"fmu": "BallscrewStage"}},
        "signals": {"log": {"file": "log.csv", "columns": columns, "interpolation": "linear", "extend": "repeat"}},
    }
    system = make_system(document, folder=folder, fmus=native)
    with Simulation(system) as simulation:
        expected = simulation.run().rows
        checkpoint = simulation.pause(0.7)
        for _ in range(2):
            rest = simulation.resume(checkpoint)
            assert rest.rows.tobytes() == expected[-rest.time.size :].tobytes()
        with pytest.raises(DescriptionError, match="this input is connected"):
            simulation.resume(checkpoint, {"c.position_ref": 1.0})


@pytest.mark.parametrize("kind", ["ends", "stays"])
def test_an_fmu_that_ends_the_run_ends_it_with_the_right_samples(folder: Path, kind: str) -> None:
    from fmu_files import PROBE, probe_library, write_fmu

    write_fmu(folder / "Stubborn.fmu", PROBE, binary=probe_library("stubborn").read_bytes())
    instances = {kind: {"fmu": "Stubborn", "start": {"fail_time": 0.5}}, "a": {"fmu": "Probe"}}
    record = {"variables": ["a.u", "log.x"]}
    result = simulate(made(folder, ["log.x -> a.u"], instances=instances, record=record))
    assert not result.partial
    assert result["a.u"].tolist() == ROWS[: result.time.size, 1].tolist()
    assert result["log.x"].tolist() == result["a.u"].tolist()
    assert result.time.size in (4, 5)


def test_elements_of_arrays_of_fmi3_get_sums_and_noise(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_echo3(folder / "Echo.fmu")
    connections = [
        {"from": ["log.x", "a.y"], "to": "e.u_Float64[2]", "factors": [1.0, -1.0]},
        {"from": "log.x", "to": "e.u_Float32[1]", "noise": {"rms": 0.5, "seed": 1}},
        "log.x -> a.u",
    ]
    instances = {"a": {"fmu": "Probe"}, "e": {"fmu": "Echo", "start": {"u_Float64[1]": 7.0, "u_Float64[3]": 9.0}}}
    record = {"variables": ["e.y_Float64", "e.y_Float32", "a.y"]}
    system = made(folder, connections, instances=instances, record=record)
    result = simulate(system)
    assert result["e.y_Float64[2]"].tolist() == (ROWS[:, 1] - result["a.y"]).tolist()
    assert set(result["e.y_Float64[1]"]) == {7.0}
    assert set(result["e.y_Float64[3]"]) == {9.0}
    noise = result["e.y_Float32[1]"] - ROWS[:, 1]
    assert 0.0 < float(np.max(np.abs(noise))) < 2.5
    assert plain(system, monkeypatch).rows.tobytes() == result.rows.tobytes()
    assert isolated(system, monkeypatch).rows.tobytes() == result.rows.tobytes()
