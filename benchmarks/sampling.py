"""Samples of a controller whose importer adds up its time, t += h, over 1e8 steps: how many are met late or not at all.

For each sampling time, communication step and start time: the number of wrong steps, which must be 0, and by how many
sampling times the sum has drifted from k*h.
"""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from counting import STEPS, T_S, program, run

COUNT = 100_000_000


def main() -> int:
    """Exit code 1 if a step was wrong."""
    table = Table("T_s / s", "step / T_s", "start / s", "drift / T_s", "wrong steps", title=f"{COUNT:.0e} steps each")
    failed = 0
    with TemporaryDirectory() as folder:
        path = program(2, Path(folder))
        for T_s in T_S:
            for p, q in STEPS:
                for start in ("0", "1e6"):
                    wrong, drift = run(path, T_s, p, q, COUNT, start, "sum")
                    failed += wrong
                    table.add_row(T_s, f"{p}/{q}", start, f"{drift:.3f}", str(wrong))
    Console().print(table)
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
