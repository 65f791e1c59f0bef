"""Systems, and single FMUs where a master takes nothing else: each function runs one job and gives its rows."""

from __future__ import annotations

import copy
import os
import shutil
import tempfile
from pathlib import Path
from typing import Any

Job = dict[str, Any]
Rows = list[list[float]]


def libcosim(job: Job) -> Rows:
    """libcosim through libcosimpy: one FMU, or a whole SSP with its fixed-step (Jacobi) algorithm."""
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
    from libcosimpy.CosimObserver import CosimObserver
    from libcosimpy.CosimSlave import CosimLocalSlave

    log_output_level(CosimLogLevel.INFO)  # FMILibrary's are shown with it
    nanoseconds = round(job["step"] * 1e9)
    observer = CosimObserver.create_last_value()
    if job["kind"] == "system":
        execution = CosimExecution.from_ssp_file(ssp_path=job["path"], step_size=nanoseconds)
        places = [
            (execution.slave_index_from_instance_name(name.partition(".")[0]), job["references"][name])
            for name in job["outputs"]
        ]
    else:
        execution = CosimExecution.from_step_size(nanoseconds)
        index = execution.add_local_slave(CosimLocalSlave(fmu_path=job["path"], instance_name=job["name"]))
        for name, value in job["inputs"].items():
            execution.real_initial_value(index, job["references"][name], value)
        places = [(index, job["references"][name]) for name in job["outputs"]]
    execution.add_observer(observer)
    rows: Rows = []
    for _ in range(job["steps"]):
        if not execution.step():
            raise RuntimeError("cosim_execution_step failed")
        rows.append([float(observer.last_real_values(slave, [reference])[0]) for slave, reference in places])
    return rows


def fmilibrary(job: Job) -> Rows:
    """libcosim with one FMU; a warning or an error in the log of FMILibrary, which it reads FMUs with, is an error."""
    kept = {stream: os.dup(stream) for stream in (1, 2)}
    with tempfile.TemporaryFile() as log:
        try:
            for stream in kept:
                os.dup2(log.fileno(), stream)
            rows = libcosim(job)
        finally:
            for stream, copy in kept.items():
                os.dup2(copy, stream)
                os.close(copy)
        log.seek(0)
        said = [x for x in log.read().decode(errors="replace").splitlines() if "[FMI Library" in x]
    if not said:
        raise RuntimeError("the log of FMILibrary is empty, so nothing was checked")
    wrong = [x.partition("[FMI Library")[2] for x in said if any(f"[{w}]" in x for w in ("warning", "error", "fatal"))]
    if wrong:
        raise RuntimeError("; ".join(wrong)[:300])
    return rows


def ecos(job: Job) -> Rows:
    """ecos through ecospy: one FMU, or a whole SSP with its fixed-step (Jacobi) algorithm."""
    try:
        from ecospy import EcosSimulation, EcosSimulationStructure
    except OSError as error:
        raise RuntimeError(f"{error}. Install it: apt-get install libtbb12") from None

    if job["kind"] == "system":
        simulation = EcosSimulation(job["step"], ssp_path=job["path"])
        simulation.init(parameter_set="start")
        identifiers = [name.replace(".", "::") for name in job["outputs"]]
    else:
        structure = EcosSimulationStructure()
        structure.add_model("fmu", job["path"])
        structure.add_parameter_set("inputs", {f"fmu::{name}": value for name, value in job["inputs"].items()})
        simulation = EcosSimulation(job["step"], structure=structure)
        simulation.init(parameter_set="inputs")
        identifiers = [f"fmu::{name}" for name in job["outputs"]]
    rows: Rows = []
    for _ in range(job["steps"]):
        simulation.step()
        rows.append([float(simulation.get_real(identifier)) for identifier in identifiers])
    simulation.terminate()
    return rows


def container(job: Job) -> Rows:
    """A container FMU that the FMU manipulation toolbox makes of the SSP, its master in C, run in FMPy.

    It reads the structure of the SSP only; parameters and outputs are told to it here. The container stays at
    ``job["container"]``; its own variables are called instance.variable, so the outputs get an underscore.
    """
    import fmpy
    from fmu_manipulation_toolbox.assembly import Assembly

    Path(job["container"]).unlink(missing_ok=True)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        shutil.copy(job["path"], folder / "system.ssp")
        assembly = Assembly("system.ssp", default_step_size=job["step"], fmu_directory=folder)
        root = assembly.root
        embedded = dict(zip([i["name"] for i in job["instances"]], root.fmu_names_list, strict=True))
        for instance in job["instances"]:
            for variable, (_, value) in instance["start"].items():
                text = str(int(value)) if isinstance(value, bool) else str(value)
                root.add_start_value(embedded[instance["name"]], variable, text)
        for output in job["outputs"]:
            instance, _, variable = output.partition(".")
            root.add_output(embedded[instance], variable, f"{instance}_{variable}")
        assembly.make_fmu()
        made = folder / "system.fmu"
        names = [output.replace(".", "_") for output in job["outputs"]]
        result = fmpy.simulate_fmu(
            str(made),
            stop_time=job["steps"] * job["step"],
            step_size=job["step"],
            output_interval=job["step"],
            output=names,
        )
        shutil.copy(made, job["container"])
    return [[float(row[name]) for name in names] for row in result][1:]


def fmpy_container(job: Job) -> Rows:
    """A container FMU that FMPy makes, run in FMPy.

    Its master knows the types of variables by the names of FMI 3.0 only, so that those of connections are changed.
    """
    import fmpy
    from fmpy.container_fmu.cli import create_container_fmu
    from fmpy.container_fmu.config import Component, Configuration, Connection
    from fmpy.model_description import CoSimulation, DefaultExperiment, ModelDescription, ModelVariable, Unknown

    embedded = {
        i["name"]: Component(i["name"], Path(i["path"]), fmpy.read_model_description(i["path"]))
        for i in job["instances"]
    }
    inner = {(name, v.name): v for name, c in embedded.items() for v in c.modelDescription.modelVariables}
    mappings: dict[Any, Any] = {}
    variables = [ModelVariable(name="time", type="Real", causality="independent", variability="continuous")]

    def show(instance: str, name: str, **attributes: Any) -> Any:
        kind = inner[instance, name].type
        kind = "Integer" if kind == "Enumeration" else kind
        variable = ModelVariable(name=f"{instance}.{name}", type=kind, **attributes)
        variables.append(variable)
        mappings[variable] = [(embedded[instance], inner[instance, name])]
        return variable

    for instance in job["instances"]:
        for name, (_, value) in instance["start"].items():
            text = str(value).lower() if isinstance(value, bool) else str(value)
            show(instance["name"], name, causality="parameter", variability="fixed", initial="exact", start=text)
    outputs = [
        show(*name.split("."), causality="output", variability="continuous", initial="calculated")
        for name in job["outputs"]
    ]
    description = ModelDescription()
    description.fmiVersion, description.modelName = "2.0", "container"
    description.guid = description.instantiationToken = "{container}"
    description.coSimulation = CoSimulation(modelIdentifier="container_fmu")
    description.coSimulation.fixedInternalStepSize = job["step"]
    description.defaultExperiment = DefaultExperiment(startTime=0, stopTime=job["steps"] * job["step"])
    description.modelVariables = variables
    description.outputs = [Unknown(variable=v) for v in outputs]
    description.initialUnknowns = [Unknown(variable=v) for v in outputs]

    def connect(source: str, output: str, target: str, name: str) -> Any:
        start: Any = copy.copy(inner[source, output])
        start.type = {"Real": "Float64", "Integer": "Int32"}.get(start.type, start.type)
        return Connection(embedded[source], [start], embedded[target], [inner[target, name]])

    connections = [connect(*connection) for connection in job["connections"]]
    configuration = Configuration(False, description, list(embedded.values()), connections, mappings)
    with tempfile.TemporaryDirectory() as folder:
        unpacked = Path(folder, "unpacked")
        unpacked.mkdir()
        made = Path(folder, "container.fmu")
        create_container_fmu(configuration, unpacked, made)
        result = fmpy.simulate_fmu(
            str(made),
            stop_time=job["steps"] * job["step"],
            step_size=job["step"],
            output_interval=job["step"],
            output=job["outputs"],
        )
    return [[float(row[name]) for name in job["outputs"]] for row in result][1:]


def syssimx(job: Job) -> Rows:
    """syssimx, wired through its API, with its Jacobi algorithm.

    ``System.initialize`` makes a step of length zero, which FMI 2.0 does not allow and FMUs refuse: it is left out.
    """
    from syssimx import Connection, FMUComponent, System
    from syssimx.system.algorithms.jacobi import JacobiAlgorithm

    class Component(FMUComponent):  # type: ignore[misc]
        def _do_step_internal(self, t: float, dt: float) -> None:
            if dt > 0:
                super()._do_step_internal(t, dt)

    system = System("system")
    components = {}
    for instance in job["instances"]:
        component = Component(instance["name"], instance["path"])
        for name, (_, value) in instance["start"].items():
            kept = component.parameters.get(name)
            quantity = value * kept.units if hasattr(kept, "units") else value
            if name in component.parameters:
                component.set_parameters(**{name: quantity})
            else:
                component.inputs[name].set(value)
        components[instance["name"]] = component
        system.add_component(component)
    for connection in job["connections"]:
        system.add_connection(Connection(*connection))
    system.set_algorithm(JacobiAlgorithm())
    system.initialize(0.0)
    rows: Rows = []
    for k in range(job["steps"]):
        system.algorithm.step(system, k * job["step"], job["step"])
        values = (components[i].outputs[v].get() for i, v in (name.split(".") for name in job["outputs"]))
        rows.append([float(getattr(value, "magnitude", value)) for value in values])
    return rows


def sofirpy(job: Job) -> Rows:
    """sofirpy's ``simulate``; the inputs of step 1, which it does not connect, are told to it."""
    from sofirpy import simulate

    starts = {i["name"]: {n: value for n, (_, value) in i["start"].items()} for i in job["instances"]}
    for instance, variable, value in job["first"]:
        starts[instance][variable] = value
    wires: dict[str, list[dict[str, str]]] = {}
    for source, output, target, variable in job["connections"]:
        wire = {"connect_to_system": source, "connect_to_external_parameter": output, "parameter_name": variable}
        wires.setdefault(target, []).append(wire)
    shown: dict[str, list[str]] = {}
    for output in job["outputs"]:
        instance, _, variable = output.partition(".")
        shown.setdefault(instance, []).append(variable)
    result = simulate(
        stop_time=job["steps"] * job["step"],
        step_size=job["step"],
        fmu_paths={i["name"]: i["path"] for i in job["instances"]},
        connections_config=wires or None,
        start_values={name: values for name, values in starts.items() if values},
        parameters_to_log=shown,
    )
    return [[float(row[name]) for name in job["outputs"]] for _, row in result.iterrows()][1:]


def cofmupy(job: Job) -> Rows:
    """CoFmuPy's master, all FMUs in one group (Jacobi); the inputs of step 1, which it takes as 0, are told to it."""
    from cofmupy.master import DefaultMaster

    initial: dict[str, dict[str, float]] = {}
    for instance in job["instances"]:
        initial[instance["name"]] = {n: v for n, (kind, v) in instance["start"].items() if kind == "Real"}
    for instance, variable, value in job["first"]:
        initial[instance][variable] = value
    connections: dict[tuple[str, str], list[tuple[str, str]]] = {}
    for source, output, target, variable in job["connections"]:
        connections.setdefault((source, output), []).append((target, variable))
    fmus = [
        {"id": i["name"], "name": i["name"], "path": i["path"], "initialization": initial[i["name"]]}
        for i in job["instances"]
    ]
    master = DefaultMaster(fmus, connections, [[fmu["id"] for fmu in fmus]], "jacobi")
    master.init_simulation(input_dict={})
    rows: Rows = []
    for _ in range(job["steps"]):
        found = master.do_step(job["step"])
        rows.append([float(found[i][v][0]) for i, v in (name.split(".") for name in job["outputs"])])
    return rows


def cofmupy_fmu(job: Job) -> Rows:
    """CoFmuPy with one FMU."""
    instance = {"name": "fmu", "path": job["path"], "start": {n: ["Real", v] for n, v in job["inputs"].items()}}
    outputs = [f"fmu.{name}" for name in job["outputs"]]
    return cofmupy({**job, "instances": [instance], "connections": [], "first": [], "outputs": outputs})


def syssimx_fmu(job: Job) -> Rows:
    """syssimx with one FMU."""
    instance = {"name": "fmu", "path": job["path"], "start": {n: ["Real", v] for n, v in job["inputs"].items()}}
    outputs = [f"fmu.{name}" for name in job["outputs"]]
    return syssimx({**job, "instances": [instance], "connections": [], "outputs": outputs})
