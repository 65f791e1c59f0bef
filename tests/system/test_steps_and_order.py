"""Steps that are fractions, an order that decides, the tolerance of FMUs, an FMU as a system."""

from __future__ import annotations

import dataclasses
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmu_files import PROBE, probe_library, write_fmu, write_gain, write_probe

from cosim.errors import DescriptionError
from cosim.master.instance import FmuInstance
from cosim.master.simulation import Simulation, simulate
from cosim.system.ssp_write import write_ssp
from cosim.system.system import System, make_system, read_system
from cosim.system.toml_write import write_system


def probe(folder: Path, **experiment: object) -> System:
    write_probe(folder)
    document = {"experiment": experiment, "instances": {"a": {"fmu": "./Probe.fmu", "start": {"y_start": 1.0}}}}
    return make_system(document, name="probe.toml", folder=folder)


# Fractions


@pytest.mark.parametrize(
    ("stop", "step", "steps"),
    [
        (Decimal("1.0"), Decimal("0.03333333333333333"), 30),
        (Decimal("1.0"), "1/30", 30),
        (Decimal("1.0"), 1 / 30, 30),
        (Decimal("1.0"), " 1 / 3 ", 3),
        ("1/3", "1/30", 10),
        (Decimal("10"), "2.5/75", 300),
        (Decimal("1e4"), Decimal("0.1428571428571428"), 70000),
    ],
)
def test_steps_divide_up_to_the_rounding_of_sixteen_digits(
    tmp_path: Path, stop: object, step: object, steps: int
) -> None:
    system = probe(tmp_path, stop_time=stop, step_size=step)
    assert system.steps == steps
    read = read_system(write_system(read_system(write_ssp(system, tmp_path / "s.ssp")), tmp_path / "s.toml"))
    assert (read.digest, read.steps) == (system.digest, steps)


def test_a_fraction_is_the_double_next_to_it(tmp_path: Path) -> None:
    result = simulate(probe(tmp_path, stop_time=1, step_size="1/30"))
    assert result.time.tolist() == [k * (1 / 30) for k in range(31)]


@pytest.mark.parametrize(
    ("step", "text"),
    [
        (Decimal("0.0333333"), 'Change step_size = "1/30", or take stop_time = '),
        (Decimal("0.033333333333333"), 'Change step_size = "1/30", or take'),
        ("1/0", '"1/0" is not a finite number of seconds. Fractions are written "1/30".'),
        ("0.1", '"0.1" is not a finite number of seconds.'),
        ("-1/30", "-1/30 s must be positive."),
        ("1/30 s", '"1/30 s" is not a finite number of seconds.'),
    ],
)
def test_steps_that_are_none(tmp_path: Path, step: object, text: str) -> None:
    with pytest.raises(DescriptionError) as caught:
        probe(tmp_path, stop_time=1, step_size=step)
    assert text in caught.value.problems[0]


def sampled(folder: Path, sampling: object) -> System:
    """An instance with the sampling time ``sampling``, in steps of 1/30 s."""
    variables = [dataclasses.replace(v, name="T_s" if v.name == "time_constant" else v.name) for v in PROBE]
    write_fmu(folder / "C.fmu", variables, binary=probe_library().read_bytes())
    document: dict[str, Any] = {
        "experiment": {"stop_time": 1, "step_size": "1/30"},
        "instances": {"c": {"fmu": "./C.fmu", "start": {"T_s": sampling}}},
    }
    return make_system(document, folder=folder)


@pytest.mark.parametrize("sampling", ["1/30", "1/60", "1/10", "0.03333333333333333"])
def test_sampling_times_may_be_fractions(tmp_path: Path, sampling: str) -> None:
    system = sampled(tmp_path, sampling if "/" in sampling else Decimal(sampling))
    numerator, _, denominator = sampling.partition("/")
    assert system.instances[0].start["T_s"] == float(numerator) / float(denominator or "1")
    samples = [note for note in system.notes if "samples a step" in note]
    assert bool(samples) == (sampling == "1/60")


def test_a_changed_sampling_time_is_checked_against_the_step(tmp_path: Path) -> None:
    system = sampled(tmp_path, "1/30")
    changed = system.changed({"c.T_s": "1/60"})
    assert not [note for note in system.notes if "samples a step" in note]
    assert [note for note in changed.notes if "samples a step" in note]


# Order


def ring(folder: Path, order: object, multiple: int = 1) -> System:
    """Two gains of 0.5, each fed by the other; the files state no dependencies, as many do not."""
    parts = [v for v in PROBE if v.name in ("u", "z", "gain")]
    variables = [dataclasses.replace(v, depends_on=None) if v.causality == "output" else v for v in parts]
    if not (folder / "Gain.fmu").exists():
        write_fmu(folder / "Gain.fmu", variables, binary=probe_library().read_bytes())
    start = {"gain": Decimal("0.5"), "u": Decimal(1)}
    document = {
        "connections": ["a.z -> b.u", "b.z -> a.u"],
        "experiment": {"stop_time": 1, "step_size": Decimal("0.25"), "order": order},
        "instances": {
            name: {"fmu": "./Gain.fmu", "start": start, "step_multiple": multiple if name == "b" else 1}
            for name in ("a", "b")
        },
    }
    return make_system(document, name="ring.toml", folder=folder)


@pytest.mark.parametrize(("order", "late"), [(["a", "b"], "b.z -> a.u"), (["b", "a"], "a.z -> b.u")])
def test_an_order_decides_who_is_late_in_a_loop(tmp_path: Path, order: list[str], late: str) -> None:
    system = ring(tmp_path, order)
    assert system.evaluation_order == tuple(order)
    (note,) = system.notes
    assert note.startswith(f"connection {late}: one step of delay: ")
    assert "its file does not say on which inputs its output depends" in note
    assert np.isfinite(simulate(system).rows).all()


def test_a_loop_without_an_order_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DescriptionError, match=r"algebraic loop: .*name all instances in order = \[\.\.\.\], or"):
        ring(tmp_path, "sequential")
    assert ring(tmp_path, "parallel").notes == ()


def test_an_instance_that_feeds_itself_is_late(tmp_path: Path) -> None:
    write_gain(tmp_path, "Gain", "m", "m")
    document = {
        "connections": ["a.z -> a.u"],
        "experiment": {"stop_time": 1, "step_size": 1, "order": ["a"]},
        "instances": {"a": {"fmu": "./Gain.fmu"}},
    }
    (note,) = make_system(document, folder=tmp_path).notes
    assert "one step of delay: a feeds itself" in note


@pytest.mark.parametrize(("order", "multiple"), [(["b", "a"], 1), ("parallel", 1), (["a", "b"], 2)])
def test_one_simulation_runs_variants_of_its_program(tmp_path: Path, order: object, multiple: int) -> None:
    """The program is made anew when only the order, or how often an instance steps, differs."""
    first = ring(tmp_path, ["a", "b"])
    second = ring(tmp_path, order, multiple)
    alone = [simulate(first).rows.tolist(), simulate(second).rows.tolist()]
    assert alone[0] != alone[1]
    with Simulation(first) as simulation:
        shared = [simulation.run(system).rows.tolist() for system in (first, second, first)]
    assert shared == [alone[0], alone[1], alone[0]]


@pytest.mark.parametrize(
    ("decimation", "text"),
    [
        (1, ""),
        (2, "figures and pictures are of the recorded rows, 0.2 s apart: peaks between them are not seen."),
        (3, "not seen. The last row is at 0.9 s, before the end of the run."),
    ],
)
def test_rows_that_are_left_out_are_noted(tmp_path: Path, decimation: int, text: str) -> None:
    system = probe(tmp_path, stop_time=1, step_size=Decimal("0.1")).changed(decimation=decimation)
    found = [note for note in system.notes if note.startswith("record.decimation: ")]
    assert len(found) == (decimation > 1)
    assert all(note.endswith(text) for note in found)
    if decimation == 3:
        assert simulate(system).time[-1] == pytest.approx(0.9)


def test_a_stated_factor_of_one_is_a_conversion(tmp_path: Path) -> None:
    """mm to m with factor = 1.0 is what was asked for; without it the units do not match."""
    write_gain(tmp_path, "A", "mm", "mm")
    write_gain(tmp_path, "B", "m", "m")
    document: dict[str, Any] = {
        "connections": [{"from": "a.z", "to": "b.u", "factor": Decimal("1.0")}],
        "experiment": {"stop_time": 1, "step_size": 1},
        "instances": {"a": {"fmu": "./A.fmu", "start": {"u": 2}}, "b": {"fmu": "./B.fmu"}},
    }
    assert simulate(make_system(document, folder=tmp_path))["b.z"][-1] == 2.0
    document["connections"] = [{"from": "a.z", "to": "b.u"}]
    with pytest.raises(DescriptionError, match="does not match"):
        make_system(document, folder=tmp_path)


# Tolerance


@pytest.mark.parametrize(
    ("experiment", "system_tolerance", "told"),
    [
        ('tolerance="1e-5"', None, (True, 1e-5)),
        ('tolerance="1e-5"', Decimal("1e-3"), (True, 1e-3)),
        ('stopTime="1"', None, (False, 0.0)),
        ("", Decimal("1e-3"), (True, 1e-3)),
    ],
)
def test_the_tolerance_of_the_file_is_passed_on(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    experiment: str,
    system_tolerance: Decimal | None,
    told: tuple[bool, float],
) -> None:
    write_gain(tmp_path, "Gain", "m", "m", experiment=experiment)
    document: dict[str, Any] = {
        "experiment": {"stop_time": 1, "step_size": 1},
        "instances": {"a": {"fmu": "./Gain.fmu"}},
    }
    if system_tolerance is not None:
        document["experiment"]["tolerance"] = system_tolerance
    calls: list[tuple[bool, float]] = []
    call = FmuInstance.call

    def spy(self: FmuInstance, function: str, *arguments: Any) -> Any:
        if function == "fmi2SetupExperiment":
            calls.append((bool(arguments[0]), arguments[1]))
        return call(self, function, *arguments)

    monkeypatch.setattr(FmuInstance, "call", spy)
    simulate(make_system(document, folder=tmp_path))
    assert calls == [told]


# An FMU alone


def test_an_fmu_is_a_system_with_the_experiment_of_its_file(tmp_path: Path) -> None:
    path = write_gain(tmp_path, "My-Gain", "m", "m", experiment='startTime="0.5" stopTime="2" stepSize="0.25"')
    system = read_system(path, {"u": 3, "My_Gain.gain": 2}, record=["z"])
    assert (system.start_time, system.stop_time, system.step_size, system.steps) == (
        Decimal("0.5"),
        Decimal("2.0"),
        Decimal("0.25"),
        6,
    )
    assert simulate(system)["My_Gain.z"].tolist() == [6.0] * 7


def test_an_fmu_without_a_step_takes_a_thousandth(tmp_path: Path) -> None:
    path = write_gain(tmp_path, "Gain", "m", "m", experiment='stopTime="2"')
    assert read_system(path).step_size == Decimal("0.002")
    assert read_system(path, step_size="0.5").steps == 4
    path = write_gain(tmp_path, "Other", "m", "m")
    with pytest.raises(DescriptionError) as caught:
        read_system(path)
    assert [problem.split(": ")[1] for problem in caught.value.problems] == [
        "experiment.stop_time",
        "experiment.step_size",
    ]


def test_the_given_end_decides_the_step_of_an_fmu_without_one(tmp_path: Path) -> None:
    path = write_gain(tmp_path, "Gain", "m", "m")
    assert read_system(path, stop_time=4).step_size == Decimal("0.004")
    assert read_system(path, stop_time="0.5").steps == 1000
    assert read_system(path, stop_time="1/3").steps == 1000
    path = write_gain(tmp_path, "Other", "m", "m", experiment='startTime="1" stopTime="2"')
    assert read_system(path, stop_time="3").step_size == Decimal("0.002")


def test_a_step_of_the_file_that_does_not_divide_its_times_ends_the_run_before(tmp_path: Path) -> None:
    path = write_gain(tmp_path, "Gain", "m", "m", experiment='startTime="0.5" stopTime="2" stepSize="0.4"')
    system = read_system(path)
    assert (system.stop_time, system.step_size, system.steps) == (Decimal("1.7"), Decimal("0.4"), 3)
    assert "the file's step of 0.4 s does not divide its times: the run ends at 1.7 s." in system.notes
    with pytest.raises(DescriptionError, match="does not divide"):
        read_system(path, stop_time="2")
    with pytest.raises(DescriptionError, match="does not divide"):
        read_system(path, step_size="0.7")


@pytest.mark.parametrize("number", ["INF", "NaN"])
def test_a_stop_time_of_a_file_that_is_not_finite_counts_as_missing(tmp_path: Path, number: str) -> None:
    path = write_gain(tmp_path, "Gain", "m", "m", experiment=f'stopTime="{number}"')
    with pytest.raises(DescriptionError, match="stop_time: missing"):
        read_system(path)
    assert read_system(path, stop_time=1.0, step_size=0.5).steps == 2


def test_an_fmu_may_be_exported_and_run_again(tmp_path: Path) -> None:
    path = write_gain(tmp_path, "Gain", "m", "m", experiment='stopTime="1" stepSize="0.5"')
    system = read_system(path, {"u": 2})
    assert read_system(write_system(system, tmp_path / "s.toml")).digest == system.digest
