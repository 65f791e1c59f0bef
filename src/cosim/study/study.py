"""The parts of a study: runs, claims, measures, pictures; and the verdict, computed from a claim and measured values.

A verdict is always computed, never written by hand: a claim gets the first status whose rule holds for its measured
values. If no rule holds, it is "not reproduced", or "differs" for a check of our own code.
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
from .rules import Criterion, Numbers

Kind = Literal["paper", "check", "finding"]
"""``paper``: a publication says so. ``check``: another simulation of the same equations gave this figure; agreement
proves the code, not the model. ``finding``: nobody published it; it is measured and not judged."""

Status = Literal[
    "reproduced",
    "fitted",
    "order only",
    "transferred",
    "not reproduced",
    "agrees",
    "differs",
    "finding",
    "not checkable",
    "not run",
]
"""``fitted``: the claim holds with a choice that was made after its figure was seen. ``order only``: the figures
differ, but their order is the published one. ``transferred``: the claim holds on another machine, since the data of
the paper's machine are not known. ``agrees``, ``differs``: results of checks. ``not checkable``: nothing was published,
or a run that the claim needs has failed. ``not run``: a run that the claim needs was left out."""

STATUSES: Mapping[Kind, tuple[Status, ...]] = {
    "paper": ("reproduced", "fitted", "order only", "transferred", "not reproduced", "not checkable", "not run"),
    "check": ("agrees", "differs", "not checkable", "not run"),
    "finding": ("finding", "not checkable", "not run"),
}
"""The statuses that a claim of each kind can get, the best first."""

Value = float | int | bool | str
NONE: Mapping[str, Any] = MappingProxyType({})
COPY = "~"
"""Separator between the name of a run and the number of its perturbed copy."""


@dataclass(frozen=True)
class Run:
    """One run of a study."""

    system: str
    """System file in the folder of the study."""
    overrides: Mapping[str, Value] = field(default_factory=lambda: NONE)
    """Changed start values: ``instance.variable`` -> value."""
    stop_time: float | None = None
    """End of the run in s, if it is not that of the system file."""
    window: tuple[float, float] = (-math.inf, math.inf)
    """Begin and end in s of the part of the run that ``measure`` looks at."""
    measure: Callable[[Result, tuple[float, float]], Numbers] | None = None
    """Function that gives figures beyond those of ``tracking``; it gets every recorded row."""
    keep_every: int = 1
    """After the figures are measured, every ``keep_every``-th row is kept for claims and pictures."""
    scaled: Mapping[str, float] = field(default_factory=lambda: NONE)
    """Scaled start values: ``instance.variable`` -> factor on the value from the system file or ``overrides``."""
    machines: int = 0
    """Number of machines drawn from ``box`` that are run besides the machine of the file: see ``run.run_machines``."""
    box: Mapping[str, tuple[float, float]] = field(default_factory=lambda: NONE)
    """Start value that differs between machines -> range of the factor on it."""


@dataclass(frozen=True)
class Outcome:
    """The result of a run: figures in SI units and the rows kept, or the reason of its failure."""

    name: str
    run: Run
    numbers: Numbers
    result: Result | None
    steps: int
    failure: str = ""


class Missing(CosimError):
    """A claim or picture needs a run that was left out or has failed."""

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
        """One figure of a run. Raises DescriptionError if the run has no such figure."""
        numbers = self[run].numbers
        if name not in numbers:
            raise DescriptionError(f"run {run} has no figure '{name}': it has {', '.join(sorted(numbers))}.")
        return numbers[name]

    def result(self, run: str) -> Result:
        """The rows kept of a run. Raises Missing if the run was left out or has failed."""
        result = self[run].result
        if result is None:
            raise Missing(run, "no rows were kept")
        return result

    def all(self) -> tuple[Outcome, ...]:
        """Every outcome, the failed ones too."""
        return tuple(self._outcomes.values())

    def copies(self) -> list[Outcomes]:
        """One set of outcomes for each number of a copy; in it the perturbed copies replace their runs."""
        found: dict[int, dict[str, Outcome]] = {}
        for name, outcome in self._outcomes.items():
            base, separator, number = name.rpartition(COPY)
            if separator:
                found.setdefault(int(number), {})[base] = outcome
        copies: list[Outcomes] = []
        for _, replaced in sorted(found.items()):
            copy = Outcomes([])
            copy._outcomes = self._outcomes | replaced
            copies.append(copy)
        return copies


Measure = Callable[[Outcomes], float | Numbers]
"""Function that measures a claim: it returns one value, or values by label, in the unit of the claim."""

Advance = Callable[[Outcome], None]
OwnOutcomes = Callable[[Path | None, Path | None, Advance, int], Outcomes]
"""Function that makes the outcomes of a study about measured data of the user.

Its arguments are the folder of the data (None: use the figures that come with the study), the folder of the FMUs, a
function that gets each outcome as it is ready, and the number of runs at a time.
"""

NO_RULES: Mapping[Status, Criterion] = MappingProxyType({})


@dataclass(frozen=True)
class Reading:
    """A claim measured in another setting; the report shows the result but does not count it."""

    setting: str
    measure: Measure


@dataclass(frozen=True)
class Claim:
    """A statement of a paper, or a figure of another simulation, and how it is measured."""

    id: str
    text: str
    published: str | float | Numbers
    """What was published: words, one value, or values by label, in ``unit``."""
    unit: str | Mapping[str, str] = "1"
    """The unit of every value, or units by label."""
    measure: Measure | None = None
    """The measured value or values in ``unit``; None if there is nothing to measure."""
    verdicts: Mapping[Status, Criterion] = field(default_factory=lambda: NO_RULES)
    """Status -> the rule that must hold for it, the best status first."""
    group: str = "Claims"
    setting: str = ""
    """The setting in which the claim is measured; if possible, it is the same for all claims of a study."""
    note: str = ""
    """Remark that a reader needs to judge the claim."""
    kind: Kind = "paper"
    readings: tuple[Reading, ...] = ()

    def unit_of(self, label: str) -> str:
        """The unit of the value ``label``."""
        return self.unit if isinstance(self.unit, str) else self.unit.get(label, "1")

    def published_numbers(self) -> Numbers:
        """The published values by label; empty if words were published."""
        return NONE if isinstance(self.published, str) else labelled(self.published)


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
    """Introduction before the tables, in Markdown."""
    runs: Mapping[str, Run]
    claims: tuple[Claim, ...]
    pictures: Mapping[str, Picture]
    groups: Mapping[str, str] = field(default_factory=lambda: NONE)
    """Text under the heading of a group of claims."""
    chapters: Mapping[str, Callable[[Outcomes], str]] = field(default_factory=lambda: NONE)
    """More chapters of the report: heading -> Markdown made from the outcomes."""
    outcomes: OwnOutcomes | None = None
    """Function that makes the outcomes instead of the runs, for a study about measured data of the user."""
    claims_digest: str = ""
    """SHA-256 of the file of claims, read before the first run."""

    def __post_init__(self) -> None:
        ids = [claim.id for claim in self.claims]
        problems = [
            f"claim {name} is there {ids.count(name)} times: give each its own id."
            for name in sorted({name for name in ids if ids.count(name) > 1})
        ]
        for claim in self.claims:
            wanted = claim.measure is not None and claim.kind != "finding"
            if wanted != bool(claim.verdicts):
                problems.append(
                    f"claim {claim.id} has a measure without verdicts, or verdicts without a measure: "
                    "give both or none."
                )
            problems += [
                f"claim {claim.id} has a rule for '{status}', which a {claim.kind} cannot get. "
                f"Use one of {', '.join(STATUSES[claim.kind])}."
                for status in claim.verdicts
                if status not in STATUSES[claim.kind]
            ]
        if problems:
            raise DescriptionError(problems)


@dataclass(frozen=True)
class ReadingResult:
    """The result of a claim in another setting."""

    setting: str
    measured: Numbers
    status: Status
    reason: str = ""


@dataclass(frozen=True)
class Verdict:
    """The verdict on a claim."""

    claim: Claim
    measured: Numbers
    status: Status
    reason: str = ""
    """Why the claim could not be measured; empty if it was."""
    spread: Mapping[str, tuple[float, float]] = field(default_factory=lambda: NONE)
    """Smallest and largest value over the run and its perturbed copies, by label; empty without copies."""
    readings: tuple[ReadingResult, ...] = ()


def labelled(value: float | Numbers) -> Numbers:
    """Values by label; a single value has the label ``""``."""
    return {"": float(value)} if isinstance(value, float | int | np.floating) else value


def judge(claim: Claim, outcomes: Outcomes) -> Verdict:
    """Measure a claim and give it the first status whose rule holds for its runs and all their perturbed copies.

    No rule holds for NaN.
    """
    if claim.measure is None:
        return Verdict(claim, NONE, "not checkable")
    measured, status, reason = _judged(claim, claim.measure, [outcomes])
    readings = tuple(
        ReadingResult(reading.setting, *_judged(claim, reading.measure, [outcomes])) for reading in claim.readings
    )
    copies = outcomes.copies()
    if not measured or not copies:
        return Verdict(claim, measured, status, reason, NONE, readings)
    found = [_measured(claim.measure, copy) for copy in copies]
    spread = {
        label: (min(values), max(values))
        for label in measured
        if len(set(values := [numbers.get(label, math.nan) for numbers in (measured, *found)])) > 1
    }
    if spread:
        status = _judged(claim, claim.measure, [outcomes, *copies])[1]
    return Verdict(claim, measured, status, reason, spread, readings)


def _measured(measure: Measure, outcomes: Outcomes) -> Numbers:
    """The measured values; empty if a run is missing."""
    try:
        return labelled(measure(outcomes))
    except Missing:
        return NONE


def _judged(claim: Claim, measure: Measure, sets: Sequence[Outcomes]) -> tuple[Numbers, Status, str]:
    """The values in the first set of outcomes, the first status whose rule holds in all sets, and a reason."""
    try:
        measured = [labelled(measure(outcomes)) for outcomes in sets]
    except Missing as missing:
        return NONE, "not checkable" if missing.failure else "not run", str(missing)
    if claim.kind == "finding":
        return measured[0], "finding", ""
    published = claim.published_numbers()
    if not any(math.isnan(value) for numbers in measured for value in numbers.values()):
        for status, rule in claim.verdicts.items():
            if all(rule.holds(numbers, published) for numbers in measured):
                return measured[0], status, ""
    return measured[0], "differs" if claim.kind == "check" else "not reproduced", ""
