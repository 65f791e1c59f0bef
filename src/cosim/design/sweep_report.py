"""The report of a sweep: the varied parameters, the dependence of every figure on them, best runs and failed runs."""

# matplotlib leaves the types of its keyword arguments open:
# pyright: reportUnknownMemberType=false

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import DescriptionError
from ..files import write_file
from ..result.metrics import Array
from ..result.plots import save, typeset
from .dataset import DataSet
from .plan import RUN_COLUMNS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MAX_PAIRS = 6
"""Largest number of pairs of parameters that get a map for each figure: all pairs of four parameters."""
REPORT = "report.md"
"""Name of the report in the folder of the runs."""
SHOWN = 10
"""Largest number of best runs, and of failed runs, in a table of the report."""


def write_report(runs: Runs) -> Path:
    """Write ``report.md`` and a picture for each figure into the folder of the runs; returns the report's path.

    Raises FileError if one of them cannot be written.
    """
    folder, about, columns, spreads = runs.folder, runs.about, runs.columns, runs.spreads
    parameters: list[str] = about["parameters"]
    failed = [(run, error) for run, error in zip(columns["run"], columns["error"], strict=True) if error]
    lines = [
        f"# {about['description'] or about['name']}",
        "",
        f"System {about['system']}, {about['method']} of {about['runs']} runs over "
        + ", ".join(f"{path} [{about['units'][path]}]" for path in parameters)
        + f". {len(columns['run'])} runs are recorded, {len(failed)} of them failed.",
        "",
    ]
    if spreads:
        lines += ["| figure | unit | least | median | largest | in run |", "|" + "---|" * 6]
        for spread in spreads:
            ends = " | ".join(f"{value:.6g}" for value in (spread.least, spread.median, spread.largest))
            lines.append(f"| {spread.name} | {spread.unit} | {ends} | {spread.run} |")
        lines.append("")
    for name, unit in ((spread.name, spread.unit) for spread in spreads):
        values = _values(columns[name])
        finite = np.isfinite(values)
        picture = folder / f"{name.replace('.', '_')}.png"
        _draw(picture, _labelled(name, unit), values, {path: columns[path] for path in parameters}, about["units"])
        lines += [f"## {name}", "", f"![{name}]({picture.name})", ""]
        order = [int(i) for i in np.argsort(np.where(finite, values, np.inf))[:SHOWN] if finite[i]]
        lines += [
            "| run | " + " | ".join(parameters) + f" | {_labelled(name, unit)} |",
            "|" + "---|" * (len(parameters) + 2),
        ]
        for i in order:
            given = " | ".join(_shown(columns[path][i]) for path in parameters)
            lines.append(f"| {columns['run'][i]} | {given} | {values[i]:.6g} |")
        lines.append("")
    if failed:
        lines += ["## Failed runs", ""]
        lines += [f"- run {run}: {error}" for run, error in failed[:SHOWN]]
        if len(failed) > SHOWN:
            lines.append(f"- and {len(failed) - SHOWN} more")
        lines.append("")
    return write_file(folder / REPORT, "\n".join(lines))


@dataclass(frozen=True)
class Spread:
    """How a figure is spread over the runs of a data set that did not fail."""

    name: str
    unit: str
    """"" if the data set does not say it."""
    least: float
    median: float
    largest: float
    run: int
    """The run with the largest value."""


@dataclass(frozen=True)
class Runs:
    """The runs of the data set in ``folder``; ``columns`` are its columns by name."""

    folder: Path
    about: Mapping[str, Any]
    columns: Mapping[str, list[Any]]

    @cached_property
    def spreads(self) -> list[Spread]:
        """The spread of every figure."""
        return _spreads(self.columns, self.about["parameters"], self.about.get("figures", {}))


def read_runs(folder: Path) -> Runs:
    """The runs of the data set in ``folder``. Raises DescriptionError if there is none."""
    data = DataSet(folder)
    try:
        about = data.about()
    except FileNotFoundError:
        raise DescriptionError(f"{folder} holds no sweep.") from None
    columns: dict[str, list[Any]] = data.read().to_pydict()
    if not columns["run"]:
        raise DescriptionError(f"{folder} holds no run yet.")
    return Runs(folder, about, columns)


def _values(column: list[Any]) -> Array:
    return np.array([math.nan if value is None else value for value in column])


def _spreads(columns: Mapping[str, list[Any]], parameters: Sequence[str], units: Mapping[str, str]) -> list[Spread]:
    found: list[Spread] = []
    for name in columns:
        if name in RUN_COLUMNS or name in parameters:
            continue
        values = _values(columns[name])
        finite = values[np.isfinite(values)]
        if finite.size:
            run = columns["run"][int(np.argmax(np.where(np.isfinite(values), values, -np.inf)))]
            ends = float(finite.min()), float(np.median(finite)), float(finite.max())
            found.append(Spread(name, units.get(name, ""), *ends, run))
    return found


def _labelled(name: str, unit: str) -> str:
    return name if unit in ("", "1") else f"{name} [{typeset(unit)}]"


def _shown(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _numbers(values: list[Any]) -> tuple[Array, list[str] | None]:
    """The values as numbers. Texts and booleans become indices; the names behind the indices are returned, too."""
    if all(isinstance(value, float) for value in values):
        return np.array(values), None
    labels = sorted({str(value) for value in values})
    return np.array([float(labels.index(str(value))) for value in values]), labels


def _is_log(values: Array) -> bool:
    distinct = np.unique(values)
    if distinct.size < 3 or distinct[0] <= 0.0 or distinct[-1] < 10.0 * distinct[0]:
        return False
    return float(np.ptp(np.diff(np.log(distinct)))) < float(np.ptp(np.diff(distinct))) / float(distinct[-1])


def _draw(picture: Path, name: str, values: Array, given: Mapping[str, list[Any]], units: Mapping[str, str]) -> None:
    """Draw a figure: as a line if one parameter varies, else as a map for each pair of parameters."""
    varied = [path for path, column in given.items() if len(set(column)) > 1] or list(given)[:1]
    axes_of = {path: _numbers(given[path]) for path in varied}
    pairs = list(itertools.combinations(varied, 2))[:MAX_PAIRS]

    def scale(axes: Axes, path: str, which: str) -> None:
        numbers, labels = axes_of[path]
        if labels is not None:
            ticks = list(range(len(labels)))
            (axes.set_xticks if which == "x" else axes.set_yticks)(ticks, labels)
        elif _is_log(numbers):
            (axes.set_xscale if which == "x" else axes.set_yscale)("log")
        (axes.set_xlabel if which == "x" else axes.set_ylabel)(_labelled(path, units[path]))

    def draw(figure: Figure) -> None:
        if not pairs:
            axes = figure.add_subplot()
            x = axes_of[varied[0]][0]
            order = np.argsort(x)
            axes.plot(x[order], values[order], ".-")
            scale(axes, varied[0], "x")
            axes.set_ylabel(name)
            return
        for i, (across, up) in enumerate(pairs):
            axes = figure.add_subplot(-(-len(pairs) // 3), min(len(pairs), 3), i + 1)
            axes.grid(visible=False)
            mappable = heat_map(axes, axes_of[across][0], axes_of[up][0], values)
            scale(axes, across, "x")
            scale(axes, up, "y")
            figure.colorbar(mappable, ax=axes, label=name if len(pairs) == 1 else "")
        if len(pairs) > 1:
            figure.suptitle(f"{name} (mean over the other parameters)", fontsize=10.0)

    columns = max(1, min(len(pairs), 3))
    save(picture, draw, (1.2 + 4.2 * columns, 0.4 + 3.6 * max(1, -(-len(pairs) // 3))))


def heat_map(axes: Axes, x: Array, y: Array, values: Array) -> Any:
    """Draw cells with mean values if the points form a grid, else coloured points; returns what a colour bar needs."""
    across, up = np.unique(x), np.unique(y)
    if across.size * up.size > max(values.size, 1):
        finite = np.isfinite(values)
        axes.plot(x[~finite], y[~finite], "x", color="#999999", markersize=4.0)
        return axes.scatter(x[finite], y[finite], c=values[finite], s=16.0)
    total, count = np.zeros((up.size, across.size)), np.zeros((up.size, across.size))
    finite = np.isfinite(values)
    at = np.searchsorted(up, y[finite]), np.searchsorted(across, x[finite])
    np.add.at(total, at, values[finite])
    np.add.at(count, at, 1.0)
    cells = np.divide(total, count, out=np.full_like(total, np.nan), where=count > 0.0)
    return axes.pcolormesh(_edges(across), _edges(up), cells)


def _edges(centres: Array) -> Array:
    """Edges of cells around ascending ``centres``: midpoints of neighbours, for equal ratios of their logarithms."""
    if centres.size == 1:
        half = abs(float(centres[0])) / 2.0 or 0.5
        return np.array([centres[0] - half, centres[0] + half])
    log = _is_log(centres)
    at = np.log(centres) if log else centres
    middle = 0.5 * (at[1:] + at[:-1])
    edges = np.concatenate(([2.0 * at[0] - middle[0]], middle, [2.0 * at[-1] - middle[-1]]))
    return np.exp(edges) if log else edges
