"""Pages of the components, from their declarations: the facts of the page in each FMU, a system to start from, what
uses them, and the importers that gave the same trace.

``docs/components/index.md`` is written by hand; its lines ``% components ROOM`` are replaced by the components of the
room. A component without a system among the studies has one in ``docs/components/systems``.
"""

from __future__ import annotations

import json
import re
import shutil
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import tomli_w

from cosim.errors import listed
from cosim.export.assets import ICON, PICTURE
from cosim.export.assets import folder as asset_folder
from cosim.export.fmi2_xml import summary
from cosim.export.page import facts_of
from cosim.export.trace import trace
from cosim.export.workspace import Workspace
from cosim.fmu.places import shipped_systems
from cosim.study.claims import read_claims
from cosim.system.system import System, read_system

from .markup import escaped, fenced, found_by, literal, markdown, table

ROOT = Path(__file__).resolve().parents[2]
WORKSPACE = Workspace(ROOT, ROOT / "build" / "cache")
SYSTEMS = ROOT / "docs" / "components" / "systems"
IMPORTERS = ROOT / "docs" / "importers.json"
MANY = 6
"""Number of systems of a study that are named."""
ORDER = ("description", "connections", "experiment", "instances", "signals", "record")
"""Order of the keys of a system, as a person writes them."""
_ROOM = re.compile(r"^% components (\w+)$", re.MULTILINE)
Markup: Any = import_module("markupsafe").Markup


class Use(NamedTuple):
    """A shipped system, and the components in it by the names of their instances."""

    name: str
    system: System
    kinds: Mapping[str, str]


def write(folder: Path) -> None:
    """Write ``components/``: one page for each component with its pictures, and fill the list."""
    target = folder / "components"
    pictures = target / "pictures"
    pictures.mkdir(exist_ok=True)
    for name, file in WORKSPACE.components().items():
        assets = asset_folder(file, name)
        shutil.copyfile(assets / ICON, pictures / f"{name}_icon.png")
        shutil.copyfile(assets / PICTURE, pictures / f"{name}.png")
        (target / f"{name}.md").write_text(page(name), encoding="utf-8")
    index = target / "index.md"
    index.write_text(
        _ROOM.sub(lambda found: cards(found[1]), index.read_text(encoding="utf-8")),
        encoding="utf-8",
    )


def cards(room: str) -> str:
    """The components of a room with icon and sentence, as a table, and their place in the contents."""
    names = [name for name, file in WORKSPACE.components().items() if file.parent.name == room]
    rows = [
        (
            f"![Icon of {name}](pictures/{name}_icon.png){{.component-icon}}",
            f"[{name}]({name}.md)",
            markdown(summary(WORKSPACE.component(name))),
        )
        for name in names
    ]
    contents = "\n".join(("```{toctree}", ":hidden:", "", *names, "```"))
    return "\n".join((table(("Icon", "Component", "What it is"), rows), "", contents))


MARKS = str.maketrans({mark: f"&#{ord(mark)};" for mark in "|*_`[]$~"})
"""What means something in Markdown, as HTML writes it."""


def page(name: str) -> str:
    """The page of a component."""
    kind = WORKSPACE.component(name)
    facts = facts_of(trace(kind))
    return "\n".join([*_head(name, facts), *_tables(facts), *_validation(name, facts), *_use(name)]) + "\n"


# ---- declaration ----


def _head(name: str, facts: Mapping[str, Any]) -> Iterator[str]:
    yield from (found_by(name), f"# {name}", "")
    yield from (f"![Icon of {name}](pictures/{name}_icon.png){{.component-icon}}", "", markdown(facts["summary"]), "")
    for title, blocks in facts["text"]:
        if blocks:
            yield from (f"## {title}", "")
        for what, text in blocks:
            block = textwrap.dedent(text)
            yield f"```{{equations}}\n:text:\n\n{block}\n```" if what == "equations" else _linked(text, name)
            yield ""


def _linked(text: str, name: str) -> str:
    """A paragraph in which the names of other components lead to their pages."""
    others = "|".join(sorted(set(WORKSPACE.components()) - {name}, key=len, reverse=True))
    return re.sub(rf"\b({others})\b", r"[\1](\1.md)", markdown(text))


def _tables(facts: Mapping[str, Any]) -> Iterator[str]:
    heads = ("Parameter", "Start", "Unit", "Shown as", "Bounds", "Meaning")
    yield from _section("Parameters", heads, facts["parameters"])
    yield from _section("Inputs", facts["inputs"]["heads"], facts["inputs"]["rows"])
    heads = ("Output", "Unit", "Shown in", "Inputs passed on directly", "Meaning")
    yield from _section("Outputs", heads, facts["outputs"])
    if facts["sampled"]:
        yield from (
            "Inputs are sampled, and outputs change, at multiples of `T_s`. Right after a step an output is the one "
            "applied over that step.",
            "",
        )
    yield from _section("States", facts["states"]["heads"], facts["states"]["rows"])
    yield from _section("Solver counters", facts["counters"]["heads"], facts["counters"]["rows"])
    heads = ("Value", "Above", "Unit", "Meaning")
    yield from _section("Warnings when initialization or a run ends", heads, facts["notes"])


def _section(title: str, heads: Sequence[str], rows: Sequence[Sequence[Any]]) -> list[str]:
    """A heading and a table; nothing without rows. The first cell of a row is a name."""
    named = [(literal(str(row[0])), *map(_cell, row[1:])) for row in rows]
    return [f"## {title}", "", table(heads, named), ""] if rows else []


def _cell(cell: Any) -> str:
    """Text of a cell; HTML stays HTML, in which Markdown's own marks are shown as they are."""
    return str(cell).translate(MARKS) if isinstance(cell, Markup) else escaped(str(cell))


def _validation(name: str, facts: Mapping[str, Any]) -> Iterator[str]:
    """The picture of the reference experiments and the differences held."""
    experiments = facts["validation"]["experiments"]
    solver = (
        "integrated by scipy's Radau at a relative tolerance of 1e-10"
        if facts["integrated"]
        else "evaluated as they are"
    )
    yield from ("## Validation", "")
    yield (
        f"The FMU carries these experiments with reference results: the equations above in Python, {solver}, without "
        f"FMI. [References](../references.md) says what they mean. `cosim verify {name}` replays them."
    )
    yield ""
    for experiment in experiments:
        step = f"{experiment['step_size'] * 1e3:.3g}"
        text = f"{markdown(experiment['description'])} ({experiment['rows']} rows, {step} ms apart)."
        yield f"- **{escaped(experiment['name'])}**: {text}"
    shown = ", ".join(experiment["name"] for experiment in experiments)
    yield from ("", f"![Reference results of {name} and what its FMU gave: {escaped(shown)}](pictures/{name}.png)", "")
    yield (
        "Reference (line) and native FMU (dots) for the main outputs. Below, for every output, the difference as a "
        "share of its tolerance, the largest in colour."
    )
    yield ""
    heads = ("Output", "Experiment", "Largest value", "Largest difference", "Tolerance", "Unit")
    yield from _section("Measured differences of the native FMU", heads, facts["differences"])


# ---- systems ----


@cache
def shipped() -> tuple[Use, ...]:
    """The systems of the studies, those of the ranking, too, which lie in a folder of their own."""
    studies = ROOT / "studies"
    files = shipped_systems() | {
        path.relative_to(studies).with_suffix("").as_posix(): path for path in sorted(studies.glob("*/systems/*.toml"))
    }
    systems = {name: read_system(path) for name, path in files.items()}
    return tuple(
        Use(name, system, {i.name: i.fmu.path.stem for i in system.instances}) for name, system in systems.items()
    )


def example(name: str) -> tuple[str, str]:
    """A small system with the component as text, and what ``cosim run`` calls it; empty for one of the page only."""
    own = SYSTEMS / f"{name}.toml"
    if own.is_file():
        return own.read_text(encoding="utf-8"), ""
    room = WORKSPACE.components()[name].parent.name
    other = {"plant": "controllers", "controllers": "plant"}[room]
    partners = {n for n, file in WORKSPACE.components().items() if file.parent.name == other}
    loops = [use for use in shipped() if name in use.kinds.values() and partners & set(use.kinds.values())]
    if not loops:
        raise ValueError(f"no study has a loop with {name}: write {own.relative_to(ROOT)}.")
    chosen = min(
        loops,
        key=lambda use: (use.name.count("/"), use.system.parallel, len(use.kinds), len(_toml(use)), use.name),
    )
    return _toml(chosen), chosen.name if chosen.name in shipped_systems() else f"studies/{chosen.name}.toml"


def _toml(use: Use) -> str:
    document = use.system.document
    keys = sorted(document, key=lambda key: ORDER.index(key) if key in ORDER else len(ORDER))
    return tomli_w.dumps({key: document[key] for key in keys})


def _use(name: str) -> Iterator[str]:
    text, place = example(name)
    yield from ("## A system to start from", "")
    if place:
        yield f"`cosim run {place}` runs this system of the studies; save it as a file of your own to change it."
    else:
        yield f"Saved as `{name}.toml`, `cosim run {name}.toml` runs it."
    yield from ("", fenced(text, "toml"))
    users = [use.name for use in shipped() if name in use.kinds.values()]
    if users:
        yield from ("## Studies that use it", "", table(("Study", "Systems"), list(_studies(users))), "")
    yield from _proofs(name)


def _studies(users: Sequence[str]) -> Iterator[tuple[str, str]]:
    for study in dict.fromkeys(user.split("/")[0] for user in users):
        systems = [user for user in users if user.startswith(f"{study}/")]
        title = read_claims(ROOT / "studies" / study / "claims.toml").title
        yield f"{literal(study)}: {escaped(title)}", listed([literal(system) for system in systems], MANY)


def _proofs(name: str) -> Iterator[str]:
    """The importers in which the FMU gave the trace of ``cosim run``, by itself and in systems."""
    # by importer and version the largest difference of each form; an importer may have several rows of a form
    runs: dict[tuple[str, str], dict[str, float]] = {}
    for row in json.loads(IMPORTERS.read_text(encoding="utf-8")):
        held = row["components"].get(name)
        if held and held["ran"] == held["jobs"] and not held["problems"] and held["difference"] is not None:
            found, form = runs.setdefault((row["importer"], row["version"]), {}), _form(row)
            found[form] = max(found.get(form, 0.0), held["difference"])
    yield from ("## Importers", "")
    if not runs:
        yield "Not yet run in other importers."
        return
    yield (
        "Programs that nobody here wrote, in which the FMU gave what `cosim run` gives: the largest difference of an "
        "output as a share of its largest value. [How, and which bugs of importers were met](../importers.md)."
    )
    rows = [
        (
            escaped(importer),
            escaped(version),
            "; ".join(found),
            f"{max(found.values()):.1e}" if any(found.values()) else "0",
        )
        for (importer, version), found in runs.items()
    ]
    yield from ("", table(("Importer", "Version", "FMU", "Largest difference"), rows))


def _form(row: Mapping[str, Any]) -> str:
    """In which form the FMU was run."""
    form = {"native": "native", "python": "Python", "fmi3": "FMI 3.0"}[row["fmus"]]
    return form + {"Model exchange": ", model exchange", "Systems": " in systems"}.get(row["section"], "")
