"""The reference results that the FMUs carry: complete, reproducible, sound, and met by every flavour."""

from __future__ import annotations

import shutil
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from conftest import ROOT, WORKSPACE
from PIL import Image

from cosim.errors import DescriptionError
from cosim.export.assets import GUIDE, ICON, MEASURED, PICTURE, asset_files, assets, folder, measured
from cosim.export.workspace import Workspace
from cosim.model import Choice, Plant, Record, Source, declarations, variable
from cosim.reference import fmi_ls_ref as lsref
from cosim.reference.exact import Validation, scalar_names, tolerance, trace
from cosim.reference.replay import verify, verify_all
from cosim.system.ssp_package import read_document
from fmus.references.experiments import EXPERIMENTS
from fmus.references.icons import ICONS

COMPONENTS = sorted(WORKSPACE.components())
CASES = [(name, validation) for name in COMPONENTS for validation in EXPERIMENTS.get(name, ())]
NAMES = [f"{name}-{validation.name}" for name, validation in CASES]
PLANT_ROWS = 12
"""Rows of a plant that a test integrates anew; the command makes all."""


DRIFT = {"drift_amplitude": 0.1, "drift_frequency": 5.0}
OFF: dict[str, dict[str, float]] = {
    "command_max": {"command_max": 3.0},
    "position_start": {"position_start": 1e-4},
    "resolution": {"resolution": 1e-6},
    "play_positive": {"play_positive": 5e-6},
    "play_negative": {"play_negative": 5e-6},
    "drift_amplitude": DRIFT,
    "drift_frequency": DRIFT,
}
"""For options that are off in all experiments of a component: how they are switched on. Then they must be seen."""


def committed(name: str) -> Path:
    return folder(WORKSPACE.components()[name], name)


def stem(validation: Validation) -> str:
    return "".join(c if c.isalnum() else "_" for c in validation.name)


def numbers(path: Path) -> np.ndarray[Any, Any]:
    return np.array([[float(cell) for cell in row] for row in lsref.read_csv(path).rows])


def test_every_component_has_experiments_and_all_files() -> None:
    assert sorted(EXPERIMENTS) == COMPONENTS == sorted(ICONS)
    for name in COMPONENTS:
        found = {path.name for path in asset_files(WORKSPACE.components()[name], name)} - {GUIDE}
        assert found >= {lsref.MANIFEST, lsref.EXPERIMENTS, PICTURE, ICON, MEASURED}
        described = lsref.read_experiments(committed(name) / lsref.EXPERIMENTS)
        assert [e.name for e in described] == [v.name for v in EXPERIMENTS[name]]
        listed = {file.source for file in lsref.read_manifest_file(committed(name) / lsref.MANIFEST)}
        assert listed == (found - {lsref.MANIFEST, ICON, PICTURE, MEASURED}) | {f"../../documentation/{PICTURE}"}


def test_there_is_nothing_of_components_that_are_gone() -> None:
    there = {path.name for path in (ROOT / "fmus" / "references").iterdir() if path.is_dir()}
    assert there - {"__pycache__"} == set(COMPONENTS)


@pytest.mark.parametrize(("name", "validation"), CASES, ids=NAMES)
def test_the_committed_numbers_come_out_again(name: str, validation: Validation) -> None:
    kind = WORKSPACE.component(name)
    inputs = validation.inputs(kind)
    if scalar_names(kind.Input):
        assert np.array_equal(numbers(committed(name) / f"{stem(validation)}_stimuli.csv"), np.array(inputs))
    reference = numbers(committed(name) / f"{stem(validation)}_reference.csv")
    assert len(reference) == validation.steps + 1
    rows = PLANT_ROWS if issubclass(kind, Plant) else validation.steps + 1
    made = np.array(trace(kind, validation, inputs[:rows]))
    (experiment,) = (
        e for e in lsref.read_experiments(committed(name) / lsref.EXPERIMENTS) if e.name == validation.name
    )
    for column, output in enumerate(scalar_names(kind.Output)):
        limit = experiment.tolerances[output].limit(float(np.max(np.abs(reference[:, column]))))
        assert np.max(np.abs(made[:, column] - reference[:rows, column])) <= 0.1 * limit, output


@pytest.mark.parametrize(
    ("name", "validation"),
    [case for case in CASES if not issubclass(WORKSPACE.component(case[0]), Plant)],
    ids=[n for n, case in zip(NAMES, CASES, strict=True) if not issubclass(WORKSPACE.component(case[0]), Plant)],
)
def test_no_row_lies_on_a_discontinuity(name: str, validation: Validation) -> None:
    """Inputs, or of a source the time, moved by far more than rounding move the outputs by as little."""
    kind = WORKSPACE.component(name)
    straight = np.array(trace(kind, validation))
    peaks = np.max(np.abs(straight), axis=0)
    for share in (1e-11, -1e-11):
        if issubclass(kind, Source):
            source: Any = validation.component(kind)
            moved = np.array(
                [list(source.output(validation.time(row) * (1.0 + share))) for row in range(validation.steps + 1)]
            )
        else:
            inputs = [tuple(u * (1.0 + share) for u in row) for row in validation.inputs(kind)]
            moved = np.array(trace(kind, validation, inputs))
        assert np.all(np.abs(moved - straight) <= 1e-5 * peaks + 1e-15), scalar_names(kind.Output)


@pytest.mark.parametrize(("name", "validation"), CASES, ids=NAMES)
def test_experiments_are_as_they_are_described(name: str, validation: Validation) -> None:
    kind = WORKSPACE.component(name)
    assert validation.step_size in (2.0**-9, 2.0**-8, 2.0**-6, 2.0**-5), "exact in binary and in whole nanoseconds"
    assert set(validation.shown) <= set(scalar_names(kind.Output))
    assert validation.parameters, "set parameters other than the start values"
    reference = numbers(committed(name) / f"{stem(validation)}_reference.csv")
    assert np.ptp(reference[:, [scalar_names(kind.Output).index(n) for n in validation.shown]], axis=0).min() > 0.0
    parameters = committed(name) / f"{stem(validation)}_parameters.ssv"
    read_document(parameters.read_bytes(), "SystemStructureParameterValues")


@pytest.mark.parametrize("flavour", ["native", "python", "fmi3"])
def test_every_fmu_meets_its_references(flavour: str, request: pytest.FixtureRequest) -> None:
    paths = [request.getfixturevalue(flavour) / f"{name}.fmu" for name in COMPONENTS]
    for report in verify_all(paths):
        assert report.code == 0, [*report.problems, *(o.failure for o in report.outcomes)]
        assert sum(len(outcome.signals) for outcome in report.outcomes) == sum(
            len(scalar_names(WORKSPACE.component(report.path.stem).Output)) for _ in EXPERIMENTS[report.path.stem]
        )


NEEDS_EVERY_STEP = ("BallscrewStageMaxwellSlip",)
"""Plants whose discrete states act on the motion: FMPy's CVode calls completedIntegratorStep at communication points
only, and not after each of its steps as FMI asks. test_model_exchange.py drives these itself."""


@pytest.mark.parametrize(
    "name",
    [name for name in COMPONENTS if issubclass(WORKSPACE.component(name), Plant) and name not in NEEDS_EVERY_STEP],
)
def test_plants_meet_them_as_model_exchange_too(native: Path, name: str) -> None:
    report = verify(native / f"{name}.fmu", interface="me")
    assert (report.code, report.interface) == (0, "me"), report.outcomes


def replay(fmu: str, kind: Any, validation: Validation, start: dict[str, Any]) -> np.ndarray[Any, Any]:
    """The outputs that FMPy gives with the rows as they stand: it interpolates continuous inputs."""
    names = scalar_names(kind.Input)
    signals = np.array(
        [(validation.time(k), *row) for k, row in enumerate(validation.inputs(kind))],
        dtype=[(n, float) for n in ("time", *names)],
    )
    result = fmpy.simulate_fmu(
        fmu,
        start_values=start,
        input=signals,
        output=scalar_names(kind.Output),
        stop_time=validation.time(validation.steps),
        output_interval=validation.step_size,
        relative_tolerance=1e-9,
    )
    return np.column_stack([result[name] for name in scalar_names(kind.Output)])


@pytest.mark.parametrize("name", ["BallscrewStage", "PPi", "SlidingMode"])
def test_an_importer_that_interpolates_inputs_gets_the_same(native: Path, name: str) -> None:
    validation, kind = EXPERIMENTS[name][0], WORKSPACE.component(name)
    found = replay(str(native / f"{name}.fmu"), kind, validation, start_values(kind, validation))
    reference = numbers(committed(name) / f"{stem(validation)}_reference.csv")
    assert np.all(np.max(np.abs(found - reference), axis=0) <= 1e-6 * np.max(np.abs(reference), axis=0))


@pytest.mark.parametrize("name", COMPONENTS)
def test_every_parameter_has_its_part_in_an_experiment(native: Path, tmp_path: Path, name: str) -> None:
    """Each number, changed by some percent, leaves the tolerances: nothing of a component goes unseen."""
    kind = WORKSPACE.component(name)
    plant = issubclass(kind, Plant)
    if plant:
        fmpy.extract(str(native / f"{name}.fmu"), unzipdir=str(tmp_path))

    def outputs(validation: Validation, changes: dict[str, float]) -> np.ndarray[Any, Any]:
        changed = {**validation.parameters, **changes}
        changed_validation = replace(validation, parameters=changed)
        if plant:
            return replay(str(tmp_path), kind, validation, start_values(kind, changed_validation))
        return np.array(trace(kind, changed_validation))

    straight = [outputs(validation, {}) for validation in EXPERIMENTS[name]]
    share = tolerance(kind).relative
    unseen: list[str] = []
    for declaration in declarations(kind):
        if not isinstance(declaration.start, float) or declaration.name in ("tolerance", "T_s"):
            continue
        for validation, rows in zip(EXPERIMENTS[name], straight, strict=True):
            value = getattr(validation.component(kind), declaration.attribute)
            factor = 1.08 if value * 1.08 <= declaration.max else 0.92
            changes = {declaration.attribute: value * factor} if value else OFF.get(declaration.name, {})
            moved = outputs(validation, changes)
            if np.any(np.max(np.abs(moved - rows), axis=0) > share * np.max(np.abs(rows), axis=0)):
                break
        else:
            unseen.append(declaration.name)
    assert unseen == []


def start_values(kind: Any, validation: Validation) -> dict[str, Any]:
    lines = {d.attribute: d.name for d in declarations(kind)}
    values: dict[str, Any] = {}
    for attribute, value in validation.parameters.items():
        if isinstance(value, tuple):
            values |= {f"{lines[attribute]}[{i}]": item for i, item in enumerate(value, start=1)}
        else:
            values[lines[attribute]] = value.number if isinstance(value, Choice) else value
    return values


def test_both_flavours_carry_the_same_bytes(native: Path, python: Path) -> None:
    expected = assets(WORKSPACE.component("Trajectory"))
    assert {ICON, f"documentation/{PICTURE}", "documentation/fmi-ls-ref.txt"} < set(expected)
    for path in (native, python):
        with zipfile.ZipFile(path / "Trajectory.fmu") as archive:
            assert {name: archive.read(name) for name in expected} == expected
            assert MEASURED not in {Path(name).name for name in archive.namelist()}


def test_pictures_are_small_and_icons_square() -> None:
    for name in COMPONENTS:
        with Image.open(committed(name) / ICON) as icon:
            assert icon.size == (256, 256)
        assert (committed(name) / ICON).stat().st_size < 8_000
        assert (committed(name) / PICTURE).stat().st_size < 80_000


def test_icons_are_drawn_as_committed(tmp_path: Path) -> None:
    from fmus.references.icons import draw

    for name in COMPONENTS:
        draw(name, tmp_path / "icon.png")
        with Image.open(tmp_path / "icon.png") as made, Image.open(committed(name) / ICON) as kept:
            off = np.asarray(made.convert("RGB"), float) - np.asarray(kept.convert("RGB"), float)
        # another matplotlib may place a letter a little differently
        assert np.mean(np.abs(off)) < 4.0, name


def test_what_is_measured_is_within_its_tolerance() -> None:
    for name in COMPONENTS:
        facts = measured(WORKSPACE.components()[name], name)
        assert facts is not None
        for experiment in facts["experiments"]:
            assert all(s["largest_difference"] <= s["tolerance"] for s in experiment["signals"])


class Bare(Source):
    """A component without references."""

    class Output(Record):
        y: float = variable(0.0, "1", "Zero")

    def output(self, t: float) -> Output:
        return self.Output(y=0.0 * t)


def test_a_component_without_references_has_no_assets() -> None:
    assert assets(Bare) == {}
    assert measured(Path("fmus/sources/bare.py"), "Bare") is None


def test_a_changed_reference_makes_the_fmu_stale(tmp_path: Path) -> None:
    shutil.copytree(ROOT / "fmus", tmp_path / "fmus", ignore=shutil.ignore_patterns("__pycache__"))
    workspace = Workspace(tmp_path, tmp_path / "cache")
    before = {name: workspace.key(name, ("linux64",)) for name in ("Trajectory", "PPi")}
    path = folder(workspace.components()["Trajectory"], "Trajectory") / "step_reference.csv"
    path.write_bytes(path.read_bytes() + b"\n")
    after = {name: workspace.key(name, ("linux64",)) for name in ("Trajectory", "PPi")}
    assert after["Trajectory"] != before["Trajectory"]
    assert after["PPi"] == before["PPi"]
    guide = path.parents[1] / GUIDE
    guide.write_bytes(guide.read_bytes() + b"more")
    assert workspace.key("PPi", ("linux64",)) != before["PPi"]


def test_experiments_with_wrong_names_are_refused() -> None:
    wrong = Validation(name="x", description="", step_size=0.5, steps=2, shown=(), stimuli={"no_input": lambda t: t})
    with pytest.raises(DescriptionError, match="no_input"):
        wrong.inputs(WORKSPACE.component("PPi"))


class Growth(Plant):
    """A plant with a closed form."""

    class State(Record):
        x: float = variable(1.0, "1", "Value")

    class Input(Record):
        u: float = variable(0.0, "1/s", "Rate")

    class Output(Record):
        x: float = variable(0.0, "1", "Value")
        u: float = variable(0.0, "1/s", "Rate")

    def derivative(self, t: float, x: Any, u: Any) -> Any:
        return self.State(x=u.u * x.x)

    def output(self, t: float, x: Any, u: Any) -> Any:
        return self.Output(x=x.x, u=u.u)


def test_traces_of_plants_follow_the_convention() -> None:
    """Inputs of a row act over the step after it; its outputs still show the inputs of the row before."""
    growth = Validation(
        name="x", description="", step_size=0.25, steps=4, shown=(), stimuli={"u": lambda t: 1.0 if t < 0.5 else -2.0}
    )
    rows = trace(Growth, growth)
    exact = [1.0, np.exp(0.25), np.exp(0.5), np.exp(0.0), np.exp(-0.5)]
    assert [row[0] for row in rows] == pytest.approx(exact, rel=1e-9)
    assert [row[1] for row in rows] == [1.0, 1.0, 1.0, -2.0, -2.0]
