"""Time derivatives of recorded signals."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import DescriptionError
from ..extras import import_extra
from ..units import parse_unit
from .header import is_unit

Array = NDArray[np.float64]


def differences(time: Array, values: Array, order: int) -> Array:
    """The derivative of ``values`` by central differences, without smoothing; ``order`` 2 applies them twice.

    Differences have second-order accuracy and are one-sided at both ends. ``time`` in s and ``values`` have one value
    a sample. Raises DescriptionError for less than 3 samples.
    """
    if time.size < 3:
        raise DescriptionError(f"{time.size} samples: derivatives need at least 3.")
    for _ in range(order):
        values = np.gradient(values, time, edge_order=2)
    return values


def smoothed(time: Array, values: Array, order: int, *, window: float, polynomial: int) -> Array:
    """The smoothed derivative of ``values`` (Savitzky and Golay 1964).

    A polynomial of degree ``polynomial`` is fitted to the samples around each sample; its derivative is the result.
    ``window`` in s is the longest time that these samples may span. The sample is in the middle of the window.
    Raises DescriptionError if the window does not fit the record, or if the samples are not equally spaced.
    """
    signal: Any = import_extra("scipy.signal", "smoothing")
    steps = np.diff(time)
    step = float(np.median(steps)) if steps.size else 0.0
    # The filter needs equal steps. Rounding of the times changes a step by less than a tenth.
    if not steps.size or np.max(np.abs(steps - step)) > 0.1 * step:
        raise DescriptionError(
            "smoothing needs equally spaced samples. Resample the record before, in Python: "
            "cosim.read_record(FILE).resampled().to_dataframe(units=True).to_csv(NEW)."
        )
    # The longest odd number of samples that spans no more than the window.
    count = 2 * math.floor(0.5 * window / step + 1e-6) + 1
    if count <= polynomial or order > polynomial:
        raise DescriptionError(
            f"smoothing.window = {window:g} s holds {count} samples of {step:.6g} s: a polynomial of degree "
            f"{polynomial} needs more, and a degree of at least {order}. Take a longer window."
        )
    if count > time.size:
        raise DescriptionError(
            f"smoothing.window = {window:g} s is longer than the record, {time.size} samples of {step:.6g} s."
        )
    mean_step = float(time[-1] - time[0]) / (time.size - 1)
    return np.asarray(signal.savgol_filter(values, count, polynomial, deriv=order, delta=mean_step), dtype=np.float64)


def derivative_name(name: str, order: int) -> str:
    """The name of a derivative in the structured naming convention of FMI: ``der(x)``, ``der(x,2)``."""
    return f"der({name})" if order == 1 else f"der({name},{order})"


def derivative_unit(unit: str, order: int) -> str:
    """The unit of a derivative by time in s; "" if the unit of the signal is not known."""
    # A unit with an offset has no derivative in this unit: a rate in degC/s would be one in K/s.
    if not is_unit(unit) or parse_unit(unit).offset:
        return ""
    seconds = "s" if order == 1 else f"s{order}"
    above, _, below = unit.partition("/")
    if not below:
        return f"{above}/{seconds}"
    own = [factor for factor in below.strip("()").split(".") if factor]
    power = next((int(f[1:] or 1) for f in own if (f[0] == "s" and f[1:].isdigit()) or f == "s"), 0)
    rest = [factor for factor in own if not (factor == "s" or (factor[0] == "s" and factor[1:].isdigit()))]
    together = [*rest, f"s{order + power}" if order + power > 1 else "s"]
    text = f"{above}/{together[0]}" if len(together) == 1 else f"{above}/({'.'.join(together)})"
    return text if is_unit(text) else ""
