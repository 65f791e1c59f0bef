"""The page of a run: figures, charts, the system with its start values, and the origin of everything."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast

from .diagram import Block, Wire, draw
from .plots import COLOURS, run_panels, signal_panels, typeset
from .report import Cell, Chart, Drawing, Notes, Part, Section, Table, Text, write_report
from .result import Result
from .summary import Figure, loops, not_finite, summary

MOST_SIGNALS = 32
"""Largest number of signals drawn in addition to the signals of the loops. More make the page slow."""
MAX_MESSAGES, MAX_ELEMENTS = 50, 6
"""Largest number of messages on the page, and of array elements in a line. More are rarely read."""


def report_run(result: Result, path: str | Path, *, notes: Sequence[str] = (), also: Sequence[Section] = ()) -> Path:
    """Write the page of a run. ``notes`` are added to the notes of the system; ``also`` comes after the signals.

    Raises DescriptionError for another ending than .html or .htm or if plotly is missing, FileError if the file cannot
    be written.
    """
    facts = result.metadata
    system = str(facts.get("system", "Run"))
    return write_report(
        path,
        str(facts.get("description") or system),
        run_sections(result, notes=notes, also=also),
        subtitle=system if facts.get("description") else "",
    )


def run_sections(result: Result, *, notes: Sequence[str] = (), also: Sequence[Section] = ()) -> list[Section]:
    """The sections of the page of a run. A section without content has no parts."""
    return [
        Section("Notes", _notes(result, notes)),
        Section("Figures of merit", figure_parts(summary(result))),
        Section("Signals", [Chart(run_panels(result))] if result.time.size > 1 else [Text("Nothing was recorded.")]),
        Section("Other signals", _other_signals(result)),
        *also,
        Section("System", system_parts(result.metadata)),
        Section("Solver", _solver(result)),
        Section("Provenance", provenance(result.metadata)),
        Section("Messages", _messages(result)),
    ]


def _other_signals(result: Result) -> list[Part]:
    """Charts of the recorded signals that belong to no loop.

    Empty for a run without loops, because ``run_panels`` then draws all signals.
    """
    found = loops(result)
    drawn = {name for loop in found for name in (loop.reference, loop.position, loop.command)}
    names = [name for name in result.names if name not in drawn]
    if not found or not names or result.time.size < 2:
        return []
    parts: list[Part] = [Chart(signal_panels(result, names[:MOST_SIGNALS], len(COLOURS)))]
    more = names[MOST_SIGNALS:]
    return [*parts, Text(f"Not drawn: {', '.join(more)}.")] if more else parts


def figure_parts(figures: Sequence[Figure]) -> list[Part]:
    """The table of figures, each with its unit, or with the reason why it has no value."""
    rows: list[tuple[Cell, ...]] = [
        (row.name, "none", row.reason) if row.reason else (row.name, row.value, typeset(row.unit)) for row in figures
    ]
    return [Table(rows, ("Figure", "Value", "Unit"))] if rows else []


def _notes(result: Result, notes: Sequence[str]) -> list[Part]:
    said = list(dict.fromkeys((*cast("Sequence[str]", result.metadata.get("notes", ())), *notes)))
    if result.partial:
        reached = f" at {result.time[-1]:.9g} s" if result.time.size else ""
        said.insert(0, f"The run ended early{reached}.")
    said += [f"{name} is not finite from {time:.9g} s on." for name, time in not_finite(result).items()]
    return [Notes(said)] if said else []


def system_parts(facts: Mapping[str, Any]) -> list[Part]:
    """The block diagram and the start values of a system, from the metadata of its run."""
    wires = cast("Sequence[Mapping[str, Any]]", facts.get("wires", ()))
    rows = _start_values(facts.get("start_values", {}))
    table = Table(rows, ("Variable", "Here", "In the FMU", "Unit"), "Start values that differ from those of the FMU.")
    parts: list[Part] = [_diagram(facts, wires)] if facts.get("fmus") else []
    return [*parts, *([table] if rows else [])]


def _start_values(entries: Mapping[str, Mapping[str, Any]]) -> list[tuple[Cell, ...]]:
    """The rows of a table: one for each variable, and one for all elements of an array."""
    arrays: dict[str, list[str]] = {}
    for name in entries:
        arrays.setdefault(name.partition("[")[0] if name.endswith("]") else name, []).append(name)
    rows: list[tuple[Cell, ...]] = []
    for array, names in arrays.items():
        values = [[_value(entries[name][key]) for name in names] for key in ("value", "fmu")]
        unit = typeset(entries[names[0]]["unit"])
        if len(names) == 1:
            rows.append((names[0], values[0][0], values[1][0], unit))
        else:
            rows.append((f"{array} ({len(names)} elements)", *(_several(column) for column in values), unit))
    return rows


def _several(values: Sequence[Cell]) -> str:
    """The values of an array as text: one value if all are equal, all values if they are few, else their range."""
    texts = [value if isinstance(value, str) else f"{value:.6g}" for value in values]
    if len(set(texts)) == 1:
        return f"all {texts[0]}"
    numbers = [value for value in values if not isinstance(value, str)]
    if len(texts) <= MAX_ELEMENTS or len(numbers) < len(values):
        return ", ".join(texts[:MAX_ELEMENTS]) + (", ..." if len(texts) > MAX_ELEMENTS else "")
    return f"{min(numbers):.6g} to {max(numbers):.6g}"


def _value(value: object) -> Cell:
    if isinstance(value, bool):
        return str(value).lower()
    return float(value) if isinstance(value, int | float) else "none" if value is None else str(value)


def _diagram(facts: Mapping[str, Any], wires: Sequence[Mapping[str, Any]]) -> Drawing:
    fmus = cast("Mapping[str, Mapping[str, Any]]", facts["fmus"])
    records = cast("Mapping[str, Mapping[str, Any]]", facts.get("signals", {}))
    order = [str(name) for name in facts.get("evaluation_order", ())]
    others = [str(wire[end][0]) for wire in wires for end in ("from", "to")]
    blocks: list[Block] = []
    for name in dict.fromkeys((*order, *fmus, *others)):
        entry = fmus.get(name, {})
        kind = entry["fmu"] if entry else Path(str(records.get(name, {}).get("file", ""))).name
        blocks.append(Block(name, str(kind), str(entry.get("description", ""))))
    drawn = [Wire(_end(wire["from"]), _end(wire["to"]), typeset(wire["units"][0]), _change(wire)) for wire in wires]
    steps = facts.get("order")
    told = (
        "at once, with the outputs of the point before" if steps == "parallel" else f"in the order {', '.join(order)}"
    )
    return Drawing(draw(blocks, drawn), f"Every wire carries its unit. The instances step {told}.")


def _end(end: Sequence[str]) -> tuple[str, str]:
    return end[0], end[1]


def _change(wire: Mapping[str, Any]) -> str:
    """The text at the end of a wire: factor, target unit and noise, each only if it changes the value."""
    (before, after), factor = wire["units"], wire["factor"]
    said = [f"\N{MULTIPLICATION SIGN}{factor:.5g}"] if factor != 1.0 else []
    said += [typeset(after)] if after != before else []
    said += [f"+ noise {wire['noise']:.3g} {typeset(after)}".rstrip()] if "noise" in wire else []
    return " ".join(said)


def _solver(result: Result) -> list[Part]:
    kinds = list(dict.fromkeys(kind for counts in result.solver.values() for kind in counts))
    rows: list[tuple[Cell, ...]] = [
        (name, *(counts.get(kind, "") for kind in kinds)) for name, counts in result.solver.items()
    ]
    return [Table(rows, ("Instance", *(kind.replace("_", " ") for kind in kinds)))] if kinds else []


def provenance(facts: Mapping[str, Any]) -> list[Part]:
    """Tables with digest, times, versions and FMUs of a run, from its metadata. Empty tables are left out."""
    order = facts.get("order", "")
    rows: list[tuple[Cell, ...]] = [
        (text, f"{facts[key]:.12g} {unit}".strip() if isinstance(facts[key], int | float) else str(facts[key]))
        for text, key, unit in (
            ("System", "system", ""),
            ("Digest of everything that decides the results, SHA-256", "system_digest", ""),
            ("Start time", "start_time", "s"),
            ("Stop time", "stop_time", "s"),
            ("Communication step", "step_size", "s"),
            ("Steps", "steps", ""),
            ("Decimation of the record", "decimation", ""),
            ("Tolerance told to the FMUs", "tolerance", ""),
            ("Stepping took", "stepping_seconds", "s"),
        )
        if facts.get(key) is not None
    ]
    if order:
        rows.append(("Order", order if isinstance(order, str) else ", ".join(order)))
    versions = cast("Mapping[str, str]", facts.get("versions", {}))
    rows += [(f"Version of {name}", text) for name, text in versions.items()]
    fmus = cast("Mapping[str, Mapping[str, Any]]", facts.get("fmus", {}))
    table: list[tuple[Cell, ...]] = [
        (name, str(f["fmu"]), f"{f.get('fmi', '')}", str(f.get("version", "")), str(f["digest"]))
        for name, f in fmus.items()
    ]
    heads = ("Instance", "FMU", "FMI", "Version", "SHA-256 of the file")
    signals = cast("Mapping[str, Mapping[str, str]]", facts.get("signals", {}))
    records: list[tuple[Cell, ...]] = [(name, entry["file"], entry["digest"]) for name, entry in signals.items()]
    record_heads = ("Signal", "File", "SHA-256 of the file")
    tables = (Table(rows), Table(table, heads), Table(records, record_heads))
    return [table for table in tables if table.rows]


def _messages(result: Result) -> list[Part]:
    more = len(result.messages) - MAX_MESSAGES + result.dropped_messages
    shown: list[Part] = [Notes([str(message) for message in result.messages[:MAX_MESSAGES]])] if result.messages else []
    return [*shown, *([Text(f"And {more} more.")] if more > 0 else [])]
