"""Claims as data: the file ``claims.toml`` of a study, which is read and checked before the first run.

The ``kind`` of a table of claims says whether its figures come from a paper, from another simulation, or from nobody.
The values of a claim are given in one of two ways: ``values`` has for each label a sum or product of ``run:figure``
terms, ``measure`` names a function of the study. Figures of runs are in SI units; the claim's unit says how they are
scaled. Each threshold is given with its reason.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag, model_validator

from ..errors import DescriptionError, suggest
from ..fmu.tables import Number, Pair, Positive, Share, Table, Text, read_table
from . import expression, rules
from .rules import Criterion, Numbers
from .study import COPY, Claim, Kind, Measure, Outcomes, OwnOutcomes, Picture, Reading, Run, Status, Study, labelled

FACTORS: Mapping[str, float] = {
    "nm": 1e9,
    "µm": 1e6,
    "mm": 1e3,
    "µm/s": 1e6,
    "mm/s": 1e3,
    "ms": 1e3,
    "%": 1e2,
    "A·s/mm": 1e-3,
    "mm/(A·s)": 1e3,
}
"""Unit of a claim -> factor on values in SI units; 1 for every other unit."""
RELATIVE = 1e-6
"""Relative change of a parameter in a perturbed copy of a run.

It is far below the uncertainty of any machine parameter and far above rounding errors.
"""


def _number_or_table(value: object) -> str:
    return "table" if isinstance(value, Mapping) else "number"


def _text_or_table(value: object) -> str:
    return "table" if isinstance(value, Mapping) else "text"


def _text_number_or_table(value: object) -> str:
    return "text" if isinstance(value, str) else _number_or_table(value)


TextOrTable = Annotated[
    Annotated[str, Tag("text")] | Annotated[dict[str, str], Tag("table")], Discriminator(_text_or_table)
]
NumberOrTable = Annotated[
    Annotated[Number, Tag("number")] | Annotated[dict[str, Number], Tag("table")], Discriminator(_number_or_table)
]
TextNumberOrTable = Annotated[
    Annotated[str, Tag("text")] | Annotated[Number, Tag("number")] | Annotated[dict[str, Number], Tag("table")],
    Discriminator(_text_number_or_table),
]


class RuleData(Table):
    """Conditions that must all hold, and the reason of their thresholds."""

    near: Number | None = None
    """Largest relative distance from the published value."""
    near_abs: Number | None = None
    """Largest distance from the published value, in the unit of the claim."""
    share_of_effect: Share | None = None
    """Largest distance from the published value, as a share of the effect: the published value minus ``without``."""
    at_most: Number | None = None
    """Largest value, in the unit of the claim."""
    at_least: Number | None = None
    """Smallest value, in the unit of the claim."""
    between: Pair | None = None
    """Smallest and largest value, in the unit of the claim."""
    falling: bool = False
    """Whether each value must be smaller than the one before it."""
    published: Literal["at least", "at most", "same order"] | None = None
    """Required relation of the measured values to the published ones."""
    rule: str = ""
    """Name of a rule of the study."""
    why: str = ""
    """Reason of the thresholds. Must be given here or in the table of claims."""

    @model_validator(mode="after")
    def _has_a_condition(self) -> RuleData:
        if not self.model_fields_set - {"why"}:
            raise ValueError("no condition: give near, near_abs, at_most, at_least, between, falling or published")
        return self


class ReadingData(Table):
    """A claim measured in another setting; the report shows the result but does not count it."""

    setting: Text
    """The other setting, in words."""
    values: Mapping[str, str] = {}
    """Values in this setting, as in a claim."""
    measure: str = ""
    """Name of a function of the study, as in a claim."""


class ClaimData(Table):
    """One claim."""

    id: Text
    """Short name, such as M1; the report uses it."""
    text: Text
    """What is claimed, in words."""
    published: TextNumberOrTable
    """The published value, or values by label; a text if no number was published."""
    unit: TextOrTable = "1"
    """Unit of the values, or units by label; ``1`` has none."""
    factor: Number | None = None
    """Factor on values in SI units, for a unit that ``FACTORS`` does not have."""
    magnitude: bool = False
    """Whether magnitudes are compared instead of values with signs."""
    values: Mapping[str, str] = {}
    """For each label, a sum or product of ``run:figure`` terms; the label of a single value is empty."""
    measure: str = ""
    """Name of a function of the study, in place of values."""
    setting: str = ""
    """Setting of the runs, in words."""
    note: str = ""
    """What a reader must know to judge the value."""
    without: NumberOrTable | None = None
    """The values to expect without the effect that is tested, by label; labels without a known effect are left out."""
    verdicts: Mapping[Status, RuleData] = {}
    """For each status, the rule that earns it; the first that holds decides."""
    readings: Sequence[ReadingData] = ()
    """The same claim measured in other settings."""


class TableData(Table):
    """Claims of one kind under one heading."""

    title: Text
    """Heading of the table."""
    kind: Kind
    """``paper``: a publication says so; ``check``: another simulation gave it; ``finding``: measured, not judged."""
    text: str = ""
    """Text above the table."""
    setting: str = ""
    """Setting of the claims that do not give their own."""
    why: str = ""
    """Reason of the thresholds that do not give their own."""
    claims: list[ClaimData]
    """The claims."""


class SpreadData(Table):
    """Runs that are repeated with slightly changed values: once for each parameter, once with another tolerance."""

    runs: list[str]
    """Names of runs; ``*`` stands for any characters, ``?`` for one."""
    parameters: Annotated[list[str], Field(min_length=1)]
    """``INSTANCE.VARIABLE``: each is changed in a copy of its own."""
    relative: Positive = RELATIVE
    """Relative change of each parameter."""
    tolerance: Mapping[str, Positive] = {}
    """Tolerance parameter of the integrator -> factor on its value, for the copy with another tolerance."""


class ClaimsData(Table):
    """A file of claims."""

    title: Text
    """Title of the report."""
    source: Text
    """The paper: authors, title, journal, year."""
    text: Text
    """What the study is about, in Markdown."""
    spread: Sequence[SpreadData] = ()
    """Runs that are repeated with slightly changed values."""
    tables: list[TableData]
    """The tables of claims."""


def read_claims(path: Path) -> ClaimsData:
    """The claims file at ``path``. Raises DescriptionError with every problem of its shape."""
    return read_table(path, ClaimsData)


def read_study(
    path: Path,
    runs: Mapping[str, Run],
    pictures: Mapping[str, Picture],
    *,
    measures: Mapping[str, Measure] | None = None,
    own_rules: Mapping[str, Criterion] | None = None,
    chapters: Mapping[str, Callable[[Outcomes], str]] | None = None,
    outcomes: OwnOutcomes | None = None,
) -> Study:
    """The study with the claims of the file ``path``; its claims name ``measures`` and ``own_rules``.

    Raises DescriptionError with every problem: a run or measure that does not exist, a threshold without its reason, a
    tolerance above the effect that it tests.
    """
    data = read_claims(path)
    builder = _Builder(path.name, runs, measures or {}, own_rules or {})
    claims = tuple(builder.claim(table, claim) for table in data.tables for claim in table.claims)
    copies: dict[str, Run] = {}
    for spread in data.spread:
        copies |= builder.copies(spread)
    if builder.problems:
        raise DescriptionError(builder.problems)
    return Study(
        title=data.title,
        source=data.source,
        text=data.text,
        runs={**runs, **copies},
        claims=claims,
        pictures=pictures,
        groups={table.title: table.text for table in data.tables},
        chapters=chapters or {},
        outcomes=outcomes,
        claims_digest=hashlib.sha256(path.read_bytes()).hexdigest(),
    )


class _Builder:
    """Turns claims as data into claims, and collects the problems."""

    def __init__(
        self, file: str, runs: Mapping[str, Run], measures: Mapping[str, Measure], own_rules: Mapping[str, Criterion]
    ) -> None:
        self.file = file
        self.runs = runs
        self.measures = measures
        self.own_rules = own_rules
        self.problems: list[str] = []

    def problem(self, claim: str, text: str) -> None:
        self.problems.append(f"{self.file}: claim {claim}: {text}")

    def claim(self, table: TableData, data: ClaimData) -> Claim:
        verdicts: dict[Status, Criterion] = {
            status: self.rule(table, data, rule) for status, rule in data.verdicts.items()
        }
        readings = tuple(
            Reading(reading.setting, measure)
            for reading in data.readings
            if (measure := self.measure(data, reading.values, reading.measure)) is not None
        )
        return Claim(
            data.id,
            data.text,
            data.published,
            data.unit,
            self.measure(data, data.values, data.measure),
            verdicts,
            table.title,
            data.setting or table.setting,
            data.note,
            table.kind,
            readings,
        )

    def measure(self, data: ClaimData, values: Mapping[str, str], name: str) -> Measure | None:
        if values and name:
            self.problem(data.id, "it has values and a measure: give one of them.")
        if name:
            if name not in self.measures:
                self.problem(data.id, f"there is no measure '{name}'.{suggest(name, self.measures)}")
            return self.measures.get(name)
        for text in values.values():
            self.check_terms(data.id, text)
        return measured_values(values, data) if values else None

    def check_terms(self, claim: str, text: str) -> None:
        try:
            terms = expression.names(text)
        except DescriptionError as error:
            self.problem(claim, str(error))
            return
        for term in terms:
            run, separator, figure = term.rpartition(":")
            if not separator or not figure:
                self.problem(claim, f"'{term}' is no figure of a run: write 'run:figure'.")
            elif run not in self.runs:
                self.problem(claim, f"there is no run '{run}'.{suggest(run, self.runs)}")

    def rule(self, table: TableData, claim: ClaimData, data: RuleData) -> Criterion:
        """The rule that holds where all conditions of ``data`` hold."""
        why = data.why or table.why
        if not why:
            self.problem(claim.id, "a threshold has no reason: give why.")
        without = labelled(claim.without) if claim.without is not None else None
        found: list[Criterion] = []
        if data.near is not None or data.near_abs is not None:
            rule = rules.near(rel=data.near or 0.0, abs=data.near_abs or 0.0)
            found.append(rule)
            if without is not None and rule.tolerance is not None and data.share_of_effect is None:
                self.check_effect(claim, rule.tolerance, without)
        if data.share_of_effect is not None:
            if without is None:
                self.problem(claim.id, "share_of_effect needs the published values without the effect: give without.")
            else:
                found.append(rules.within_effect(data.share_of_effect, without))
        if data.at_most is not None:
            found.append(rules.at_most(data.at_most))
        if data.at_least is not None:
            found.append(rules.at_least(data.at_least))
        if data.between is not None:
            low, high = data.between
            found.append(rules.between(low, high))
        if data.falling:
            found.append(rules.falling())
        if data.published is not None:
            found.append(
                {
                    "at least": rules.at_least_published,
                    "at most": rules.at_most_published,
                    "same order": rules.published_order,
                }[data.published]()
            )
        if data.rule:
            if data.rule in self.own_rules:
                found.append(self.own_rules[data.rule])
            else:
                self.problem(claim.id, f"there is no rule '{data.rule}'.{suggest(data.rule, self.own_rules)}")
        if not found:
            return Criterion("", _never, why)
        combined = found[0]
        for other in found[1:]:
            combined = rules.both(combined, other)
        return replace(combined, why=why)

    def check_effect(self, claim: ClaimData, tolerance: Callable[[float], float], without: Numbers) -> None:
        """Report a tolerance as large as the effect: such a rule would hold without the effect, too."""
        published: Numbers = {} if isinstance(claim.published, str) else labelled(claim.published)
        for label in without.keys() - published.keys():
            self.problem(claim.id, f"without: there is no published value '{label}'.")
        for label in without.keys() & published.keys():
            allowed, effect = tolerance(published[label]), math.fabs(published[label] - without[label])
            if not allowed < effect:
                self.problem(
                    claim.id,
                    f"{label or 'its value'}: the tolerance {allowed:.3g} is not below the effect {effect:.3g} that it "
                    "tests. Give a smaller one, or share_of_effect.",
                )

    def copies(self, data: SpreadData) -> dict[str, Run]:
        """The perturbed copies of runs."""
        found: dict[str, Run] = {}
        scales: list[Mapping[str, float]] = [{name: 1.0 + data.relative} for name in data.parameters]
        if data.tolerance:
            scales.append(data.tolerance)
        for pattern in data.runs:
            matching = [name for name in self.runs if fnmatchcase(name, pattern)]
            if not matching:
                self.problems.append(f"{self.file}: spread: no run matches '{pattern}'.{suggest(pattern, self.runs)}")
            for name in matching:
                found |= {
                    f"{name}{COPY}{i}": replace(self.runs[name], scaled=scale)
                    for i, scale in enumerate(scales, start=1)
                }
        return found


def _never(measured: Numbers, published: Numbers) -> bool:
    return False


def measured_values(values: Mapping[str, str], data: ClaimData) -> Measure:
    """A measure that evaluates ``values``, label -> sum or product of ``run:figure``, in the unit of the claim."""

    def factor(label: str) -> float:
        if data.factor is not None:
            return data.factor
        return FACTORS.get(data.unit if isinstance(data.unit, str) else data.unit.get(label, "1"), 1.0)

    def measure(outcomes: Outcomes) -> dict[str, float]:
        def lookup(term: str) -> float:
            run, _, figure = term.rpartition(":")
            return outcomes.number(run, figure)

        found: dict[str, float] = {}
        for label, text in values.items():
            value: Any = factor(label) * expression.evaluate(text, lookup)
            found[label] = math.fabs(value) if data.magnitude else value
        return found

    return measure
