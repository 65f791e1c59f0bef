"""Choose the 128 nodes of the reference nominal characteristic trajectory (NCT) from its 402 identified points.

Nodes are a subset of the points: a straight line between neighbours is nowhere farther than a relative tolerance
from the points it passes over, and the tolerance is the smallest for which 128 nodes do. The first nodes are
(0, 0) and the end of the linear part. Run to print the table of ``fmus/physics/nct.py`` (SI)::

    python tests/references/nctf/nct_table.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
POINTS = HERE / "nct_6A_0p1s_alpha505.csv"
"""Identified at 6 A for 0.1 s, linear below e_lin = 0.643 um (alpha = 505 1/s): error in mm, rate in mm/s."""


def identified_points() -> tuple[np.ndarray, np.ndarray]:
    """Error [m] and rate [m/s] of the 402 points."""
    error, rate = np.loadtxt(POINTS, delimiter=",", skiprows=1).T
    return error * 1e-3, rate * 1e-3


def chord_error(error: np.ndarray, rate: np.ndarray, first: int, last: int) -> float:
    """Largest relative distance of the points between two nodes from the line that joins them."""
    inner = slice(first + 1, last)
    line = np.interp(error[inner], error[[first, last]], rate[[first, last]])
    return float(np.max(np.abs(line / rate[inner] - 1.0), initial=0.0))


def nodes_within(error: np.ndarray, rate: np.ndarray, tolerance: float) -> list[int]:
    """Fewest points whose joining lines stay within ``tolerance`` of all points (longest steps first)."""
    chosen = [0, 1]
    while chosen[-1] < len(error) - 1:
        last = chosen[-1] + 1
        while last + 1 < len(error) and chord_error(error, rate, chosen[-1], last + 1) <= tolerance:
            last += 1
        chosen.append(last)
    return chosen


def table(count: int = 128) -> tuple[np.ndarray, np.ndarray, float]:
    """Nodes' error [m] and rate [m/s], rounded to 10 digits, and the relative error of the interpolation."""
    error, rate = identified_points()
    low, high = 0.0, 1e-2
    for _ in range(60):
        middle = 0.5 * (low + high)
        if len(nodes_within(error, rate, middle)) <= count:
            high = middle
        else:
            low = middle
    chosen = nodes_within(error, rate, high)
    while len(chosen) < count:  # spend what is left where the lines are worst
        worst = max(range(1, len(chosen) - 1), key=lambda i: chord_error(error, rate, chosen[i], chosen[i + 1]))
        chosen.insert(worst + 1, (chosen[worst] + chosen[worst + 1]) // 2)
    nodes = [np.array([float(f"{value:.9e}") for value in curve[chosen]]) for curve in (error, rate)]
    inside = np.interp(error[1:], nodes[0], nodes[1])
    return nodes[0], nodes[1], float(np.max(np.abs(inside / rate[1:] - 1.0)))


def as_source(name: str, values: np.ndarray) -> str:
    """``values`` as a tuple of Python source, five a line."""
    rows = [", ".join(f"{value:.10g}" for value in values[i : i + 5]) for i in range(0, len(values), 5)]
    return f"{name} = (\n" + "".join(f"    {row},\n" for row in rows) + ")"


if __name__ == "__main__":
    errors, rates, worst = table()
    print(as_source("REFERENCE_ERROR", errors))  # noqa: T201
    print(as_source("REFERENCE_RATE", rates))  # noqa: T201
    print(f"# largest relative error of the interpolation: {worst:.2e}")  # noqa: T201
