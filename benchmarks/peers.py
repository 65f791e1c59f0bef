"""Other masters on two coupled FMUs, one a run: ``python peers.py NAME FOLDER STEPS`` prints seconds of stepping.

FOLDER holds ``a.fmu`` and ``b.fmu``, each with input ``u`` and output ``y``. Loading and initialization are not
counted. Run by ``master.py``, with an interpreter that has the peers.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

STEP = 0.1


def fmpy_methods(folder: Path, steps: int) -> float:
    """FMPy's FMU2Slave: setReal, doStep, getReal in a Python loop."""
    slaves = [slave(folder / f"{name}.fmu") for name in "ab"]
    a, b = slaves
    u, y = [0], [1]
    ya, yb = a.getReal(y), b.getReal(y)
    begun = time.perf_counter()
    for k in range(steps):
        a.setReal(u, yb)
        b.setReal(u, ya)
        a.doStep(k * STEP, STEP)
        b.doStep(k * STEP, STEP)
        ya, yb = a.getReal(y), b.getReal(y)
    return time.perf_counter() - begun


def slave(path: Path, stop_time: float | None = None) -> Any:
    from fmpy import extract, read_model_description
    from fmpy.fmi2 import FMU2Slave

    model = read_model_description(str(path))
    made = FMU2Slave(
        guid=model.guid,
        modelIdentifier=model.coSimulation.modelIdentifier,
        unzipDirectory=str(extract(str(path))),
        instanceName=path.stem,
    )
    made.instantiate()
    made.setupExperiment(startTime=0.0, stopTime=stop_time)
    made.enterInitializationMode()
    made.exitInitializationMode()
    return made


def fmpy_simulate_fmu(folder: Path, steps: int) -> float:
    """fmpy.simulate_fmu: one FMU, output recorded; the time of both is twice that."""
    from fmpy import simulate_fmu

    begun = time.perf_counter()
    simulate_fmu(str(folder / "a.fmu"), stop_time=steps * STEP, output_interval=STEP, output=["y"])
    return 2.0 * (time.perf_counter() - begun)


def fmu_container(folder: Path, steps: int) -> float:
    """Container of fmu-manipulation-toolbox: its loop in C, 1000 inner steps a call; records nothing."""
    from fmu_manipulation_toolbox.assembly import Assembly

    links = [["a.fmu", "y", "b.fmu", "u"], ["b.fmu", "y", "a.fmu", "u"]]
    text = {"name": "container.fmu", "fmu": ["a.fmu", "b.fmu"], "link": links, "step_size": STEP}
    (folder / "container.json").write_text(json.dumps(text), encoding="utf-8")
    Assembly("container.json", fmu_directory=folder).make_fmu()
    container = slave(folder / "container.fmu")
    begun = time.perf_counter()
    for k in range(steps // 1000):
        container.doStep(k * 1000 * STEP, 1000 * STEP)
    return time.perf_counter() - begun


def ecos(folder: Path, steps: int) -> float:
    """Ecos through its Python API, all steps in one call of its C++ loop; records nothing."""
    from ecospy import EcosSimulation, EcosSimulationStructure

    with EcosSimulationStructure() as structure:
        for name in "ab":
            structure.add_model(name, folder / f"{name}.fmu")
        structure.make_real_connection("a::y", "b::u")
        structure.make_real_connection("b::y", "a::u")
        with EcosSimulation(structure=structure, step_size=STEP) as simulation:
            simulation.init()
            begun = time.perf_counter()
            simulation.step(steps)
            return time.perf_counter() - begun


def cofmupy(folder: Path, steps: int) -> float:
    """CoFmuPy's coordinator, nothing saved."""
    from cofmupy import Coordinator

    def end(name: str, variable: str) -> dict[str, str]:
        return {"id": name, "variable": variable, "unit": "", "type": "fmu"}

    config = {
        "fmus": [{"id": name, "name": name, "path": str(folder / f"{name}.fmu")} for name in "ab"],
        "connections": [
            {"source": end("a", "y"), "target": end("b", "u")},
            {"source": end("b", "y"), "target": end("a", "u")},
        ],
        "cosim_method": "jacobi",
    }
    (folder / "cofmupy.json").write_text(json.dumps(config), encoding="utf-8")
    coordinator = Coordinator()
    coordinator.start(str(folder / "cofmupy.json"))
    begun = time.perf_counter()
    for _ in range(steps):
        coordinator.do_step(STEP)
    return time.perf_counter() - begun


PEERS: dict[str, tuple[Callable[[Path, int], float], float]] = {
    "fmu-manipulation-toolbox container": (fmu_container, 1.0),
    "ecos": (ecos, 1.0),
    "fmpy.simulate_fmu": (fmpy_simulate_fmu, 0.1),
    "FMPy FMU2Slave methods": (fmpy_methods, 0.1),
    "cofmupy": (cofmupy, 0.02),
}
"""What to run, and the share of the steps that is enough to measure it."""


def main() -> int:
    name, folder, steps = sys.argv[1], Path(sys.argv[2]), int(sys.argv[3])
    run, share = PEERS[name]
    count = max(1000, int(steps * share) // 1000 * 1000)
    with tempfile.TemporaryDirectory() as place:
        copy = Path(place)
        for fmu in ("a.fmu", "b.fmu"):
            (copy / fmu).write_bytes((folder / fmu).read_bytes())
        try:
            seconds = run(copy, count)
        except (ImportError, OSError) as error:
            print(json.dumps({"missing": str(error)}))
            return 0
    print(json.dumps({"seconds": seconds, "steps": count}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
