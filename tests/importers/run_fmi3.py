"""Single FMI 3.0 co-simulation FMUs in importers: each function runs one job and gives its rows.

A job's ``places`` has the value reference and the number of elements of each recorded variable; ``outputs`` names
every element of the rows.
"""

from __future__ import annotations

import tempfile
from typing import Any

Job = dict[str, Any]
Rows = list[list[float]]


def fmpy_slave(job: Job) -> Rows:
    """FMPy, function by function."""
    import fmpy
    from fmpy.fmi3 import FMU3Slave

    with tempfile.TemporaryDirectory() as folder:
        fmpy.extract(job["path"], unzipdir=folder)
        fmu = FMU3Slave(guid=job["guid"], unzipDirectory=folder, modelIdentifier=job["name"], instanceName=job["name"])
        fmu.instantiate()
        fmu.enterInitializationMode(startTime=0.0)
        for name, value in job["inputs"].items():
            fmu.setFloat64([job["references"][name]], [value])
        fmu.exitInitializationMode()
        rows: Rows = []
        for k in range(job["steps"]):
            fmu.doStep(k * job["step"], job["step"])
            rows.append([v for reference, size in job["places"] for v in fmu.getFloat64([reference], size)])
        fmu.terminate()
        fmu.freeInstance()
        return rows


def fmpy_simulate(job: Job) -> Rows:
    """FMPy's ``simulate_fmu``."""
    return _simulate(job, events=False)


def fmpy_events(job: Job) -> Rows:
    """FMPy's ``simulate_fmu`` with event mode; of the two rows of an event the second, from event mode."""
    return _simulate(job, events=True)


def _simulate(job: Job, *, events: bool) -> Rows:
    import fmpy
    import numpy as np

    result = fmpy.simulate_fmu(
        job["path"],
        fmi_type="CoSimulation",
        stop_time=job["steps"] * job["step"],
        step_size=job["step"],
        output_interval=job["step"],
        start_values=job["inputs"],
        output=job["variables"],
        use_event_mode=events,
    )
    times = {round(row["time"] / job["step"]): row for row in result}
    return [
        [float(value) for name in job["variables"] for value in np.ravel(times[k + 1][name])]
        for k in range(job["steps"])
    ]


def fmuloader(job: Job) -> Rows:
    """fmuloader's low-level binding."""
    from fmuloader.fmi3 import Fmi3Slave

    fmu = Fmi3Slave(job["path"], model_identifier=job["name"])
    fmu.instantiate_co_simulation(job["name"], instantiation_token=job["guid"])
    fmu.enter_initialization_mode(start_time=0.0)
    for name, value in job["inputs"].items():
        fmu.set_float64([job["references"][name]], [value])
    fmu.exit_initialization_mode()
    rows: Rows = []
    for k in range(job["steps"]):
        fmu.do_step(k * job["step"], job["step"])
        row: list[float] = []
        for reference, size in job["places"]:
            values = fmu.get_float64([reference])
            if len(values) != size:
                raise RuntimeError(f"get_float64 reads {len(values)} of the {size} elements of an array")
            row += values
        rows.append(row)
    fmu.terminate()
    fmu.free_instance()
    return rows
