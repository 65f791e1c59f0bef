"""The places of components, and which of their FMUs are out of date."""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import time
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from ..errors import CosimError, DescriptionError, suggest
from ..model import Component
from .assets import asset_files
from .compile import RUNTIME
from .package import build, build_python
from .python.python_package import PROXY
from .source_files import load_component, needed_files, origin

Flavour = Literal["native", "python", "fmi3"]
"""Kind of FMU: FMI 2.0 native, FMI 2.0 by PythonFMU, FMI 3.0 native. Each is also the name of its folder."""


@dataclass(frozen=True)
class Workspace:
    """The places of components and of the build cache.

    ``root`` is the folder with the library ``fmus/``. ``cache`` holds files that can be made again. ``files`` are
    components of the user: name -> file.
    """

    root: Path
    cache: Path
    files: tuple[tuple[str, Path], ...] = ()

    def components(self) -> dict[str, Path]:
        """Component name -> its file; ``ballscrew_stage.py`` holds ``BallscrewStage``."""
        library = [
            path
            for room in ("plant", "controllers", "sources")
            for path in sorted((self.root / "fmus" / room).glob("*.py"))
            if path.stem != "__init__"
        ]
        return {"".join(part.capitalize() for part in path.stem.split("_")): path for path in library} | dict(
            self.files
        )

    def component(self, name: str) -> type[Component]:
        """Import a component by name. Raises DescriptionError that names file and line."""
        return load_component(self.components()[name], name)

    def select(self, names: Sequence[str]) -> list[str]:
        """The named components, or all. Raises DescriptionError listing every unknown name."""
        workspace, found = self.choose(names or tuple(self.components()))
        if workspace.files != self.files:
            raise DescriptionError("give names of components, no files.")
        return found

    def choose(self, references: Sequence[str]) -> tuple[Workspace, list[str]]:
        """A workspace that also has the components of the files named, and the names of all components selected.

        A reference is the name of a component, FILE.py or FILE.py:NAME. Raises DescriptionError with all problems.
        """
        files, names = dict(self.files), dict[str, None]()
        problems: list[str] = []
        known = self.components()
        for reference in references:
            file, colon, name = reference.rpartition(":")
            if not (colon and file.endswith(".py")):
                file, name = reference, ""
            try:
                if not file.endswith(".py"):
                    if file not in known:
                        raise DescriptionError(
                            f"no component '{file}'.{suggest(file, known)} For a component of your own give FILE.py."
                        )
                    names[file] = None
                    continue
                path = Path(file).resolve()
                name = load_component(path, name or None).__name__
                if files.get(name, path) != path:
                    raise DescriptionError(f"{path.name} and {files[name].name} both hold {name}. Rename one of them.")
                files[name] = path
                names[name] = None
            except DescriptionError as error:
                problems += error.problems
        if problems:
            raise DescriptionError(problems)
        return replace(self, files=tuple(files.items())), list(names)

    def sources(self, name: str, flavour: Flavour = "native") -> str:
        """A hash of the project's files that the FMU is made from. It needs none of the tools that build FMUs."""
        package, path = Path(__file__).parents[1], self.components()[name]
        files = [
            *needed_files(origin(path), path).values(),
            *(package / f"{module}.py" for module in ("model", "units", "errors", "fmu/xml", "fmu/archive")),
            *sorted(Path(__file__).parent.rglob("*.py")),
            *sorted(Path(__file__).parent.glob("*.j2")),
            *sorted(RUNTIME.glob("*.[ch]")),
            *asset_files(path, name),
            *((PROXY,) if flavour == "python" else ()),
        ]
        digest = hashlib.sha256()
        for file in files:
            digest.update(file.name.encode() + b"\0" + file.read_bytes() + b"\0")
        return digest.hexdigest()

    def key(self, name: str, platforms: Iterable[str], flavour: Flavour = "native") -> str:
        """A hash of everything the FMU is made from; as long as it is the same, the FMU need not be rebuilt."""
        digest = hashlib.sha256(self.sources(name, flavour).encode())
        for package_name in ("casadi", "ziglang", "motion-cosim", *(("pythonfmu",) if flavour == "python" else ())):
            digest.update(importlib.metadata.version(package_name).encode() + b"\0")
        digest.update(" ".join((flavour, *sorted(platforms))).encode())
        return digest.hexdigest()

    def stale(
        self, names: Iterable[str], output: Path, platforms: Sequence[str], flavour: Flavour = "native"
    ) -> list[str]:
        """The names of the components whose FMU in ``output`` is missing or out of date."""
        return [name for name in names if not self.is_current(name, platforms, output / f"{name}.fmu", flavour)]

    def build(
        self, names: Sequence[str], output: Path, platforms: Sequence[str], flavour: Flavour = "native"
    ) -> Iterator[tuple[str, float, CosimError | None]]:
        """Build FMUs in parallel. As each one ends, yields its name, its build time in s and its error, or None."""
        with ProcessPoolExecutor() as pool:
            running = {pool.submit(_timed_build, self, name, output, tuple(platforms), flavour): name for name in names}
            for future in as_completed(running):
                try:
                    yield running[future], future.result(), None
                except CosimError as error:
                    yield running[future], 0.0, error

    def is_current(self, name: str, platforms: Sequence[str], target: Path, flavour: Flavour = "native") -> bool:
        """Whether the FMU ``target`` is up to date."""
        return self._known(target, key=self.key(name, platforms, flavour))

    def has_these_sources(self, name: str, target: Path) -> bool:
        """Whether the native FMU ``target`` was built from the present sources, by any tools, for any platforms."""
        return self._known(target, sources=self.sources(name, "native"))

    def remember(
        self,
        name: str,
        platforms: Sequence[str],
        target: Path,
        flavour: Flavour = "native",
        remarks: Sequence[str] = (),
    ) -> None:
        """Note that ``target`` has just been built, with ``remarks`` for its author."""
        stamp = self._stamp(target)
        stamp.parent.mkdir(parents=True, exist_ok=True)
        entry: dict[str, Any] = {"key": self.key(name, platforms, flavour), "sources": self.sources(name, flavour)}
        entry |= {"sha256": hashlib.sha256(target.read_bytes()).hexdigest(), "remarks": list(remarks)}
        stamp.write_text(json.dumps(entry))

    def remarks(self, target: Path) -> list[str]:
        """The remarks for the author of the FMU ``target``, from when it was built."""
        stamp = self._stamp(target)
        return list(json.loads(stamp.read_text()).get("remarks", ())) if stamp.is_file() else []

    def _known(self, target: Path, **wanted: str) -> bool:
        """Whether ``target`` is unchanged since its stamp was written, and the stamp has the values ``wanted``."""
        stamp = self._stamp(target)
        if not (target.is_file() and stamp.is_file()):
            return False
        known = json.loads(stamp.read_text())
        return {**known, **wanted, "sha256": hashlib.sha256(target.read_bytes()).hexdigest()} == known

    def _stamp(self, target: Path) -> Path:
        place = hashlib.sha256(str(target.resolve().parent).encode()).hexdigest()[:8]
        return self.cache / "fmus" / f"{target.stem}-{place}.json"


def _timed_build(workspace: Workspace, name: str, output: Path, platforms: tuple[str, ...], flavour: Flavour) -> float:
    from .trace import trace  # imports CasADi: only for builds

    start = time.perf_counter()
    kind = workspace.component(name)
    if flavour == "python":
        target = build_python(kind, output, workspace.cache, platforms)
    else:
        target = build(kind, output, workspace.cache, platforms, 3 if flavour == "fmi3" else 2)
    workspace.remember(name, platforms, target, flavour, trace(kind).remarks)  # the trace of this build
    return time.perf_counter() - start
