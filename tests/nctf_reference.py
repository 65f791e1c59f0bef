"""Reference traces of the NCTF components and the independent model behind them (``references/nctf``)."""

from __future__ import annotations

import importlib.util
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

FOLDER = Path(__file__).parent / "references" / "nctf"

EXISTING = {
    "variant": "existing",
    "defuzzification": "singleton",
    "K_f": 0.53,
    "h_zero": 28.36e-3,
    "u_i_zero": 0.384e-3,
}
"""Start values of ``NctfFuzzy`` that make it the existing variant."""
WARM = {"F_C": 0.87 * 0.046, "F_S": 0.87 * 0.046, "sigma_2": 0.76 * 9.7e-4}
"""Friction of the warm ballscrew."""
LARGEST_DAMPING = (
    (0.02, 49.990, 48.563),
    (0.05, 19.975, 19.404),
    (0.1, 9.950, 9.665),
    (0.2, 4.899, 4.757),
    (0.25, 3.873, 3.759),
    (0.3, 3.180, 3.085),
    (0.4, 2.291, 2.220),
)
"""omega_n*T_s, and the largest stable damping ratio of the nominal stage for alpha*T_s -> 0 and alpha*T_s = 0.101."""


@cache
def reference(file: str) -> dict[str, Any]:
    """The arrays of one file of traces."""
    with np.load(FOLDER / f"{file}.npz") as data:
        return dict(data)


@cache
def module(name: str) -> ModuleType:
    """One of the scripts that made the references."""
    spec = importlib.util.spec_from_file_location(f"nctf_reference_{name}", FOLDER / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    loaded = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(loaded)
    return loaded
