"""Runs jobs in one importer: ``python runner.py IMPORTER < jobs.json``; the traces go to standard output.

A job of kind ``fmu`` has one instance with its inputs held from the start, one of kind ``system`` an SSP file. The
trace has one row of outputs for each communication point after the start. Nothing of this project is imported here.
"""

from __future__ import annotations

import importlib.metadata
import json
import os
import sys
from collections.abc import Callable
from typing import Any

import run_fmi3
import run_fmus
import run_programs
import run_systems

Job = dict[str, Any]
Rows = list[list[float]]

IMPORTERS: dict[str, tuple[str, Callable[[Job], Rows]]] = {
    "fmpy": ("fmpy", run_fmus.fmpy_slave),
    "fmpy.simulate_fmu": ("fmpy", run_fmus.fmpy_simulate),
    "fmpy.simulate_fmu ME": ("fmpy", run_fmus.fmpy_exchange),
    "fmuloader": ("fmuloader", run_fmus.fmuloader),
    "fmuloader ME": ("fmuloader", run_fmus.fmuloader_exchange),
    "pathsim-fmi": ("pathsim-fmi", run_fmus.pathsim),
    "pathsim-fmi ME": ("pathsim-fmi", run_fmus.pathsim_exchange),
    "sofirpy": ("sofirpy", run_fmus.sofirpy),
    "sofirpy systems": ("sofirpy", run_systems.sofirpy),
    "fmureader": ("fmureader", run_fmus.fmureader),
    "fmutool": ("fmu-manipulation-toolbox", run_fmus.toolbox),
    "libcosim": ("libcosimpy", run_systems.libcosim),
    "fmilibrary": ("libcosimpy", run_systems.fmilibrary),
    "ecos": ("ecospy", run_systems.ecos),
    "fmucontainer": ("fmu-manipulation-toolbox", run_systems.container),
    "fmpy container": ("fmpy", run_systems.fmpy_container),
    "syssimx": ("syssimx", run_systems.syssimx),
    "syssimx FMU": ("syssimx", run_systems.syssimx_fmu),
    "fmpy 3.0": ("fmpy", run_fmi3.fmpy_slave),
    "fmpy.simulate_fmu 3.0": ("fmpy", run_fmi3.fmpy_simulate),
    "fmpy.simulate_fmu 3.0 events": ("fmpy", run_fmi3.fmpy_events),
    "fmuloader 3.0": ("fmuloader", run_fmi3.fmuloader),
    "pathsim-fmi 3.0": ("pathsim-fmi", run_fmus.pathsim),
    "cofmupy": ("cofmupy", run_systems.cofmupy),
    "cofmupy FMU": ("cofmupy", run_systems.cofmupy_fmu),
}
"""Name -> distribution, function."""
PROGRAMS: dict[str, Callable[[Job], Rows]] = {
    "fmusim": run_programs.fmusim,
    "fmusim events": run_programs.fmusim_events,
    "fmusim ME": run_programs.fmusim_exchange,
    "fmu-check": run_programs.fmu_check,
    "omsimulator": run_programs.omsimulator,
}
"""Name -> function; the job says where the program is."""


def _version(distribution: str) -> str:
    try:
        return importlib.metadata.version(distribution)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"


def main() -> None:
    """Read a list of jobs, run each, write the results; what an importer prints itself is dropped."""
    importer = sys.argv[1]
    distribution, run = IMPORTERS.get(importer) or ("", PROGRAMS[importer])
    jobs = json.load(sys.stdin)
    real = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    for job in jobs:
        try:
            result: dict[str, Any] = {"rows": run(job)}
        except Exception as error:
            result = {"error": f"{type(error).__name__}: {error}"}
        if importer in PROGRAMS:
            result["version"] = run_programs.version(importer, job["program"])
        else:
            result["version"] = _version(distribution)
        real.write(json.dumps(result) + "\n")
        real.flush()


if __name__ == "__main__":
    main()
