"""Which room may import what: one row a room, no exemption, no circle, no arrow upwards."""

from __future__ import annotations

import ast
import subprocess
import sys

import pytest
from rooms import (
    PAGE,
    PICTURE,
    ROOMS,
    ROOT,
    SOURCES,
    arrows,
    circles,
    imports,
    module_of,
    page_with_table,
    picture,
    room_of,
    within,
)

PURE = {"math", "random", "time", "datetime", "os", "io", "pathlib", "sys", "builtins", "warnings"}
"""Parts of the standard library that equations must not use."""


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
    assert circles() == []


def test_every_row_of_the_table_is_inhabited() -> None:
    assert {room.name for room in ROOMS} == {room_of(module_of(path)).name for path in SOURCES}


def test_page_and_picture_show_the_rooms_of_today() -> None:
    """``python tests/rooms.py`` writes both anew."""
    page = PAGE.read_text(encoding="utf-8")
    assert page == page_with_table(page)
    assert PICTURE.read_text(encoding="utf-8") == picture()


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
