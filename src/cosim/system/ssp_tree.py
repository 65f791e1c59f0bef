"""The elements of an SSD as a tree: systems contain systems and components. Each component gets an instance name.

In SSP, systems may be nested and names may contain any character. Here, a system is flat and instance names are plain.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

from ..fmu.description import Fmu
from .instances import NAME
from .ssp_names import local_name, tag

Path = tuple[str, ...]
"""The names of the elements on the way from the top system to an element; () is the top system itself."""

End = tuple[Path, str]
"""A connector, or a variable, of an element."""


@dataclass
class Part:
    """An element of a system."""

    path: Path
    xml: Any
    connectors: dict[str, Any]
    """The connectors that the SSD declares."""
    parts: dict[str, Part]
    """The elements of a system."""
    fmu: Fmu | None = None
    """The FMU of a component, None if it cannot be read."""
    start: dict[str, Any] = field(default_factory=dict[str, Any])
    """The start values of a component."""

    @property
    def name(self) -> str:
        """The name of the element behind the names of the systems around it, divided by points."""
        return ".".join(self.path) or str(self.xml.get("name") or "system")

    @property
    def kind(self) -> str:
        """``System``, ``Component`` or another element's name."""
        return local_name(self.xml)

    def all(self) -> Iterator[Part]:
        """This element and all elements inside it; an outer element comes before its inner elements."""
        yield self
        for part in self.parts.values():
            yield from part.all()

    def components(self) -> Iterator[Part]:
        """This element, if it is a component, and all components inside it."""
        return (part for part in self.all() if part.kind == "Component")

    def connector_kind(self, name: str) -> str | None:
        """The kind of a connector, such as ``input`` or ``output``; None if it is not known.

        The SSD declares it. If it does not, or declares ``inout``, the FMU decides.
        """
        declared = self.connectors[name].get("kind") if name in self.connectors else None
        variable = None if self.fmu is None else self.fmu.variables.get(name)
        if variable is not None and declared in (None, "inout"):
            return variable.causality
        return declared


def read_tree(xml: Any, problem: Callable[[str], None], path: Path = ()) -> Part:
    """The system ``xml`` with everything inside it. ``problem`` is called for two elements of one name."""
    connectors = {c.get("name"): c for c in xml.findall(f"{tag('ssd:Connectors')}/{tag('ssd:Connector')}")}
    part = Part(path, xml, connectors, {})
    for element in xml.findall(f"{tag('ssd:Elements')}/*"):
        name = element.get("name")
        if name in part.parts:
            problem(f"'{part.name}' has two elements called '{name}'. Name each differently.")
        part.parts[name] = read_tree(element, problem, (*path, name))
    return part


def instance_names(components: Iterable[Part]) -> dict[Path, str]:
    """The instance name of each component.

    A component of the top system keeps its name if the name is plain. The others get a name made from their path, in
    the order of the file, with a number if the name is taken. Therefore a component that is added at the end of the top
    system changes no other name, unless it has that name itself.
    """
    paths = [component.path for component in components]
    names: dict[Path, str] = {path: path[0] for path in paths if len(path) == 1 and NAME.fullmatch(path[0])}
    taken = set(names.values())
    for path in paths:
        if path in names:
            continue
        wanted = "_".join(_plain(name) for name in path)
        wanted = wanted if NAME.fullmatch(wanted) else f"_{wanted}"
        name, number = wanted, 1
        while name in taken:
            number += 1
            name = f"{wanted}_{number}"
        names[path] = name
        taken.add(name)
    return {path: names[path] for path in paths}


def _plain(name: str) -> str:
    """A name of letters, digits and underscores that looks like ``name``."""
    if re.fullmatch(r"[A-Za-z0-9_]+", name):
        return name
    letters = unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode()
    return re.sub(r"[^A-Za-z0-9_]+", "_", letters).strip("_") or "component"
