"""Rules that earn a verdict: conditions on measured values, given the published ones."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise

from ..errors import DescriptionError

Numbers = Mapping[str, float]
"""Values by label."""


@dataclass(frozen=True)
class Rule:
    """A condition on measured values, given the published ones."""

    text: str
    """For the report; ``{unit}`` stands for a space and the unit of the claim."""
    holds: Callable[[Numbers, Numbers], bool]


def near(*, rel: float = 0.0, abs: float = 0.0) -> Rule:
    """Every measured value within ``rel`` of the published one of the same label or within ``abs`` in the unit."""

    def holds(measured: Numbers, published: Numbers) -> bool:
        if measured.keys() != published.keys():
            raise DescriptionError(f"measured {sorted(measured)} but published {sorted(published)}: use equal labels.")
        return all(
            math.isclose(measured[k], published[k], rel_tol=0.0, abs_tol=max(rel * math.fabs(published[k]), abs))
            for k in published
        )

    parts = [f"{100.0 * rel:g} %"] if rel else []
    parts += [f"{abs:g}{{unit}}"] if abs else []
    return Rule("within " + " or ".join(parts), holds)


def _every(text: str, condition: Callable[[float], bool]) -> Rule:
    return Rule(text, lambda measured, _: all(condition(value) for value in measured.values()))


def between(low: float, high: float) -> Rule:
    """Every measured value in ``low`` ... ``high``."""
    return _every(f"{low:g} to {high:g}{{unit}}", lambda value: low <= value <= high)


def at_most(limit: float) -> Rule:
    """Every measured value at most ``limit``."""
    return _every(f"at most {limit:g}{{unit}}", lambda value: value <= limit)


def at_least(limit: float) -> Rule:
    """Every measured value at least ``limit``."""
    return _every(f"at least {limit:g}{{unit}}", lambda value: value >= limit)


def both(one: Rule, other: Rule) -> Rule:
    """Two rules at once."""
    return Rule(f"{one.text} and {other.text}", lambda m, p: one.holds(m, p) and other.holds(m, p))


def falling() -> Rule:
    """Each measured value smaller than the one before it."""

    def holds(measured: Numbers, _: Numbers) -> bool:
        values = list(measured.values())
        return all(after < before for before, after in pairwise(values))

    return Rule("each smaller than the one before", holds)
