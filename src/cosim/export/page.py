"""documentation/index.html of an FMU: what it computes, with which parameters, from where, and how well."""

from __future__ import annotations

import html
import inspect
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

from ..model import Component, Controller, Plant
from ..units import conversion
from .assets import EXTRA, GUIDE, ICON, ICONS, PICTURE, asset_files, measured
from .contract import Fmi
from .fmi2_xml import summary
from .interface import Variable, variables_of
from .source_files import component_origin
from .trace import Trace

SIGNS = ("positive", "a positive", "sign:", "valid", "do not combine", "for a start at speed")
"""How paragraphs of a docstring begin that say signs and limits of use."""

_STYLE = """
body{font:16px/1.55 system-ui,sans-serif;color:#222;max-width:62rem;margin:2rem auto;padding:0 1.2rem}
header{display:flex;gap:1.4rem;align-items:center;border-bottom:3px solid #16324f;padding-bottom:1rem}
header img{width:8rem;height:8rem}h1{margin:0;color:#16324f}header p{margin:.3rem 0 0;font-size:1.1rem}
h2{color:#16324f;margin:2.2rem 0 .6rem;font-size:1.3rem}code{font:.92em ui-monospace,monospace}
pre{font:.95rem/1.6 ui-monospace,monospace;background:#f1f5f9;border-left:4px solid #d55e00;padding:.8rem 1.2rem;
overflow-x:auto}table{border-collapse:collapse;width:100%;font-size:.92rem}caption{text-align:left;padding:.3rem 0}
th,td{border-bottom:1px solid #d5dde5;padding:.3rem .6rem;text-align:left;vertical-align:top}
thead th{border-bottom:2px solid #16324f}
th[scope=row]{font:inherit;font-family:ui-monospace,monospace;white-space:nowrap}
.n{text-align:right;white-space:nowrap}figure{margin:1rem 0}figure img{max-width:100%;height:auto}
figcaption,footer{color:#555;font-size:.92rem}footer{border-top:1px solid #d5dde5;margin-top:2.5rem;padding-top:.8rem}
""".strip()


def documentation(trace: Trace, version: str, *, native: bool = True, fmi: Fmi = 2) -> bytes:
    """The page: equations and source from the docstring, tables of the variables, and what the validation gave."""
    kind = trace.kind
    name, variables = kind.__name__, variables_of(trace.kind)
    carried = {path.name for path in asset_files(Path(inspect.getfile(kind)), kind.__name__)}
    icon = f'<img src="../{ICONS[fmi]}" alt="Icon of {name}">' if ICON in carried else ""
    parts = [
        f"<header>{icon}<div><h1>{name}</h1><p>{_words(summary(kind))}</p></div></header>",
        *_text(kind),
        *_parameters([v for v in variables if v.role in ("fixed", "tunable")]),
        *_ports("Inputs", [v for v in variables if v.role == "input"]),
        *_outputs(trace, variables),
        *_ports("States", [v for v in variables if v.role == "state"]),
        *_ports("Solver counters", [v for v in variables if v.role == "counter"]),
        *_validation(kind),
        _footer(kind, version, native),
    ]
    page = "\n".join(parts)
    return (
        f'<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">\n<title>{name}</title>\n'
        f"<style>\n{_STYLE}\n</style>\n</head>\n<body>\n{page}\n</body>\n</html>\n"
    ).encode()


# ---- text of the docstring ----


def _text(kind: type[Component]) -> list[str]:
    """Equations, signs and limits, source."""
    blocks = [b for b in re.split(r"\n\s*\n", inspect.getdoc(kind) or "") if b.strip()][1:]
    equations: list[str] = []
    signs: list[str] = []
    sources: list[str] = []
    for block in blocks:
        if block.startswith("Source:"):
            sources.append(_paragraph(block.removeprefix("Source:").strip()))
        elif block.startswith("    "):
            equations.append(f"<pre>{html.escape(inspect.cleandoc(' ' + chr(10) + block))}</pre>")
        elif block.lower().startswith(SIGNS):
            signs.append(_paragraph(block))
        else:
            equations.append(_paragraph(block))
    sections = (("Equations", equations), ("Signs and range of validity", signs), ("Source", sources))
    return [part for title, found in sections if found for part in (f"<h2>{title}</h2>", *found)]


def _paragraph(text: str) -> str:
    return f"<p>{_words(text)}</p>"


def _words(text: str) -> str:
    """Running text; what stands in two backticks as code."""
    escaped = html.escape(" ".join(text.split()), quote=False)
    return re.sub(r"``(.+?)``", r"<code>\1</code>", escaped)


# ---- variables ----


def _parameters(variables: Sequence[Variable]) -> list[str]:
    heads = ("Parameter", "Start", "Unit", "Shown as", "Bounds", "Meaning")
    rows: list[Sequence[str]] = []
    for group in _arrays(variables):
        first = group[0]
        meaning = first.text + (" (tunable)" if first.role == "tunable" else "")
        if first.choice:
            start = next(item.name for item in first.choice if item.number == first.start)
            meaning += ": " + "; ".join(f"{item.name} = {item.text}" for item in first.choice)
        elif first.type == "Boolean":
            start = "true" if first.start else "false"
        else:
            start = _span([v.start for v in group])
        bounds = "" if first.choice or first.type == "Boolean" else _bounds(first)
        shown = _shown([v.start for v in group], first)
        rows.append((_name(group), start, _unit(first.unit), shown, bounds, _words(meaning)))
    return _table("Parameters", heads, rows, right=(1, 3))


def _ports(title: str, variables: Sequence[Variable]) -> list[str]:
    shown = any(v.display_unit for v in variables)
    heads = (title.rstrip("s"), "Unit", *(("Shown in",) if shown else ()), "Meaning")
    rows = [
        (_name(g), _unit(g[0].unit), *((_unit(g[0].display_unit or ""),) if shown else ()), _words(g[0].text))
        for g in _arrays(variables)
    ]
    return _table(title, heads, rows)


def _outputs(trace: Trace, variables: Sequence[Variable]) -> list[str]:
    """Outputs with the inputs on which they depend directly."""
    inputs = [v.name for v in variables if v.role == "input"]
    outputs = [v for v in variables if v.role == "output"]
    direct = {v.name: [inputs[i] for i in sorted(trace.output_inputs[row])] for row, v in enumerate(outputs)}
    rows: list[Sequence[str]] = []
    for group in _arrays(outputs):
        known = ", ".join(f"<code>{html.escape(name)}</code>" for name in direct[group[0].name]) or "none"
        first = group[0]
        shown = _unit(first.display_unit or "")
        rows.append((_name(group), _unit(first.unit), shown, known, _words(first.text)))
    found = _table("Outputs", ("Output", "Unit", "Shown in", "Inputs passed on directly", "Meaning"), rows)
    if found and issubclass(trace.kind, Controller):
        found.append(
            "<p>Inputs are sampled, and outputs change, at multiples of <code>T_s</code>. Right after a step an output "
            "is the one applied over that step.</p>"
        )
    return found


def _arrays(variables: Iterable[Variable]) -> list[list[Variable]]:
    """Variables one by one, the elements of an array together."""
    return [list(group) for _, group in groupby(variables, lambda variable: variable.array or variable.name)]


def _name(group: Sequence[Variable]) -> str:
    return html.escape(f"{group[0].array}[1 ... {len(group)}]" if len(group) > 1 else group[0].name)


def _span(values: Sequence[float]) -> str:
    low, high = f"{min(values):.6g}", f"{max(values):.6g}"
    return low if low == high else f"{low} ... {high}"


def _shown(values: Sequence[float], variable: Variable) -> str:
    """Start values in the display unit."""
    if variable.display_unit is None or variable.display_unit == variable.unit:
        return ""
    factor = conversion(variable.unit, variable.display_unit)
    return f"{_span([value * factor for value in values])} {_unit(variable.display_unit)}"


def _bounds(variable: Variable) -> str:
    low = f"{variable.min:.6g}" if math.isfinite(variable.min) else ""
    high = f"{variable.max:.6g}" if math.isfinite(variable.max) else ""
    if low and high:
        return f"{low} ... {high}"
    return f"&ge; {low}" if low else f"&le; {high}" if high else ""


def _unit(unit: str) -> str:
    """A unit as people write it."""
    if unit in ("", "1"):
        return ""
    shown = re.sub(r"(?<=[A-Za-z)])(-?\d+(?:\.\d+)?)", r"<sup>\1</sup>", unit)
    shown = re.sub(r"\bu(?=m\b|s\b|N\b|rad\b)", "&micro;", shown)
    return re.sub(r"\.(?=[A-Za-z])", "&middot;", shown)


def _table(title: str, heads: Sequence[str], rows: Sequence[Sequence[str]], right: Sequence[int] = ()) -> list[str]:
    if not rows:
        return []
    head = "".join(f'<th scope="col"{_align(i, right)}>{text}</th>' for i, text in enumerate(heads))
    body = "\n".join(
        f'<tr><th scope="row">{row[0]}</th>'
        + "".join(f"<td{_align(i, right)}>{cell}</td>" for i, cell in enumerate(row[1:], start=1))
        + "</tr>"
        for row in rows
    )
    return [f"<h2>{title}</h2>", f"<table>\n<thead><tr>{head}</tr></thead>\n<tbody>\n{body}\n</tbody>\n</table>"]


def _align(column: int, right: Sequence[int]) -> str:
    return ' class="n"' if column in right else ""


# ---- validation ----


def _validation(kind: type[Component]) -> list[str]:
    facts = measured(Path(inspect.getfile(kind)), kind.__name__)
    if facts is None:
        return []
    origin = (
        "integrated by scipy's Radau at a relative tolerance of 1e-10"
        if issubclass(kind, Plant)
        else "evaluated as they are"
    )
    experiments: list[Mapping[str, Any]] = facts["experiments"]
    rows = [
        (
            html.escape(signal["name"]),
            html.escape(experiment["name"]),
            f"{signal['largest_value']:.3g}",
            f"{signal['largest_difference']:.2g}",
            f"{signal['tolerance']:.2g}",
            _unit(signal["unit"]),
        )
        for experiment in experiments
        for signal in experiment["signals"]
    ]
    listed = "\n".join(
        f"<li><b>{html.escape(e['name'])}</b>: {_words(e['description'])} "
        f"({e['rows']} rows, {e['step_size'] * 1e3:.3g} ms apart).</li>"
        for e in experiments
    )
    heads = ("Output", "Experiment", "Largest value", "Largest difference", "Tolerance", "Unit")
    return [
        "<h2>Validation</h2>",
        f"<p>The reference results in <code>{EXTRA}/</code> are the equations above in Python, {origin}, without FMI. "
        f'What they mean, and how to replay them in any importer, says <a href="{GUIDE}">{GUIDE}</a>; with '
        f"motion-cosim: <code>cosim verify {kind.__name__}.fmu</code>. Experiments:</p>",
        f"<ul>\n{listed}\n</ul>",
        f'<figure><img src="{PICTURE}" alt="Reference results and what the FMU gave">',
        "<figcaption>Reference (line) and native FMU (dots) for the main outputs. Below, for every output, the "
        "difference as a share of its tolerance, the largest in colour.</figcaption></figure>",
        *_table("Measured differences of the native FMU", heads, rows, right=(2, 3, 4)),
    ]


def _footer(kind: type[Component], version: str, native: bool) -> str:
    if native:
        inside = "The C sources are in <code>sources/</code>."
    else:
        place = component_origin(kind).module.replace(".", "/")
        inside = (
            f"The equations are in <code>resources/motion_cosim/{place}.py</code>. Runs with PythonFMU "
            '(<a href="licenses/pythonfmu.txt">licence</a>) in an importer that is a Python 3.11 or later'
            f"{' with numpy and scipy' if issubclass(kind, Plant) else ''}."
        )
    return (
        f"<footer><p>{kind.__name__} {html.escape(version)}, motion-cosim. MIT licence: "
        f'<a href="licenses/license.txt">licenses/license.txt</a>. {inside}</p></footer>'
    )
