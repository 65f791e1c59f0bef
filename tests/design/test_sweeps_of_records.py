"""Sweeps of systems that records feed: over FMUs' parameters, and over records, factors and times."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmu_files import write_probe

from cosim.design.dataset import DataSet
from cosim.design.plan import make_sweep
from cosim.design.sweep import sweep
from cosim.errors import DescriptionError
from cosim.fmu.tables import write_toml

TIME = np.arange(9) * 0.125


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_probe(tmp_path)
    for name, scale in (("one", 1.0), ("two", 2.0)):
        rows = np.column_stack((TIME, scale * TIME))
        np.savetxt(tmp_path / f"{name}.csv", rows, delimiter=",", header="t,x", comments="")
    columns = {"x": {"column": "x", "factor": 1.0, "unit": "V"}}
    system = {
        "connections": ["log.x -> a.u"],
        "experiment": {"stop_time": 1.0, "step_size": 0.125},
        "instances": {"a": {"fmu": "./Probe.fmu"}},
        "signals": {"log": {"file": "one.csv", "extend": "hold", "columns": columns}},
    }
    write_toml(tmp_path / "s.toml", system)
    return tmp_path


def plan(folder: Path, parameters: dict[str, Any]) -> Any:
    document = {"system": "s.toml", "parameters": parameters, "metrics": {"z": {"of": "max_abs", "signal": "a.z"}}}
    return make_sweep(document, folder=folder, fmus=folder)


@pytest.mark.parametrize(
    ("path", "values", "figures"),
    [
        ("a.gain", [1.0, 3.0], [1.0, 3.0]),
        ("log.file", ["one.csv", "two.csv"], [1.0, 2.0]),
        ("log.columns.x.factor", [0.5, 4.0], [0.5, 4.0]),
        ("log.columns.x.offset", [0.0, 1.0], [1.0, 2.0]),
        ("log.start_time", [-0.5, 0.0], [0.5, 1.0]),
    ],
)
def test_runs_differ_in_what_is_swept(folder: Path, path: str, values: list[Any], figures: list[float]) -> None:
    sweep(plan(folder, {path: values}), output=folder / "out")
    rows = DataSet(folder / "out").read().to_pydict()
    assert rows[path] == values
    assert rows["z"] == pytest.approx(figures)


@pytest.mark.parametrize(
    ("path", "text"),
    [
        ("log.fil", "'fil' cannot be set. Did you mean 'file'?"),
        ("log.columns.y.factor", "'columns.y.factor' cannot be set. Did you mean 'columns.x.factor'?"),
        ("lg.file", "no instance 'lg'"),
    ],
)
def test_what_cannot_be_swept(folder: Path, path: str, text: str) -> None:
    with pytest.raises(DescriptionError, match=text):
        plan(folder, {path: [1.0, 2.0]})


def test_another_record_makes_another_sweep(folder: Path) -> None:
    before = plan(folder, {"a.gain": [1.0, 2.0]}).digest
    (folder / "one.csv").write_bytes((folder / "two.csv").read_bytes())
    assert plan(folder, {"a.gain": [1.0, 2.0]}).digest != before


def test_a_swept_record_counts_by_its_content_and_is_checked_before_the_first_run(folder: Path) -> None:
    before = plan(folder, {"log.file": ["one.csv", "two.csv"]}).digest
    (folder / "two.csv").write_bytes((folder / "one.csv").read_bytes())
    assert plan(folder, {"log.file": ["one.csv", "two.csv"]}).digest != before
    with pytest.raises(DescriptionError, match=r"three\.csv: no such file"):
        plan(folder, {"log.file": ["one.csv", "three.csv"]})
