"""The Python on docs/results.md runs as it stands."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import ROOT


def test_examples_of_the_page_run(native: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "build" / "fmus").mkdir(parents=True)
    (tmp_path / "build" / "fmus" / "native").symlink_to(native, target_is_directory=True)
    monkeypatch.chdir(tmp_path)
    time = np.arange(1001) * 1e-3
    rows = "".join(f"{t},{x}\n" for t, x in zip(time.tolist(), (5.0 * np.sin(time)).tolist(), strict=True))
    (tmp_path / "log.csv").write_text(f"time,x\ns,mm\n{rows}")
    names: dict[str, Any] = {}
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "results.md").read_text(encoding="utf-8"), re.DOTALL)
    assert len(blocks) == 2
    for block in blocks:
        exec(block, names)
    assert names["again"]["plant.position"].tobytes() == names["result"]["plant.position"].tobytes()
    assert names["found"]["x"].fit > 99.9
    for file in (
        "run.csv",
        "run.csv-metadata.json",
        "run.png",
        "both.png",
        "all.png",
        "compared.png",
        "compared.html",
        "run.html",
        "axis.html",
    ):
        assert (tmp_path / file).stat().st_size > 1000
