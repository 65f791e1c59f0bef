"""Fixtures of all tests."""

from __future__ import annotations

from pathlib import Path

import pytest

from cosim.export.package import Workspace, host_platform

ROOT = Path(__file__).resolve().parents[1]
WORKSPACE = Workspace(ROOT, ROOT / "build" / "cache")


@pytest.fixture(scope="session")
def native() -> Path:
    """The folder of the native FMUs, every one current."""
    folder = ROOT / "build" / "fmus" / "native"
    platforms = (host_platform(),)
    stale = WORKSPACE.stale(WORKSPACE.components(), folder, platforms)
    problems = [f"{name}: {error}" for name, _, error in WORKSPACE.build(stale, folder, platforms) if error]
    assert not problems, "\n".join(problems)
    return folder
