"""Which module may import what: the table of rooms, as data."""

from __future__ import annotations

import ast
import subprocess
import sys
from fnmatch import fnmatch
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SOURCES = sorted(path.relative_to(ROOT).as_posix() for top in ("src", "fmus") for path in (ROOT / top).rglob("*.py"))

TRAVELLING = ["cosim.model", "cosim.units", "cosim.errors"]

ROOMS: list[tuple[str, list[str]]] = [
    # pattern of files (the first that fits counts), modules they may import beside the standard library
    ("fmus/references/experiments.py", ["cosim.model", "cosim.validation.exact", "fmus"]),
    ("fmus/references/icons.py", ["matplotlib", "numpy", "PIL"]),
    ("fmus/references/maxwell_slip.py", ["fmus.plant", "numpy", "scipy"]),
    ("fmus/*", ["cosim.model", "fmus.physics"]),
    ("src/cosim/model.py", TRAVELLING),
    ("src/cosim/units.py", TRAVELLING),
    ("src/cosim/errors.py", TRAVELLING),
    ("src/cosim/export/trace.py", [*TRAVELLING, "cosim.export", "casadi"]),
    ("src/cosim/export/slave.py", [*TRAVELLING, "cosim.export", "pythonfmu", "numpy", "scipy"]),
    ("src/cosim/export/embed.py", [*TRAVELLING, "cosim.export", "pythonfmu"]),
    ("src/cosim/export/*", [*TRAVELLING, "cosim.export", "cosim.xmlfile", "fmus"]),
    ("src/cosim/xmlfile.py", ["lxml"]),
    ("src/cosim/fmu.py", ["cosim.errors", "fmpy.model_description"]),
    ("src/cosim/system.py", ["cosim.errors", "cosim.units", "cosim.fmu", "cosim.ssp"]),
    ("src/cosim/ssp.py", ["cosim.errors", "cosim.units", "cosim.fmu", "cosim.system", "cosim.xmlfile", "fmpy", "lxml"]),
    ("src/cosim/handout.py", ["cosim.errors"]),
    ("src/cosim/results.py", ["cosim.errors", "numpy", "pandas", "pyarrow"]),
    ("src/cosim/loop.py", ["numpy", "llvmlite", "cosim.kernel"]),
    ("src/cosim/kernel.py", ["cosim.loop", "numba", "numpy", "llvmlite"]),
    (
        "src/cosim/master.py",
        ["cosim.errors", "cosim.fmu", "cosim.system", "cosim.results", "cosim.loop", "numpy", "fmpy"],
    ),
    ("src/cosim/metrics.py", ["cosim.errors", "cosim.units", "numpy"]),
    ("src/cosim/plots.py", ["cosim.errors", "cosim.units", "cosim.metrics", "numpy", "matplotlib"]),
    ("src/cosim/lsref.py", ["cosim.errors", "cosim.xmlfile", "lxml"]),
    ("src/cosim/verify.py", ["cosim.errors", "cosim.fmu", "cosim.lsref", "cosim.xmlfile", "fmpy", "lxml", "numpy"]),
    ("src/cosim/verify_plot.py", ["cosim.errors", "cosim.plots", "cosim.verify", "numpy", "matplotlib"]),
    ("src/cosim/console.py", ["rich"]),
    ("src/cosim/verify_command.py", ["cosim.console", "cosim.errors", "cosim.verify", "cosim.verify_plot", "rich"]),
    ("src/cosim/validation/exact.py", [*TRAVELLING, "cosim.export.layout", "cosim.lsref", "numpy", "scipy"]),
    ("src/cosim/validation/make.py", ["cosim", "PIL"]),
    ("src/cosim/cli.py", ["cosim", "rich"]),
]
"""Modules that stand on these (studies, design tools) are free to use all of them, and none of these uses them."""

PURE = {"math", "random", "time", "datetime", "os", "io", "pathlib", "sys", "builtins", "warnings"}
"""Parts of the standard library that equations must not use."""


def imports(path: str) -> set[str]:
    """Full names of the modules a file imports, ``import_module("...")`` included."""
    package = list(Path(path).with_suffix("").parts)
    package = package[1:] if package[0] == "src" else package
    found: set[str] = set()
    for node in ast.walk(ast.parse((ROOT / path).read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level] if node.level else []
            module = ".".join([*base, *([node.module] if node.module else [])])
            # "from . import loop" names modules, "from .loop import advance" does not.
            found |= {f"{module}.{alias.name}" for alias in node.names} if node.module is None else {module}
        elif (
            isinstance(node, ast.Call)
            and isinstance(node.func, ast.Name | ast.Attribute)
            and (node.func.id if isinstance(node.func, ast.Name) else node.func.attr) == "import_module"
            and node.args
            and isinstance(node.args[0], ast.Constant)
        ):
            found.add(str(node.args[0].value))
    return found


def allowed(path: str) -> list[str] | None:
    return next((modules for pattern, modules in ROOMS if fnmatch(path, pattern)), None)


@pytest.mark.parametrize("path", [path for path in SOURCES if allowed(path) is not None])
def test_imports_stay_in_their_room(path: str) -> None:
    room = allowed(path)
    assert room is not None
    foreign = {
        module
        for module in imports(path)
        if module.split(".")[0] not in sys.stdlib_module_names
        and not any(module == name or module.startswith(f"{name}.") for name in room)
    }
    assert not foreign, f"{path} imports {sorted(foreign)}, allowed are {room}"


@pytest.mark.parametrize(
    "path", [path for path in SOURCES if path.startswith("fmus/") and not path.startswith("fmus/references/")]
)
def test_equations_use_no_clock_no_file_no_print(path: str) -> None:
    assert not {module.split(".")[0] for module in imports(path)} & PURE
    calls = {
        node.func.id
        for node in ast.walk(ast.parse((ROOT / path).read_text(encoding="utf-8")))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
    }
    assert not calls & {"print", "open", "input", "eval", "exec"}


def test_every_room_of_the_table_is_inhabited_or_planned() -> None:
    planned = {"src/cosim/ssp.py"}
    empty = {pattern for pattern, _ in ROOMS if not any(fnmatch(path, pattern) for path in SOURCES)}
    assert empty <= planned


def test_the_reader_sees_what_a_file_imports() -> None:
    assert imports("src/cosim/master.py") >= {"cosim.loop", "cosim.errors", "numpy", "fmpy.fmi2", "ctypes"}
    assert "casadi" in imports("src/cosim/export/trace.py")


def test_importing_the_package_loads_nothing_heavy() -> None:
    code = (
        "import sys, cosim, cosim.model, cosim.system\n"
        "print([m for m in ('numba', 'matplotlib', 'pandas', 'pyarrow', 'casadi', 'scipy') if m in sys.modules])"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"
