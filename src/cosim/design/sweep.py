"""Sweeps: one system over many start values, figures of merit of every run, in a Parquet data set.

A sweep file is TOML::

    system = "fsmc_5sin.toml"          # a system file, relative to this file
    description = "Gain and mass"
    method = "grid"                    # grid, list, latin or sobol
    count = 64                         # of latin and sobol: how many runs
    seed = 1                           # of latin and sobol

    [parameters]
    "controller.lambda_" = { from = 50.0, to = 200.0, count = 4 }     # grid: equal steps, both ends included
    "plant.m" = { from = 10.0, to = 1000.0, count = 3, log = true }   # equal ratios
    "controller.friction_velocity" = ["reference", "measured"]        # these values

    [experiment]                       # optional, as in a system file: stop_time, step_size, order
    stop_time = 2.0

    [metrics]                          # optional; default: the tracking figures of every loop
    window = [1.0, 2.0]                # seconds
    peak = { of = "max_abs", signal = "controller.error" }

grid takes every combination, list the first values of all parameters, then the second ones ...; latin (Latin
hypercube) and sobol spread ``count`` points over the ranges, and over the values of a list.

Runs are numbered; the number decides the values. Batches of runs go to workers, which keep the FMUs loaded. What
comes back is written at once as one more file of the data set, complete or not at all: a sweep that was interrupted
goes on with the runs that are missing. A run that fails is recorded with its error.
"""

from __future__ import annotations

import atexit
import contextlib
import math
import os
import time as clock_time
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from ..errors import CosimError, DescriptionError
from ..master.simulation import Simulation
from ..system.system import System, make_system
from .dataset import DataSet, Row
from .plan import Metric, Point, Sweep, measure, read_sweep

BATCH_SECONDS = 1.0
"""Work in one task: long against what a task costs, short against the loss when a worker dies."""


MAX_BATCH = 500


DEATHS = 2
"""The runs of a batch whose worker died this often are tried one by one; a run that does it again has failed."""


CONNECT_SECONDS = 10.0


# Running, on whichever machine


@dataclass(frozen=True)
class Job:
    """What a worker needs to know, in plain values."""

    document: Mapping[str, Any]
    name: str
    folder: str
    fmus: str | None
    digest: str
    parameters: tuple[str, ...]
    metrics: tuple[Metric, ...]
    window: tuple[float, float]


def job_of(sweep: Sweep) -> Job:
    """The part of a sweep that workers get."""
    system = sweep.system
    fmus = None if system.fmus is None else str(Path(system.fmus).resolve())
    folder = str(Path(system.folder).resolve())
    return Job(system.document, system.name, folder, fmus, system.digest, sweep.parameters, sweep.metrics, sweep.window)


_loaded: dict[str, tuple[System, Simulation]] = {}
"""The simulation of this process, kept from batch to batch."""


def _simulation(job: Job) -> tuple[System, Simulation]:
    found = _loaded.get(job.digest)
    if found is not None:
        return found
    unload()
    system = make_system(job.document, name=job.name, folder=job.folder, fmus=job.fmus)
    if system.digest != job.digest:
        raise DescriptionError(
            f"{job.name}: this worker finds other FMUs than the sweep was started with. "
            f"Give all machines the same files below {job.folder}."
        )
    _loaded[job.digest] = system, Simulation(system).__enter__()
    return _loaded[job.digest]


def unload() -> None:
    """Free the FMUs that batches in this process have kept loaded."""
    for _, simulation in _loaded.values():
        simulation.close()
    _loaded.clear()


atexit.register(unload)


def run_batch(job: Job, numbers: Sequence[int], points: Sequence[Point]) -> list[Row]:
    """Carry out some runs in this process; a run that fails gives a row with its error.

    Raises DescriptionError if the system as such cannot be run here.
    """
    rows: list[Row] = []
    for number, point in zip(numbers, points, strict=True):
        system, simulation = _simulation(job)
        begun = clock_time.perf_counter()
        found: Mapping[str, float] = {}
        error = ""
        try:
            result = simulation.run(system.changed(dict(zip(job.parameters, point, strict=True))))
            found = measure(result, job.metrics, job.window)
        except CosimError as problem:
            error = str(problem)
            unload()  # an FMU that failed may not be what it was
        rows.append(Row(number, point, found, clock_time.perf_counter() - begun, error))
    return rows


# Scheduling


@dataclass
class Progress:
    """How far a sweep is."""

    total: int
    done: int
    """Rows in the data set, those of earlier sessions included."""
    failed: int = 0
    """Runs of this session that failed."""
    begun: float = 0.0
    before: int = 0
    """Rows that were there when this session began."""
    run_seconds: float = 0.0
    """Time spent in runs, over all workers."""

    @property
    def rate(self) -> float:
        """Runs a second in this session."""
        elapsed = clock_time.perf_counter() - self.begun
        return (self.done - self.before) / elapsed if elapsed > 0.0 else 0.0


@dataclass(frozen=True)
class Outcome:
    """What a sweep left behind."""

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


def sweep(
    path: str | Path | Sweep,
    output: str | Path | None = None,
    *,
    fmus: str | Path | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    restart: bool = False,
    progress: Callable[[Progress], None] = lambda progress: None,
) -> Outcome:
    """Carry out the runs of a sweep that its data set in ``output`` does not hold yet::

        outcome = sweep("gains.toml", "results/gains", workers=2)

    ``workers`` processes of this machine (default: its cores; 0: this process), or the cluster of the dask scheduler
    at ``scheduler``. Raises DescriptionError; FileError if the data set cannot be written; KeyboardInterrupt. What was
    written stays, and the same call goes on from there.
    """
    plan = path if isinstance(path, Sweep) else read_sweep(path, fmus=fmus)
    folder = Path(output) if output is not None else Path("results") / "sweeps" / Path(plan.name).stem
    data = DataSet(folder)
    held = data.open(plan, restart=restart)
    missing = [number for number in range(len(plan.points)) if number not in held]
    begun = clock_time.perf_counter()
    state = Progress(len(plan.points), len(held), begun=begun, before=len(held))
    used = 1

    def keep(rows: Sequence[Row]) -> None:
        data.write(plan, rows)
        state.done += len(rows)
        state.failed += sum(bool(row.error) for row in rows)
        state.run_seconds += sum(row.seconds for row in rows)
        progress(state)

    progress(state)
    if missing:
        if workers == 0 and scheduler is None:
            _here(plan, missing, keep)
        else:
            used = _on_cluster(plan, missing, keep, workers=workers, scheduler=scheduler)
    table = data.read()
    failed = (
        sum(error is not None for error in table.column("error").to_pylist()) if "error" in table.column_names else 0
    )
    elapsed = clock_time.perf_counter() - begun
    return Outcome(folder, table.num_rows, state.done - state.before, failed, elapsed, state.run_seconds, used)


class _Batches:
    """Cuts the runs into batches of about ``BATCH_SECONDS``, as measured so far."""

    def __init__(self, numbers: Sequence[int], workers: int) -> None:
        self.numbers = list(numbers)
        self.at = 0
        self.size = 1
        self.workers = workers

    def learn(self, rows: Sequence[Row]) -> None:
        mean = sum(row.seconds for row in rows) / len(rows)
        wanted = int(BATCH_SECONDS / max(mean, 1e-6))
        self.size = max(1, min(wanted, 4 * self.size + 1, MAX_BATCH))

    def next(self) -> list[int]:
        left = len(self.numbers) - self.at
        share = -(-left // (2 * self.workers))  # the last batches become smaller, so that all workers end together
        batch = self.numbers[self.at : self.at + max(1, min(self.size, share))]
        self.at += len(batch)
        return batch


def _here(plan: Sweep, missing: Sequence[int], keep: Callable[[Sequence[Row]], None]) -> None:
    job, batches = job_of(plan), _Batches(missing, 1)
    try:
        while batch := batches.next():
            rows = run_batch(job, batch, [plan.points[number] for number in batch])
            batches.learn(rows)
            keep(rows)
    finally:
        unload()


@contextlib.contextmanager
def _client(workers: int | None, scheduler: str | None) -> Generator[tuple[Any, int]]:
    """A dask client and its number of worker threads."""
    try:
        import dask as _dask
        import distributed as _distributed
    except ImportError:
        raise DescriptionError(
            "sweeps on several processes need dask.distributed: install motion-cosim[tools], or take --workers 0."
        ) from None
    dask, distributed = cast(Any, _dask), cast(Any, _distributed)
    settings = {"distributed.scheduler.allowed-failures": DEATHS - 1, "distributed.admin.tick.limit": "60s"}
    with contextlib.ExitStack() as stack:
        stack.enter_context(dask.config.set(settings))
        if scheduler is None:
            count = workers if workers is not None else os.cpu_count() or 1
            cluster = stack.enter_context(
                distributed.LocalCluster(
                    n_workers=count,
                    threads_per_worker=1,
                    processes=True,
                    dashboard_address=None,
                    silence_logs="CRITICAL",
                )
            )
            client = stack.enter_context(distributed.Client(cluster))
        else:
            try:
                client = stack.enter_context(distributed.Client(scheduler, timeout=CONNECT_SECONDS))
            except (OSError, TimeoutError, ValueError) as error:
                raise DescriptionError(f"no dask scheduler at {scheduler}: {error}") from None
            count = sum(client.nthreads().values())
            if not count:
                raise DescriptionError(f"the dask scheduler at {scheduler} has no workers. Start some: dask worker.")
        yield client, count


def _on_cluster(
    plan: Sweep,
    missing: Sequence[int],
    keep: Callable[[Sequence[Row]], None],
    *,
    workers: int | None,
    scheduler: str | None,
) -> int:
    """Runs on dask workers; each batch is kept as it comes back."""
    job = job_of(plan)
    with _client(workers, scheduler) as (client, count):
        from distributed import as_completed as _as_completed
        from distributed.scheduler import KilledWorker as _KilledWorker

        as_completed, killed = cast(Any, _as_completed), cast(Any, _KilledWorker)
        batches = _Batches(missing, count)
        sent: dict[str, Sequence[int]] = {}

        def submit(batch: Sequence[int]) -> Any:
            points = [plan.points[number] for number in batch]
            future = client.submit(run_batch, job, list(batch), points, pure=False)
            sent[future.key] = batch
            return future

        suspects: list[int] = []
        waiting = as_completed([submit(batch) for _ in range(2 * count) if (batch := batches.next())])
        for future in waiting:
            batch = sent.pop(future.key)
            try:
                rows = cast("list[Row]", future.result())
            except killed:
                suspects += batch
            else:
                batches.learn(rows)
                keep(rows)
            if following := batches.next():
                waiting.add(submit(following))
        # Which run of a batch, or of another batch waiting at the same worker, killed it? Alone it shows.
        for number in suspects:
            try:
                keep(cast("list[Row]", submit([number]).result()))
            except killed:
                text = f"the worker process died in this run, {DEATHS} times"
                keep([Row(number, plan.points[number], {}, math.nan, text)])
    return count


# Report


def report(folder: str | Path) -> Path:
    """Write ``report.md`` and its pictures into the folder of a data set: figures, best runs, heat maps, failures."""
    from .sweep_report import write_report

    return write_report(Path(folder))
