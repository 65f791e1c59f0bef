"""Pictures of the runs of a study, described by the signals that they show."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from ..result import metrics, plots
from . import expression
from .study import Outcomes, Picture

ERROR = "plant.position - trajectory.position"


@dataclass(frozen=True)
class Signals:
    """One pair of axes over time: label of a line -> ``run: signal`` or ``run: signal - signal``."""

    quantity: str
    unit: str
    """SI unit of the signals."""
    lines: Mapping[str, str]
    window: tuple[float, float] = (-math.inf, math.inf)
    """Seconds shown."""
    origin: float = 0.0
    """Time in s that is drawn as 0."""
    colours: tuple[int, ...] | None = None
    """Index of each line's colour in ``plots.COLOURS``; by default the index of the line."""
    over: float = 1.0
    """Divisor of the values."""


def over_time(title: str, panels: Sequence[Signals], *, columns: int = 1, x_quantity: str = "Time") -> Picture:
    """A picture of signals over time, one panel each, row by row."""

    def draw(outcomes: Outcomes, path: Path) -> None:
        drawn: list[plots.Panel] = []
        for panel in panels:
            series: list[plots.Series] = []
            for i, (label, text) in enumerate(panel.lines.items()):
                run, _, signals = text.partition(": ")
                result = outcomes.result(run)
                part = metrics.window(result.time, *panel.window)
                values = expression.evaluate(signals, lambda name, result=result: result[name])
                series.append(
                    plots.Series(
                        label,
                        result.time[part] - panel.origin,
                        values[part] / panel.over,
                        panel.colours[i] if panel.colours else i,
                    )
                )
            drawn.append(plots.Panel(panel.quantity, panel.unit, tuple(series)))
        plots.plot_panels(path, drawn, columns=columns, x_quantity=x_quantity)

    return Picture(title, draw)


def errors_of(title: str, runs: Mapping[str, str]) -> Picture:
    """The position errors of several runs, label -> run, one panel each over the same time axis."""
    return over_time(
        title,
        [
            Signals("Error", "m", {label: f"{run}: {ERROR}"}, colours=(i,))
            for i, (label, run) in enumerate(runs.items())
        ],
    )
