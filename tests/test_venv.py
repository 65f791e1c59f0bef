"""``.ci/venv``, which makes and mends .venv for make: on a package without dependencies, so nothing is fetched."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[1] / ".ci" / "venv"

PIP = """
import pathlib, sys
with open("calls", "a") as calls:
    calls.write(" ".join(sys.argv[1:]) + "\\n")
if pathlib.Path("broken").exists():
    if pathlib.Path("broken").read_text():
        (pathlib.Path(__file__).parents[1] / "half_a_package").mkdir()
    sys.exit("told to fail")
script = pathlib.Path(sys.executable).with_name("hello")
script.write_text(f"#!/bin/sh\\n'{sys.executable}' -c 'print(1 + 1)'")
script.chmod(0o755)
"""
"""Stands for pip: installs a script; fails if there is a file ``broken``, halfway through if it has content."""
PYTHON = f"""
if [ "$2" != venv ]; then exec '{sys.executable}' "$@"; fi
'{sys.executable}' -m venv --without-pip "$3"
for site in "$3"/lib/python3*/site-packages; do
    mkdir -p "$site/pip/_internal/cli"
    touch "$site/pip/_internal/cli/main.py"
    cp pip_stub "$site/pip/__main__.py"
done
"""
"""A Python whose venvs have that pip: made in a moment, and nothing is fetched."""


@pytest.fixture
def place(tmp_path: Path) -> Path:
    """A project whose folder has a blank and an umlaut in its name."""
    folder = tmp_path / "my prüfstand"
    (folder / ".ci").mkdir(parents=True)
    shutil.copy(SCRIPT, folder / ".ci")
    (folder / "pyproject.toml").write_text("# dependencies\n")
    (folder / "pip_stub").write_text(PIP)
    (tmp_path / "bin").mkdir()
    program(tmp_path / "bin", "python3", PYTHON)
    return folder


def run(place: Path, *extras: str, **variables: str) -> subprocess.CompletedProcess[str]:
    path = f"{place.parent / 'bin'}{os.pathsep}{os.environ['PATH']}"
    environment = {**os.environ, "PYTHON": "", "CONSTRAINTS": "", "PATH": path, **variables}
    command = ["sh", str(place / ".ci" / "venv"), *(extras or ("build",))]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)


def calls(place: Path) -> list[str]:
    """The arguments of each call of pip."""
    return (place / "calls").read_text().splitlines()


def program(folder: Path, name: str, text: str) -> str:
    path = folder / name
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)
    return str(path)


def works(place: Path) -> bool:
    """Whether the script of the installed package runs."""
    done = subprocess.run([place / ".venv/bin/hello"], capture_output=True, text=True, check=False)
    return done.stdout == "2\n"


def test_an_extra_is_installed_once(place: Path) -> None:
    done = run(place, "build")
    assert done.returncode == 0, done.stderr
    assert works(place)
    assert run(place, "build").stderr == ""
    assert calls(place) == ["install --quiet --no-compile --editable .[build]"]
    assert run(place, "build", "test").returncode == 0
    assert run(place, "build").stderr == run(place, "test").stderr == ""
    assert calls(place)[1:] == ["install --quiet --no-compile --editable .[build,test]"]


def test_changed_dependencies_are_installed(place: Path) -> None:
    assert run(place, "build", "test").returncode == 0
    (place / "pyproject.toml").write_text("# other dependencies\n")
    assert "Installing" in run(place, "build").stderr
    assert "Installing" in run(place, "test").stderr
    (place / "pins.txt").write_text("numpy==2.0\n")
    assert "Installing" in run(place, "test", CONSTRAINTS="pins.txt").stderr
    assert calls(place)[-1] == "install --quiet --no-compile --editable .[test] --constraint pins.txt"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("exit 127", "is not a Python that can be started"),
        ("echo 3.9; exit 1", "is Python 3.9, but 3.11 or later is needed"),
        ('case "$2" in *ensurepip*) exit 1;; *) echo 3.11;; esac', "apt-get install python3-venv"),
    ],
)
def test_a_wrong_python_is_told_before_anything_is_made(place: Path, tmp_path: Path, text: str, said: str) -> None:
    done = run(place, PYTHON=program(tmp_path, "other", text))
    assert done.returncode != 0
    assert said in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert not (place / ".venv").exists()


def test_a_python_that_is_not_there_is_told(place: Path) -> None:
    done = run(place, PYTHON="nonsense")
    assert done.returncode != 0
    assert done.stderr.splitlines() == [
        "'nonsense' is not a Python that can be started. Install Python 3.11 or later and name it: "
        "make PYTHON=python3.12 ..."
    ]


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        ("rm bin/python", "without a Python that can be started"),
        ("ln -sf gone bin/python", "without a Python that can be started"),
        ("rm pyvenv.cfg", "without a Python that can be started"),
        ("rm -r lib/python3*/site-packages/pip", "without a pip that works"),
        ("touch .unfinished", "half-made (an installation was cut off or failed)"),
    ],
)
def test_a_broken_venv_is_made_anew(place: Path, damage: str, said: str) -> None:
    assert run(place).returncode == 0
    subprocess.run(damage, shell=True, cwd=place / ".venv", check=True)
    (place / ".venv" / "rest").touch()
    done = run(place)
    assert done.returncode == 0, done.stderr
    assert done.stderr.splitlines()[0] == f".venv is {said}. It is made anew."
    assert works(place)
    assert not (place / ".venv" / "rest").exists()
    assert run(place).stderr == ""


def test_another_python_makes_the_venv_anew(place: Path, tmp_path: Path) -> None:
    assert run(place).returncode == 0
    assert run(place, PYTHON="python3").stderr == ""
    newer = program(tmp_path, "newer", 'if [ "$1" = -c ]; then echo 3.99; else exec python3 "$@"; fi')
    version = ".".join(map(str, sys.version_info[:2]))
    assert f".venv is of Python {version}, not 3.99. It is made anew." in run(place, PYTHON=newer).stderr


def test_without_a_right_python_a_good_venv_is_enough(place: Path, tmp_path: Path) -> None:
    """The system's python3 may be too old where .venv was made by another one."""
    assert run(place).returncode == 0
    program(tmp_path / "bin", "python3", "echo 3.9; exit 1")
    (place / "pyproject.toml").write_text("# other dependencies\n")
    assert run(place).returncode == 0


def test_a_moved_folder_gets_a_new_venv(place: Path) -> None:
    assert run(place).returncode == 0
    moved = place.rename(place.with_name("moved"))
    done = run(moved)
    assert done.returncode == 0
    assert f".venv is that of {place}" in done.stderr
    assert works(moved)


@pytest.mark.parametrize(("broken", "anew"), [("", False), ("halfway", True)])
def test_a_failing_pip_is_told_and_tried_again(place: Path, broken: str, anew: bool) -> None:
    """.venv stays if pip failed before it changed a package, as where there is no network."""
    (place / "broken").write_text(broken)
    assert run(place).returncode != 0
    done = run(place)
    assert done.returncode != 0
    assert done.stderr.splitlines()[-1].startswith("pip could not install the package with extras build")
    (place / "broken").unlink()
    done = run(place)
    assert done.returncode == 0
    assert ("made anew" in done.stderr) is anew
    assert works(place)


def test_a_file_in_the_place_of_the_venv(place: Path) -> None:
    (place / ".venv").write_text("")
    assert ".venv is not a folder. It is made anew." in run(place).stderr
    assert works(place)
