"""Fits: known truth is found, what records do not tell is named, what cannot be fitted is refused."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim import read_system, simulate
from cosim.commands.cli import main
from cosim.design import fit as fits
from cosim.design.fit_file import make_fit
from cosim.errors import DescriptionError
from cosim.fmu.tables import write_toml

TRUTH = {"plant.m": 60.0, "plant.F_C": 0.5, "plant.sigma_2": 0.012}
NOISE = {"x": 2e-8, "u": 5e-3}
SYSTEM = """
connections = [
    "trajectory.position -> controller.position_ref",
    "plant.position -> controller.position",
    { from = "controller.command", to = "plant.command", factor = 0.2, offset = 0.0 },
]
[experiment]
stop_time = 0.5
step_size = 1e-3
[instances.trajectory]
fmu = "Trajectory"
start = { kind = "sine", amplitude = 3e-3, frequency = 4.0 }
[instances.controller]
fmu = "CascadeP"
start = { K_pos = 100.0, K_vel = 400.0 }
[instances.plant]
fmu = "BallscrewStage"
start = { m = 60.0, F_C = 0.5, F_S = 0.7, v_s = 2.0, sigma_0 = 2000.0, sigma_1 = 1.0, sigma_2 = 0.012 }
"""
POSITION = {"signal": "plant.position", "column": "x"}
COMMAND = {"signal": "controller.command", "column": "u"}

Change = Callable[[dict[str, np.ndarray]], None]


def unchanged(columns: dict[str, np.ndarray]) -> None:
    pass


def problem(**changes: Any) -> dict[str, Any]:
    """A fit of three values to one record."""
    parameters = {
        "plant.m": {"start": 40.0},
        "plant.F_C": {"start": 0.8, "log": True},
        "plant.sigma_2": {"start": 0.02},
    }
    return {
        "system": "loop.toml",
        "parameters": parameters,
        "outputs": {"position": POSITION, "command": COMMAND},
        "records": {"first": {"file": "first.csv"}},
        **changes,
    }


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the system lies."""
    folder = tmp_path_factory.mktemp("fit")
    (folder / "loop.toml").write_text(SYSTEM)
    return folder


@pytest.fixture(scope="module")
def clean(folder: Path, native: Path) -> Mapping[str, np.ndarray]:
    """The signals of a run with the true values."""
    result = simulate(read_system(folder / "loop.toml", fmus=native))
    return {"t": result.time, "x": result["plant.position"], "u": result["controller.command"]}


@pytest.fixture
def record(folder: Path, clean: Mapping[str, np.ndarray]) -> Callable[..., Path]:
    """Writes a record: the clean signals, noise, and what a test changes."""

    def write(name: str, change: Change = unchanged, *, seed: int = 0, units: str = "s,m,V") -> Path:
        random = np.random.default_rng(seed)
        columns = {key: values.copy() for key, values in clean.items()}
        for key, noise in NOISE.items():
            columns[key] += noise * random.standard_normal(len(columns[key]))
        change(columns)
        rows = zip(*(values.tolist() for values in columns.values()), strict=True)
        path = folder / name
        path.write_text("\n".join([",".join(columns), units, *(",".join(map(repr, row)) for row in rows)]) + "\n")
        return path

    return write


@pytest.fixture
def fitted(folder: Path, native: Path) -> Callable[..., fits.Fitted]:
    """Carries a fit out."""

    def run(*, workers: int = 2, look: bool = False, **changes: Any) -> fits.Fitted:
        made = make_fit(problem(**changes), folder=folder, fmus=native)
        return (fits.sensitivities if look else fits.fit)(made, workers=workers)

    return run


def problems(folder: Path, native: Path, **changes: Any) -> str:
    with pytest.raises(DescriptionError) as caught:
        fits.fit(make_fit(problem(**changes), folder=folder, fmus=native), workers=1)
    return "\n".join(caught.value.problems)


Fit = Callable[..., fits.Fitted]
Write = Callable[..., Path]


def test_the_truth_lies_in_narrow_intervals(record: Write, fitted: Fit) -> None:
    record("first.csv")
    found = fitted()
    assert found.converged
    assert found.weak == ()
    for estimate in found.estimates:
        truth = TRUTH[estimate.name]
        # Four standard deviations: the truth is there for any seed, and a wrong scale of the interval would show.
        assert abs(estimate.value - truth) < 4.0 * estimate.deviation < 0.01 * truth
        assert estimate.low < estimate.value < estimate.high
    assert found.loops <= 80
    assert [c.rms for c in found.comparisons] == pytest.approx([2e-8, 5e-3], rel=0.1)


def test_the_number_of_workers_changes_nothing(record: Write, fitted: Fit) -> None:
    record("first.csv")
    assert fitted(workers=1).values == fitted(workers=2).values


def test_values_that_only_act_together_are_named(record: Write, fitted: Fit) -> None:
    record("first.csv")
    found = fitted(parameters={"plant.m": {}, "plant.J_rot": {}, "plant.F_C": {"start": 0.8}})
    assert [set(weak.names) for weak in found.weak] == [{"plant.m", "plant.J_rot"}]
    told = {estimate.name: estimate.told for estimate in found.estimates}
    assert told == {"plant.m": False, "plant.J_rot": False, "plant.F_C": True}
    assert len(found.held) == 1
    assert set(found.held) < {"plant.m", "plant.J_rot"}
    assert found.values["plant.F_C"] == pytest.approx(0.5, rel=1e-3)
    assert any("cannot tell" in sentence and "plant.J_rot" in sentence for sentence in found.findings)


def test_delay_gain_and_bias_of_a_sensor_are_found(record: Write, fitted: Fit, clean: Mapping[str, np.ndarray]) -> None:
    from scipy.interpolate import CubicSpline

    def late(columns: dict[str, np.ndarray]) -> None:
        noise = columns["x"] - clean["x"]
        spline = CubicSpline(clean["t"], clean["x"])
        columns["x"] = 1.001 * spline(np.maximum(clean["t"] - 3e-4, 0.0)) + 2e-6 + noise

    record("first.csv", late)
    free = {
        "delay": {"from": 0.0, "to": 2e-3},
        "gain": {"from": 0.9, "to": 1.1},
        "bias": {"from": -1e-4, "to": 1e-4},
    }
    found = fitted(outputs={"position": {**POSITION, **free}, "command": COMMAND})
    assert found.values["position delay"] == pytest.approx(3e-4, rel=1e-3)
    assert found.values["position gain"] == pytest.approx(1.001, rel=1e-5)
    assert found.values["position bias"] == pytest.approx(2e-6, rel=0.01)
    assert found.values["plant.m"] == pytest.approx(60.0, rel=0.005)


def test_a_validation_record_is_compared_and_not_fitted(record: Write, fitted: Fit) -> None:
    def off(columns: dict[str, np.ndarray]) -> None:
        columns["x"] += 1e-6

    record("first.csv")
    record("other.csv", off, seed=1)
    alone = fitted()
    both = fitted(records={"first": {"file": "first.csv"}, "other": {"file": "other.csv", "use": "validate"}})
    assert both.values == alone.values
    validated = [c for c in both.comparisons if c.validates]
    assert [(c.record, c.output) for c in validated] == [("other", "position"), ("other", "command")]
    assert validated[0].rms == pytest.approx(1e-6, rel=0.01)


def test_start_values_of_one_record_are_free_there_only(record: Write, fitted: Fit) -> None:
    record("first.csv")
    record("second.csv", seed=1)
    free = {"plant.position_start": {"from": -1e-4, "to": 1e-4}}
    records = {"first": {"file": "first.csv"}, "second": {"file": "second.csv", "free": free}}
    found = fitted(records=records, parameters={"plant.F_C": {"start": 0.6}})
    assert list(found.values) == ["plant.F_C", "plant.position_start (second)"]
    assert abs(found.values["plant.position_start (second)"]) < 1e-7
    assert list(found.start_values) == ["plant.F_C"]


def test_outliers_count_less_with_a_robust_loss(record: Write, fitted: Fit) -> None:
    def spoilt(columns: dict[str, np.ndarray]) -> None:
        columns["x"][100:400:7] += 1e-4

    record("first.csv", spoilt)
    off = {
        loss: abs(fitted(loss=loss, parameters={"plant.F_C": {"start": 0.6}}).values["plant.F_C"] - 0.5)
        for loss in ("linear", "soft_l1", "cauchy")
    }
    assert off["cauchy"] < off["soft_l1"] < 0.1 * off["linear"]


def test_a_fit_that_runs_out_of_runs_keeps_the_best_values(record: Write, fitted: Fit) -> None:
    record("first.csv")
    found, first = fitted(loops=9), fitted(look=True)
    assert not found.converged
    assert "loops" in found.message
    assert sum(c.rms for c in found.comparisons) < sum(c.rms for c in first.comparisons)


def test_other_starts_end_at_the_same_values(record: Write, fitted: Fit) -> None:
    record("first.csv")
    found = fitted(starts=2)
    assert len(found.costs) == 2
    assert found.costs[1] == pytest.approx(found.costs[0], rel=1e-4)


def test_records_come_in_their_own_units(record: Write, fitted: Fit) -> None:
    def in_um(columns: dict[str, np.ndarray]) -> None:
        columns["x"] *= 1e6

    record("first.csv")
    wanted = fitted().values
    record("first.csv", in_um, units="s,um,V")
    assert fitted().values == pytest.approx(wanted, rel=1e-6)


@pytest.mark.parametrize(
    ("told", "text"),
    [
        (
            ("s,um,V", {"factor": 1e-6}),
            "converted from um to m, and then multiplied by factor = 1e-06. If the factor is",
        ),
        (
            ("s,um,V", {"unit": "um", "factor": -1e-6}),
            "converted from um to m, and then multiplied by factor = -1e-06.",
        ),
        (("s,,V", {}), 'nothing says its unit: taken as m. Say it: unit = "m".'),
        (("s,um,V", {"factor": 1.02}), ""),
        (("s,V,V", {"factor": 1e-6}), ""),
        (("s,,V", {"unit": "um"}), ""),
    ],
)
def test_units_that_count_twice_or_are_missing_are_noted(
    record: Write, folder: Path, native: Path, told: tuple[str, dict[str, Any]], text: str
) -> None:
    units, output = told
    record("first.csv", units=units)
    outputs = {"position": {**POSITION, **output}, "command": COMMAND}
    notes = [n for n in make_fit(problem(outputs=outputs), folder=folder, fmus=native).notes if "column x" in n]
    assert len(notes) == bool(text)
    assert all(text in note for note in notes)


def test_the_run_begins_with_the_first_sample_of_a_record_that_drives_it(
    record: Write, fitted: Fit, folder: Path, clean: Mapping[str, np.ndarray]
) -> None:
    def later(columns: dict[str, np.ndarray]) -> None:
        columns["r"] = 3e-3 * np.sin(8.0 * math.pi * clean["t"])
        columns["t"] += 100.0

    driven = SYSTEM.replace("trajectory.position", "log.r").replace('[instances.trajectory]\nfmu = "Trajectory"\n', "")
    driven = driven.replace('start = { kind = "sine", amplitude = 3e-3, frequency = 4.0 }\n', "")
    (folder / "driven.toml").write_text(driven + '[signals.log]\nfile = "late.csv"\n')
    record("late.csv", later, units="s,m,V,m")
    records = {"late": {"file": "late.csv", "window": [100.1, 100.4]}}
    found = fitted(system="driven.toml", records=records)
    assert found.values["plant.m"] == pytest.approx(60.0, rel=0.005)
    assert found.comparisons[0].time[[0, -1]] == pytest.approx([0.1, 0.4])
    assert found.comparisons[0].rms == pytest.approx(2e-8, rel=0.1)


def test_figures_of_the_tracking_error(record: Write, fitted: Fit, clean: Mapping[str, np.ndarray]) -> None:
    def with_reference(columns: dict[str, np.ndarray]) -> None:
        columns["r"] = 3e-3 * np.sin(8.0 * math.pi * clean["t"])

    record("first.csv", with_reference, units="s,m,V,m")
    (compared,) = fitted(look=True, outputs={"position": {**POSITION, "reference": "r"}}).comparisons
    error = compared.measured - 3e-3 * np.sin(8.0 * math.pi * compared.time)
    assert compared.relative == pytest.approx(100.0 * compared.rms / math.sqrt(float(np.mean(error**2))))


# ---- refused ----


def test_a_value_that_nothing_depends_on_is_refused(record: Write, folder: Path, native: Path) -> None:
    record("first.csv")
    said = problems(folder, native, parameters={"plant.m": {}, "plant.drift_frequency": {"from": 0.0, "to": 10.0}})
    assert "plant.drift_frequency is free, but nothing depends on it" in said
    assert "plant.m" not in said


def test_a_record_without_excitation_is_refused(record: Write, folder: Path, native: Path) -> None:
    def still(columns: dict[str, np.ndarray]) -> None:
        random = np.random.default_rng(3)
        for key, noise in NOISE.items():
            columns[key] = noise * random.standard_normal(len(columns[key]))

    record("first.csv", still)
    assert "a record without excitation: position varies by" in problems(folder, native)


def test_every_problem_is_told_at_once(record: Write, folder: Path, native: Path) -> None:
    record("first.csv")
    parameters = {
        "plant.mass": {},
        "controller.position": {},
        "plant.F_C": {"start": -1.0},
        "plant.drift_frequency": {},
    }
    said = problems(folder, native, parameters=parameters)
    for words in (
        "no variable 'mass'",
        "'controller.position' is connected",
        "starts at -1 N.m, outside 0 ... inf",
        "starts at 0: give another start",
    ):
        assert words in said


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"outputs": {"x": {"signal": "plant.positon"}}}, "Did you mean 'position'?"),
        ({"records": {"first": {"file": "first.csv", "use": "validate"}}}, "Leave one to be fitted"),
        ({"records": {"first": {"file": "none.csv"}}}, "none.csv"),
        ({"records": {"first": {"file": "first.csv", "window": [0.4, 0.41]}}}, "At least 20 are needed"),
        ({"records": {"first": {"file": "first.csv", "window": [90.0, 99.0]}}}, "0 samples from 90 s"),
        ({"outputs": {"position": {**POSITION, "delay": 1e9}}}, "At least 20 are needed"),
        ({"parameters": {"plant.m": {"from": 2.0, "to": 1.0}}}, "must rise"),
        ({"outputs": {"position": {**POSITION, "delay": {"from": 0.0}}}}, "upper end"),
        ({"loss": "l1"}, "loss"),
    ],
)
def test_what_is_wrong_in_a_file_is_told(
    record: Write, folder: Path, native: Path, changes: dict[str, Any], words: str
) -> None:
    record("first.csv")
    assert words in problems(folder, native, **changes)


# ---- the command ----


def test_the_command_writes_values_that_a_system_takes(
    record: Write, folder: Path, native: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record("first.csv")
    write_toml(folder / "fit.toml", problem())
    out = folder / "out"
    page = out / "fit.html"
    arguments = ["fit", str(folder / "fit.toml"), "--output", str(out), "--report", str(page)]
    assert main([*arguments, "--fmus", str(native), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["parameters"]["plant.m"]["value"] == pytest.approx(60.0, rel=0.01)
    assert json.loads((out / "fit.json").read_text())["parameters"] == told["parameters"]
    start = dict(read_system(out / "start.toml", fmus=native).instance("plant").start)
    assert start["F_C"] == pytest.approx(told["parameters"]["plant.F_C"]["value"], rel=1e-9)
    assert "Records against the system" in page.read_text()


def test_a_folder_that_cannot_be_made_is_told_before_the_fit(
    record: Write, folder: Path, native: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record("first.csv")
    write_toml(folder / "fit.toml", problem(system="none.toml", colour=1))
    taken = folder / "loop.toml" / "out"
    assert main(["fit", str(folder / "fit.toml"), "--output", str(taken), "--fmus", str(native)]) == 2
    assert "a part of the path is a file" in capsys.readouterr().err
    assert main(["fit", str(folder / "fit.toml"), "--fmus", str(native)]) == 2
    told = capsys.readouterr().err
    assert "colour: unknown key" in told
    assert "none.toml: no such file" in told


def test_a_dry_run_shows_sensitivities_and_fits_nothing(
    record: Write, folder: Path, native: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record("first.csv")
    write_toml(folder / "fit.toml", problem())
    assert main(["fit", str(folder / "fit.toml"), "--dry-run", "--fmus", str(native)]) == 0
    told = capsys.readouterr().out
    assert "nothing fitted" in told
    assert "Change of the outputs" in told


def test_a_dry_run_writes_nothing(
    record: Write, folder: Path, native: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record("first.csv")
    write_toml(folder / "fit.toml", problem())
    there = sorted(folder.rglob("*"))
    files = ["--output", str(folder / "fitted"), "--report", str(folder / "page.html")]
    assert main(["fit", str(folder / "fit.toml"), "--dry-run", *files, "--fmus", str(native)]) == 0
    assert "--dry-run writes nothing: --output and --report are left out." in " ".join(capsys.readouterr().err.split())
    assert sorted(folder.rglob("*")) == there
