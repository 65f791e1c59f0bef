"""The figures of every position loop of a run."""

from __future__ import annotations

import numpy as np

from .. import metrics
from ..results import Result


def tracking(result: Result, window: tuple[float, float]) -> dict[str, float]:
    """Figures of every position loop over ``window``, SI units; with several loops each name begins with its loop's.

    error_max, error_rms, error_std, error_mean, error_end [m]; command_max, command_mean, command_end and
    command_tv (total variation a second) in the unit of the command.
    """
    part = metrics.window(result.time, *window)
    time = result.time[part]
    loops = metrics.loops(result)
    numbers: dict[str, float] = {}
    for loop in loops:
        prefix = f"{loop.name}." if len(loops) > 1 else ""
        error = loop.error(result)[part]
        numbers[f"{prefix}error_max"] = metrics.max_abs(error)
        numbers[f"{prefix}error_rms"] = metrics.rms(error)
        numbers[f"{prefix}error_std"] = metrics.std(error)
        numbers[f"{prefix}error_mean"] = float(np.mean(error))
        numbers[f"{prefix}error_end"] = float(error[-1])
        if loop.command:
            command = result[loop.command][part]
            numbers[f"{prefix}command_max"] = metrics.max_abs(command)
            numbers[f"{prefix}command_mean"] = float(np.mean(command))
            numbers[f"{prefix}command_end"] = float(command[-1])
            numbers[f"{prefix}command_tv"] = metrics.total_variation(time, command)
    return numbers
