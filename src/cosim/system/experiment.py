"""The table ``[experiment]``: times, step, order, tolerance."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from fractions import Fraction
from typing import Any, cast

from ..errors import suggest
from .findings import Findings
from .parts import Order
from .values import decimal, fraction, show_value, whole

SHORTEST, LONGEST = Fraction(1, 10**18), 10**12
"""Times in s beyond which a number is no time of a machine: the period of light waves, 30,000 years."""

MOST_STEPS = 2**53
"""Largest number of steps. A double holds each number of steps up to it, so that each instant is exact."""


@dataclass(frozen=True)
class ExperimentTimes:
    """A checked experiment; ``steps`` is 0 if a problem was found."""

    start_time: Decimal = Decimal(0)
    stop_time: Decimal = Decimal(0)
    step_size: Decimal = Decimal(0)
    steps: int = 0
    order: Order = "sequential"
    tolerance: float | None = None


def read_experiment(
    document: Mapping[str, Any],
    findings: Findings,
    ends: Sequence[tuple[str, float]] | None = None,
    multiple: int = 1,
) -> ExperimentTimes:
    """The experiment of a document.

    ``ends`` are the names of records that end the run, and the times in s at which they end. The number of steps is
    then a multiple of ``multiple``. If no record ends the run, ``ends`` is None and a stop time is required.
    """
    table = findings.table(document, "experiment")
    findings.known_keys("experiment", table, ("start_time", "stop_time", "step_size", "order", "tolerance"))
    start = _seconds(table, "start_time", Fraction(0), findings)
    stop = _seconds(table, "stop_time", None, findings) if "stop_time" in table or ends is None else None
    step = _seconds(table, "step_size", None, findings)
    if step is not None and step <= 0:
        findings.problem("experiment.step_size", f"{step} s must be positive.")
        step = None
    if start is not None and stop is not None and stop <= start:
        findings.problem("experiment.stop_time", f"{stop} s must be after start_time = {start} s.")
        stop = None
    tolerance = _tolerance(table, findings)
    order = _order(table.get("order", "sequential"), findings.table(document, "instances"), findings)
    if start is not None and step is not None and ends and ("stop_time" not in table or stop is not None):
        stop = _with_record(start, stop, step, ends, multiple, findings)
    if start is None or stop is None or step is None:
        return ExperimentTimes(order=order, tolerance=tolerance)
    steps = _steps(start, stop, step, findings)
    return ExperimentTimes(_decimal(start), _decimal(stop), _decimal(step), steps, order, tolerance)


Number = Decimal | Fraction
"""A number exactly as it was written: a decimal, or a fraction such as 1/30."""


def _seconds(table: Mapping[str, Any], key: str, default: Fraction | None, findings: Findings) -> Number | None:
    where = f"experiment.{key}"
    if key not in table:
        if default is None:
            findings.problem(
                where, f"missing. Give it in seconds, such as {key} = 1.0, or --{key.replace('_', '-')} 1.0."
            )
            return None
        return Decimal(int(default))
    value = table[key]
    exact = fraction(value)
    if exact is None:
        hint = ' Fractions are written "1/30".' if isinstance(value, str) and "/" in value else ""
        findings.problem(where, f"{show_value(value)} is not a finite number of seconds.{hint}")
        return None
    if exact and not SHORTEST <= abs(exact) <= LONGEST:
        findings.problem(where, f"a time must be 0 or lie between {float(SHORTEST):g} s and {LONGEST} s.")
        return None
    return exact if isinstance(value, str) else decimal(value)


def _with_record(  # noqa: PLR0917
    start: Number,
    stop: Number | None,
    step: Number,
    ends: Sequence[tuple[str, float]],
    multiple: int,
    findings: Findings,
) -> Number | None:
    """The stop time of a run that a record ends: the last communication point before the first record ends.

    An earlier ``stop`` is kept.
    """
    name, end = min(ends, key=lambda item: item[1])
    if stop is not None and float(stop) <= end:
        return stop
    # As a double, 0.3 is a little less than 3 steps of 0.1.
    steps = math.floor((end - float(start)) / float(step) + 1e-6) // multiple * multiple
    if steps < 1:
        findings.problem(
            f"signals.{name}",
            f"the record ends at {end:.9g} s, before the first communication step from {_decimal(start)} s on is over.",
        )
        return None
    last = Fraction(start) + steps * Fraction(step)
    if stop is not None:
        findings.note(
            f"signals.{name}",
            f"the run ends at {float(last):.9g} s, where the record ends, not at stop_time = {_decimal(stop)} s.",
        )
    return last


def _decimal(number: Number) -> Decimal:
    """A fraction as the shortest decimal of the nearest double. A run computes with this double."""
    return number if isinstance(number, Decimal) else Decimal(repr(float(number)))


def _steps(start: Number, stop: Number, step: Number, findings: Findings) -> int:
    length = Fraction(stop) - Fraction(start)
    ratio = length / Fraction(step)
    steps = whole(ratio)
    if ratio > MOST_STEPS:
        findings.problem("experiment.step_size", f"{float(ratio):.3g} steps: at most 2^53 can be counted exactly.")
        return 0
    if steps is not None:
        return steps
    whole_steps = math.floor(ratio)
    ends = [Fraction(start) + n * Fraction(step) for n in (whole_steps, whole_steps + 1) if n > 0]
    nearest = round(ratio)
    exact = length.denominator == 1 and abs(ratio - nearest) < 0.01 and nearest > 0
    remedy = f'step_size = "{length}/{nearest}"' if exact else "step_size"
    findings.problem(
        "experiment.step_size",
        f"{step} s does not divide stop_time - start_time = {_decimal(stop) - _decimal(start)} s into whole steps "
        f"({float(ratio):.6g}). Change {remedy}, or take stop_time = {' or '.join(_plain(end) for end in ends)}.",
    )
    return 0


def _plain(number: Fraction) -> str:
    """A fraction as decimal text, rounded to the precision of Decimal."""
    return f"{Decimal(number.numerator) / Decimal(number.denominator)}"


def _tolerance(table: Mapping[str, Any], findings: Findings) -> float | None:
    if "tolerance" not in table:
        return None
    given = table["tolerance"]
    number = None if isinstance(given, str) else decimal(given)
    if number is None or not number.is_finite() or not 0 < number < 1:
        findings.problem("experiment.tolerance", f"{show_value(given)}: give a number between 0 and 1.")
        return None
    return float(number)


def _order(value: object, instances: Mapping[str, Any], findings: Findings) -> Order:
    where = "experiment.order"
    if value == "parallel":
        return "parallel"
    if value == "sequential":
        return "sequential"
    if isinstance(value, str):
        findings.problem(where, f"'{value}' is no order.{suggest(value, ('parallel', 'sequential'))}")
        return "sequential"
    if not isinstance(value, Sequence) or not all(isinstance(name, str) for name in cast("Sequence[Any]", value)):
        findings.problem(where, 'give "sequential", "parallel" or a list of all instances.')
        return "sequential"
    names = tuple(cast("Sequence[str]", value))
    if len(names) == 1 and len(instances) != 1 and names[0] not in instances:
        known = ("parallel", "sequential", *instances)
        findings.problem(where, f"'{names[0]}' is no order.{suggest(names[0], known)}")
        return "sequential"
    for name in dict.fromkeys(names):
        if name not in instances:
            findings.problem(where, f"no instance '{name}'.{suggest(name, instances)}")
        elif names.count(name) > 1:
            findings.problem(where, f"instance '{name}' is named {names.count(name)} times. Name it once.")
    missing = [name for name in instances if name not in names]
    if missing:
        named = f"instances {', '.join(missing)} are" if len(missing) > 1 else f"instance {missing[0]} is"
        findings.problem(where, f"{named} missing. Name every instance.")
    return names
