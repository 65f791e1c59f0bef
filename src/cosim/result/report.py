"""A report page: sections of tables, texts, drawings and charts that can be zoomed, in one HTML file.

The page contains all that it needs, including plotly.js (extra ``report``). Its content security policy keeps a browser
from loading anything else. It has at most ``MAX_BYTES``. Long signals are drawn as their envelope: the smallest and the
largest sample of each group of samples. The groups are as small as the size of the page allows. No peak is lost.
"""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from ..errors import DescriptionError
from ..extras import require
from ..files import check_writable, write_file
from ..version import VERSION
from .metrics import Array
from .plots import COLOURS, Panel, display_unit, envelope, largest, typeset

ENDINGS = (".html", ".htm")
MAX_BYTES = 6_000_000
"""Largest size of a page in bytes. Mail programs and issue trackers accept this size. plotly.js takes 4.8 MB of it."""
MOST_COLUMNS, LEAST_COLUMNS = 20_000, 100
"""Largest and smallest number of columns of the envelope of a long signal.

More columns are slow to draw. Fewer columns do not show the shape of the signal.
"""
DARK_COLOURS = ("#56A8DC", "#F0803C", "#2BC493", "#E39CC2", "#E69F00", "#8CCDF2", "#F2F2F2", "#A0A0A0")
"""The colours of pictures for a dark page, in the same order."""

Cell = str | float


@dataclass(frozen=True)
class Text:
    """A paragraph of plain text."""

    text: str


@dataclass(frozen=True)
class Notes:
    """A list of remarks."""

    notes: Sequence[str]


@dataclass(frozen=True)
class Table:
    """Rows of texts and numbers. Numbers are aligned to the right; a number that is not finite is shown as ``none``."""

    rows: Sequence[Sequence[Cell]]
    headings: Sequence[str] = ()
    caption: str = ""


@dataclass(frozen=True)
class Drawing:
    """A drawing as SVG markup, for example from ``diagram.draw``, and its caption."""

    svg: str
    caption: str = ""


@dataclass(frozen=True)
class Chart:
    """Panels below each other over a common x axis; they are zoomed together. ``log_x``: the x axis is logarithmic."""

    panels: Sequence[Panel]
    caption: str = ""
    x_quantity: str = "Time"
    x_unit: str = "s"
    log_x: bool = False


Part = Text | Notes | Table | Drawing | Chart


@dataclass(frozen=True)
class Section:
    """A heading and the parts below it."""

    title: str
    parts: Sequence[Part]


def check_report(path: Path) -> None:
    """Check that a page can be written to ``path``. Raises DescriptionError if it cannot, or if plotly is missing."""
    if path.suffix.lower() not in ENDINGS:
        raise DescriptionError(f"{path}: the name of a report must end in {' or '.join(ENDINGS)}.")
    require("plotly", f"{path}: to write a report")
    check_writable(path)


def write_report(path: str | Path, title: str, sections: Sequence[Section], *, subtitle: str = "") -> Path:
    """Write a page of ``sections``, whole or not at all; a section without parts is left out.

    Raises DescriptionError for another ending than .html or if plotly is missing, FileError if it cannot be written.
    """
    path = Path(path)
    check_report(path)
    sections = [section for section in sections if section.parts]
    charts = [part for section in sections for part in section.parts if isinstance(part, Chart)]
    script = str(import_module("plotly.offline").get_plotlyjs())
    bare = _render(title, subtitle, sections, [""] * len(charts), script)
    content = _charts_within(charts, MAX_BYTES - len(bare.encode()))
    return write_file(path, _render(title, subtitle, sections, content, script))


def environment() -> Environment:
    """The jinja2 environment with the templates of this package."""
    found = Environment(
        loader=PackageLoader("cosim.result"), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    found.filters["number"] = _number
    found.filters["typeset"] = typeset
    found.tests["text"] = lambda value: isinstance(value, str)
    return found


def _render(title: str, subtitle: str, sections: Sequence[Section], charts: Sequence[str], script: str) -> str:
    templates = environment()
    content = iter(charts)
    blocks: list[dict[str, Any]] = []
    for i, section in enumerate(sections):
        parts = [
            {
                "kind": type(part).__name__,
                "part": part,
                "data": Markup(next(content)) if isinstance(part, Chart) else "",
            }
            for part in section.parts
        ]
        blocks.append({"title": section.title, "anchor": f"section-{i + 1}", "parts": parts})
    return templates.get_template("report.html").render(
        title=title,
        subtitle=subtitle,
        sections=blocks,
        maker=f"cosim {VERSION}",
        # These scripts come from here and from plotly. Text of a user enters scripts only as JSON.
        plotly=Markup(script.replace("</script", "<\\/script")),
        code=Markup(templates.loader.get_source(templates, "report.js")[0] if templates.loader else ""),
        colours=Markup(_json({"light": COLOURS, "dark": DARK_COLOURS})),
        markup=Markup,
    )


def _number(value: float) -> str:
    return f"{value:.6g}" if math.isfinite(value) else "none"


# Charts.


def _charts_within(charts: Sequence[Chart], room: int) -> list[str]:
    """The charts as JSON, with as many columns as fit into ``room`` bytes.

    The number of columns is between ``LEAST_COLUMNS`` and ``MOST_COLUMNS``.
    """
    columns = MOST_COLUMNS
    while True:
        content = [_json(_chart(chart, columns)) for chart in charts]
        if sum(map(len, content)) <= room or columns <= LEAST_COLUMNS:
            return content
        columns = max(LEAST_COLUMNS, columns // 2)


def _chart(chart: Chart, columns: int) -> dict[str, Any]:
    places = [line.x for panel in chart.panels for line in panel.series if line.x.size]
    unit, factor = display_unit(chart.x_unit, largest(places))
    ends = [min(float(np.min(x)) for x in places), max(float(np.max(x)) for x in places)] if places else []
    width = max((-(-x.size // columns) for x in places if x.size > 2 * columns), default=1)
    return {
        "x": {"title": _labelled(chart.x_quantity, unit), "log": chart.log_x, "range": [factor * end for end in ends]},
        "panels": [_panel(panel, factor, columns) for panel in chart.panels],
        "note": f"Smallest and largest of every {width} samples are drawn: no peak is lost." if width > 1 else "",
    }


def _panel(panel: Panel, x_factor: float, columns: int) -> dict[str, Any]:
    peak = largest([line.y for line in panel.series])
    cut = panel.limit is not None and peak > panel.limit > 0.0
    unit, factor = display_unit(panel.unit, panel.limit if cut and panel.limit else peak)
    lines: list[dict[str, Any]] = []
    for i, line in enumerate(panel.series):
        x, y = envelope(line.x, line.y, columns)
        place = (i if line.colour is None else line.colour) % len(COLOURS)
        content = {"x": _packed(x * x_factor), "y": _packed(y * factor)}
        lines.append({"label": line.label, "colour": place, "dashed": line.dashed, **content})
    notes = [panel.heading] if panel.heading else []
    if cut:
        notes.append(f"The axis is cut off: the lines go up to {peak * factor:.3g} {typeset(unit)}.")
    return {
        "title": _labelled(panel.quantity, unit),
        "limit": panel.limit * factor if cut and panel.limit else None,
        "log": panel.log,
        "note": " ".join(notes),
        "lines": lines,
    }


def _labelled(quantity: str, unit: str) -> str:
    return quantity if unit == "1" else f"{quantity} [{typeset(unit)}]"


def _packed(values: Array) -> str:
    """Numbers as base64, 8 bytes each, little-endian. Numbers that are not finite become NaN, drawn as a gap."""
    plain = np.where(np.isfinite(values), values, np.nan)
    return base64.b64encode(plain.astype("<f8").tobytes()).decode()


def _json(content: Any) -> str:
    """JSON that is safe inside a script element."""
    return json.dumps(content, ensure_ascii=False, separators=(",", ":")).replace("<", "\\u003c")
