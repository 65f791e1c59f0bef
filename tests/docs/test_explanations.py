"""Pages that explain: what they show is measured, and what they read from files is whole."""

from __future__ import annotations

import json
import tomllib
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from cosim.study import STATUSES
from docs.generate import explanations, sampling

ROOT = Path(__file__).parents[2]
PAGES = ROOT / "docs" / "explanations"
KEPT = json.loads((ROOT / "benchmarks" / "figures.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize(
    ("setting", "ages"),
    list(zip(sampling.SETTINGS, ((0,), (1,), (1,), (0, 1, 2, 3), (4, 5, 6, 7), (0,)), strict=True)),
    ids=lambda value: value.text if isinstance(value, sampling.Setting) else "",
)
def test_ages_of_samples_are_those_that_the_order_and_the_clocks_say(
    setting: sampling.Setting, ages: tuple[int, ...]
) -> None:
    time, sample = sampling.used_samples(setting)
    late = time > 7.5 * sampling.STEP
    found = (time - sample)[late] / sampling.STEP
    assert set(np.round(found, 6)) == set(ages)


@pytest.mark.parametrize("name", KEPT)
def test_kept_figures_name_their_machine_and_fill_their_table(name: str) -> None:
    entry = KEPT[name]
    assert {"processor", "cores", "system", "python"} <= entry["machine"].keys()
    assert entry["rows"]
    assert all(len(row) == len(entry["heads"]) for row in entry["rows"])


def test_every_benchmark_that_keeps_figures_is_shown() -> None:
    page = (PAGES / "benchmarks.md").read_text(encoding="utf-8")
    assert [name for name in KEPT if f"{{{{ bench_{name} }}}}" not in page] == []


def test_every_word_of_a_verdict_is_explained() -> None:
    page = (PAGES / "reproduced.md").read_text(encoding="utf-8")
    assert {word for kind in STATUSES.values() for word in kind if f"**{word}**" not in page} == set()


def test_claims_are_counted_as_they_stand_in_the_files() -> None:
    kinds: Counter[str] = Counter()
    for path in ROOT.glob("studies/*/claims.toml"):
        for table in tomllib.loads(path.read_text(encoding="utf-8"))["tables"]:
            kinds[table["kind"]] += len(table["claims"])
    row = explanations.claims()["claims_table"].splitlines()[-1]
    assert row == f"| all |  | {kinds['paper']} | {kinds['check']} | {kinds['finding']} |"


def test_importers_of_the_page_are_known_by_name() -> None:
    names = explanations.validation()["importers"].split(", ")
    assert {"FMPy", "OMSimulator", "libcosim"} <= set(names)
    assert len(names) == len({name.split(" ")[0].lower() for name in names})
