"""FMUs stepped by a C program: win64 under wine, aarch64-linux under qemu, Python ones in a host without Python.

``make platforms`` runs it.

Not part of the normal suite: the tools come from the system (Debian: wine, qemu-user, libc6-arm64-cross, libpython3),
and the first compilation for Windows takes minutes.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from ctypes.util import find_library
from pathlib import Path

import pytest
from conftest import WORKSPACE

from cosim.export.compile import RUNTIME, TARGETS
from cosim.export.package import build

from .cases import Case, compare, fmu_case
from .conform import TOLERANCE

COMPONENTS = sorted(WORKSPACE.components())
SYSROOT = Path("/usr/aarch64-linux-gnu")
STEPS = 50
LIBPYTHON = find_library(f"python{sys.version_info.major}.{sys.version_info.minor}")


def host(folder: Path, target: str, ending: str) -> Path:
    """The host program for a platform."""
    program = folder / f"host{ending}"
    if not program.exists():
        command = [sys.executable, "-m", "ziglang", "cc", "-target", target, "-O1", "-I", str(RUNTIME)]
        libraries = [] if "windows" in target else ["-ldl"]
        command += [str(Path(__file__).with_name("host.c")), "-o", str(program), *libraries]
        environment = os.environ | {"ZIG_GLOBAL_CACHE_DIR": str((WORKSPACE.cache / "zig").resolve())}
        subprocess.run(command, check=True, env=environment)
    return program


def run(case: Case, folder: Path, platform: str, command: list[str]) -> None:
    """Build an FMU for the platform, run its library in the host, compare with the run here."""
    name = case.job["name"]
    member = f"binaries/{platform}/{name}{TARGETS[platform][1]}"
    path = build(WORKSPACE.component(name), folder / platform / name, WORKSPACE.cache, (platform,))
    with zipfile.ZipFile(path) as archive:
        library = Path(archive.extract(member, path.parent))
    step(case, library, command, {"WINEDEBUG": "-all"})


def step(case: Case, library: Path, command: list[str], environment: dict[str, str]) -> None:
    """Run a library in the host and compare; exp and sin of a platform's C library may differ in the last bit."""
    job = case.job
    inputs = [text for n, v in job["inputs"].items() for text in (str(job["references"][n]), repr(v))]
    outputs = [str(job["references"][n]) for n in job["outputs"]]
    counts = [str(len(job["inputs"])), *inputs, str(len(outputs)), *outputs]
    done = subprocess.run(
        [*command, str(library), job["guid"], repr(job["step"]), str(job["steps"]), *counts],
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
        env=os.environ | environment,
    )
    assert done.returncode == 0, done.stderr[-500:]
    rows = [[float(value) for value in line.split()] for line in done.stdout.splitlines()]
    difference, output = compare(case, rows)
    assert difference <= TOLERANCE, output


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("platforms")


@pytest.mark.skipif(shutil.which("wine") is None, reason="wine is not installed: apt-get install wine")
@pytest.mark.parametrize("name", COMPONENTS)
def test_win64_under_wine(native: Path, folder: Path, name: str) -> None:
    program = host(folder, "x86_64-windows-gnu", ".exe")
    case = fmu_case(native / f"{name}.fmu", STEPS)
    run(case, folder, "win64", ["wine", str(program)])


@pytest.mark.skipif(
    shutil.which("qemu-aarch64") is None or not SYSROOT.exists(),
    reason="qemu-aarch64 or its C library is not installed: apt-get install qemu-user libc6-arm64-cross",
)
@pytest.mark.parametrize("name", COMPONENTS)
def test_aarch64_linux_under_qemu(native: Path, folder: Path, name: str) -> None:
    program = host(folder, "aarch64-linux-gnu.2.17", "")
    case = fmu_case(native / f"{name}.fmu", STEPS)
    command = ["qemu-aarch64", "-L", str(SYSROOT), str(program)]
    run(case, folder, "aarch64-linux", command)


@pytest.mark.skipif(
    LIBPYTHON is None, reason="no shared library of this Python is installed: apt-get install libpython3"
)
@pytest.mark.parametrize("name", COMPONENTS)
def test_python_flavour_in_a_host_without_python(python: Path, folder: Path, name: str) -> None:
    """The FMU finds and starts the library of Python by itself; numpy and scipy are those of this Python."""
    program = host(folder, "x86_64-linux-gnu.2.17", ".linux")
    case = fmu_case(python / f"{name}.fmu", 10)
    with zipfile.ZipFile(python / f"{name}.fmu") as archive:
        archive.extractall(folder / "python" / name)
    library = folder / "python" / name / "binaries" / "linux64" / f"{name}.so"
    packages = {"PYTHONPATH": sysconfig.get_path("purelib"), "COSIM_LIBPYTHON": str(LIBPYTHON)}
    step(case, library, [str(program)], packages)


def test_host_without_python_is_told_what_is_missing(python: Path, folder: Path) -> None:
    program = host(folder, "x86_64-linux-gnu.2.17", ".linux")
    with zipfile.ZipFile(python / "PPi.fmu") as archive:
        archive.extractall(folder / "told")
    library = folder / "told" / "binaries" / "linux64" / "PPi.so"
    guid = (folder / "told" / "resources" / "guid.txt").read_text()
    done = subprocess.run(
        [str(program), str(library), guid, "1e-4", "1", "0", "0"],
        capture_output=True,
        text=True,
        check=False,
        env={"COSIM_LIBPYTHON": "/nowhere/libpython3.so"},
    )
    assert done.returncode == 1
    assert "Set COSIM_LIBPYTHON to the path of libpython3.x.so, or take the native FMU" in done.stderr
