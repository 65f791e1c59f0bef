"""Reads SSP packages and SSD files as the document of a system file.

Nested systems are flattened: each component becomes an instance. Connections are followed through the connectors of
systems. A connector that is not connected is a constant: the parameter value that is bound to it.
"""

from __future__ import annotations

import contextlib
import json
import math
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, quote, urlsplit

from ..errors import DescriptionError, listed
from ..fmu.description import read_fmu
from .ssp_flow import Flow, Hop, said
from .ssp_names import own_annotation, tag
from .ssp_package import Package, open_package, read_document
from .ssp_tree import End, Part, instance_names, read_tree
from .ssp_units import ConnectorUnits, defined_units
from .ssp_values import ParameterValues, linear, other_transformation, typed_value

FMU = "application/x-fmu-sharedlibrary"

SHOWN_NAMES = 20
"""Largest number of instance names that a note lists: about three lines."""


@dataclass(frozen=True)
class SspSystem:
    """The system that an SSP describes."""

    document: dict[str, Any]
    """The system with the keys of a system file."""
    folder: Path
    """The folder where relative paths of the document start."""
    notes: list[str]
    """Remarks on things that are legal but may surprise."""


def read_ssp(path: str | Path) -> SspSystem:
    """Read the system of an .ssp or .ssd file.

    An .ssp is unpacked into a temporary folder that lasts as long as the process.
    Raises DescriptionError with all problems.
    """
    package = open_package(Path(path))
    notes: list[str] = []
    if package.others:
        others = ", ".join(package.others)
        notes.append(f"{package.file_name} is read, not {others}. For another, unpack the package and name it.")
    try:
        root = read_document(package.description, note=notes.append)
    except DescriptionError as error:
        raise DescriptionError(
            [f"{package.name}: {package.file_name}, {problem}" for problem in error.problems]
        ) from None
    reader = SspReader(package, root, notes)
    return SspSystem(reader.document(), package.folder, reader.notes)


class SspReader:
    """Turns an SSD into the document of a system, collecting problems and notes; ``notes`` are those found before."""

    def __init__(self, package: Package, root: Any, notes: list[str]) -> None:
        self.package = package
        self.root = root
        self.problems: list[str] = []
        self.notes = notes
        self.top = read_tree(root.find(tag("ssd:System")), self.problem)
        self.names = instance_names(self.top.components())
        self.sources = {part.path: self.source(part) for part in self.top.components()}
        self.units = ConnectorUnits(self.top, defined_units(root, "ssd:Units"))
        self.values = ParameterValues(package, self.units, self.problem, self.notes.append)
        self.flow = Flow(self.top, self.units, self.problem)

    def problem(self, text: str) -> None:
        self.problems.append(f"{self.package.name}: {text}")

    def document(self) -> dict[str, Any]:
        """The document with the keys of a system file. Raises DescriptionError with all problems."""
        self.tell_elements()
        self.values.read(self.top)
        connections = self.connections()
        self.constants()
        for (path, name), given in self.values.given.items():
            if path in self.names:
                self.units.parts[path].start[name] = given.value
        document: dict[str, Any] = {
            "instances": {self.names[part.path]: self.instance(part) for part in self.top.components()},
            "connections": connections,
            "experiment": self.experiment(),
        }
        description = self.root.get("description") or self.top.xml.get("description")
        if description:
            document["description"] = description
        own = own_annotation(self.root.find(tag("ssd:DefaultExperiment")), "cosim:Experiment")
        record = None if own is None else own.find(tag("cosim:Record"))
        if record is not None:
            names = [element.get("name") for element in record.findall(tag("cosim:Variable"))]
            document["record"] = {"variables": names, "decimation": int(record.get("decimation", "1"))}
        if own is not None:
            self.more(own.find(tag("cosim:Document")), document)
        if not self.names:
            self.problem("no component in it: there is nothing to run.")
        if self.problems:
            raise DescriptionError(self.problems)
        return document

    def more(self, element: Any, document: dict[str, Any]) -> None:
        """Enter the parts of the system that SSP cannot express, from our annotation into ``document``.

        These are records, and the connections of inputs that get a record, a sum or noise.
        """
        if element is None:
            return
        try:
            more = json.loads(element.text or "", parse_float=Decimal)
            connections, signals = list(more["connections"]), dict(more["signals"])
        except (ValueError, TypeError, KeyError):
            self.problem("the annotation of signals cannot be read. Export the system again.")
            return
        for name, table in signals.items():
            try:
                table["file"] = self.package.file(quote(str(table.get("file", ""))))
            except DescriptionError as error:
                self.problem(f"signals.{name}: {error}")
        if signals:
            document["signals"] = signals
        targets = {c.split("->")[1].strip() if isinstance(c, str) else c.get("to") for c in connections}
        document["connections"] = [c for c in document["connections"] if c["to"] not in targets] + connections

    # Elements

    def tell_elements(self) -> None:
        """Note each instance whose name differs from its component's name, and each element that is not read."""
        renamed = [f"'{part.name}' is {self.names[part.path]}" for part in self.top.components()]
        renamed = [text for text, path in zip(renamed, self.names, strict=True) if path != (self.names[path],)]
        if renamed:
            self.notes.append(f"instances have plain names here: {listed(renamed, SHOWN_NAMES)}.")
        for part in self.top.all():
            if part.kind not in ("System", "Component"):
                self.notes.append(f"'{part.name}' is a {part.kind}, which is not read.")
        if contradicted := [said(end) for end in self.units.contradicted()]:
            self.notes.append(
                f"the description states another unit than the FMU for {listed(contradicted, SHOWN_NAMES)}: the "
                "description counts."
            )

    def source(self, part: Part) -> str:
        """The path of a component's FMU, relative to the SSD. Also reads the FMU, if possible."""
        xml = part.xml
        if xml.get("type", FMU) != FMU:
            self.problem(f"component '{part.name}' is of type {xml.get('type')}. Only FMUs are read.")
            return ""
        uri = str(xml.get("source"))
        proxied = parse_qs(urlsplit(uri).query).get("file") if uri.startswith("proxyfmu:") else None
        if proxied is not None:
            self.notes.append(f"component '{part.name}' is meant for libcosim's proxyfmu; its FMU runs directly here.")
        try:
            source = self.package.file(proxied[0] if proxied else uri)
        except DescriptionError as error:
            self.problem(f"component '{part.name}': {error}")
            return ""
        with contextlib.suppress(DescriptionError):  # the check of the system reports it
            part.fmu = read_fmu(self.package.folder / source)
        if xml.get("implementation", "any") == "ModelExchange":
            self.notes.append(f"component '{part.name}' is meant for model exchange; it runs as co-simulation here.")
        return source

    def instance(self, part: Part) -> dict[str, Any]:
        table: dict[str, Any] = {"fmu": self.sources[part.path], "start": part.start}
        own = own_annotation(part.xml, "cosim:Instance")
        if own is not None and own.get("stepMultiple"):
            table["step_multiple"] = int(own.get("stepMultiple"))
        return table

    # Connections

    def connections(self) -> list[dict[str, Any]]:
        """The connections between components."""
        found: list[dict[str, Any]] = []
        for end in self.flow.into:
            if end[0] not in self.names or not (hops := self.flow.trace(end)):
                continue
            if hops[0].source[0] in self.names and (connection := self.connection(hops)) is not None:
                found.append(connection)
        return found

    def connection(self, hops: list[Hop]) -> dict[str, Any] | None:
        source, target = hops[0].source, hops[-1].target
        if self.units.parts[source[0]].connector_kind(source[1]) == "calculatedParameter":
            self.problem(f"connection {hops[0]}: parameters that an FMU calculates are not passed on. Set the value.")
            return None
        for hop in hops:
            other = other_transformation(hop.xml)
            if other is not None:
                name = str(other.tag).rpartition("}")[2]
                self.problem(f"connection {hop}: {name} is not read for signals, only LinearTransformation.")
                return None
        ends = {"from": self.named(source), "to": self.named(target)}
        try:
            return {**ends, **self.transformation(hops)}
        except DescriptionError as error:
            self.problem(f"connection {' -> '.join(said(end) for end in (source, target))}: {error}")
            return None

    def named(self, end: End) -> str:
        """A variable as INSTANCE.VARIABLE."""
        return f"{self.names[end[0]]}.{end[1]}"

    def transformation(self, hops: list[Hop]) -> dict[str, Any]:
        """Factor, offset and treatment of units of a chain of connections, with the keys of a system file.

        Raises DescriptionError for units that cannot be converted.
        """
        differs = self.units.differs(hops[0].source) or self.units.differs(hops[-1].target)
        if len(hops) == 1:
            stated = self.stated(hops[0].xml)
            if hops[0].suppressed:
                return self.suppressed(hops[0], stated)
            if not differs:
                return {**stated, "units": "convert"}
        factor, offset = self.flow.through(hops)
        if not differs and not any(hop.suppressed or linear(hop.xml) for hop in hops):
            direct = self.flow.through([Hop(hops[0].source, hops[-1].target, hops[0].xml)])
            if all(math.isclose(a, b, rel_tol=1e-14) for a, b in zip(direct, (factor, offset), strict=True)):
                return {"units": "convert"}
        return {"factor": factor, "offset": offset}

    @staticmethod
    def stated(element: Any) -> dict[str, Decimal]:
        """Factor and offset that a connection states."""
        found = element.find(tag("ssc:LinearTransformation"))
        if found is None:
            return {}
        return {key: Decimal(found.get(key)) for key in ("factor", "offset") if found.get(key) is not None}

    def suppressed(self, hop: Hop, stated: dict[str, Decimal]) -> dict[str, Any]:
        """Factor, offset and treatment of units of a connection that suppresses the conversion of units.

        ``write_ssp`` writes a conversion as numbers and keeps the original form in an annotation. If it still fits the
        numbers, the original form is restored.
        """
        own = own_annotation(hop.xml, "cosim:Conversion")
        if own is not None:
            meant = {key: Decimal(own.get(key)) for key in ("factor", "offset")}
            written = float(stated.get("factor", 1)), float(stated.get("offset", 0))
            if self.flow.through([hop], (float(meant["factor"]), float(meant["offset"]))) == written:
                return {**meant, "units": "convert"}
        return dict(stated) if "factor" in stated else {**stated, "units": "suppress"}

    def constants(self) -> None:
        """Pass the values bound to system connectors on to the inputs and parameters that they feed."""
        used: set[End] = set()
        for end in self.flow.into:
            hops = self.flow.trace(end) if end[0] in self.names else []
            if not hops or hops[0].source[0] in self.names:
                continue
            first = next((i for i, hop in enumerate(hops) if hop.source in self.values.given), None)
            if first is None:
                self.notes.append(
                    f"nothing feeds '{said(hops[0].source)}', so '{self.named(end)}' keeps its own start."
                )
                continue
            source = hops[first].source
            used.add(source)
            try:
                value = self.flow.constant(self.values.given[source], hops[first:])
            except DescriptionError as error:
                self.problem(f"'{said(source)}' -> '{self.named(end)}': {error}")
                continue
            self.units.parts[end[0]].start.pop(end[1], None)
            self.values.given.pop(end, None)
            self.units.parts[end[0]].start[end[1]] = value
        for end in self.values.given:
            if end[0] not in self.names and end not in used:
                self.notes.append(
                    f"the value of '{said(end)}' is not used: nothing takes it, or another value comes in."
                )

    # Experiment

    def experiment(self) -> dict[str, Any]:
        element = self.root.find(tag("ssd:DefaultExperiment"))
        table: dict[str, Any] = {}
        for attribute, key in (("startTime", "start_time"), ("stopTime", "stop_time")):
            if element is not None and element.get(attribute) is not None:
                table[key] = typed_value("Real", element.get(attribute))
        own = own_annotation(element, "cosim:Experiment")
        if own is not None:
            for attribute, key in (("stepSize", "step_size"), ("tolerance", "tolerance")):
                if own.get(attribute) is not None:
                    table[key] = typed_value("Real", own.get(attribute))
            order = own.get("order", "sequential")
            table["order"] = order if order in ("sequential", "parallel") else order.split()
            return table
        for name, attribute in (("oms:FixedStepMaster", "stepSize"), ("osp:FixedStepAlgorithm", "baseStepSize")):
            other = self.root.find(f".//{tag(name)}")
            if other is not None and other.get(attribute):
                table["step_size"] = typed_value("Real", other.get(attribute))
                if name.startswith("osp"):
                    table["order"] = "parallel"  # libcosim exchanges all outputs after a step
                    self.notes.append(
                        'the file asks for libcosim\'s fixed-step algorithm, which is order = "parallel".'
                    )
        return table
