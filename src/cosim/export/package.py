"""From a component to a file NAME.fmu: trace, compile for each platform, zip. Equal sources give equal bytes."""

from __future__ import annotations

import hashlib
import importlib.metadata
import uuid
from collections.abc import Mapping, Sequence
from pathlib import Path

from ..fmu.archive import write_zip
from ..model import Component
from ..version import VERSION
from .assets import assets
from .compile import COMMON_SOURCES, RUNTIME, SOURCES, TARGETS, TUPLES, BuildError, compile_binary, host_platform
from .contract import Fmi, header
from .python.python_package import BINARIES, PROXY, external_dependencies, library, resources


def build(kind: type[Component], output: Path, cache: Path, platforms: Sequence[str] = (), fmi: Fmi = 2) -> Path:
    """Export ``kind`` as a native co-simulation FMU of FMI 2.0 or 3.0; returns the path of ``output/NAME.fmu``.

    ``platforms`` are keys of ``TARGETS``, by default this machine's. ``cache`` keeps compiled binaries.
    Raises DescriptionError for a wrong declaration, TraceError for equations that cannot be traced, BuildError for C
    that does not compile, FileError for a file that cannot be written.
    """
    from .fmi2_xml import build_description, model_description
    from .fmi3_xml import model_description3
    from .model_c import model_c
    from .page import documentation
    from .trace import trace

    traced = trace(kind)

    def described(guid: str) -> bytes:
        if fmi == 3:
            return model_description3(traced, guid, VERSION)
        return model_description(traced, guid, VERSION, sources=SOURCES)

    names = sorted((*COMMON_SOURCES, f"fmi{fmi}.c", f"fmi{fmi}.h"))
    runtime = {name: (RUNTIME / name).read_bytes() for name in names} | {"contract.h": header(fmi).encode()}
    guid = _guid(described("") + model_c(traced, "", fmi).encode(), *(runtime[name] for name in sorted(runtime)))
    sources = {"model.c": model_c(traced, guid, fmi).encode(), **runtime}
    files = {
        "modelDescription.xml": described(guid),
        "documentation/index.html": documentation(traced, VERSION, fmi=fmi),
        **_common(kind, fmi),
        "sources/buildDescription.xml": build_description(kind, SOURCES),
        **{f"sources/{name}": content for name, content in sources.items()},
    }
    for name in platforms or (host_platform(),):
        for folder in TUPLES[name] if fmi == 3 else (name,):
            files[f"binaries/{folder}/{kind.__name__}{TARGETS[name][1]}"] = compile_binary(sources, name, cache)
    return _written(output / f"{kind.__name__}.fmu", files)


def build_python(kind: type[Component], output: Path, cache: Path, platforms: Sequence[str] = ()) -> Path:
    """Export ``kind`` as an FMI 2.0 co-simulation FMU that runs its Python methods; returns ``output/NAME.fmu``.

    ``platforms`` are keys of ``python_package.BINARIES``, by default this machine's. Raises what ``build`` raises, as
    dependencies come from the trace, and EmbedError.
    """
    from .fmi2_xml import model_description
    from .page import documentation
    from .trace import trace

    traced = trace(kind)
    blank = model_description(traced, "", VERSION, sources=(), native=False)
    embedded = resources(kind)
    proxy = {path.name: path.read_bytes() for path in (PROXY, RUNTIME / "fmi2.h", RUNTIME / "log.h")}
    proxy["contract.h"] = header(2).encode()
    chosen = platforms or (host_platform(),)
    libraries = {name: library(name) for name in chosen}
    parts = (blank, *(path.encode() + b"\0" + embedded[path] for path in sorted(embedded)), *proxy.values())
    guid = _guid(*parts)
    files = {
        "modelDescription.xml": model_description(traced, guid, VERSION, sources=(), native=False),
        "documentation/index.html": documentation(traced, VERSION, native=False),
        "documentation/licenses/pythonfmu.txt": _licence("pythonfmu"),
        "documentation/externalDependencies.txt": external_dependencies(kind).encode(),
        **_common(kind, 2),
        "resources/guid.txt": guid.encode(),
        **{f"resources/{path}": content for path, content in embedded.items()},
    }
    for name in chosen:
        ending = TARGETS[name][1]
        files[f"binaries/{name}/{kind.__name__}{ending}"] = compile_binary(proxy, name, cache, ("proxy.c",))
        files[f"binaries/{name}/{BINARIES[name]}"] = libraries[name]
    return _written(output / f"{kind.__name__}.fmu", files)


def _common(kind: type[Component], fmi: Fmi) -> dict[str, bytes]:
    """The members of an FMU that do not depend on its flavour."""
    from .terminals import terminals_and_icons

    return {
        "documentation/licenses/license.txt": _own_licence(),
        "terminalsAndIcons/terminalsAndIcons.xml": terminals_and_icons(kind),
        **assets(kind, fmi),
    }


def _written(target: Path, files: Mapping[str, bytes]) -> Path:
    write_zip(target, files, "modelDescription.xml")
    return target


def _own_licence() -> bytes:
    """The licence of the C and Python code that an FMU carries, in a work tree or installed."""
    here = Path(__file__).parents[3] / "LICENSE"
    return here.read_bytes() if here.is_file() else _licence("motion-cosim")


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
