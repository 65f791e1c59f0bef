"""The wheel: what it holds, that it runs with its dependencies alone, and that FMUs it should not hold are refused."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path
from typing import Any

import pytest
from conftest import ROOT, WORKSPACE

import hatch_build
from cosim.export.compile import TARGETS, host_platform
from cosim.fmu.places import PREBUILT

SYSTEM = """
description = "A system of a user"
connections = [
    "trajectory.position -> controller.position_ref",
    "trajectory.velocity -> controller.velocity_ref",
    "trajectory.acceleration -> controller.acceleration_ref",
    "plant.position -> controller.position",
    "plant.velocity -> controller.velocity",
    "controller.command -> plant.command",
]
[experiment]
stop_time = 0.01
step_size = 1e-4
[instances.trajectory]
fmu = "Trajectory"
[instances.controller]
fmu = "FuzzySlidingMode"
[instances.plant]
fmu = "BallscrewStage"
"""
OF_EXTRAS = frozenset(("casadi", "ziglang", "pythonfmu", "scipy", "matplotlib", "PIL", "pyarrow", "plotly"))
"""Packages that an installation without extras has not."""
WITHOUT = """
import sys

class Without:
    # a finder that does not see some packages

    def __init__(self, finder):
        self.finder = finder

    def find_spec(self, name, path=None, target=None):
        return None if name.partition(".")[0] in {absent!r} else self.finder.find_spec(name, path, target)

    def __getattr__(self, name):
        return getattr(self.finder, name)

sys.meta_path[:] = map(Without, sys.meta_path)
"""


def hatchling(folder: Path, *arguments: str, choice: str = "release") -> subprocess.CompletedProcess[str]:
    """``hatchling build`` in ``folder``, with nothing from outside."""
    return subprocess.run(
        [sys.executable, "-m", "hatchling", "build", *arguments],
        cwd=folder,
        env=os.environ | {"COSIM_WHEEL": choice},
        capture_output=True,
        text=True,
        check=False,
    )


def build_wheel(folder: Path) -> Path:
    done = hatchling(ROOT, "-t", "wheel", "-d", str(folder), choice="host")
    assert done.returncode == 0, done.stderr
    (wheel,) = folder.glob("*.whl")
    return wheel


@pytest.fixture(scope="module")
def wheel(native: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel with the FMUs of this machine."""
    return build_wheel(tmp_path_factory.mktemp("wheel"))


@pytest.fixture(scope="module")
def bare(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files of a fresh clone that matter to a wheel; no FMU is built."""
    folder = tmp_path_factory.mktemp("clone")
    for name in ("pyproject.toml", "hatch_build.py", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, folder)
    for name in ("src", "fmus"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    return folder


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """An environment in which the wheel is installed without extras."""
    folder = tmp_path_factory.mktemp("installed")
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index", "--target", str(folder / "at")]
    subprocess.run([*pip, "--disable-pip-version-check", str(wheel)], check=True)
    (folder / "none").mkdir()
    (folder / "none" / "sitecustomize.py").write_text(WITHOUT.format(absent=set(OF_EXTRAS)), encoding="utf-8")
    path = os.pathsep.join([str(folder / "none"), str(folder / "at")])
    return os.environ | {"PYTHONPATH": path, "XDG_CACHE_HOME": str(folder / "cache")}


def started(environment: dict[str, str], folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """A Python that has run in ``folder``."""
    return subprocess.run(
        [sys.executable, *arguments], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )


def test_contents(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        held = set(archive.namelist())
        fmus = {name: archive.read(name) for name in held if name.endswith(".fmu")}
    folder = ROOT / "build" / "fmus" / "native"
    assert fmus == {f"cosim/prebuilt/{path.name}": path.read_bytes() for path in folder.glob("*.fmu")}
    assert len(fmus) == len(WORKSPACE.components())
    for top, place in ((ROOT / "src", ""), (ROOT / "fmus", "fmus/"), (ROOT / "studies", "cosim/studies/")):
        files = [path for path in top.rglob("*") if path.is_file() and "__pycache__" not in path.parts]
        assert files
        assert {place + path.relative_to(top).as_posix() for path in files} <= held
    assert [name for name in held if name.endswith("licenses/LICENSE")]
    strange = [name for name in held if name.split("/")[0] not in ("cosim", "fmus") and ".dist-info/" not in name]
    assert strange == []


def test_wheel_of_one_platform_says_so(wheel: Path) -> None:
    assert wheel.stem.split("-")[2:4] == ["py3", "none"]
    assert wheel.stem.split("-")[4] != "any"


def test_same_bytes_twice(wheel: Path, tmp_path: Path) -> None:
    assert build_wheel(tmp_path).read_bytes() == wheel.read_bytes()


def test_installed_wheel_runs_a_shipped_system_and_one_of_the_user(installed: dict[str, str], tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text(SYSTEM, encoding="utf-8")

    def cosim(*arguments: str) -> str:
        done = started(installed, tmp_path, "-m", "cosim", *arguments)
        assert done.returncode == 0, done.stderr
        return done.stdout

    assert Path(cosim("list").split()[2].rstrip(",")).parts[-2:] == ("cosim", "prebuilt")
    shown = cosim("run", "shams2010/fsmc_5sin", "--stop-time", "0.1", "--json")
    assert json.loads(shown)["steps"] == 1000
    assert json.loads(cosim("run", "mine.toml", "--json", "--output", "run.csv"))["steps"] == 100
    assert "Copied" in cosim("fmus", "copy", "mine", "BallscrewStage")
    assert (tmp_path / "mine" / "BallscrewStage.fmu").is_file()
    done = started(installed, tmp_path, "-c", "import cosim, fmus; print(cosim.__file__); import casadi")
    assert Path(done.stdout.strip()).parts[-3:] == ("at", "cosim", "__init__.py")
    assert "ModuleNotFoundError: No module named 'casadi'" in done.stderr


@pytest.mark.parametrize(
    ("command", "package", "extra"),
    [
        (("run", "shams2010/fsmc_5sin", "--plot", "run.png"), "matplotlib", "plots"),
        (("run", "shams2010/fsmc_5sin", "--output", "run.parquet"), "pyarrow", "parquet"),
        (("run", "shams2010/fsmc_5sin", "--report", "run.html"), "plotly", "report"),
        (("tune", "studies/maeda2008/tunings/step_1mm.toml"), "scipy", "tools"),
        (("build", "PPi"), "casadi", "build"),
    ],
)
def test_a_missing_extra_is_named_before_anything_runs(
    installed: dict[str, str], tmp_path: Path, command: tuple[str, ...], package: str, extra: str
) -> None:
    done = started(installed, tmp_path, "-m", "cosim", *command)
    assert done.returncode == 2
    # a long path would be folded at 80 columns
    said = " ".join(done.stderr.split())
    assert f'needs {package}, which is not installed: pip install "motion-cosim[{extra}]"' in said
    assert done.stdout == ""
    assert not list(tmp_path.iterdir())


def test_fmus_of_the_user_win_over_those_of_the_wheel(installed: dict[str, str], native: Path, tmp_path: Path) -> None:
    folder = tmp_path / "build" / "fmus" / "native"
    folder.mkdir(parents=True)
    shutil.copy(native / "PPi.fmu", folder)
    below = tmp_path / "deep" / "down"
    below.mkdir(parents=True)
    done = subprocess.run(
        [sys.executable, "-m", "cosim", "info", "PPi"],
        cwd=below,
        env=installed,
        capture_output=True,
        text=True,
        check=True,
    )
    # a long path is folded at 80 columns
    assert "".join(str(folder / "PPi.fmu").split()) in "".join(done.stdout.split())


def test_wheel_without_fmus_is_refused(bare: Path, tmp_path: Path) -> None:
    done = hatchling(bare, "-t", "wheel", "-d", str(tmp_path))
    assert done.returncode != 0
    assert f"needs FMUs that are not in {bare / 'build' / 'fmus' / 'release'}" in done.stderr
    for name in WORKSPACE.components():
        assert f"{name}: missing" in done.stderr
    assert "Build them: make wheel" in done.stderr
    assert not list(tmp_path.iterdir())


def test_unknown_choice_is_refused(bare: Path, tmp_path: Path) -> None:
    done = hatchling(bare, "-t", "wheel", "-d", str(tmp_path), choice="mine")
    assert done.returncode != 0
    assert "COSIM_WHEEL=mine: give one of host, release." in done.stderr


def test_editable_install_needs_no_fmu(bare: Path, tmp_path: Path) -> None:
    hook = hatch_build.PrebuiltFmus(str(bare), {}, None, None, str(tmp_path), "wheel")
    data: dict[str, Any] = {"force_include": {}}
    hook.initialize("editable", data)
    assert data == {"force_include": {}}
    with pytest.raises(ValueError, match="needs FMUs"):
        hook.initialize("standard", data)


def test_sdist_holds_what_builds_the_wheel_and_nothing_built(tmp_path: Path) -> None:
    done = hatchling(ROOT, "-t", "sdist", "-d", str(tmp_path))
    assert done.returncode == 0, done.stderr
    (sdist,) = tmp_path.glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        held = {name.partition("/")[2] for name in archive.getnames()}
    assert held >= {"Makefile", "build_fmus.py", "hatch_build.py", "pyproject.toml", "LICENSE", "tests/conftest.py"}
    assert not [name for name in held if name.startswith("build/") or name.endswith((".fmu", ".pyc"))]


def test_stale_changed_and_incomplete_fmus_are_found(native: Path) -> None:
    host = host_platform()
    other = next(platform for platform in TARGETS if platform != host)
    assert hatch_build.problems(WORKSPACE, ["PPi"], native, (host,)) == []
    assert hatch_build.problems(WORKSPACE, ["PPi"], native, (host, other)) == [f"PPi: no binary for {other}"]
    assert hatch_build.problems(WORKSPACE, ["Nobody"], native, (host,)) == ["Nobody: missing"]


def test_changed_sources_make_an_fmu_stale(native: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(type(WORKSPACE), "sources", lambda *_: "those of another day")
    (problem,) = hatch_build.problems(WORKSPACE, ["PPi"], native, (host_platform(),))
    assert problem.startswith("PPi: stale")


def test_an_fmu_that_was_changed_after_it_was_built_is_stale(native: Path, tmp_path: Path) -> None:
    """Its stamp lies in the cache, so a copy elsewhere has none; it is made here for the copy."""
    copy = Path(shutil.copy(native / "PPi.fmu", tmp_path))
    WORKSPACE.remember("PPi", (host_platform(),), copy)
    try:
        assert hatch_build.problems(WORKSPACE, ["PPi"], tmp_path, (host_platform(),)) == []
        with zipfile.ZipFile(copy, "a") as archive:
            archive.writestr("extra/note.txt", "changed")
        (problem,) = hatch_build.problems(WORKSPACE, ["PPi"], tmp_path, (host_platform(),))
        assert problem.startswith("PPi: stale")
    finally:
        WORKSPACE._stamp(copy).unlink()


def test_checkout_has_no_prebuilt_fmus() -> None:
    assert not PREBUILT.exists()
