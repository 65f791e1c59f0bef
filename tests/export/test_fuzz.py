"""Random sequences of FMI calls with random arguments never crash whoever makes them."""

from __future__ import annotations

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from conftest import ROOT


@pytest.mark.parametrize("name", ["BallscrewStage", "FrictionPulse", "Trajectory"])
@pytest.mark.parametrize(("flavour", "program"), [("native", "fmi2"), ("fmi3", "fmi3")])
def test_no_sequence_of_calls_crashes_the_importer(
    request: pytest.FixtureRequest, flavour: str, program: str, name: str, tmp_path: Path
) -> None:
    """60,000 calls in a program of its own that ends at undefined behaviour."""
    folder: Path = request.getfixturevalue(flavour)
    with zipfile.ZipFile(folder / f"{name}.fmu") as archive:
        archive.extractall(tmp_path, [member for member in archive.namelist() if member.startswith("sources/")])
    fuzz = ROOT / "tests" / "fuzz"
    flags = ["-O1", "-g", "-fsanitize=undefined", "-fno-sanitize-recover=undefined"]
    command = [
        *flags,
        f"-I{tmp_path / 'sources'}",
        f"-I{fuzz}",
        str(fuzz / f"{program}.c"),
        "-o",
        str(tmp_path / "run"),
    ]
    subprocess.run([sys.executable, "-m", "ziglang", "cc", *command, "-lm"], check=True)
    done = subprocess.run([str(tmp_path / "run"), "300", "7"], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    fine, refused, wrong = map(int, done.stdout.split())
    assert fine > 5000
    assert refused > 0
    assert wrong > 5000
