"""From a component to a file NAME.fmu: trace, compile for each platform, zip. Equal sources give equal bytes."""

from __future__ import annotations

import hashlib
import importlib.metadata
import os
import uuid
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from ..model import Component
from .assets import assets
from .compile import COMMON_SOURCES, RUNTIME, SOURCES, TARGETS, TUPLES, BuildError, compile_binary, host_platform
from .interface import Fmi
from .python.python_package import BINARIES, PROXY, library, resources


def build(kind: type[Component], output: Path, cache: Path, platforms: Sequence[str] = (), fmi: Fmi = 2) -> Path:
    """Export ``kind`` as a native co-simulation FMU of FMI 2.0 or 3.0; returns the path of ``output/NAME.fmu``.

    ``platforms`` are keys of ``TARGETS``, by default this machine's. ``cache`` keeps compiled binaries.
    Raises TraceError for equations that cannot be traced, BuildError for C that does not compile.
    """
    from .fmi2_xml import build_description, model_description
    from .fmi3_xml import model_description3
    from .model_c import model_c
    from .page import documentation
    from .trace import trace

    version = importlib.metadata.version("motion-cosim")
    traced = trace(kind)

    def described(guid: str) -> bytes:
        if fmi == 3:
            return model_description3(traced, guid, version)
        return model_description(traced, guid, version, sources=SOURCES)

    names = sorted((*COMMON_SOURCES, f"fmi{fmi}.c", f"fmi{fmi}.h"))
    runtime = {name: (RUNTIME / name).read_bytes() for name in names}
    guid = _guid(described("") + model_c(traced, "", fmi).encode(), *runtime.values())
    sources = {"model.c": model_c(traced, guid, fmi).encode(), **runtime}
    files = {
        "modelDescription.xml": described(guid),
        "documentation/index.html": documentation(traced, version, fmi=fmi),
        **_common(kind, fmi),
        "sources/buildDescription.xml": build_description(kind, SOURCES),
        **{f"sources/{name}": content for name, content in sources.items()},
    }
    for name in platforms or (host_platform(),):
        for folder in TUPLES[name] if fmi == 3 else (name,):
            files[f"binaries/{folder}/{kind.__name__}{TARGETS[name][1]}"] = compile_binary(sources, name, cache)
    target = output / f"{kind.__name__}.fmu"
    write_zip(target, files)
    return target


def build_python(
    kind: type[Component], output: Path, cache: Path, platforms: Sequence[str] = (), root: Path | None = None
) -> Path:
    """Export ``kind`` as an FMI 2.0 co-simulation FMU that runs its Python methods; returns ``output/NAME.fmu``.

    ``platforms`` are keys of ``python_package.BINARIES``, by default this machine's; ``root`` holds the component's
    package ``fmus``. Raises TraceError, as dependencies come from the trace, EmbedError and BuildError.
    """
    from .fmi2_xml import model_description
    from .page import documentation
    from .trace import trace

    version = importlib.metadata.version("motion-cosim")
    traced = trace(kind)
    blank = model_description(traced, "", version, sources=(), native=False)
    embedded = resources(kind, root or Path(__file__).parents[3])
    proxy = {name: path.read_bytes() for name, path in (("proxy.c", PROXY), ("fmi2.h", RUNTIME / "fmi2.h"))}
    chosen = platforms or (host_platform(),)
    libraries = {name: library(name) for name in chosen}
    parts = (blank, *(path.encode() + b"\0" + embedded[path] for path in sorted(embedded)), *proxy.values())
    guid = _guid(*parts)
    files = {
        "modelDescription.xml": model_description(traced, guid, version, sources=(), native=False),
        "documentation/index.html": documentation(traced, version, native=False),
        "documentation/licenses/pythonfmu.txt": _licence("pythonfmu"),
        **_common(kind, 2),
        "resources/guid.txt": guid.encode(),
        **{f"resources/{path}": content for path, content in embedded.items()},
    }
    for name in chosen:
        ending = TARGETS[name][1]
        files[f"binaries/{name}/{kind.__name__}{ending}"] = compile_binary(proxy, name, cache, ("proxy.c",))
        files[f"binaries/{name}/{BINARIES[name]}"] = libraries[name]
    target = output / f"{kind.__name__}.fmu"
    write_zip(target, files)
    return target


def _common(kind: type[Component], fmi: Fmi) -> dict[str, bytes]:
    """The members of an FMU that do not depend on its flavour."""
    from .terminals import terminals_and_icons

    return {
        "documentation/licenses/license.txt": (Path(__file__).parents[3] / "LICENSE").read_bytes(),
        "terminalsAndIcons/terminalsAndIcons.xml": terminals_and_icons(kind),
        **assets(kind, fmi),
    }


def _licence(distribution: str) -> bytes:
    """The licence text of an installed package."""
    for path in importlib.metadata.files(distribution) or ():
        if path.name.upper().startswith("LICEN"):
            return Path(str(path.locate())).read_bytes()
    raise BuildError(f"{distribution} is installed without its licence. Install it again.")


def _guid(*parts: bytes) -> str:
    digest = hashlib.sha256()
    for part in parts:
        digest.update(hashlib.sha256(part).digest())
    return f"{{{uuid.UUID(bytes=digest.digest()[:16])}}}"


def write_zip(target: Path, files: Mapping[str, bytes]) -> None:
    """Write a zip whose bytes depend on ``files`` only: sorted, stored, one date; replaced in one go."""
    target.parent.mkdir(parents=True, exist_ok=True)
    partial = target.with_suffix(f".{os.getpid()}.part")
    with zipfile.ZipFile(partial, "w", zipfile.ZIP_STORED) as archive:
        for name in sorted(files, key=lambda name: (name != "modelDescription.xml", name)):
            entry = zipfile.ZipInfo(name, (2026, 1, 1, 0, 0, 0))
            entry.create_system = 3
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, files[name])
    partial.replace(target)
