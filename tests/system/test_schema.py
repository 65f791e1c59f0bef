"""The JSON Schema of system files says what their reader reads."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from decimal import Decimal
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel, ValidationError

from cosim import DescriptionError, make_system
from cosim.system import schema
from cosim.system.findings import Findings

ROOT = Path(__file__).resolve().parents[2]
TABLES: Mapping[str, type[BaseModel]] = {
    "": schema.SystemData,
    "experiment": schema.ExperimentData,
    "instances.a": schema.InstanceData,
    "record": schema.RecordData,
    "connections, number 1": schema.ConnectionData,
    "connections, number 1, noise": schema.NoiseData,
}
"""Where the reader looks, and the model of it."""
FILES = {
    f"{path.parent.name}/{path.stem}": path
    for path in sorted(path for top in ("studies", "docs") for path in (ROOT / top).rglob("*.toml"))
    if {"instances", "experiment"} <= tomllib.loads(path.read_text(encoding="utf-8")).keys()
}


def test_keys_are_those_of_the_reader(monkeypatch: pytest.MonkeyPatch) -> None:
    known: dict[str, set[str]] = {}
    monkeypatch.setattr(
        Findings, "known_keys", lambda _, where, table, keys: known.__setitem__(where, {*known.get(where, ()), *keys})
    )
    connection = {"from": "a.y", "to": "a.u", "noise": {}}
    with pytest.raises(DescriptionError):
        make_system({"connections": [connection], "instances": {"a": {}}, "experiment": {}, "record": {}})
    of_models = {
        where: {field.alias or name for name, field in model.model_fields.items()} for where, model in TABLES.items()
    }
    # "base" is gone before the reader checks a document.
    assert known == {**of_models, "": of_models[""] - {"base"}}


@pytest.mark.parametrize("path", FILES.values(), ids=FILES)
def test_shipped_systems_have_the_shape(path: Path) -> None:
    schema.SystemData.model_validate(tomllib.loads(path.read_text(encoding="utf-8"), parse_float=Decimal))


@pytest.mark.parametrize(
    "document",
    [
        {"connections": ["a.y b.u"]},
        {"connections": [{"from": "a.y"}]},
        {"experiment": {"stoptime": 1.0}},
        {"instances": {"a b": {"fmu": "A"}}},
        {"instances": {"a": {"fmu": "A", "step_multiple": 0}}},
        {"signals": {"log": {"columns": {"x": 3}}}},
        {"record": {"variables": "plant.*"}},
    ],
)
def test_other_shapes_are_seen(document: Mapping[str, Sequence[Any]]) -> None:
    with pytest.raises(ValidationError):
        schema.SystemData.model_validate(document)
