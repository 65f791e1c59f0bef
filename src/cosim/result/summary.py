"""The figures of merit of a run: finds its position loops and computes the figures of each."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, cast

import numpy as np

from ..errors import DescriptionError
from ..units import conversion
from .metrics import (
    Array,
    circular_test,
    contour_error,
    least_squares_circle,
    max_abs,
    mean,
    overshoot,
    rms,
    settling_time,
    std,
    total_variation,
    window,
)

RESTS = 0.01
"""A step is judged only if its reference is constant at the end, for at least this fraction of the record."""
ROUNDING = 8.0 * float(np.finfo(np.float64).eps)
"""Largest change of a reference, relative to its largest value, that is rounding and no motion."""
SMALLEST_STEP = 1e-6
"""Smallest distance of a position from a constant reference at the start that counts as a step, relative to its largest
distance during the run: a run that a disturbance moves that much further is no step response."""
ON_CIRCLE = 1e-6
"""Largest distance of a reference point from its circle, relative to the radius: no other path is as near to one."""


# A recorded run.


class Recorded(Protocol):
    """The part of a result that figures need; ``cosim.result.result.Result`` has it."""

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
    """Name of the controller's instance."""
    reference: str
    position: str
    command: str
    """``""`` if it was not recorded."""
    scale: tuple[float, float] = (1.0, 0.0)
    """Factor and offset from the unit of the reference to the unit of the position, from the connections."""

    def reference_values(self, result: Recorded) -> Array:
        """The reference in the unit of the position."""
        factor, offset = self.scale
        values = result[self.reference]
        return values if self.scale == (1.0, 0.0) else factor * values + offset

    def unit(self, result: Recorded) -> str:
        """The unit of the position. If its FMU states none, and it reaches the controller as it is, the reference's."""
        own = result.unit(self.position)
        return result.unit(self.reference) if (own, self.scale) == ("1", (1.0, 0.0)) else own

    def error(self, result: Recorded) -> Array:
        """Position minus reference, in the unit of the position."""
        return result[self.position] - self.reference_values(result)


def loops(result: Recorded) -> list[Loop]:
    """The position loops of a run: every instance whose inputs ``position_ref`` and ``position`` are connected.

    The sources of these inputs are the loop's reference and position. The instance's ``command`` is its command. Both
    signals must be recorded, in the same unit or in units that the connections transform. The connections come from the
    result's metadata: ``connections`` ("source -> target"), and ``transformations`` with factor and offset.
    """
    return [loop for loop, reason in _loops(result) if not reason]


def _loops(result: Recorded) -> Iterator[tuple[Loop, str]]:
    """Every position loop, and the reason why it has no figures; ``""`` if it has figures."""
    connections = cast("Sequence[str]", result.metadata.get("connections", ()))
    scales = cast("Mapping[str, Sequence[float]]", result.metadata.get("transformations", {}))
    recorded = set(result.names)
    sources: dict[str, tuple[str, tuple[float, float]]] = {}
    sums: set[str] = set()
    for connection in connections:
        source, target = _ends(connection, recorded)
        factor, offset = scales.get(connection, (1.0, 0.0))
        if target in sources:
            sums.add(target)
        sources[target] = source, (factor, offset)
    for target, (reference, scale) in sources.items():
        instance, dot, variable = target.partition(".")
        if not dot or variable != "position_ref" or f"{instance}.position" not in sources:
            continue
        position, other_scale = sources[f"{instance}.position"]
        between = _between(scale, other_scale)
        command = f"{instance}.command"
        loop = Loop(instance, reference, position, command if command in recorded else "", between)
        added = [name for name in (target, f"{instance}.position") if name in sums]
        missing = [name for name in (reference, position) if name not in recorded]
        if added:
            yield loop, f"{' and '.join(added)} is a sum, not one recorded signal"
        elif missing:
            yield loop, f"{' and '.join(missing)} was not recorded: add it with --record"
        elif between == (1.0, 0.0) and result.unit(reference) != result.unit(position) != "1":
            yield (
                loop,
                f"{reference} in {result.unit(reference)} and {position} in {result.unit(position)} differ in unit",
            )
        else:
            yield loop, ""


def _ends(connection: str, recorded: set[str]) -> tuple[str, str]:
    """Source and target of a connection. Names may contain arrows; the right arrow follows a recorded name."""
    parts = connection.split(" -> ")
    splits = [(" -> ".join(parts[:i]), " -> ".join(parts[i:])) for i in range(1, len(parts))]
    return next((ends for ends in splits if ends[0] in recorded), splits[0])


def _between(scale: tuple[float, float], other: tuple[float, float]) -> tuple[float, float]:
    """Factor and offset from the unit of the reference to the unit of the position.

    ``scale`` and ``other`` are the factors and offsets of both to the unit of the controller.
    """
    if scale == other or other[0] == 0.0:
        return 1.0, 0.0
    return scale[0] / other[0], (scale[1] - other[1]) / other[0]


class FigureOfMerit(NamedTuple):
    """A figure: one line of a table."""

    name: str
    value: float
    unit: str

    @property
    def reason(self) -> str:
        """Always empty: the figure has a value."""
        return ""


class Missing(NamedTuple):
    """A figure without a value: one line of a table."""

    name: str
    reason: str
    """The reason why there is no value."""

    @property
    def value(self) -> float:
        """Always NaN."""
        return math.nan

    @property
    def unit(self) -> str:
        """Always empty: there is no value."""
        return ""


Figure = FigureOfMerit | Missing


def summary(result: Recorded, start: float | None = None) -> list[Figure]:
    """The figures of a run: tracking figures of every loop from ``start`` in s on (default: the second half).

    Empty if the run has no loop. Lengths are in um, other positions in their own unit.
    If the reference is constant at the end, there are also the overshoot and the settling time into 2 % of its last
    step; settling counts from the last change of the reference.
    If two loops have references of their own, there is also the contour error. On a circle there is also the circular
    test of the last whole turn.
    A figure without a value has the reason.
    """
    rows: list[Figure] = []
    found = list(_loops(result)) if result.time.size else []
    for loop, reason in found:
        prefix = f"{loop.name}: " if len(found) > 1 else ""
        rows += [Missing(f"{prefix}Position error", reason)] if reason else _loop_rows(result, loop, prefix, start)
    complete = [loop for loop, reason in found if not reason]
    if len(complete) == 2 and (path := _path(result, *complete)) is not None:
        rows += [*_contour_rows(result, path, start), *_circle_rows(path)]
    return rows


def _figure(name: str, unit: str, compute: Callable[[], float]) -> Figure:
    """The computed figure, or a Missing with the reason if ``compute`` raises DescriptionError."""
    try:
        return FigureOfMerit(name, compute(), unit)
    except DescriptionError as error:
        return Missing(name, str(error))


def not_finite(result: Recorded) -> dict[str, float]:
    """The recorded variables with samples that are not finite, and the time in s of the first such sample of each."""
    found: dict[str, float] = {}
    for name in result.names:
        wrong = np.flatnonzero(~np.isfinite(result[name]))
        if wrong.size:
            found[name] = float(result.time[wrong[0]])
    return found


def _length(unit: str) -> tuple[float, str]:
    """Factor and unit in which positions are shown: um for lengths, else their own unit."""
    try:
        return conversion(unit, "um"), "um"
    except DescriptionError:
        return 1.0, unit


def _loop_rows(result: Recorded, loop: Loop, prefix: str, start: float | None) -> list[Figure]:
    wrong = not_finite(result)
    for name in (loop.position, loop.reference):
        if name in wrong:
            return [Missing(f"{prefix}Position error", f"{name} is not finite from {wrong[name]:g} s on")]
    time = result.time
    begin = 0.5 * float(time[0] + time[-1]) if start is None else start
    try:
        part = window(time, begin)
    except DescriptionError as error:
        return [Missing(f"{prefix}Position error", str(error))]
    since = f" from {time[part][0]:g} s"
    factor, unit = _length(loop.unit(result))
    error = loop.error(result) * factor
    rows = [
        FigureOfMerit(f"{prefix}Position error, maximum{since}", max_abs(error[part]), unit),
        FigureOfMerit(f"{prefix}Position error, rms{since}", rms(error[part]), unit),
        FigureOfMerit(f"{prefix}Position error, at the end", float(error[-1]), unit),
        FigureOfMerit(f"{prefix}Position error, maximum of the whole run", max_abs(error), unit),
        *_step_rows(time, loop.reference_values(result) * factor, result[loop.position] * factor, (prefix, unit)),
    ]
    if loop.command in wrong:
        rows.append(Missing(f"{prefix}Command", f"{loop.command} is not finite from {wrong[loop.command]:g} s on"))
    elif loop.command:
        own, command = result.unit(loop.command), result[loop.command]
        variation = f"{prefix}Command, total variation{since}"
        rows += [
            FigureOfMerit(f"{prefix}Command, maximum", max_abs(command), own),
            _figure(variation, f"{own}/s", lambda: total_variation(time[part], command[part])),
        ]
    return rows


def _step_rows(time: Array, reference: Array, position: Array, label: tuple[str, str]) -> list[Figure]:
    """Overshoot and settling of the last step of the reference; empty if it is not constant at the end.

    A smooth motion counts as one step. It goes from the last rest or reversal of the reference to its rest at the end.
    """
    prefix, unit = label
    last = float(reference[-1])
    rounding = ROUNDING * max_abs(reference)
    steps = np.diff(reference)
    changes = np.flatnonzero(np.abs(steps) > rounding)
    motion, begin, first = 0, 0, float(position[0])
    # A position that starts on a constant reference, up to rounding, makes no step.
    least = max(rounding, SMALLEST_STEP * max_abs(position - last))
    if changes.size:
        least = rounding
        rest = reference.size - 1 - int(changes[-1])
        if rest < max(2.0, RESTS * reference.size):
            return []
        senses = np.signbit(steps[changes])
        breaks = np.flatnonzero((np.diff(changes) > 1) | (senses[1:] != senses[:-1]))
        motion = int(changes[breaks[-1] + 1]) if breaks.size else int(changes[0])
        begin, first = int(changes[-1]) + 1, float(reference[motion])
    if abs(last - first) <= least:
        return []
    settled = settling_time(time[begin:], position[begin:], last, 0.02 * abs(last - first), float(time[begin]))
    name = f"{prefix}Settling into 2 % of the step"
    return [
        FigureOfMerit(f"{prefix}Overshoot", overshoot(position[motion:], first, last), unit),
        FigureOfMerit(name, settled * 1e3, "ms")
        if math.isfinite(settled)
        else Missing(name, "never: outside at the end"),
    ]


class _Path(NamedTuple):
    """The path of two axes, in one unit."""

    unit: str
    x: Array
    y: Array
    x_ref: Array
    y_ref: Array


def _path(result: Recorded, x: Loop, y: Loop) -> _Path | None:
    """The path of two loops; None if they are not its two axes, or if a signal is not finite."""
    signals = {x.position, y.position, x.reference, y.reference}
    if len(signals) < 4 or signals & set(not_finite(result)):
        return None
    (factor, unit), (y_factor, y_unit) = (_length(loop.unit(result)) for loop in (x, y))
    if y_unit != unit:
        try:
            y_factor *= conversion(y_unit, unit)
        except DescriptionError:
            return None
    references = factor * x.reference_values(result), y_factor * y.reference_values(result)
    return _Path(unit, factor * result[x.position], y_factor * result[y.position], *references)


def _contour_rows(result: Recorded, path: _Path, start: float | None) -> list[Figure]:
    """The contour error of two axes. Empty if one of them is commanded to rest."""
    if any(np.ptp(values) == 0.0 for values in (path.x_ref, path.y_ref)):
        return []
    unit = path.unit
    error = contour_error(path.x, path.y, path.x_ref, path.y_ref)
    time = result.time
    try:
        part = window(time, 0.5 * float(time[0] + time[-1]) if start is None else start)
    except DescriptionError as problem:
        return [Missing("Contour error", str(problem))]
    since = f" from {time[part][0]:g} s"
    return [
        FigureOfMerit(f"Contour error, maximum{since}", max_abs(error[part]), unit),
        FigureOfMerit(f"Contour error, rms{since}", rms(error[part]), unit),
        FigureOfMerit("Contour error, maximum of the whole run", max_abs(error), unit),
    ]


def _circle_rows(path: _Path) -> list[Figure]:
    """The circular test of the last whole turn. Empty if the references do not follow a circle."""
    circle = _commanded_circle(path.x_ref, path.y_ref)
    if circle is None:
        return []
    x_centre, y_centre, radius = circle
    x_ref, y_ref, unit = path.x_ref - x_centre, path.y_ref - y_centre, path.unit
    angle = np.unwrap(np.arctan2(y_ref, x_ref))
    travelled = abs(float(angle[-1] - angle[0])) / (2.0 * math.pi)
    turns = int(travelled + 1e-9)
    if np.max(np.abs(np.diff(angle)), initial=0.0) > 0.25 * math.pi:
        return [Missing("Circular test", "less than 8 samples a turn were recorded: take a smaller decimation")]
    if turns == 0:
        short = f"the circle has {travelled:.3g} turns, one is needed: take a later stop time"
        return [Missing("Circular test", short)] if travelled >= 0.5 else []
    try:
        test = circular_test(path.x - x_centre, path.y - y_centre, x_ref, y_ref, radius=radius, turn=turns)
    except DescriptionError as error:
        return [Missing("Circular test", f"too few samples were recorded: {error}")]
    return [
        FigureOfMerit(f"Circular deviation G, turn {turns}", test.circular_deviation, unit),
        FigureOfMerit(f"Radial deviation F_max, turn {turns}", test.radial_max, unit),
        FigureOfMerit(f"Radial deviation F_min, turn {turns}", test.radial_min, unit),
        FigureOfMerit(f"Radial deviation, mean, turn {turns}", test.radial_mean, unit),
        FigureOfMerit(f"Reversal spike, largest, turn {turns}", max(test.spikes, key=abs), unit),
    ]


def _commanded_circle(x_ref: Array, y_ref: Array) -> tuple[float, float, float] | None:
    """Centre and radius of the circle on which all reference points lie; None if they lie on none.

    The origin is tried first: the centre of a circle about it is exact.
    """
    if x_ref.size < 3 or np.ptp(x_ref) == 0.0 or np.ptp(y_ref) == 0.0:
        return None
    x, y, radius = 0.0, 0.0, float(np.mean(np.hypot(x_ref, y_ref)))
    if max_abs(np.hypot(x_ref, y_ref) - radius) > ON_CIRCLE * radius:
        x, y, radius = least_squares_circle(x_ref, y_ref)
    return (x, y, radius) if max_abs(np.hypot(x_ref - x, y_ref - y) - radius) <= ON_CIRCLE * radius else None


_OF_ERROR: Mapping[str, Callable[[Array], float]] = {
    "max": max_abs,
    "rms": rms,
    "std": std,
    "mean": mean,
    "end": lambda error: mean(error[-1:]),
}
_OF_COMMAND: Mapping[str, Callable[[Array], float]] = {
    "max": max_abs,
    "mean": mean,
    "end": lambda command: mean(command[-1:]),
}


def tracking(result: Recorded, interval: tuple[float, float]) -> dict[str, float]:
    """Figures of every position loop over ``interval`` (start and end in s).

    error_max, error_rms, error_std, error_mean and error_end are in the unit of the position (m, rad ...). command_max,
    command_mean and command_end are in the unit of the command, command_tv (total variation) in this unit per second.
    With several loops, each name begins with the name of its loop, as in ``controller_x.error_max``. A figure is NaN
    if a signal is not finite. Raises DescriptionError if there is no sample in ``interval``.
    """
    part = window(result.time, *interval)
    time = result.time[part]
    found = loops(result)
    numbers: dict[str, float] = {}
    for loop in found:
        prefix = f"{loop.name}." if len(found) > 1 else ""
        error = loop.error(result)[part]
        numbers |= {f"{prefix}error_{name}": figure(error) for name, figure in _OF_ERROR.items()}
        if loop.command:
            command = result[loop.command][part]
            numbers |= {f"{prefix}command_{name}": figure(command) for name, figure in _OF_COMMAND.items()}
            numbers[f"{prefix}command_tv"] = total_variation(time, command)
    return numbers


def tracking_units(result: Recorded) -> dict[str, str]:
    """The units of the figures of ``tracking``, by name. The values of the result are not needed."""
    found = loops(result)
    units: dict[str, str] = {}
    for loop in found:
        prefix = f"{loop.name}." if len(found) > 1 else ""
        units |= {f"{prefix}error_{name}": result.unit(loop.position) for name in _OF_ERROR}
        if loop.command:
            unit = result.unit(loop.command)
            units |= {f"{prefix}command_{name}": unit for name in _OF_COMMAND}
            units[f"{prefix}command_tv"] = f"{unit}/s"
    return units
