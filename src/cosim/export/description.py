"""modelDescription.xml and buildDescription.xml of an FMU."""

from __future__ import annotations

import inspect
import math
from collections.abc import Iterable, Sequence
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from ..model import Component, Plant
from ..units import BASE_UNITS, parse_unit
from .layout import Variable, layout
from .trace import Trace

GENERATION_DATE = "2026-01-01T00:00:00Z"
"""Fixed, so that equal sources give equal bytes."""

LOG_CATEGORIES = (
    ("logStatusWarning", "Messages with status fmi2Warning"),
    ("logStatusDiscard", "Messages with status fmi2Discard: a value or a step was refused"),
    ("logStatusError", "Messages with status fmi2Error: a call was wrong"),
    ("logAll", "All messages"),
)

QUANTITIES = {
    "m": "Length",
    "m/s": "Velocity",
    "m/s2": "Acceleration",
    "m/s3": "Jerk",
    "rad": "Angle",
    "rad/s": "AngularVelocity",
    "rad/s2": "AngularAcceleration",
    "N": "Force",
    "N.m": "Torque",
    "kg": "Mass",
    "kg.m2": "MomentOfInertia",
    "A": "ElectricCurrent",
    "V": "ElectricPotential",
    "s": "Time",
    "Hz": "Frequency",
    "N/m": "Stiffness",
    "N.s/m": "Damping",
    "N.m/rad": "RotationalStiffness",
    "N.m.s/rad": "RotationalDamping",
}


def summary(kind: type[Component]) -> str:
    """The first sentence of a component's docstring."""
    return " ".join((inspect.getdoc(kind) or kind.__name__).split("\n\n")[0].split())


def number(value: float) -> str:
    """A number as XML text that reads back to the same bits."""
    return repr(float(value)).removesuffix(".0")


def _xml(root: Element) -> bytes:
    indent(root, "  ")
    return b'<?xml version="1.0" encoding="UTF-8"?>\n' + tostring(root) + b"\n"


def model_description(trace: Trace, guid: str, version: str, *, sources: Sequence[str], native: bool = True) -> bytes:
    """modelDescription.xml of the native flavour, or of the Python one (``native=False``)."""
    kind, variables = trace.kind, layout(trace)
    root = Element(
        "fmiModelDescription",
        fmiVersion="2.0",
        modelName=kind.__name__,
        guid=guid,
        description=summary(kind),
        version=version,
        author="The motion-cosim authors",
        license="MIT",
        generationTool=f"motion-cosim {version}",
        generationDateAndTime=GENERATION_DATE,
        variableNamingConvention="structured",
    )
    exchange = None
    if native and issubclass(kind, Plant):
        root.set("numberOfEventIndicators", "0")
        exchange = SubElement(
            root,
            "ModelExchange",
            modelIdentifier=kind.__name__,
            needsExecutionTool="false",
            completedIntegratorStepNotNeeded="false" if len(trace.states) > trace.n_continuous else "true",
            canBeInstantiatedOnlyOncePerProcess="false",
            canNotUseMemoryManagementFunctions="false",
            canGetAndSetFMUstate="true",
            canSerializeFMUstate="true",
            providesDirectionalDerivative="true",
        )
    simulation = SubElement(
        root,
        "CoSimulation",
        modelIdentifier=kind.__name__,
        needsExecutionTool="false" if native else "true",
        canHandleVariableCommunicationStepSize="true",
        canInterpolateInputs="false",
        maxOutputDerivativeOrder="0",
        canRunAsynchronuously="false",
        canBeInstantiatedOnlyOncePerProcess="false",
        canNotUseMemoryManagementFunctions="false" if native else "true",
        canGetAndSetFMUstate="true",
        canSerializeFMUstate="true",
        providesDirectionalDerivative="true" if native else "false",
    )
    for element in (exchange, simulation) if sources else ():
        if element is not None:
            files = SubElement(element, "SourceFiles")
            for name in sources:
                SubElement(files, "File", name=name)
    _units(root, variables)
    _types(root, variables)
    categories = SubElement(root, "LogCategories")
    for name, text in LOG_CATEGORIES:
        SubElement(categories, "Category", name=name, description=text)
    experiment = SubElement(
        root,
        "DefaultExperiment",
        startTime="0",
        stopTime=number(kind.experiment.stop_time),
        stepSize=number(kind.experiment.step_size),
    )
    tolerance = next((v.start for v in variables if v.name == "tolerance"), None)
    if issubclass(kind, Plant) and tolerance is not None:
        experiment.set("tolerance", number(tolerance))
    listed = SubElement(root, "ModelVariables")
    for variable in variables:
        listed.append(_scalar_variable(variable))
    _structure(root, trace, variables)
    return _xml(root)


def _units(root: Element, variables: Sequence[Variable]) -> None:
    definitions = SubElement(root, "UnitDefinitions")
    reals = [v for v in variables if v.type == "Real"]
    for name in sorted({v.unit for v in reals}):
        unit = parse_unit(name)
        element = SubElement(definitions, "Unit", name=name)
        if unit.integral:
            base = SubElement(element, "BaseUnit")
            for symbol, exponent in zip(BASE_UNITS, unit.exponents, strict=True):
                if exponent:
                    base.set(symbol, str(int(exponent)))
            if unit.factor != 1.0:
                base.set("factor", number(unit.factor))
        for shown in sorted({v.display_unit for v in reals if v.unit == name and v.display_unit}):
            factor = unit.factor / parse_unit(shown).factor
            SubElement(element, "DisplayUnit", name=shown, factor=number(_clean(factor)))


def _clean(factor: float) -> float:
    """1000.0000000000001, the quotient of two decimal factors, as 1000.0."""
    return float(f"{factor:.15g}")


def _types(root: Element, variables: Sequence[Variable]) -> None:
    used = sorted({v.unit for v in variables if v.type == "Real" and v.unit in QUANTITIES}, key=QUANTITIES.__getitem__)
    choices = {v.choice.__name__: v.choice for v in variables if v.choice}
    if not used and not choices:
        return
    definitions = SubElement(root, "TypeDefinitions")
    for unit in used:
        simple = SubElement(definitions, "SimpleType", name=QUANTITIES[unit])
        SubElement(simple, "Real", quantity=QUANTITIES[unit], unit=unit)
    for name in sorted(choices):
        simple = SubElement(definitions, "SimpleType", name=name)
        items = SubElement(simple, "Enumeration")
        for item in choices[name]:
            SubElement(items, "Item", name=item.name, value=str(item.number), description=item.text)


def _scalar_variable(variable: Variable) -> Element:
    causality, variability, initial = {
        "fixed": ("parameter", "fixed", "exact"),
        "tunable": ("parameter", "tunable", "exact"),
        "input": ("input", "continuous" if variable.continuous else "discrete", None),
        "state": ("local", "continuous" if variable.continuous else "discrete", "calculated"),
        "output": ("output", "continuous" if variable.continuous else "discrete", "calculated"),
        "derivative": ("local", "continuous", "calculated"),
        "counter": ("local", "discrete", "calculated"),
    }[variable.role]
    element = Element(
        "ScalarVariable",
        name=variable.name,
        valueReference=str(variable.reference),
        description=variable.text,
        causality=causality,
        variability=variability,
    )
    if initial:
        element.set("initial", initial)
    value = SubElement(element, variable.type)
    starts = variable.role in ("fixed", "tunable", "input")
    if variable.type == "Real":
        _real_attributes(value, variable)
        if starts:
            value.set("start", number(variable.start))
    elif variable.type == "Boolean":
        if starts:
            value.set("start", "true" if variable.start else "false")
    else:
        if variable.choice:
            value.set("declaredType", variable.choice.__name__)
        for name, bound in (("min", variable.min), ("max", variable.max)):
            if math.isfinite(bound):
                value.set(name, str(int(bound)))
        if starts:
            value.set("start", str(int(variable.start)))
    return element


def _real_attributes(value: Element, variable: Variable) -> None:
    if variable.unit in QUANTITIES:
        value.set("declaredType", QUANTITIES[variable.unit])
        value.set("quantity", QUANTITIES[variable.unit])
    value.set("unit", variable.unit)
    if variable.display_unit:
        value.set("displayUnit", variable.display_unit)
    for name, bound in (("min", variable.min), ("max", variable.max)):
        if math.isfinite(bound):
            value.set(name, number(bound))
    if variable.nominal != 1.0:
        value.set("nominal", number(variable.nominal))
    if variable.state is not None:
        value.set("derivative", str(variable.state + 1))


def _structure(root: Element, trace: Trace, variables: Sequence[Variable]) -> None:
    def indices(role: str) -> list[int]:
        return [v.reference + 1 for v in variables if v.role == role]

    inputs, states, outputs, derivatives = map(indices, ("input", "state", "output", "derivative"))
    parameters = [v.reference + 1 for v in variables if v.role in ("fixed", "tunable")]
    continuous = states[: trace.n_continuous]

    def unknown(parent: Element, index: int, known: Iterable[int]) -> None:
        SubElement(parent, "Unknown", index=str(index), dependencies=" ".join(str(i) for i in sorted(known)))

    def known_states(rows: frozenset[int]) -> list[int]:
        return [continuous[i] for i in rows if i < trace.n_continuous]

    structure = SubElement(root, "ModelStructure")
    listed = SubElement(structure, "Outputs")
    for row, index in enumerate(outputs):
        used = [inputs[i] for i in trace.output_inputs[row]]
        unknown(listed, index, [*used, *known_states(trace.output_states[row])])
    if derivatives:
        listed = SubElement(structure, "Derivatives")
        for row, index in enumerate(derivatives):
            used = [inputs[i] for i in trace.derivative_inputs[row]]
            unknown(listed, index, [*used, *known_states(trace.derivative_states[row])])
    listed = SubElement(structure, "InitialUnknowns")
    groups = [("state", continuous), ("output", outputs), ("derivative", derivatives)]
    rows = [(index, f"{name}{row}") for name, group in groups for row, index in enumerate(group)]
    for index, key in sorted(rows):
        used = [parameters[i] for i in trace.initial_parameters[key]]
        unknown(listed, index, [*used, *(inputs[i] for i in trace.initial_inputs[key])])
    if not rows:
        structure.remove(listed)
    if not outputs:
        structure.remove(structure[0])


def build_description(kind: type[Component], sources: Sequence[str]) -> bytes:
    """sources/buildDescription.xml: how an importer compiles the sources (the schema of FMI 3.0, used since 2.0.4)."""
    root = Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = SubElement(root, "BuildConfiguration", modelIdentifier=kind.__name__)
    files = SubElement(configuration, "SourceFileSet", language="C99")
    for name in sources:
        SubElement(files, "SourceFile", name=name)
    return _xml(root)
