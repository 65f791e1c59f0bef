"""Precision-motion co-simulation: FMI 2.0 FMUs declared once in Python, and a fast master that steps them together.

    system = cosim.read_system("stage.toml", {"plant.m": 70.0})
    result = cosim.simulate(system)
    result["plant.position"], result.unit("plant.position")

What runs FMUs is imported on first use: components and their export need none of it.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .errors import CosimError, DescriptionError, SimulationError, TraceError
    from .master import CallError, Interrupted, RunError, SignalError, Simulation, simulate
    from .results import Result
    from .system import System, make_system, read_system

__all__ = [
    "CallError",
    "CosimError",
    "DescriptionError",
    "Interrupted",
    "Result",
    "RunError",
    "SignalError",
    "Simulation",
    "SimulationError",
    "System",
    "TraceError",
    "make_system",
    "read_system",
    "simulate",
]

_HOMES = {
    "errors": ("CosimError", "DescriptionError", "SimulationError", "TraceError"),
    "master": ("CallError", "Interrupted", "RunError", "SignalError", "Simulation", "simulate"),
    "results": ("Result",),
    "system": ("System", "make_system", "read_system"),
}


def __getattr__(name: str) -> Any:
    for module, names in _HOMES.items():
        if name in names:
            return getattr(import_module(f".{module}", __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
