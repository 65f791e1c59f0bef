"""The binaries of the FMUs of all platforms, looked at without running them; ``make platforms`` runs it.

Not part of the normal suite: the first compilation for Windows takes minutes.
"""

from __future__ import annotations

import re
import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import lief
import pytest
from conftest import ROOT, WORKSPACE
from fmpy.fmi2 import FMU2Model, FMU2Slave
from fmpy.fmi3 import FMU3Model, FMU3Slave

from cosim.export.compile import TARGETS, TUPLES
from cosim.export.workspace import Flavour

COMPONENTS = sorted(WORKSPACE.components())
FUNCTIONS: Mapping[Flavour, set[str]] = {
    "native": {name for name in dir(FMU2Slave) + dir(FMU2Model) if name.startswith("fmi2")},
    "fmi3": {name for name in dir(FMU3Slave) + dir(FMU3Model) if name.startswith("fmi3")},
}
"""The functions that FMPy looks for."""
GLIBC = (2, 17)
PAGE = 1 << 14
"""Slices of a universal binary start at a page of Apple silicon."""
LINKER_MARKS = {"__mh_dylib_header", "___dso_handle"}
"""Symbols that zig's linker defines in every macOS library."""


@dataclass(frozen=True)
class Release:
    """FMUs of all platforms."""

    flavour: Flavour
    folder: Path

    @property
    def functions(self) -> set[str]:
        return FUNCTIONS[self.flavour]

    def binaries(self, platform: str) -> Iterator[tuple[str, bytes]]:
        """The library of every component for a platform; FMI 3.0 has one of its own for Apple silicon."""
        place = TUPLES[platform][0] if self.flavour == "fmi3" else platform
        for name in COMPONENTS:
            with zipfile.ZipFile(self.folder / f"{name}.fmu") as archive:
                yield name, archive.read(f"binaries/{place}/{name}{TARGETS[platform][1]}")


@pytest.fixture(scope="module", params=["native", "fmi3"])
def release(request: pytest.FixtureRequest) -> Release:
    """The FMUs that go into the wheel, and those of FMI 3.0."""
    folder = ROOT / "build" / "fmus" / ("release" if request.param == "native" else "release-fmi3")
    stale = WORKSPACE.stale(COMPONENTS, folder, tuple(TARGETS), request.param)
    found = WORKSPACE.build(stale, folder, tuple(TARGETS), request.param)
    problems = [str(error) for _, _, error in found if error]
    assert not problems, "\n".join(problems)
    return Release(request.param, folder)


def test_the_functions_looked_for_are_those_of_the_standards() -> None:
    assert {flavour: len(names) for flavour, names in FUNCTIONS.items()} == {"native": 44, "fmi3": 75}
    assert {"fmi2Instantiate", "fmi2DoStep", "fmi2GetDerivatives"} <= FUNCTIONS["native"]
    assert {"fmi3InstantiateCoSimulation", "fmi3DoStep", "fmi3UpdateDiscreteStates"} <= FUNCTIONS["fmi3"]


@pytest.mark.parametrize("platform", TARGETS)
def test_no_path_of_the_build_is_in_a_binary(release: Release, platform: str) -> None:
    for name, content in release.binaries(platform):
        assert str(ROOT).encode() not in content, name
        assert b"ziglang" not in content, name


@pytest.mark.parametrize(
    ("platform", "machine"), [("linux64", lief.ELF.ARCH.X86_64), ("aarch64-linux", lief.ELF.ARCH.AARCH64)]
)
def test_linux(release: Release, platform: str, machine: lief.ELF.ARCH) -> None:
    for name, content in release.binaries(platform):
        library = lief.ELF.parse(list(content))
        assert library is not None, name
        assert library.header.machine_type == machine, name
        assert {symbol.name for symbol in library.exported_symbols} == release.functions, name
        assert set(library.libraries) <= {"libc.so.6", "libm.so.6"}, name
        assert not library.has(lief.ELF.DynamicEntry.TAG.RPATH), name
        assert not library.has(lief.ELF.DynamicEntry.TAG.RUNPATH), name
        needed = {v.name for r in library.symbols_version_requirement for v in r.get_auxiliary_symbols()}
        versions = [tuple(map(int, version.removeprefix("GLIBC_").split("."))) for version in needed]
        assert versions, name
        assert max(versions) <= GLIBC, f"{name} needs {needed}"


def test_windows(release: Release) -> None:
    for name, content in release.binaries("win64"):
        library = lief.PE.parse(list(content))
        assert library is not None, name
        assert library.header.machine == lief.PE.Header.MACHINE_TYPES.AMD64, name
        exported = library.get_export()
        assert exported is not None, name
        assert {entry.name for entry in exported.entries} == release.functions, name
        foreign = [
            i.name
            for i in library.imports
            if not re.fullmatch(r"api-ms-win-crt-[\w-]+\.dll|KERNEL32\.dll", str(i.name))
        ]
        assert foreign == [], name


@pytest.mark.parametrize(
    ("platform", "machines"),
    [
        ("darwin64", [lief.MachO.Header.CPU_TYPE.X86_64, lief.MachO.Header.CPU_TYPE.ARM64]),
        ("aarch64-darwin", [lief.MachO.Header.CPU_TYPE.ARM64]),
    ],
)
def test_macos(release: Release, platform: str, machines: list[lief.MachO.Header.CPU_TYPE]) -> None:
    for name, content in release.binaries(platform):
        universal = lief.MachO.parse(list(content))
        assert universal is not None, name
        slices = [universal.at(k) for k in range(universal.size)]
        assert [library.header.cpu_type for library in slices] == machines, name
        for library in slices:
            exported = {symbol.name for symbol in library.exported_symbols}
            assert exported - LINKER_MARKS == {f"_{function}" for function in release.functions}, name
            assert [used.name for used in library.libraries] == ["model.dylib", "/usr/lib/libSystem.B.dylib"], name
            assert not library.has_rpath, name
            assert library.fat_offset % PAGE == 0, name
            if library.header.cpu_type == lief.MachO.Header.CPU_TYPE.ARM64:
                # Apple silicon loads nothing unsigned
                assert library.has_code_signature, name
                assert library.build_version.minos == [11, 0, 0], name
            else:
                assert library.version_min.version == [10, 13, 0], name
