"""Reads SSP packages and SSD files as the document of a system file."""

from __future__ import annotations

import atexit
import contextlib
import hashlib
import io
import json
import zipfile
from collections.abc import Iterable, Mapping
from decimal import Decimal, InvalidOperation
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import quote, unquote, urlsplit

import fmpy.ssp

from ..errors import DescriptionError, suggest
from ..files import temporary_folder
from ..fmu.archive import unpack
from ..fmu.description import read_fmu
from ..fmu.xml import parse
from ..units import Unit
from .connections import converted
from .parts import Connection
from .ssp_names import ANNOTATION, lxml_etree, tag
from .ssp_units import ConnectorUnits, converted_value, defined_units

_schemas = Path(fmpy.ssp.__file__).parent / "schema"


_unpacked: dict[str, Path] = {}


_folders = contextlib.ExitStack()
"""Folders of unpacked packages, which last as long as the process."""
atexit.register(_folders.close)


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
    return SspReader(path.name, folder, content).document(), folder


def _unpack(path: Path) -> tuple[bytes, Path]:
    packed = path.read_bytes()
    digest = hashlib.sha256(packed).hexdigest()
    if digest not in _unpacked:
        with contextlib.ExitStack() as resources:
            folder = resources.enter_context(temporary_folder())
            try:
                with zipfile.ZipFile(io.BytesIO(packed)) as archive:
                    archive.filename = path.name
                    unpack(archive, folder)
            except (zipfile.BadZipFile, RuntimeError, NotImplementedError, EOFError) as error:
                raise DescriptionError(f"{path.name}: not a readable zip archive ({error}).") from None
            _unpacked[digest] = folder
            _folders.push(resources.pop_all())
    folder = _unpacked[digest]
    description = folder / "SystemStructure.ssd"
    if not description.is_file():
        raise DescriptionError(f"{path.name}: no SystemStructure.ssd inside. This is not an SSP file.")
    return description.read_bytes(), folder


def validate(content: bytes, schema: str = "SystemStructureDescription") -> list[str]:
    """What is wrong with an SSP 1.0 document by its XML schema; line numbers included."""
    try:
        document = parse(content)
    except lxml_etree.XMLSyntaxError as error:
        return [f"not valid XML: {error}"]
    validator = lxml_etree.XMLSchema(lxml_etree.parse(str(_schemas / f"{schema}.xsd")))
    if validator.validate(document):
        return []
    return [f"line {entry.line}: {entry.message}" for entry in validator.error_log]


class SspReader:
    """Turns an SSD into the document of a system, collecting problems."""

    def __init__(self, name: str, folder: Path, content: bytes) -> None:
        self.name = name
        self.folder = folder
        self.problems: list[str] = []
        problems = validate(content)
        if problems:
            raise DescriptionError([f"{name}: SystemStructure.ssd, {problem}" for problem in problems])
        self.root = parse(content)
        self.kinds: dict[tuple[str, str], str] = {}
        """Kind of each connector."""
        self.units = ConnectorUnits(defined_units(self.root, "ssd:Units"))

    def problem(self, text: str) -> None:
        self.problems.append(f"{self.name}: {text}")

    def document(self) -> dict[str, Any]:
        top = self.root.find(tag("ssd:System"))
        instances: dict[str, Any] = {}
        elements = top.find(tag("ssd:Elements"))
        for element in elements if elements is not None else ():
            if element.tag == tag("ssd:Component"):
                instances[element.get("name")] = self.instance(element)
            else:
                kind = str(element.tag).rpartition("}")[2]
                self.problem(
                    f"element '{element.get('name')}' is a {kind}. Only components (FMUs) are read: flatten it."
                )
        for connector in top.findall(f"{tag('ssd:Connectors')}/{tag('ssd:Connector')}"):
            if connector.get("kind") == "input":
                self.problem(f"the system has an input '{connector.get('name')}'. Connect a source inside it.")
        starts = {f"{name}.": (name, table["start"]) for name, table in instances.items()}
        self.bindings(top, starts, top.get("name") or "")
        document: dict[str, Any] = {
            "instances": instances,
            "connections": [found for element in self.connections(top) if (found := self.connection(element))],
            "experiment": self.experiment(),
        }
        description = self.root.get("description") or top.get("description")
        if description:
            document["description"] = description
        own = self.own(self.root.find(tag("ssd:DefaultExperiment")), "cosim:Experiment")
        record = None if own is None else own.find(tag("cosim:Record"))
        if record is not None:
            names = [element.get("name") for element in record.findall(tag("cosim:Variable"))]
            document["record"] = {"variables": names, "decimation": int(record.get("decimation", "1"))}
        if own is not None:
            self.more(own.find(tag("cosim:Document")), document)
        if self.problems:
            raise DescriptionError(self.problems)
        return document

    def more(self, element: Any, document: dict[str, Any]) -> None:
        """Enter what SSP has no word for: records, and the connections of inputs that get a record, a sum or noise."""
        if element is None:
            return
        try:
            more = json.loads(element.text or "", parse_float=Decimal)
            connections, signals = list(more["connections"]), dict(more["signals"])
        except (ValueError, TypeError, KeyError):
            self.problem("the annotation of signals cannot be read. Export the system again.")
            return
        for name, table in signals.items():
            table["file"] = self.source(f"signals.{name}", quote(str(table.get("file", ""))))
        if signals:
            document["signals"] = signals
        targets = {c.split("->")[1].strip() if isinstance(c, str) else c.get("to") for c in connections}
        document["connections"] = [c for c in document["connections"] if c["to"] not in targets] + connections

    def instance(self, element: Any) -> dict[str, Any]:
        name = element.get("name")
        if element.get("type", "application/x-fmu-sharedlibrary") != "application/x-fmu-sharedlibrary":
            self.problem(f"component '{name}' is of type {element.get('type')}. Only FMUs are read.")
        if element.get("implementation", "any") == "ModelExchange":
            self.problem(f"component '{name}' is to run as ModelExchange. Only co-simulation is offered.")
        for connector in element.findall(f"{tag('ssd:Connectors')}/{tag('ssd:Connector')}"):
            end = name, connector.get("name")
            unit = next((child.get("unit") for child in connector if child.tag == tag("ssc:Real")), None)
            self.kinds[end] = connector.get("kind")
            if unit:
                self.units.stated[end] = unit
        source = self.source(name, element.get("source"))
        with contextlib.suppress(DescriptionError):  # whoever checks the system says what is wrong with an FMU
            self.units.fmus[name] = read_fmu(self.folder / source)
        start: dict[str, Any] = {}
        self.bindings(element, {"": (name, start)}, name)
        table: dict[str, Any] = {"fmu": source, "start": start}
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

    def own(self, parent: Any, element: str) -> Any:
        """Our annotation in an element, or None."""
        if parent is None:
            return None
        place = f"{tag('ssd:Annotations')}/{tag('ssc:Annotation')}"
        for annotation in parent.findall(place):
            if annotation.get("type") == ANNOTATION:
                return annotation.find(tag(element))
        return None

    # Parameters

    def bindings(self, element: Any, targets: Mapping[str, tuple[str, dict[str, Any]]], where: str) -> None:
        """Enter the values of the parameter bindings of an element.

        ``targets`` gives the component and its start values for each beginning of a name, which is taken off.
        """
        for binding in element.findall(f"{tag('ssd:ParameterBindings')}/{tag('ssd:ParameterBinding')}"):
            if binding.find(tag("ssd:ParameterMapping")) is not None:
                self.problem(f"'{where}': a parameter mapping is not read. Name the parameters as the FMUs do.")
                continue
            prefix = binding.get("prefix", "")
            parameters, own = self.parameters(binding, where)
            for parameter, typed in parameters:
                name = f"{prefix}{parameter}"
                target = next((t for t in targets if name.startswith(t)), None)
                if target is None:
                    known = [t.rstrip(".") for t in targets]
                    self.problem(f"'{where}': no component for parameter '{name}'.{suggest(parameter, known)}")
                    continue
                component, start = targets[target]
                variable = name[len(target) :]
                value = self.value(str(typed.tag).rpartition("}")[2], typed.get("value"))
                start[variable] = self.in_unit_of(component, variable, value, typed.get("unit"), own)

    def in_unit_of(self, component: str, name: str, value: object, unit: str | None, own: Mapping[str, Unit]) -> object:
        """A parameter's value in the unit of its variable."""
        wanted = self.units.own((component, name))
        if unit is None or wanted is None or not isinstance(value, Decimal):
            return value
        try:
            fmu = self.units.fmus[component]
            return converted_value(value, unit, wanted, fmu=fmu, own=own, defined=self.units.defined)
        except DescriptionError as error:
            self.problem(f"parameter '{component}.{name}': {error}")
            return value

    def parameters(self, binding: Any, where: str) -> tuple[list[tuple[str, Any]], dict[str, Unit]]:
        """Names and typed elements of the parameters of a binding, and the units that their set defines."""
        source = binding.get("source")
        if source:
            relative = self.source(where, source)
            try:
                content = (self.folder / relative).read_bytes()
            except OSError as error:
                self.problem(f"'{where}': parameter values '{source}' cannot be read ({error.strerror}).")
                return [], {}
        else:
            inline = binding.find(f"{tag('ssd:ParameterValues')}/{tag('ssv:ParameterSet')}")
            if inline is None:
                return [], {}
            content = lxml_etree.tostring(inline)
        problems = validate(content, "SystemStructureParameterValues")
        if problems:
            self.problems += [f"{self.name}: parameter values of '{where}', {problem}" for problem in problems]
            return [], {}
        root = parse(content)
        found = root.findall(f"{tag('ssv:Parameters')}/{tag('ssv:Parameter')}")
        typed = [(parameter.get("name"), next(iter(parameter), None)) for parameter in found]
        return [(name, element) for name, element in typed if element is not None], defined_units(root, "ssv:Units")

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
        return top.findall(f"{tag('ssd:Connections')}/{tag('ssd:Connection')}")

    def connection(self, element: Any) -> dict[str, Any] | None:
        ends = [(element.get(f"{side}Element"), element.get(f"{side}Connector")) for side in ("start", "end")]
        said = " -> ".join(".".join(part or "" for part in end) for end in ends)
        if any(part is None for end in ends for part in end):
            own = "output" if ends[1][0] is None else "input"
            if own == "output":
                return None  # an output of the whole system: every output is recorded anyway
            self.problem(f"connection {said}: ends at a connector of the system. Connect components with each other.")
            return None
        if self.kinds.get(ends[0]) == "input":
            ends.reverse()  # SSP lets a connection be written from either side
            if element.find(tag("ssc:LinearTransformation")) is not None:
                self.problem(f"connection {said}: starts at an input and transforms. Write it from the output.")
                return None
        for child in element:
            kind = str(child.tag).rpartition("}")[2]
            if kind.endswith("Transformation") and kind != "LinearTransformation":
                self.problem(f"connection {said}: a {kind} is not read, only LinearTransformation.")
        source, target = (f"{name}.{variable}" for name, variable in ends)
        try:
            return {"from": source, "to": target, **self.transformation(element, ends[0], ends[1])}
        except DescriptionError as error:
            self.problem(f"connection {said}: {error}")
            return None

    def transformation(self, element: Any, source: tuple[str, str], target: tuple[str, str]) -> dict[str, Any]:
        """Factor, offset and treatment of units of a connection, as a system file has them.

        Raises DescriptionError for units that cannot be converted.
        """
        linear = element.find(tag("ssc:LinearTransformation"))
        stated: dict[str, Any] = {}
        if linear is not None:
            stated = {key: Decimal(linear.get(key)) for key in ("factor", "offset") if linear.get(key) is not None}
        if element.get("suppressUnitConversion") in ("true", "1"):
            own = self.own(element, "cosim:Conversion")
            if own is not None:
                meant = {key: Decimal(own.get(key)) for key in ("factor", "offset")}
                written = float(stated.get("factor", 1)), float(stated.get("offset", 0))
                if self.total(meant, source, target) == written:
                    return {**meant, "units": "convert"}
            return stated if "factor" in stated else {**stated, "units": "suppress"}
        if self.units.differs(source) or self.units.differs(target):
            factor, offset = self.total(stated, source, target)
            return {"factor": factor, "offset": offset}
        return {**stated, "units": "convert"}

    def total(
        self, stated: Mapping[str, Decimal], source: tuple[str, str], target: tuple[str, str]
    ) -> tuple[float, float]:
        """Factor and offset of the conversion of units and what is stated behind it (SSP 1.0, LinearTransformation)."""
        written = (float(stated.get("factor", 1)), float(stated.get("offset", 0)))
        whole = converted(Connection(source, target, stated=written), *self.units.conversion(source, target))
        return whole.factor, whole.offset

    # Experiment

    def experiment(self) -> dict[str, Any]:
        element = self.root.find(tag("ssd:DefaultExperiment"))
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
            other = element.find(f".//{tag('osp:FixedStepAlgorithm')}")
            if other is not None and other.get("baseStepSize"):
                table["step_size"] = self.value("Real", other.get("baseStepSize"))
        return table
