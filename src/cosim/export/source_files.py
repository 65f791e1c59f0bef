"""The files of a component's author: the component in a file, and the files beside it that it imports."""

from __future__ import annotations

import ast
import contextlib
import importlib
import importlib.util
import inspect
import re
import sys
import tokenize
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from hashlib import sha256
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType
from typing import Any

from ..errors import DescriptionError, TraceError, suggest
from ..model import Component, Controller, Plant, Source
from .place import of_author, of_class, of_error, place

TAKEN = ("cosim", "pythonfmu")
"""Names of packages that a Python FMU holds beside the author's files."""


@dataclass(frozen=True)
class Origin:
    """Where a module is: the folder that imports start from, and the dotted name of the module there."""

    root: Path
    module: str

    def file(self, module: str) -> Path | None:
        """The file of another module of the same folder, None if it is not there."""
        base = self.root.joinpath(*module.split("."))
        found = (base.with_suffix(".py"), base / "__init__.py")
        return next((path for path in found if path.is_file()), None)


def origin(path: Path) -> Origin:
    """The origin of a file. The packages that contain it are part of its module's name."""
    path = path.resolve()
    root, names = path.parent, [re.sub(r"\W", "_", path.stem)]
    while (root / "__init__.py").is_file():
        names.insert(0, root.name)
        root = root.parent
    return Origin(root, ".".join(names))


def component_origin(kind: type[Component]) -> Origin:
    """The origin of the file of a component."""
    return origin(Path(inspect.getfile(kind)))


def is_of_library(kind: type[Component]) -> bool:
    """Whether a component is one of this project's own."""
    return component_origin(kind).module.startswith("fmus.")


# ---- import ----


def load_component(path: Path, name: str | None = None) -> type[Component]:
    """Import the component ``name`` of a file, or its only one.

    Raises DescriptionError with file, line and remedy for a file that cannot be imported or has no such component.
    """
    if path.suffix != ".py" or not path.is_file():
        known = [str(other.name) for other in path.parent.glob("*.py")] if path.parent.is_dir() else []
        raise DescriptionError(f"{path}: there is no such Python file.{suggest(path.name, known)}")
    found = {
        key: value
        for key, value in vars(_imported(path.resolve())).items()
        if isinstance(value, type)
        and issubclass(value, Component)
        and value not in (Plant, Controller, Source, Component)
    }
    own = {key: value for key, value in found.items() if Path(inspect.getfile(value)).resolve() == path.resolve()}
    if name is not None:
        if name not in found:
            raise DescriptionError(f"{path.name}: has no component '{name}'.{suggest(name, own)}")
        return found[name]
    if not own:
        raise DescriptionError(
            f"{path.name}: has no component. Derive a class from Plant, Controller or Source of cosim.model."
        )
    if len(own) > 1:
        listed = "; ".join(f"{key} ({of_class(value)})" for key, value in own.items())
        first = next(iter(own))
        raise DescriptionError(f"{path.name}: has {len(own)} components: {listed}. Name one: {path.name}:{first}")
    return next(iter(own.values()))


def _imported(path: Path) -> ModuleType:
    """The module of a file, imported once. Any error of the import becomes a DescriptionError."""
    where = origin(path)
    if where.module.partition(".")[0] in TAKEN:
        raise DescriptionError(f"{path.name}: the name {where.module} is taken. Give the file another name.")
    if str(where.root) not in sys.path:
        # Behind all others: a file called numpy.py beside the component must not hide NumPy from the other packages.
        sys.path.append(str(where.root))
    _prepare_imports(where, path)
    try:
        return importlib.import_module(where.module) if "." in where.module else _from_file(path, where.module)
    except SyntaxError as error:
        at = place(error.filename or str(path), error.lineno)
        raise DescriptionError(f"{at}: {error.msg}. Python cannot read this line.") from error
    except (DescriptionError, TraceError) as error:
        raise DescriptionError(f"{of_error(error.__traceback__, str(path)) or path.name}: {error}") from error
    except (Exception, SystemExit) as error:
        at = of_error(error.__traceback__) or path.name
        hint = ""
        if isinstance(error, ModuleNotFoundError):
            hint = f" Put {error.name}.py beside {path.name}, or install {error.name}."
        text = f"{type(error).__name__}: {error}".rstrip(": .")
        raise DescriptionError(f"{at}: importing it failed: {text}.{hint}") from error


class _Beside:
    """Finds the files beside the component that is imported, before a module of the same name elsewhere is found."""

    def __init__(self) -> None:
        self.files: dict[str, Path] = {}

    def find_spec(self, name: str, path: object = None, target: object = None) -> ModuleSpec | None:
        """The module of the file called ``name``; None if there is none."""
        file = self.files.get(name)
        return None if file is None else importlib.util.spec_from_file_location(name, file)


_beside = _Beside()


def _prepare_imports(where: Origin, path: Path) -> None:
    """Let the imports of a component find the files beside it.

    A module of the same name that another component imported is forgotten. Raises DescriptionError for each file that
    has the name of an installed module or one of Python: other packages need those.
    """
    if _beside not in sys.meta_path:
        sys.meta_path.insert(0, _beside)
    _beside.files = {}
    problems: list[str] = []
    imported: dict[str, Path] = {}
    with contextlib.suppress(SyntaxError):  # the import tells the line
        for module, file in needed_files(where, path).items():
            imported |= {name.partition(".")[0]: file for name in imported_modules(file, module)}
    for top, file in imported.items():
        beside = where.file(top) if top and top not in TAKEN else None
        if beside is None:
            continue
        other = importlib.util.find_spec(top)
        if other is None or Path(other.origin or "").resolve() == beside.resolve():
            continue
        if other.origin is not None and Path(other.origin).is_file() and of_author(other.origin):
            for name in [name for name in sys.modules if name.partition(".")[0] == top]:
                del sys.modules[name]
            _beside.files[top] = beside
            continue
        mine = beside.parent.name if beside.name == "__init__.py" else beside.name
        problems.append(
            f"{file.name}: 'import {top}' means {mine} beside it, but {top} is a module of Python or installed "
            f"({other.origin}). Rename {mine} and its imports."
        )
    if problems:
        raise DescriptionError(problems)


def _from_file(path: Path, name: str) -> ModuleType:
    """The module of a file outside of packages. Its name is made from its path, so that no other module has it."""
    unique = f"{name}_{sha256(str(path).encode()).hexdigest()[:16]}"
    if unique not in sys.modules:
        spec = importlib.util.spec_from_file_location(unique, path)
        if spec is None or spec.loader is None:
            raise DescriptionError(f"{path}: Python cannot import it.")
        sys.modules[unique] = importlib.util.module_from_spec(spec)
        try:
            spec.loader.exec_module(sys.modules[unique])
        except BaseException:
            del sys.modules[unique]
            raise
    return sys.modules[unique]


# ---- files a component needs ----


def needed_files(where: Origin, path: Path) -> dict[str, Path]:
    """Dotted module name -> file, sorted: the component's module in ``path`` and all it imports from its own folder."""
    found: dict[str, Path] = {}
    pending: list[tuple[str, Path]] = [(where.module, path)]
    while pending:
        module, file = pending.pop()
        if module in found:
            continue
        found[module] = file
        for name in (*imported_modules(file, module), module.rpartition(".")[0]):
            if not name:
                continue
            beside = where.file(name)
            if beside is not None and name.partition(".")[0] not in TAKEN:
                pending.append((name, beside))
    return dict(sorted(found.items()))


def imported_modules(path: Path, module: str) -> Iterator[str]:
    """Full names of the modules that a file imports; ``from a import b`` gives ``a`` and ``a.b``: b may be a module."""
    package = module.split(".") if path.name == "__init__.py" else module.split(".")[:-1]
    for node in ast.walk(ast.parse(path.read_bytes(), path.name)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            name = ".".join([*base, *([node.module] if node.module else [])])
            yield from (name, *(f"{name}.{alias.name}".lstrip(".") for alias in node.names))


def relative_imports(path: Path, module: str, local: Mapping[str, Any]) -> str:
    """The text of a file with its imports of ``cosim`` and of ``local`` modules made relative.

    The package that holds the file may then have any name. Raises DescriptionError for an import without relative form.
    """
    with tokenize.open(path) as file:  # knows byte order marks and comments such as "coding: latin-1"
        text = file.read()
    # The copy is UTF-8.
    text = re.sub(r"^([ \t\f]*#.*?coding[:=][ \t]*)[-\w.]+", r"\g<1>utf-8", text, count=1, flags=re.MULTILINE)
    tops = {"cosim", *(name.partition(".")[0] for name in local)}
    dots = "." * (len(module.split(".")) + (path.name == "__init__.py"))
    names = "|".join(sorted(map(re.escape, tops)))
    text = re.sub(rf"^(\s*from )({names})(?=[. ])", rf"\g<1>{dots}\g<2>", text, flags=re.MULTILINE)
    alone = rf"^(\s*)import ({names})(?=[ \t]*(?:as \w+[ \t]*)?(?:#.*)?$)"
    text = re.sub(alone, rf"\g<1>from {dots} import \g<2>", text, flags=re.MULTILINE)
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import) and any(alias.name.partition(".")[0] in tops for alias in node.names):
            listed = ", ".join(alias.name for alias in node.names)
            raise DescriptionError(
                f"{place(str(path), node.lineno)}: 'import {listed}' has no relative form, which a Python FMU needs. "
                "Write 'from package import module', one a line."
            )
    return text
