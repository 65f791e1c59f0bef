"""Figures of runs that several studies need, in SI units: functions for ``Run.measure``.

Each function returns a measure, a function of the full record of a run and of the run's window in s. Signals that are
not given have the names of the library's plain loop, ``trajectory.position`` and ``plant.position``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np

from ..result import metrics
from ..result.metrics import Array
from ..result.result import Result

Window = tuple[float, float]
RunMeasure = Callable[[Result, Window], dict[str, float]]

REFERENCE, POSITION = "trajectory.position", "plant.position"


def error(result: Result, position: str = POSITION, reference: str = REFERENCE) -> Array:
    """Position minus reference, shape (rows,), in the unit of the signals."""
    return result[position] - result[reference]


def step_response(*, bands: Mapping[str, float] | None = None, shares: Mapping[str, float] | None = None) -> RunMeasure:
    """Overshoot [m], overshoot as a share of the step, rise time from 10 to 90 % [s], and settling times [s].

    ``bands``: name of a settling time -> half width in m; ``shares``: the same as a share of the step.
    """

    def measure(result: Result, window: Window) -> dict[str, float]:
        time, position, final = result.time, result[POSITION], float(result[REFERENCE][-1])
        overshoot = metrics.overshoot(position, 0.0, final)
        widths = {**(bands or {}), **{name: share * final for name, share in (shares or {}).items()}}
        return {
            "overshoot": overshoot,
            "overshoot_share": overshoot / final,
            "rise": metrics.rise_time(time, position, start=0.0, final=final),
            **{name: metrics.settling_time(time, position, final, width) for name, width in widths.items()},
        }

    return measure


def reversals() -> RunMeasure:
    """Largest values over all reversals of the error's peak [m], base [m], delay [s] and decay [s]; and the slip.

    ``base`` is the median of the error between reversals.

    ``slip`` is the top speed of the table divided by that of the reference: 1 for a table that follows.
    """

    def measure(result: Result, window: Window) -> dict[str, float]:
        part = metrics.window(result.time, *window)
        reference, position = result[REFERENCE][part], result[POSITION][part]
        peaks = metrics.reversal_peaks(result.time[part], position - reference, reference)
        return {
            "reversal_peak": max((abs(peak.peak) for peak in peaks), default=math.nan),
            "reversal_base": max((peak.base for peak in peaks), default=math.nan),
            "reversal_delay": max((peak.delay for peak in peaks), default=math.nan),
            "reversal_decay": max((peak.decay for peak in peaks), default=math.nan),
            "slip": metrics.max_abs(np.diff(position)) / metrics.max_abs(np.diff(reference)),
        }

    return measure


def amplitude_error(frequency: float) -> RunMeasure:
    """The error of the amplitude in m of a motion of ``frequency`` in Hz."""

    def measure(result: Result, window: Window) -> dict[str, float]:
        part = metrics.window(result.time, *window)
        amplitude, wanted = (
            metrics.sine_amplitude(result.time[part], result[name][part], frequency) for name in (POSITION, REFERENCE)
        )
        return {"amplitude_error": amplitude - wanted}

    return measure


def second_turn(result: Result, radius: float) -> metrics.CircularTest:
    """The circular test over the second turn of the axes ``plant_x`` and ``plant_y``; ``radius`` in m."""
    names = ("plant_x.position", "plant_y.position", "trajectory_x.position", "trajectory_y.position")
    return metrics.circular_test(*(result[name] for name in names), radius=radius)


def circle(radius: float) -> RunMeasure:
    """The figures of ``second_turn`` in m: G, F_max, F_min, mean_deviation, spike_0 ... spike_270; ``radius`` in m."""

    def measure(result: Result, window: Window) -> dict[str, float]:
        test = second_turn(result, radius)
        return {
            "G": test.circular_deviation,
            "F_max": test.radial_max,
            "F_min": test.radial_min,
            "mean_deviation": test.radial_mean,
            **{f"spike_{90 * i}": spike for i, spike in enumerate(test.spikes)},
        }

    return measure


def sample(index: int, signals: Mapping[str, str]) -> RunMeasure:
    """The values of signals at the recorded sample ``index``; ``signals`` maps the name of a figure to its signal."""
    return lambda result, window: {name: float(result[signal][index]) for name, signal in signals.items()}


def together(*parts: RunMeasure) -> RunMeasure:
    """A measure that gives the figures of several measures together."""

    def measure(result: Result, window: Window) -> dict[str, float]:
        found: dict[str, float] = {}
        for part in parts:
            found |= part(result, window)
        return found

    return measure
