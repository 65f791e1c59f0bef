"""Rules for verdicts: conditions on measured values, given the published ones."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

from ..errors import DescriptionError

Numbers = Mapping[str, float]
"""Values by label."""


@dataclass(frozen=True)
class Criterion:
    """A condition on measured values, given the published ones."""

    text: str
    """Text of the rule in the report; ``{unit}`` stands for a space and the unit of the claim."""
    holds: Callable[[Numbers, Numbers], bool]
    why: str = ""
    """The reason of its threshold."""
    tolerance: Callable[[float], float] | None = None
    """Allowed distance from a published value, for a rule that compares with it."""


def near(*, rel: float = 0.0, abs: float = 0.0) -> Criterion:
    """Every measured value is near the published one of the same label: within the share ``rel`` or within ``abs``.

    ``abs`` is in the unit of the claim. The rule raises DescriptionError if the labels differ.
    """

    def tolerance(published: float) -> float:
        return max(rel * math.fabs(published), abs)

    def holds(measured: Numbers, published: Numbers) -> bool:
        if measured.keys() != published.keys():
            raise DescriptionError(f"measured {sorted(measured)} but published {sorted(published)}: use equal labels.")
        return all(
            math.isclose(measured[k], published[k], rel_tol=0.0, abs_tol=tolerance(published[k])) for k in published
        )

    parts = [f"within {100.0 * rel:g} % of it"] if rel else []
    parts += [f"within ±{abs:g}{{unit}}"] if abs else []
    return Criterion(" or ".join(parts) or "equal", holds, tolerance=tolerance)


def within_effect(share: float, without: Numbers) -> Criterion:
    """Every measured value differs from the published one by at most ``share`` of the effect.

    The effect is the published value minus the value without the effect, by label in ``without``. Labels that
    ``without`` does not have are not judged.
    """

    def holds(measured: Numbers, published: Numbers) -> bool:
        return all(
            math.fabs(measured[k] - published[k]) <= share * math.fabs(published[k] - value)
            for k, value in without.items()
        )

    return Criterion(f"within {100.0 * share:g} % of the effect", holds)


def _every(text: str, condition: Callable[[float], bool]) -> Criterion:
    return Criterion(text, lambda measured, _: all(condition(value) for value in measured.values()))


def between(low: float, high: float) -> Criterion:
    """Every measured value is in ``low`` ... ``high``, in the unit of the claim."""
    return _every(f"{low:g} to {high:g}{{unit}}", lambda value: low <= value <= high)


def at_most(limit: float) -> Criterion:
    """Every measured value is at most ``limit``, in the unit of the claim."""
    return _every(f"at most {limit:g}{{unit}}", lambda value: value <= limit)


def at_least(limit: float) -> Criterion:
    """Every measured value is at least ``limit``, in the unit of the claim."""
    return _every(f"at least {limit:g}{{unit}}", lambda value: value >= limit)


def at_least_published() -> Criterion:
    """Every measured value is at least the published one of the same label."""
    return Criterion("each at least as published", lambda m, p: all(m[name] >= p[name] for name in p))


def at_most_published() -> Criterion:
    """Every measured value is at most the published one of the same label."""
    return Criterion("each at most as published", lambda m, p: all(m[name] <= p[name] for name in p))


def published_order() -> Criterion:
    """The measured values, put in the order of the published ones, rise."""

    def holds(measured: Numbers, published: Numbers) -> bool:
        labels = sorted(published, key=lambda label: published[label])
        return all(measured[one] < measured[other] for one, other in pairwise(labels))

    return Criterion("the published order", holds)


def falling() -> Criterion:
    """Each measured value is smaller than the one before it."""

    def holds(measured: Numbers, _: Numbers) -> bool:
        values = list(measured.values())
        return all(after < before for before, after in pairwise(values))

    return Criterion("each smaller than the one before", holds)


def both(one: Criterion, other: Criterion) -> Criterion:
    """A rule that holds where two rules hold."""

    def holds(measured: Numbers, published: Numbers) -> bool:
        return one.holds(measured, published) and other.holds(measured, published)

    return replace(one, text=f"{one.text} and {other.text}", holds=holds)
