"""Writes systems as SSP 1.0 (System Structure and Parameterization) for other tools, with the FMUs inside.

``write_ssp`` packs a checked system; ``read_ssp`` gives the document of an .ssp or .ssd for ``make_system``. SSP cannot
express communication step size, order, step multiples, record, signals, sums and noise. These are in annotations of
type ``motion-cosim``. Readers that do not know these annotations use the rest.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from decimal import Decimal
from pathlib import Path
from typing import TYPE_CHECKING, cast
from urllib.parse import quote
from xml.etree import ElementTree

from ..fmu.archive import write_zip
from ..fmu.description import Fmu
from ..fmu.variables import Value, Variable
from ..fmu.xml import document
from ..units import BASE_UNITS
from .parts import Connection, Instance
from .ssp_integers import with_integers
from .ssp_names import ANNOTATION, NAMESPACES, tag
from .written import connection_entries, record_files, record_names, signal_tables, unique_names

if TYPE_CHECKING:
    from .system import System


PARAMETER_SET = "start"
"""Name of every parameter set. Some importers apply only the parameter sets of one name, which the user gives."""

GENERATION_DATE = "2026-01-01T00:00:00Z"
"""Fixed, so that equal systems give equal bytes."""


# ---- writing ----


def write_ssp(system: System, target: str | Path, *, integers: bool = False) -> Path:
    """Write a system as .ssp, with its FMUs in resources/. Equal systems give equal bytes. Raises FileError.

    With ``integers``, the FMUs declare Enumeration variables as integers, for importers without enumerations.
    """
    target = Path(target)
    files = unique_names(path for paths in (resource_names(system), record_names(system)) for path in paths)
    description = structure(system, {path: f"resources/{name}" for path, name in files.items()})
    start = "SystemStructure.ssd"
    members: dict[str, bytes | Path] = {start: description}
    fmus = {instance.fmu.path for instance in system.instances}
    for name, path in record_files(files).items():
        members[f"resources/{name}"] = with_integers(path.read_bytes()) if integers and path in fmus else path
    write_zip(target, members, start, deflated=(start,))
    return target


def resource_names(system: System) -> dict[Path, str]:
    """A file name for each FMU of the system. Different FMUs of the same name get a number."""
    return unique_names(instance.fmu.path for instance in system.instances)


def lost_elsewhere(system: System, *, integers: bool = False) -> list[str]:
    """The parts of this system that other tools ignore when they run its .ssp, as one sentence each.

    ``integers``: the FMUs in the .ssp declare enumerations as integers.
    """
    lost: list[str] = []
    own = own_connections(system)
    open_inputs = dict.fromkeys(".".join(c.target) for c in own if _is_own(system, c))
    if open_inputs:
        lost.append(
            f"records and sums are beyond SSP 1.0: other tools leave {', '.join(open_inputs)} unconnected. "
            "The package holds the records as resources."
        )
    noisy = [".".join(c.target) for c in own if c.noise is not None and not _is_own(system, c)]
    if noisy:
        lost.append(f"noise is beyond SSP 1.0: other tools leave out that on {', '.join(noisy)}.")
    chosen = [
        f"{instance.name}.{name}"
        for instance in system.instances
        for name, value in instance.start.items()
        if instance.fmu.variables[name].type == "Enumeration" and value != instance.fmu.variables[name].start
    ]
    if chosen and not integers:
        lost.append(
            f"libcosim and ecos know no enumerations and read past {', '.join(chosen)}. For them, add --enumerations "
            "integer."
        )
    return lost


def own_connections(system: System) -> list[Connection]:
    """The connections that SSP cannot express: all connections to inputs that get a record, a sum or noise."""
    targets = {c.target for c in system.connections if c.noise is not None or _is_own(system, c)}
    return [connection for connection in system.connections if connection.target in targets]


def _is_own(system: System, connection: Connection) -> bool:
    """Whether SSP cannot express a connection even in part: it belongs to a sum, or its source is a record."""
    records = {signal.name for signal in system.signals}
    same = [c for c in system.connections if c.target == connection.target]
    return len(same) > 1 or connection.source[0] in records


def structure(system: System, sources: Mapping[Path, str]) -> bytes:
    """The content of SystemStructure.ssd; ``sources`` gives the path of each FMU and record relative to this file."""
    for prefix, uri in NAMESPACES.items():
        ElementTree.register_namespace(prefix, uri)
    root = ElementTree.Element(
        tag("ssd:SystemStructureDescription"),
        {
            "version": "1.0",
            "name": _stem(system.name),
            "generationTool": "motion-cosim",
            "generationDateAndTime": GENERATION_DATE,
        },
    )
    if system.description:
        root.set("description", system.description)
    top = _sub(root, "ssd:System", name="system")
    elements = _sub(top, "ssd:Elements")
    units: dict[str, Fmu] = {}
    for instance in system.instances:
        _component(elements, instance, quote(sources[instance.fmu.path]), system.step_size, units)
    connections = _sub(top, "ssd:Connections")
    for connection in system.connections:
        if _is_own(system, connection):
            continue
        element = _sub(
            connections,
            "ssd:Connection",
            startElement=connection.source[0],
            startConnector=connection.source[1],
            endElement=connection.target[0],
            endConnector=connection.target[1],
        )
        _transformation(element, connection)
    if not len(connections):
        top.remove(connections)
    # OMSimulator does not read a system without its own FixedStepMaster. It takes a missing tolerance as 0.
    holder = _sub(_sub(_sub(top, "ssd:Annotations"), "ssc:Annotation", type="org.openmodelica"), "oms:Annotations")
    tolerance = "1e-8" if system.tolerance is None else repr(system.tolerance)
    master = {"description": "oms-ma", "stepSize": str(system.step_size), "relativeTolerance": tolerance}
    _sub(_sub(holder, "oms:SimulationInformation"), "oms:FixedStepMaster", **master)
    _units(root, "ssd:Units", units)
    _experiment(root, system, sources)
    return document(root)


def _component(
    elements: ElementTree.Element, instance: Instance, source: str, step_size: Decimal, units: dict[str, Fmu]
) -> None:
    """Add an instance with its connectors and start values. The units that it uses are added to ``units``."""
    fmu = instance.fmu
    component = _sub(
        elements,
        "ssd:Component",
        name=instance.name,
        type="application/x-fmu-sharedlibrary",
        source=source,
        implementation="CoSimulation",
    )
    if fmu.description:
        component.set("description", fmu.description)
    connectors = _sub(component, "ssd:Connectors")
    for name in (*fmu.inputs, *fmu.outputs):
        variable = fmu.variables[name]
        connector = _sub(connectors, "ssd:Connector", name=name, kind=variable.causality)
        _type(connector, variable, fmu, units)
    if instance.start:
        bindings = _sub(component, "ssd:ParameterBindings")
        values = _sub(_sub(bindings, "ssd:ParameterBinding"), "ssd:ParameterValues")
        values.append(parameter_set(fmu, instance.start))
    if instance.step_multiple != 1:
        holder = _sub(component, "ssd:Annotations")
        own = _sub(holder, "ssc:Annotation", type=ANNOTATION)
        _sub(own, "cosim:Instance", stepMultiple=str(instance.step_multiple))
        hint = _sub(holder, "ssc:Annotation", type="com.opensimulationplatform")
        _sub(hint, "osp:StepSizeHint", value=str(step_size * instance.step_multiple))


def _experiment(root: ElementTree.Element, system: System, sources: Mapping[Path, str]) -> None:
    """Add the DefaultExperiment: start and stop time for every tool, and annotations.

    One annotation has the step size for libcosim; the other has the entries that only this project reads.
    """
    experiment = _sub(root, "ssd:DefaultExperiment", startTime=str(system.start_time), stopTime=str(system.stop_time))
    holder = _sub(experiment, "ssd:Annotations")
    algorithm = _sub(_sub(holder, "ssc:Annotation", type="com.opensimulationplatform"), "osp:Algorithm")
    _sub(algorithm, "osp:FixedStepAlgorithm", baseStepSize=str(system.step_size))
    own = _sub(_sub(holder, "ssc:Annotation", type=ANNOTATION), "cosim:Experiment", stepSize=str(system.step_size))
    own.set("order", system.order if isinstance(system.order, str) else " ".join(system.order))
    if system.tolerance is not None:
        own.set("tolerance", repr(system.tolerance))
    record = _sub(own, "cosim:Record", decimation=str(system.decimation))
    for name, variable in system.record:
        _sub(record, "cosim:Variable", name=f"{name}.{variable}")
    if own_connections(system) or system.signals:
        more = {
            "connections": connection_entries(own_connections(system)),
            "signals": signal_tables(system, sources),
        }
        _sub(own, "cosim:Document").text = json.dumps(more, default=float, ensure_ascii=False)


def _transformation(element: ElementTree.Element, connection: Connection) -> None:
    """Write the factor and offset of a connection.

    A conversion of units is written as a LinearTransformation, because not every importer converts units. An annotation
    keeps the factor and offset of the system file.
    """
    factor, offset = connection.factor, connection.offset
    if connection.units != "same":
        element.set("suppressUnitConversion", "true")
    if connection.units in ("converted", "given") or (factor, offset) != (1.0, 0.0):
        linear = _sub(element, "ssc:LinearTransformation", offset=repr(offset))
        if connection.units in ("converted", "given") or factor != 1.0:
            linear.set("factor", repr(factor))
    if connection.units == "converted":
        own = _sub(_sub(element, "ssd:Annotations"), "ssc:Annotation", type=ANNOTATION)
        factor, offset = connection.stated
        _sub(own, "cosim:Conversion", factor=repr(factor), offset=repr(offset))


def parameter_set(fmu: Fmu, start: Mapping[str, Value]) -> ElementTree.Element:
    """An SSV ParameterSet. Enumerations are written as Integer, because some importers fail at the name of an item."""
    root = ElementTree.Element(tag("ssv:ParameterSet"), {"version": "1.0", "name": PARAMETER_SET})
    parameters = _sub(root, "ssv:Parameters")
    units: dict[str, Fmu] = {}
    for name, value in start.items():
        variable = fmu.variables[name]
        kind = "Integer" if variable.type == "Enumeration" else variable.type
        text = str(value).lower() if isinstance(value, bool) else str(value) if isinstance(value, str) else repr(value)
        element = _sub(_sub(parameters, "ssv:Parameter", name=name), f"ssv:{kind}", value=text)
        if kind == "Real" and variable.unit in fmu.base_units:
            element.set("unit", cast(str, variable.unit))
            units[cast(str, variable.unit)] = fmu
    _units(root, "ssv:Units", units)
    return root


def _stem(name: str) -> str:
    return Path(name).stem or "system"


def _sub(parent: ElementTree.Element, element: str, /, **attributes: str) -> ElementTree.Element:
    return ElementTree.SubElement(parent, tag(element), attributes)


def _type(connector: ElementTree.Element, variable: Variable, fmu: Fmu, units: dict[str, Fmu]) -> None:
    kind = "Integer" if variable.type == "Enumeration" else variable.type
    element = _sub(connector, f"ssc:{kind}")
    if kind == "Real" and variable.unit in fmu.base_units:
        element.set("unit", cast(str, variable.unit))
        units.setdefault(cast(str, variable.unit), fmu)


def _units(root: ElementTree.Element, tag: str, units: Mapping[str, Fmu]) -> None:
    if not units:
        return
    definitions = _sub(root, tag)
    for name in sorted(units):
        unit = units[name].base_units[name]
        base = _sub(_sub(definitions, "ssc:Unit", name=name), "ssc:BaseUnit")
        for symbol, exponent in zip(BASE_UNITS, unit.exponents, strict=True):
            if exponent:
                base.set(symbol, str(int(exponent)))
        if unit.factor != 1.0:
            base.set("factor", repr(unit.factor))
        if unit.offset != 0.0:
            base.set("offset", repr(unit.offset))
