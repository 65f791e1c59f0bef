"""Signals over time as a pandas DataFrame, and in one line of text."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import DescriptionError, listed

MOST_NAMES = 8
"""Largest number of signals in a line of text."""


def optional(package: str, method: str) -> Any:
    """Import an optional package. Raises DescriptionError if it is not installed."""
    try:
        return import_module(package)
    except ModuleNotFoundError:
        raise DescriptionError(f"{method} needs {package}, which is not installed: pip install {package}.") from None


def dataframe(
    time: NDArray[np.float64],
    values: NDArray[np.float64],
    units: Mapping[str, str],
    metadata: Mapping[str, Any],
    *,
    in_names: bool,
) -> Any:
    """A pandas DataFrame of ``values``, one column for each of ``units``. With ``in_names`` names are ``x [mm]``.

    Raises DescriptionError if pandas is not installed.
    """
    pandas = optional("pandas", "to_dataframe")
    names = _labels(units) if in_names else list(units)
    index = pandas.Index(time, name="time [s]" if in_names else "time")
    frame = pandas.DataFrame(values, index=index, columns=names)
    frame.attrs["units"] = dict(units)
    frame.attrs["metadata"] = dict(metadata)
    return frame


def _labels(units: Mapping[str, str]) -> list[str]:
    """Names of signals with their units, such as ``x [mm]``."""
    return [name if unit in ("", "1") else f"{name} [{unit}]" for name, unit in units.items()]


def signals_text(units: Mapping[str, str]) -> str:
    """The first signals with their units, and how many more there are."""
    return listed(_labels(units), MOST_NAMES)


def span(time: NDArray[np.float64]) -> str:
    """The number of samples and their times, such as ``1001 samples from 0 s to 1 s``."""
    return f"{time.size} samples" + (f" from {time[0]:.6g} s to {time[-1]:.6g} s" if time.size else "")
