"""Whether FMUs of two folders give the same traces to the last bit: ``equal_traces.py BEFORE AFTER``.

For changes of the runtime that must not change a result. Each FMI 2.0 or 3.0 FMU found in both folders is stepped with
smooth inputs: by its own step size and by fractions, multiples and a step without common measure of it, time both as
k*h and added up. Exit code 1 if a trace differs.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import fmpy
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave

STEPS = 400
FACTORS = {"T": 1.0, "T/4": 0.25, "T/7": 1.0 / 7.0, "3 T": 3.0, "sqrt(2) T": math.sqrt(2.0), "0.37 T": 0.3719264}
STARTS = (0.0, 0.37, 1000.0)


def instance(description: Any, folder: str) -> Any:
    """An FMU ready to be initialised, with FMPy's names of FMI 2.0."""
    options = {
        "unzipDirectory": folder,
        "modelIdentifier": description.coSimulation.modelIdentifier,
        "instanceName": "equal",
    }
    if description.fmiVersion.startswith("2"):
        fmu: Any = FMU2Slave(guid=description.guid, **options)
        fmu.get, fmu.set = fmu.getReal, fmu.setReal
    else:
        fmu = FMU3Slave(guid=description.instantiationToken, **options)
        fmu.get, fmu.set = fmu.getFloat64, fmu.setFloat64
    fmu.instantiate()
    return fmu


def initialise(fmu: Any, description: Any, start: float) -> None:
    """From instantiated to the first step."""
    fmu.reset()
    if description.fmiVersion.startswith("2"):
        fmu.setupExperiment(startTime=start)
        fmu.enterInitializationMode()
    else:
        fmu.enterInitializationMode(startTime=start)
    fmu.exitInitializationMode()


def clocks(start: float, h: float) -> Iterator[tuple[str, Sequence[float]]]:
    """Communication points as k*h and as a sum."""
    yield "k*h", [start + k * h for k in range(STEPS)]
    times = [start]
    while len(times) < STEPS:
        times.append(times[-1] + h)
    yield "sum", times


def traces(path: Path) -> dict[str, list[list[float]]]:
    """Outputs and states before and after each step, by experiment."""
    description: Any = fmpy.read_model_description(path)
    inputs = [v for v in description.modelVariables if v.causality == "input" and v.type in ("Real", "Float64")]
    kept = [
        v.valueReference
        for v in description.modelVariables
        if v.causality in ("output", "local") and v.type in ("Real", "Float64")
    ]
    found: dict[str, list[list[float]]] = {}
    with TemporaryDirectory() as folder:
        fmpy.extract(path, unzipdir=folder)
        fmu = instance(description, folder)
        step = float(description.defaultExperiment.stepSize)
        for start in STARTS:
            for label, factor in FACTORS.items():
                for clock, times in clocks(start, factor * step):
                    initialise(fmu, description, start)
                    rows = found[f"start {start:g} s, step {label}, {clock}"] = []
                    for k, t in enumerate(times):
                        if inputs:
                            values = [1e-3 * math.sin(0.1 * k + i) for i in range(len(inputs))]
                            fmu.set([v.valueReference for v in inputs], values)
                        rows.append(fmu.get(kept))
                        fmu.doStep(t, factor * step)
                        rows.append(fmu.get(kept))
        fmu.freeInstance()
    return found


def difference(before: Path, after: Path, read: Callable[[Path], dict[str, list[list[float]]]] = traces) -> str:
    """The first experiment with another trace, or ''."""
    one, other = read(before), read(after)
    for name, rows in one.items():
        for k, (row, found) in enumerate(zip(rows, other[name], strict=True)):
            if row != found:
                return f"{name}: differs at step {k // 2}: {row} {found}"
    return ""


def main() -> int:
    """The number of FMUs with another trace, at most 1."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("before", type=Path)
    parser.add_argument("after", type=Path)
    arguments = parser.parse_args()
    names = sorted(path.name for path in arguments.before.glob("*.fmu") if (arguments.after / path.name).exists())
    different = 0
    for name in names:
        text = difference(arguments.before / name, arguments.after / name)
        different += bool(text)
        print(f"{name}: {text or 'equal'}", flush=True)
    experiments = 2 * len(STARTS) * len(FACTORS)
    print(f"{len(names) - different} of {len(names)} FMUs equal in {experiments} experiments of {STEPS} steps each")
    return int(different > 0 or not names)


if __name__ == "__main__":
    sys.exit(main())
