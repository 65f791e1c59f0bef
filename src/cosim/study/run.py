"""Finding studies and carrying out their runs."""

from __future__ import annotations

import fnmatch
import importlib.util
import sys
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, ProcessPoolExecutor, as_completed
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

from ..errors import CosimError, DescriptionError, SimulationError, suggest
from ..fmu.places import study_folders
from ..master.simulation import simulate
from ..result.result import Result
from ..result.summary import tracking
from ..system.system import read_system
from .rules import Numbers
from .study import NONE, Outcome, Outcomes, Run, Study


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
