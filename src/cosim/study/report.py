"""The report of a study: one HTML page, the same as Markdown with its pictures beside it, and the figures as JSON."""

from __future__ import annotations

import base64
import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markdown_it import MarkdownIt

from ..files import write_file
from ..version import VERSION
from .rules import Numbers
from .study import COPY, STATUSES, Claim, Kind, Missing, Outcome, Outcomes, Status, Study, Verdict

KINDS: Mapping[Kind, tuple[str, str]] = {
    "paper": (
        "Claims of the paper",
        "Fitted: a choice was made after the figure was seen. Transferred: it holds on a machine that is not that of "
        "the paper.",
    ),
    "check": (
        "Checks of our code",
        "Expected are figures of another simulation of the same equations: agreement proves the code, not the model.",
    ),
    "finding": ("Findings", "Nobody published them: they are measured and not judged."),
}
"""Heading and explanation of the claims of each kind."""

RUN_HEADS = ("Steps", "Error max [µm]", "Error rms [µm]", "Variation [1/s]", "Evaluations", "Rejected")


def number(value: float) -> str:
    """A value with four figures, without needless zeros; "none" for NaN."""
    if math.isnan(value):
        return "none"
    if value == 0.0 or math.isinf(value):
        return f"{value:g}"
    if 1e-4 <= abs(value) < 1e6:
        decimals = max(0, 3 - math.floor(math.log10(abs(value))))
        text = f"{value:.{decimals}f}"
        return text.rstrip("0").rstrip(".") if decimals else text
    mantissa, exponent = f"{value:.3e}".split("e")
    return f"{mantissa.rstrip('0').rstrip('.')}e{int(exponent)}"


def values(numbers: Numbers, claim: Claim) -> str:
    """Labelled values in a line; the unit stands once if it is the same for all."""
    units = {claim.unit_of(label) for label in numbers}
    parts: list[str] = []
    for label, value in numbers.items():
        unit = claim.unit_of(label)
        parts.append(f"{label} {number(value)}{f' {unit}' if len(units) > 1 and unit != '1' else ''}".strip())
    common = next(iter(units)) if len(units) == 1 else ""
    return ", ".join(parts) + (f" {common}" if common not in ("", "1") else "")


def counts(verdicts: Iterable[Verdict], kind: Kind) -> dict[Status, int]:
    """How many claims of a kind have each status, the best first, zeros left out."""
    found = [verdict.status for verdict in verdicts if verdict.claim.kind == kind]
    return {status: found.count(status) for status in STATUSES[kind] if status in found}


def slug(text: str) -> str:
    """A text as an identifier in HTML: letters and digits stay, other characters become hyphens or codes."""
    kept = (
        char if char.isalnum() and char.isascii() else "-" if char in " .,()" else f"{ord(char):x}" for char in text
    )
    return "".join(kept)


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ")


def _cells(claim: Claim, verdict: Verdict) -> list[dict[str, str]]:
    """One entry for each value, with label, published value, measured value, spread and unit."""
    published = claim.published_numbers()
    labels = list(dict.fromkeys([*published, *verdict.measured])) or [""]
    cells: list[dict[str, str]] = []
    for label in labels:
        spread = verdict.spread.get(label)
        unit = claim.unit_of(label)
        cells.append(
            {
                "label": label,
                "published": number(published[label]) if label in published else "",
                "measured": number(verdict.measured[label]) if label in verdict.measured else "",
                "spread": _spread(*spread) if spread else "",
                "unit": "" if unit == "1" else unit,
            }
        )
    return cells


def _spread(low: float, high: float) -> str:
    """Both ends of a range as text; one number if both have the same four figures."""
    ends = dict.fromkeys((number(low), number(high)))
    return " … ".join(ends)


def _rules(claim: Claim) -> list[dict[str, str]]:
    unit = claim.unit if isinstance(claim.unit, str) and claim.unit not in ("", "1") else ""
    alone = list(claim.verdicts) in (["reproduced"], ["agrees"])
    return [
        {
            "status": "" if alone else status,
            "text": rule.text.replace("{unit}", f" {unit}" if unit else ""),
            "why": rule.why,
        }
        for status, rule in claim.verdicts.items()
    ]


def _measured_line(claim: Claim, numbers: Numbers, spread: Mapping[str, tuple[float, float]]) -> str:
    line = values(numbers, claim) if numbers else ""
    parts = [f"{label} {_spread(low, high)}".strip() for label, (low, high) in spread.items()]
    return f"{line} (spread {', '.join(parts)})" if parts else line


def _row(verdict: Verdict) -> dict[str, Any]:
    claim = verdict.claim
    words = claim.published if isinstance(claim.published, str) and claim.kind != "finding" else ""
    return {
        "id": claim.id,
        "text": claim.text,
        "words": words,
        "setting": claim.setting,
        "note": claim.note,
        "status": verdict.status,
        "reason": verdict.reason,
        "cells": _cells(claim, verdict),
        "rules": _rules(claim),
        "published_line": words or values(claim.published_numbers(), claim),
        "measured_line": _measured_line(claim, verdict.measured, verdict.spread),
        "readings": [
            {
                "setting": reading.setting,
                "status": reading.status,
                "reason": reading.reason,
                "measured_line": values(reading.measured, claim) if reading.measured else "",
                "cells": [
                    {"label": label, "measured": number(value), "unit": "" if (u := claim.unit_of(label)) == "1" else u}
                    for label, value in reading.measured.items()
                ]
                or [{"label": "", "measured": "", "unit": ""}],
            }
            for reading in verdict.readings
        ],
    }


def _tables(study: Study, verdicts: Sequence[Verdict], markdown: MarkdownIt) -> list[dict[str, Any]]:
    tables: list[dict[str, Any]] = []
    for group in dict.fromkeys(claim.group for claim in study.claims):
        found = [verdict for verdict in verdicts if verdict.claim.group == group]
        kind = found[0].claim.kind
        text = study.groups.get(group, "")
        if kind == "check":
            text = f"{text} {KINDS[kind][1]}".strip()
        tables.append(
            {
                "title": group,
                "anchor": f"table-{slug(group)}",
                "text": markdown.render(text),
                "source_text": text,
                "heading": {"paper": "Claim", "check": "Figure", "finding": "Finding"}[kind],
                "given": {"paper": "Published", "check": "Expected", "finding": ""}[kind],
                "rules": "" if kind == "finding" else "Holds if",
                "verdict": {"paper": "Verdict", "check": "Check", "finding": ""}[kind],
                "rows": [_row(verdict) for verdict in found],
            }
        )
    return tables


def _boxes(verdicts: Sequence[Verdict]) -> list[dict[str, Any]]:
    boxes: list[dict[str, Any]] = []
    for kind, (title, text) in KINDS.items():
        found = counts(verdicts, kind)
        if found:
            entries = [
                {"status": s, "ids": [v.claim.id for v in verdicts if v.claim.kind == kind and v.status == s]}
                for s in found
            ]
            boxes.append({"title": title, "text": text, "total": sum(found.values()), "entries": entries})
    return boxes


def changed_values(outcome: Outcome) -> str:
    """The changed start values of a run as text; an array is shown by its length only, as "table of" so many."""
    arrays: dict[str, int] = {}
    parts: list[str] = []
    for name, value in outcome.run.overrides.items():
        element = re.fullmatch(r"(.+)\[\d+(?:,\d+)*\]", name)
        if element:
            arrays[element[1]] = arrays.get(element[1], 0) + 1
        else:
            parts.append(f"{name} = {value:.6g}" if isinstance(value, float) else f"{name} = {value}")
    parts += [f"{name} = table of {count}" for name, count in arrays.items()]
    parts += [f"{name} times {factor:.9g}" for name, factor in outcome.run.scaled.items()]
    return ", ".join(parts)


def _run_rows(outcome: Outcome) -> list[dict[str, Any]]:
    head = {
        "name": outcome.name,
        "system": outcome.run.system,
        "changed": changed_values(outcome),
        "failure": outcome.failure,
        "loop": "",
    }
    if outcome.failure:
        return [{**head, "cells": [f"{outcome.steps}", *[""] * (len(RUN_HEADS) - 1)]}]
    loops = [name.removesuffix("error_max") for name in outcome.numbers if name.endswith("error_max")] or [""]
    rows: list[dict[str, Any]] = []
    for loop in loops:
        found = {name.removeprefix(loop): value for name, value in outcome.numbers.items() if name.startswith(loop)}
        micrometres = [number(1e6 * found[name]) if name in found else "" for name in ("error_max", "error_rms")]
        variation = number(found["command_tv"]) if "command_tv" in found else ""
        evaluations = sum(value for name, value in outcome.numbers.items() if name.endswith(".rhs_evaluations"))
        rejected = sum(value for name, value in outcome.numbers.items() if name.endswith(".rejected"))
        first = loop == loops[0]
        solver = [number(evaluations / outcome.steps), f"{rejected:.0f}"] if first and outcome.steps else ["", ""]
        rows.append(
            {
                **(head if first else {"name": "", "system": "", "changed": "", "failure": ""}),
                "loop": loop.rstrip("."),
                "cells": [f"{outcome.steps}" if first else "", *micrometres, variation, *solver],
            }
        )
    return rows


def _chapters(study: Study, outcomes: Outcomes, markdown: MarkdownIt) -> list[dict[str, Any]]:
    chapters: list[dict[str, Any]] = []
    for title, write in study.chapters.items():
        try:
            text = write(outcomes)
        except Missing as missing:
            text = f"Not written: {missing}."
        html = markdown.render(text)
        chapters.append({"title": title, "anchor": f"chapter-{slug(title)}", "text": text, "html": html})
    return chapters


def _plain(numbers: Numbers) -> dict[str, float | None]:
    """Numbers as JSON allows them: infinity and NaN become null."""
    return {name: float(value) if math.isfinite(value) else None for name, value in numbers.items()}


def _figures(outcomes: Outcomes, verdicts: Sequence[Verdict]) -> dict[str, Any]:
    claims: dict[str, Any] = {}
    for verdict in verdicts:
        claim = verdict.claim
        claims[claim.id] = {
            "kind": claim.kind,
            "verdict": verdict.status,
            "unit": claim.unit if isinstance(claim.unit, str) else dict(claim.unit),
            "measured": _plain(verdict.measured),
        }
        if verdict.spread:
            claims[claim.id]["spread"] = {label: list(ends) for label, ends in verdict.spread.items()}
        if verdict.readings:
            claims[claim.id]["readings"] = {r.setting: _plain(r.measured) for r in verdict.readings}
    runs = {
        outcome.name: {**_plain(outcome.numbers), **({"failure": outcome.failure} if outcome.failure else {})}
        for outcome in outcomes.all()
    }
    return {"runs": runs, "claims": claims}


def write_report(folder: Path, name: str, study: Study, outcomes: Outcomes, verdicts: Sequence[Verdict]) -> Path:
    """Draw the pictures and write report.md, report.html and figures.json into ``folder``; the path of report.html."""
    folder.mkdir(parents=True, exist_ok=True)
    pictures: list[dict[str, str]] = []
    for key, picture in study.pictures.items():
        entry = {"key": key, "title": picture.title, "missing": "", "data": ""}
        try:
            picture.draw(outcomes, folder / f"{key}.png")
            entry["data"] = base64.b64encode((folder / f"{key}.png").read_bytes()).decode()
        except Missing as error:
            entry["missing"] = str(error)
        pictures.append(entry)
    markdown = MarkdownIt("commonmark", {"html": False}).enable("table")
    runs, copies = (
        [row for o in outcomes.all() if (COPY in o.name) is wanted for row in _run_rows(o)] for wanted in (False, True)
    )
    boxes = _boxes(verdicts)
    context = {
        "name": name,
        "study": study,
        "text": markdown.render(study.text),
        "boxes": boxes,
        "statuses": list(dict.fromkeys(entry["status"] for box in boxes for entry in box["entries"])),
        "tables": _tables(study, verdicts, markdown),
        "chapters": _chapters(study, outcomes, markdown),
        "pictures": pictures,
        "runs": runs,
        "copies": copies,
        "run_heads": RUN_HEADS,
        "version": f", version {VERSION}",
    }
    page = folder / "report.html"
    for file in (folder / "report.md", page):
        environment = Environment(
            loader=PackageLoader("cosim.study"),
            undefined=StrictUndefined,
            autoescape=file == page,
            keep_trailing_newline=True,
        )
        environment.filters |= {"slug": slug, "cell": _cell}
        write_file(file, environment.get_template(file.name).render(context))
    figures = json.dumps(_figures(outcomes, verdicts), indent=1, allow_nan=False)
    write_file(folder / "figures.json", figures + "\n")
    return page
