"""Systems as SSP 1.0 (System Structure and Parameterization): what other tools read, with the FMUs inside.

``write_ssp`` packs a checked system; ``read_ssp`` gives the document of an .ssp or .ssd for ``make_system``. What SSP
has no word for (communication step size, order, step multiples, record) stands in annotations of type
``motion-cosim``; readers that do not know them use the rest.
"""

from __future__ import annotations

import hashlib
import importlib
import io
import json
import os
import re
import tempfile
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from decimal import Decimal, InvalidOperation
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any, cast
from urllib.parse import quote, unquote, urlsplit
from xml.etree import ElementTree

import fmpy.ssp

from .errors import DescriptionError, suggest
from .fmu import Fmu, Value, Variable, checked_members
from .units import BASE_UNITS, conversion, same_unit
from .xmlfile import document, parse

if TYPE_CHECKING:
    from .system import System

ANNOTATION = "motion-cosim"
NAMESPACES = {
    "ssd": "http://ssp-standard.org/SSP1/SystemStructureDescription",
    "ssc": "http://ssp-standard.org/SSP1/SystemStructureCommon",
    "ssv": "http://ssp-standard.org/SSP1/SystemStructureParameterValues",
    "cosim": "urn:motion-cosim:ssp:1",
    "osp": "http://opensimulationplatform.com/SSP/OSPAnnotations",
    "oms": "https://raw.githubusercontent.com/OpenModelica/OMSimulator/master/schema/oms.xsd",
}
PARAMETER_SET = "start"
"""Name of every parameter set: some importers apply only those of a name they are told."""
GENERATION_DATE = "2026-01-01T00:00:00Z"
"""Fixed, so that equal systems give equal bytes."""

_lxml: Any = importlib.import_module("lxml.etree")
_schemas = Path(fmpy.ssp.__file__).parent / "schema"
_unpacked: dict[str, tempfile.TemporaryDirectory[str]] = {}


def _tag(name: str) -> str:
    prefix, _, local = name.partition(":")
    return f"{{{NAMESPACES[prefix]}}}{local}"


# ---- writing ----


def write_ssp(system: System, target: str | Path) -> Path:
    """Write a system as .ssp, its FMUs in resources/. Equal systems give equal bytes. Raises DescriptionError."""
    target = Path(target)
    files = _resource_names(system)
    description = structure(system, {path: f"resources/{name}" for path, name in files.items()})
    partial = target.with_name(f"{target.name}.{os.getpid()}.part")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with zipfile.ZipFile(partial, "w") as archive:
            _add(archive, "SystemStructure.ssd", description, zipfile.ZIP_DEFLATED)
            for path, name in sorted(files.items(), key=lambda item: item[1]):
                _add(archive, f"resources/{name}", path.read_bytes(), zipfile.ZIP_STORED)
        partial.replace(target)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise DescriptionError(f"{target}: cannot be written ({error.strerror}).") from None
    return target


def _add(archive: zipfile.ZipFile, name: str, content: bytes, method: int) -> None:
    entry = zipfile.ZipInfo(name, (2026, 1, 1, 0, 0, 0))
    entry.create_system = 3
    entry.external_attr = 0o644 << 16
    entry.compress_type = method
    archive.writestr(entry, content)


def _resource_names(system: System) -> dict[Path, str]:
    """A file name for each FMU of the system; different FMUs of one name are told apart by a number."""
    names: dict[Path, str] = {}
    taken: set[str] = set()
    for instance in system.instances:
        path = instance.fmu.path
        if path in names:
            continue
        name, number = path.name, 1
        while name.lower() in taken:
            number += 1
            name = f"{path.stem}_{number}.fmu"
        taken.add(name.lower())
        names[path] = name
    return names


def structure(system: System, sources: Mapping[Path, str]) -> bytes:
    """SystemStructure.ssd of a system; ``sources`` gives the URI of each FMU file relative to it."""
    for prefix, uri in NAMESPACES.items():
        ElementTree.register_namespace(prefix, uri)
    root = ElementTree.Element(
        _tag("ssd:SystemStructureDescription"),
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
        fmu = instance.fmu
        component = _sub(
            elements,
            "ssd:Component",
            name=instance.name,
            type="application/x-fmu-sharedlibrary",
            source=quote(sources[fmu.path]),
            implementation="CoSimulation",
        )
        if fmu.text:
            component.set("description", fmu.text)
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
            _sub(hint, "osp:StepSizeHint", value=str(system.step_size * instance.step_multiple))
    connections = _sub(top, "ssd:Connections")
    for connection in system.connections:
        element = _sub(
            connections,
            "ssd:Connection",
            startElement=connection.source[0],
            startConnector=connection.source[1],
            endElement=connection.target[0],
            endConnector=connection.target[1],
        )
        if connection.factor != 1.0 or connection.offset != 0.0:
            element.set("suppressUnitConversion", "true")
            factor, offset = repr(connection.factor), repr(connection.offset)
            _sub(element, "ssc:LinearTransformation", factor=factor, offset=offset)
    if not system.connections:
        top.remove(connections)
    # OMSimulator reads no system that does not name its master, and takes a tolerance left out as 0.
    holder = _sub(_sub(_sub(top, "ssd:Annotations"), "ssc:Annotation", type="org.openmodelica"), "oms:Annotations")
    tolerance = "1e-8" if system.tolerance is None else repr(system.tolerance)
    master = {"description": "oms-ma", "stepSize": str(system.step_size), "relativeTolerance": tolerance}
    _sub(_sub(holder, "oms:SimulationInformation"), "oms:FixedStepMaster", **master)
    _units(root, "ssd:Units", units)
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
    return document(root)


def parameter_set(fmu: Fmu, start: Mapping[str, Value]) -> ElementTree.Element:
    """An SSV ParameterSet. Enumerations are written as Integer, the form that all importers read."""
    root = ElementTree.Element(_tag("ssv:ParameterSet"), {"version": "1.0", "name": PARAMETER_SET})
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


def _sub(parent: ElementTree.Element, tag: str, **attributes: str) -> ElementTree.Element:
    return ElementTree.SubElement(parent, _tag(tag), attributes)


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
        factor, offset, *exponents = units[name].base_units[name]
        base = _sub(_sub(definitions, "ssc:Unit", name=name), "ssc:BaseUnit")
        for symbol, exponent in zip(BASE_UNITS, exponents, strict=True):
            if exponent:
                base.set(symbol, str(int(exponent)))
        if factor != 1.0:
            base.set("factor", repr(factor))
        if offset != 0.0:
            base.set("offset", repr(offset))


# ---- reading ----


def read_ssp(path: str | Path) -> tuple[dict[str, Any], Path]:
    """The document of an .ssp or .ssd, as a system file holds it, and the folder its paths start from.

    An .ssp is unpacked into a temporary folder that lasts as long as the process.
    Raises DescriptionError with every problem found.
    """
    path = Path(path)
    try:
        if path.suffix.lower() == ".ssd":
            content, folder = path.read_bytes(), path.parent
        else:
            content, folder = _unpack(path)
    except FileNotFoundError:
        raise DescriptionError(f"{path}: no such file.") from None
    except OSError as error:
        raise DescriptionError(f"{path}: cannot be read ({error.strerror}).") from None
    return _Reader(path.name, folder, content).document(), folder


def _unpack(path: Path) -> tuple[bytes, Path]:
    packed = path.read_bytes()
    digest = hashlib.sha256(packed).hexdigest()
    if digest not in _unpacked:
        holder = tempfile.TemporaryDirectory(prefix="cosim-ssp-")
        try:
            with zipfile.ZipFile(io.BytesIO(packed)) as archive:
                archive.filename = path.name
                for member in checked_members(archive):
                    archive.extract(member, holder.name)
        except (zipfile.BadZipFile, RuntimeError, NotImplementedError, EOFError) as error:
            holder.cleanup()
            raise DescriptionError(f"{path.name}: not a readable zip archive ({error}).") from None
        except DescriptionError:
            holder.cleanup()
            raise
        _unpacked[digest] = holder
    folder = Path(_unpacked[digest].name)
    description = folder / "SystemStructure.ssd"
    if not description.is_file():
        raise DescriptionError(f"{path.name}: no SystemStructure.ssd inside. This is not an SSP file.")
    return description.read_bytes(), folder


def validate(content: bytes, schema: str = "SystemStructureDescription") -> list[str]:
    """What is wrong with an SSP 1.0 document by its XML schema; line numbers included."""
    try:
        document = parse(content)
    except _lxml.XMLSyntaxError as error:
        return [f"not valid XML: {error}"]
    validator = _lxml.XMLSchema(_lxml.parse(str(_schemas / f"{schema}.xsd")))
    if validator.validate(document):
        return []
    return [f"line {entry.line}: {entry.message}" for entry in validator.error_log]


class _Reader:
    """Turns an SSD into the document of a system, collecting problems."""

    def __init__(self, name: str, folder: Path, content: bytes) -> None:
        self.name = name
        self.folder = folder
        self.problems: list[str] = []
        problems = validate(content)
        if problems:
            raise DescriptionError([f"{name}: SystemStructure.ssd, {problem}" for problem in problems])
        self.root = parse(content)
        self.kinds: dict[tuple[str, str], tuple[str, str | None]] = {}
        """Kind and unit of each connector."""

    def problem(self, text: str) -> None:
        self.problems.append(f"{self.name}: {text}")

    def document(self) -> dict[str, Any]:
        top = self.root.find(_tag("ssd:System"))
        instances: dict[str, Any] = {}
        elements = top.find(_tag("ssd:Elements"))
        for element in elements if elements is not None else ():
            if element.tag == _tag("ssd:Component"):
                instances[element.get("name")] = self.instance(element)
            else:
                kind = str(element.tag).rpartition("}")[2]
                self.problem(
                    f"element '{element.get('name')}' is a {kind}. Only components (FMUs) are read: flatten it."
                )
        for connector in top.findall(f"{_tag('ssd:Connectors')}/{_tag('ssd:Connector')}"):
            if connector.get("kind") == "input":
                self.problem(f"the system has an input '{connector.get('name')}'. Connect a source inside it.")
        self.bindings(top, {f"{name}.": table["start"] for name, table in instances.items()}, top.get("name") or "")
        document: dict[str, Any] = {
            "instances": instances,
            "connections": [found for element in self.connections(top) if (found := self.connection(element))],
            "experiment": self.experiment(),
        }
        description = self.root.get("description") or top.get("description")
        if description:
            document["description"] = description
        own = self.own(self.root.find(_tag("ssd:DefaultExperiment")), "cosim:Experiment")
        record = None if own is None else own.find(_tag("cosim:Record"))
        if record is not None:
            names = [element.get("name") for element in record.findall(_tag("cosim:Variable"))]
            document["record"] = {"variables": names, "decimation": int(record.get("decimation", "1"))}
        if self.problems:
            raise DescriptionError(self.problems)
        return document

    def instance(self, element: Any) -> dict[str, Any]:
        name = element.get("name")
        if element.get("type", "application/x-fmu-sharedlibrary") != "application/x-fmu-sharedlibrary":
            self.problem(f"component '{name}' is of type {element.get('type')}. Only FMUs are read.")
        if element.get("implementation", "any") == "ModelExchange":
            self.problem(f"component '{name}' is to run as ModelExchange. Only co-simulation is offered.")
        for connector in element.findall(f"{_tag('ssd:Connectors')}/{_tag('ssd:Connector')}"):
            unit = next((child.get("unit") for child in connector if child.tag == _tag("ssc:Real")), None)
            self.kinds[name, connector.get("name")] = (connector.get("kind"), unit)
        start: dict[str, Any] = {}
        self.bindings(element, {"": start}, name)
        table: dict[str, Any] = {"fmu": self.source(name, element.get("source")), "start": start}
        own = self.own(element, "cosim:Instance")
        if own is not None and own.get("stepMultiple"):
            table["step_multiple"] = int(own.get("stepMultiple"))
        return table

    def source(self, name: str, uri: str) -> str:
        """The path of a component's FMU relative to the SSD, which may not leave its folder in an .ssp."""
        parts = urlsplit(uri)
        path = PurePosixPath(unquote(parts.path))
        if parts.scheme or parts.netloc or parts.fragment or path.is_absolute() or ".." in path.parts:
            self.problem(f"component '{name}': source '{uri}' is not a path inside the package.")
        return f"./{path}"

    def own(self, parent: Any, tag: str) -> Any:
        """Our annotation in an element, or None."""
        if parent is None:
            return None
        place = f"{_tag('ssd:Annotations')}/{_tag('ssc:Annotation')}"
        for annotation in parent.findall(place):
            if annotation.get("type") == ANNOTATION:
                return annotation.find(_tag(tag))
        return None

    # Parameters

    def bindings(self, element: Any, targets: Mapping[str, dict[str, Any]], where: str) -> None:
        """Enter the values of the parameter bindings of an element; of a name's prefixes the target's is taken off."""
        for binding in element.findall(f"{_tag('ssd:ParameterBindings')}/{_tag('ssd:ParameterBinding')}"):
            if binding.find(_tag("ssd:ParameterMapping")) is not None:
                self.problem(f"'{where}': a parameter mapping is not read. Name the parameters as the FMUs do.")
                continue
            found = self.values(binding, where)
            prefix = binding.get("prefix", "")
            for name, value in found:
                target = next((t for t in targets if f"{prefix}{name}".startswith(t)), None)
                if target is None:
                    known = [t.rstrip(".") for t in targets]
                    self.problem(f"'{where}': no component for parameter '{prefix}{name}'.{suggest(name, known)}")
                else:
                    targets[target][f"{prefix}{name}"[len(target) :]] = value

    def values(self, binding: Any, where: str) -> Iterator[tuple[str, object]]:
        source = binding.get("source")
        if source:
            relative = self.source(where, source)
            try:
                content = (self.folder / relative).read_bytes()
            except OSError as error:
                self.problem(f"'{where}': parameter values '{source}' cannot be read ({error.strerror}).")
                return
        else:
            inline = binding.find(f"{_tag('ssd:ParameterValues')}/{_tag('ssv:ParameterSet')}")
            if inline is None:
                return
            content = _lxml.tostring(inline)
        problems = validate(content, "SystemStructureParameterValues")
        if problems:
            self.problems += [f"{self.name}: parameter values of '{where}', {problem}" for problem in problems]
            return
        for parameter in parse(content).findall(f"{_tag('ssv:Parameters')}/{_tag('ssv:Parameter')}"):
            typed = next(iter(parameter), None)
            if typed is not None:
                yield parameter.get("name"), self.value(str(typed.tag).rpartition("}")[2], typed.get("value"))

    @staticmethod
    def value(kind: str, text: str) -> object:
        if kind == "Boolean":
            return text.strip() in ("true", "1")
        if kind == "Integer":
            return int(text)
        if kind == "Real":
            try:
                return Decimal(text.strip())
            except InvalidOperation:  # INF and NaN of XML Schema; the system says what is wrong with them
                return float(text.strip())
        return text

    # Connections

    def connections(self, top: Any) -> Iterable[Any]:
        return top.findall(f"{_tag('ssd:Connections')}/{_tag('ssd:Connection')}")

    def connection(self, element: Any) -> dict[str, Any] | str | None:
        ends = [(element.get(f"{side}Element"), element.get(f"{side}Connector")) for side in ("start", "end")]
        said = " -> ".join(".".join(part or "" for part in end) for end in ends)
        if any(part is None for end in ends for part in end):
            own = "output" if ends[1][0] is None else "input"
            if own == "output":
                return None  # an output of the whole system: every output is recorded anyway
            self.problem(f"connection {said}: ends at a connector of the system. Connect components with each other.")
            return None
        if self.kinds.get(ends[0], ("",))[0] == "input":
            ends.reverse()  # SSP lets a connection be written from either side
            if element.find(_tag("ssc:LinearTransformation")) is not None:
                self.problem(f"connection {said}: starts at an input and transforms. Write it from the output.")
                return None
        factor, offset = Decimal(1), Decimal(0)
        for child in element:
            kind = str(child.tag).rpartition("}")[2]
            if kind == "LinearTransformation":
                factor, offset = Decimal(child.get("factor", "1")), Decimal(child.get("offset", "0"))
            elif kind.endswith("Transformation"):
                self.problem(f"connection {said}: a {kind} is not read, only LinearTransformation.")
        units = [self.kinds.get(end, ("", None))[1] for end in ends]
        if element.get("suppressUnitConversion") not in ("true", "1") and units[0] and units[1]:
            factor = self.converted(said, factor, units[0], units[1])
        source, target = (f"{name}.{variable}" for name, variable in ends)
        if factor == 1 and offset == 0:
            return f"{source} -> {target}"
        return {"from": source, "to": target, "factor": factor, "offset": offset}

    def converted(self, said: str, factor: Decimal, unit: str, other: str) -> Decimal:
        """``factor`` with the conversion that SSP prescribes between different units."""
        try:
            if unit == other or same_unit(unit, other):
                return factor
            return factor * Decimal(repr(conversion(unit, other)))
        except DescriptionError as error:
            self.problem(f"connection {said}: {error}")
            return factor

    # Experiment

    def experiment(self) -> dict[str, Any]:
        element = self.root.find(_tag("ssd:DefaultExperiment"))
        if element is None:
            return {}
        table: dict[str, Any] = {}
        for attribute, key in (("startTime", "start_time"), ("stopTime", "stop_time")):
            if element.get(attribute) is not None:
                table[key] = self.value("Real", element.get(attribute))
        own = self.own(element, "cosim:Experiment")
        if own is not None:
            for attribute, key in (("stepSize", "step_size"), ("tolerance", "tolerance")):
                if own.get(attribute) is not None:
                    table[key] = self.value("Real", own.get(attribute))
            order = own.get("order", "sequential")
            table["order"] = order if order in ("sequential", "parallel") else order.split()
        else:
            other = element.find(f".//{_tag('osp:FixedStepAlgorithm')}")
            if other is not None and other.get("baseStepSize"):
                table["step_size"] = self.value("Real", other.get("baseStepSize"))
        return table


# ---- TOML ----


def write_toml(system: System, target: str | Path) -> Path:
    """Write a system as a TOML file, its FMUs into the folder STEM_fmus beside it. Raises DescriptionError."""
    target = Path(target)
    names = _resource_names(system)
    folder = target.with_name(f"{target.stem}_fmus")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for path, name in names.items():
            (folder / name).write_bytes(path.read_bytes())
        target.write_text(toml(system, {path: f"{folder.name}/{name}" for path, name in names.items()}), "utf-8")
    except OSError as error:
        raise DescriptionError(f"{target}: cannot be written ({error.strerror}).") from None
    return target


def toml(system: System, sources: Mapping[Path, str]) -> str:
    """A system as the text of a system file; ``sources`` gives the path of each FMU relative to it."""
    lines: list[str] = []
    if system.description:
        lines.append(f"description = {_text(system.description)}")
    lines.append("connections = [")
    for connection in system.connections:
        if connection.factor == 1.0 and connection.offset == 0.0:
            lines.append(f"    {_text(str(connection))},")
        else:
            source, target = ".".join(connection.source), ".".join(connection.target)
            lines.append(
                f"    {{ from = {_text(source)}, to = {_text(target)}, factor = {connection.factor!r}, "
                f"offset = {connection.offset!r} }},"
            )
    lines += ["]", "", "[experiment]"]
    lines += [f"{key} = {_decimal(getattr(system, key))}" for key in ("start_time", "stop_time", "step_size")]
    lines.append(f"order = {_value(system.order if isinstance(system.order, str) else list(system.order))}")
    if system.tolerance is not None:
        lines.append(f"tolerance = {system.tolerance!r}")
    for instance in system.instances:
        lines += ["", f"[instances.{instance.name}]", f"fmu = {_text(sources[instance.fmu.path])}"]
        if instance.step_multiple != 1:
            lines.append(f"step_multiple = {instance.step_multiple}")
        if instance.start:
            lines += ["", f"[instances.{instance.name}.start]"]
            lines += [f"{_key(name)} = {_value(value)}" for name, value in _gathered(instance.fmu, instance.start)]
    lines += ["", "[record]", f"decimation = {system.decimation}", "variables = ["]
    lines += [f"    {_text('.'.join(entry))}," for entry in system.record]
    return "\n".join([*lines, "]", ""])


def _gathered(fmu: Fmu, start: Mapping[str, Value]) -> Iterator[tuple[str, object]]:
    """Start values with complete arrays gathered and enumerations by name."""
    whole = {e: array for array, elements in fmu.arrays.items() if all(e in start for e in elements) for e in elements}
    done: set[str] = set()
    for name, value in start.items():
        array = whole.get(name)
        if array is None:
            items = {number: item for item, number in fmu.variables[name].items.items()}
            yield name, items.get(cast(int, value), value) if items else value
        elif array not in done:
            done.add(array)
            yield array, [start[element] for element in fmu.arrays[array]]


def _text(text: str) -> str:
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else _text(name)


def _decimal(number: Decimal) -> str:
    text = str(number)
    return text if re.search(r"[.eE]", text) else f"{text}.0"


def _value(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return _text(value)
    if isinstance(value, list):
        return f"[{', '.join(_value(item) for item in cast('list[object]', value))}]"
    return repr(value)
