"""The report of a study: Markdown with pictures beside it, the same as one HTML file, and the figures as JSON."""

from __future__ import annotations

import base64
import html
import json
import math
import re
from collections.abc import Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import get_args

from markdown_it import MarkdownIt

from .rules import Numbers
from .study import Claim, Missing, Outcome, Outcomes, Status, Study, Verdict

STATUSES: tuple[Status, ...] = get_args(Status)
STYLES: dict[Status, str] = {
    "reproduced": "green",
    "fitted": "cyan",
    "order only": "yellow",
    "not reproduced": "red",
    "not checkable": "dim",
    "not run": "dim",
}
"""Colours on a terminal."""

_PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>
body {{ font: 15px/1.5 system-ui, sans-serif; max-width: 78rem; margin: 2rem auto; padding: 0 1rem; color: #222; }}
h1 {{ font-size: 1.6rem; }} h2 {{ font-size: 1.25rem; margin-top: 2.2rem; }} h3 {{ font-size: 1.05rem; }}
.table {{ overflow-x: auto; }}
table {{ border-collapse: collapse; font-size: 0.88rem; margin: 0.8rem 0; }}
th, td {{ border-bottom: 1px solid #ddd; padding: 0.3rem 0.6rem; text-align: left; vertical-align: top; }}
th {{ border-bottom: 2px solid #999; }}
td small {{ color: #666; }}
img {{ max-width: 100%; }}
code {{ background: #f3f3f3; padding: 0 0.2em; }}
td.status {{ font-weight: 600; white-space: nowrap; }}
td.reproduced {{ color: #00704f; }}
td.fitted {{ color: #005a8c; }}
td.order-only {{ color: #8a6500; }}
td.not-reproduced {{ color: #b34700; }}
td.not-checkable, td.not-run {{ color: #666; }}
</style>
</head>
<body>
{body}
</body>
</html>
"""


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


def values(numbers: Numbers, unit: str) -> str:
    """Labelled values and their unit."""
    if not numbers:
        return ""
    said = ", ".join(f"{label} {number(value)}".strip() for label, value in numbers.items())
    return f"{said} {unit}" if unit not in ("", "1") else said


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ")


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(_cell(text) for text in line) + " |" for line in lines)


def _published(claim: Claim) -> str:
    if isinstance(claim.published, str):
        return claim.published
    numbers = claim.published if isinstance(claim.published, Mapping) else {"": float(claim.published)}
    return values(numbers, claim.unit)


def _rules(claim: Claim) -> str:
    unit = f" {claim.unit}" if claim.unit not in ("", "1") else ""
    rules = {status: rule.text.replace("{unit}", unit) for status, rule in claim.verdicts.items()}
    if list(rules) == ["reproduced"]:
        return rules["reproduced"]
    return "<br>".join(f"{status}: {text}" for status, text in rules.items())


def _claim_row(verdict: Verdict) -> list[str]:
    claim = verdict.claim
    text = claim.text if not claim.setting else f"{claim.text}<br><small>{claim.setting}</small>"
    measured = values(verdict.measured, claim.unit) or verdict.reason
    if claim.note:
        measured = f"{measured}<br><small>{claim.note}</small>" if measured else f"<small>{claim.note}</small>"
    return [claim.id, text, _published(claim), measured, _rules(claim), verdict.status]


def counts(verdicts: Sequence[Verdict]) -> dict[Status, int]:
    """How many claims have each status, in the order of the statuses, zeros left out."""
    found: dict[Status, int] = {}
    for status in STATUSES:
        count = sum(verdict.status == status for verdict in verdicts)
        if count:
            found[status] = count
    return found


def _run_rows(outcome: Outcome) -> list[list[str]]:
    run = outcome.run
    changed = ", ".join(f"{name} = {value}" for name, value in run.overrides.items())
    head = [f"`{outcome.name}`", f"`{run.system}`" + (f"<br><small>{changed}</small>" if changed else "")]
    if outcome.failure:
        return [[*head, f"{outcome.steps}", f"failed: {outcome.failure}", "", "", "", ""]]
    loops = [name.removesuffix("error_max") for name in outcome.numbers if name.endswith("error_max")] or [""]
    rows: list[list[str]] = []
    for loop in loops:
        found = {name.removeprefix(loop): value for name, value in outcome.numbers.items() if name.startswith(loop)}
        micrometres = [number(1e6 * found[name]) if name in found else "" for name in ("error_max", "error_rms")]
        variation = number(found["command_tv"]) if "command_tv" in found else ""
        evaluations = sum(value for name, value in outcome.numbers.items() if name.endswith(".rhs_evaluations"))
        rejected = sum(value for name, value in outcome.numbers.items() if name.endswith(".rejected"))
        first = loop == loops[0]
        name = head if first else ["", ""]
        steps = [f"{outcome.steps}" if first else ""]
        solver = [number(evaluations / outcome.steps), f"{rejected:.0f}"] if first and outcome.steps else ["", ""]
        if loop:
            name = [f"{name[0]} {loop.rstrip('.')}", name[1]]
        rows.append([*name, *steps, *micrometres, variation, *solver])
    return rows


def _version() -> str:
    try:
        return f", version {version('motion-cosim')}"
    except PackageNotFoundError:
        return ""


def markdown(
    name: str, study: Study, outcomes: Outcomes, verdicts: Sequence[Verdict], pictures: Mapping[str, str]
) -> str:
    """The report as Markdown; ``pictures`` gives for each picture "" or why it is missing."""
    parts = [f"# {study.title}", f"Source: {study.source}", study.text.strip(), "## Verdicts"]
    parts.append(_table(["Verdict", "Claims"], [[status, f"{count}"] for status, count in counts(verdicts).items()]))
    parts.append(
        "Every verdict is computed from the figures below: a claim gets the first verdict whose rule its measured "
        "values keep, and *not reproduced* if they keep none."
    )
    for group in dict.fromkeys(claim.group for claim in study.claims):
        parts += [f"## {group}", study.groups.get(group, "")]
        rows = [_claim_row(verdict) for verdict in verdicts if verdict.claim.group == group]
        parts.append(_table(["", "Claim", "Published", "Measured", "Holds if", "Verdict"], rows))
    parts.append("## Pictures")
    for key, picture in study.pictures.items():
        missing = pictures.get(key, "")
        parts += [f"### {picture.title}", f"Not drawn: {missing}." if missing else f"![{picture.title}]({key}.png)"]
    parts.append("## Runs")
    parts.append(
        "Position error is position minus reference, over the run's window. Variation is the sum of the command's "
        "changes a second, in its unit. Evaluations are those of the plants' derivatives for one communication step."
    )
    head = ["Run", "System", "Steps", "Error max [µm]", "Error rms [µm]", "Variation [1/s]", "Evaluations", "Rejected"]
    parts.append(_table(head, [row for outcome in outcomes.all() for row in _run_rows(outcome)]))
    parts.append(f"Made by `cosim study {name}`{_version()}; all figures in SI units are in `figures.json`.")
    return "\n\n".join(part for part in parts if part) + "\n"


def to_html(text: str, title: str, folder: Path) -> str:
    """``text`` as one HTML page, the pictures of ``folder`` inside it."""
    body = str(MarkdownIt("commonmark", {"html": True}).enable("table").render(text))

    def embed(match: re.Match[str]) -> str:
        data = base64.b64encode((folder / match.group(1)).read_bytes()).decode()
        return f'src="data:image/png;base64,{data}"'

    body = re.sub(r'src="([^":]+\.png)"', embed, body)
    for status in STATUSES:
        body = body.replace(f"<td>{status}</td>", f'<td class="status {status.replace(" ", "-")}">{status}</td>')
    body = body.replace("<table>", '<div class="table"><table>').replace("</table>", "</table></div>")
    return _PAGE.format(title=html.escape(title), body=body)


def _plain(numbers: Numbers) -> dict[str, float | None]:
    """Numbers as JSON knows them: what is not finite is null."""
    return {name: float(value) if math.isfinite(value) else None for name, value in numbers.items()}


def _failure(outcome: Outcome) -> dict[str, str]:
    return {"failure": outcome.failure} if outcome.failure else {}


def write_report(folder: Path, name: str, study: Study, outcomes: Outcomes, verdicts: Sequence[Verdict]) -> Path:
    """Draw the pictures and write report.md, report.html and figures.json into ``folder``; the path of report.html."""
    folder.mkdir(parents=True, exist_ok=True)
    missing: dict[str, str] = {}
    for key, picture in study.pictures.items():
        try:
            picture.draw(outcomes, folder / f"{key}.png")
        except Missing as error:
            missing[key] = str(error)
    text = markdown(name, study, outcomes, verdicts, missing)
    (folder / "report.md").write_text(text, encoding="utf-8")
    page = folder / "report.html"
    page.write_text(to_html(text, study.title, folder), encoding="utf-8")
    figures = {
        "runs": {outcome.name: {**_plain(outcome.numbers), **_failure(outcome)} for outcome in outcomes.all()},
        "claims": {
            verdict.claim.id: {
                "verdict": verdict.status,
                "unit": verdict.claim.unit,
                "measured": _plain(verdict.measured),
            }
            for verdict in verdicts
        },
    }
    (folder / "figures.json").write_text(json.dumps(figures, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    return page
