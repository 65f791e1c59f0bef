"""The figures that the benchmarks keep: benchmarks/figures.json, of which docs/explanations/benchmarks is made.

Each benchmark writes its own entry, with the machine it ran on: ``keep("master", Kept(...))``. Ratios say more than
times: both sides of a ratio were measured in turns on the same machine.
"""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

FILE = Path(__file__).with_name("figures.json")


@dataclass(frozen=True)
class Kept:
    """What one benchmark keeps."""

    title: str
    text: str
    """What was measured, and how, in a few sentences."""
    heads: Sequence[str]
    rows: Sequence[Sequence[str | float]]
    more: Mapping[str, Any] = field(default_factory=dict[str, Any])
    """Figures beside the table, for pictures and sentences."""


def processor() -> str:
    """The name of the processor."""
    information = Path("/proc/cpuinfo")
    lines = information.read_text(encoding="utf-8").splitlines() if information.exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def machine() -> dict[str, str | int]:
    """The machine, as far as speed depends on it; ``load``: how many programs wanted to run in the last minute."""
    return {
        "processor": processor(),
        "cores": os.cpu_count() or 1,
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "load": round(os.getloadavg()[0]) if hasattr(os, "getloadavg") else "",
    }


def keep(name: str, figures: Kept) -> None:
    """Write the entry of a benchmark; the others stay."""
    entries = json.loads(FILE.read_text(encoding="utf-8")) if FILE.exists() else {}
    entries[name] = {"machine": machine(), **asdict(figures)}
    FILE.write_text(json.dumps(dict(sorted(entries.items())), indent=1) + "\n", encoding="utf-8")
    print(f"kept in {FILE.name}")
