"""The program of counting.c, made from the component of counter.py."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from counter import Counter

from cosim.export.compile import RUNTIME
from cosim.export.contract import Fmi, header
from cosim.export.model_c import model_c
from cosim.export.trace import trace

T_S = ("1e-3", "1e-4", "1e-5", "0.0003333333333333333")
"""Sampling times as text, s."""
STEPS = ((1, 1), (1, 2), (1, 7), (3, 1))
"""Communication steps p/q in T_s."""


def program(fmi: Fmi, folder: Path) -> Path:
    """Compile the program for a version of FMI."""
    (folder / "model.c").write_text(model_c(trace(Counter), "{counter}", fmi))
    (folder / "contract.h").write_text(header(fmi))
    flags = ["-std=c99", "-O2", "-ffp-contract=off", "-fno-math-errno", f"-I{folder}", f"-I{RUNTIME}"]
    target = folder / "counting"
    source = str(Path(__file__).with_name("counting.c"))
    subprocess.run([sys.executable, "-m", "ziglang", "cc", *flags, source, "-o", str(target), "-lm"], check=True)
    return target


def run(path: Path, *arguments: object) -> tuple[int, float]:
    """Steps that were wrong, and the drift of the clock in T_s.

    Arguments: T_s, p, q, steps, start, clock, then for FMI 3.0 "events" and "early".
    """
    done = subprocess.run([str(path), *map(str, arguments)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
    wrong, drift = done.stdout.split()
    return int(wrong), float(drift)
