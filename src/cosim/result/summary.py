"""The figures of merit of a run: which loops it has, and what is told of each."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, cast

import numpy as np

from ..units import conversion
from .metrics import (
    Array,
    circular_test,
    max_abs,
    overshoot,
    rms,
    settling_time,
    std,
    total_variation,
    window,
)

# A recorded run.


class Recorded(Protocol):
    """What is needed of a run's result; ``cosim.result.result.Result`` is one."""

    @property
    def time(self) -> Array: ...
    @property
    def names(self) -> Sequence[str]: ...
    @property
    def metadata(self) -> Mapping[str, Any]: ...
    def unit(self, name: str) -> str: ...
    def __getitem__(self, name: str, /) -> Array: ...


@dataclass(frozen=True)
class Loop:
    """A position loop of a system: the names of its recorded signals."""

    name: str
    """The controller's instance."""
    reference: str
    position: str
    command: str
    """``""`` if it was not recorded."""

    def error(self, result: Recorded) -> Array:
        """Position minus reference."""
        return result[self.position] - result[self.reference]


def loops(result: Recorded) -> list[Loop]:
    """The position loops of a run: every instance whose inputs ``position_ref`` and ``position`` are connected.

    Their sources are the loop's reference and position, the instance's ``command`` is its command. A loop counts if
    both signals were recorded in the same unit. The connections are those in the result's metadata,
    ``"source -> target"`` each.
    """
    connections = cast("Sequence[str]", result.metadata.get("connections", ()))
    ends = [connection.split(" -> ") for connection in connections]
    sources = {target: source for source, target in ends}
    recorded = set(result.names)
    found: list[Loop] = []
    for target, reference in sources.items():
        instance, _, variable = target.rpartition(".")
        position = sources.get(f"{instance}.position")
        if variable != "position_ref" or position is None or not {reference, position} <= recorded:
            continue
        if result.unit(reference) == result.unit(position):
            command = f"{instance}.command"
            found.append(Loop(instance, reference, position, command if command in recorded else ""))
    return found


def not_finite(result: Recorded) -> dict[str, float]:
    """Recorded variables that are NaN or infinite somewhere, each with the first time in seconds."""
    bad = {name: ~np.isfinite(result[name]) for name in result.names}
    return {name: float(result.time[int(where.argmax())]) for name, where in bad.items() if where.any()}


class Row(NamedTuple):
    """One line of a table of figures."""

    name: str
    value: float
    unit: str


def summary(result: Recorded, start: float | None = None) -> list[Row]:
    """The table that ends a run: tracking figures of every loop from ``start`` s on (the last half if not given).

    Empty if the run has no loop. Lengths are in um. If the reference rests from ``start`` on at a place other than
    the position's first, overshoot and settling into 2 % of the way are told as well; if two loops go along a circle
    about the origin, the circular test of its last whole turn. No figure is computed from signals that are not finite.
    """
    time = result.time
    if not time.size:
        return []
    begin = 0.5 * float(time[0] + time[-1]) if start is None else start
    part = window(time, begin)
    since = f" from {time[part][0]:g} s"
    rows: list[Row] = []
    bad = not_finite(result)
    every = loops(result)
    found = [loop for loop in every if not {loop.reference, loop.position} & set(bad)]
    for loop in found:
        prefix = f"{loop.name}: " if len(every) > 1 else ""
        length = conversion(result.unit(loop.position), "um")
        error = loop.error(result) * length
        rows += [
            Row(f"{prefix}Position error, maximum{since}", max_abs(error[part]), "um"),
            Row(f"{prefix}Position error, rms{since}", rms(error[part]), "um"),
            Row(f"{prefix}Position error, at the end", float(error[-1]), "um"),
            Row(f"{prefix}Position error, maximum of the whole run", max_abs(error), "um"),
        ]
        reference, position = result[loop.reference], result[loop.position]
        first, last = float(position[0]), float(reference[-1])
        if last != first and np.ptp(reference[part]) == 0.0:
            settled = settling_time(time, position, last, 0.02 * abs(last - first), float(time[0]))
            rows += [
                Row(f"{prefix}Overshoot", overshoot(position, first, last) * length, "um"),
                Row(f"{prefix}Settling into 2 % of the step", settled * 1e3, "ms"),
            ]
        if loop.command and loop.command not in bad:
            unit = result.unit(loop.command)
            command = result[loop.command]
            rows += [
                Row(f"{prefix}Command, maximum", max_abs(command), unit),
                Row(
                    f"{prefix}Command, total variation{since}", total_variation(time[part], command[part]), f"{unit}/s"
                ),
            ]
    if len(found) == 2:
        rows += _circle_rows(result, found[0], found[1])
    return rows


def _circle_rows(result: Recorded, x: Loop, y: Loop) -> list[Row]:
    """The circular test of the last whole turn; empty if the references do not go along a circle about the origin."""
    length = conversion(result.unit(x.position), "um")
    if result.unit(y.position) != result.unit(x.position):
        return []
    x_ref, y_ref = result[x.reference] * length, result[y.reference] * length
    radius = float(np.mean(np.hypot(x_ref, y_ref)))
    angle = np.unwrap(np.arctan2(y_ref, x_ref))
    turns = int(abs(float(angle[-1] - angle[0])) / (2.0 * math.pi) + 1e-9)
    if turns == 0 or max_abs(np.hypot(x_ref, y_ref) - radius) > 1e-6 * radius:
        return []
    test = circular_test(
        result[x.position] * length, result[y.position] * length, x_ref, y_ref, radius=radius, turn=turns
    )
    return [
        Row(f"Circular deviation G, turn {turns}", test.circular_deviation, "um"),
        Row(f"Radial deviation F_max, turn {turns}", test.radial_max, "um"),
        Row(f"Radial deviation F_min, turn {turns}", test.radial_min, "um"),
        Row(f"Radial deviation, mean, turn {turns}", test.radial_mean, "um"),
        Row(f"Reversal spike, largest, turn {turns}", max(test.spikes, key=abs), "um"),
    ]


def tracking(result: Recorded, interval: tuple[float, float]) -> dict[str, float]:
    """Figures of every position loop over ``interval``, SI units; with several loops each name begins with its loop's.

    error_max, error_rms, error_std, error_mean, error_end [m]; command_max, command_mean, command_end and
    command_tv (total variation a second) in the unit of the command.
    """
    part = window(result.time, *interval)
    time = result.time[part]
    found = loops(result)
    numbers: dict[str, float] = {}
    for loop in found:
        prefix = f"{loop.name}." if len(found) > 1 else ""
        error = loop.error(result)[part]
        numbers[f"{prefix}error_max"] = max_abs(error)
        numbers[f"{prefix}error_rms"] = rms(error)
        numbers[f"{prefix}error_std"] = std(error)
        numbers[f"{prefix}error_mean"] = float(np.mean(error))
        numbers[f"{prefix}error_end"] = float(error[-1])
        if loop.command:
            command = result[loop.command][part]
            numbers[f"{prefix}command_max"] = max_abs(command)
            numbers[f"{prefix}command_mean"] = float(np.mean(command))
            numbers[f"{prefix}command_end"] = float(command[-1])
            numbers[f"{prefix}command_tv"] = total_variation(time, command)
    return numbers
