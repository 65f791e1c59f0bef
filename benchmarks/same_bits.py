"""Whether two builds of the FMUs give the same traces to the last bit, and what each costs.

    python benchmarks/same_bits.py OLD_FOLDER NEW_FOLDER [SYSTEM ...]

Two comparisons: every reference experiment of every FMU that both folders hold, and the recorded columns of closed
loops (default: some of each study). Printed: rows compared, the largest difference, accepted steps and evaluations of
the derivative of each plant in both. Exit code 1 if a bit differs.
"""

from __future__ import annotations

import sys
import tempfile
import zipfile
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from cosim import read_system, simulate
from cosim.reference.replay import verify

STUDIES = Path(__file__).resolve().parents[1] / "studies"
SYSTEMS = (
    "shams2010/smc_2pi.toml",
    "shams2010/csmc_step.toml",
    "shams2010/fsmc_5sin.toml",
    "shams2010/backlash_smc.toml",
    "maeda2008/step.toml",
    "maeda2008/stairs.toml",
    "feng2015/circle_two_mass.toml",
    "feng2015/circle_pulse.toml",
    "rubio2015/p_pi.toml",
    "purtojo2015/proposed_step.toml",
)
COUNTERS = ("steps", "rhs_evaluations")


def with_old_references(new: Path, old: Path, scratch: Path) -> Path:
    """A copy of the new FMU that carries the experiments of the old one."""
    target = scratch / new.name
    with zipfile.ZipFile(new) as one, zipfile.ZipFile(old) as other, zipfile.ZipFile(target, "w") as made:
        for archive, wanted in ((one, False), (other, True)):
            for name in archive.namelist():
                if ("fmi-ls-ref" in name) is wanted:
                    made.writestr(name, archive.read(name))
    return target


def experiments(old: Path, new: Path, table: Table) -> bool:
    same = True
    with tempfile.TemporaryDirectory() as scratch:
        for path in sorted(old.glob("*.fmu")):
            if not (new / path.name).is_file():
                continue
            reports = verify(path), verify(with_old_references(new / path.name, path, Path(scratch)))
            for one, other in zip(reports[0].outcomes, reports[1].outcomes, strict=True):
                if one.failure or other.failure:
                    raise SystemExit(f"{path.name}, {one.experiment.name}: {one.failure or other.failure}")
                worst = max(
                    float(np.max(np.abs(a.replay - b.replay))) for a, b in zip(one.signals, other.signals, strict=True)
                )
                same &= worst == 0.0
                table.add_row(f"{path.stem}, {one.experiment.name}", str(one.rows), f"{worst:g}", "")
    return same


def loop(old: Path, new: Path, name: str, table: Table) -> bool:
    before, after = (simulate(read_system(STUDIES / name, fmus=folder)) for folder in (old, new))
    worst = float(np.max(np.abs(before.rows - after.rows)))
    counts = "; ".join(
        f"{instance} " + ", ".join("/".join(f"{r.solver[instance][c]:.0f}" for c in COUNTERS) for r in (before, after))
        for instance in before.solver
        if before.solver[instance].get(COUNTERS[1])
    )
    table.add_row(name, str(len(before.time)), f"{worst:g}", counts)
    return worst == 0.0


def main() -> int:
    old, new = Path(sys.argv[1]), Path(sys.argv[2])
    table = Table("experiment or loop", "rows", "largest difference", "steps/evaluations: old, new")
    same = experiments(old, new, table)
    for name in sys.argv[3:] or SYSTEMS:
        same &= loop(old, new, name, table)
    Console(width=150).print(table)
    return 0 if same else 1


if __name__ == "__main__":
    sys.exit(main())
