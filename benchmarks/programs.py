"""C programs and libraries of the benchmarks, compiled as the FMUs are, and the sources inside an FMU."""

from __future__ import annotations

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import fmpy

from cosim.export.compile import FLAGS, TARGETS, host_platform

CACHE = Path(__file__).resolve().parents[1] / "build" / "cache" / "zig"
HEADERS = Path(fmpy.__file__).parent / "c-code"
"""The folder of the header files of FMI."""
ONLY_OF_FMUS = ("-shared", "-fPIC", "-Wall", "-Wextra", "-Werror", "-s")
"""Flags of FMUs that a program does not take."""


def compile_c(target: Path, *arguments: str, library: bool = False) -> Path:
    """Compile ``arguments`` (sources and flags, relative to the folder of ``target``) with the flags of the FMUs.

    Without a target platform, the compiler would use all that this processor has.
    """
    flags = [flag for flag in FLAGS if flag not in ONLY_OF_FMUS] + (["-shared", "-fPIC"] if library else [])
    command = [sys.executable, "-m", "ziglang", "cc", "-target", TARGETS[host_platform()][0][0], *flags, "-w"]
    command += [f"-I{HEADERS}", f"-I{target.parent}", *arguments, "-o", str(target)]
    environment = os.environ | {"ZIG_GLOBAL_CACHE_DIR": str(CACHE)}
    subprocess.run(command, cwd=target.parent, check=True, env=environment)
    return target


def extract_sources(fmu: Path, folder: Path) -> None:
    """Put the folder ``sources`` of an FMU into ``folder``."""
    with zipfile.ZipFile(fmu) as archive:
        archive.extractall(folder, [member for member in archive.namelist() if member.startswith("sources/")])
