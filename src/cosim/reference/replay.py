"""Replay of the reference results inside FMUs: does this FMU behave on this machine as its maker says?

``verify`` runs every experiment that an FMU holds (``fmi_ls_ref``) with FMPy's ``simulate_fmu``. The FMU may be of FMI
2.0 or 3.0, for co-simulation or model exchange, and of any maker. FMPy sets the inputs at the start of a communication
step and reads the outputs right after it, before the next inputs; the references of this library are made the same way.
An FMU that only lists result files is run through its default experiment.

Each FMU runs in a process of its own, so that an FMU that crashes or hangs is only reported.
"""

# FMPy and numpy's structured arrays leave types open:
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import importlib
import math
import multiprocessing
import os
import threading
import time as clock_time
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import DescriptionError
from ..files import forbidden_library, temporary_folder
from ..master.board import Board, mapped
from ..master.failure import limit_text, process_error
from ..master.interrupts import held_back
from ..master.process import shared_memory
from ..reference import fmi_ls_ref as lsref
from .fmi_ls_ref import ReferenceExperiment, Tolerance
from .jobs import (
    SAME_TIME,
    Array,
    Interface,
    Job,
    listed_experiments,
    make_job,
    missing_files,
    read_model,
    unpack_fmu,
    values_of,
)

DEFAULT_TOLERANCE = 1e-3
"""Tolerance of a reference for which the FMU states none, as a share of its largest magnitude.

Tools commonly call two traces with this difference the same.
"""

DEFAULT_TIMEOUT = 60.0
"""Longest time of a run in s."""

POLL_SECONDS = 0.1
"""Time between two looks at the time limit and at Ctrl-C; an answer comes at once."""

LAST_WORDS = 400
"""Number of characters shown of the last output of a failed FMU."""

_lxml: Any = importlib.import_module("lxml.etree")


@dataclass(frozen=True, eq=False)
class Signal:
    """A variable of an experiment: its reference and the values of the FMU, both in the unit of the variable."""

    name: str
    unit: str
    times: Array
    reference: Array
    replay: Array
    limit: float
    """The largest difference allowed."""
    stated: bool
    """Whether the FMU states the tolerance."""

    @property
    def differences(self) -> Array:
        """Replay minus reference at each time; for an array the element with the largest difference."""
        off = self.replay - self.reference
        return off if off.ndim == 1 else _widest(off)

    @property
    def largest(self) -> float:
        """The largest magnitude of the difference; infinite if the FMU gave NaN."""
        return float(np.max(np.nan_to_num(np.abs(self.differences), nan=math.inf)))

    @property
    def at(self) -> float:
        """Time of the largest difference in s."""
        return float(self.times[int(np.argmax(np.nan_to_num(np.abs(self.differences), nan=math.inf)))])

    @property
    def share(self) -> float:
        """The largest difference as a share of its limit."""
        return 0.0 if self.largest == 0.0 else self.largest / self.limit if self.limit > 0.0 else math.inf

    @property
    def within(self) -> bool:
        """Whether the largest difference is within the limit."""
        return self.largest <= self.limit


@dataclass(frozen=True, eq=False)
class Replay:
    """The result of an experiment."""

    experiment: ReferenceExperiment
    rows: int
    signals: tuple[Signal, ...] = ()
    failure: str = ""
    """Why there are no signals; empty if the experiment ran."""
    notes: tuple[str, ...] = ()

    @property
    def within(self) -> bool:
        """Whether it ran and all signals are within their tolerances."""
        return not self.failure and all(signal.within for signal in self.signals)

    @property
    def worst(self) -> Signal | None:
        """The signal with the largest share of its tolerance; None without signals."""
        return max(self.signals, key=lambda signal: (signal.share, signal.largest), default=None)


@dataclass(frozen=True, eq=False)
class Report:
    """The results of all experiments of an FMU."""

    path: Path
    name: str
    fmi: str = ""
    interface: str = ""
    outcomes: tuple[Replay, ...] = ()
    problems: tuple[str, ...] = ()
    """Problems of the FMU file or of its references."""

    @property
    def code(self) -> int:
        """Exit code: 2 if something is wrong with the file, 1 for a difference or a failed run, else 0."""
        return 2 if self.problems else 0 if all(outcome.within for outcome in self.outcomes) else 1


def verify(
    path: str | Path,
    *,
    interface: Interface | None = None,
    tolerance: float = DEFAULT_TOLERANCE,
    timeout: float = DEFAULT_TIMEOUT,
) -> Report:
    """Replay every experiment of the FMU at ``path``. Problems of the FMU are in the report, they are never raised.

    ``interface`` is ``"cs"`` or ``"me"``, by default co-simulation where the FMU has it. ``tolerance`` is relative to
    the largest magnitude of a reference; it is used if the FMU states none. ``timeout`` in s ends a run that hangs.
    The FMU runs in a new Python process: a script that calls this needs ``if __name__ == "__main__":``.
    """
    return _report(Path(path), interface, _Way(tolerance, timeout, threading.Event()))


@dataclass(frozen=True)
class _Way:
    """How experiments are replayed: with ``tolerance`` where none is stated, ``timeout`` in s, until ``stopped``."""

    tolerance: float
    timeout: float
    stopped: threading.Event


def _report(path: Path, interface: Interface | None, way: _Way) -> Report:
    try:
        with temporary_folder() as folder:
            return _verify(path, folder, interface, way)
    except DescriptionError as error:
        said = (text if text.startswith(path.name) else f"{path.name}: {text}" for text in error.problems)
        return Report(path, path.stem, problems=tuple(said))


def verify_all(
    paths: Sequence[Path],
    *,
    interface: Interface | None = None,
    tolerance: float = DEFAULT_TOLERANCE,
    timeout: float = DEFAULT_TIMEOUT,
) -> Iterable[Report]:
    """``verify`` for many FMUs, on all cores; the reports come in the order of ``paths``."""
    way = _Way(tolerance, timeout, threading.Event())
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        try:
            yield from pool.map(partial(_report, interface=interface, way=way), paths)
        finally:
            # After Ctrl-C, the replays in progress end at once.
            way.stopped.set()
            pool.shutdown(wait=False, cancel_futures=True)


def _verify(path: Path, folder: Path, interface: Interface | None, way: _Way) -> Report:
    unpack_fmu(path, folder)
    model = read_model(folder)
    offered = [kind for kind, name in (("cs", model.coSimulation), ("me", model.modelExchange)) if name is not None]
    chosen: Any = interface or next(iter(offered), None)
    if chosen not in offered:
        wanted = {"cs": "co-simulation", "me": "model exchange"}.get(str(chosen), "co-simulation or model exchange")
        raise DescriptionError(f"{path.name}: has no {wanted}. It offers: {', '.join(offered) or 'neither'}.")
    related = lsref.read_manifest(folder)
    problems = missing_files(related, folder)
    found, more = listed_experiments(related, folder, model)
    problems += more
    if not found and not problems:
        problems.append(
            f"no reference results. An FMU with some lists them in {lsref.FOLDER}/{lsref.MANIFEST}; this one "
            f"{'lists none' if related else 'has no such file'}."
        )
    jobs: list[Job] = []
    for experiment, beside in found:
        try:
            job = make_job(experiment, beside, folder, model, chosen)
            jobs.append(job)
            wrong = job.problems
        except DescriptionError as error:
            wrong = error.problems
        problems += [f"experiment '{experiment.name}': {text}" for text in wrong]
    outcomes = _run(jobs, folder, way)
    said = tuple(f"{path.name}: {text}" for text in dict.fromkeys(problems))
    return Report(path, str(model.modelName), str(model.fmiVersion), chosen, tuple(outcomes), said)


# ---- running ----


def _run(jobs: Sequence[Job], folder: Path, way: _Way) -> list[Replay]:
    """Run the jobs in a child process. After a crash or a hang a new process runs the remaining jobs."""
    outcomes: list[Replay] = []
    context = multiprocessing.get_context("spawn")
    while len(outcomes) < len(jobs) and not way.stopped.is_set():
        waiting = jobs[len(outcomes) :]
        here, there = context.Pipe(duplex=False)
        printed = folder / "printed.txt"
        with shared_memory(folder, Board.size(), shared_file=True) as (memory, path):
            board = Board(memoryview(memory))
        arguments = (there, str(folder), [dict(job.arguments) for job in waiting], str(printed), path)
        process = context.Process(target=_child, args=arguments, daemon=True)
        with held_back():
            # The process never lets signals through: this one kills it.
            process.start()
        there.close()
        try:
            for job in waiting:
                failure, columns, ended = _answer(here, process, board, way)
                if failure:
                    words = _last_words(printed)
                    failure += f" It printed: {words}" if words else ""
                outcomes.append(
                    _compared(job, columns, way.tolerance) if columns is not None else _failed(job, failure)
                )
                if ended:
                    break
        finally:
            process.kill()
            process.join()
            here.close()
    return outcomes


def _last_words(printed: Path) -> str:
    """The end of the printed output, without FMPy's warnings on inputs that keep their start values."""
    lines = printed.read_text(errors="replace").splitlines() if printed.exists() else []
    return " ".join(" ".join(line for line in lines if "Warning: missing input" not in line).split())[-LAST_WORDS:]


def _answer(pipe: Any, process: Any, board: Board, way: _Way) -> tuple[str, dict[str, Any] | None, bool]:
    """The answer of the process to the next job: a failure or columns, and whether the process has ended."""
    try:
        deadline = clock_time.monotonic() + way.timeout
        while clock_time.monotonic() < deadline and not way.stopped.is_set():
            if pipe.poll(POLL_SECONDS):
                return (*pipe.recv(), False)
    except EOFError:
        process.join()
        return str(process_error(board, process.exitcode)), None, True
    return str(process_error(board, None, limit=limit_text(way.timeout, "a run"))), None, True


def _child(pipe: Any, folder: str, jobs: list[dict[str, Any]], printed: str, memory: Path) -> None:
    """Run the jobs one by one. The output of the FMU and of FMPy goes to the file ``printed``.

    Calls of the FMU are shown on the board in the file ``memory``.
    """
    from fmpy.model_description import read_model_description

    simulate: Any = importlib.import_module("fmpy.simulation").simulate_fmu
    fmu: Any = importlib.import_module("fmpy.fmi1")._FMU
    board, call = Board.show(mapped(memory)), fmu._call

    def shown_call(self: Any, function: str, *arguments: Any) -> Any:
        with board.call(self.instanceName, function):
            return call(self, function, *arguments)

    def show_time(time: float, recorder: object) -> bool:
        board.clock[0] = time
        return True

    fmu._call = shown_call
    model = read_model_description(folder, validate=False)
    for job in jobs:
        board.clock[0] = job["start_time"]
        file = os.open(printed, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(file, 1)
        os.dup2(file, 2)
        try:
            # The first call of FMPy ends this one, which is shown if the library crashes while it is loaded.
            with board.call(Path(folder).name, "loading the library"):
                result = simulate(folder, model_description=model, remote_platform=None, step_finished=show_time, **job)
        except Exception as error:  # FMPy raises bare exceptions
            text = f"{str(error).strip().rstrip('.') or type(error).__name__}."
            pipe.send((text + forbidden_library(text), None))
        else:
            pipe.send(("", {name: np.array(result[name]) for name in result.dtype.names or ()}))
        finally:
            os.close(file)
    pipe.close()


def _failed(job: Job, failure: str) -> Replay:
    return Replay(job.experiment, len(job.references.rows), failure=failure, notes=job.notes)


def _compared(job: Job, columns: Mapping[str, Any], tolerance: float) -> Replay:
    """The signals at the times of the references.

    At an event FMPy gives several rows of the same time. With held stimuli the first row counts, which is before the
    new inputs; otherwise the last row, which is after the event. If the references have several rows of a time, their
    first and last rows are compared with the first and last rows of FMPy.
    """
    step = job.experiment.step_size or 1.0
    near = SAME_TIME * step
    times = np.array(job.references.times)
    found = np.asarray(columns["time"], dtype=float)
    first = np.searchsorted(found, times - near)
    last = np.maximum(np.searchsorted(found, times + near, side="right") - 1, first)
    same = np.diff(times) == 0.0
    before, after = np.append(same, False), np.insert(same, 0, False)
    rows = np.where(before, first, np.where(after, last, first if job.experiment.held else last))
    late = (rows >= len(found)) | (np.abs(found[np.minimum(rows, len(found) - 1)] - times) > near)
    if late.any():
        return _failed(job, f"the FMU gave no values at {times[late][0]:g} s; its last are those of {found[-1]:g} s.")
    signals: list[Signal] = []
    for name, (variable, element) in job.variables.items():
        reference = values_of("", name, job.references, variable, element)
        replay = np.asarray(columns[variable.name], dtype=float)[rows]
        replay = replay.reshape(len(rows), -1)
        replay = replay[:, 0 if element is None else element] if reference.ndim == 1 else replay
        stated = job.experiment.tolerances.get(name)
        allowed = stated if stated is not None else Tolerance(0.0, tolerance)
        limit = allowed.limit(float(np.max(np.abs(reference))))
        signals.append(Signal(name, _unit(variable), times, reference, replay, limit, stated is not None))
    return Replay(job.experiment, len(times), tuple(signals), notes=job.notes)


def _unit(variable: Any) -> str:
    declared = variable.declaredType
    return str(variable.unit or (declared.unit if declared is not None else None) or "")


def _widest(off: Array) -> Array:
    columns = np.argmax(np.nan_to_num(np.abs(off), nan=math.inf), axis=1)
    return off[np.arange(len(off)), columns]
