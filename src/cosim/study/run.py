"""Finding studies and carrying out their runs."""

from __future__ import annotations

import fnmatch
import importlib.util
import math
import sys
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, ProcessPoolExecutor, as_completed
from dataclasses import replace
from multiprocessing import active_children, get_context
from pathlib import Path

import numpy as np

from ..errors import CosimError, DescriptionError, SimulationError, suggest
from ..fmu.places import study_folders
from ..master.interrupts import held_back, released
from ..master.simulation import simulate
from ..result.result import Result
from ..result.summary import tracking
from ..system.system import System, read_system
from .rules import Numbers
from .study import NONE, Outcome, Outcomes, Run, Study

END_SECONDS = 0.5
"""Longest time in which a process ends its run after Ctrl-C; then it is killed. Longer than ``GRACE_SECONDS``."""


def known_studies() -> dict[str, Path]:
    """Every study found: name -> folder."""
    found: dict[str, Path] = {}
    for place in study_folders():
        for path in sorted(place.glob("*/study.py")):
            found.setdefault(path.parent.name, path.parent)
    return found


def find_study(name: str) -> Path:
    """The folder of the study ``name``, which may also be a path. Raises DescriptionError if there is no such study."""
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
    numbers = _measured(run, result)
    for instance, counters in result.solver.items():
        numbers.update({f"{instance}.{counter}": value for counter, value in counters.items()})
    kept = slice(None, None, run.keep_every)
    thinned = replace(result, time=result.time[kept].copy(), rows=result.rows[kept].copy())
    return Outcome(name, run, numbers, thinned, int(result.metadata["steps"]))


def run_system(folder: Path, run: Run, fmus: Path | None = None) -> System:
    """The system of a run of the study in ``folder``, with its changed and scaled start values.

    Raises DescriptionError for a wrong system file or a value that does not exist.
    """
    system = read_system(folder / run.system, run.overrides, fmus=fmus, stop_time=run.stop_time)
    if not run.scaled:
        return system
    changed = {name: factor * _start(system, name, run.system) for name, factor in run.scaled.items()}
    return read_system(folder / run.system, {**run.overrides, **changed}, fmus=fmus, stop_time=run.stop_time)


def _start(system: System, name: str, file: str) -> float:
    """The start value ``instance.variable`` of a system."""
    owner, _, variable = name.partition(".")
    instance = next((instance for instance in system.instances if instance.name == owner), None)
    if instance is None or variable not in instance.fmu.variables:
        raise DescriptionError(f"{file}: there is no {name} to be scaled.")
    start = instance.start.get(variable, instance.fmu.variables[variable].start)
    return float(start or 0.0)


def run_machines(folder: Path, run: Run, fmus: Path | None = None, *, timeout: float | None = None) -> dict[str, float]:
    """Figures of ``run.machines`` machines whose start values are drawn from ``run.box``.

    The factors are spread evenly over the logarithm of their range; the same box gives the same machines. Each figure
    of ``tracking`` and ``run.measure`` is given as NAME_median, NAME_p90 and NAME_worst; a machine whose run fails
    counts as infinite and in ``failed``.
    """
    random = np.random.default_rng(0)
    low, high = (np.log([ends[i] for ends in run.box.values()]) for i in (0, 1))
    rows: list[Numbers] = []
    failed = 0
    for factors in np.exp(random.uniform(low, high, (run.machines, len(run.box)))):
        machine = replace(run, scaled=dict(zip(run.box, map(float, factors), strict=True)), machines=0)
        try:
            rows.append(_measured(machine, _simulate(run_system(folder, machine, fmus), timeout)))
        except SimulationError:
            failed += 1
    found: dict[str, float] = {"failed": float(failed)}
    for name in rows[0] if rows else ():
        values = np.sort([*(row[name] for row in rows), *[np.inf] * failed])
        ends = (len(values) // 2, math.ceil(0.9 * len(values)) - 1, -1)
        found |= {f"{name}_{text}": float(values[i]) for text, i in zip(("median", "p90", "worst"), ends, strict=True)}
    return found


def _measured(run: Run, result: Result) -> dict[str, float]:
    numbers = tracking(result, run.window)
    if run.measure is not None:
        numbers.update(run.measure(result, run.window))
    return numbers


def _simulate(system: System, timeout: float | None) -> Result:
    """A run in a process of its own, so that an FMU that crashes or hangs costs this run only."""
    return simulate(system, isolated=True, timeout=timeout)


def run_one(folder: Path, name: str, run: Run, fmus: Path | None = None, *, timeout: float | None = None) -> Outcome:
    """Carry out one run of the study in ``folder``. An error that stops it becomes the failure of the outcome.

    ``timeout`` in s is the limit for a call of an FMU.
    """
    steps = 0
    try:
        system = run_system(folder, run, fmus)
        steps = system.steps
        outcome = measure_run(name, run, _simulate(system, timeout))
        if not run.machines:
            return outcome
        return replace(outcome, numbers={**outcome.numbers, **run_machines(folder, run, fmus, timeout=timeout)})
    except CosimError as error:
        return Outcome(name, run, NONE, None, steps, str(error))


def _run_in_process(
    folder: Path, name: str, fmus: Path | None, timeout: float | None
) -> tuple[str, Numbers, Result | None, int, str]:
    """The outcome of ``run_one`` without the run itself, whose functions cannot be sent between processes."""
    outcome = run_one(folder, name, load_study(folder).runs[name], fmus, timeout=timeout)
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
    data: Path | None = None,
    timeout: float | None = None,
    progress: Callable[[Outcome], None] = lambda outcome: None,
) -> Outcomes:
    """Carry out the runs of the study in ``folder`` whose names match ``pattern``, ``jobs`` at a time.

    The outcomes do not depend on ``jobs``. ``progress`` gets each outcome as its run ends. Some studies are about
    measured data of the user: they read the files in the folder ``data``, or show stored figures without it.
    ``timeout`` in s is the limit for a call of an FMU.
    Raises DescriptionError if no run matches, SimulationError if a run takes its process down.
    """
    study = load_study(folder)
    if study.outcomes is not None:
        if timeout is not None:
            raise DescriptionError(f"the study {folder.name} has limits of its own: leave --timeout out.")
        return study.outcomes(data, fmus, progress, jobs)
    if data is not None:
        raise DescriptionError(f"the study {folder.name} reads no data of yours: leave --data out.")
    names = matching_runs(study, pattern)
    done: dict[str, Outcome] = {}
    if jobs <= 1 or len(names) == 1:
        for name in names:
            done[name] = run_one(folder, name, study.runs[name], fmus, timeout=timeout)
            progress(done[name])
    else:
        before = active_children()
        pool = ProcessPoolExecutor(min(jobs, len(names)), mp_context=get_context("spawn"), initializer=released)
        try:
            with held_back():
                futures = [pool.submit(_run_in_process, folder, name, fmus, timeout) for name in names]
            for future in as_completed(futures):
                name, numbers, result, steps, failure = future.result()
                done[name] = Outcome(name, study.runs[name], numbers, result, steps, failure)
                progress(done[name])
        except BrokenExecutor:
            left = ", ".join(name for name in names if name not in done)
            raise SimulationError(
                f"a process died in one of the runs {left}. Give jobs = 1 to see which run it is."
            ) from None
        except KeyboardInterrupt:
            workers = [child for child in active_children() if child not in before]
            for worker in workers:
                worker.terminate()
            for worker in workers:
                worker.join(END_SECONDS)
                worker.kill()
            raise
        finally:
            pool.shutdown(cancel_futures=True)
    return Outcomes([done[name] for name in names])
