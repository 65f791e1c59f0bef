"""Single FMI 2.0 FMUs in importers of Python: each function runs one job and gives its rows."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

Job = dict[str, Any]
Rows = list[list[float]]


def fmpy_slave(job: Job) -> Rows:
    """FMPy, function by function: inputs set before each step, outputs read after it."""
    import fmpy
    from fmpy.fmi2 import FMU2Slave

    with tempfile.TemporaryDirectory() as folder:
        fmpy.extract(job["path"], unzipdir=folder)
        description = fmpy.read_model_description(folder)
        identifier = description.coSimulation.modelIdentifier
        fmu = FMU2Slave(
            guid=description.guid, unzipDirectory=folder, modelIdentifier=identifier, instanceName=job["name"]
        )
        inputs = [job["references"][name] for name in job["inputs"]]
        outputs = [job["references"][name] for name in job["outputs"]]
        rows: Rows = []
        fmu.instantiate()
        fmu.setupExperiment(startTime=0.0)
        fmu.enterInitializationMode()
        fmu.setReal(inputs, list(job["inputs"].values()))
        fmu.exitInitializationMode()
        for k in range(job["steps"]):
            fmu.doStep(k * job["step"], job["step"])
            rows.append(fmu.getReal(outputs))
        fmu.terminate()
        fmu.freeInstance()
        return rows


def fmpy_simulate(job: Job) -> Rows:
    """FMPy's ``simulate_fmu``."""
    import fmpy

    result = fmpy.simulate_fmu(
        job["path"],
        fmi_type="CoSimulation",
        stop_time=job["steps"] * job["step"],
        step_size=job["step"],
        output_interval=job["step"],
        start_values=job["inputs"],
        output=job["outputs"],
    )
    return [[float(row[name]) for name in job["outputs"]] for row in result][1:]


def fmpy_exchange(job: Job) -> Rows:
    """FMPy's ``simulate_fmu``, model exchange with CVode."""
    import fmpy

    result = fmpy.simulate_fmu(
        job["path"],
        fmi_type="ModelExchange",
        stop_time=job["steps"] * job["step"],
        output_interval=job["step"],
        relative_tolerance=1e-8,
        start_values=job["inputs"],
        output=job["outputs"],
    )
    times = {round(row["time"] / job["step"]): [float(row[name]) for name in job["outputs"]] for row in result}
    return [times[k + 1] for k in range(job["steps"])]


def fmuloader(job: Job) -> Rows:
    """fmuloader's low-level binding."""
    from fmuloader.fmi2 import Fmi2Slave, Fmi2Type

    fmu = Fmi2Slave(job["path"], model_identifier=job["name"])
    # its allocateMemory gives pointers cut to 32 bits (0.1.2rc0), so it passes none
    no_memory = {"cannot_use_memory_management_functions": True}
    fmu.instantiate(job["name"], Fmi2Type.CO_SIMULATION, guid=job["guid"], **no_memory)
    fmu.setup_experiment(start_time=0.0)
    fmu.enter_initialization_mode()
    fmu.set_real([job["references"][name] for name in job["inputs"]], list(job["inputs"].values()))
    fmu.exit_initialization_mode()
    rows: Rows = []
    for k in range(job["steps"]):
        fmu.do_step(k * job["step"], job["step"])
        rows.append(fmu.get_real([job["references"][name] for name in job["outputs"]]))
    fmu.terminate()
    fmu.free_instance()
    return rows


def fmuloader_exchange(job: Job) -> Rows:
    """fmuloader's low-level binding, model exchange, integrated by scipy's Radau."""
    from fmuloader.fmi2 import Fmi2Slave, Fmi2Type
    from scipy.integrate import solve_ivp

    fmu = Fmi2Slave(job["path"], model_identifier=job["name"])
    no_memory = {"cannot_use_memory_management_functions": True}
    fmu.instantiate(job["name"], Fmi2Type.MODEL_EXCHANGE, guid=job["guid"], **no_memory)
    fmu.setup_experiment(start_time=0.0)
    fmu.enter_initialization_mode()
    fmu.set_real([job["references"][name] for name in job["inputs"]], list(job["inputs"].values()))
    fmu.exit_initialization_mode()
    fmu.new_discrete_states()
    fmu.enter_continuous_time_mode()
    n = job["continuous_states"]
    nominals = fmu.get_nominals_of_continuous_states(n)

    def derivative(t: float, x: Any) -> list[float]:
        fmu.set_time(t)
        fmu.set_continuous_states(x.tolist())
        return fmu.get_derivatives(n)

    start = fmu.get_continuous_states(n)
    times = [(k + 1) * job["step"] for k in range(job["steps"])]
    atol = [1e-10 * nominal for nominal in nominals]
    solution = solve_ivp(derivative, (0.0, times[-1]), start, "Radau", times, rtol=1e-8, atol=atol)
    rows: Rows = []
    for k in range(job["steps"]):
        derivative(times[k], solution.y[:, k])
        fmu.completed_integrator_step()
        rows.append(fmu.get_real([job["references"][name] for name in job["outputs"]]))
    fmu.terminate()
    fmu.free_instance()
    return rows


def pathsim(job: Job) -> Rows:
    """PathSim's block for co-simulation, stepped by its scheduled event; FMI 2.0 and 3.0."""
    from pathsim_fmi.blocks import CoSimulationFMU

    block = CoSimulationFMU(job["path"], job["name"], start_values=job["inputs"], dt=job["step"])
    names = list(block.fmu_wrapper.input_refs)
    for name, value in job["inputs"].items():
        block.inputs[names.index(name)] = value
    outputs = list(block.fmu_wrapper.output_refs)
    rows: Rows = []
    for k in range(job["steps"]):
        block._step_fmu(k * job["step"])
        values = block.outputs.to_array()
        if len(values) < len(job["outputs"]):
            raise RuntimeError(f"the block has {len(values)} outputs for {len(job['outputs'])} elements")
        rows.append([float(values[outputs.index(name)]) for name in job["outputs"]])
    return rows


def pathsim_exchange(job: Job) -> Rows:
    """PathSim's block for model exchange, with its fifth-order Dormand-Prince method."""
    from pathsim import Connection, Simulation
    from pathsim.blocks import Constant
    from pathsim.solvers import RKDP54
    from pathsim_fmi.blocks import ModelExchangeFMU

    block = ModelExchangeFMU(job["path"], job["name"], start_values=job["inputs"])
    names, outputs = list(block.fmu_wrapper.input_refs), list(block.fmu_wrapper.output_refs)
    sources = {name: Constant(value) for name, value in job["inputs"].items()}
    wires = [Connection(source[0], block[names.index(name)]) for name, source in sources.items()]
    tolerances = {"tolerance_lte_rel": 1e-8, "tolerance_lte_abs": 1e-14}
    simulation = Simulation(
        [block, *sources.values()], wires, dt=job["step"] / 10, Solver=RKDP54, log=False, **tolerances
    )
    rows: Rows = []
    for _ in range(job["steps"]):
        simulation.run(job["step"], reset=False, adaptive=True)
        values = block.outputs.to_array()
        rows.append([float(values[outputs.index(name)]) for name in job["outputs"]])
    return rows


def sofirpy(job: Job) -> Rows:
    """sofirpy's ``simulate``."""
    from sofirpy import simulate

    result = simulate(
        stop_time=job["steps"] * job["step"],
        step_size=job["step"],
        fmu_paths={"fmu": job["path"]},
        start_values={"fmu": job["inputs"]},
        parameters_to_log={"fmu": job["outputs"]},
    )
    return [[float(row[f"fmu.{name}"]) for name in job["outputs"]] for _, row in result.iterrows()][1:]


def toolbox(job: Job) -> Rows:
    """The FMU manipulation toolbox's checker: no trace, an error if it finds anything."""
    tool = Path(sys.executable).with_name("fmutool")
    done = subprocess.run([tool, "-input", job["path"], "-check"], capture_output=True, text=True, check=False)
    said = done.stdout + done.stderr
    wrong = [line for line in said.splitlines() if line.startswith(("ERROR", "WARNING", "CRITICAL"))]
    if done.returncode or wrong:
        raise RuntimeError("; ".join(wrong) or said[-300:])
    return []


def fmureader(job: Job) -> Rows:
    """fmureader's check of modelDescription.xml: no trace, an error if it does not read every variable."""
    from fmureader.fmi import read_model_description

    found = {variable.name for variable in read_model_description(job["path"]).model_variables}
    if missing := job["references"].keys() - found:
        raise RuntimeError(f"variables not read: {', '.join(sorted(missing))}")
    return []
