"""The pages that explain: figures are measured here, or read from files that tests and benchmarks write.

The pages are written by hand in docs/explanations. ``{{ name }}`` in them is replaced by what the functions here give,
and pictures are drawn beside them.
"""

from __future__ import annotations

import json
import re
import tomllib
from collections import Counter
from pathlib import Path
from typing import Any

from jinja2 import Environment, StrictUndefined

from cosim.study import STATUSES, read_claims

from . import failing, sampling, work
from .components import IMPORTERS
from .markup import table

ROOT = Path(__file__).resolve().parents[2]
FIGURES = ROOT / "benchmarks" / "figures.json"


def write(folder: Path) -> None:
    """Fill in the pages of ``folder``/explanations and draw their pictures."""
    place = folder / "explanations"
    pictures = place / "pictures"
    pictures.mkdir(exist_ok=True)
    measured = json.loads(FIGURES.read_text(encoding="utf-8"))
    known: dict[str, Any] = {
        **sampling.measured(pictures),
        **work.measured(pictures, measured["integrator"]),
        **failing.measured(pictures),
        **claims(),
        **validation(),
        **axis(),
        **benchmarks(measured),
    }
    environment = Environment(undefined=StrictUndefined, autoescape=False, keep_trailing_newline=True)
    for page in sorted(place.glob("*.md")):
        page.write_text(environment.from_string(page.read_text(encoding="utf-8")).render(known), encoding="utf-8")
    words = (place / "reproduced.md").read_text(encoding="utf-8")
    missing = {status for kind in STATUSES.values() for status in kind if f"**{status}**" not in words}
    if missing:
        raise ValueError(f"explanations/reproduced.md does not explain {', '.join(sorted(missing))}")


def claims() -> dict[str, Any]:
    """How many claims the studies hold, and one of them as it stands in its file."""
    rows: list[tuple[object, ...]] = []
    total: Counter[str] = Counter()
    for path in sorted((ROOT / "studies").glob("*/claims.toml")):
        data = read_claims(path)
        count = Counter(held.kind for held in data.tables for _ in held.claims)
        total += count
        rows.append((f"`{path.parent.name}`", data.title, count["paper"], count["check"], count["finding"]))
    rows.append(("all", "", total["paper"], total["check"], total["finding"]))
    text = (ROOT / "studies" / "shams2010" / "claims.toml").read_text(encoding="utf-8")
    found = re.search(r'\[\[tables\.claims\]\]\nid = "C3"\n.*?\n(?=\[\[)', text, re.DOTALL)
    assert found is not None
    heads = ("Study", "About", "Claims of the paper", "Checks of our code", "Findings")
    return {"claims_table": table(heads, rows), "claims_total": total["paper"], "claim_example": found.group().strip()}


def validation() -> dict[str, Any]:
    """What is checked against what: counts of files and of rows of tables."""
    references = sorted((ROOT / "fmus" / "references").glob("*/*_reference.csv"))
    rows = json.loads(IMPORTERS.read_text(encoding="utf-8"))
    # "OMSimulator, SSP of one FMU" and "fmusim with event mode" tell how an importer was used, after its name.
    names = {re.split(r",| \(| with ", row["importer"])[0] for row in rows if row["section"] != "Checkers"}
    return {
        "experiments": len(references),
        "components": len({path.parent for path in references}),
        "importers": ", ".join(sorted(names, key=str.lower)),
        "importer_count": len(names),
    }


def axis() -> dict[str, Any]:
    """What the fits of the measured axis left, from the figures that the study stores."""
    figures = tomllib.loads((ROOT / "studies" / "emps" / "figures.toml").read_text(encoding="utf-8"))
    plants = {
        "published_symmetric": "published values, symmetric friction",
        "published_asymmetric": "published values, asymmetric friction",
        "symmetric": "fitted, symmetric Coulomb friction",
        "asymmetric": "fitted, asymmetric",
        "lugre": "fitted, LuGre friction",
        "rising": "fitted, friction that rises with speed",
        "lag": "fitted, with a lag of the drive",
        "ripple": "fitted, with ripple",
    }
    rows = [
        (text, f"{1e6 * figures[name]['position_rms']:.2f}", f"{100.0 * figures[name]['force']:.1f}")
        for name, text in plants.items()
    ]
    laps = figures["ripple"]
    rows.append(
        ("the machine from lap to lap", f"{1e6 * laps['position_laps']:.2f}", f"{100.0 * laps['force_laps']:.1f}")
    )
    return {"axis_table": table(("Plant", "Position of the loop, rms in µm", "Force, % of its rms"), rows)}


def benchmarks(kept: dict[str, Any]) -> dict[str, Any]:
    """The figures that the benchmarks keep, as tables, each with its machine."""
    found: dict[str, Any] = {}
    for name, entry in kept.items():
        machine = entry["machine"]
        load = f"; {machine['load']} programs wanted to run in the minute before" if machine.get("load") else ""
        found[f"bench_{name}"] = "\n\n".join(
            (
                entry["text"],
                table(entry["heads"], entry["rows"]),
                f"*Made on {machine['processor']}, {machine['cores']} cores, {machine['system']}, "
                f"Python {machine['python']}{load}.*",
            )
        )
        found |= {f"bench_{name}_{key}": value for key, value in entry["more"].items()}
    return found
