"""Shows a comparison: as rows of a table, as a picture, as a page."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..record.read import Record
from .compare import Comparison, Difference
from .picture import Picture
from .plots import Panel, Series, display_unit, typeset
from .report import Chart, Notes, Part, Section, Table, Text, write_report
from .result import Result
from .run_report import figure_parts, provenance, system_parts
from .summary import Figure, FigureOfMerit, Missing

MOST_SIGNALS = 8
"""Largest number of signals in a picture or page. If there are more, those that differ most are shown."""


def comparison_rows(found: Comparison) -> list[Figure]:
    """The figures of a comparison as rows of a table, each in a unit that suits the size of the difference."""
    rows: list[Figure] = []
    for entry in found.differences:
        head = entry.name if entry.name == entry.other else f"{entry.name} / {entry.other}"
        if not math.isfinite(entry.maximum):
            rows.append(Missing(f"{head}: difference", "a signal is not finite everywhere"))
            continue
        unit, factor = display_unit(entry.unit, entry.maximum)
        rows += [
            FigureOfMerit(f"{head}: difference, maximum, at {entry.at:.6g} s", factor * entry.maximum, unit),
            FigureOfMerit(f"{head}: difference, rms", factor * entry.rms, unit),
            FigureOfMerit(f"{head}: difference, mean", factor * entry.mean, unit),
        ]
        if math.isfinite(entry.relative):
            rows.append(FigureOfMerit(f"{head}: rms, relative to that of {found.a}", 100.0 * entry.relative, "%"))
        fit = f"{head}: fit (NRMSE)"
        varies = math.isfinite(entry.fit)
        rows.append(FigureOfMerit(fit, entry.fit, "%") if varies else Missing(fit, f"{found.a} does not vary"))
        if entry.spectrum is not None and entry.rms > 0.0:
            said = f"{head}: largest component, at {entry.spectrum.peak_frequency:.4g} Hz"
            rows.append(FigureOfMerit(said, factor * entry.spectrum.peak_amplitude, unit))
        if entry.outside is not None:
            out = entry.outside
            said = f"{head}: outside the tolerance, first at {out.first:.6g} s"
            rows += [
                FigureOfMerit(said, 100.0 * out.share, "% of the samples"),
                FigureOfMerit(f"{head}: beyond it by", factor * out.excess, unit),
            ]
    for entry in found.tracking:
        unit, factor = display_unit(entry.unit, max(entry.rms_a, entry.rms_b))
        rows += [
            FigureOfMerit(f"{entry.loop}: tracking error of {found.a}, rms", factor * entry.rms_a, unit),
            FigureOfMerit(f"{entry.loop}: tracking error of {found.b}, rms", factor * entry.rms_b, unit),
            FigureOfMerit(f"{entry.loop}: difference of the tracking errors, maximum", factor * entry.maximum, unit),
            FigureOfMerit(f"{entry.loop}: difference of the tracking errors, rms", factor * entry.rms, unit),
        ]
    return rows


def comparison_panels(found: Comparison) -> list[Panel]:
    """For each signal of ``shown``, a panel with both sides, and below it a panel with the difference and the tube."""
    panels: list[Panel] = []
    for entry in shown(found):
        name = entry.name if entry.name == entry.other else f"{entry.name} / {entry.other}"
        both = Series(found.a, entry.time, entry.a, 0), Series(found.b, entry.time, entry.b, 1, dashed=True)
        lines = [Series(f"{found.b} minus {found.a}", entry.time, entry.difference, 2)]
        if entry.tube is not None:
            limits = (entry.tube[0] - entry.a, entry.tube[1] - entry.a)
            lines += [
                Series(label, entry.time, limit, 7, dashed=True)
                for label, limit in zip(("tolerance", ""), limits, strict=True)
            ]
        panels += [Panel("Value", entry.unit, both, heading=name), Panel("Difference", entry.unit, tuple(lines))]
    return panels


def shown(found: Comparison) -> list[Difference]:
    """The signals that differ most, at most ``MOST_SIGNALS``, in the order in which they were compared."""

    def weight(entry: Difference) -> tuple[bool, float]:
        relative = entry.relative if math.isfinite(entry.relative) else entry.maximum
        return entry.outside is not None, relative if math.isfinite(relative) else math.inf

    chosen = sorted(found.differences, key=weight, reverse=True)[:MOST_SIGNALS]
    return [entry for entry in found.differences if any(entry is other for other in chosen)]


def plot_comparison(found: Comparison, path: str | Path | None = None) -> Picture:
    """Both sides and their differences as a picture. It is written to ``path`` if this is given.

    Raises DescriptionError for an unknown ending, FileError if the file cannot be written.
    """
    picture = Picture(tuple(comparison_panels(found)), f"{found.b} compared with {found.a}")
    if path is not None:
        picture.save(path)
    return picture


def comparison_sections(found: Comparison, *, notes: Sequence[str] = ()) -> list[Section]:
    """The sections of the page of a comparison."""
    spectra = [
        Panel(
            "Density",
            f"{typeset(entry.unit)}/\N{SQUARE ROOT}Hz",
            (Series(entry.name, entry.spectrum.frequency, entry.spectrum.density),),
            log=True,
        )
        for entry in shown(found)
        if entry.spectrum is not None and np.any(entry.spectrum.density > 0.0)
    ]
    left_out = len(found.differences) - len(shown(found))
    more = f" {left_out} signals that differ less are not drawn." if left_out else ""
    text = "Amplitude spectral density of the difference: its square integrates to the variance."
    return [
        Section(
            "Comparison",
            [Notes([f"Compared: {found.how}.", *found.notes, *notes]), *figure_parts(comparison_rows(found))],
        ),
        Section(
            "Signals and differences",
            [Chart(comparison_panels(found), caption=f"Difference: {found.b} minus {found.a}.{more}")],
        ),
        Section("Spectra", [Chart(spectra, text, "Frequency", "Hz", log_x=True)] if spectra else []),
    ]


def report_comparison(
    found: Comparison, path: str | Path, sources: tuple[Result | Record, Result | Record], *, notes: Sequence[str] = ()
) -> Path:
    """Write the page of a comparison of ``sources``. ``notes`` are added to the notes of the comparison.

    Raises DescriptionError for another ending than .html or .htm or if plotly is missing, FileError if the file cannot
    be written.
    """
    sections = comparison_sections(found, notes=notes)
    for label, source in zip((found.a, found.b), sources, strict=True):
        if isinstance(source, Result):
            parts: list[Part] = [*system_parts(source.metadata), *provenance(source.metadata)]
        else:
            shown = [(name, typeset(source.units[name])) for name in source.columns]
            span = f"{source.time.size} rows, {source.time[0]:.9g} s to {source.time[-1]:.9g} s: {source.path}"
            parts = [Text(span), Table(shown, ("Column", "Unit"))]
        sections.append(Section(label, parts))
    return write_report(path, f"{found.b} compared with {found.a}", sections)
