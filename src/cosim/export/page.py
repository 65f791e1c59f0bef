"""documentation/index.html of an FMU: what it computes, with which parameters, from where, and how well.

The page is the template ``page.html.j2``; this module gives it the facts. The pages of components in the documentation
of the project take the same facts.
"""

from __future__ import annotations

import html
import inspect
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from importlib import import_module
from itertools import groupby
from pathlib import Path
from typing import Any, Literal

from ..model import Component, Controller, Plant
from ..units import conversion
from .assets import EXTRA, GUIDE, ICON, ICONS, PICTURE, asset_files, measured
from .contract import Fmi
from .fmi2_xml import summary
from .interface import InterfaceVariable, variables_of
from .mathml import STYLE, typeset
from .source_files import component_origin
from .trace import Trace

jinja2: Any = import_module("jinja2")
markup: Any = import_module("markupsafe")

SIGNS = ("positive", "a positive", "sign:", "valid", "do not combine", "for a start at speed")
"""First words of the docstring paragraphs that tell sign conventions and limits of use."""


@cache
def _template() -> Any:
    loader = jinja2.FileSystemLoader(Path(__file__).parent)
    environment = jinja2.Environment(
        loader=loader, autoescape=True, undefined=jinja2.StrictUndefined, keep_trailing_newline=True
    )
    environment.filters.update(words=_words, typeset=_equations)
    return environment.get_template("page.html.j2")


def documentation(trace: Trace, version: str, *, native: bool = True, fmi: Fmi = 2) -> bytes:
    """The page: equations and source from the docstring, tables of the variables, and what the validation gave."""
    kind = trace.kind
    drawn = ICON in {path.name for path in asset_files(Path(inspect.getfile(kind)), kind.__name__)}
    page = _template().render(
        facts_of(trace),
        version=version,
        icon=ICONS[fmi] if drawn else None,
        style=markup.Markup(STYLE),
        extra=EXTRA,
        guide=GUIDE,
        picture=PICTURE,
        native=native,
        module=component_origin(kind).module.replace(".", "/"),
    )
    return page.encode()


def facts_of(trace: Trace) -> dict[str, Any]:
    """What the declaration of a component, its docstring and its validation say, for a page.

    Rows of tables are sequences of cells: text, or HTML as ``markupsafe.Markup``.
    """
    kind, variables = trace.kind, variables_of(trace.kind)
    name = kind.__name__
    validation = measured(Path(inspect.getfile(kind)), name)

    def ports(title: str, role: str) -> dict[str, Any]:
        return _ports(title, [v for v in variables if v.role == role])

    return {
        "name": name,
        "summary": summary(kind),
        "text": _text(kind),
        "parameters": _parameters([v for v in variables if v.role in ("fixed", "tunable")]),
        "inputs": ports("Input", "input"),
        "outputs": _outputs(trace, variables),
        "states": ports("State", "state"),
        "counters": ports("Solver counter", "counter"),
        "notes": [(note.name, _words(note.limit_name), _unit(note.unit), _words(note.text)) for note in trace.notes],
        "sampled": issubclass(kind, Controller),
        "integrated": issubclass(kind, Plant),
        "validation": validation,
        "differences": _differences(validation) if validation else [],
    }


# ---- text of the docstring ----


def _text(kind: type[Component]) -> list[tuple[str, list[tuple[Literal["equations", "words"], str]]]]:
    """The parts "equations", "signs and limits" and "source" of the docstring, each with its blocks of text."""
    blocks = [b for b in re.split(r"\n\s*\n", inspect.getdoc(kind) or "") if b.strip()][1:]
    equations: list[tuple[Literal["equations", "words"], str]] = []
    signs: list[tuple[Literal["equations", "words"], str]] = []
    sources: list[tuple[Literal["equations", "words"], str]] = []
    for block in blocks:
        if block.startswith("Source:"):
            sources.append(("words", block.removeprefix("Source:").strip()))
        elif block.startswith("    "):
            equations.append(("equations", block))
        elif block.lower().startswith(SIGNS):
            signs.append(("words", block))
        else:
            equations.append(("words", block))
    return [("Equations", equations), ("Signs and range of validity", signs), ("Source", sources)]


def _words(text: str) -> Any:
    """Running text as HTML; text in double backticks becomes code. Quotes stay as they are."""
    escaped = html.escape(" ".join(text.split()), quote=False)
    return markup.Markup(re.sub(r"``(.+?)``", r"<code>\1</code>", escaped))


def _equations(block: str) -> Any:
    return markup.Markup(typeset(block))


# ---- variables ----


def _parameters(variables: Sequence[InterfaceVariable]) -> list[Sequence[Any]]:
    rows: list[Sequence[Any]] = []
    for group in _arrays(variables):
        first = group[0]
        meaning = first.description + (" (tunable)" if first.role == "tunable" else "")
        if first.choice:
            start = next(item.name for item in first.choice if item.number == first.start)
            meaning += ": " + "; ".join(f"{item.name} = {item.description}" for item in first.choice)
        elif first.type == "Boolean":
            start = "true" if first.start else "false"
        else:
            start = _span([v.start for v in group])
        bounds = "" if first.choice or first.type == "Boolean" else _bounds(first)
        shown = _shown([v.start for v in group], first)
        rows.append((_name(group), start, _unit(first.unit), shown, bounds, _words(meaning)))
    return rows


def _ports(title: str, variables: Sequence[InterfaceVariable]) -> dict[str, Any]:
    """Heads and rows of a table of variables; it has a column of display units only if a variable has one."""
    shown = any(v.display_unit for v in variables)
    heads = (title, "Unit", *(("Shown in",) if shown else ()), "Meaning")
    rows = [
        (_name(g), _unit(g[0].unit), *((_unit(g[0].display_unit or ""),) if shown else ()), _words(g[0].description))
        for g in _arrays(variables)
    ]
    return {"heads": heads, "rows": rows}


def _outputs(trace: Trace, variables: Sequence[InterfaceVariable]) -> list[Sequence[Any]]:
    """Outputs with the inputs on which they depend directly."""
    inputs = [v.name for v in variables if v.role == "input"]
    outputs = [v for v in variables if v.role == "output"]
    direct = {v.name: [inputs[i] for i in sorted(trace.output_inputs[row])] for row, v in enumerate(outputs)}
    rows: list[Sequence[Any]] = []
    for group in _arrays(outputs):
        first = group[0]
        known = [markup.Markup("<code>{}</code>").format(name) for name in direct[first.name]]
        listed = markup.Markup(", ").join(known) or "none"
        shown = _unit(first.display_unit or "")
        rows.append((_name(group), _unit(first.unit), shown, listed, _words(first.description)))
    return rows


def _arrays(variables: Iterable[InterfaceVariable]) -> list[list[InterfaceVariable]]:
    """The variables in groups: the elements of an array together, every other variable alone."""
    return [list(group) for _, group in groupby(variables, lambda variable: variable.array or variable.name)]


def _name(group: Sequence[InterfaceVariable]) -> str:
    return f"{group[0].array}[1 ... {len(group)}]" if len(group) > 1 else group[0].name


def _span(values: Sequence[float]) -> str:
    low, high = f"{min(values):.6g}", f"{max(values):.6g}"
    return low if low == high else f"{low} ... {high}"


def _shown(values: Sequence[float], variable: InterfaceVariable) -> Any:
    """Start values in the display unit."""
    if variable.display_unit is None or variable.display_unit == variable.unit:
        return ""
    factor = conversion(variable.unit, variable.display_unit)
    return markup.Markup("{} {}").format(_span([value * factor for value in values]), _unit(variable.display_unit))


def _bounds(variable: InterfaceVariable) -> Any:
    low = f"{variable.min:.6g}" if math.isfinite(variable.min) else ""
    high = f"{variable.max:.6g}" if math.isfinite(variable.max) else ""
    if low and high:
        return f"{low} ... {high}"
    return markup.Markup(f"&ge; {low}" if low else f"&le; {high}" if high else "")


def _unit(unit: str) -> Any:
    """A unit as people write it."""
    if unit in ("", "1"):
        return ""
    shown = re.sub(r"(?<=[A-Za-z)])(-?\d+(?:\.\d+)?)", r"<sup>\1</sup>", unit)
    shown = re.sub(r"\bu(?=m\b|s\b|N\b|rad\b)", "&micro;", shown)
    return markup.Markup(re.sub(r"\.(?=[A-Za-z])", "&middot;", shown))


# ---- validation ----


def _differences(facts: Mapping[str, Any]) -> list[Sequence[Any]]:
    """A row for each output and experiment."""
    return [
        (
            signal["name"],
            experiment["name"],
            f"{signal['largest_value']:.3g}",
            f"{signal['largest_difference']:.2g}",
            f"{signal['tolerance']:.2g}",
            _unit(signal["unit"]),
        )
        for experiment in facts["experiments"]
        for signal in experiment["signals"]
    ]
