"""Pictures of replayed references: the reference as a line, the output of the FMU as dots, the difference below.

The lowest panel shows the difference of every signal of the experiment as a share of its tolerance. The signal with
the largest share is in colour. Below the line at 1 the FMU is within tolerance.
"""

# matplotlib leaves the types of its keyword arguments open:
# pyright: reportUnknownMemberType=false

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..errors import DescriptionError
from ..result.plots import COLOURS, display_unit, save, typeset
from .replay import Replay, Report, Signal

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


COLUMNS = 4
"""Experiments side by side; more start new rows of panels."""

SHOWN = 3
"""Number of signals drawn if none are chosen for an experiment."""

SMALLEST = 1e-7
"""Share of the tolerance that is drawn for a difference of 0, since the axis is logarithmic."""

WIDTHS = (6.0, 8.5, 10.5, 12.0)
"""Width of the picture in inches for 1 to 4 experiments side by side."""

MARKED = 70
"""Most dots drawn of a signal; with more rows, only every second, third ... row gets a dot."""


def draw(report: Report, target: Path, shown: Mapping[str, Sequence[str]] | None = None) -> None:
    """Write the picture of a report; ``shown`` names the signals of each experiment, by default its first three.

    Raises DescriptionError if nothing was replayed or the file cannot be written.
    """
    outcomes = [outcome for outcome in report.outcomes if outcome.signals]
    if not outcomes:
        raise DescriptionError(f"picture {target}: {report.path.name} gave nothing to draw.")
    chosen = [_chosen(outcome, (shown or {}).get(outcome.experiment.name)) for outcome in outcomes]
    across = min(COLUMNS, len(outcomes))
    blocks = -(-len(outcomes) // across)
    deep = max(len(signals) for signals in chosen) + 1

    def fill(figure: Figure) -> None:
        grid = figure.add_gridspec(blocks * deep, across)
        for place, (outcome, signals) in enumerate(zip(outcomes, chosen, strict=True)):
            block, column = divmod(place, across)
            for row, signal in enumerate(signals):
                axes = figure.add_subplot(grid[block * deep + row, column])
                _signal(axes, signal)
                axes.tick_params(labelbottom=False)
                if row == 0:
                    axes.set_title(outcome.experiment.name)
                    if place == 0:
                        axes.legend(ncols=2, loc="lower right", bbox_to_anchor=(1.0, 1.0))
            _shares(figure.add_subplot(grid[block * deep + deep - 1, column]), outcome)

    save(target, fill, (WIDTHS[across - 1], 1.3 * blocks * deep + 0.5))


def _chosen(outcome: Replay, names: Sequence[str] | None) -> list[Signal]:
    if names is None:
        return list(outcome.signals[:SHOWN])
    return [signal for name in names for signal in outcome.signals if signal.name == name]


def _signal(axes: Axes, signal: Signal) -> None:
    reference, replay = (np.reshape(values, (len(signal.times), -1)) for values in (signal.reference, signal.replay))
    unit, factor = display_unit(signal.unit, float(np.max(np.abs(reference)))) if signal.unit else ("", 1.0)
    scale = display_unit("s", float(np.max(signal.times)))[1]
    every = -(-len(signal.times) // MARKED)
    axes.plot(signal.times * scale, reference * factor, color=COLOURS[0], label="reference")
    dots = axes.plot(
        signal.times[::every] * scale, replay[::every] * factor, ".", color=COLOURS[1], markersize=3.5, label="FMU"
    )
    for line in dots[1:]:
        line.set_label("")
    axes.set_ylabel(f"{_wrapped(signal.name)}\n[{typeset(unit)}]" if unit not in ("", "1") else _wrapped(signal.name))
    axes.margins(x=0.02)


def _wrapped(name: str) -> str:
    """A long name on two lines, broken at an underline."""
    if len(name) < 14 or "_" not in name:
        return name
    middle = min((i for i, c in enumerate(name) if c == "_"), key=lambda i: abs(i - len(name) // 2))
    return f"{name[: middle + 1]}\n{name[middle + 1 :]}"


def _shares(axes: Axes, outcome: Replay) -> None:
    seconds, scale = display_unit("s", float(np.max(outcome.signals[0].times)))
    worst = outcome.worst
    for signal in sorted(outcome.signals, key=lambda signal: signal is worst):
        off = np.abs(signal.differences)
        share = off / signal.limit if signal.limit > 0.0 else np.where(off > 0.0, np.inf, 0.0)
        colour, width = (COLOURS[2], 1.0) if signal is worst else ("#AAAAAA", 0.6)
        axes.plot(signal.times * scale, np.maximum(share, SMALLEST), color=colour, linewidth=width)
    axes.axhline(1.0, color=COLOURS[6], linestyle="--", linewidth=0.9)
    said = "no difference" if worst is None or worst.largest == 0.0 else worst.name
    axes.text(0.99, 0.97, said, transform=axes.transAxes, ha="right", va="top", fontsize=7.5, color=COLOURS[2])
    axes.set_yscale("log")
    axes.set_ylim(SMALLEST, 30.0)
    axes.set_yticks([1e-6, 1e-4, 1e-2, 1.0])
    axes.set_ylabel("difference\n/ tolerance")
    axes.set_xlabel(f"time [{typeset(seconds)}]")
    axes.margins(x=0.02)
