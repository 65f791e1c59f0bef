"""The page of a fit: values, values not told by the records, records against the system, residuals, their spectrum."""

from __future__ import annotations

import math
from pathlib import Path

from ..result.compare import spectrum
from ..result.plots import Panel, Series, display_unit, typeset
from ..result.report import Cell, Chart, Notes, Section, Table, Text, write_report
from .fit import Fitted, OutputFit


def write_page(fitted: Fitted, path: Path) -> Path:
    """Write the page of a fit (.html; extra ``report``). Raises DescriptionError, FileError."""
    title = fitted.fit.description or fitted.fit.name
    subtitle = (
        f"{fitted.message}; {fitted.loops} runs of a record in {fitted.seconds:.3g} s with {fitted.workers} processes"
    )
    return write_report(path, title, sections(fitted), subtitle=subtitle)


def sections(fitted: Fitted) -> list[Section]:
    """The sections of the page."""
    return [
        Section("Values", [_values(fitted), Notes(fitted.findings)] if fitted.findings else [_values(fitted)]),
        Section("Records against the system", [_agreement(fitted), *_charts(fitted)]),
        Section("Residuals", [*_residuals(fitted)]),
        Section("Correlation", [_correlation(fitted)]),
        Section("Sensitivity", [_effects(fitted)]),
        Section("Where it comes from", [_provenance(fitted)]),
    ]


def _values(fitted: Fitted) -> Table:
    rows: list[list[Cell]] = []
    for e in fitted.estimates:
        ends: list[Cell] = [e.low, e.high] if e.told else ["not told", ""]
        rows.append([e.name, e.start, e.value, *ends, typeset(e.unit), "at its bound" if e.at_bound else ""])
    return Table(rows, ("", "Start", "Value", "95 % from", "to", "Unit", ""))


def _agreement(fitted: Fitted) -> Table:
    rows: list[list[Cell]] = []
    for c in fitted.comparisons:
        unit, factor = display_unit(c.unit, c.largest)
        laps: Cell = "" if math.isnan(c.repeatability) else factor * c.repeatability
        names = f"{c.record} {c.output}", "not fitted" if c.validates else "fitted"
        rows.append([*names, factor * c.rms, factor * c.largest, typeset(unit), c.relative, c.fit, laps])
    headings = ("Record", "", "rms", "Largest", "Unit", "rms / %", "Fit / %", "Lap to lap, rms")
    return Table(rows, headings, "Record minus system. A record that was not fitted is the one to trust.")


def _charts(fitted: Fitted) -> list[Chart]:
    found: list[Chart] = []
    for record in dict.fromkeys(c.record for c in fitted.comparisons):
        panels: list[Panel] = []
        for c in _of(fitted, record):
            lines = Series("record", c.time, c.measured, 0), Series("system", c.time, c.expected, 1, dashed=True)
            off = Series("record minus system", c.time, c.measured - c.expected, 2)
            panels += [Panel(c.output, c.unit, lines), Panel(f"{c.output}, difference", c.unit, (off,))]
        found.append(Chart(panels, f"Record {record}."))
    return found


def _residuals(fitted: Fitted) -> list[Text | Chart]:
    parts: list[Text | Chart] = []
    for record in dict.fromkeys(c.record for c in fitted.comparisons):
        panels: list[Panel] = []
        for c in _of(fitted, record):
            found = spectrum(c.time, c.measured - c.expected)
            frequency, density = found.frequency, found.density
            noise = next(output.noise for output in fitted.fit.outputs if output.name == c.output)
            # The density of white noise with this standard deviation, up to half of the sampling frequency.
            level = noise / math.sqrt(float(frequency[-1]))
            lines = (
                Series("difference", frequency, density, 2),
                Series("noise", frequency, 0.0 * density + level, 7, dashed=True),
            )
            panels.append(Panel(c.output, f"{typeset(c.unit)}/\N{SQUARE ROOT}Hz", lines, log=True))
        parts.append(Chart(panels, f"Record {record}: density of the difference.", "Frequency", "Hz", log_x=True))
        said = [
            f"{c.output}: {', '.join(f'{100.0 * p.share:.2g} % near {p.frequency:.3g} Hz' for p in c.peaks)}"
            for c in _of(fitted, record)
        ]
        parts.append(Text(f"Where the power of the difference lies in {record}: {'; '.join(said)}."))
    return parts


def _correlation(fitted: Fitted) -> Table:
    names = [e.name for e in fitted.estimates]
    rows: list[list[Cell]] = [
        [name, *(float(round(fitted.correlation[i, j], 3)) if j <= i else "" for j in range(len(names)))]
        for i, name in enumerate(names)
    ]
    return Table(rows, ("", *names))


def _effects(fitted: Fitted) -> Table:
    outputs = fitted.fit.outputs
    rows: list[list[Cell]] = [[e.name, *(e.effects[o.name] for o in outputs)] for e in fitted.estimates]
    rows.append(["(noise)", *(o.noise for o in outputs)])
    headings = ("", *(f"{o.name} / {o.unit} rms" for o in outputs))
    return Table(rows, headings, "Change of the outputs for 1 % more of each value.")


def _provenance(fitted: Fitted) -> Table:
    rows: list[tuple[str, str]] = [("Fit", fitted.fit.name), ("System", fitted.fit.system)]
    for record in fitted.fit.records:
        used = "not fitted" if record.validates else "fitted"
        first, last = record.time[record.part][[0, -1]]
        rows.append((f"Record {record.name}", f"{record.path.name}, {used}, {first:g} s to {last:g} s"))
    rows += [
        (f"Noise of {o.name}", f"{o.noise:.4g} {o.unit}{'' if o.noise_given else ', from the record'}")
        for o in fitted.fit.outputs
    ]
    rows += [("Loss", fitted.fit.loss), ("Ends of the starts, rms over noise", _costs(fitted))]
    rows.append(("Share of the time in runs", f"{100.0 * _share(fitted):.3g} %"))
    return Table(rows)


def _costs(fitted: Fitted) -> str:
    return ", ".join(f"{math.sqrt(cost):.4g}" for cost in fitted.costs) or "not fitted"


def _share(fitted: Fitted) -> float:
    return fitted.run_seconds / (fitted.workers * fitted.seconds)


def _of(fitted: Fitted, record: str) -> list[OutputFit]:
    return [c for c in fitted.comparisons if c.record == record]
