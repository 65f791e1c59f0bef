"""``cosim check`` and the notes of ``cosim run``: what is wrong, what is worth knowing."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from conftest import Command
from fmu_files import PROBE, Variable, probe_library, write_fmu, write_gain, write_probe

from cosim.master.trial import try_system
from cosim.system.system import read_system


def notes(cosim: Command, *arguments: str | Path) -> list[str]:
    code, out, _ = cosim("check", *arguments, "--json")
    assert code == 0
    found: dict[str, Any] = json.loads(out)
    assert found["problems"] == []
    return found["notes"]


# Rules that FMUs know


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        (["plant.F_C=0"], "plant: fmi2ExitInitializationMode at 0 s returned fmi2Error. The FMU said: "),
        (["plant.F_S=0"], "F_C"),
        (["trajectory.kind=stairs"], "stairs need a dwell"),
    ],
)
def test_rules_between_parameters_are_told(native: Path, cosim: Command, settings: list[str], text: str) -> None:
    given = [item for setting in settings for item in ("--set", setting)]
    code, out, err = cosim("check", "shams2010/fsmc_5sin", "--fmus", native, *given)
    assert code == 2
    assert text in err
    assert "No problems." not in out
    code, out, _ = cosim("check", "shams2010/fsmc_5sin", "--fmus", native, *given, "--json")
    assert code == 2
    assert text in json.loads(out)["problems"][0]


def system(folder: Path, *, a: str = "", b: str = "", connections: str = '"a.y -> b.u"', experiment: str = "") -> Path:
    write_probe(folder)
    path = folder / "two.toml"
    path.write_text(
        f"connections = [{connections}]\n[experiment]\nstop_time = 1.0\nstep_size = 0.1\n{experiment}\n"
        f'[instances.a]\nfmu = "./Probe.fmu"\nstart = {{ {a} }}\n'
        f'[instances.b]\nfmu = "./Probe.fmu"\nstart = {{ {b} }}\n',
        encoding="utf-8",
    )
    return path


def test_an_fmu_that_fails_at_initialization(tmp_path: Path, cosim: Command) -> None:
    code, _, err = cosim("check", system(tmp_path, b="fail_time = -1.0, fail_function = 3"))
    assert (code, "b: fmi2" in err) == (2, True), err


def ending(folder: Path) -> Path:
    """An FMU that ends its process while it is initialized, as its gain says."""
    variables = [v for v in PROBE if v.name in ("u", "z", "gain")]
    header = {"experiment": 'stopTime="1" stepSize="1"'}
    return write_fmu(folder / "E.fmu", variables, binary=probe_library("ending").read_bytes(), **header)


@pytest.mark.parametrize(("gain", "text"), [(2, "crashed: SIGSEGV"), (3, "ended its process with exit code 5")])
def test_an_fmu_that_ends_its_process_is_named(tmp_path: Path, cosim: Command, gain: int, text: str) -> None:
    code, out, err = cosim("check", ending(tmp_path), "--set", f"gain={gain}")
    assert code == 2
    assert f"E: fmi2EnterInitializationMode at 0 s {text}" in err
    assert "No problems." not in out


def test_an_initialization_without_end_is_ended(tmp_path: Path) -> None:
    found = try_system(read_system(ending(tmp_path), {"gain": 4}), seconds=6.0)
    assert found.problem == (
        "E: fmi2EnterInitializationMode at 0 s had not come back when 6 s had passed, the limit for the initialization,"
        " and was ended."
    )


def test_problems_as_json(tmp_path: Path, cosim: Command) -> None:
    code, out, err = cosim("check", system(tmp_path, a="gan = 2.0"), "--json", "--step-size", "0.3")
    assert (code, err) == (2, "")
    assert [problem.split(": ")[1] for problem in json.loads(out)["problems"]] == [
        "instances.a.start.gan",
        "experiment.step_size",
    ]


def test_facts_as_json(native: Path, cosim: Command) -> None:
    code, out, _ = cosim("check", "shams2010/fsmc_5sin", "--fmus", native, "--json", "--order", "parallel")
    found = json.loads(out)
    assert code == 0
    assert found["instances"]["trajectory"]["start"]["kind"] == "sine"
    assert found["order"] == "parallel"
    assert found["connections"][0] == {
        "from": "trajectory.position",
        "to": "controller.position_ref",
        "factor": 1.0,
        "offset": 0.0,
        "units": "same",
        "added": False,
        "noise": None,
    }
    assert (found["steps"], found["step_size"]) == (100000, 1e-4)


def test_enumerations_are_shown_by_name_and_arrays_by_length(native: Path, cosim: Command) -> None:
    code, out, _ = cosim("check", "maeda2008/step", "--fmus", native)
    assert code == 0
    assert "kind = step" in " ".join(out.split())
    errors = f"nct.error={[k * 1e-6 for k in range(128)]}"
    code, out, _ = cosim("check", "NctfPi", "--fmus", native, "--json", "--set", errors)
    assert json.loads(out)["instances"]["NctfPi"]["start"] == {"nct.error": "128 values"}


# Notes


def test_a_forgotten_input_is_told_with_the_output_that_fits(native: Path, tmp_path: Path, cosim: Command) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(
        'base = "shams2010/fsmc_5sin"\nconnections = [\n"trajectory.position -> controller.position_ref",\n'
        '"trajectory.acceleration -> controller.acceleration_ref",\n"plant.position -> controller.position",\n'
        '"controller.command -> plant.command"]\n',
        encoding="utf-8",
    )
    found = notes(cosim, path, "--fmus", native)
    expected = [
        "instances.controller: input 'velocity_ref' is not connected and stays at 0.0 m/s. trajectory.velocity would "
        "fit: connect it, or give a start value.",
        "instances.controller: input 'velocity' is not connected and stays at 0.0 m/s. plant.velocity would fit: "
        "connect it, or give a start value.",
    ]
    assert set(expected) <= set(found)
    code, _, err = cosim("run", path, "--fmus", native, "--stop-time", "0.1")
    assert code == 0
    assert all(f"note: {note}" in err for note in expected)
    code, out, _ = cosim("run", path, "--fmus", native, "--stop-time", "0.1", "--json")
    assert set(expected) <= set(json.loads(out)["notes"])
    given = ["--set", "controller.velocity=0", "--set", "controller.velocity_ref=0"]
    assert not any("would fit" in note for note in notes(cosim, path, "--fmus", native, *given))


def test_a_forgotten_output_of_a_trajectory_is_told(native: Path, tmp_path: Path, cosim: Command) -> None:
    """Feed-forward from position_next = 0 would command -position/T_s; a measured position comes from the plant."""
    wires = ["trajectory.position -> controller.position_ref", "plant.position -> controller.motor_position"]
    path = tmp_path / "mine.toml"
    path.write_text(
        f"connections = {json.dumps([*wires, 'controller.command -> plant.command'])}\n"
        'experiment = { stop_time = 0.1, step_size = 2.5e-4 }\ninstances.trajectory.fmu = "Trajectory"\n'
        'instances.controller.fmu = "CascadePid"\ninstances.plant.fmu = "BallscrewStage"\n',
        encoding="utf-8",
    )
    fitting = [note for note in notes(cosim, path, "--fmus", native) if "would fit" in note]
    assert any("'position_next' is not connected" in n and "trajectory.position_next would fit" in n for n in fitting)
    assert any("'position' is not connected" in n and "plant.position would fit" in n for n in fitting)


def test_noise_is_told_with_its_unit(native: Path, tmp_path: Path, cosim: Command) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(
        'experiment = { stop_time = 0.1, step_size = 1e-3 }\ninstances.controller.fmu = "CascadeP"\n'
        'instances.plant.fmu = "BallscrewStage"\n'
        '[[connections]]\nfrom = "plant.position"\nto = "controller.position"\nnoise = { rms = 2e-9, seed = 1 }\n',
        encoding="utf-8",
    )
    code, out, _ = cosim("check", path, "--fmus", native)
    assert code == 0
    assert "plant.position -> controller.position (noise of 2e-09 m rms)" in out


def test_an_input_that_the_parameters_switch_off_is_not_forgotten(native: Path, cosim: Command) -> None:
    """The controller differentiates the position: its input velocity does nothing."""
    difference = notes(cosim, "maeda2008/step", "--fmus", native)
    assert not any("would fit" in note for note in difference)
    measured = notes(cosim, "maeda2008/step", "--fmus", native, "--set", "controller.velocity_source=input")
    assert any("plant.velocity would fit" in note for note in measured)


def test_the_output_of_the_same_axis_fits(tmp_path: Path, cosim: Command) -> None:
    parts = [v for v in PROBE if v.name in ("u", "z", "gain")]
    renamed = [replace(v, name={"u": "force", "z": "velocity", "gain": "gain"}[v.name]) for v in parts]
    renamed = [replace(v, depends_on=("force",)) if v.causality == "output" else v for v in renamed]
    controller = [replace(v, name={"u": "velocity", "z": "command", "gain": "gain"}[v.name]) for v in parts]
    controller = [replace(v, depends_on=("velocity",)) if v.causality == "output" else v for v in controller]
    for name, variables in (("Plant", renamed), ("Controller", controller)):
        write_fmu(tmp_path / f"{name}.fmu", variables, binary=probe_library().read_bytes())
    instances = "".join(
        f'[instances.{kind.lower()}_{axis}]\nfmu = "./{kind}.fmu"\n'
        for kind in ("Plant", "Controller")
        for axis in "xy"
    )
    path = tmp_path / "axes.toml"
    path.write_text(f"[experiment]\nstop_time = 1.0\nstep_size = 0.1\n{instances}", encoding="utf-8")
    found = notes(cosim, path)
    for axis in "xy":
        assert any(
            f"controller_{axis}: input 'velocity'" in n and f"plant_{axis}.velocity would fit" in n for n in found
        )


def test_other_unconnected_inputs_are_listed(native: Path, tmp_path: Path, cosim: Command) -> None:
    assert "instances.plant: unconnected inputs stay at load_torque = 0.0 N.m." in notes(
        cosim, "shams2010/fsmc_5sin", "--fmus", native
    )
    path = system(tmp_path, a="u = 1.0, count_in = 2, flag_in = true")
    assert notes(cosim, path) == ["instances.b: unconnected inputs stay at count_in = 0, flag_in = false."]


@pytest.mark.parametrize(("step", "samples"), [("1e-2", 100), ("2e-4", 2), ("1e-4", None), ("5e-5", None)])
def test_samples_that_the_step_does_not_meet(native: Path, cosim: Command, step: str, samples: int | None) -> None:
    found = notes(cosim, "shams2010/fsmc_5sin", "--fmus", native, "--step-size", step)
    text = f"it takes {samples} samples a step with inputs that do not change"
    assert any(text in note for note in found) == (samples is not None)
    assert any("samples a step" in note for note in found) == (samples is not None)


@pytest.mark.parametrize(("stated", "times"), [("1e-3", 500), ("5e-3", 100), ("1e-2", None), ("0", None)])
def test_a_step_far_beyond_that_of_the_file_is_told(
    tmp_path: Path, cosim: Command, stated: str, times: int | None
) -> None:
    path = write_gain(tmp_path, "Gain", "m", "m", experiment=f'stopTime="1" stepSize="{stated}"')
    found = [note for note in notes(cosim, path, "--step-size", "0.5") if "that of its file" in note]
    assert len(found) == (times is not None)
    assert all(f"its step of 0.5 s is {times} times that of its file, {float(stated):g} s." in note for note in found)


@pytest.mark.parametrize(("sampling", "samples"), [("1", 2), ("20", 1), ("0.05", None), ("1e-3", None)])
def test_a_controller_that_hardly_samples_is_told(
    native: Path, cosim: Command, sampling: str, samples: int | None
) -> None:
    setting = ("--set", f"controller.T_s={sampling}", "--stop-time", "1")
    found = notes(cosim, "shams2010/fsmc_5sin", "--fmus", native, *setting)
    assert any(f"it takes only {samples} samples in the run of 1 s" in n for n in found) == (samples is not None)
    assert any("samples in the run" in note for note in found) == (samples is not None)


@pytest.mark.parametrize(
    ("T_s", "said"), [("0.1", "T_s = 0.0001 s against a communication step of 0.01 s"), ("10", "")]
)
def test_a_sampling_time_counts_in_its_unit(tmp_path: Path, cosim: Command, T_s: str, said: str) -> None:
    variables = [*(v for v in PROBE if v.name in ("u", "z")), Variable("T_s", "parameter", 3, start=T_s, unit="ms")]
    path = write_fmu(tmp_path / "Foreign.fmu", variables, binary=probe_library().read_bytes())
    found = [note for note in notes(cosim, path, "--step-size", "1e-2", "--stop-time", "1") if "T_s" in note]
    assert len(found) == bool(said)
    assert all(said in note for note in found)


@pytest.mark.parametrize(
    ("setting", "text"),
    [
        ("trajectory.repetitions=3", "start.repetitions: 3 has no effect"),
        ("trajectory.jerk_max=9", "start.jerk_max: 9 m/s3 has no effect"),
        ("trajectory.out_and_back=true", "start.out_and_back: true has no effect"),
        ("trajectory.turns=3", ""),
        ("trajectory.radius=0.03", ""),
        ("trajectory.phase=0.3", ""),
    ],
)
def test_a_start_value_of_another_kind_is_told(native: Path, cosim: Command, setting: str, text: str) -> None:
    kind = ("--set", "trajectory.kind=circle", "--set", "trajectory.turns=2")
    found = notes(cosim, "shams2010/fsmc_5sin", "--fmus", native, *kind, "--set", setting, "--stop-time", "40")
    name = setting.partition("=")[0].rpartition(".")[2]
    told = [note for note in found if f"start.{name}:" in note]
    if text:
        assert text in told[0]
        assert told[0].endswith("Is it of another kind than kind = circle?")
    else:
        assert told == []


def test_an_amplitude_of_zero_hides_nothing(native: Path, cosim: Command) -> None:
    zero = ("--set", "trajectory.amplitude=0", "--set", "trajectory.frequency=2")
    found = notes(cosim, "shams2010/fsmc_5sin", "--fmus", native, *zero)
    assert not any("no effect" in note for note in found)


def test_an_fmu_that_needs_its_tool_is_told(tmp_path: Path, cosim: Command) -> None:
    variables = [v for v in PROBE if v.name in ("u", "z", "gain")]
    binary = probe_library().read_bytes()
    write_fmu(tmp_path / "T.fmu", variables, binary=binary, attributes='needsExecutionTool="true"')
    found = notes(cosim, tmp_path / "T.fmu", "--stop-time", "1", "--step-size", "1")
    assert found[0] == "instances.T: T runs only where the tool that made it is installed."


def test_values_that_are_not_finite_at_the_start_are_told(tmp_path: Path, cosim: Command) -> None:
    path = write_gain(tmp_path, "G", "m", "m", experiment='stopTime="1" stepSize="1"')
    found = notes(cosim, path, "--set", "gain=1e308", "--set", "u=1e308")
    assert "G.z is inf after initialization." in found


# One FMU


def test_one_fmu_runs_by_path_or_name(native: Path, tmp_path: Path, cosim: Command) -> None:
    plot = tmp_path / "move.png"
    given = ("--set", "kind=quintic", "--stop-time", "1")
    code, out, err = cosim("run", "Trajectory", "--fmus", native, *given, "--plot", plot)
    assert (code, err) == (0, "")
    assert plot.read_bytes().startswith(b"\x89PNG")
    code, out, _ = cosim("run", native / "Trajectory.fmu", *given, "--json")
    assert (code, json.loads(out)["steps"]) == (0, 10000)


def test_an_order_that_is_none_is_suggested(native: Path, cosim: Command) -> None:
    code, _, err = cosim("check", "shams2010/fsmc_5sin", "--fmus", native, "--order", "sequencial")
    assert code == 2
    assert "'sequencial' is no order. Did you mean 'sequential'?" in err
    code, _, err = cosim("check", "shams2010/fsmc_5sin", "--fmus", native, "--order", "paralel")
    assert "Did you mean 'parallel'?" in err


def test_a_nan_comes_first_and_ends_with_1(tmp_path: Path, cosim: Command) -> None:
    path = write_gain(tmp_path, "G", "m", "m", experiment='stopTime="1" stepSize="0.5"')
    code, _, err = cosim("run", path, "--set", "gain=1e308", "--set", "u=1e308")
    assert code == 1
    assert err.splitlines()[0] == "error: G.z is not finite from 0 s on. No figure is computed from these."


def test_names_are_found_from_another_folder(
    native: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cosim: Command
) -> None:
    monkeypatch.chdir(tmp_path)
    for arguments, text in (
        (("list",), "Trajectory"),
        (("info", "Trajectory"), "repetitions"),
        (("check", "Trajectory"), "No problems."),
        (("fmus", "copy", "mine", "Trajectory"), "Trajectory"),
        (("linearize", "NominalStage"), "velocity"),
    ):
        code, out, err = cosim(*arguments)
        assert (code, err) == (0, ""), arguments
        assert text in out
    assert (tmp_path / "mine" / "Trajectory.fmu").read_bytes() == (native / "Trajectory.fmu").read_bytes()


def test_list_names_every_study(cosim: Command) -> None:
    _, out, _ = cosim("list")
    assert "ranking" in out.splitlines()[-1]
    assert "feng2015/learned" not in out
