"""The pages of file formats: every key is explained, every example is read."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from cosim import read_record, read_system, simulate
from cosim.design.fit_file import read_fit
from cosim.design.names import AxisNames, NctfNames
from cosim.design.plan import read_sweep
from cosim.design.stability import read_map
from cosim.design.tune import read_tuning
from cosim.export.workspace import Workspace
from cosim.fmu.tables import read_table
from cosim.master.metadata import METADATA
from cosim.study import load_study
from cosim.system.schema import SystemData
from docs.generate.formats import ROOT, files, keys, write

PAGES = ROOT / "docs" / "reference" / "formats"
SCHEMAS = {path.stem: path for path in sorted((ROOT / "docs" / "schemas").glob("*.json"))}
READERS: dict[str, Callable[[Path], object]] = {
    "system": read_system,
    "record": read_record,
    "sweep": read_sweep,
    "tuning": read_tuning,
    "fit": read_fit,
    "map": read_map,
    "claims": lambda path: load_study(path.parent),
    "names": lambda path: read_table(path, NctfNames if path.stem == "nctf" else AxisNames),
    "component": lambda path: Workspace(ROOT, ROOT / "build" / "cache").choose([str(path)]),
}


def properties(name: str) -> Iterator[tuple[str, dict[str, Any]]]:
    schema = json.loads(SCHEMAS[name].read_text(encoding="utf-8"))
    for table in (schema, *schema.get("$defs", {}).values()):
        for key, entry in table.get("properties", {}).items():
            inner = schema["$defs"][entry["$ref"].rpartition("/")[2]] if "$ref" in entry else {}
            yield key, {"description": inner.get("description", ""), **entry}


@pytest.mark.parametrize("name", SCHEMAS)
def test_every_key_says_what_it_means_and_is_on_a_page(name: str) -> None:
    listed = keys(name)
    for key, entry in properties(name):
        assert entry["description"], f"{name}: {key}"
        assert re.search(rf"^:+{{key}} {name} (.*\.)?{key}$", listed, re.MULTILINE), key
    shown = [page.stem for page in PAGES.glob("*.md") if f"% keys {name}\n" in page.read_text(encoding="utf-8")]
    assert len(shown) == 1


@pytest.mark.parametrize("page", READERS)
def test_the_examples_of_a_page_are_read(page: str, native: Path) -> None:
    found = files(PAGES / f"{page}.md")
    assert found
    for path in found:
        READERS[page](path)


def test_all_forms_of_a_connection_are_read() -> None:
    (text,) = re.findall("```toml\n(.*?)```", (PAGES / "system.md").read_text(encoding="utf-8"), re.DOTALL)
    connections = SystemData.model_validate(tomllib.loads(text)).connections
    assert len(connections) == 5


def test_every_page_is_filled(tmp_path: Path) -> None:
    target = tmp_path / "reference" / "formats"
    target.mkdir(parents=True)
    for page in PAGES.glob("*.md"):
        (target / page.name).write_bytes(page.read_bytes())
    write(tmp_path)
    for page in target.glob("*.md"):
        assert not re.search("^% ", page.read_text(encoding="utf-8"), re.MULTILINE), page


def test_the_page_of_results_knows_all_metadata_of_a_run(native: Path, tmp_path: Path) -> None:
    result = simulate(read_system("Trajectory", stop_time=0.01))
    result.save(tmp_path / "run.csv")
    written = json.loads((tmp_path / "run.csv-metadata.json").read_text(encoding="utf-8"))["notes"][0]["cosim"]
    assert METADATA.keys() == written.keys()
