"""All of docs/use-in-your-tool.md that can be followed here; ``make conformance`` runs it.

Not part of the normal suite: the tools are those of requirements.txt, in build/importers.
"""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from .conform import ROOT
from .page import PAGE, Block, blocks, follow, user_folder

IMPORTERS = ROOT / "build" / "importers" / "bin"
BLOCKS = blocks(PAGE.read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def followed(native: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[Block, str]:
    assert IMPORTERS.is_dir(), f"{IMPORTERS} is missing. Run make conformance."
    folder = user_folder(tmp_path_factory.mktemp("page"), native)
    return dict(follow(BLOCKS, folder, {"run": Path(sys.executable).parent, "run-importers": IMPORTERS}))


@pytest.mark.parametrize(
    "block", [b for b in BLOCKS if b.mark.startswith("run")], ids=lambda b: f"{b.section}, line {b.line}"
)
def test_block(followed: dict[Block, str], block: Block) -> None:
    assert followed[block] == ""


def test_versions_of_the_page_are_those_followed() -> None:
    claimed = {
        (name, version)
        for line in re.findall(r"^\*Followed literally here: (.*?)\*", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
        for name, version in re.findall(r"([\w-]+) (\d[\d.]*\d)", line)
    }
    names = sorted(name for name, _ in claimed)
    code = f"from importlib.metadata import version\nprint(*(version(name) for name in {names}))"
    done = subprocess.run([IMPORTERS / "python", "-c", code], capture_output=True, text=True, check=True)
    assert claimed == set(zip(names, done.stdout.split(), strict=True))
    assert len(claimed) >= 6
