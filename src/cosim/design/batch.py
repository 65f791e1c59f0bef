"""A batch of runs of a sweep, carried out in this process or by a worker."""

from __future__ import annotations

import time as clock_time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

from ..errors import CosimError
from ..master.failure import ProcessError
from ..result.result import Result
from . import workers as work
from .dataset import RunRow
from .plan import Metric, Point, Sweep, measure
from .workers import Limit, Loadable, LoadError, Worker


@dataclass(frozen=True)
class Job:
    """The data that another process needs for runs of a sweep, in plain values."""

    system: Loadable
    parameters: tuple[str, ...]
    metrics: tuple[Metric, ...]
    window: tuple[float, float]
    timeout: float | None = None

    @classmethod
    def of(cls, sweep: Sweep) -> Job:
        """The job of a sweep: the part of it that workers get."""
        return cls(Loadable.of(sweep.system), sweep.parameters, sweep.metrics, sweep.window, sweep.timeout)

    @property
    def judge(self) -> Callable[[Result], dict[str, float]]:
        """The function that computes the figures of a run."""
        return partial(measure, wanted=self.metrics, window=self.window)


def run_batch(
    job: Job, numbers: Sequence[int], points: Sequence[Point], worker: Worker | None = None, limit: Limit | None = None
) -> list[RunRow]:
    """Carry out some runs, in this process or by ``worker``. A run that fails gives a row with its error.

    ``limit`` learns how long runs take. Raises DescriptionError or LoadError if no run of the system is possible here.
    """
    limit = limit if limit is not None else Limit(job.timeout)
    rows: list[RunRow] = []
    for number, point in zip(numbers, points, strict=True):
        values = dict(zip(job.parameters, point, strict=True))
        found: Mapping[str, float] = {}
        error, ended = "", True
        if worker is None:
            work.load(job.system)
        begun = clock_time.perf_counter()
        try:
            if worker is None:
                found = work.evaluate(job.system, values, job.judge)
            else:
                found = worker.evaluate(job.system, values, job.judge, limit)
        except LoadError:
            raise
        except CosimError as problem:
            error, ended = str(problem), not isinstance(problem, ProcessError)
        seconds = clock_time.perf_counter() - begun if worker is None else worker.seconds
        if ended:
            limit.learn(seconds)
        rows.append(RunRow(number, point, found, seconds, error))
    return rows
