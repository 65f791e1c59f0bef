"""Pictures of recorded signals, without a display, as PNG or another format (by the ending of the file).

Values are in SI units. Each axis has a display unit that suits the size of its values. The colours are those of Okabe
and Ito, which colour-blind readers can tell apart, in a fixed order: give the same thing the same place in every
picture. Long signals are drawn as their envelope, so no peak is lost. matplotlib (extra
``plots``) is loaded with the first picture.
"""

# matplotlib leaves the types of its keyword arguments open:
# pyright: reportUnknownMemberType=false

from __future__ import annotations

import io
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from ..errors import DescriptionError
from ..extras import require
from ..files import check_writable, write_file
from ..public import public_names
from ..units import conversion
from .metrics import Array, max_abs
from .summary import Loop, Recorded, loops

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__dir__ = public_names(globals())


COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#999999")
"""Line colours in order (Okabe and Ito 2008). Yellow is left out because it is pale on white."""

PICTURES = (".png", ".pdf", ".svg", ".jpg", ".jpeg", ".webp", ".tif", ".tiff", ".eps")
"""Allowed endings of picture files."""

POINTS = 4000
"""Number of columns of the envelope of a long signal. A signal with more than twice as many samples is long."""

_DISPLAY = {
    "m": ("mm", "um", "nm"),
    "m/s": ("m/s", "mm/s", "um/s"),
    "rad": ("rad", "mrad", "urad"),
    "s": ("s", "ms", "us"),
    "N": ("kN", "N", "mN", "uN"),
    "A": ("A", "mA"),
    "V": ("V", "mV"),
}

_NO_DATE: Mapping[str, dict[str, None]] = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}
"""Metadata by the ending of the file: no date. With the fixed salt below, equal pictures have equal bytes."""
_STYLE: dict[str, Any] = {
    "svg.hashsalt": "cosim",
    "font.size": 9.0,
    "axes.titlesize": 9.0,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#DDDDDD",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "lines.linewidth": 1.1,
    "legend.frameon": False,
    "legend.fontsize": 8.0,
    "figure.dpi": 130.0,
    "savefig.dpi": 130.0,
}


@dataclass(frozen=True)
class Series:
    """One line: ``y`` over ``x`` in the units of its panel."""

    label: str
    x: Array
    y: Array
    colour: int | None = None
    """Index in ``COLOURS``; by default the index of the line in its panel."""
    dashed: bool = False


@dataclass(frozen=True)
class Panel:
    """One pair of axes: a quantity, its SI unit and its lines."""

    quantity: str
    unit: str
    series: tuple[Series, ...]
    log: bool = False
    limit: float | None = None
    """The axis ends at plus and minus this value. If lines are cut off, a note above the panel says so."""
    heading: str = ""
    """Text above the panel, on the left."""


def display_unit(unit: str, peak: float) -> tuple[str, float]:
    """The display unit for values in the SI ``unit`` up to ``peak``, and the factor to it.

    The largest display unit is taken if the peak is at least 1 in it. Otherwise, the largest smaller unit is taken in
    which the peak is at least 0.1. A unit without display units is kept.
    """
    if unit not in _DISPLAY:
        return unit, 1.0
    choice = unit
    for i, candidate in enumerate(_DISPLAY[unit]):
        choice = candidate
        if peak * conversion(unit, candidate) >= (0.1 if i else 1.0):
            break
    if peak == 0.0 or not math.isfinite(peak):
        choice = _DISPLAY[unit][0]
    return choice, conversion(unit, choice)


def typeset(unit: str) -> str:
    """A unit as it is written in a picture: ``N.m`` as N·m, ``m/s2`` as m/s², ``um`` as µm."""
    unit = re.sub(r"(?<=[a-z)])(\d+\.\d+)", lambda match: "^" + match.group(1).replace(".", ","), unit, flags=re.I)
    unit = re.sub(r"(?<=[a-z)])([23])", lambda match: "²³"[int(match.group(1)) - 2], unit, flags=re.I)
    return re.sub(r"\bu(?=m\b|s\b|N\b|rad\b)", "µ", unit.replace(".", "·")).replace(",", ".")


def envelope(x: Array, y: Array, columns: int = POINTS) -> tuple[Array, Array]:
    """The envelope of a signal: the smallest and the largest ``y`` of each of at most ``columns`` groups of samples.

    All groups but the last have the same number of samples. Both extremes keep their ``x`` and their order. A signal
    with at most 2 * ``columns`` samples is returned unchanged. Samples that are not finite are ignored, unless a group
    has no others; this group is then drawn as a gap.
    """
    if x.size <= 2 * columns:
        return x, y
    width = -(-x.size // columns)
    whole = x.size // width * width
    starts = [*range(0, whole, width), whole]
    finite = np.isfinite(y)
    low, high = (y, y) if finite.all() else (np.where(finite, y, np.inf), np.where(finite, y, -np.inf))
    lowest = low[:whole].reshape(-1, width).argmin(axis=1)
    highest = high[:whole].reshape(-1, width).argmax(axis=1)
    if whole < x.size:
        lowest, highest = np.append(lowest, low[whole:].argmin()), np.append(highest, high[whole:].argmax())
    first = np.asarray(starts[: lowest.size])
    index = np.sort(np.column_stack((first + lowest, first + highest)), axis=1).ravel()
    return x[index], y[index]


def save(path: Path, draw: Callable[[Figure], None], size: tuple[float, float]) -> None:
    """Write the picture that ``draw`` makes, whole or not at all; ``size`` in inches.

    Raises DescriptionError for another ending than those in PICTURES, FileError if the file cannot be written.
    """
    check_format(path)
    content = rendered(draw, size, path.suffix.lower()[1:])
    write_file(path, content)


def rendered(draw: Callable[[Figure], None], size: tuple[float, float], ending: str = "png") -> bytes:
    """The picture that ``draw`` makes, as the content of a file with this ending; ``size`` in inches.

    Raises DescriptionError if matplotlib is not installed or not usable.
    """
    require("matplotlib", "to draw a picture")
    try:
        import matplotlib
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ValueError as error:  # of its settings
        remedy = "Correct the variable MPLBACKEND or the file matplotlibrc."
        raise DescriptionError(f"matplotlib: {error}. {remedy}") from None

    content = io.BytesIO()
    with matplotlib.rc_context(cast(Any, _STYLE)):
        figure = Figure(figsize=size, layout="constrained")
        FigureCanvasAgg(figure)
        draw(figure)
        figure.savefig(content, format=ending, metadata=_NO_DATE.get(ending))
    return content.getvalue()


def check_format(path: Path) -> None:
    """Raise DescriptionError if the ending of ``path`` is not in PICTURES, or if matplotlib is not installed."""
    if path.suffix.lower() not in PICTURES:
        raise DescriptionError(f"{path}: the name of a picture must end in {', '.join(PICTURES)}.")
    require("matplotlib", f"{path}: to draw a picture")


def check_picture(path: Path) -> None:
    """Raise DescriptionError if a picture cannot be written to ``path``."""
    check_format(path)
    check_writable(path)


def largest(arrays: Sequence[Array]) -> float:
    """Largest magnitude of the finite values of several arrays, 0 if there is none."""
    finite = [float(np.max(np.abs(part))) for array in arrays if (part := array[np.isfinite(array)]).size]
    return max(finite, default=0.0)


def _draw_panel(axes: Axes, panel: Panel, x_unit: str) -> None:
    x_factor = display_unit(x_unit, largest([series.x for series in panel.series]))[1]
    peak = largest([series.y for series in panel.series])
    cut = panel.limit is not None and peak > panel.limit > 0.0
    unit, factor = display_unit(panel.unit, panel.limit if cut and panel.limit else peak)
    for i, series in enumerate(panel.series):
        x, y = envelope(series.x, series.y)
        axes.plot(
            x * x_factor,
            y * factor,
            color=COLOURS[(i if series.colour is None else series.colour) % len(COLOURS)],
            linestyle="--" if series.dashed else "-",
            label=series.label,
        )
    if panel.log:
        axes.set_yscale("log")
    if cut and panel.limit:
        axes.set_ylim(-panel.limit * factor, panel.limit * factor)
        axes.set_title(f"cut off: up to {peak * factor:.3g} {typeset(unit)}", fontsize=8.0, color="#666666")
    axes.set_ylabel(f"{panel.quantity} [{typeset(unit)}]" if unit != "1" else panel.quantity)
    axes.margins(x=0.0)
    if panel.heading:
        axes.set_title(panel.heading, loc="left")
    label = panel.series[0].label if panel.series else ""
    if len(panel.series) > 1 or (panel.heading and label):
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=min(len(panel.series), 4), borderaxespad=0.0)
    elif label:
        axes.set_title(label)


def plot_panels(
    path: Path,
    panels: Sequence[Panel],
    *,
    title: str = "",
    columns: int = 1,
    x_quantity: str = "Time",
    x_unit: str = "s",
) -> None:
    """Write a picture of panels below each other (row by row if there are several ``columns``), over a common x axis.

    A panel with one line and no heading has the line's label as its title; other panels have a legend. ``x_unit`` is an
    SI unit. Raises DescriptionError without panels or for an unknown ending, FileError if the file cannot be written.
    """
    if not panels:
        raise DescriptionError(f"picture {path}: nothing to draw.")
    draw, size = panels_drawing(panels, title=title, columns=columns, x_quantity=x_quantity, x_unit=x_unit)
    save(path, draw, size)


def panels_drawing(
    panels: Sequence[Panel], *, title: str = "", columns: int = 1, x_quantity: str = "Time", x_unit: str = "s"
) -> tuple[Callable[[Figure], None], tuple[float, float]]:
    """The function that draws panels (see ``plot_panels``), and the size of the picture in inches."""
    rows = math.ceil(len(panels) / columns)

    def draw(figure: Figure) -> None:
        if title:
            figure.suptitle(title, fontsize=10.0)
        column_tops: list[Axes] = []
        for i, panel in enumerate(panels):
            share = column_tops[i % columns] if i >= columns else None
            axes = figure.add_subplot(rows, columns, i + 1, sharex=share)
            if share is None:
                column_tops.append(axes)
            _draw_panel(axes, panel, x_unit)
            if i + columns >= len(panels):
                peak = largest([series.x for series in panel.series])
                unit = display_unit(x_unit, peak)[0]
                axes.set_xlabel(f"{x_quantity} [{typeset(unit)}]" if unit != "1" else x_quantity)
            else:
                axes.tick_params(labelbottom=False)

    return draw, (7.2 if columns == 1 else 4.6 * columns, 0.6 + 1.75 * rows)


def plot_run(result: Recorded, path: Path) -> None:
    """Write a picture of a run with the panels of ``run_panels``. Raises DescriptionError or FileError."""
    plot_panels(path, run_panels(result))


def run_panels(result: Recorded) -> list[Panel]:
    """The panels of a run: reference and position, error and command of every loop. Without a loop, all signals.

    The axis of the error fits the second half of the run. If the error at the start is much larger, it is cut off, and
    a note says so.
    """
    panels: list[Panel] = []
    found = loops(result)
    if found:
        one = len(found) == 1

        def name(loop: Loop, text: str) -> str:
            return text if one else f"{loop.name} {text}".rstrip()

        panels.append(
            Panel(
                "Position",
                found[0].unit(result),
                tuple(
                    series
                    for i, loop in enumerate(found)
                    for series in (
                        Series(name(loop, "position"), result.time, result[loop.position], 2 * i),
                        Series(
                            name(loop, "reference"), result.time, loop.reference_values(result), 2 * i + 1, dashed=True
                        ),
                    )
                ),
            )
        )
        errors = tuple(Series(name(loop, ""), result.time, loop.error(result), 2 * i) for i, loop in enumerate(found))
        settled = 1.5 * max(max_abs(series.y[series.y.size // 2 :]) for series in errors)
        limit = settled if largest([series.y for series in errors]) > 4.0 * settled else None
        panels.append(Panel("Error", found[0].unit(result), errors, limit=limit))
        for unit in dict.fromkeys(result.unit(loop.command) for loop in found if loop.command):
            panels.append(
                Panel(
                    "Command",
                    unit,
                    tuple(
                        Series(name(loop, ""), result.time, result[loop.command], 2 * i)
                        for i, loop in enumerate(found)
                        if loop.command and result.unit(loop.command) == unit
                    ),
                )
            )
    else:
        panels += signal_panels(result, result.names)
    return panels


def signal_panels(result: Recorded, names: Sequence[str], most: int | None = None) -> list[Panel]:
    """Signals over time. Signals of one unit share a panel, or several panels with at most ``most`` lines each."""
    panels: list[Panel] = []
    for unit in dict.fromkeys(result.unit(name) for name in names):
        members = tuple(Series(name, result.time, result[name]) for name in names if result.unit(name) == unit)
        step = most or len(members)
        panels += [Panel("Value", unit, members[first : first + step]) for first in range(0, len(members), step)]
    return panels


def plot_errors(path: Path, errors: Mapping[str, tuple[Array, Array]], *, title: str = "", unit: str = "m") -> None:
    """Draw the errors of several runs, label -> (time in s, error), in one panel each over the same time axis.

    Raises DescriptionError for an unknown ending, FileError if the file cannot be written.
    """
    panels = [
        Panel("Error", unit, (Series(label, time, error, i),))
        for i, (label, (time, error)) in enumerate(errors.items())
    ]
    plot_panels(path, panels, title=title)


def plot_phase_plane(
    path: Path,
    series: Sequence[Series],
    *,
    x: tuple[str, str] = ("Error", "m"),
    y: tuple[str, str] = ("Error rate", "m/s"),
    title: str = "",
) -> None:
    """Draw trajectories of ``y`` over ``x``, which are (name, SI unit). A dot marks the end of each line.

    Raises DescriptionError for an unknown ending, FileError if the file cannot be written.
    """
    x_unit, x_factor = display_unit(x[1], largest([line.x for line in series]))
    y_unit, y_factor = display_unit(y[1], largest([line.y for line in series]))

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        axes.axhline(0.0, color="#888888", linewidth=0.6)
        axes.axvline(0.0, color="#888888", linewidth=0.6)
        for i, line in enumerate(series):
            colour = COLOURS[(i if line.colour is None else line.colour) % len(COLOURS)]
            axes.plot(
                line.x * x_factor,
                line.y * y_factor,
                color=colour,
                label=line.label,
                linestyle="--" if line.dashed else "-",
            )
            axes.plot(line.x[-1:] * x_factor, line.y[-1:] * y_factor, "o", color=colour, markersize=4.0)
        axes.set_xlabel(f"{x[0]} [{typeset(x_unit)}]")
        axes.set_ylabel(f"{y[0]} [{typeset(y_unit)}]")
        axes.set_title(title)
        if len(series) > 1:
            axes.legend()

    save(path, draw, (4.8, 4.2))


@dataclass(frozen=True)
class Polar:
    """A double-ball-bar picture: radial deviations in m over the commanded angle in rad; ``radius`` in m."""

    title: str
    radius: float
    series: tuple[Series, ...]
    magnification: float | None = None
    """Scale of the deviations relative to the scale of the radius. None: 1, 2 or 5 times a power of ten is chosen."""


def magnification(radius: float, deviation: float) -> float:
    """The largest 1, 2 or 5 times a power of ten that draws ``deviation`` no larger than 0.35 of ``radius``."""
    if deviation == 0.0:
        return 1.0
    wanted = 0.35 * radius / deviation
    power = 10.0 ** math.floor(math.log10(wanted))
    return max(step * power for step in (1.0, 2.0, 5.0) if step * power <= wanted)


def plot_polar(path: Path, plots: Sequence[Polar], *, title: str = "") -> None:
    """Draw polar error plots side by side. A point is at radius + magnification*deviation in its commanded direction.

    The heavy circle is the commanded path. The rings are labelled with their deviation.
    Raises DescriptionError for an unknown ending, FileError if the file cannot be written.
    """
    if not plots:
        raise DescriptionError(f"picture {path}: nothing to draw.")

    def draw(figure: Figure) -> None:
        if title:
            figure.suptitle(title, fontsize=10.0)
        for i, plot in enumerate(plots):
            _draw_polar(figure.add_subplot(1, len(plots), i + 1), plot)

    save(path, draw, (4.2 * len(plots) + 0.2, 4.8))


def _draw_polar(axes: Axes, plot: Polar) -> None:
    peak = largest([series.y for series in plot.series])
    scale = plot.magnification or magnification(plot.radius, peak)
    unit, factor = display_unit("m", peak)
    gain = scale / (plot.radius * factor)  # display unit -> radii
    axes.set_aspect("equal")
    axes.set_axis_off()
    _draw_rings(axes, peak * factor, gain)
    for i, series in enumerate(plot.series):
        r = 1.0 + gain * factor * np.append(series.y, series.y[:1])
        angle = np.append(series.x, series.x[:1])
        axes.plot(
            r * np.cos(angle),
            r * np.sin(angle),
            color=COLOURS[(i if series.colour is None else series.colour) % len(COLOURS)],
            linestyle="--" if series.dashed else "-",
            label=series.label,
        )
    axes.set_title(
        f"{plot.title}\nradius {plot.radius * 1e3:g} mm, deviation x {scale:,.0f}, rings in {typeset(unit)}",
        loc="center",
    )
    if len(plot.series) > 1:
        axes.legend(loc="center", facecolor="white", frameon=True, edgecolor="none")


def _draw_rings(axes: Axes, peak: float, gain: float) -> None:
    """Draw rings of equal deviation up to ``peak``, and the four directions; ``gain`` is radii for a deviation of 1."""
    from matplotlib.ticker import MaxNLocator

    turn = np.linspace(0.0, 2.0 * math.pi, 721)
    rings = MaxNLocator(nbins=5, symmetric=True).tick_values(-peak, peak)
    edge = 1.0 + 1.08 * gain * float(max(rings[-1], peak))
    for ring in rings:
        r = 1.0 + gain * float(ring)
        if r <= 0.0:
            continue
        commanded = abs(ring) < 1e-9 * rings[-1]
        axes.plot(
            r * np.cos(turn),
            r * np.sin(turn),
            color="#444444" if commanded else "#CCCCCC",
            linewidth=1.0 if commanded else 0.6,
        )
        at = r * math.sqrt(0.5)
        box = {"boxstyle": "round,pad=0.15", "facecolor": "white", "edgecolor": "none"}
        axes.text(at, at, f"{ring:g}", fontsize=6.5, ha="center", va="center", bbox=box, zorder=5)
    for x, y, name in ((1, 0, "+X"), (0, 1, "+Y"), (-1, 0, "-X"), (0, -1, "-Y")):
        axes.plot((0, x * edge), (0, y * edge), color="#CCCCCC", linewidth=0.6)
        axes.text(1.06 * x * edge, 1.06 * y * edge, name, ha="center", va="center")
