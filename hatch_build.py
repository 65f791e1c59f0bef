"""What a wheel holds beside Python files: the prebuilt FMUs, the compiled loop of the master, and the studies.

A wheel for release holds the FMUs of ``build/fmus/release`` with the binaries of every platform; ``make wheel`` builds
both. With ``COSIM_WHEEL=host`` in the environment it holds those of ``build/fmus/native`` for this machine alone, and
the wheel's tag says so. Editable installs get neither: there both lie in the work tree.
"""

from __future__ import annotations

import os
import sys
import sysconfig
import zipfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

CHOICES = ("host", "release")


class PrebuiltFmus(BuildHookInterface):
    """Adds FMUs and studies to a standard wheel, and refuses FMUs that are missing, stale or incomplete."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Called by hatchling before each wheel; ``version`` is "standard" or "editable"."""
        if version == "editable":
            return
        root = Path(self.root)
        sys.path.insert(0, str(root / "src"))
        try:
            # this part of the package needs nothing but Python: hatchling's environment has no tool that builds FMUs
            from cosim.export.compile import TARGETS, host_platform
            from cosim.export.loop_library import FOLDER, library_names
            from cosim.export.workspace import Workspace
        finally:
            del sys.path[0]
        choice = os.environ.get("COSIM_WHEEL", "release")
        if choice not in CHOICES:
            raise ValueError(f"COSIM_WHEEL={choice}: give one of {', '.join(CHOICES)}.")
        if choice == "host":
            folder, platforms = root / "build" / "fmus" / "native", (host_platform(),)
            build_data["tag"] = f"py3-none-{sysconfig.get_platform().replace('-', '_').replace('.', '_')}"
            remedy = "python build_fmus.py"
        else:
            folder, platforms = root / "build" / "fmus" / "release", tuple(TARGETS)
            remedy = "make wheel, or python build_fmus.py --platform all --output build/fmus/release"
        workspace = Workspace(root, root / "build" / "cache")
        names = sorted(workspace.components())
        libraries = [FOLDER / name for name in library_names(platforms).values()]
        found = problems(workspace, names, folder, platforms)
        found += [f"{library.name}: missing, the loop of the master" for library in libraries if not library.is_file()]
        if found:
            text = "\n".join(f"  {problem}" for problem in found)
            raise ValueError(f"the wheel needs FMUs that are not in {folder}:\n{text}\nBuild them: {remedy}.")
        for name in names:
            build_data["force_include"][str(folder / f"{name}.fmu")] = f"cosim/prebuilt/{name}.fmu"
        for library in libraries:
            build_data["force_include"][str(library)] = f"cosim/master/{library.name}"
        build_data["force_include"][str(root / "studies")] = "cosim/studies"


def problems(workspace: Any, names: list[str], folder: Path, platforms: tuple[str, ...]) -> list[str]:
    """What is wrong with the FMU of each component in ``folder``."""
    found: list[str] = []
    for name in names:
        path = folder / f"{name}.fmu"
        if not path.is_file():
            found.append(f"{name}: missing")
        elif not workspace.has_these_sources(name, path):
            found.append(f"{name}: stale, it was not built from the files that are here")
        else:
            with zipfile.ZipFile(path) as archive:
                held = {part.split("/")[1] for part in archive.namelist() if part.startswith("binaries/")}
            if absent := [platform for platform in platforms if platform not in held]:
                found.append(f"{name}: no binary for {', '.join(absent)}")
    return found
