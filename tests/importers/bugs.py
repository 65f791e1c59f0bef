"""Bugs of importers, shown with FMUs that this project did not make: ``python bugs.py [--fmusim PATH ...]``.

Runs in the Python that has the importers, without this project, and prints a list of findings as JSON. The FMUs come
from PythonFMU's own exporter (slaves in foreign/), or are Reference FMUs. Each demonstration runs in a process of its
own and says ``no`` once the importer has been mended.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import importlib.metadata
import io
import json
import os
import re
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import run_programs

FOREIGN = Path(__file__).with_name("foreign")
STEP = 0.1
SECONDS = 60
Found = tuple[bool, str]
"""Whether the bug was seen, and what was seen."""


@dataclass(frozen=True)
class Tools:
    """Where things are."""

    folder: Path
    program: str = ""
    references: Path = Path()

    def fmu(self, name: str) -> str:
        """An FMU made of a slave of foreign/ by PythonFMU's exporter."""
        command = [
            sys.executable,
            "-m",
            "pythonfmu",
            "build",
            "-f",
            str(FOREIGN / f"{name}.py"),
            "-d",
            str(self.folder),
        ]
        subprocess.run(command, check=True, capture_output=True)
        return str(self.folder / f"{name.capitalize()}.fmu")

    def reference(self, version: str, name: str) -> str:
        """A Reference FMU."""
        return str(self.references / version / f"{name}.fmu")


def changed(fmu: str, change: Callable[[ElementTree.Element], None]) -> str:
    """The FMU with another modelDescription.xml; the binary stays."""
    target = str(Path(fmu).with_suffix(".changed.fmu"))
    with zipfile.ZipFile(fmu) as source, zipfile.ZipFile(target, "w") as archive:
        for member in source.infolist():
            content = source.read(member)
            if member.filename == "modelDescription.xml":
                root = ElementTree.fromstring(content)
                change(root)
                content = ElementTree.tostring(root)
            archive.writestr(member, content)
    return target


def ssp(
    folder: Path,
    fmus: dict[str, str],
    connections: Sequence[tuple[str, str, str, str, float]] = (),
    parameters: dict[str, str] | None = None,
    *,
    annotations: dict[str, str] | None = None,
    extra: str = "",
) -> str:
    """An SSP 1.0 of the FMUs: connections with a factor; parameters and annotations by instance, and of the system."""
    space = "http://ssp-standard.org/SSP1/SystemStructure"
    elements = ""
    for name, path in fmus.items():
        description = zipfile.ZipFile(path).read("modelDescription.xml")
        connectors = "".join(
            f'<ssd:Connector name="{v.get("name")}" kind="{v.get("causality")}"><ssc:Real/></ssd:Connector>'
            for v in ElementTree.fromstring(description).iter("ScalarVariable")
            if v.get("causality") in ("input", "output") and v.find("Real") is not None
        )
        values = (parameters or {}).get(name, "")
        if values:
            values = (
                "<ssd:ParameterBindings><ssd:ParameterBinding><ssd:ParameterValues>"
                f'<ssv:ParameterSet version="1.0" name="start"><ssv:Parameters>{values}</ssv:Parameters>'
                "</ssv:ParameterSet></ssd:ParameterValues></ssd:ParameterBinding></ssd:ParameterBindings>"
            )
        elements += (
            f'<ssd:Component name="{name}" type="application/x-fmu-sharedlibrary" source="resources/{name}.fmu">'
            f"<ssd:Connectors>{connectors}</ssd:Connectors>{values}{(annotations or {}).get(name, '')}</ssd:Component>"
        )
    wires = "".join(
        f'<ssd:Connection startElement="{a}" startConnector="{b}" endElement="{c}" endConnector="{d}">'
        + (f'<ssc:LinearTransformation factor="{factor}" offset="0"/>' if factor != 1 else "")
        + "</ssd:Connection>"
        for a, b, c, d, factor in connections
    )
    wires = f"<ssd:Connections>{wires}</ssd:Connections>" if wires else ""
    text = (
        f'<?xml version="1.0" encoding="UTF-8"?><ssd:SystemStructureDescription xmlns:ssd="{space}Description" '
        f'xmlns:ssc="{space}Common" xmlns:ssv="{space}ParameterValues" '
        'xmlns:osp="http://opensimulationplatform.com/SSP/OSPAnnotations" version="1.0" name="shown">'
        f'<ssd:System name="shown"><ssd:Elements>{elements}</ssd:Elements>{wires}{extra}</ssd:System>'
        '<ssd:DefaultExperiment startTime="0" stopTime="1"/></ssd:SystemStructureDescription>'
    )
    target = folder / "shown.ssp"
    with zipfile.ZipFile(target, "w") as archive:
        archive.writestr("SystemStructure.ssd", text)
        for name, path in fmus.items():
            archive.write(path, f"resources/{name}.fmu")
    return str(target)


def _enumeration(root: ElementTree.Element) -> None:
    types = ElementTree.Element("TypeDefinitions")
    kind = ElementTree.SubElement(ElementTree.SubElement(types, "SimpleType", name="Mode"), "Enumeration")
    for value in (1, 2, 3):
        ElementTree.SubElement(kind, "Item", name=f"m{value}", value=str(value))
    root.insert(1, types)
    for variable in root.iter("ScalarVariable"):
        if variable.get("name") == "mode":
            variable[0].tag = "Enumeration"
            variable[0].set("declaredType", "Mode")


REAL = '<ssv:Parameter name="k"><ssv:Real value="3"/></ssv:Parameter>'
SOURCE_GAIN = (("source", "y", "gain", "u", 1.0),)


def fmuloader_memory(tools: Tools) -> Found:
    from fmuloader import fmi2

    address = fmi2._make_callbacks().allocateMemory(1, 64)
    regions = (line.split()[0].split("-") for line in Path("/proc/self/maps").read_text().splitlines())
    inside = any(int(a, 16) <= address < int(b, 16) for a, b in regions)
    text = "in" if inside else "outside"
    return not inside, f"allocateMemory(1, 64) gives an address {text} the memory of the process"


def libcosim_parameter(tools: Tools) -> Found:
    from libcosimpy.CosimExecution import CosimExecution

    mode = '<ssv:Parameter name="mode"><ssv:Enumeration value="m3"/></ssv:Parameter>'
    system = ssp(tools.folder, {"chooser": changed(tools.fmu("chooser"), _enumeration)}, parameters={"chooser": mode})
    CosimExecution.from_ssp_file(ssp_path=system, step_size=10**8)
    return False, "the SSP is read"


def libcosim_enumeration(tools: Tools) -> Found:
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimObserver import CosimObserver
    from libcosimpy.CosimSlave import CosimLocalSlave

    execution = CosimExecution.from_step_size(10**8)
    path = changed(tools.fmu("chooser"), _enumeration)
    index = execution.add_local_slave(CosimLocalSlave(fmu_path=path, instance_name="chooser"))
    taken = execution.integer_initial_value(index, 0, 3)
    observer = CosimObserver.create_last_value()
    execution.add_observer(observer)
    execution.step()
    chosen = float(observer.last_real_values(index, [1])[0])
    return chosen != 3, f"integer_initial_value(3) is {'taken' if taken else 'refused'}, the FMU runs with {chosen:g}"


def ecos_enumeration(tools: Tools) -> Found:
    from ecospy import EcosSimulation, EcosSimulationStructure

    structure = EcosSimulationStructure()
    structure.add_model("chooser", changed(tools.fmu("chooser"), _enumeration))
    structure.add_parameter_set("start", {"chooser::mode": 3})
    simulation = EcosSimulation(STEP, structure=structure)
    simulation.init(parameter_set="start")
    simulation.step()
    chosen = simulation.get_real("chooser::chosen")
    return chosen != 3, f"set to 3, the FMU runs with {chosen:g}"


def ecos_unnamed(tools: Tools) -> Found:
    from ecospy import EcosSimulation

    system = ssp(tools.folder, {"gain": tools.fmu("gain")}, parameters={"gain": REAL})
    values = []
    for name in (None, "start"):
        simulation = EcosSimulation(STEP, ssp_path=system)
        simulation.init(parameter_set=name)
        simulation.step()
        values.append(simulation.get_real("gain::y"))
    return values[0] != 3, f"y = k u with k = 3, u = 1 is {values[0]:g}; {values[1]:g} when the set is named"


def ecos_multirate(tools: Tools) -> Found:
    from ecospy import EcosSimulation

    hint = (
        '<ssd:Annotations><ssc:Annotation type="com.opensimulationplatform">'
        f'<osp:StepSizeHint value="{4 * STEP}"/></ssc:Annotation></ssd:Annotations>'
    )
    fmus = {"slow": tools.fmu("gain"), "reader": tools.fmu("gain")}
    system = ssp(tools.folder, fmus, (("slow", "end", "reader", "u", 1.0),), annotations={"slow": hint})
    simulation = EcosSimulation(STEP, ssp_path=system)
    simulation.init()
    simulation.step(2)
    seen = simulation.get_real("reader::y")
    return seen > 1.5 * STEP, f"over the step from {STEP:g} s to {2 * STEP:g} s another FMU has its value of {seen:g} s"


def fmpy_parameters(tools: Tools) -> Found:
    y = _fmpy_ssp(tools, {"gain": REAL})["gain.y"][-1]
    return y != 15, f"y = k u with k = 3, u = 5 is {y:g}"


def fmpy_first(tools: Tools) -> Found:
    first = _fmpy_ssp(tools, {})["gain.first"][-1]
    return first != 5, f"u in step 1 is {first:g}; the source's output is 5 from the start"


def _fmpy_ssp(tools: Tools, parameters: dict[str, str]) -> Any:
    from fmpy.ssp.simulation import simulate_ssp

    fmus = {"source": tools.fmu("source"), "gain": tools.fmu("gain")}
    return simulate_ssp(ssp(tools.folder, fmus, SOURCE_GAIN, parameters), stop_time=5 * STEP, step_size=STEP)


def fmpy_container(tools: Tools) -> Found:
    import fmpy
    from fmpy.container_fmu.cli import create_container_fmu
    from fmpy.container_fmu.config import Component, Configuration, Connection
    from fmpy.model_description import CoSimulation, ModelDescription, ModelVariable, Unknown

    source, gain = (
        Component(name, Path(path), fmpy.read_model_description(path))
        for name, path in ((name, tools.fmu(name)) for name in ("source", "gain"))
    )
    a, u, y = (
        next(v for v in c.modelDescription.modelVariables if v.name == name)
        for c, name in ((source, "y"), (gain, "u"), (gain, "y"))
    )
    time = ModelVariable(name="time", type="Real", causality="independent", variability="continuous")
    shown = ModelVariable(name="y", type="Real", causality="output", variability="continuous", initial="calculated")
    description = ModelDescription()
    description.fmiVersion, description.modelName = "2.0", "shown"
    description.guid = description.instantiationToken = "{shown}"
    description.coSimulation = CoSimulation(modelIdentifier="container_fmu")
    description.coSimulation.fixedInternalStepSize = STEP
    description.modelVariables, description.outputs = [time, shown], [Unknown(variable=shown)]
    description.initialUnknowns = [Unknown(variable=shown)]
    connection = Connection(source, [a], gain, [u])
    made, said = tools.folder / "shown.fmu", list[str]()
    (tools.folder / "unpacked").mkdir()
    configuration = Configuration(False, description, [source, gain], [connection], {shown: [(gain, y)]})
    create_container_fmu(configuration, tools.folder / "unpacked", made)
    try:
        result = fmpy.simulate_fmu(
            str(made),
            stop_time=5 * STEP,
            step_size=STEP,
            output=["y"],
            debug_logging=True,
            logger=lambda *arguments: said.append(arguments[-1].decode()),
        )
    except Exception as error:
        wrong = re.search(r"unknown variant `\w+`", " ".join(said))
        return True, f"{error}" + (f": {wrong[0]}" if wrong else "")
    return float(result["y"][-1]) != 5, f"y = u with u = 5 is {result['y'][-1]:g}"


def sofirpy_first(tools: Tools) -> Found:
    from sofirpy import simulate

    wire = {"parameter_name": "u", "connect_to_system": "source", "connect_to_external_parameter": "y"}
    result = simulate(
        stop_time=5 * STEP,
        step_size=STEP,
        fmu_paths={"source": tools.fmu("source"), "gain": tools.fmu("gain")},
        connections_config={"gain": [wire]},
        parameters_to_log={"gain": ["first"]},
    )
    first = float(result["gain.first"].iloc[-1])
    return first != 5, f"u in step 1 is {first:g}; the source's output is 5 from the start"


def cofmupy_first(tools: Tools) -> Found:
    from cofmupy.master import DefaultMaster

    fmus = [{"id": n, "name": n, "path": tools.fmu(n), "initialization": {}} for n in ("source", "gain")]
    master = DefaultMaster(fmus, {("source", "y"): [("gain", "u")]}, [["source", "gain"]], "jacobi")
    master.init_simulation(input_dict={})
    master.do_step(STEP)
    first = master.do_step(STEP)["gain"]["first"][0]
    return first != 5, f"u in step 1 is {first:g}; the source's output is 5 from the start"


def cofmupy_types(tools: Tools) -> Found:
    from cofmupy.master import DefaultMaster

    fmus = [{"id": "chooser", "name": "chooser", "path": tools.fmu("chooser"), "initialization": {"mode": 3}}]
    try:
        master = DefaultMaster(fmus, {}, [["chooser"]], "jacobi")
        master.init_simulation(input_dict={})
        chosen = master.do_step(STEP)["chooser"]["chosen"][0]
    except Exception as error:
        return True, f"an Integer set to 3: {type(error).__name__}: {error}"
    return chosen != 3, f"an Integer set to 3, the FMU runs with {chosen:g}"


def _independent(root: ElementTree.Element) -> None:
    for unknown in root.iter("Unknown"):
        unknown.set("dependencies", "")


def syssimx_dependencies(tools: Tools) -> Found:
    from syssimx import FMUComponent

    try:
        FMUComponent("gain", tools.fmu("gain"))
    except TypeError as error:
        return True, f"{type(error).__name__}: {error}"
    return False, "the FMU is read"


def syssimx_zero(tools: Tools) -> Found:
    from syssimx import FMUComponent, System

    system, component = System("shown"), FMUComponent("gain", changed(tools.fmu("gain"), _independent))
    system.add_component(component)
    system.initialize(0.0)
    system.algorithm.step(system, 0.0, STEP)
    value = component.outputs["shortest"].get()
    shortest = float(getattr(value, "magnitude", value))
    return shortest == 0, f"the shortest step is {shortest:g} s"


def container_parameters(tools: Tools) -> Found:
    return _container(tools, 1.0, {"gain": REAL}, 15.0, "k = 3, u = 5")


def container_factor(tools: Tools) -> Found:
    return _container(tools, 2.0, {}, 10.0, "k = 1, u = 2*5")


def _container(tools: Tools, factor: float, parameters: dict[str, str], right: float, text: str) -> Found:
    import fmpy
    from fmu_manipulation_toolbox.assembly import Assembly

    fmus = {"source": tools.fmu("source"), "gain": tools.fmu("gain")}
    ssp(tools.folder, fmus, (("source", "y", "gain", "u", factor),), parameters)
    assembly = Assembly("shown.ssp", default_step_size=STEP, fmu_directory=tools.folder)
    assembly.root.add_output(next(n for n in assembly.root.fmu_names_list if "gain" in n), "y", "result")
    assembly.make_fmu()
    made = str(tools.folder / "shown.fmu")
    result = fmpy.simulate_fmu(made, stop_time=5 * STEP, step_size=STEP, output_interval=STEP, output=["result"])
    y = float(result["result"][-1])
    return y != right, f"y = k u with {text} is {y:g}"


def pathsim_early(tools: Tools) -> Found:
    from pathsim import Simulation
    from pathsim_fmi.blocks import CoSimulationFMU

    block = CoSimulationFMU(tools.fmu("gain"), "gain", dt=STEP)
    simulation = Simulation([block], [], dt=STEP / 4, log=False)
    simulation.run(2.5 * STEP)
    end = block.outputs.to_array()[list(block.fmu_wrapper.output_refs).index("end")]
    time = simulation.time
    return end > time + 1e-9, f"at {time:g} s the block shows the FMU's outputs of {end:g} s"


def fmuloader_arrays(tools: Tools) -> Found:
    import fmpy
    from fmuloader.fmi3 import Fmi3Slave

    path = tools.reference("3.0", "StateSpace")
    description = fmpy.read_model_description(path)
    reference = next(v.valueReference for v in description.modelVariables if v.name == "y")
    fmu = Fmi3Slave(path, model_identifier="StateSpace")
    fmu.instantiate_co_simulation("shown", instantiation_token=description.instantiationToken)
    fmu.enter_initialization_mode(start_time=0.0)
    fmu.exit_initialization_mode()
    try:
        count = len(fmu.get_float64([reference]))
    except Exception as error:
        return True, f"get_float64 of y, 3 elements: {type(error).__name__}: {error}"
    return count != 3, f"get_float64 of y gives {count} of 3 elements"


def pathsim_arrays(tools: Tools) -> Found:
    from pathsim_fmi.blocks import CoSimulationFMU

    try:
        block = CoSimulationFMU(tools.reference("3.0", "StateSpace"), "shown", dt=1.0)
        count = len(block.outputs.to_array())
    except Exception as error:
        return True, f"the block of y, 3 elements: {type(error).__name__}: {error}"
    return count != 3, f"the block has {count} outputs for y with 3 elements"


def checker_discrete(tools: Tools) -> Found:
    (tools.folder / "in.csv").write_text("time,Float64_continuous_input,Float64_discrete_input\n0,1,2\n1,1,2\n")
    command = [tools.program, "-k", "cs", "-h", str(STEP), "-s", "1", "-i", "in.csv", "-o", "out.csv", "-e", "log.txt"]
    subprocess.run([*command, tools.reference("2.0", "Feedthrough")], cwd=tools.folder, check=True, capture_output=True)
    heads, *_, last = (tools.folder / "out.csv").read_text().splitlines()
    column = heads.replace('"', "").split(",").index("Float64_discrete_output")
    value = float(last.split(",")[column])
    return value != 2, f"the second input set to 2 (the first to 1), the FMU's copy of it is {value:g}"


def omsimulator_plain(tools: Tools) -> Found:
    system = ssp(tools.folder, {"lag": tools.reference("2.0", "Dahlquist")})
    command = [tools.program, "--stopTime=1", "--resultFile=result.csv", system]
    done = subprocess.run(command, cwd=tools.folder, capture_output=True, text=True, check=False, timeout=SECONDS)
    said = re.findall(r"error:\s+(.*)", done.stdout + done.stderr)
    return bool(done.returncode), f"exit code {done.returncode}" + (f": {said[0]}" if said else "")


def omsimulator_factor(tools: Tools) -> Found:
    space = "https://raw.githubusercontent.com/OpenModelica/OMSimulator/master/schema/oms.xsd"
    master = (
        f'<ssd:Annotations><ssc:Annotation type="org.openmodelica"><oms:Annotations xmlns:oms="{space}">'
        '<oms:SimulationInformation><oms:FixedStepMaster description="oms-ma" stepSize="0.1" relativeTolerance="1e-6"/>'
        "</oms:SimulationInformation></oms:Annotations></ssc:Annotation></ssd:Annotations>"
    )
    fmus = {"lag": tools.reference("2.0", "Dahlquist"), "copy": tools.reference("2.0", "Feedthrough")}
    wires = (("lag", "x", "copy", "Float64_continuous_input", 2.0),)
    command = [tools.program, "--stopTime=1", "--resultFile=result.csv", ssp(tools.folder, fmus, wires, extra=master)]
    subprocess.run(command, cwd=tools.folder, check=True, capture_output=True, timeout=SECONDS)
    with (tools.folder / "result.csv").open(newline="") as file:
        last = list(csv.DictReader(file))[-1]
    x, y = (
        next(float(value) for name, value in last.items() if name.strip().endswith(end))
        for end in ("lag.x", "copy.Float64_continuous_output")
    )
    return abs(y - 2 * x) > 1e-6, f"y = 2 x with x = {x:g} is {y:g}"


@dataclass(frozen=True)
class Bug:
    """A demonstration: what is wrong, which FMU shows it, what it needs."""

    importer: str
    text: str
    fmu: str
    show: Callable[[Tools], Found]
    needs: tuple[str, ...] = ()
    """Options of the command line."""
    crash: str = ""
    """What the end of the process means, if the bug ends it."""


OWN = "made by PythonFMU"
EDITED = "made by PythonFMU, its Integer declared as Enumeration"
BUGS = (
    Bug("fmuloader", "the memory it hands to an FMU has an address cut to 32 bits", "none", fmuloader_memory),
    Bug("fmuloader", "reads no arrays of FMI 3.0", "Reference FMU", fmuloader_arrays, ("reference_fmus",)),
    Bug("libcosimpy", "ends the process at ssv:Enumeration", EDITED, libcosim_parameter, crash="the process ended"),
    Bug("libcosimpy", "knows no Enumeration of FMI 2.0", EDITED, libcosim_enumeration),
    Bug("ecospy", "knows no Enumeration of FMI 2.0", EDITED, ecos_enumeration),
    Bug("ecospy", "applies parameters of an SSP only if their set is named", OWN, ecos_unnamed),
    Bug("ecospy", "shows the outputs of a slower FMU before their time", OWN, ecos_multirate),
    Bug("fmpy", "simulate_ssp ignores parameters", OWN, fmpy_parameters),
    Bug("fmpy", "simulate_ssp takes the inputs of step 1 as 0", OWN, fmpy_first),
    Bug("fmpy", "its container reads no connection of FMI 2.0 FMUs that it wrote itself", OWN, fmpy_container),
    Bug("sofirpy", "sets connected inputs only after step 1", OWN, sofirpy_first),
    Bug("cofmupy", "takes the inputs of step 1 as 0", OWN, cofmupy_first, ("cofmupy",)),
    Bug("cofmupy", "sets and reads every variable as Real", OWN, cofmupy_types, ("cofmupy",)),
    Bug("syssimx", "reads no FMU whose outputs state no dependencies", OWN, syssimx_dependencies),
    Bug("syssimx", "makes a step of length zero, which FMI 2.0 forbids", f"{OWN}, dependencies added", syssimx_zero),
    Bug("fmu-manipulation-toolbox", "a container ignores the parameters of its SSP", OWN, container_parameters),
    Bug("fmu-manipulation-toolbox", "a container ignores factors in connections of its SSP", OWN, container_factor),
    Bug("pathsim-fmi", "the block's outputs are a step early", OWN, pathsim_early),
    Bug("pathsim-fmi", "reads no arrays of FMI 3.0", "Reference FMU", pathsim_arrays, ("reference_fmus",)),
    Bug(
        "FMUComplianceChecker",
        "gives every discrete Real input the value of the first input",
        "Reference FMU",
        checker_discrete,
        ("fmu_check", "reference_fmus"),
    ),
    Bug(
        "OMSimulator",
        "reads no SSP without an annotation of its own",
        "Reference FMU",
        omsimulator_plain,
        ("omsimulator", "reference_fmus"),
    ),
    Bug(
        "OMSimulator",
        "ignores factors in connections",
        "Reference FMUs",
        omsimulator_factor,
        ("omsimulator", "reference_fmus"),
    ),
)
PROGRAMS = {"fmu_check": "fmu-check", "omsimulator": "omsimulator"}
"""Option that gives a program's path -> its name in run_programs."""


def one(number: int, tools: Tools) -> None:
    """Run one demonstration and print what it found; what an importer prints itself is dropped."""
    bug = BUGS[number]
    option = next((name for name in bug.needs if name in PROGRAMS), "")
    real = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    version = (
        run_programs.version(PROGRAMS[option], tools.program) if option else importlib.metadata.version(bug.importer)
    )
    real.write(json.dumps({"version": version}) + "\n")
    real.flush()
    with contextlib.redirect_stdout(io.StringIO()):
        seen, what = bug.show(tools)
    real.write(json.dumps({"seen": bool(seen), "what": what}) + "\n")
    real.flush()


def finding(number: int, options: argparse.Namespace) -> dict[str, str]:
    """Run one demonstration in a process of its own."""
    bug = BUGS[number]
    found = {"importer": bug.importer, "version": "", "bug": bug.text, "fmu": bug.fmu, "seen": "not tried", "what": ""}
    if missing := [name for name in bug.needs if not getattr(options, name)]:
        return found | {"what": "give " + ", ".join(f"--{name.replace('_', '-')}" for name in missing)}
    python = options.cofmupy if "cofmupy" in bug.needs else sys.executable
    command = [python, __file__, "--one", str(number)]
    for name in bug.needs:
        command += [f"--{name.replace('_', '-')}", str(getattr(options, name))]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=SECONDS)
    except subprocess.TimeoutExpired:
        return found | {"seen": "yes", "what": f"no end within {SECONDS} s"}
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    found["version"] = lines[0]["version"] if lines else ""
    if len(lines) == 2:
        return found | {"seen": "yes" if lines[1]["seen"] else "no", "what": lines[1]["what"]}
    if bug.crash and done.returncode < 0:
        return found | {"seen": "yes", "what": f"{bug.crash} (signal {-done.returncode})"}
    return found | {"seen": "failed", "what": f"exit code {done.returncode}: {done.stderr.strip().splitlines()[-1:]}"}


def main() -> None:
    """Run every demonstration, print the findings as JSON."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--one", type=int)
    for name in ("cofmupy", "fmusim", "fmu-check", "omsimulator", "reference-fmus"):
        parser.add_argument(f"--{name}")
    options = parser.parse_args()
    if options.one is None:
        sys.stdout.write(json.dumps([finding(k, options) for k in range(len(BUGS))]))
        return
    with tempfile.TemporaryDirectory() as folder:
        program = options.fmu_check or options.omsimulator or ""
        one(options.one, Tools(Path(folder), program, Path(options.reference_fmus or "")))


if __name__ == "__main__":
    main()
