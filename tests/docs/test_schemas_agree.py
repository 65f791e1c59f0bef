"""The JSON Schema and the reader of each file format accept the same documents: shipped files, changed at random."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from cosim.errors import DescriptionError
from cosim.fmu.text import read_toml
from cosim.result.metrics import OF_ONE_SIGNAL
from cosim.system.system import System, make_system, read_system
from docs.schemas.write import MODELS, schema

ROOT = Path(__file__).resolve().parents[2]
Document = dict[str, Any]
SCHEMAS = {name: json.loads(schema(name)) for name in MODELS}
KEYS = {
    name: sorted({key for table in (top, *top.get("$defs", {}).values()) for key in table.get("properties", {})})
    for name, top in SCHEMAS.items()
}
VALUES: tuple[Any, ...] = (
    *(True, False, 0, 1, -1, 3, 2.0, 0.5, -0.5, 1e300),
    *("", "text", "a.b", "true", "5", "0.1", "1/30", "1 mm", "none", "hold", "convert", "at least", "sequential"),
    *([], {}, [1], [1.0, 2.0], ["a"], [True], [[1.0]], {"a": 1}, {"from": 1.0, "to": 2.0}, {"rms": 1e-9, "seed": 1.0}),
)
"""Values that take the place of others. JSON has no numbers that are not finite, so none is here."""
EXAMPLES = settings(max_examples=400, derandomize=True, deadline=None)


def plain(value: Any) -> Any:
    """A document with numbers as JSON has them."""
    return json.loads(json.dumps(value, default=float))


def shipped() -> dict[str, list[Document]]:
    """The shipped files of each format."""
    found: dict[str, list[Document]] = {name: [] for name in MODELS}
    for top in ("studies", "docs"):
        for path in sorted((ROOT / top).rglob("*.toml")):
            document = plain(read_toml(path))
            for name in MODELS:
                if not refusals(name, document):
                    found[name].append(document)
    return found


def refusals(name: str, document: Document) -> list[str]:
    """Types of the errors with which a model refuses a document; "value_error" is a rule between several keys."""
    try:
        model = MODELS[name].model_validate(document)
    except ValidationError as error:
        return [detail["type"] for detail in error.errors()]
    # The reader of runs checks this name with a message of its own.
    asked = getattr(model, "metrics", {}).values()
    return [] if all(getattr(figure, "of", "rms") in OF_ONE_SIGNAL for figure in asked) else ["no figure"]


SHIPPED = shipped()


def places(value: Any, place: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The places of all values inside a document."""
    for key, inner in value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ():
        yield (*place, key)
        yield from places(inner, (*place, key))


def changed(document: Document, keys: list[str], draw: Callable[[st.SearchStrategy[Any]], Any]) -> Document:
    """A document with one to three changes: a value replaced, wrapped, written otherwise, added or left out."""
    document = copy.deepcopy(document)
    for _ in range(draw(st.integers(1, 3))):
        known = list(places(document))
        if not known:
            break
        *way, key = draw(st.sampled_from(known))
        table: Any = document
        for step in way:
            table = table[step]
        value = copy.deepcopy(draw(st.sampled_from(VALUES)))
        match draw(st.sampled_from(("replace", "replace", "add", "leave out", "wrap", "write"))):
            case "replace":
                table[key] = value
            case "add" if isinstance(table, dict):
                table[draw(st.sampled_from((*keys, "unknown", "a b", "x-y", "")))] = value
            case "add":
                table.insert(key, value)
            case "leave out":
                del table[key]
            case "wrap":
                table[key] = [table[key]]
            case _:
                old = table[key]
                table[key] = str(old) if isinstance(old, int | float | str) else old
                if isinstance(old, int | float) and not isinstance(old, bool):
                    table[key] = draw(st.sampled_from((float(old), -old, str(old))))
    return document


@pytest.mark.parametrize("name", MODELS)
def test_the_schema_accepts_what_the_reader_accepts(name: str) -> None:
    validator = jsonschema.Draft202012Validator(SCHEMAS[name])
    assert SHIPPED[name]
    agreed: dict[bool, int] = {True: 0, False: 0}

    @EXAMPLES
    @given(st.data())
    def agree(data: st.DataObject) -> None:
        document = changed(data.draw(st.sampled_from(SHIPPED[name])), KEYS[name], data.draw)
        found = refusals(name, document)
        wrong = next(validator.iter_errors(document), None)
        if found and set(found) == {"value_error"}:
            return  # JSON Schema cannot say a rule between several keys
        assert (not found) == (wrong is None), (found, wrong and (list(wrong.absolute_path), wrong.message))
        agreed[wrong is None] += 1

    agree()
    assert min(agreed.values()) > 20  # both answers are met


# System files are read without the models, because these are loaded slowly.

SYSTEMS = ("studies/maeda2008/step.toml", "docs/examples/your_machine/motor.toml", "studies/feng2015/circle.toml")


@pytest.fixture(scope="module")
def systems(native: Path) -> Mapping[str, System]:
    return {name: read_system(ROOT / name, fmus=native) for name in SYSTEMS}


def accepted(document: Document, system: System) -> bool:
    try:
        make_system(document, name="changed", folder=system.folder, fmus=system.fmus)
    except DescriptionError:
        return False
    return True


def small(document: Document) -> Document:
    """A system as a document whose connections are tables and whose columns are tables, so that their keys change."""
    document = plain(document)
    for i, connection in enumerate(document["connections"]):
        if isinstance(connection, str):
            source, target = connection.split(" -> ")
            sums = {"from": [source], "factors": [1.0], "noise": {"rms": 1e-9, "seed": i}}
            ends = sums if i % 2 else {"from": source, "factor": 1.0, "offset": 0.0}
            document["connections"][i] = {**ends, "to": target}
    for signal in document.get("signals", {}).values():
        for name, column in signal.get("columns", {}).items():
            signal["columns"][name] = {"column": column} if isinstance(column, str) else column
    return document


@pytest.mark.parametrize("name", SYSTEMS)
def test_the_schema_accepts_what_the_reader_of_systems_accepts(systems: Mapping[str, System], name: str) -> None:
    """The other way, the reader refuses more: names that no FMU has, steps that do not divide the run."""
    validator, system = jsonschema.Draft202012Validator(SCHEMAS["system"]), systems[name]
    document = small(dict(system.document))
    assert accepted(document, system)

    @EXAMPLES
    @given(st.data())
    def agree(data: st.DataObject) -> None:
        other = changed(document, KEYS["system"], data.draw)
        wrong = next(validator.iter_errors(other), None)
        if wrong is not None:
            assert not accepted(other, system), (list(wrong.absolute_path), wrong.message)

    agree()


def single_changes() -> Iterator[tuple[tuple[Any, ...], str]]:
    """Each key of each kind of table in a system file, and where such a table is."""
    of = {key: SCHEMAS["system"]["$defs"][key]["properties"] for key in SCHEMAS["system"]["$defs"]}
    first = ("connections", 0)
    for place, model in (
        (("experiment",), "ExperimentData"),
        (("record",), "RecordData"),
        (("instances", "plant"), "InstanceData"),
        (first, "ConnectionData"),
        (("connections", 1), "ConnectionData"),
        (("connections", 1, "noise"), "NoiseData"),
        (("signals", "log"), "SignalEntry"),
        (("signals", "log", "columns", "command"), "ColumnEntry"),
    ):
        yield from ((place, key) for key in of[model])


@pytest.mark.parametrize(("place", "key"), list(single_changes()))
def test_each_key_of_a_system_takes_the_values_that_its_schema_takes(
    systems: Mapping[str, System], place: tuple[Any, ...], key: str
) -> None:
    system = systems[
        "docs/examples/your_machine/motor.toml" if place[0] == "signals" else "studies/maeda2008/step.toml"
    ]
    validator = jsonschema.Draft202012Validator(SCHEMAS["system"])
    for value in VALUES:
        document = small(dict(system.document))
        table: Any = document
        for step in place:
            table = table[step]
        table[key] = copy.deepcopy(value)
        wrong = next(validator.iter_errors(document), None)
        assert wrong is None or not accepted(document, system), (value, wrong.message)
