"""Reads an FMU file without starting the FMU: variables, dependencies, platforms. Unpacks it safely.

An FMU may come from an unknown source. Every member of its archive is checked before any member is read.
"""

from __future__ import annotations

import hashlib
import math
import os
import re
import stat
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from functools import lru_cache
from pathlib import Path, PurePosixPath
from platform import machine
from types import MappingProxyType
from typing import Any

from ..errors import DescriptionError, listed
from ..units import Unit, resolve_unit
from .archive import checked_members, opened, repeated, unpack
from .reading import read_description
from .text import no_such_file
from .variables import Variable, read_dependencies, read_variables

MAX_DESCRIPTION_BYTES = 64 * 2**20
"""Largest size in bytes of modelDescription.xml: some 200 000 variables. A parser needs many times as much memory."""

ELEMENT = re.compile(r"(?P<name>.+)\[(?P<index>\d+(?:\s*,\s*\d+)*)\]")
"""Name of an array element: ``a[1]``, or ``a[1,2]`` in an array of two dimensions."""


SHOWN_CLOCKS = 5
"""Largest number of clocks that a message lists."""


@dataclass(frozen=True)
class Array:
    """An array of scalar variables ``a[1]``, ``a[2]`` ..., or ``a[1,1]``, ``a[1,2]`` ..."""

    elements: tuple[str, ...]
    """Names of the elements, sorted by index; the last index changes fastest. The order in the file does not matter."""
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
    """An FMU as its file describes it."""

    path: Path
    fmi: int
    """Major version of FMI: 2 or 3. An FMU of version 1 can be shown, but cannot run."""
    name: str
    identifier: str
    guid: str
    description: str
    version: str
    tool: str
    digest: str
    """SHA-256 of the file."""
    variables: Mapping[str, Variable]
    dependencies: Mapping[str, tuple[str, ...]]
    """The inputs on which each output depends directly (feedthrough)."""
    unstated: frozenset[str]
    """The outputs for which the file does not state dependencies. They count as depending on all inputs."""
    arrays: Mapping[str, Array]
    """Arrays by name: ``a`` for the variables ``a[1]``, ``a[2]`` ..."""
    base_units: Mapping[str, Unit]
    """The units for which the file states a BaseUnit."""
    log_categories: tuple[str, ...]
    start_time: float | None
    stop_time: float | None
    step_size: float | None
    tolerance: float | None
    """Times, step and tolerance of DefaultExperiment; None where the file states none, or none that can be meant."""
    platforms: tuple[str, ...]
    library: str | None
    """The archive member to load on this machine; None if the FMU has no binary for it."""
    obstacles: tuple[str, ...] = ()
    """The reasons why the FMU cannot run here; empty if it can run."""
    findings: tuple[str, ...] = ()
    """The rules of FMI that the file breaks. It can be read all the same."""
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
        """The meaning of a unit name in this file; None if it is unknown.

        A BaseUnit of the file decides. Without one, the name is read as usual.
        """
        return resolve_unit(name, self.base_units)

    def extract(self, folder: Path) -> Path:
        """Unpack the binaries for this machine and the resources into ``folder``. Returns the path of the library.

        Raises DescriptionError if the FMU cannot run on this machine, if the archive is hostile or has changed since it
        was read, or if ``folder`` cannot take the files.
        """
        if self.library is None:
            raise DescriptionError([f"{self.path.name}: {obstacle}" for obstacle in self.obstacles])
        if _stamp(self.path) != self._stamp:
            raise DescriptionError(f"{self.path} changed after it was read. Read the system again.")
        binaries = str(PurePosixPath(self.library).parent) + "/"
        with opened(self.path) as archive:
            unpack(archive, folder, lambda name: name.startswith((binaries, "resources/")), _single)
        # The FMU is told the path of this folder. Some FMUs open it even if they have no resources.
        (folder / "resources").mkdir(exist_ok=True)
        return folder.joinpath(*PurePosixPath(self.library).parts)


def read_fmu(path: Path) -> Fmu:
    """Read the FMU at ``path``, of any version of FMI. Raises DescriptionError if the file is not a readable FMU.

    An FMU that can be read but not run has the reasons in ``obstacles``. Broken rules that do no harm are in
    ``findings``.
    """
    try:
        return _read(path.resolve(), _stamp(path))
    except FileNotFoundError:
        raise no_such_file(path, ".fmu") from None
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


def _single(name: str) -> bool:
    """Whether all members of this name must have the same content: the model description and the binaries."""
    return name == "modelDescription.xml" or name.startswith("binaries/")


def _stamp(path: Path) -> tuple[int, int]:
    status = os.stat(path)
    if stat.S_ISDIR(status.st_mode):
        raise DescriptionError(f"{path}: is a folder. Name an .fmu file.")
    return status.st_mtime_ns, status.st_size


@lru_cache(maxsize=256)
def _read(path: Path, stamp: tuple[int, int]) -> Fmu:
    content = path.read_bytes()
    with opened(path, content) as archive:
        members = checked_members(archive, _single)
        names = [member.filename for member in members]
        findings = [
            f"'{name}' is in the archive more than once, with different content. The last counts."
            for name in repeated(members)
        ]
        if "modelDescription.xml" not in names:
            raise DescriptionError(f"{path.name}: no modelDescription.xml inside.{_instead(names)}")
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
    return _describe(path, stamp, hashlib.sha256(content).hexdigest(), xml, names, findings)


def _instead(names: list[str]) -> str:
    """A sentence for an archive without a description: the member that may be meant."""
    for name in names:
        if PurePosixPath(name).name.lower() == "modeldescription.xml":
            return f" It has {name}: zip the content of the folder itself, and name this file modelDescription.xml."
    return " This is not an FMU."


def _describe(  # noqa: PLR0917
    path: Path, stamp: tuple[int, int], digest: str, xml: bytes, names: list[str], findings: list[str]
) -> Fmu:
    model, more = read_description(path.name, xml)
    findings = [*findings, *more]
    version = int(model.fmiMajorVersion)
    interface = model.coSimulation or model.modelExchange or model.scheduledExecution
    identifier = "" if interface is None else str(interface.modelIdentifier)
    if not re.fullmatch(r"[A-Za-z_]\w*", identifier, re.ASCII):
        findings.append(f"modelIdentifier {identifier!r} is not a C identifier.")
    variables = read_variables(model, findings)
    extension = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")
    folders = [folder for folder in platform_folders() if version < 3 or "-" in folder]
    candidates = [f"binaries/{folder}/{identifier}{extension}" for folder in folders]
    library = next((name for name in candidates if name in names), None)
    obstacles = _obstacles(model, version)
    if library is None and not obstacles:
        obstacles = [_no_binary(folders, identifier, extension, names)]
    units = {unit.name: unit for unit in model.unitDefinitions}
    dependencies, unstated = read_dependencies(model, variables)
    times = _experiment(model.defaultExperiment, findings)
    return Fmu(
        path=path,
        fmi=version,
        name=str(model.modelName),
        identifier=identifier,
        guid=str(model.guid),
        description=str(model.description or ""),
        version=str(model.version or ""),
        tool=str(model.generationTool or ""),
        digest=digest,
        variables=MappingProxyType(variables),
        dependencies=MappingProxyType(dependencies),
        unstated=unstated,
        arrays=MappingProxyType(_arrays(variables)),
        base_units=MappingProxyType({n: _base_unit(u.baseUnit) for n, u in units.items() if u.baseUnit is not None}),
        log_categories=tuple(str(category.name) for category in model.logCategories),
        start_time=times["startTime"],
        stop_time=times["stopTime"],
        step_size=times["stepSize"],
        tolerance=times["tolerance"],
        platforms=_platforms(names),
        library=library,
        obstacles=tuple(obstacles),
        findings=tuple(findings),
        once_per_process=bool(interface is not None and interface.canBeInstantiatedOnlyOncePerProcess),
        needs_tool=bool(interface is not None and interface.needsExecutionTool),
        _stamp=stamp,
    )


TIMES = ("startTime", "stopTime", "stepSize", "tolerance")


def _experiment(experiment: Any, findings: list[str]) -> dict[str, float | None]:
    """The numbers of DefaultExperiment. One that cannot be meant is a finding and counts as missing (None)."""
    given = {name: _number(experiment, name, findings) for name in TIMES}

    def leave_out(name: str, reason: str) -> None:
        findings.append(f"DefaultExperiment: {name} is {given[name]:g}{reason}. Left out.")
        given[name] = None

    start, stop, step, tolerance = (given[name] for name in TIMES)
    if stop is not None and stop < (start or 0.0):
        leave_out("stopTime", f" s, before startTime = {start or 0.0:g} s")
        stop = None
    length = None if stop is None else stop - (start or 0.0)
    if step is not None and step <= 0.0:
        leave_out("stepSize", " s; a step is longer than 0 s")
    elif step is not None and length and step > length:
        leave_out("stepSize", f" s, longer than the experiment of {length:g} s")
    if tolerance is not None and not 0.0 < tolerance < 1.0:
        leave_out("tolerance", "; a relative tolerance lies between 0 and 1")
    return given


def _number(experiment: Any, name: str, findings: list[str]) -> float | None:
    """A number of DefaultExperiment; None if it is missing or not a finite number."""
    text = None if experiment is None else getattr(experiment, name)
    try:
        number = None if text is None else float(text)
    except ValueError:
        number = math.nan
    if number is not None and not math.isfinite(number):
        findings.append(f"DefaultExperiment: {name} is '{text}', which is no finite number. Left out.")
        return None
    return number


def _obstacles(model: Any, version: int) -> list[str]:
    """The reasons why an FMU cannot run here that do not depend on the machine."""
    if version not in (2, 3):
        return [f"FMI {model.fmiVersion}. FMUs of FMI 2.0 and 3.0 run here: take one of these."]
    if model.coSimulation is None and model.modelExchange is None and model.scheduledExecution is not None:
        return [
            "only for scheduled execution, which needs an importer that runs its clocks. Export it for co-simulation."
        ]
    if model.coSimulation is None:
        return ["only for model exchange. Export it for co-simulation."]
    clocks = [v.name for v in model.modelVariables if v.type == "Clock"]
    if clocks:
        shown = listed(clocks, SHOWN_CLOCKS)
        return [f"its model has clocks ({shown}), and cosim activates no clocks. Export it without them."]
    return []


def _platforms(names: Iterable[str]) -> tuple[str, ...]:
    parts = (PurePosixPath(name).parts for name in names)
    return tuple(sorted({part[1] for part in parts if len(part) > 2 and part[0] == "binaries"}))


def _no_binary(folders: list[str], identifier: str, extension: str, names: list[str]) -> str:
    """The message for an FMU that has no binary for this machine."""
    others = [
        name
        for folder in folders
        for name in names
        if PurePosixPath(name).parent == PurePosixPath("binaries", folder) and name.endswith(extension)
    ]
    if others:
        return (
            f"the binary for this platform is {' or '.join(others)}, but by the modelIdentifier it must be called "
            f"{identifier}{extension}. Rename one of them, or export the FMU again."
        )
    have = ", ".join(_platforms(names))
    if not have:
        return (
            f"no binary for this platform ({folders[0]}), nor for another. Ask for an FMU with binaries, or build it "
            "from its sources."
        )
    return (
        f"no binary for this platform ({folders[0]}); the FMU has: {have}. "
        "Build it for this platform, or run it on one of those."
    )


def _arrays(names: Iterable[str]) -> dict[str, Array]:
    """The arrays whose elements are among the names, in the order of the file."""
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


def _base_unit(base: Any) -> Unit:
    exponents = (base.kg, base.m, base.s, base.A, base.K, base.mol, base.cd, base.rad)
    return Unit(float(base.factor), tuple(Fraction(exponent) for exponent in exponents), float(base.offset))
