"""What an FMU file says, read without starting it: variables, dependencies, platforms, and a safe way to unpack it.

A file from elsewhere is not trusted: every member of its archive is checked before any is read.
"""

from __future__ import annotations

import hashlib
import math
import os
import re
import stat
import sys
import zipfile
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from functools import lru_cache
from importlib import import_module
from pathlib import Path, PurePosixPath
from platform import machine
from types import MappingProxyType
from typing import Any, Literal, cast

from ..errors import DescriptionError
from ..files import temporary_folder
from ..units import Unit, resolve_unit
from .archive import checked_members, unpack

fmi: Any = import_module("fmpy.model_description")


Type = Literal["Real", "Integer", "Boolean", "String", "Enumeration"]


Value = float | int | bool | str


MAX_DESCRIPTION_BYTES = 64 * 2**20


ELEMENT = re.compile(r"(?P<name>.+)\[(?P<index>\d+(?:\s*,\s*\d+)*)\]")
"""Name of an element of an array: ``a[1]``, or ``a[1,2]`` of an array of two dimensions."""


@dataclass(frozen=True)
class DisplayUnit:
    """``value in this unit = factor * value + offset``."""

    name: str
    factor: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class Variable:
    """A scalar variable of an FMU, in the words of FMI 2.0."""

    name: str
    reference: int
    type: Type
    causality: str
    variability: str
    initial: str | None
    unit: str | None
    display_unit: DisplayUnit | None
    start: Value | None
    start_text: str | None
    min: float | None
    max: float | None
    text: str
    items: Mapping[str, int]
    """Names and values of an Enumeration, empty for other types."""
    derivative_of: str | None = None
    """The state whose time derivative this is."""

    @property
    def settable(self) -> bool:
        """Whether a start value may be given before initialization."""
        if self.causality in ("parameter", "input"):
            return True
        return self.variability != "constant" and self.initial in ("exact", "approx")


@dataclass(frozen=True)
class Array:
    """An array of scalar variables ``a[1]``, ``a[2]`` ..., or ``a[1,1]``, ``a[1,2]`` ..."""

    elements: tuple[str, ...]
    """Names of the elements in the order of their indices, the last index fastest, wherever the file has them."""
    first: tuple[int, ...]
    """The smallest index of each dimension: 0 or 1 in most files."""
    shape: tuple[int, ...]
    """Number of elements along each dimension; empty if indices are missing or of different length."""

    @property
    def span(self) -> str:
        """The indices as text, such as ``1..10`` or ``1..2, 1..3``."""
        return ", ".join(f"{low}..{low + n - 1}" for low, n in zip(self.first, self.shape, strict=True))


@dataclass(frozen=True)
class Fmu:
    """An FMI 2.0 co-simulation FMU as its file describes it."""

    path: Path
    name: str
    identifier: str
    guid: str
    text: str
    version: str
    tool: str
    digest: str
    """SHA-256 of the file."""
    variables: Mapping[str, Variable]
    dependencies: Mapping[str, tuple[str, ...]]
    """The inputs on which each output depends directly (feedthrough)."""
    arrays: Mapping[str, Array]
    """The array ``a`` of ``a[1]``, ``a[2]`` ..."""
    base_units: Mapping[str, Unit]
    """The units for which the file states a BaseUnit."""
    log_categories: tuple[str, ...]
    start_time: float | None
    stop_time: float | None
    step_size: float | None
    tolerance: float | None
    """Times, step and tolerance of DefaultExperiment, where the file states them."""
    platforms: tuple[str, ...]
    library: str | None
    """The archive member to load on this machine, None if there is none."""
    once_per_process: bool = False
    needs_tool: bool = False
    """Whether the tool that made the FMU must be installed to run it."""
    _stamp: tuple[int, int] = field(default=(0, 0), repr=False)

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the inputs, in the order of the file."""
        return tuple(v.name for v in self.variables.values() if v.causality == "input")

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the outputs, in the order of the file."""
        return tuple(v.name for v in self.variables.values() if v.causality == "output")

    def unit(self, name: str) -> Unit | None:
        """What this file means by a unit: what it states, else what its name says; None for an unknown name."""
        return resolve_unit(name, self.base_units)

    def extract(self, folder: Path) -> Path:
        """Unpack into ``folder`` what a run on this machine needs; the path of the library.

        Raises DescriptionError if the archive is hostile or has changed since it was read, or if ``folder`` is full.
        """
        if self.library is None:
            raise DescriptionError(f"{self.path.name}: {_no_binary(self)}")
        if _stamp(self.path) != self._stamp:
            raise DescriptionError(f"{self.path} changed after it was read. Read the system again.")
        binaries = str(PurePosixPath(self.library).parent) + "/"
        with zipfile.ZipFile(self.path) as archive:
            unpack(archive, folder, lambda name: name.startswith((binaries, "resources/")))
        return folder.joinpath(*PurePosixPath(self.library).parts)


def read_fmu(path: Path) -> Fmu:
    """Read and check the FMU at ``path``. Raises DescriptionError with every problem of the file."""
    try:
        return _read(path.resolve(), _stamp(path))
    except FileNotFoundError:
        raise DescriptionError(f"{path}: no such file.") from None
    except OSError as error:
        raise DescriptionError(f"{path}: cannot be read ({error.strerror}).") from None


def platform_folders() -> tuple[str, ...]:
    """Folders of ``binaries/`` that serve this machine, best first."""
    x86 = machine().lower() in ("x86_64", "amd64")
    arm = machine().lower() in ("aarch64", "arm64")
    if sys.platform == "win32":
        return ("win64", "x86_64-windows") if x86 else ("aarch64-windows",)
    if sys.platform == "darwin":
        return ("aarch64-darwin", "darwin64") if arm else ("darwin64", "x86_64-darwin")
    return ("linux64", "x86_64-linux") if x86 else ("aarch64-linux",) if arm else (f"{machine()}-linux",)


def missing_binary(fmu: Fmu) -> str | None:
    """What to say if this machine cannot run ``fmu``."""
    return None if fmu.library is not None else _no_binary(fmu)


def _no_binary(fmu: Fmu) -> str:
    have = ", ".join(fmu.platforms) or "none"
    return (
        f"no binary for this platform ({platform_folders()[0]}); the FMU has: {have}. "
        "Build it for this platform, or run it on one of those."
    )


def _stamp(path: Path) -> tuple[int, int]:
    status = os.stat(path)
    if stat.S_ISDIR(status.st_mode):
        raise DescriptionError(f"{path}: is a folder. Name an .fmu file.")
    return status.st_mtime_ns, status.st_size


@lru_cache(maxsize=256)
def _read(path: Path, stamp: tuple[int, int]) -> Fmu:
    content = path.read_bytes()
    try:
        with zipfile.ZipFile(path) as archive:
            members = checked_members(archive)
            names = [member.filename for member in members]
            if "modelDescription.xml" not in names:
                raise DescriptionError(f"{path.name}: no modelDescription.xml inside. This is not an FMU.")
            member = archive.getinfo("modelDescription.xml")
            if member.file_size > MAX_DESCRIPTION_BYTES:
                raise DescriptionError(
                    f"{path.name}: modelDescription.xml has {member.file_size / 2**20:.0f} MiB; "
                    f"at most {MAX_DESCRIPTION_BYTES // 2**20} MiB are read."
                )
            xml = archive.read(member)
            damaged = archive.testzip()
            if damaged is not None:
                raise DescriptionError(f"{path.name}: '{damaged}' is damaged. Build or download the FMU again.")
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, ValueError) as error:
        raise DescriptionError(
            f"{path.name}: not a readable zip archive ({error}). Build or download the FMU again."
        ) from None
    return _describe(path, stamp, hashlib.sha256(content).hexdigest(), xml, names)


def _parse(path: Path, xml: bytes) -> Any:
    """FMPy's ModelDescription of ``xml``, validated against the schema and FMPy's further rules."""
    said = f"{path.name}: modelDescription.xml"
    with temporary_folder() as folder:
        file = folder / "modelDescription.xml"
        file.write_bytes(xml)
        try:
            return fmi.read_model_description(str(file), validate=True)
        except fmi.ValidationError as error:
            raise DescriptionError([f"{said}: {problem}" for problem in error.problems]) from None
        except (AttributeError, KeyError, IndexError, TypeError):
            raise DescriptionError(f"{said}: this is not an FMI 2.0 description.") from None
        except Exception as error:
            # FMPy raises bare exceptions, and lxml its own, for whatever a damaged file holds.
            text = str(error).replace(str(file), "modelDescription.xml").strip() or type(error).__name__
            raise DescriptionError(f"{said}: cannot be read: {text}") from None


def _describe(path: Path, stamp: tuple[int, int], digest: str, xml: bytes, names: list[str]) -> Fmu:
    model = _parse(path, xml)
    if model.fmiVersion != "2.0":
        raise DescriptionError(
            f"{path.name}: FMI {model.fmiVersion}. Only FMI 2.0 is read here: take an FMU of that version "
            "(cosim verify replays FMI 3.0, too)."
        )
    if model.coSimulation is None:
        raise DescriptionError(f"{path.name}: only for model exchange. Export it for co-simulation.")
    identifier = str(model.coSimulation.modelIdentifier)
    if not re.fullmatch(r"\w+", identifier):
        raise DescriptionError(f"{path.name}: modelIdentifier {identifier!r} is not a C identifier.")
    units = {unit.name: unit for unit in model.unitDefinitions}
    variables = {v.name: _variable(path, v, units) for v in model.modelVariables if v.causality != "independent"}
    inputs = tuple(v.name for v in variables.values() if v.causality == "input")
    dependencies = {name: inputs for name, v in variables.items() if v.causality == "output"}
    for unknown in model.outputs:
        if unknown.dependencies is not None:
            needed = {known.name for known in unknown.dependencies}
            dependencies[unknown.variable.name] = tuple(name for name in inputs if name in needed)
    folders = {
        parts[1] for parts in (PurePosixPath(n).parts for n in names) if len(parts) > 2 and parts[0] == "binaries"
    }
    extension = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")
    candidates = [f"binaries/{folder}/{identifier}{extension}" for folder in platform_folders()]
    experiment = model.defaultExperiment
    return Fmu(
        path=path,
        name=str(model.modelName),
        identifier=identifier,
        guid=str(model.guid),
        text=str(model.description or ""),
        version=str(model.version or ""),
        tool=str(model.generationTool or ""),
        digest=digest,
        variables=MappingProxyType(variables),
        dependencies=MappingProxyType(dependencies),
        arrays=MappingProxyType(_arrays(variables)),
        base_units=MappingProxyType({n: _base_unit(u.baseUnit) for n, u in units.items() if u.baseUnit is not None}),
        log_categories=tuple(str(category.name) for category in model.logCategories),
        start_time=_float(experiment.startTime) if experiment else None,
        stop_time=_float(experiment.stopTime) if experiment else None,
        step_size=_float(experiment.stepSize) if experiment else None,
        tolerance=_float(experiment.tolerance) if experiment else None,
        platforms=tuple(sorted(folders)),
        library=next((name for name in candidates if name in names), None),
        once_per_process=bool(model.coSimulation.canBeInstantiatedOnlyOncePerProcess),
        needs_tool=bool(model.coSimulation.needsExecutionTool),
        _stamp=stamp,
    )


def _arrays(names: Iterable[str]) -> dict[str, Array]:
    """The arrays that element names make, in the order of the file."""
    found: dict[str, dict[tuple[int, ...], str]] = {}
    for name in names:
        match = ELEMENT.fullmatch(name)
        if match:
            found.setdefault(match["name"], {})[tuple(int(i) for i in match["index"].split(","))] = name
    return {name: _array(elements) for name, elements in found.items()}


def _array(elements: Mapping[tuple[int, ...], str]) -> Array:
    indices = sorted(elements)
    ordered = tuple(elements[index] for index in indices)
    if len({len(index) for index in indices}) > 1:
        return Array(ordered, (), ())
    ranges = [(min(along), max(along)) for along in zip(*indices, strict=True)]
    shape = tuple(high - low + 1 for low, high in ranges)
    if math.prod(shape) != len(indices):
        return Array(ordered, (), ())
    return Array(ordered, tuple(low for low, _ in ranges), shape)


def _variable(path: Path, v: Any, units: Mapping[str, Any]) -> Variable:
    declared = v.declaredType

    def of(attribute: str) -> Any:
        own = getattr(v, attribute)
        return own if own is not None or declared is None else getattr(declared, attribute)

    unit = cast("str | None", of("unit")) if v.type == "Real" else None
    display = cast("str | None", of("displayUnit")) if v.type == "Real" else None
    shown: DisplayUnit | None = None
    if display is not None and unit is not None and unit in units:
        for candidate in units[unit].displayUnits:
            if candidate.name == display:
                shown = DisplayUnit(display, float(candidate.factor), float(candidate.offset))
    items = {item.name: int(item.value) for item in declared.items} if v.type == "Enumeration" and declared else {}
    try:
        start = _start(v.type, v.start)
        low, high = _float(of("min")), _float(of("max"))
    except ValueError as error:
        raise DescriptionError(f"{path.name}: modelDescription.xml: variable '{v.name}': {error}.") from None
    return Variable(
        name=v.name,
        reference=int(v.valueReference),
        type=v.type,
        causality=v.causality,
        variability=v.variability,
        initial=v.initial,
        unit=unit,
        display_unit=shown,
        start=start,
        start_text=v.start,
        min=low if v.type in ("Real", "Integer", "Enumeration") else None,
        max=high if v.type in ("Real", "Integer", "Enumeration") else None,
        text=v.description or "",
        items=MappingProxyType(items),
        derivative_of=None if v.derivative is None else str(v.derivative.name),
    )


def _start(kind: str, text: str | None) -> Value | None:
    if text is None or kind == "String":
        return text
    if kind == "Boolean":
        return text in ("true", "1")
    return float(text) if kind == "Real" else int(text)


def _float(text: str | None) -> float | None:
    return None if text is None else float(text)


def _base_unit(base: Any) -> Unit:
    exponents = (base.kg, base.m, base.s, base.A, base.K, base.mol, base.cd, base.rad)
    return Unit(float(base.factor), tuple(Fraction(exponent) for exponent in exponents), float(base.offset))
