"""The crew that carries out the runs of a sweep: workers of this machine, or the cluster of a dask scheduler."""

from __future__ import annotations

import atexit
import contextlib
import logging
import math
import os
import time as clock_time
from collections.abc import Sequence
from concurrent.futures import CancelledError, Future
from typing import Protocol, Self, cast

from ..errors import CosimError, DescriptionError
from ..extras import import_extra
from .batch import Job, run_batch
from .dataset import RunRow
from .plan import Point
from .workers import Limit, Pool, Workers

CONNECT_SECONDS = 10.0
"""Longest time in which a scheduler must answer, at the start and after the connection was lost."""

ABSENT_SECONDS = 60.0
"""Longest time that a cluster may be without workers: workers that died may start again, which takes seconds."""


class ClusterError(CosimError):
    """The scheduler or all workers of a cluster are gone."""


class BatchLost(CosimError):
    """A batch did not come back because its worker died."""


class Crew(Protocol):
    """Takes batches of runs."""

    count: int
    """Number of batches that run at the same time."""

    def submit(self, job: Job, batch: Sequence[int], points: Sequence[Point], limit: Limit) -> Future[list[RunRow]]:
        """Start a batch; ``limit`` is the time limit of a run."""
        ...

    def rows(self, future: Future[list[RunRow]]) -> list[RunRow]:
        """The rows of a finished batch. Raises BatchLost, or the error that the batch raised."""
        ...

    def check(self) -> None:
        """Raise ClusterError if no worker is left for the batches."""
        ...


class Threads:
    """Threads of this process, each with a worker; a context manager."""

    def __init__(self, count: int | None = None) -> None:
        self.count = count if count is not None else os.cpu_count() or 1
        self._pool = Pool(self.count)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._pool.stop()

    def submit(self, job: Job, batch: Sequence[int], points: Sequence[Point], limit: Limit) -> Future[list[RunRow]]:
        """Have a batch done."""
        return self._pool.submit(lambda worker: run_batch(job, batch, points, worker, limit))

    def rows(self, future: Future[list[RunRow]]) -> list[RunRow]:
        """What came back."""
        return future.result()

    def check(self) -> None:
        """Threads do not die."""


class Cluster:
    """The workers of a dask scheduler; a context manager. Raises DescriptionError if it does not answer."""

    def __init__(self, address: str) -> None:
        distributed = import_extra("distributed", "a scheduler")
        self.address = address
        self.count = 0
        try:
            self._client = distributed.Client(address, timeout=CONNECT_SECONDS, set_as_default=False)
        except (OSError, TimeoutError, ValueError) as error:
            raise DescriptionError(f"no dask scheduler at {address}: {error}") from None
        self._executor = self._client.get_executor(pure=False)
        self._seen = clock_time.monotonic()
        self._levels = {logger: logger.level for logger in _loggers()}
        for logger in self._levels:
            # The loss of the scheduler is reported in one sentence; dask would log tracebacks.
            logger.setLevel(logging.CRITICAL)

    def __enter__(self) -> Self:
        self.count = sum(self._client.nthreads().values())
        if not self.count:
            self.__exit__()
            raise DescriptionError(f"the dask scheduler at {self.address} has no workers. Start some: dask worker.")
        return self

    def __exit__(self, *error: object) -> None:
        with contextlib.suppress(Exception):
            # A scheduler that is gone does not answer.
            self._client.close(timeout=CONNECT_SECONDS)
        for logger, level in self._levels.items():
            logger.setLevel(level)

    def submit(self, job: Job, batch: Sequence[int], points: Sequence[Point], limit: Limit) -> Future[list[RunRow]]:
        """Have a batch done."""
        try:
            return self._executor.submit(cluster_batch, job, list(batch), list(points), limit.longest)
        except Exception as error:
            raise self._gone() from error

    def rows(self, future: Future[list[RunRow]]) -> list[RunRow]:
        """What came back."""
        from distributed.scheduler import KilledWorker as _KilledWorker

        killed = cast("type[Exception]", _KilledWorker)
        try:
            return future.result()
        except killed as error:
            raise BatchLost(f"the worker of the cluster died in this run: {error}") from None
        except CancelledError:
            raise self._gone() from None

    def check(self) -> None:
        """Whether the scheduler answers and has workers."""
        now = clock_time.monotonic()
        if self._client.status == "running" and self._client.scheduler_info().get("workers"):
            self._seen = now
        patience = ABSENT_SECONDS if self._client.status == "running" else CONNECT_SECONDS
        if now - self._seen > patience:
            raise self._gone()

    def _gone(self) -> ClusterError:
        what = "has no workers any more" if self._client.status == "running" else "is gone"
        return ClusterError(
            f"the dask scheduler at {self.address} {what}. What was written is kept; the same command goes on."
        )


def _loggers() -> list[logging.Logger]:
    """The loggers of dask.distributed."""
    names = [name for name in logging.root.manager.loggerDict if name.split(".")[0] == "distributed"]
    return [logging.getLogger(name) for name in names]


_limits: dict[str, Limit] = {}
_workers = Workers()
"""Limits and workers of this process of a cluster."""
atexit.register(_workers.stop)


def cluster_batch(job: Job, batch: Sequence[int], points: Sequence[Point], longest: float) -> list[RunRow]:
    """Carry out a batch in a process of a cluster; ``longest`` is the longest time of a run so far in s, or NaN."""
    limit = _limits.setdefault(job.system.digest, Limit(job.timeout))
    limit.given = job.timeout
    if not math.isnan(longest):
        limit.learn(longest)
    return run_batch(job, batch, points, _workers.mine(), limit)
