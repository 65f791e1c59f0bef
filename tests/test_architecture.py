"""Which room may import what: one row a room, no exemption, no circle, no arrow upwards."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections import defaultdict
from collections.abc import Mapping, Sequence
from graphlib import TopologicalSorter
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).resolve().parents[1]
SOURCES = sorted(path.relative_to(ROOT).as_posix() for top in ("src", "fmus") for path in (ROOT / top).rglob("*.py"))
TRAVELLING = ("cosim.errors", "cosim.units", "cosim.model")
BASE = (*TRAVELLING, "cosim.files")


class Room(NamedTuple):
    """A folder or module, what it may import of this project, and which packages."""

    name: str
    rooms: Sequence[str] = ()
    packages: Sequence[str] = ()


ROOMS = (
    # From the bottom to the top: a room imports only rooms above it in this table, and of those only the named ones.
    Room("cosim.errors"),
    Room("cosim.files", ["cosim.errors"]),
    Room("cosim.units", ["cosim.errors"]),
    Room("cosim.model", ["cosim.errors", "cosim.units"]),
    Room("fmus", ["cosim.model"]),
    Room("cosim.fmu", BASE, ["fmpy.model_description", "lxml", "pydantic", "pydantic_core", "tomli_w"]),
    Room("cosim.export", [*BASE, "cosim.fmu", "fmus"], ["casadi", "jinja2", "markupsafe", "pythonfmu"]),
    Room("cosim.system", [*BASE, "cosim.fmu"], ["fmpy.ssp", "lxml"]),
    Room("cosim.result", BASE, ["matplotlib", "numpy", "pandas", "pyarrow"]),
    Room(
        "cosim.master",
        [*BASE, "cosim.fmu", "cosim.system", "cosim.result"],
        ["fmpy", "numpy"],
    ),
    Room(
        "cosim.reference",
        [*BASE, "cosim.fmu", "cosim.export", "cosim.system", "cosim.result"],
        ["fmpy", "lxml", "matplotlib", "numpy", "PIL", "scipy"],
    ),
    Room("fmus.references", ["cosim.model", "cosim.reference", "fmus"], ["matplotlib", "numpy", "PIL", "scipy"]),
    Room(
        "cosim.design",
        [*BASE, "cosim.fmu", "cosim.system", "cosim.result", "cosim.master"],
        ["control", "distributed", "matplotlib", "numpy", "pyarrow", "pydantic", "scipy"],
    ),
    Room(
        "cosim.study",
        [*BASE, "cosim.fmu", "cosim.system", "cosim.result", "cosim.master", "cosim.design"],
        ["jinja2", "markdown_it", "matplotlib", "numpy", "pydantic"],
    ),
    Room("cosim.commands", ["cosim", "fmus"], ["numpy", "rich"]),
    Room("cosim.__init__", ["cosim"]),
    Room("cosim.__main__", ["cosim"]),
)

PURE = {"math", "random", "time", "datetime", "os", "io", "pathlib", "sys", "builtins", "warnings"}
"""Parts of the standard library that equations must not use."""


def module_of(path: str) -> str:
    parts = list(Path(path).with_suffix("").parts)
    return ".".join(parts[1:] if parts[0] == "src" else parts)


def imports(path: str) -> set[str]:
    """Full names of the modules a file imports, ``import_module("...")`` included."""
    package = module_of(path).split(".")
    found: set[str] = set()
    for node in ast.walk(ast.parse((ROOT / path).read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level] if node.level else []
            module = ".".join([*base, *([node.module] if node.module else [])])
            # "from ..result import plots" names a module, "from .loop import advance" does not.
            named = {f"{module}.{alias.name}" for alias in node.names}
            found |= {name if name in MODULES else module for name in named}
        elif (
            isinstance(node, ast.Call)
            and isinstance(node.func, ast.Name | ast.Attribute)
            and (node.func.id if isinstance(node.func, ast.Name) else node.func.attr) == "import_module"
            and node.args
            and isinstance(node.args[0], ast.Constant)
        ):
            found.add(str(node.args[0].value))
    return {module for module in found if module.split(".")[0] not in sys.stdlib_module_names}


MODULES = {module_of(path).removesuffix(".__init__") for path in SOURCES}


def within(module: str, names: Sequence[str]) -> bool:
    return any(module == name or module.startswith(f"{name}.") for name in names)


def room_of(module: str) -> Room:
    """The room of a module: the longest name in the table that fits."""
    fitting = [room for room in ROOMS if within(module, [room.name])]
    assert fitting, f"{module} lies in no room of the table"
    return max(fitting, key=lambda room: len(room.name))


def arrows() -> Mapping[str, set[str]]:
    """For each room the other rooms that it imports."""
    found: dict[str, set[str]] = defaultdict(set)
    for path in SOURCES:
        own = room_of(module_of(path)).name
        for module in imports(path):
            if module in MODULES and room_of(module).name != own:
                found[own].add(room_of(module).name)
    return found


@pytest.mark.parametrize("path", SOURCES)
def test_imports_stay_in_their_room(path: str) -> None:
    room = room_of(module_of(path))
    allowed = [room.name, *room.rooms, *room.packages]
    foreign = sorted(module for module in imports(path) if not within(module, allowed))
    assert not foreign, f"{path} imports {foreign}; {room.name} may import {allowed}"


def test_no_arrow_points_upwards() -> None:
    """The package's own two modules stand above all rooms."""
    height = {room.name: i for i, room in enumerate(ROOMS)}
    for room, targets in arrows().items():
        assert all(height[target] < height[room] for target in targets), (room, sorted(targets))


def test_no_circle_between_modules() -> None:
    """Imports inside functions count, too."""
    graph = {
        module_of(path).removesuffix(".__init__"): {name for name in imports(path) if name in MODULES}
        for path in SOURCES
    }
    graph = {name: {target for target in targets if target != "cosim"} - {name} for name, targets in graph.items()}
    TopologicalSorter(graph).prepare()


def test_table_of_rooms(capsys: pytest.CaptureFixture[str]) -> None:
    """Every row is inhabited; with -s the table of rooms, arrows and floors is shown."""
    found = arrows()
    floors: dict[str, int] = {}
    for room in ROOMS:
        floors[room.name] = 1 + max((floors[target] for target in found[room.name]), default=-1)
    inhabited = {room_of(module_of(path)).name for path in SOURCES}
    assert {room.name for room in ROOMS} == inhabited
    line = "{} {}: {}".format
    with capsys.disabled():
        if sys.flags.verbose:
            lines = (line(floors[room.name], room.name, ", ".join(sorted(found[room.name])) or "-") for room in ROOMS)
            sys.stdout.write("\n".join(["", *lines, ""]))


@pytest.mark.parametrize(
    "path", [path for path in SOURCES if path.startswith("fmus/") and not path.startswith("fmus/references/")]
)
def test_equations_use_no_clock_no_file_no_print(path: str) -> None:
    tree = ast.parse((ROOT / path).read_text(encoding="utf-8"))
    modules = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    modules |= {str(node.module) for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    assert not {module.split(".")[0] for module in modules} & PURE
    calls = {node.func.id for node in ast.walk(tree) if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)}
    assert not calls & {"print", "open", "input", "eval", "exec"}


def test_the_reader_sees_what_a_file_imports() -> None:
    assert imports("src/cosim/master/simulation.py") >= {"cosim.errors", "cosim.master.run", "numpy"}
    assert "fmpy.fmi2" in imports("src/cosim/master/instance.py")
    assert "cosim.design.sweep" in imports("src/cosim/commands/sweep.py")


def test_importing_the_package_loads_nothing_heavy() -> None:
    code = (
        "import sys, cosim, cosim.model, cosim.system.system\n"
        "print([m for m in ('matplotlib', 'pandas', 'pyarrow', 'casadi', 'scipy') if m in sys.modules])"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"


def test_public_names_are_listed_and_there() -> None:
    import cosim

    assert set(cosim.__all__) <= set(dir(cosim))
    assert all(getattr(cosim, name) is not None for name in cosim.__all__)
