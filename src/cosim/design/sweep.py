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
import hashlib
import itertools
import json
import math
import os
import time as clock_time
import tomllib
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Any, cast

import numpy as np

from .. import metrics as figures
from ..errors import CosimError, DescriptionError, suggest
from ..fmu import Variable
from ..master import Simulation
from ..results import Result
from ..study import tracking
from ..system import System, make_system, read_system, shipped_file, start_value

METHODS = ("grid", "list", "latin", "sobol")
BATCH_SECONDS = 1.0
"""Work in one task: long against what a task costs, short against the loss when a worker dies."""
MAX_BATCH = 500
DEATHS = 2
"""The runs of a batch whose worker died this often are tried one by one; a run that does it again has failed."""
CONNECT_SECONDS = 10.0
TEMPORARY = ".part"

Value = float | str | bool
Point = tuple[Value, ...]


@dataclass(frozen=True)
class Metric:
    """A figure of one signal."""

    name: str
    of: str
    signal: str


FUNCTIONS: Mapping[str, Callable[[figures.Array, figures.Array], float]] = {
    "max_abs": lambda time, signal: figures.max_abs(signal),
    "rms": lambda time, signal: figures.rms(signal),
    "std": lambda time, signal: figures.std(signal),
    "mean": lambda time, signal: float(np.mean(signal)),
    "min": lambda time, signal: float(np.min(signal)),
    "max": lambda time, signal: float(np.max(signal)),
    "last": lambda time, signal: float(signal[-1]),
    "peak_to_peak": lambda time, signal: float(np.ptp(signal)),
    "total_variation": figures.total_variation,
}
"""What a metric may be ``of``."""


def measure(result: Result, wanted: Sequence[Metric], window: tuple[float, float]) -> dict[str, float]:
    """The figures of a run; those of ``cosim.study.tracking`` if none are named."""
    if not wanted:
        return tracking(result, window)
    part = figures.window(result.time, *window)
    time = result.time[part]
    return {metric.name: FUNCTIONS[metric.of](time, result[metric.signal][part]) for metric in wanted}


@dataclass(frozen=True)
class Sweep:
    """A checked sweep: the system and the value of every parameter in every run."""

    name: str
    description: str
    system: System
    method: str
    parameters: tuple[str, ...]
    points: tuple[Point, ...]
    metrics: tuple[Metric, ...]
    window: tuple[float, float]

    @property
    def digest(self) -> str:
        """SHA-256 of everything that decides the results."""
        content = [self.system.digest, self.parameters, self.points, [vars(m) for m in self.metrics], self.window]
        return hashlib.sha256(json.dumps(content).encode()).hexdigest()


# The sweep file


def read_sweep(path: str | Path, *, fmus: str | Path | None = None) -> Sweep:
    """Read and check a sweep file. Raises DescriptionError with every problem found."""
    path = shipped_file(path)
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8"), parse_float=Decimal)
    except FileNotFoundError:
        raise DescriptionError(f"{path}: no such file.") from None
    except (OSError, UnicodeDecodeError) as error:
        raise DescriptionError(f"{path}: cannot be read ({error}).") from None
    except tomllib.TOMLDecodeError as error:
        raise DescriptionError(f"{path.name}: not valid TOML: {error}.") from None
    return make_sweep(document, name=path.name, folder=path.parent, fmus=fmus)


def make_sweep(
    document: Mapping[str, Any], *, name: str = "sweep", folder: str | Path = ".", fmus: str | Path | None = None
) -> Sweep:
    """Check a sweep given as nested tables, as a sweep file holds them."""
    known = ("system", "description", "method", "count", "seed", "parameters", "experiment", "metrics")
    problems = [f"{name}: {key}: unknown key.{suggest(key, known)}" for key in document if key not in known]
    if not isinstance(document.get("system"), str):
        raise DescriptionError([*problems, f'{name}: system: missing. Name a system file: system = "loop.toml".'])
    experiment = dict(document.get("experiment", {}))
    wrong = [key for key in experiment if key not in ("stop_time", "step_size", "order")]
    problems += [f"{name}: experiment.{key}: unknown key. Known: stop_time, step_size, order." for key in wrong]
    if wrong:
        raise DescriptionError(problems)
    system = read_system(Path(folder) / document["system"], fmus=fmus, **experiment)
    parameters: dict[str, Any] = dict(document.get("parameters", {}))
    if not parameters:
        problems.append(f'{name}: parameters: none given. Write "plant.m" = [60.0, 70.0].')
    method = document.get("method", "grid")
    if method not in METHODS:
        raise DescriptionError([*problems, f"{name}: method: '{method}' is none.{suggest(str(method), METHODS)}"])
    points: tuple[Point, ...] = ()
    try:
        variables = {path: _swept(system, path) for path in parameters}
        points = _points(method, parameters, variables, document.get("count"), document.get("seed", 1))
    except DescriptionError as error:
        problems += [f"{name}: {problem}" for problem in error.problems]
    wanted, window, found = _metrics(document.get("metrics", {}), system)
    problems += [f"{name}: metrics{problem}" for problem in found]
    if problems:
        raise DescriptionError(problems)
    needed = dict.fromkeys([*(".".join(end) for end in system.record), *(metric.signal for metric in wanted)])
    system = system.changed(record=list(needed))
    text = str(document.get("description", ""))
    return Sweep(name, text, system, method, tuple(parameters), points, wanted, window)


def _swept(system: System, path: str) -> Variable:
    instance, _, variable = path.partition(".")
    found = system.variable(instance, variable)
    if not found.settable:
        raise DescriptionError(f"parameters.{path}: a {found.variability} {found.causality} cannot be set.")
    return found


def _points(
    method: str, parameters: Mapping[str, Any], variables: Mapping[str, Variable], count: object, seed: object
) -> tuple[Point, ...]:
    """The values of each run, checked against type and bounds."""
    if method in ("grid", "list"):
        axes = [_axis(path, given) for path, given in parameters.items()]
        if method == "grid":
            rows = list(itertools.product(*axes))
        else:
            lengths = {path: len(axis) for path, axis in zip(parameters, axes, strict=True)}
            if len(set(lengths.values())) > 1:
                raise DescriptionError(f"parameters: a list takes equally many values of each, not {lengths}.")
            rows = list(zip(*axes, strict=True))
    else:
        if not isinstance(count, int) or isinstance(count, bool) or count < 1:
            raise DescriptionError(f"count: {count} is not a number of runs. Give a whole number of at least 1.")
        if not isinstance(seed, int) or isinstance(seed, bool):
            raise DescriptionError(f"seed: {seed} is not a whole number.")
        shares = _shares(method, len(parameters), count, seed)
        columns = [_spread(path, given, shares[:, i]) for i, (path, given) in enumerate(parameters.items())]
        rows = list(zip(*columns, strict=True))
    if not rows:
        raise DescriptionError("parameters: no run comes out of these values.")
    problems: dict[str, None] = {}
    for row in rows:
        for (path, variable), value in zip(variables.items(), row, strict=True):
            problem = start_value(variable, value)[1]
            if problem:
                problems[f"parameters.{path}: {problem}"] = None
    if problems:
        raise DescriptionError(list(problems)[:10])
    return tuple(rows)


def _plain(value: object) -> Value:
    return value if isinstance(value, bool | str) else float(cast(Any, value))


@dataclass(frozen=True)
class Range:
    """Values between two ends, in equal steps or equal ratios."""

    low: float
    high: float
    log: bool = False

    def at(self, share: float) -> float:
        """The value at a share of the way, 0 ... 1."""
        if self.log:
            return self.low * (self.high / self.low) ** share
        return self.low + (self.high - self.low) * share


def read_range(path: str, given: Mapping[str, Any]) -> Range:
    """The range of a parameter given as a table with from, to and log."""
    unknown = [key for key in given if key not in ("from", "to", "count", "log")]
    try:
        low, high = float(given["from"]), float(given["to"])
    except (KeyError, TypeError, ValueError):
        raise DescriptionError(f"parameters.{path}: write {{ from = 1.0, to = 2.0, count = 5 }}.") from None
    log = bool(given.get("log", False))
    if unknown:
        raise DescriptionError(f"parameters.{path}.{unknown[0]}: unknown key. Known: from, to, count, log.")
    if log and not (low > 0.0 and high > 0.0):
        raise DescriptionError(f"parameters.{path}: log needs positive ends, not {low:g} and {high:g}.")
    return Range(low, high, log)


def _axis(path: str, given: Any) -> list[Value]:
    """The values of a parameter of a grid or list."""
    if not isinstance(given, Mapping):
        return _values(path, given)
    table = cast("Mapping[str, Any]", given)
    ends = read_range(path, table)
    count = table.get("count")
    if not isinstance(count, int) or isinstance(count, bool) or count < 1:
        raise DescriptionError(f"parameters.{path}.count: give how many values, at least 1.")
    spaced = (np.geomspace if ends.log else np.linspace)(ends.low, ends.high, count)
    return [float(value) for value in spaced]


def _values(path: str, given: Any) -> list[Value]:
    if not isinstance(given, Sequence) or isinstance(given, str) or not given:
        raise DescriptionError(f"parameters.{path}: give a list of values or {{ from = ..., to = ... }}.")
    return [_plain(value) for value in cast("Sequence[object]", given)]


def _shares(method: str, dimensions: int, count: int, seed: int) -> figures.Array:
    """``count`` points of the unit cube."""
    import warnings

    from scipy.stats import qmc as _qmc

    qmc: Any = _qmc
    engine = qmc.LatinHypercube(d=dimensions, rng=seed) if method == "latin" else qmc.Sobol(d=dimensions, rng=seed)
    with warnings.catch_warnings():
        # Sobol points of another number than a power of two are less balanced; the user chose the number.
        warnings.simplefilter("ignore", UserWarning)
        return cast(figures.Array, engine.random(count))


def _spread(path: str, given: Any, shares: figures.Array) -> list[Value]:
    """Shares of the unit interval as values of a parameter."""
    if isinstance(given, Mapping):
        ends = read_range(path, cast("Mapping[str, Any]", given))
        return [ends.at(float(share)) for share in shares]
    values = _values(path, given)
    return [values[min(int(share * len(values)), len(values) - 1)] for share in shares]


def _metrics(given: Any, system: System) -> tuple[tuple[Metric, ...], tuple[float, float], list[str]]:
    """Metrics, window and problems."""
    if not isinstance(given, Mapping):
        return (), (-math.inf, math.inf), [": must be a table: write [metrics]."]
    wanted: list[Metric] = []
    window = (-math.inf, math.inf)
    problems: list[str] = []
    for name, item in cast("Mapping[str, Any]", given).items():
        if name == "window":
            try:
                begin, end = (float(value) for value in item)
                window = begin, end
            except (TypeError, ValueError):
                problems.append(".window: give begin and end in seconds, such as [1.0, 2.0].")
            continue
        table = cast("Mapping[str, Any]", item if isinstance(item, Mapping) else {})
        of, signal = table.get("of"), table.get("signal")
        if not isinstance(of, str) or not isinstance(signal, str):
            problems.append(f'.{name}: write {{ of = "rms", signal = "controller.error" }}.')
        elif of not in FUNCTIONS:
            problems.append(f".{name}.of: '{of}' is no figure.{suggest(of, FUNCTIONS)}")
        else:
            try:
                system.variable(*signal.split(".", 1)) if "." in signal else system.instance(signal)
                wanted.append(Metric(name, of, signal))
            except DescriptionError as error:
                problems += [f".{name}.signal: {problem}" for problem in error.problems]
    return tuple(wanted), window, problems


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


@dataclass(frozen=True)
class Row:
    """One run as it is recorded."""

    run: int
    values: Point
    figures: Mapping[str, float]
    seconds: float
    error: str = ""


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


# The data set


class DataSet:
    """A folder of Parquet files that together hold the rows of a sweep, and a description of it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.runs = folder / "runs"

    def open(self, sweep: Sweep, *, restart: bool = False) -> set[int]:
        """Make or take up the data set of ``sweep``; the numbers of the runs it holds.

        Raises DescriptionError if the folder holds another sweep.
        """
        about = self.folder / "sweep.json"
        if about.is_file():
            held = json.loads(about.read_text(encoding="utf-8")).get("digest")
            if restart:
                for path in self.runs.glob("*"):
                    path.unlink()
            elif held != sweep.digest:
                raise DescriptionError(
                    f"{self.folder} holds another sweep, or one with other FMUs. Name another folder with --output, "
                    "or start anew with --restart."
                )
        elif self.folder.is_dir() and any(self.folder.iterdir()):
            raise DescriptionError(f"{self.folder} is not empty and holds no sweep. Name another folder.")
        self.runs.mkdir(parents=True, exist_ok=True)
        for path in self.runs.glob(f"*{TEMPORARY}"):
            path.unlink()
        content = {
            "digest": sweep.digest,
            "name": sweep.name,
            "description": sweep.description,
            "system": sweep.system.name,
            "system_hash": sweep.system.digest,
            "method": sweep.method,
            "parameters": list(sweep.parameters),
            "units": {path: sweep.system.variable(*path.split(".", 1)).unit or "1" for path in sweep.parameters},
            "runs": len(sweep.points),
        }
        _write(about, json.dumps(content, indent=2).encode())
        return set(self.read().column("run").to_pylist())

    def write(self, sweep: Sweep, rows: Sequence[Row]) -> None:
        """Add a file with ``rows``, complete or not at all. Raises OSError."""
        import pyarrow
        from pyarrow import parquet as _parquet

        arrow, parquet = cast(Any, pyarrow), cast(Any, _parquet)
        names = list(dict.fromkeys(name for row in rows for name in row.figures))
        columns: dict[str, Any] = {"run": arrow.array([row.run for row in rows], arrow.int64())}
        for i, path in enumerate(sweep.parameters):
            kind = arrow.float64() if isinstance(sweep.points[0][i], float) else None
            columns[path] = arrow.array([row.values[i] for row in rows], kind)
        for name in names:
            columns[name] = arrow.array([row.figures.get(name) for row in rows], arrow.float64())
        columns["seconds"] = arrow.array([row.seconds for row in rows], arrow.float64())
        columns["error"] = arrow.array([row.error or None for row in rows], arrow.string())
        buffer = arrow.BufferOutputStream()
        parquet.write_table(arrow.table(columns), buffer)
        _write(self.runs / f"{min(row.run for row in rows):08d}.parquet", buffer.getvalue())

    def read(self) -> Any:
        """All rows as one pyarrow table, in the order of the runs."""
        import pyarrow
        from pyarrow import parquet as _parquet

        arrow, parquet = cast(Any, pyarrow), cast(Any, _parquet)
        tables = [parquet.read_table(path) for path in sorted(self.runs.glob("*.parquet"))]
        if not tables:
            return arrow.table({"run": arrow.array([], arrow.int64())})
        return arrow.concat_tables(tables, promote_options="default").sort_by("run")


def _write(path: Path, content: Any) -> None:
    """Write a file so that it is there whole or not at all, whatever happens meanwhile."""
    temporary = path.with_name(path.name + TEMPORARY)
    try:
        with temporary.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except OSError:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
        raise


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
    at ``scheduler``. Raises DescriptionError; OSError if the data set cannot be written; KeyboardInterrupt. What was
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
