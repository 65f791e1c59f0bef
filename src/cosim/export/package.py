"""From a component to a file NAME.fmu: trace, compile for each platform, zip. Equal sources give equal bytes."""

from __future__ import annotations

import hashlib
import importlib
import importlib.metadata
import json
import os
import platform
import struct
import subprocess
import sys
import tempfile
import time
import uuid
import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from ..errors import CosimError, DescriptionError, suggest
from ..model import Component
from .embed import BINARIES, PROXY, library, resources
from .layout import Fmi
from .reference import asset_files, assets

Flavour = Literal["native", "python", "fmi3"]
"""FMI 2.0 native and with PythonFMU, FMI 3.0 native; also the names of the folders of each."""
NATIVE = Path(__file__).with_name("native")
RUNTIME = ("core.c", "integrator.c", "integrator.h")
SOURCES = ("model.c",)
LIBRARIES = {"loop.c": "-lm", "model.c": "-lm", "proxy.c": "-ldl"}
FLAGS = (
    "-std=c99",
    "-O2",
    "-g0",
    "-s",
    "-shared",
    "-fPIC",
    "-fvisibility=hidden",
    "-ffp-contract=off",
    "-fno-math-errno",
    "-fno-trapping-math",
    "-fno-sanitize=undefined",
    "-Wall",
    "-Wextra",
    "-Werror",
)
TARGETS: Mapping[str, tuple[tuple[str, ...], str]] = {
    "linux64": (("x86_64-linux-gnu.2.17",), ".so"),
    "win64": (("x86_64-windows-gnu",), ".dll"),
    "darwin64": (("x86_64-macos.10.13", "aarch64-macos.11.0"), ".dylib"),
    "aarch64-linux": (("aarch64-linux-gnu.2.17",), ".so"),
    "aarch64-darwin": (("aarch64-macos.11.0",), ".dylib"),
}
"""Platform folder of an FMU -> compiler targets (two make a universal binary) and file ending."""
TUPLES: Mapping[str, tuple[str, ...]] = {
    "linux64": ("x86_64-linux",),
    "win64": ("x86_64-windows",),
    "darwin64": ("x86_64-darwin", "aarch64-darwin"),
    "aarch64-linux": ("aarch64-linux",),
    "aarch64-darwin": ("aarch64-darwin",),
}
"""The folders of FMI 3.0 for the platforms of ``TARGETS``; of two binaries for one folder the later is taken."""


class BuildError(CosimError):
    """The C compiler refused the generated sources; the text is its own."""


def host_platform() -> str:
    """The platform folder of this machine. Raises DescriptionError where none fits."""
    machine = {"amd64": "x86_64", "x86_64": "x86_64", "arm64": "aarch64", "aarch64": "aarch64"}.get(
        platform.machine().lower()
    )
    known = {
        ("Linux", "x86_64"): "linux64",
        ("Linux", "aarch64"): "aarch64-linux",
        ("Windows", "x86_64"): "win64",
        ("Darwin", "x86_64"): "darwin64",
        ("Darwin", "aarch64"): "darwin64",
    }
    found = known.get((platform.system(), machine or ""))
    if found is None:
        raise DescriptionError(
            f"no FMU platform for {platform.system()} on {platform.machine()}. Name one of: {', '.join(TARGETS)}."
        )
    return found


@dataclass(frozen=True)
class Workspace:
    """Where components are found and FMUs are put: ``root`` holds ``fmus/``, ``cache`` what can be made again."""

    root: Path
    cache: Path

    def components(self) -> dict[str, Path]:
        """Component name -> its file; ``ballscrew_stage.py`` holds ``BallscrewStage``."""
        files = [
            path
            for room in ("plant", "controllers", "sources")
            for path in sorted((self.root / "fmus" / room).glob("*.py"))
            if path.stem != "__init__"
        ]
        return {"".join(part.capitalize() for part in path.stem.split("_")): path for path in files}

    def component(self, name: str) -> type[Component]:
        """Import a component by name."""
        path = self.components()[name]
        module = importlib.import_module(".".join(path.relative_to(self.root).with_suffix("").parts))
        return getattr(module, name)

    def select(self, names: Sequence[str]) -> list[str]:
        """The named components, or all. Raises DescriptionError listing every unknown name."""
        known = self.components()
        unknown = [name for name in names if name not in known]
        if unknown:
            raise DescriptionError([f"no component '{name}'.{suggest(name, known)}" for name in unknown])
        return list(names or known)

    def sources(self, name: str, flavour: Flavour = "native") -> str:
        """A hash of the files of this project that the FMU is made from; it needs no tool that builds FMUs."""
        package = Path(__file__).parents[1]
        files = [
            self.components()[name],
            *sorted((self.root / "fmus" / "physics").glob("*.py")),
            *(package / f"{module}.py" for module in ("model", "units", "errors", "xmlfile")),
            *sorted(Path(__file__).parent.glob("*.py")),
            *sorted(NATIVE.glob("*.[ch]")),
            *asset_files(self.components()[name]),
            *((PROXY,) if flavour == "python" else ()),
        ]
        digest = hashlib.sha256()
        for path in files:
            digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
        return digest.hexdigest()

    def key(self, name: str, platforms: Iterable[str], flavour: Flavour = "native") -> str:
        """A hash of everything the FMU is made from: while it stands, the FMU need not be rebuilt."""
        digest = hashlib.sha256(self.sources(name, flavour).encode())
        for package_name in ("casadi", "ziglang", "motion-cosim", *(("pythonfmu",) if flavour == "python" else ())):
            digest.update(importlib.metadata.version(package_name).encode() + b"\0")
        digest.update(" ".join((flavour, *sorted(platforms))).encode())
        return digest.hexdigest()

    def stale(
        self, names: Iterable[str], output: Path, platforms: Sequence[str], flavour: Flavour = "native"
    ) -> list[str]:
        """Those of the components whose FMU in ``output`` is missing or not what would be built now."""
        return [name for name in names if not self.is_current(name, platforms, output / f"{name}.fmu", flavour)]

    def build(
        self, names: Sequence[str], output: Path, platforms: Sequence[str], flavour: Flavour = "native"
    ) -> Iterator[tuple[str, float, CosimError | None]]:
        """Build FMUs in parallel; yields name, seconds and what went wrong as each is done."""
        with ProcessPoolExecutor() as pool:
            running = {pool.submit(_timed_build, self, name, output, tuple(platforms), flavour): name for name in names}
            for future in as_completed(running):
                try:
                    yield running[future], future.result(), None
                except CosimError as error:
                    yield running[future], 0.0, error

    def is_current(self, name: str, platforms: Sequence[str], target: Path, flavour: Flavour = "native") -> bool:
        """Whether ``target`` is the FMU that would be built now."""
        return self._known(target, key=self.key(name, platforms, flavour))

    def has_these_sources(self, name: str, target: Path, flavour: Flavour = "native") -> bool:
        """Whether ``target`` was built from these files, whatever built it and for which platforms."""
        return self._known(target, sources=self.sources(name, flavour))

    def remember(self, name: str, platforms: Sequence[str], target: Path, flavour: Flavour = "native") -> None:
        """Note that ``target`` has just been built."""
        stamp = self._stamp(target)
        stamp.parent.mkdir(parents=True, exist_ok=True)
        entry = {"key": self.key(name, platforms, flavour), "sources": self.sources(name, flavour)}
        stamp.write_text(json.dumps({**entry, "sha256": hashlib.sha256(target.read_bytes()).hexdigest()}))

    def _known(self, target: Path, **wanted: str) -> bool:
        """Whether ``target`` is as it was when its stamp was written, and the stamp says what is wanted."""
        stamp = self._stamp(target)
        if not (target.is_file() and stamp.is_file()):
            return False
        known = json.loads(stamp.read_text())
        return {**known, **wanted, "sha256": hashlib.sha256(target.read_bytes()).hexdigest()} == known

    def _stamp(self, target: Path) -> Path:
        place = hashlib.sha256(str(target.resolve().parent).encode()).hexdigest()[:8]
        return self.cache / "fmus" / f"{target.stem}-{place}.json"


def _timed_build(workspace: Workspace, name: str, output: Path, platforms: tuple[str, ...], flavour: Flavour) -> float:
    start = time.perf_counter()
    if str(workspace.root) not in sys.path:
        sys.path.insert(0, str(workspace.root))
    kind = workspace.component(name)
    if flavour == "python":
        target = build_python(kind, output, workspace.cache, platforms, workspace.root)
    else:
        target = build(kind, output, workspace.cache, platforms, 3 if flavour == "fmi3" else 2)
    workspace.remember(name, platforms, target, flavour)
    return time.perf_counter() - start


def build(kind: type[Component], output: Path, cache: Path, platforms: Sequence[str] = (), fmi: Fmi = 2) -> Path:
    """Export ``kind`` as a native co-simulation FMU of FMI 2.0 or 3.0; returns the path of ``output/NAME.fmu``.

    ``platforms`` are keys of ``TARGETS``, by default this machine's. ``cache`` keeps compiled binaries.
    Raises TraceError for equations that cannot be traced, BuildError for C that does not compile.
    """
    from .code import model_c
    from .description import build_description, model_description
    from .description3 import model_description3
    from .page import documentation
    from .trace import trace

    version = importlib.metadata.version("motion-cosim")
    traced = trace(kind)

    def described(guid: str) -> bytes:
        if fmi == 3:
            return model_description3(traced, guid, version)
        return model_description(traced, guid, version, sources=SOURCES)

    names = sorted((*RUNTIME, f"fmi{fmi}.c", f"fmi{fmi}.h"))
    runtime = {name: (NATIVE / name).read_bytes() for name in names}
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

    ``platforms`` are keys of ``embed.BINARIES``, by default this machine's; ``root`` holds the component's package
    ``fmus``. Raises TraceError, as dependencies come from the trace, EmbedError and BuildError.
    """
    from .description import model_description
    from .page import documentation
    from .trace import trace

    version = importlib.metadata.version("motion-cosim")
    traced = trace(kind)
    blank = model_description(traced, "", version, sources=(), native=False)
    embedded = resources(kind, root or Path(__file__).parents[3])
    proxy = {name: path.read_bytes() for name, path in (("proxy.c", PROXY), ("fmi2.h", NATIVE / "fmi2.h"))}
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


def compile_binary(sources: Mapping[str, bytes], name: str, cache: Path, compiled: Sequence[str] = SOURCES) -> bytes:
    """The shared library of ``sources`` for platform ``name``, from the cache where nothing changed.

    ``compiled`` names those of the sources that the compiler is given, the others are included by them.
    """
    targets, ending = TARGETS[name]
    slices = [_compile(sources, compiled, target, ending, cache) for target in targets]
    return slices[0] if len(slices) == 1 else _universal(slices)


def _compile(sources: Mapping[str, bytes], compiled: Sequence[str], target: str, ending: str, cache: Path) -> bytes:
    digest = hashlib.sha256(repr((FLAGS, target, importlib.metadata.version("ziglang"))).encode())
    for name in sorted(sources):
        digest.update(name.encode() + b"\0" + sources[name])
    kept = cache / "binaries" / f"{digest.hexdigest()[:32]}{ending}"
    if kept.is_file():
        return kept.read_bytes()
    kept.parent.mkdir(parents=True, exist_ok=True)
    environment = os.environ | {"ZIG_GLOBAL_CACHE_DIR": str((cache / "zig").resolve())}
    with tempfile.TemporaryDirectory() as folder:
        for name, content in sources.items():
            (Path(folder) / name).write_bytes(content)
        # relative names and a fixed output name: no path gets into the binary
        command = [sys.executable, "-m", "ziglang", "cc", "-target", target, *FLAGS, *compiled, "-o", f"model{ending}"]
        if not target.startswith("x86_64-windows"):
            command += [LIBRARIES[name] for name in compiled]
        environment["ZIG_LOCAL_CACHE_DIR"] = str(Path(folder) / "local")
        done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
        if done.returncode:
            raise BuildError(f"compiling for {target} failed:\n{done.stderr.strip()}")
        content = (Path(folder) / f"model{ending}").read_bytes()
    partial = kept.with_suffix(f".{os.getpid()}.part")
    partial.write_bytes(content)
    partial.replace(kept)
    return content


def _universal(slices: Sequence[bytes]) -> bytes:
    """A macOS universal binary: big-endian fat header, then each slice at a 16 kB boundary."""
    alignment = 14
    position = 1 << alignment
    header = struct.pack(">II", 0xCAFEBABE, len(slices))
    body = b""
    for content in slices:
        cpu, subtype = struct.unpack("<II", content[4:12])
        offset = position + len(body)
        header += struct.pack(">IIIII", cpu, subtype, offset, len(content), alignment)
        body += content + b"\0" * (-len(content) % (1 << alignment))
    return header + b"\0" * (position - len(header)) + body
