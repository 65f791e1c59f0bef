"""Sweep, tuning and map files of wrong shape: every problem at once, with file, key and remedy. JSON Schemas."""

from __future__ import annotations

import runpy
import tomllib
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel

from cosim.design.documents import MapData, SweepData, TuningData
from cosim.design.plan import make_sweep
from cosim.design.stability import read_map
from cosim.errors import DescriptionError
from cosim.fmu.tables import checked, toml, write_start

ROOT = Path(__file__).parents[2]
SCHEMAS = runpy.run_path(str(ROOT / "docs" / "schemas" / "write.py"))
SWEEP: dict[str, Any] = {"system": "loop.toml", "parameters": {"a.b": [1.0]}}
TUNING: dict[str, Any] = {"system": "loop.toml", "objective": "rms", "parameters": {"a.b": {"from": 1.0, "to": 2.0}}}
MAP: dict[str, Any] = {"system": "loop.toml", "alpha": 505.0, "K": 0.03, "W": [0.1], "cases": {"one": {}}}


@pytest.mark.parametrize(
    ("model", "document", "told"),
    [
        (SweepData, {**SWEEP, "parameters": 3}, ["f.toml: parameters: must be a table, not 3."]),
        (SweepData, {**SWEEP, "parameters": {}}, ["f.toml: parameters: none given."]),
        (
            SweepData,
            {"parameters": {"a.b": [[1]]}},
            ["f.toml: system: missing.", "parameters.a.b[1]: must be a number"],
        ),
        (SweepData, {**SWEEP, "methd": "grid", "timeout": 0}, ["Did you mean 'method'?", "timeout: must be greater"]),
        (
            SweepData,
            {**SWEEP, "parameters": {"a.b": {"from": 1, "form": 1}}},
            ["a.b.form: unknown", "a.b.to: missing: write {"],
        ),
        (
            SweepData,
            {**SWEEP, "metrics": {"rms": {"of": 3}}},
            ["metrics.rms.signal: missing", "rms.of: must be a text"],
        ),
        (SweepData, {**SWEEP, "experiment": {"stoptime": 1}}, ["Did you mean 'stop_time'?"]),
        (TuningData, {**TUNING, "limits": 3}, ["f.toml: limits: must be a table, not 3."]),
        (
            TuningData,
            {**TUNING, "limits": {"x": "low"}, "seed": 1.5},
            ["limits.x: must be a number", "seed: must be a wh"],
        ),
        (
            TuningData,
            {**TUNING, "parameters": {"a.b": [1.0]}},
            ["parameters.a.b: must be a table, not a list: write {"],
        ),
        (SweepData, {**SWEEP, "method": "latin", "count": 10**30}, ["count: must be less than or equal to 1000000"]),
        (SweepData, {**SWEEP, "seed": -1}, ["f.toml: seed: must be greater than or equal to 0"]),
        (TuningData, {**TUNING, "population": 2**63}, ["population: must be less than or equal to 1000000"]),
        (TuningData, {**TUNING, "generations": 10**5, "population": 50}, ["ask for 5000000 runs; at most 1000000"]),
        (MapData, {**MAP, "K": 10**400}, ["f.toml: K: must be a finite number"]),
        (MapData, {**MAP, "K": "fast" * 9999}, [f"f.toml: K: must be a number, not '{'fast' * 50} ...'."]),
        (MapData, {**MAP, "W": [1e300]}, ["f.toml: W[1]: must be less than 3.14"]),
        (MapData, {**MAP, "K": "fast"}, ["f.toml: K: must be a number, not 'fast'."]),
        (MapData, {**MAP, "cases": {"one": {"nct": True}}}, ["cases.one.nct: the NCT is identified from a pulse"]),
        (
            MapData,
            {**MAP, "W": [0.1, -1.0], "cases": {"one": {"nct": "yes"}}},
            ["W[2]: must be", "nct: must be true or"],
        ),
    ],
)
def test_wrong_shapes_are_told_with_file_key_and_remedy(
    model: type[BaseModel], document: dict[str, Any], told: list[str]
) -> None:
    _, problems = checked(document, model, "f.toml")
    assert len(problems) == len(told), problems
    for text in told:
        assert any(text in problem for problem in problems), problems


@pytest.mark.parametrize(("model", "document"), [(SweepData, SWEEP), (TuningData, TUNING), (MapData, MAP)])
def test_right_shapes_are_taken(model: type[BaseModel], document: dict[str, Any]) -> None:
    assert checked(document, model, "f.toml")[1] == []


def test_a_file_that_is_no_toml_is_told(tmp_path: Path) -> None:
    file = tmp_path / "map.toml"
    file.write_text("K = ", encoding="utf-8")
    with pytest.raises(DescriptionError, match=r"map\.toml: not valid TOML"):
        read_map(file)


@pytest.mark.parametrize("name", SCHEMAS["MODELS"])
def test_schemas_are_those_of_the_models(name: str) -> None:
    """python docs/schemas/write.py writes them anew."""
    assert (ROOT / "docs" / "schemas" / f"{name}.json").read_text(encoding="utf-8") == SCHEMAS["schema"](name)


def test_what_is_written_is_read_again(tmp_path: Path) -> None:
    values = {"a.K": 1.0 / 3.0, "a.nct.error": [0.1, 0.2], 'b.odd "name"': "x"}
    text = write_start(tmp_path / "start.toml", values, base="base.toml", comment="two\nlines", digits=6).read_text()
    assert text.startswith("# two\n# lines\n")
    assert tomllib.loads(text) == {
        "base": "base.toml",
        "instances": {"a": {"start": {"K": 0.333333, "nct.error": [0.1, 0.2]}}, "b": {"start": {'odd "name"': "x"}}},
    }
    assert tomllib.loads(toml({"x": [1.0, True]})) == {"x": [1.0, True]}


def test_a_file_anywhere_may_name_a_system_that_comes_with_cosim(tmp_path: Path) -> None:
    wanted = "maeda2008/step_1mm"
    assert (
        make_sweep({"system": wanted, "parameters": {"plant.m": [1.0]}}, folder=tmp_path).system.name == "step_1mm.toml"
    )
    with pytest.raises(DescriptionError, match="maeda2008/step_2mm"):
        make_sweep({"system": "maeda2008/step_2mm.toml", "parameters": {"plant.m": [1.0]}}, folder=tmp_path)
