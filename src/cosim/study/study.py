"""Studies: the runs behind a paper, what it claims, what was measured, and a verdict computed from both.

A study is a folder ``studies/NAME`` with system files and a ``study.py`` that holds ``STUDY``, a ``Study``: its runs
(name -> system file and changed values), its claims (a text, the published figure, a function measuring it in the
runs, the rules that earn each verdict) and its pictures. ``cosim study NAME`` runs it and writes the report.

A verdict is never written down: a claim gets the first status whose rule its measured values keep, and
"not reproduced" if they keep none.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

import numpy as np

from ..errors import CosimError, DescriptionError
from ..result.result import Result
from .rules import Numbers, Rule

Status = Literal["reproduced", "fitted", "order only", "not reproduced", "not checkable", "not run"]
"""``fitted``: it holds with values chosen to make it hold. ``order only``: the figure differs, the order of the
compared things does not. ``not checkable``: nothing was published, or a run it needs has failed. ``not run``: a run
it needs was left out."""

Value = float | int | bool | str
NONE: Mapping[str, Any] = MappingProxyType({})


@dataclass(frozen=True)
class Run:
    """One run of a study."""

    system: str
    """System file in the folder of the study."""
    overrides: Mapping[str, Value] = field(default_factory=lambda: NONE)
    """Start values changed: ``instance.variable`` -> value."""
    stop_time: float | None = None
    """End of the run in s, if it is not that of the system file."""
    window: tuple[float, float] = (-math.inf, math.inf)
    """Seconds over which ``measure`` looks at the run."""
    measure: Callable[[Result, tuple[float, float]], Numbers] | None = None
    """Figures beyond those of ``tracking``; it sees every recorded row."""
    keep_every: int = 1
    """Rows kept for claims and pictures once the figures are measured: every so many."""


@dataclass(frozen=True)
class Outcome:
    """What a run gave: figures in SI units, the rows kept, or why it failed."""

    name: str
    run: Run
    numbers: Numbers
    result: Result | None
    steps: int
    failure: str = ""


class Missing(CosimError):
    """A claim or picture asks for a run that is not there."""

    def __init__(self, name: str, failure: str) -> None:
        self.failure = failure
        super().__init__(f"run {name} failed: {failure}" if failure else f"run {name} was left out")


class Outcomes(Mapping[str, Outcome]):
    """The outcomes by run, in the order of the study."""

    def __init__(self, outcomes: Sequence[Outcome]) -> None:
        self._outcomes = {outcome.name: outcome for outcome in outcomes}

    def __getitem__(self, name: str) -> Outcome:
        """The outcome of a run; raises Missing if it was left out or has failed."""
        outcome = self._outcomes.get(name)
        if outcome is None or outcome.failure:
            raise Missing(name, outcome.failure if outcome else "")
        return outcome

    def __iter__(self) -> Iterator[str]:
        return iter(self._outcomes)

    def __len__(self) -> int:
        return len(self._outcomes)

    def number(self, run: str, name: str) -> float:
        """One figure of a run."""
        return self[run].numbers[name]

    def result(self, run: str) -> Result:
        """The rows kept of a run."""
        result = self[run].result
        if result is None:
            raise Missing(run, "no rows were kept")
        return result

    def all(self) -> tuple[Outcome, ...]:
        """Every outcome, the failed ones too."""
        return tuple(self._outcomes.values())


# Claims


NO_RULES: Mapping[Status, Rule] = MappingProxyType({})


@dataclass(frozen=True)
class Claim:
    """One thing a paper says, and how it is looked for."""

    id: str
    text: str
    published: str | float | Numbers
    """What was published: words, one value, or values by label, in ``unit``."""
    unit: str = "1"
    measure: Callable[[Outcomes], float | Numbers] | None = None
    """The measured value or values in ``unit``; None if there is nothing to measure."""
    verdicts: Mapping[Status, Rule] = field(default_factory=lambda: NO_RULES)
    """The rule that earns each status, the best first."""
    group: str = "Claims"
    setting: str = ""
    """In which setting it is looked for."""
    note: str = ""
    """What a reader should know to judge it."""


@dataclass(frozen=True)
class Picture:
    """One picture of the report, drawn by ``draw(outcomes, path)``."""

    title: str
    draw: Callable[[Outcomes, Path], None]


@dataclass(frozen=True)
class Study:
    """A study: see the module's text."""

    title: str
    source: str
    text: str
    """What a reader should know before the tables, in Markdown."""
    runs: Mapping[str, Run]
    claims: tuple[Claim, ...]
    pictures: Mapping[str, Picture]
    groups: Mapping[str, str] = field(default_factory=lambda: NONE)
    """Text under the heading of a group of claims."""

    def __post_init__(self) -> None:
        ids = [claim.id for claim in self.claims]
        problems = [
            f"claim {name} is there {ids.count(name)} times: give each its own id."
            for name in sorted({name for name in ids if ids.count(name) > 1})
        ]
        problems += [
            f"claim {claim.id} has a measure without verdicts, or verdicts without a measure: give both or none."
            for claim in self.claims
            if (claim.measure is None) != (not claim.verdicts)
        ]
        if problems:
            raise DescriptionError(problems)


@dataclass(frozen=True)
class Verdict:
    """The verdict on a claim."""

    claim: Claim
    measured: Numbers
    status: Status
    reason: str = ""
    """Why it could not be measured."""


def _numbers(value: float | Numbers) -> Numbers:
    return {"": float(value)} if isinstance(value, float | int | np.floating) else value


def judge(claim: Claim, outcomes: Outcomes) -> Verdict:
    """Measure a claim and give it the first status whose rule holds. NaN keeps no rule."""
    if claim.measure is None:
        return Verdict(claim, NONE, "not checkable")
    try:
        measured = _numbers(claim.measure(outcomes))
    except Missing as missing:
        return Verdict(claim, NONE, "not checkable" if missing.failure else "not run", str(missing))
    published = NONE if isinstance(claim.published, str) else _numbers(claim.published)
    if not any(math.isnan(value) for value in measured.values()):
        for status, rule in claim.verdicts.items():
            if rule.holds(measured, published):
                return Verdict(claim, measured, status)
    return Verdict(claim, measured, "not reproduced")
