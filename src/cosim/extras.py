"""The packages that an installation may leave out, and what to install if one is missing."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from importlib.util import find_spec
from typing import Any

from .errors import DescriptionError

EXTRAS: Mapping[str, str] = {
    "casadi": "build",
    "control": "tools",
    "distributed": "tools",
    "matplotlib": "plots",
    "plotly": "report",
    "pyarrow": "parquet",
    "pythonfmu": "build",
    "scipy": "tools",
    "ziglang": "build",
}
"""For each package, the extra of motion-cosim that installs it."""


def missing(package: str, purpose: str, otherwise: str = "") -> str:
    """The sentence that tells how to install ``package``.

    ``purpose`` begins the sentence, such as "to read MAT files"; ``otherwise`` ends it, such as "name a .csv file".
    """
    remedy = f'pip install "motion-cosim[{EXTRAS[package]}]"' + (f", or {otherwise}" if otherwise else "")
    return f"{purpose} needs {package}, which is not installed: {remedy}."


def require(package: str, purpose: str, otherwise: str = "") -> None:
    """Raise DescriptionError with the sentence of ``missing`` if ``package`` is not installed; it is not imported."""
    if find_spec(package) is None:
        raise DescriptionError(missing(package, purpose, otherwise))


def import_extra(module: str, purpose: str) -> Any:
    """Import a module of a package of an extra. Raises DescriptionError if the package is not installed."""
    package = module.partition(".")[0]
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] != package:
            raise
        raise DescriptionError(missing(package, purpose)) from None
