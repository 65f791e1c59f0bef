"""Design tools on top of the master: procedures that run a system many times.

    sweep       systems over grids, lists and random designs of start values, on a cluster if there is one
    friction    first values of inertia and friction from a log
    fit         start values of a system, and of its sensors, from records of the real machine
    identify    the nominal characteristic trajectory of a stage from an open-loop pulse
    stability   linear and practical limits of NCTF control, maps of limits
    pulse       learning of friction pulses
    tune        parameters by optimization
    linearize   state space from directional derivatives
    margins     margins of sampled loops

They know FMI and names given as arguments, never a component.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from . import fit, friction, identify, linearize, margins, pulse, stability, sweep, tune

__all__ = ["fit", "friction", "identify", "linearize", "margins", "pulse", "stability", "sweep", "tune"]


def __getattr__(name: str) -> Any:
    if name in __all__:
        return import_module(f".{name}", __name__)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return list(__all__)
