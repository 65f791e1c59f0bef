"""Sweeps: one system over many start values, figures of merit of every run, in a Parquet data set.

A sweep file is TOML::

    system = "fsmc_5sin.toml"          # a system file, relative to this file
    description = "Gain and mass"
    method = "grid"                    # grid, list, latin or sobol
    count = 64                         # of latin and sobol: how many runs
    seed = 1                           # of latin and sobol
    timeout = 60.0                     # s, limit for a run; default: 20 times the longest run so far, at least 10 s

    [parameters]
    "controller.lambda_" = { from = 50.0, to = 200.0, count = 4 }     # grid: equal steps, both ends included
    "plant.m" = { from = 10.0, to = 1000.0, count = 3, log = true }   # equal ratios
    "controller.friction_velocity" = ["reference", "measured"]        # these values

    [experiment]                       # optional, as in a system file: stop_time, step_size, order
    stop_time = 2.0

    [metrics]                          # optional; default: the tracking figures of every loop
    window = [1.0, 2.0]                # seconds
    peak = { of = "max_abs", signal = "controller.error" }

The method grid takes every combination of values. The method list takes the first values of all parameters, then the
second ones, and so on. The methods latin (Latin hypercube) and sobol spread ``count`` points over the ranges, and over
the values of a list.

Runs are numbered, and the number of a run determines its values. Batches of runs go to workers, which keep the FMUs
loaded. The rows of a finished batch are written at once as a new file of the data set, completely or not at all.
So an interrupted sweep goes on with the missing runs. A run that fails, crashes its process or takes too long is
recorded with its reason and not repeated.
"""

from __future__ import annotations

import math
import time as clock_time
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass
from pathlib import Path

from ..extras import require
from ..public import public_names
from .batch import Job, run_batch
from .crew import BatchLost, Cluster, Crew, Threads
from .dataset import DATA_SET, DataSet, RunRow
from .plan import Sweep, read_sweep
from .workers import Limit, check_workers, unload

__dir__ = public_names(globals(), "Sweep", "read_sweep")

BATCH_SECONDS = 1.0
"""Time of the runs in one batch: long compared with the overhead of a batch, but short enough to lose little work when
a sweep is interrupted."""

MAX_BATCH = 500
"""Largest number of runs in a batch, however short they are: progress is reported and kept batch by batch."""

DEATHS = 2
"""A run has failed if this many workers of a cluster died during it."""

WATCH_SECONDS = 1.0
"""Time between two checks that the workers are still there."""


@dataclass
class SweepProgress:
    """The progress of a sweep."""

    total: int
    done: int
    """Number of rows in the data set, including those of earlier sessions."""
    failed: int = 0
    """Number of failed runs in this session."""
    begun: float = 0.0
    before: int = 0
    """Number of rows in the data set when this session began."""
    run_seconds: float = 0.0
    """Total time of the runs in s, summed over the workers."""

    @property
    def rate(self) -> float:
        """Runs per second in this session."""
        elapsed = clock_time.perf_counter() - self.begun
        return (self.done - self.before) / elapsed if elapsed > 0.0 else 0.0


@dataclass(frozen=True)
class SweepEnd:
    """The result of a sweep."""

    folder: Path
    runs: int
    """Rows in the data set."""
    new: int
    """Rows written in this session."""
    failed: int
    """Runs of the data set that failed."""
    elapsed: float
    run_seconds: float
    workers: int
    notes: tuple[str, ...] = ()
    """Damages found in the data set, one sentence each."""


def sweep(
    path: str | Path | Sweep,
    output: str | Path | None = None,
    *,
    fmus: str | Path | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    restart: bool = False,
    progress: Callable[[SweepProgress], None] = lambda progress: None,
) -> SweepEnd:
    """Carry out the runs of a sweep that its data set in ``output`` does not hold yet::

        outcome = sweep("gains.toml", "results/gains", workers=2)

    The runs are done by ``workers`` processes of this machine (default: one for each core), or by the cluster of the
    dask scheduler at ``scheduler``. With ``workers=0`` the runs are done in this process, so an FMU that crashes or
    hangs stops it. Raises DescriptionError for a wrong file, FileError if the data set cannot be written, LoadError if
    the FMUs cannot be loaded, ClusterError if the cluster is lost, KeyboardInterrupt. Rows written so far are kept, and
    the same call continues from them.
    """
    if workers is not None:
        check_workers(workers, least=0)
    plan = path if isinstance(path, Sweep) else read_sweep(path, fmus=fmus)
    require("pyarrow", DATA_SET)
    folder = Path(output) if output is not None else Path("results") / "sweeps" / Path(plan.name).stem
    data = DataSet(folder)
    with data.locked():
        held = data.open(plan, restart=restart)
        missing = [number for number in range(len(plan.points)) if number not in held]
        begun = clock_time.perf_counter()
        state = SweepProgress(len(plan.points), len(held), begun=begun, before=len(held))
        used = 1

        def keep(rows: Sequence[RunRow]) -> None:
            data.write(plan, rows)
            state.done += len(rows)
            state.failed += sum(bool(row.error) for row in rows)
            state.run_seconds += sum(row.seconds for row in rows if math.isfinite(row.seconds))
            progress(state)

        progress(state)
        if missing and workers == 0 and scheduler is None:
            _run_here(plan, missing, keep)
        elif missing:
            with Threads(workers) if scheduler is None else Cluster(scheduler) as crew:
                used = crew.count
                _run_elsewhere(plan, missing, keep, crew)
        table = data.read()
    errors: list[str | None] = table.column("error").to_pylist() if "error" in table.column_names else []
    return SweepEnd(
        folder,
        table.num_rows,
        state.done - state.before,
        sum(error is not None for error in errors),
        clock_time.perf_counter() - begun,
        state.run_seconds,
        used,
        tuple(data.notes),
    )


class _Batches:
    """Divides the runs into batches of about ``BATCH_SECONDS``, from the times of the runs so far."""

    def __init__(self, numbers: Sequence[int], workers: int) -> None:
        self.numbers = list(numbers)
        self.at = 0
        self.size = 1
        self.workers = workers

    def learn(self, rows: Sequence[RunRow]) -> None:
        mean = sum(row.seconds for row in rows) / len(rows)
        wanted = int(BATCH_SECONDS / max(mean, 1e-6))
        self.size = max(1, min(wanted, 4 * self.size + 1, MAX_BATCH))

    def next(self) -> list[int]:
        left = len(self.numbers) - self.at
        share = -(-left // (2 * self.workers))  # the last batches become smaller, so that all workers end together
        batch = self.numbers[self.at : self.at + max(1, min(self.size, share))]
        self.at += len(batch)
        return batch


def _run_here(plan: Sweep, missing: Sequence[int], keep: Callable[[Sequence[RunRow]], None]) -> None:
    job, batches = Job.of(plan), _Batches(missing, 1)
    try:
        while batch := batches.next():
            rows = run_batch(job, batch, [plan.points[number] for number in batch])
            batches.learn(rows)
            keep(rows)
    finally:
        unload()


def _run_elsewhere(plan: Sweep, missing: Sequence[int], keep: Callable[[Sequence[RunRow]], None], crew: Crew) -> None:
    """Let the workers of ``crew`` do the runs; the rows of each batch are kept as it returns."""
    job, batches, limit = Job.of(plan), _Batches(missing, crew.count), Limit(plan.timeout)
    pending: dict[Future[list[RunRow]], Sequence[int]] = {}
    # Runs of a batch whose worker died are repeated one by one, to find the run that was the cause.
    alone: deque[list[int]] = deque()
    deaths: dict[int, int] = {}
    while True:
        while len(pending) < 2 * crew.count and (batch := alone.popleft() if alone else batches.next()):
            pending[crew.submit(job, batch, [plan.points[number] for number in batch], limit)] = batch
        if not pending:
            return
        done, _ = wait(pending, timeout=WATCH_SECONDS, return_when=FIRST_COMPLETED)
        for future in done:
            batch = pending.pop(future)
            try:
                rows = crew.rows(future)
            except BatchLost as lost:
                for number in batch:
                    deaths[number] = deaths.get(number, 0) + (len(batch) == 1)
                    if deaths[number] < DEATHS:
                        alone.append([number])
                    else:
                        keep([RunRow(number, plan.points[number], {}, math.nan, str(lost))])
            else:
                batches.learn(rows)
                keep(rows)
        crew.check()


# Report


def report(folder: str | Path) -> Path:
    """Write ``report.md`` and its pictures into the folder of a data set: figures, best runs, heat maps, failures."""
    from .sweep_report import read_runs, write_report

    return write_report(read_runs(Path(folder)))
