"""Studies: the runs behind a paper, what it claims, what was measured, and a verdict computed from both.

A study is a folder ``studies/NAME`` with system files and a ``study.py`` that holds ``STUDY``, a ``Study``: its runs
(name -> system file and changed values), its claims (a text, the published figure, a function measuring it in the
runs, the rules that earn each verdict) and its pictures. ``cosim study NAME`` runs it and writes the report.

A verdict is never written down: a claim gets the first status whose rule its measured values keep, and
"not reproduced" if they keep none.
"""

from __future__ import annotations

import fnmatch
import importlib.util
import math
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field, replace
from itertools import pairwise
from multiprocessing import get_context
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

import numpy as np

from .errors import CosimError, DescriptionError, SimulationError, suggest
from .fmu.places import study_folders
from .master.simulation import simulate
from .result.result import Result
from .result.summary import tracking
from .system.system import read_system

Status = Literal["reproduced", "fitted", "order only", "not reproduced", "not checkable", "not run"]
"""``fitted``: it holds with values chosen to make it hold. ``order only``: the figure differs, the order of the
compared things does not. ``not checkable``: nothing was published, or a run it needs has failed. ``not run``: a run
it needs was left out."""

Value = float | int | bool | str
Numbers = Mapping[str, float]
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


# Rules


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


# Finding and running


def known_studies() -> dict[str, Path]:
    """Every study found: name -> folder."""
    found: dict[str, Path] = {}
    for place in study_folders():
        for path in sorted(place.glob("*/study.py")):
            found.setdefault(path.parent.name, path.parent)
    return found


def find_study(name: str) -> Path:
    """The folder of the study ``name``, which may also be a path to it. Raises DescriptionError."""
    known = known_studies()
    if name in known:
        return known[name]
    if (Path(name) / "study.py").is_file():
        return Path(name).resolve()
    raise DescriptionError(f"no study '{name}'.{suggest(name, known)}")


def load_study(folder: Path) -> Study:
    """The ``STUDY`` of ``folder/study.py``. Raises DescriptionError if there is none."""
    path = folder / "study.py"
    module_name = f"cosim_study_{folder.name}"
    spec = importlib.util.spec_from_file_location(module_name, path)
    if spec is None or spec.loader is None or not path.is_file():
        raise DescriptionError(f"{path}: no such file.")
    module = importlib.util.module_from_spec(spec)
    sys.modules[module_name] = module
    spec.loader.exec_module(module)
    study = getattr(module, "STUDY", None)
    if not isinstance(study, Study):
        raise DescriptionError(f"{path}: STUDY is not a cosim.study.Study. Define STUDY = Study(...).")
    return study


def measure_run(name: str, run: Run, result: Result) -> Outcome:
    """The outcome of a run from its full record."""
    numbers = dict(tracking(result, run.window))
    if run.measure is not None:
        numbers.update(run.measure(result, run.window))
    for instance, counters in result.solver.items():
        numbers.update({f"{instance}.{counter}": value for counter, value in counters.items()})
    kept = slice(None, None, run.keep_every)
    thinned = replace(result, time=result.time[kept].copy(), rows=result.rows[kept].copy())
    return Outcome(name, run, numbers, thinned, int(result.metadata["steps"]))


def run_one(folder: Path, name: str, run: Run, fmus: Path | None = None) -> Outcome:
    """Carry out one run of the study in ``folder``; what stops it becomes the outcome's failure."""
    steps = 0
    try:
        system = read_system(folder / run.system, run.overrides, fmus=fmus, stop_time=run.stop_time)
        steps = system.steps
        return measure_run(name, run, simulate(system))
    except CosimError as error:
        return Outcome(name, run, NONE, None, steps, str(error))


def _run_in_process(folder: Path, name: str, fmus: Path | None) -> tuple[str, Numbers, Result | None, int, str]:
    """What ``run_one`` gives without the run, whose functions do not travel between processes."""
    outcome = run_one(folder, name, load_study(folder).runs[name], fmus)
    return name, dict(outcome.numbers), outcome.result, outcome.steps, outcome.failure


def matching_runs(study: Study, pattern: str) -> list[str]:
    """The runs whose names match ``pattern`` (``*`` and ``?``). Raises DescriptionError if there is none."""
    names = [name for name in study.runs if fnmatch.fnmatchcase(name, pattern)]
    if not names:
        raise DescriptionError(f"no run matches '{pattern}'.{suggest(pattern, study.runs)}")
    return names


def run_study(
    folder: Path,
    *,
    pattern: str = "*",
    jobs: int = 1,
    fmus: Path | None = None,
    progress: Callable[[Outcome], None] = lambda outcome: None,
) -> Outcomes:
    """Carry out the runs of the study in ``folder`` whose names match ``pattern``, ``jobs`` at a time.

    The outcomes do not depend on ``jobs``; ``progress`` is told of each as it ends.
    Raises DescriptionError if no run matches, SimulationError if a run takes its process down.
    """
    study = load_study(folder)
    names = matching_runs(study, pattern)
    done: dict[str, Outcome] = {}
    if jobs <= 1 or len(names) == 1:
        for name in names:
            done[name] = run_one(folder, name, study.runs[name], fmus)
            progress(done[name])
    else:
        pool = ProcessPoolExecutor(min(jobs, len(names)), mp_context=get_context("spawn"))
        try:
            for future in as_completed([pool.submit(_run_in_process, folder, name, fmus) for name in names]):
                name, numbers, result, steps, failure = future.result()
                done[name] = Outcome(name, study.runs[name], numbers, result, steps, failure)
                progress(done[name])
        except BrokenExecutor:
            left = ", ".join(name for name in names if name not in done)
            raise SimulationError(
                f"a process died in one of the runs {left}. Give jobs = 1 to see which run it is."
            ) from None
        finally:
            pool.shutdown(cancel_futures=True)
    return Outcomes([done[name] for name in names])


def main(name: str, output: Path | None = None, *, runs: str = "*", jobs: int = 1, fmus: Path | None = None) -> int:
    """``cosim study``: run a study, write its report into ``output`` (results/NAME), show the verdicts.

    Returns 0, or 1 if a run failed; a claim that does not hold is a finding, not a failure.
    """
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
    from rich.table import Table

    from .report import STYLES, counts, values, write_report

    folder = find_study(name)
    study = load_study(folder)
    console, errors = Console(highlight=False), Console(stderr=True, highlight=False)
    if not console.is_terminal:
        console.width = max(console.width, 160)
    columns = BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("{task.description}")
    with Progress(*columns, console=errors, transient=True) as bar:
        names = matching_runs(study, runs)
        task = bar.add_task("", total=len(names))
        outcomes = run_study(
            folder,
            pattern=runs,
            jobs=jobs,
            fmus=fmus,
            progress=lambda outcome: bar.update(task, advance=1, description=escape(outcome.name)),
        )
    verdicts = [judge(claim, outcomes) for claim in study.claims]
    report = write_report(output or Path("results") / folder.name, folder.name, study, outcomes, verdicts)
    table = Table(title=escape(study.title), title_justify="left", box=SIMPLE_HEAD)
    for heading in ("", "Claim", "Measured", "Verdict"):
        table.add_column(heading)
    for verdict in verdicts:
        claim = verdict.claim
        measured = values(verdict.measured, claim.unit) or verdict.reason
        style = STYLES[verdict.status]
        table.add_row(claim.id, escape(claim.text), escape(measured), f"[{style}]{verdict.status}[/]")
    console.print(table)
    console.print(", ".join(f"{count} {status}" for status, count in counts(verdicts).items()))
    console.print(f"Written: {escape(str(report))}")
    failed = [outcome for outcome in outcomes.all() if outcome.failure]
    for outcome in failed:
        errors.print(f"[bold red]error:[/] run {escape(outcome.name)}: {escape(outcome.failure)}", soft_wrap=True)
    return 1 if failed else 0
