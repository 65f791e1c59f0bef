"""The rooms of the code as data; ``python tests/rooms.py`` draws them for docs/architecture.md."""

from __future__ import annotations

import ast
import sys
from collections import defaultdict
from collections.abc import Mapping, Sequence
from graphlib import CycleError, TopologicalSorter
from html import escape
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
SOURCES = sorted(path.relative_to(ROOT).as_posix() for top in ("src", "fmus") for path in (ROOT / top).rglob("*.py"))
TRAVELLING = ("cosim.errors", "cosim.units", "cosim.model")
BASE = (*TRAVELLING, "cosim.version", "cosim.public", "cosim.files", "cosim.extras")


class Room(NamedTuple):
    """A folder or module, what it may import of this project, and which packages."""

    name: str
    rooms: Sequence[str] = ()
    packages: Sequence[str] = ()


ROOMS = (
    # From the bottom to the top: a room imports only rooms above it in this table, and of those only the named ones.
    Room("cosim.version"),
    Room("cosim.public"),
    Room("cosim.errors"),
    Room("cosim.files", ["cosim.errors"]),
    Room("cosim.extras", ["cosim.errors"]),
    Room("cosim.units", ["cosim.errors"]),
    Room("cosim.model", ["cosim.errors"]),
    Room("fmus", ["cosim.model"]),
    Room("cosim.fmu", BASE, ["fmpy.model_description", "lxml", "pydantic", "pydantic_core", "tomli_w"]),
    Room("cosim.export", [*BASE, "cosim.fmu"], ["casadi", "jinja2", "markupsafe", "pythonfmu"]),
    Room("cosim.record", [*BASE, "cosim.fmu"], ["numpy", "pyarrow", "scipy"]),
    Room("cosim.system", [*BASE, "cosim.fmu", "cosim.record"], ["fmpy.ssp", "lxml", "numpy", "pydantic"]),
    Room("cosim.result", [*BASE, "cosim.record"], ["jinja2", "markupsafe", "matplotlib", "numpy", "plotly"]),
    Room(
        "cosim.master",
        [*BASE, "cosim.fmu", "cosim.record", "cosim.system", "cosim.result"],
        ["fmpy", "numpy"],
    ),
    Room(
        "cosim.reference",
        [*BASE, "cosim.fmu", "cosim.export", "cosim.system", "cosim.result", "cosim.master"],
        ["fmpy", "lxml", "matplotlib", "numpy", "PIL", "scipy"],
    ),
    Room("fmus.references", ["cosim.model", "cosim.reference", "fmus"], ["matplotlib", "numpy", "PIL", "scipy"]),
    Room(
        "cosim.design",
        [*BASE, "cosim.fmu", "cosim.record", "cosim.system", "cosim.result", "cosim.master"],
        ["control", "distributed", "matplotlib", "numpy", "pyarrow", "pydantic", "scipy"],
    ),
    Room(
        "cosim.study",
        [*BASE, "cosim.fmu", "cosim.record", "cosim.system", "cosim.result", "cosim.master", "cosim.design"],
        ["jinja2", "markdown_it", "numpy", "pydantic"],
    ),
    Room("cosim.commands", ["cosim", "fmus"], ["numpy", "rich"]),
    Room("cosim.__init__", ["cosim"]),
    Room("cosim.__main__", ["cosim"]),
)


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
            and (node.func.id if isinstance(node.func, ast.Name) else node.func.attr)
            in ("import_module", "import_extra")
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


def floors() -> dict[str, int]:
    """For each room the number of rooms below it in the longest chain of imports."""
    found, height = arrows(), dict[str, int]()
    for room in ROOMS:
        height[room.name] = 1 + max((height[target] for target in found[room.name]), default=-1)
    return height


def circles() -> list[str]:
    """Modules that import each other, directly or through others."""
    graph = {
        module_of(path).removesuffix(".__init__"): {name for name in imports(path) if name in MODULES}
        for path in SOURCES
    }
    graph = {name: targets - {name, "cosim"} for name, targets in graph.items()}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return list(error.args[1])
    return []


def table() -> str:
    """The rooms from the top to the bottom, in Markdown."""
    found, height = arrows(), floors()
    lines = ["| floor | room | imports |", "|---|---|---|"]
    for room in sorted(ROOMS, key=lambda room: -height[room.name]):
        lines.append(f"| {height[room.name]} | `{room.name}` | {', '.join(sorted(found[room.name])) or 'nothing'} |")
    count = sum(len(targets) for targets in found.values())
    lines += ["", f"{len(ROOMS)} rooms, {count} arrows, {max(height.values()) + 1} floors, {len(circles())} circles."]
    return "\n".join(lines) + "\n"


def picture() -> str:
    """The same as SVG: a row a floor, an arrow from each room to those that it imports."""
    found, height = arrows(), floors()
    rows = [[room.name for room in ROOMS if height[room.name] == floor] for floor in range(max(height.values()) + 1)]
    width, step = 900, 84
    place = {
        name: (width * (i + 0.5) / len(row), 40.0 + step * (len(rows) - 1 - floor))
        for floor, row in enumerate(rows)
        for i, name in enumerate(row)
    }
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {step * len(rows)}" font-family="sans-serif">',
        '<rect width="100%" height="100%" fill="white"/>',
    ]
    for room, targets in found.items():
        (x, y), below = place[room], sorted(targets)
        lines += [
            f'<line x1="{x:.0f}" y1="{y + 16:.0f}" x2="{place[target][0]:.0f}" y2="{place[target][1] - 16:.0f}" '
            'stroke="#8a99a8" stroke-width="0.8"/>'
            for target in below
        ]
    for name, (x, y) in place.items():
        shown = escape(name.removeprefix("cosim."))
        lines += [
            f'<rect x="{x - 56:.0f}" y="{y - 16:.0f}" width="112" height="32" rx="6" fill="#e8eef4" stroke="#33506b"/>',
            f'<text x="{x:.0f}" y="{y + 5:.0f}" font-size="14" text-anchor="middle" fill="#1c2b39">{shown}</text>',
        ]
    return "\n".join([*lines, "</svg>", ""])


PICTURE = ROOT / "docs" / "pictures" / "rooms.svg"
PAGE = ROOT / "docs" / "architecture.md"
MARKS = "<!-- rooms -->\n", "<!-- end of rooms -->\n"


def page_with_table(page: str) -> str:
    """The page with the table of today between its marks."""
    before, _, rest = page.partition(MARKS[0])
    _, _, after = rest.partition(MARKS[1])
    return before + MARKS[0] + table() + MARKS[1] + after


if __name__ == "__main__":
    PICTURE.write_text(picture(), encoding="utf-8")
    PAGE.write_text(page_with_table(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
