"""One picture of one or several runs and records, in a notebook or a file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

from ..errors import DescriptionError
from ..files import write_file
from ..record.read import Record
from .align import Side, pair, side_of
from .plots import Panel, Series, check_format, panels_drawing, rendered, run_panels
from .summary import Loop, Recorded, loops

MOST_PANELS = 8
"""Largest number of signals that are drawn if none are named. More do not fit on a page."""


@dataclass(frozen=True)
class Picture:
    """A picture: a notebook shows it, ``save`` writes it."""

    panels: tuple[Panel, ...]
    title: str = ""
    _content: dict[str, bytes] = field(default_factory=dict[str, bytes], repr=False)

    def content(self, ending: str = "png") -> bytes:
        """The picture as the content of a file: png, svg, pdf ..."""
        if ending not in self._content:
            self._content[ending] = rendered(*panels_drawing(self.panels, title=self.title), ending)
        return self._content[ending]

    def save(self, path: str | Path) -> Path:
        """Write the picture. Raises DescriptionError for an unknown ending, FileError if it cannot be written."""
        path = Path(path)
        check_format(path)
        return write_file(path, self.content(path.suffix.lower()[1:]))

    def _repr_png_(self) -> bytes:
        return self.content()


def plot(
    sources: Recorded | Record | Sequence[Recorded | Record],
    path: str | Path | None = None,
    *,
    signals: Mapping[str, str] | Sequence[str] | None = None,
    labels: Sequence[str] | None = None,
) -> Picture:
    """Draw runs and records: one panel for each signal, with one line for each source.

    ``path``: the file to write, if any.
    ``signals``: names, or ``{name: other}`` if some sources have the signal under the name ``other``. By default, a
    single run is drawn with its loops; several sources are drawn with the signals that at least two of them have.
    ``labels``: one for each source. Default for a run: its system, and the start values in which the runs differ.
    Default for a record: the name of its file.

    If the reference and the position of a loop are drawn, its error is drawn, too. Values are in the unit of the first
    source that has the signal. Raises DescriptionError for names that no source has, and for units that do not convert;
    FileError if the file cannot be written.
    """
    given = list(sources) if isinstance(sources, Sequence) else [sources]
    if not given:
        raise DescriptionError("nothing to draw: give at least one run or record.")
    if labels is not None and len(labels) != len(given):
        raise DescriptionError(f"{len(labels)} labels for {len(given)} runs and records: give one each.")
    if len(given) == 1 and signals is None and not isinstance(given[0], Record):
        panels = run_panels(given[0])
    else:
        names = list(labels) if labels is not None else source_labels(given)
        panels = _panels([side_of(source, name) for source, name in zip(given, names, strict=True)], given, signals)
    picture = Picture(tuple(panels))
    if path is not None:
        picture.save(path)
    return picture


def source_labels(sources: Sequence[Recorded | Record]) -> list[str]:
    """A label for each source. Labels of runs of one system include the start values in which the runs differ."""
    values = [_start_values(source) for source in sources]
    names: list[str] = []
    for source, own in zip(sources, values, strict=True):
        if isinstance(source, Record):
            names.append(source.path.name)
            continue
        system = source.metadata.get("system", "run")
        same = [
            other
            for entry, other in zip(sources, values, strict=True)
            if not isinstance(entry, Record) and entry.metadata.get("system", "run") == system
        ]
        differing = [name for name in dict.fromkeys(n for v in same for n in v) if len({v.get(name) for v in same}) > 1]
        said = [f"{name}={own[name]}" for name in differing if name in own]
        names.append(", ".join([str(system), *said]))
    return [name if names.count(name) == 1 else f"{name} ({i + 1})" for i, name in enumerate(names)]


def _start_values(source: Recorded | Record) -> dict[str, str]:
    if isinstance(source, Record):
        return {}
    entries = cast("Mapping[str, Mapping[str, Any]]", source.metadata.get("start_values", {}))
    return {name: f"{entry['value']} {entry['unit']}".strip() for name, entry in entries.items()}


def _panels(
    sides: Sequence[Side], sources: Sequence[Recorded | Record], signals: Mapping[str, str] | Sequence[str] | None
) -> list[Panel]:
    others = dict(signals) if isinstance(signals, Mapping) else {}
    if signals is None:
        names = [name for name in dict.fromkeys(n for side in sides for n in side.values) if _count(sides, name) > 1]
        names = (names if len(sides) > 1 else list(sides[0].values))[:MOST_PANELS]
        if not names:
            raise DescriptionError("no two of them have a signal of one name: say which belong together in signals.")
    else:
        names = list(signals)
    problems: list[str] = []
    panels: list[Panel] = []
    drawn: dict[str, list[Side | None]] = {}
    for name in names:
        try:
            found = _signal(sides, name, others.get(name, name))
        except DescriptionError as error:
            problems += error.problems
            continue
        drawn[name] = found
        lines = [
            Series(side.label, side.time, side.values[name], i) for i, side in enumerate(found) if side is not None
        ]
        unit = next(side.units[name] for side in found if side is not None)
        panels.append(Panel("Value", unit, tuple(lines), heading=name))
    if problems:
        raise DescriptionError(problems)
    runs = [source for source in sources if not isinstance(source, Record)]
    for loop in loops(runs[0]) if runs else ():
        if loop.reference in drawn and loop.position in drawn and loop.scale == (1.0, 0.0):
            panels.append(_error_panel(loop, drawn[loop.reference], drawn[loop.position]))
    return panels


def _count(sides: Sequence[Side], name: str) -> int:
    return sum(name in side.values for side in sides)


def _signal(sides: Sequence[Side], name: str, other: str) -> list[Side | None]:
    """A signal of each side under ``name``, in the unit of the first side that has it. None for a side without it."""
    own = [name if name in side.values else other for side in sides]
    first = next((i for i, side in enumerate(sides) if own[i] in side.values), None)
    if first is None:
        sides[0].named(name)  # raises DescriptionError
        return []
    reference = Side(
        "", sides[first].time, {name: sides[first].values[own[first]]}, {name: sides[first].units[own[first]]}
    )
    found: list[Side | None] = []
    for side, called in zip(sides, own, strict=True):
        found.append(pair(reference, side, {name: called}).b if called in side.values else None)
    return found


def _error_panel(loop: Loop, references: Sequence[Side | None], positions: Sequence[Side | None]) -> Panel:
    """A panel with the tracking error of a loop, for each side that has its reference and position."""
    lines: list[Series] = []
    unit = "1"
    for i, (reference, position) in enumerate(zip(references, positions, strict=True)):
        if reference is not None and position is not None:
            unit = position.units[loop.position]
            error = position.values[loop.position] - reference.values[loop.reference]
            lines.append(Series(position.label, position.time, error, i))
    return Panel("Error", unit, tuple(lines), heading=f"{loop.name}: {loop.position} minus {loop.reference}")
