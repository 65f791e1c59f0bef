"""The view of a result in a notebook."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Protocol

from ..record.description import Column
from .report import environment
from .summary import Recorded, summary

MOST_SIGNALS = 20
"""Largest number of signals in the list."""


class Shown(Recorded, Protocol):
    """The part of a Result that the view needs."""

    @property
    def columns(self) -> Sequence[Column]: ...
    @property
    def partial(self) -> bool: ...


def result_html(result: Shown) -> str:
    """A result as HTML: its figures of merit, and its signals with unit and range."""
    facts = result.metadata
    signals: list[dict[str, Any]] = []
    for column in result.columns[:MOST_SIGNALS]:
        values = result[column.name]
        ends = (float(values.min()), float(values.max()), float(values[-1])) if values.size else (math.nan,) * 3
        named = {"name": column.name, "unit": column.unit, "description": column.description}
        signals.append({**named, "low": ends[0], "high": ends[1], "end": ends[2]})
    return (
        environment()
        .get_template("result.html")
        .render(
            title=str(facts.get("description") or facts.get("system", "Result")),
            partial=result.partial,
            rows=result.time.size,
            span=f"{result.time[0]:.6g} s to {result.time[-1]:.6g} s" if result.time.size else "",
            figures=summary(result),
            signals=signals,
            more=max(0, len(result.columns) - MOST_SIGNALS),
        )
    )
