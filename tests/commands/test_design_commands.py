"""The design tools on the command line: JSON that is the API's result, files, exit codes, help."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim.commands.cli import main

STUDIES = Path(__file__).parents[2] / "studies"
MAEDA = STUDIES / "maeda2008"
COMMANDS = [
    ["sweep"],
    ["identify", "nct"],
    ["stability", "linear"],
    ["stability", "practical"],
    ["stability", "map"],
    ["learn", "friction-pulse"],
    ["tune"],
    ["linearize"],
]


@pytest.fixture
def call(native: Path, capsys: pytest.CaptureFixture[str]) -> Any:
    def called(*arguments: object, fmus: bool = True) -> Any:
        place = ["--fmus", str(native)] if fmus else []
        assert main([*(str(argument) for argument in arguments), "--json", *place]) == 0
        return json.loads(capsys.readouterr().out)

    return called


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_help_has_an_example(command: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main([*command, "--help"])
    assert end.value.code == 0
    assert f"examples: cosim {' '.join(command)}" in " ".join(capsys.readouterr().out.split())


def test_start_up_does_not_load_what_only_tools_need() -> None:
    heavy = ("scipy", "distributed", "dask", "control", "matplotlib", "numpy", "cosim.master.simulation")
    code = f"import sys, cosim.commands.cli; print([name for name in {heavy!r} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_sweep(call: Any, tmp_path: Path) -> None:
    file = tmp_path / "sweep.toml"
    system = json.dumps(str(MAEDA / "gain.toml"))
    parameters = '"controller.K_P" = [500.0, 900.0]'
    file.write_text(f"system = {system}\n[parameters]\n{parameters}\n[experiment]\nstop_time = 0.1\n", encoding="utf-8")
    found = call("sweep", file, "--output", tmp_path / "data", "--workers", 0)
    assert (found["runs"], found["new"], found["failed"]) == (2, 2, 0)
    units = {name: spread["unit"] for name, spread in found["figures"].items()}
    assert (units["error_rms"], units["command_max"], units["command_tv"]) == ("m", "A", "A/s")
    assert "| error_rms | m | " in Path(found["report"]).read_text(encoding="utf-8")
    assert call("sweep", file, "--output", tmp_path / "data", "--workers", 0)["new"] == 0


def test_identify(call: Any, tmp_path: Path) -> None:
    files = [tmp_path / name for name in ("nct.csv", "start.toml", "nct.png")]
    gains = ["--omega-n", 1250.0, "--zeta", 6.264]
    where = ["--output", files[0], "--start", files[1], "--plot", files[2]]
    found = call("identify", "nct", MAEDA / "pulse.toml", "--alpha", 505, *gains, *where)
    assert found["e_lin"] == pytest.approx(0.6426e-6, rel=1e-2)
    assert found["K_I"] == pytest.approx(1250.0**2 / (505.0 * found["K"]))
    assert all(path.stat().st_size > 1000 for path in files)


def test_stability(call: Any, tmp_path: Path) -> None:
    linear = call("stability", "linear", "--W", 0.1, 0.9, "--alpha", 505, "--T-s", 2e-4, fmus=False)["limits"]
    assert linear[0]["zeta_max"] == pytest.approx(9.665, rel=1e-3)
    assert linear[1]["closed_form_max"] is None
    practical = call("stability", "practical", MAEDA / "gain.toml", "--first", 2000)
    assert practical["limit"] == pytest.approx(2395.0, rel=0.03)
    changed = call(
        "stability", "practical", MAEDA / "gain.toml", "--first", 1500, "--set", "controller.compute_delay=1"
    )
    assert changed["limit"] == pytest.approx(1832.0, rel=0.03)


def test_map(call: Any, tmp_path: Path) -> None:
    file = tmp_path / "map.toml"
    file.write_text(
        f"system = {json.dumps(str(MAEDA / 'gain.toml'))}\nalpha = 505.0\nK = 32.3e-3\nW = [0.25]\n"
        "[cases.nominal]\nfirst = 2000.0\n",
        encoding="utf-8",
    )
    found = call("stability", "map", file, "--plot", tmp_path / "map.png")
    assert found["points"][0]["found"] == pytest.approx(13.5, rel=0.05)
    assert found["mean_deviation"] == pytest.approx(1.0 - 13.5 / 15.6, abs=0.02)
    assert (tmp_path / "map.png").is_file()


def test_learn_and_monitor(call: Any, tmp_path: Path) -> None:
    common = ["learn", "friction-pulse", STUDIES / "feng2015" / "circle.toml", "--axis", "x", "--output", tmp_path]
    first = call(*common)["pulses"]["pulse_x"]
    assert first["runs"] == {"peak": 4, "duration": 360, "coarse": 143, "fine": 275}
    kept = call(*common, "--monitor")
    assert kept["tables"] is None
    assert kept["pulses"]["pulse_x"]["monitored_ratio"] == pytest.approx([1.0] * 4)
    changed = call(*common, "--monitor", "--set", "plant_x.friction_scale=1.3")["pulses"]["pulse_x"]
    assert changed["learned"]
    assert max(changed["monitored_ratio"]) > 1.5
    assert np.all(np.array(changed["amplitudes"]) >= np.array(first["amplitudes"]) - 1e-5)


def test_tune(call: Any, tmp_path: Path) -> None:
    file = tmp_path / "tuning.toml"
    file.write_text(
        f'system = {json.dumps(str(MAEDA / "gain.toml"))}\nobjective = "error_rms"\ngenerations = 1\npopulation = 4\n'
        '[parameters]\n"controller.K_P" = { from = 200.0, to = 900.0 }\n[experiment]\nstop_time = 0.05\n',
        encoding="utf-8",
    )
    found = call("tune", file, "--start", tmp_path / "start.toml")
    assert found["feasible"]
    assert 200.0 <= found["parameters"]["controller.K_P"] <= 900.0
    assert "K_P" in (tmp_path / "start.toml").read_text(encoding="utf-8")
    assert 'base = "maeda2008/gain"' in (tmp_path / "start.toml").read_text(encoding="utf-8")


def test_linearize(call: Any, native: Path, tmp_path: Path) -> None:
    alone = call("linearize", native / "NominalStage.fmu", "--set", "alpha=50", "--inputs", "command")
    assert alone["A"] == [[0.0, 1.0], [0.0, -50.0]]
    changes = ["controller.sensor_resolution=0", "plant.F_C=0", "plant.F_S=0", "controller.K_P=400"]
    ends = ["--inputs", "command", "--outputs", "position"]
    picture = ["--margins", "--plot", tmp_path / "bode.png"]
    found = call(
        "linearize", MAEDA / "gain.toml", "--at", "t=0", "--set", "trajectory.amplitude=0", *changes, *ends, *picture
    )
    assert 400.0 * found["margins"]["gain"] == pytest.approx(653.1, rel=5e-3)
    assert (tmp_path / "bode.png").is_file()


def test_linearize_prints_equations_poles_and_margins(native: Path, capsys: pytest.CaptureFixture[str]) -> None:
    values = ["--set", "trajectory.amplitude=0", "controller.sensor_resolution=0", "plant.F_C=0", "plant.F_S=0"]
    values.append("controller.K_P=400")
    system = str(MAEDA / "gain.toml")
    given = ["linearize", system, *values, "--inputs", "command", "--outputs", "position", "--fmus", str(native)]
    assert main([*given, "--margins"]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    # m*der(velocity) = K_n*d + C_n*(l_p*speed - velocity), start values of the FMU
    assert "= -476.19*state.velocity + 232493*deflection +" in shown
    assert "Pole / 1/s Frequency / Hz Damping Time constant / s" in shown
    for line in (r"Stable yes", r"Gain [\d.]+ dB factor [\d.]+, at [\d.]+ Hz", r"Phase [\d.]+ deg at [\d.]+ Hz"):
        assert re.search(line, shown)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["sweep", "none.toml"], "no such file"),
        (["identify", "nct", "none.toml"], "no such file"),
        (["stability", "map", "none.toml"], "no such file"),
        (["tune", "none.toml"], "no such file"),
        (["linearize", "x.toml", "--at", "now"], "give seconds"),
        (["identify", "nct", "x.csv", "--zeta", "1"], "go together"),
        (["learn", "friction-pulse", "x.toml", "--set", "a.b"], "INSTANCE.VARIABLE=VALUE"),
        (["stability", "linear", "--alpha", "505", "--T-s", "2e-4", "--W", "0.1", "3.2"], "omega_n*T_s below pi"),
        (["stability", "practical", "maeda2008/step", "--first", "400", "--last", "300"], "gains from 400 to 300"),
        (["stability", "practical", "maeda2008/step", "--first", "5e-324"], "gains from 4.94066e-324"),
    ],
)
def test_what_is_wrong_is_said(arguments: list[str], text: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 2
    assert text in capsys.readouterr().err
    assert "Traceback" not in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "option", "rule"),
    [
        (["stability", "linear", "--T-s", "1"], "--alpha", "must be a finite number above 0"),
        (["stability", "practical", "x.toml"], "--first", "must be a finite number above 0"),
        (["identify", "nct", "x.csv"], "--zeta", "must be a finite number above 0"),
        (["tune", "x.toml"], "--workers", "must be a whole number of at least 1"),
        (["study", "x"], "--jobs", "must be a whole number of at least 1"),
    ],
)
@pytest.mark.parametrize("value", ["nan", "inf", "-1", "0", "", "x"])
def test_numbers_that_nothing_can_have(
    arguments: list[str], option: str, rule: str, value: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as end:
        main([*arguments, f"{option}={value}"])
    assert end.value.code == 2
    assert f"argument {option}: {rule}, not '{value}'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "option"),
    [
        (["tune", "x.toml"], "--start"),
        (["identify", "nct", "x.csv"], "--start"),
        (["identify", "nct", "x.csv"], "--output"),
        (["learn", "friction-pulse", "x.toml"], "--output"),
        (["study", "shams2010"], "--output"),
    ],
)
def test_files_that_cannot_be_written_are_known_before_the_work(
    arguments: list[str], option: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").touch()
    assert main([*arguments, option, str(tmp_path / "file" / "a.toml")]) == 2
    assert "a part of the path is a file" in capsys.readouterr().err
