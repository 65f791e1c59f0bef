"""FMU files made for tests: any modelDescription.xml, any zip members, and the probe of ``probe/probe.c``."""

from __future__ import annotations

import hashlib
import subprocess
import sys
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import fmpy
import psutil

PROBE_SOURCE = Path(__file__).parent / "probe" / "probe.c"
BUILD = Path(__file__).parent.parent / "build" / "tests"


@dataclass(frozen=True)
class Variable:
    name: str
    causality: str
    reference: int = 0
    type: str = "Real"
    start: str | None = None
    unit: str | None = None
    min: str | None = None
    max: str | None = None
    variability: str | None = None
    depends_on: tuple[str, ...] | None = ()
    """Inputs an output depends on; None writes no ``dependencies`` at all."""
    relative: bool = False
    """Whether a Real is a difference (relativeQuantity)."""
    items: tuple[str, ...] = ()


PROBE = (
    Variable("u", "input", 0, start="0.0", unit="V"),
    Variable("y", "output", 1, unit="V"),
    Variable("z", "output", 2, unit="V", depends_on=("u",)),
    Variable("gain", "parameter", 3, start="1.0", variability="tunable"),
    Variable("time_constant", "parameter", 4, start="0.1", unit="s", min="1e-6"),
    Variable("y_start", "parameter", 5, start="0.0", unit="V"),
    Variable("fail_time", "parameter", 6, start="1e9", unit="s"),
    Variable("clock", "output", 7, unit="s"),
    Variable("count_in", "input", 0, "Integer", start="0"),
    Variable("count", "output", 1, "Integer", depends_on=("count_in",)),
    Variable("fail_status", "parameter", 2, "Integer", start="3", min="0", max="4"),
    Variable("fail_function", "parameter", 3, "Integer", start="0"),
    Variable("solver.steps", "local", 4, "Integer"),
    Variable("sleep", "parameter", 5, "Integer", start="0"),
    Variable("flag_in", "input", 0, "Boolean", start="false"),
    Variable("flag", "output", 1, "Boolean", depends_on=("flag_in",)),
    Variable("label", "parameter", 0, "String", start="probe"),
)


def description(
    variables: Sequence[Variable],
    *,
    name: str = "Probe",
    identifier: str = "probe",
    guid: str = "probe",
    attributes: str = "",
    version: str = "2.0",
    base_units: Mapping[str, str] | None = None,
    experiment: str = "",
) -> str:
    """The text of a modelDescription.xml; ``base_units`` gives the attributes of BaseUnit, ``experiment`` those of
    DefaultExperiment.
    """
    stated = base_units or {}
    numbers = {variable.name: index + 1 for index, variable in enumerate(variables)}
    lines: list[str] = []
    types: list[str] = []
    for variable in variables:
        values = [
            f"{key}={quoteattr(value)}"
            for key, value in (("start", variable.start), ("unit", variable.unit))
            + ((("min", variable.min), ("max", variable.max)) if variable.type != "Boolean" else ())
            if value is not None
        ]
        if variable.relative:
            values.append('relativeQuantity="true"')
        if variable.items:
            types.append(
                f'<SimpleType name="{variable.name}"><Enumeration>'
                + "".join(f'<Item name="{item}" value="{i + 1}"/>' for i, item in enumerate(variable.items))
                + "</Enumeration></SimpleType>"
            )
            values.append(f'declaredType="{variable.name}"')
        default = "fixed" if variable.causality == "parameter" else "continuous"
        default = "discrete" if default == "continuous" and variable.type != "Real" else default
        lines.append(
            f'<ScalarVariable name={quoteattr(variable.name)} valueReference="{variable.reference}" '
            f'causality="{variable.causality}" variability="{variable.variability or default}">'
            f"<{variable.type} {' '.join(values)}/></ScalarVariable>"
        )
    outputs: list[str] = []
    unknowns: list[str] = []
    for variable in variables:
        if variable.causality != "output":
            continue
        known = ""
        if variable.depends_on is not None:
            known = f' dependencies="{" ".join(str(numbers[i]) for i in variable.depends_on)}"'
        outputs.append(f'<Unknown index="{numbers[variable.name]}"{known}/>')
        unknowns.append(f'<Unknown index="{numbers[variable.name]}"/>')
    units = sorted({variable.unit for variable in variables if variable.unit is not None})
    unit_lines = "".join(
        f"<Unit name={quoteattr(unit)}>" + (f"<BaseUnit {stated[unit]}/>" if unit in stated else "") + "</Unit>"
        for unit in units
    )
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        f'<fmiModelDescription fmiVersion="{version}" modelName="{name}" guid="{guid}">'
        f'<CoSimulation modelIdentifier="{identifier}" canHandleVariableCommunicationStepSize="true" {attributes}/>'
        + (f"<UnitDefinitions>{unit_lines}</UnitDefinitions>" if units else "")
        + (f"<TypeDefinitions>{''.join(types)}</TypeDefinitions>" if types else "")
        + '<LogCategories><Category name="logStatusError"/></LogCategories>'
        + (f"<DefaultExperiment {experiment}/>" if experiment else "")
        + f"<ModelVariables>{''.join(lines)}</ModelVariables><ModelStructure>"
        + (f"<Outputs>{''.join(outputs)}</Outputs>" if outputs else "")
        + (f"<InitialUnknowns>{''.join(unknowns)}</InitialUnknowns>" if unknowns else "")
        + "</ModelStructure></fmiModelDescription>\n"
    )


def library_name(identifier: str = "probe", platform: str = fmpy.platform) -> str:
    extension = {"win64": ".dll", "darwin64": ".dylib"}.get(platform, ".so")
    return f"binaries/{platform}/{identifier}{extension}"


def write_zip(path: Path, members: Mapping[str, bytes | str]) -> Path:
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return path


def write_fmu(path: Path, variables: Sequence[Variable], *, binary: bytes = b"", **header: Any) -> Path:
    """An FMU that can be described, and run if ``binary`` is a library."""
    text = description(variables, name=path.stem, **header)
    return write_zip(path, {"modelDescription.xml": text, library_name(header.get("identifier", "probe")): binary})


def write_gain(
    folder: Path,
    name: str,
    u: str | None,
    z: str | None,
    *,
    base_units: Mapping[str, str] | None = None,
    experiment: str = "",
    relative: bool = False,
) -> Path:
    """The probe as ``folder/name.fmu`` with an input ``u`` and an output ``z = gain*u`` in these units."""
    units = {"u": u, "z": z}
    variables = [
        replace(v, unit=units.get(v.name), relative=relative and v.name in units)
        for v in PROBE
        if v.name in ("u", "z", "gain")
    ]
    binary = probe_library().read_bytes()
    return write_fmu(folder / f"{name}.fmu", variables, binary=binary, base_units=base_units, experiment=experiment)


def probe_library(name: str = "probe") -> Path:
    """The probe, or another source beside it, compiled for this machine; compiled again when a source changes."""
    path = PROBE_SOURCE.with_name(f"{name}.c")
    source = path.read_bytes() + PROBE_SOURCE.read_bytes() + PROBE_SOURCE.with_name("probe3.c").read_bytes()
    library = BUILD / f"{name}-{hashlib.sha256(source).hexdigest()[:16]}{Path(library_name()).suffix}"
    if not library.exists():
        BUILD.mkdir(parents=True, exist_ok=True)
        made = library.with_suffix(".part")
        include = Path(fmpy.__file__).parent / "c-code"
        flags = ["-O2", "-g0", "-Wall", "-Wextra", "-shared", "-fPIC", f"-I{include}"]
        command = [sys.executable, "-m", "ziglang", "cc", *flags, "-o", str(made), str(path), "-lm"]
        subprocess.run(command, check=True)
        made.replace(library)
    return library


def write_probe(folder: Path, name: str = "Probe", **units: str) -> Path:
    """The probe as ``folder/name.fmu``; ``units`` replaces the units of variables."""
    variables = [replace(v, unit=units.get(v.name, v.unit)) for v in PROBE]
    return write_fmu(folder / f"{name}.fmu", variables, binary=probe_library().read_bytes())


TYPES3 = ("Float64", "Float32", "Int8", "UInt8", "Int16", "UInt16", "Int32", "UInt32", "Int64", "UInt64", "Boolean")
"""The types of FMI 3.0 of which ``echo3.c`` has arrays."""


def description3(
    *, interface: str = "CoSimulation", version: str = "3.0", more: str = "", starts: Mapping[str, str] | None = None
) -> str:
    """The text of a modelDescription.xml for ``echo3.c``, with ``more`` variables; start values by type."""
    given = starts or {}
    arrays: list[str] = []
    for number, type_name in enumerate(TYPES3):
        start = given.get(type_name, "false" if type_name == "Boolean" else "0")
        arrays.append(
            f'<{type_name} name="u_{type_name}" valueReference="{30 + number}" causality="input" start="{start}">'
            f'<Dimension start="3"/></{type_name}>'
            f'<{type_name} name="y_{type_name}" valueReference="{50 + number}" causality="output">'
            f'<Dimension start="3"/></{type_name}>'
        )
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        f'<fmiModelDescription fmiVersion="{version}" modelName="Echo" instantiationToken="probe">'
        f'<{interface} modelIdentifier="echo3"/><ModelVariables>'
        '<Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>'
        '<Float64 name="u" valueReference="1" causality="input" start="0"/>'
        '<Float64 name="y" valueReference="2" causality="output"><Dimension start="2"/></Float64>'
        '<Float64 name="gain" valueReference="3" causality="parameter" variability="fixed" start="1"/>'
        '<Float64 name="terminate_at" valueReference="20" causality="parameter" variability="fixed" start="1e9"/>'
        '<Float64 name="early_at" valueReference="21" causality="parameter" variability="fixed" start="1e9"/>'
        f"{''.join(arrays)}{more}</ModelVariables>"
        '<ModelStructure><Output valueReference="2"/></ModelStructure></fmiModelDescription>\n'
    )


def write_echo3(path: Path, **header: Any) -> Path:
    """The FMI 3.0 probe with arrays of every type."""
    tuple_name = {"linux64": "x86_64-linux", "win64": "x86_64-windows", "darwin64": "x86_64-darwin"}
    platform = tuple_name.get(fmpy.platform, fmpy.platform)
    library = f"binaries/{platform}/echo3{Path(library_name()).suffix}"
    return write_zip(
        path, {"modelDescription.xml": description3(**header), library: probe_library("echo3").read_bytes()}
    )


def strays() -> list[psutil.Process]:
    """Processes that the hostile FMU has started in a session of their own."""
    found = psutil.process_iter(["name", "status"])
    return [p for p in found if p.info["name"] == "cosim-stray" and p.info["status"] != psutil.STATUS_ZOMBIE]
