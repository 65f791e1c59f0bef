"""modelDescription.xml and buildDescription.xml of an FMU."""

from __future__ import annotations

import inspect
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from xml.etree.ElementTree import Element, SubElement

from ..fmu.xml import document
from ..model import Choice, Component, Plant
from ..units import BASE_UNITS, parse_unit
from .contract import Fmi, categories
from .interface import InterfaceVariable, variables_of
from .source_files import is_of_library
from .trace import Trace

GENERATION_DATE = "2026-01-01T00:00:00Z"
"""A fixed date, so that equal sources give equal bytes."""

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


def description_root(kind: type[Component], version: str, **own: str) -> Element:
    """The root of a modelDescription.xml; ``own`` holds the attributes that differ between versions of FMI."""
    return Element(
        "fmiModelDescription",
        own,
        modelName=kind.__name__,
        description=summary(kind),
        **({"version": version, "author": "The motion-cosim authors", "license": "MIT"} if is_of_library(kind) else {}),
        generationTool=f"motion-cosim {version}",
        generationDateAndTime=GENERATION_DATE,
        variableNamingConvention="structured",
    )


def model_description(trace: Trace, guid: str, version: str, *, sources: Sequence[str], native: bool = True) -> bytes:
    """modelDescription.xml of the native flavour, or of the Python one (``native=False``)."""
    kind, variables = trace.kind, variables_of(trace.kind)
    root = description_root(kind, version, fmiVersion="2.0", guid=guid)
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
            canNotUseMemoryManagementFunctions="true",
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
        canNotUseMemoryManagementFunctions="true",
        canGetAndSetFMUstate="true",
        canSerializeFMUstate="true",
        providesDirectionalDerivative="true" if native else "false",
    )
    for element in (exchange, simulation) if sources else ():
        if element is not None:
            files = SubElement(element, "SourceFiles")
            for name in sources:
                SubElement(files, "File", name=name)
    add_units(root, variables)
    _types(root, variables)
    add_experiment(root, kind, variables, 2)
    listed = SubElement(root, "ModelVariables")
    for variable in variables:
        listed.append(_scalar_variable(variable))
    _structure(root, trace)
    return document(root)


def add_experiment(root: Element, kind: type[Component], variables: Sequence[InterfaceVariable], fmi: Fmi) -> None:
    """Add LogCategories and DefaultExperiment, which have the same form in FMI 2.0 and 3.0."""
    listed = SubElement(root, "LogCategories")
    for name, text in categories(fmi).items():
        SubElement(listed, "Category", name=name, description=text)
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


def add_units(root: Element, variables: Sequence[InterfaceVariable]) -> None:
    """Add UnitDefinitions, which are the same in FMI 2.0 and 3.0."""
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
    """The factor without rounding errors: a quotient of two decimal factors, 1000.0000000000001, becomes 1000.0."""
    return float(f"{factor:.15g}")


def used_types(variables: Sequence[InterfaceVariable]) -> tuple[list[str], list[type[Choice]]]:
    """The units that make a type of their quantity, and the enumerations, each in the order of TypeDefinitions."""
    units = sorted({v.unit for v in variables if v.type == "Real" and v.unit in QUANTITIES}, key=QUANTITIES.__getitem__)
    choices = {v.choice.__name__: v.choice for v in variables if v.choice}
    return units, [choices[name] for name in sorted(choices)]


def _types(root: Element, variables: Sequence[InterfaceVariable]) -> None:
    units, choices = used_types(variables)
    if not units and not choices:
        return
    definitions = SubElement(root, "TypeDefinitions")
    for unit in units:
        simple = SubElement(definitions, "SimpleType", name=QUANTITIES[unit])
        SubElement(simple, "Real", quantity=QUANTITIES[unit], unit=unit)
    for choice in choices:
        simple = SubElement(definitions, "SimpleType", name=choice.__name__)
        add_items(SubElement(simple, "Enumeration"), choice)


def add_items(parent: Element, choice: type[Choice]) -> None:
    """Add the items of an enumeration."""
    for item in choice:
        SubElement(parent, "Item", name=item.name, value=str(item.number), description=item.description)


def _classes(variable: InterfaceVariable) -> tuple[str, str, str | None]:
    """Causality, variability and ``initial`` of a variable."""
    return {
        "fixed": ("parameter", "fixed", "exact"),
        "tunable": ("parameter", "tunable", "exact"),
        "input": ("input", "continuous" if variable.continuous else "discrete", None),
        "state": ("local", "continuous" if variable.continuous else "discrete", "calculated"),
        "output": ("output", "continuous" if variable.continuous else "discrete", "calculated"),
        "derivative": ("local", "continuous", "calculated"),
        "counter": ("local", "discrete", "calculated"),
        "independent": ("independent", "continuous", None),
    }[variable.role]


def variable_element(tag: str, name: str, variable: InterfaceVariable) -> Element:
    """An element with the attributes that all variables have, in FMI 2.0 and 3.0."""
    causality, variability, initial = _classes(variable)
    element = Element(
        tag,
        name=name,
        valueReference=str(variable.reference),
        description=variable.description,
        causality=causality,
        variability=variability,
    )
    if initial:
        element.set("initial", initial)
    return element


def _scalar_variable(variable: InterfaceVariable) -> Element:
    element = variable_element("ScalarVariable", variable.name, variable)
    value = SubElement(element, variable.type)
    starts = variable.role in ("fixed", "tunable", "input")
    if variable.type == "Real":
        set_real_attributes(value, variable)
        if variable.state is not None:
            value.set("derivative", str(variable.state + 1))
        if starts:
            value.set("start", number(variable.start))
    elif variable.type == "Boolean":
        if starts:
            value.set("start", "true" if variable.start else "false")
    else:
        if variable.choice:
            value.set("declaredType", variable.choice.__name__)
        set_whole_bounds(value, variable)
        if starts:
            value.set("start", str(int(variable.start)))
    return element


def set_whole_bounds(value: Element, variable: InterfaceVariable) -> None:
    """Set the bounds of a whole number as attributes."""
    for name, bound in (("min", variable.min), ("max", variable.max)):
        if math.isfinite(bound):
            value.set(name, str(int(bound)))


def set_real_attributes(value: Element, variable: InterfaceVariable) -> None:
    """Set type, unit, bounds and nominal of a Real (Float64 in FMI 3.0) as attributes."""
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


@dataclass(frozen=True)
class Dependencies:
    """The unknowns of ModelStructure and the variables that each depends on, as value references."""

    outputs: Mapping[int, Sequence[int]]
    derivatives: Mapping[int, Sequence[int]]
    initial: Mapping[int, Sequence[int]]


def dependencies(trace: Trace) -> Dependencies:
    """The dependencies that the trace has found, in ascending order of value references."""
    variables = variables_of(trace.kind)

    def references(*roles: str) -> list[int]:
        return [v.reference for v in variables if v.role in roles]

    inputs, states, outputs = references("input"), references("state"), references("output")
    derivatives, parameters = references("derivative"), references("fixed", "tunable")
    continuous = states[: trace.n_continuous]

    def known(used: frozenset[int], rows: frozenset[int]) -> list[int]:
        return sorted([*(inputs[i] for i in used), *(continuous[i] for i in rows if i < trace.n_continuous)])

    initial: dict[int, list[int]] = {}
    for name, group in (("state", continuous), ("output", outputs), ("derivative", derivatives)):
        for row, reference in enumerate(group):
            needed, used = trace.initial_parameters[f"{name}{row}"], trace.initial_inputs[f"{name}{row}"]
            initial[reference] = sorted([*(parameters[i] for i in needed), *(inputs[i] for i in used)])
    return Dependencies(
        {r: known(trace.output_inputs[row], trace.output_states[row]) for row, r in enumerate(outputs)},
        {r: known(trace.derivative_inputs[row], trace.derivative_states[row]) for row, r in enumerate(derivatives)},
        dict(sorted(initial.items())),
    )


def _structure(root: Element, trace: Trace) -> None:
    structure, found = SubElement(root, "ModelStructure"), dependencies(trace)
    groups = (("Outputs", found.outputs), ("Derivatives", found.derivatives), ("InitialUnknowns", found.initial))
    for name, unknowns in groups:
        if not unknowns:
            continue
        listed = SubElement(structure, name)
        for reference, known in unknowns.items():
            indices = " ".join(str(r + 1) for r in known)
            SubElement(listed, "Unknown", index=str(reference + 1), dependencies=indices)


def build_description(kind: type[Component], sources: Sequence[str]) -> bytes:
    """sources/buildDescription.xml: how an importer compiles the sources (the schema of FMI 3.0, used since 2.0.4)."""
    root = Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = SubElement(root, "BuildConfiguration", modelIdentifier=kind.__name__)
    files = SubElement(configuration, "SourceFileSet", language="C99")
    for name in sources:
        SubElement(files, "SourceFile", name=name)
    return document(root)
