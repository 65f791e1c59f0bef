"""modelDescription.xml of FMI 3.0. The elements that it shares with FMI 2.0 are in ``fmi2_xml``."""

from __future__ import annotations

from xml.etree.ElementTree import Element, SubElement

from ..fmu.xml import document
from ..model import Controller, Plant
from .fmi2_xml import (
    QUANTITIES,
    add_experiment,
    add_items,
    add_units,
    dependencies,
    description_root,
    number,
    set_real_attributes,
    set_whole_bounds,
    used_types,
    variable_element,
)
from .interface import InterfaceVariable, fmi3_variables
from .trace import Trace


def model_description3(trace: Trace, token: str, version: str) -> bytes:
    """modelDescription.xml of the FMI 3.0 FMU: a parameter array is one variable, a sampling instant is an event."""
    kind, groups = trace.kind, fmi3_variables(trace.kind)
    variables = [group[0] for group in groups]
    root = description_root(kind, version, fmiVersion="3.0", instantiationToken=token)
    offers = {
        "modelIdentifier": kind.__name__,
        "needsExecutionTool": "false",
        "canBeInstantiatedOnlyOncePerProcess": "false",
        "canGetAndSetFMUState": "true",
        "canSerializeFMUState": "true",
        "providesDirectionalDerivatives": "true",
        "providesAdjointDerivatives": "true",
        "providesPerElementDependencies": "false",
    }
    if issubclass(kind, Plant):
        discrete = len(trace.states) > trace.n_continuous
        SubElement(root, "ModelExchange", {**offers, "needsCompletedIntegratorStep": str(discrete).lower()})
    sampled = str(issubclass(kind, Controller)).lower()
    simulation = {
        "canHandleVariableCommunicationStepSize": "true",
        "maxOutputDerivativeOrder": "0",
        "providesIntermediateUpdate": "false",
        "mightReturnEarlyFromDoStep": sampled,
        "canReturnEarlyAfterIntermediateUpdate": "false",
        "hasEventMode": sampled,
        "providesEvaluateDiscreteStates": "false",
    }
    SubElement(root, "CoSimulation", {**offers, **simulation})
    add_units(root, variables)
    units, choices = used_types(variables)
    definitions = Element("TypeDefinitions")
    for unit in units:
        SubElement(definitions, "Float64Type", name=QUANTITIES[unit], quantity=QUANTITIES[unit], unit=unit)
    for choice in choices:
        add_items(SubElement(definitions, "EnumerationType", name=choice.__name__), choice)
    if len(definitions):
        root.append(definitions)
    add_experiment(root, kind, variables, 3)
    listed = SubElement(root, "ModelVariables")
    for group in groups:
        listed.append(_variable(group))
    _structure(root, trace)
    return document(root)


def _variable(group: tuple[InterfaceVariable, ...]) -> Element:
    variable = group[0]
    tag = {"Real": "Float64", "Integer": "Int32"}.get(variable.type, variable.type)
    name = variable.array if len(group) > 1 and variable.array else variable.name
    element = variable_element("UInt64" if variable.role == "counter" else tag, name, variable)
    if variable.type == "Real":
        set_real_attributes(element, variable)
        if variable.state is not None:
            element.set("derivative", str(variable.state))
    else:
        if variable.choice:
            element.set("declaredType", variable.choice.__name__)
        if variable.type != "Boolean":
            set_whole_bounds(element, variable)
    if variable.role in ("fixed", "tunable", "input"):
        element.set("start", " ".join(_start(v) for v in group))
    if len(group) > 1:
        SubElement(element, "Dimension", start=str(len(group)))
    return element


def _start(variable: InterfaceVariable) -> str:
    if variable.type == "Real":
        return number(variable.start)
    return str(bool(variable.start)).lower() if variable.type == "Boolean" else str(int(variable.start))


def _structure(root: Element, trace: Trace) -> None:
    first = {v.reference: group[0].reference for group in fmi3_variables(trace.kind) for v in group}
    structure, found = SubElement(root, "ModelStructure"), dependencies(trace)
    groups = (
        ("Output", found.outputs),
        ("ContinuousStateDerivative", found.derivatives),
        ("InitialUnknown", found.initial),
    )
    for name, unknowns in groups:
        for reference, known in unknowns.items():
            listed = " ".join(map(str, sorted({first[r] for r in known})))
            SubElement(structure, name, valueReference=str(reference), dependencies=listed)
