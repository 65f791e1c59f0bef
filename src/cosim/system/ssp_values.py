"""Parameter values of an SSP: parameter sets, mappings, and the variables that get the values.

A parameter has the name of its variable, behind the names of the elements around it. A mapping gives it another name.
If a variable has several values, the value at the outer element counts; at one element, the later value
(SSP 1.0, ParameterBinding).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from typing import Any, cast

from ..errors import DescriptionError, listed, suggest
from ..fmu.archive import checked_members, opened
from .ssp_names import local_name, lxml_etree, tag
from .ssp_package import Package, read_document
from .ssp_tree import End, Part
from .ssp_units import ConnectorUnits, NamedUnit, conversion, defined_units

SET = "application/x-ssp-parameter-set"
MAPPING = "application/x-ssp-parameter-mapping"

SHOWN_NAMES = 3
"""Largest number of unknown names that a note lists."""


@dataclass(frozen=True)
class Given:
    """A value of a parameter set with its unit; the unit may be None."""

    value: object
    unit: NamedUnit | None


def scaled(value: object, factor: float, offset: float) -> object:
    """``factor*value + offset``; for factor 1 and offset 0, ``value`` itself.

    Raises DescriptionError if ``value`` is not a number.
    """
    if (factor, offset) == (1.0, 0.0):
        return value
    if isinstance(value, bool | str):
        raise DescriptionError(f"'{value}' is no number to transform.")
    if isinstance(value, float):  # INF or NaN
        return value
    return Decimal(cast("int | Decimal", value)) * Decimal(repr(factor)) + Decimal(repr(offset))


def linear(element: Any) -> tuple[float, float] | None:
    """Factor and offset of the LinearTransformation in a connection or mapping entry; None if there is none."""
    found = element.find(tag("ssc:LinearTransformation"))
    return None if found is None else (float(found.get("factor", "1")), float(found.get("offset", "0")))


def other_transformation(element: Any) -> Any:
    """The mapping transformation (a table of values) in a connection or mapping entry; None if there is none."""
    return next((c for c in element if local_name(c).endswith("MappingTransformation")), None)


def transformed(value: object, element: Any) -> object:
    """A value after the transformation in a connection or mapping entry. Units must be converted before.

    Raises DescriptionError if the transformation does not fit the value.
    """
    mapping = other_transformation(element)
    if mapping is None:
        return scaled(value, *(linear(element) or (1.0, 0.0)))
    kind = local_name(mapping).removesuffix("MappingTransformation")
    for entry in mapping.findall(tag("ssc:MapEntry")):
        if typed_value(kind, entry.get("source")) == value:
            return typed_value(kind, entry.get("target"))
    raise DescriptionError(f"the {kind}MappingTransformation has no entry for {value}.")


def typed_value(kind: str, text: str) -> object:
    """The value that ``text`` means in the element ``kind`` (Real, Integer, Boolean ...) of a parameter set."""
    if kind == "Boolean":
        return text.strip() in ("true", "1")
    if kind == "Integer":
        return int(text)
    if kind == "Real":
        try:
            return Decimal(text.strip())
        except InvalidOperation:  # INF and NaN of XML Schema; the check of the system reports them
            return float(text.strip())
    return text


class ParameterValues:
    """Reads the parameter bindings of all elements."""

    def __init__(
        self, package: Package, units: ConnectorUnits, problem: Callable[[str], None], note: Callable[[str], None]
    ) -> None:
        self.package = package
        self.units = units
        self.problem = problem
        self.note = note
        self.given: dict[End, Given] = {}
        """The given values, by variable of a component or connector of a system."""

    def read(self, part: Part) -> None:
        """Enter the values that are bound to an element and to the elements inside it."""
        for inner in part.parts.values():
            self.read(inner)
        for binding in part.xml.findall(f"{tag('ssd:ParameterBindings')}/{tag('ssd:ParameterBinding')}"):
            try:
                self.bind(part, binding)
            except DescriptionError as error:
                for problem in error.problems:
                    self.problem(f"parameter values of '{part.name}', {problem}")

    def bind(self, part: Part, binding: Any) -> None:
        values = self.document(part, binding, "ssd:ParameterValues", "ssv:ParameterSet", SET)
        if values is None:
            return
        own = defined_units(values, "ssv:Units")
        entries = self.mapping(part, binding)
        prefix = binding.get("prefix", "")
        nowhere: list[str] = []
        names: set[str] = set()
        for parameter in values.findall(f"{tag('ssv:Parameters')}/{tag('ssv:Parameter')}"):
            typed = next(iter(parameter), None)
            if typed is None:
                continue
            source = f"{prefix}{parameter.get('name')}"
            if source in names:
                self.note(f"parameter values of '{part.name}': '{source}' has more than one value; the last counts.")
            names.add(source)
            for name, entry in entries.pop(source, [(source, None)]):
                found = _find(part, name)
                if found is None:
                    nowhere.append(name)
                    continue
                given = Given(typed_value(local_name(typed), typed.get("value", "")), None)
                if typed.get("unit"):
                    given = Given(given.value, self.units.meant(found, typed.get("unit"), own))
                self.enter(found, given, entry)
        if nowhere:
            self.note(
                f"parameter values of '{part.name}': nothing there is called {_few(nowhere)}; these values are ignored."
                + (suggest(nowhere[0].rpartition(".")[2], dict.fromkeys(_variables(part))) if len(nowhere) == 1 else "")
            )
        if entries:
            self.note(f"mapping at '{part.name}': the values hold nothing called {_few(list(entries))}.")

    def enter(self, end: End, given: Given, entry: Any) -> None:
        """Store the value for ``end``: converted to the unit there, then changed by the mapping ``entry``.

        The unit is that of the connector, or else that of the FMU's variable, as for connections (SSP 2.0, Real).
        """
        wanted = self.units.unit(end)
        suppressed = entry is not None and entry.get("suppressUnitConversion") in ("true", "1")
        value, unit = given.value, given.unit
        try:
            if not suppressed and wanted is not None and isinstance(value, Decimal):
                value = scaled(value, *conversion(unit, wanted, "Define it in Units."))
            if entry is not None:
                value = transformed(value, entry)
        except DescriptionError as error:
            self.problem(f"parameter '{'.'.join((*end[0], end[1]))}': {error}")
            return
        if wanted is None and (suppressed or value is not given.value):
            unit = None  # the unit of the value is not known any more
        self.given.pop(end, None)
        self.given[end] = Given(value, wanted or unit)

    def mapping(self, part: Part, binding: Any) -> dict[str, list[tuple[str, Any]]]:
        """For each mapped name, its targets and their mapping entries."""
        element = binding.find(tag("ssd:ParameterMapping"))
        if element is None:
            return {}
        root = self.document(part, element, None, "ssm:ParameterMapping", MAPPING)
        found: dict[str, list[tuple[str, Any]]] = {}
        for entry in () if root is None else root.findall(tag("ssm:MappingEntry")):
            found.setdefault(entry.get("source"), []).append((entry.get("target"), entry))
        return found

    def document(self, part: Part, element: Any, holder: str | None, root: str, kind: str) -> Any:
        """The root of a parameter set or mapping, in a separate file or inside ``element``; None if there is none."""
        source, schema = (
            element.get("source"),
            f"SystemStructure{'ParameterValues' if kind == SET else 'ParameterMapping'}",
        )
        if element.get("type", kind) != kind:
            raise DescriptionError(f"type {element.get('type')} is not read. Write it as {kind}.")
        if source:
            content = self.file(part, source, element.get("sourceBase", "SSD"))
            try:
                return read_document(content, schema, lambda text: self.note(f"file '{source}': {text}"))
            except DescriptionError as error:
                raise DescriptionError([f"file '{source}', {problem}" for problem in error.problems]) from None
        inline = element.find(tag(root) if holder is None else f"{tag(holder)}/{tag(root)}")
        return None if inline is None else read_document(lxml_etree.tostring(inline), schema)

    def file(self, part: Part, source: str, base: str) -> bytes:
        """The content of a file beside the SSD, or inside the FMU of a component. Raises DescriptionError."""
        try:
            if base == "component" and part.fmu is not None:
                with opened(part.fmu.path) as archive:
                    member = self.package.path(source).removeprefix("./")
                    if all(entry.filename != member for entry in checked_members(archive, lambda _: False)):
                        raise DescriptionError(f"file '{source}' is not in {part.fmu.path.name}.")
                    return archive.read(member)
            return (self.package.folder / self.package.file(source)).read_bytes()
        except OSError as error:
            raise DescriptionError(f"file '{source}' cannot be read ({error.strerror}).") from None


def _find(part: Part, name: str) -> End | None:
    """The variable or connector called ``name`` inside an element; None if there is none."""
    if part.kind == "Component":
        fmu = part.fmu
        known = fmu is None or name in fmu.variables or name in fmu.arrays
        return (part.path, name) if known else None
    if name in part.connectors:
        return part.path, name
    for key, inner in part.parts.items():
        if name.startswith(f"{key}.") and (found := _find(inner, name[len(key) + 1 :])) is not None:
            return found
    return None


def _variables(part: Part) -> Iterator[str]:
    for inner in part.all():
        yield from inner.connectors
        if inner.fmu is not None:
            yield from (name for name, variable in inner.fmu.variables.items() if variable.settable)


def _few(names: list[str]) -> str:
    return listed([f"'{name}'" for name in names], SHOWN_NAMES)
