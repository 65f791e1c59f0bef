"""Precision-motion co-simulation: FMUs declared once in Python, and a fast master that steps them together.

    system = cosim.read_system("stage.toml", {"plant.m": 70.0})
    result = cosim.simulate(system)
    result["plant.position"], result.unit("plant.position")

    cosim.plot([result, cosim.read_record("log.csv")], "both.png", signals={"plant.position": "x"})

``cosim.metrics`` has figures of merit, ``cosim.plots`` pictures, ``cosim.design`` the design tools. Names are imported
on first use, because components and their export do not need the packages that run FMUs.
"""

from __future__ import annotations

import logging
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from . import design
    from .errors import CosimError, DescriptionError, FileError, SimulationError, TraceError
    from .master.failure import ProcessError
    from .master.instance import CallError, RunError
    from .master.run import Interrupted, SignalError
    from .master.simulation import Simulation, simulate
    from .record.read import Record, read_record
    from .result import metrics, plots
    from .result.compare import Comparison, Tolerance, compare
    from .result.compare_report import plot_comparison, report_comparison
    from .result.picture import plot
    from .result.read import read_result
    from .result.result import Result
    from .result.run_report import report_run
    from .system.system import System, make_system, read_system

# The library prints nothing. Without this handler, Python would print warnings if the program has no handler.
logging.getLogger(__name__).addHandler(logging.NullHandler())

__all__ = [
    "CallError",
    "Comparison",
    "CosimError",
    "DescriptionError",
    "FileError",
    "Interrupted",
    "ProcessError",
    "Record",
    "Result",
    "RunError",
    "SignalError",
    "Simulation",
    "SimulationError",
    "System",
    "Tolerance",
    "TraceError",
    "compare",
    "design",
    "make_system",
    "metrics",
    "plot",
    "plot_comparison",
    "plots",
    "read_record",
    "read_result",
    "read_system",
    "report_comparison",
    "report_run",
    "simulate",
]

_HOMES = {
    "errors": ("CosimError", "DescriptionError", "FileError", "SimulationError", "TraceError"),
    "master.instance": ("CallError", "RunError"),
    "master.failure": ("ProcessError",),
    "master.run": ("Interrupted", "SignalError"),
    "master.simulation": ("Simulation", "simulate"),
    "record.read": ("Record", "read_record"),
    "result.compare": ("Comparison", "Tolerance", "compare"),
    "result.compare_report": ("plot_comparison", "report_comparison"),
    "result.picture": ("plot",),
    "result.read": ("read_result",),
    "result.result": ("Result",),
    "result.run_report": ("report_run",),
    "system.system": ("System", "make_system", "read_system"),
}
_MODULES = {"design": "design", "metrics": "result.metrics", "plots": "result.plots"}


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return import_module(f".{_MODULES[name]}", __name__)
    for module, names in _HOMES.items():
        if name in names:
            return getattr(import_module(f".{module}", __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
