"""Reference results inside FMUs replayed: does this FMU behave here as its maker says?

``verify`` runs every experiment that an FMU brings along (``fmi_ls_ref``), with FMPy's ``simulate_fmu``, FMI 2.0 and
3.0, co-simulation or model exchange, ours or foreign. FMPy sets the inputs at the start of a communication step and
reads the outputs right after it, before the next inputs; that is what the references of this library stand for.
An FMU that only lists result files is run through its default experiment.

Each FMU runs in a process of its own: one that crashes or hangs is an outcome like another.
"""

# FMPy and numpy's structured arrays leave types open:
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import importlib
import itertools
import math
import multiprocessing
import os
import re
import zipfile
import zlib
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..errors import DescriptionError, suggest
from ..files import temporary_folder
from ..fmu.archive import unpack
from ..fmu.description import ELEMENT
from ..fmu.xml import parse
from ..reference import fmi_ls_ref as lsref
from .fmi_ls_ref import ReferenceExperiment, Related, Table, Tolerance

Interface = Literal["cs", "me"]


Array = NDArray[np.float64]


DEFAULT_TOLERANCE = 1e-3
"""Of the largest value of a reference for which the FMU states no tolerance: what tools call the same trace."""


DEFAULT_TIMEOUT = 60.0


FMI_TYPES: Mapping[Interface, str] = {"cs": "CoSimulation", "me": "ModelExchange"}


TEXT_TYPES = ("String", "Binary", "Clock")
"""Types of variables whose references are not compared."""


LAST_WORDS = 400
"""Characters of what a failed FMU printed last that are shown."""


_lxml: Any = importlib.import_module("lxml.etree")


@dataclass(frozen=True, eq=False)
class Signal:
    """A variable of an experiment: its reference and what the FMU gave, in its unit."""

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
        """Replay less reference; of an array the element furthest off."""
        off = self.replay - self.reference
        return off if off.ndim == 1 else _widest(off)

    @property
    def largest(self) -> float:
        """The largest difference, infinite where the FMU gave no number."""
        return float(np.max(np.nan_to_num(np.abs(self.differences), nan=math.inf)))

    @property
    def at(self) -> float:
        """Time of the largest difference."""
        return float(self.times[int(np.argmax(np.nan_to_num(np.abs(self.differences), nan=math.inf)))])

    @property
    def share(self) -> float:
        """The largest difference as a share of its limit."""
        return 0.0 if self.largest == 0.0 else self.largest / self.limit if self.limit > 0.0 else math.inf

    @property
    def within(self) -> bool:
        """Whether the FMU is as near as it should."""
        return self.largest <= self.limit


@dataclass(frozen=True, eq=False)
class Replay:
    """What an experiment gave."""

    experiment: ReferenceExperiment
    rows: int
    signals: tuple[Signal, ...] = ()
    failure: str = ""
    """Why there are no signals."""
    notes: tuple[str, ...] = ()

    @property
    def within(self) -> bool:
        """Whether it ran and all signals are within their tolerances."""
        return not self.failure and all(signal.within for signal in self.signals)

    @property
    def worst(self) -> Signal | None:
        """The signal that uses most of its tolerance."""
        return max(self.signals, key=lambda signal: (signal.share, signal.largest), default=None)


@dataclass(frozen=True, eq=False)
class Report:
    """What was found about an FMU."""

    path: Path
    name: str
    fmi: str = ""
    interface: str = ""
    outcomes: tuple[Replay, ...] = ()
    problems: tuple[str, ...] = ()
    """What is wrong with the file or its references."""

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
    """Replay every experiment of the FMU at ``path``; what is wrong with the FMU is in the report, never raised.

    ``interface`` is ``"cs"`` or ``"me"``, by default co-simulation where the FMU has it. ``tolerance`` is relative to
    the largest value of a reference and holds where the FMU states none. ``timeout`` in s ends a run that hangs.
    The FMU runs in a new Python process: a script that calls this needs ``if __name__ == "__main__":``.
    """
    path = Path(path)
    try:
        with temporary_folder() as folder:
            return _verify(path, folder, interface, tolerance, timeout)
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
    """``verify`` for many FMUs, on all cores, in their order."""
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        work = partial(verify, interface=interface, tolerance=tolerance, timeout=timeout)
        yield from pool.map(work, paths)


# ---- what is to be run ----


@dataclass(frozen=True, eq=False)
class _Job:
    """An experiment with everything read."""

    experiment: ReferenceExperiment
    references: Table
    arguments: Mapping[str, Any] = field(default_factory=dict[str, Any])
    """For ``simulate_fmu``."""
    variables: Mapping[str, tuple[Any, int | None]] = field(default_factory=dict[str, tuple[Any, int | None]])
    """Column -> variable, and the element of it."""
    notes: tuple[str, ...] = ()
    problems: tuple[str, ...] = ()
    """Wrong, but what is right can be compared."""


def _verify(path: Path, folder: Path, interface: Interface | None, tolerance: float, timeout: float) -> Report:
    _unpack(path, folder)
    model = _model(folder)
    offered = [kind for kind, name in (("cs", model.coSimulation), ("me", model.modelExchange)) if name is not None]
    chosen: Any = interface or next(iter(offered), None)
    if chosen not in offered:
        wanted = {"cs": "co-simulation", "me": "model exchange"}.get(str(chosen), "co-simulation or model exchange")
        raise DescriptionError(f"{path.name}: has no {wanted}. It offers: {', '.join(offered) or 'neither'}.")
    related = lsref.read_manifest(folder)
    problems = _missing(related, folder)
    found, more = _experiments(related, folder, model)
    problems += more
    if not found and not problems:
        problems.append(
            f"no reference results. An FMU with some lists them in {lsref.FOLDER}/{lsref.MANIFEST}; this one "
            f"{'lists none' if related else 'has no such file'}."
        )
    jobs: list[_Job] = []
    for experiment, beside in found:
        try:
            job = _job(experiment, beside, folder, model, chosen)
            jobs.append(job)
            wrong = job.problems
        except DescriptionError as error:
            wrong = error.problems
        problems += [f"experiment '{experiment.name}': {text}" for text in wrong]
    outcomes = _run(jobs, folder, tolerance, timeout)
    said = tuple(f"{path.name}: {text}" for text in dict.fromkeys(problems))
    return Report(path, str(model.modelName), str(model.fmiVersion), chosen, tuple(outcomes), said)


def _unpack(path: Path, folder: Path) -> None:
    try:
        with zipfile.ZipFile(path) as archive:
            unpack(archive, folder)
    except OSError as error:
        raise DescriptionError(f"{path}: cannot be read ({error.strerror or error}).") from None
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, ValueError) as error:
        raise DescriptionError(f"{path.name}: not a readable zip archive ({error}). Build or get it again.") from None
    if not (folder / "modelDescription.xml").is_file():
        raise DescriptionError(f"{path.name}: no modelDescription.xml inside. This is not an FMU.")


def _model(folder: Path) -> Any:
    from fmpy.model_description import read_model_description

    try:
        model = read_model_description(str(folder), validate=False)
    except Exception as error:
        # FMPy raises bare exceptions, and lxml its own, for whatever a damaged file holds
        text = str(error).replace(f"{folder}{os.sep}", "").strip() or type(error).__name__
        raise DescriptionError(f"modelDescription.xml cannot be read: {text}") from None
    if model.fmiVersion == "1.0":
        raise DescriptionError("FMI 1.0. Only FMI 2.0 and 3.0 are supported.")
    return model


def _missing(related: Sequence[Related], folder: Path) -> list[str]:
    """Files that the manifest lists and the FMU has not."""
    problems: list[str] = []
    for file in related:
        try:
            lsref.locate(file.source, folder / lsref.FOLDER, folder)
        except DescriptionError as error:
            problems += [f"{lsref.MANIFEST}: {text}" for text in error.problems]
    return problems


def _experiments(
    related: Sequence[Related], folder: Path, model: Any
) -> tuple[list[tuple[ReferenceExperiment, Path]], list[str]]:
    """Experiments with the folder their URIs start from: those of the experiment files, else one a result file."""
    found: list[tuple[ReferenceExperiment, Path]] = []
    problems: list[str] = []
    beside = folder / lsref.FOLDER
    files = [f for f in related if f.role.split("/")[0] == "experiment" and f.role != "experiment/uncertainty-analysis"]
    for file in files:
        try:
            path = lsref.locate(file.source, beside, folder)
        except DescriptionError:
            continue  # told with the manifest
        if file.type not in lsref.EXPERIMENTS_TYPES and path.suffix != ".exp":
            problems.append(f"'{file.source}': type '{file.type}' is not read. Use {lsref.EXPERIMENTS_TYPE}.")
            continue
        try:
            found += [(experiment, path.parent) for experiment in lsref.read_experiments(path)]
        except DescriptionError as error:
            problems += error.problems
    if files:
        return found, problems
    for file in related:
        if file.role == "result" and (file.type == lsref.CSV_TYPE or file.source.endswith(".csv")):
            found.append((_default_experiment(file, related, beside, model), beside))
    return found, problems


def _default_experiment(file: Related, related: Sequence[Related], beside: Path, model: Any) -> ReferenceExperiment:
    """The default experiment with a result file, and the inputs in ``NAME_in.csv`` beside ``NAME_out.csv``."""
    inputs = re.sub(r"(_out|_ref)?\.csv$", "_in.csv", file.source)
    known = {f.source for f in related}
    default = model.defaultExperiment

    def value(name: str) -> float | None:
        text = getattr(default, name) if default is not None else None
        return None if text is None else float(text)

    return ReferenceExperiment(
        name="default",
        description=file.description,
        start_time=value("startTime"),
        stop_time=value("stopTime"),
        step_size=value("stepSize"),
        tolerance=value("tolerance"),
        stimuli=inputs if inputs in known or (beside / inputs).is_file() else None,
        references=file.source,
    )


def _job(experiment: ReferenceExperiment, beside: Path, folder: Path, model: Any, interface: Interface) -> _Job:
    """Everything ``simulate_fmu`` needs. Raises DescriptionError with all problems of the experiment's files."""
    variables = {variable.name: variable for variable in model.modelVariables}
    if experiment.references is None:
        raise DescriptionError("has no references to compare with.")
    problems: list[str] = []
    start: dict[str, Any] = {}
    stimuli: Any = None
    if experiment.parameters is not None:
        try:
            start = _parameters(lsref.locate(experiment.parameters, beside, folder), variables)
        except DescriptionError as error:
            problems += error.problems
    if experiment.stimuli is not None:
        try:
            stimuli = _stimuli(lsref.locate(experiment.stimuli, beside, folder), variables, experiment.held)
        except DescriptionError as error:
            problems += error.problems
    try:
        path = lsref.locate(experiment.references, beside, folder)
        references = lsref.read_csv(path)
    except DescriptionError as error:
        raise DescriptionError([*problems, *error.problems]) from None
    experiment, more = _timed(experiment, references, path.name)
    problems += more
    located: dict[str, tuple[Any, int | None]] = {}
    notes: list[str] = []
    unknown: list[str] = []
    for name in references.names:
        variable, element = _find(name, variables)
        if variable is None:
            unknown.append(f"'{name}'")
        elif variable.type in TEXT_TYPES:
            notes.append(f"'{name}' is of type {variable.type} and not compared.")
        else:
            located[name] = variable, element
            try:
                _values(path.name, name, references, variable, element)
            except DescriptionError as error:
                problems += error.problems
    lesser = [
        f"{path.name}: a tolerance is stated for '{name}', which it has not."
        for name in experiment.tolerances
        if name not in references.names
    ]
    if unknown:
        # A file may serve FMUs of several versions of FMI, which have other variables.
        remark = f"the FMU has no variable {', '.join(unknown)}"
        if located:
            notes.append(f"{remark}: not compared.")
        else:
            lesser.append(f"{path.name}: {remark}. Take out what it has not.")
    if problems or not located:
        nothing = [] if located or unknown else [f"{path.name}: nothing to compare in it."]
        raise DescriptionError([*problems, *lesser, *nothing])
    arguments: dict[str, Any] = {
        "fmi_type": FMI_TYPES[interface],
        "start_time": experiment.start_time,
        "stop_time": experiment.stop_time,
        "output_interval": experiment.step_size,
        "relative_tolerance": experiment.tolerance,
        "start_values": start,
        "input": stimuli,
        "output": list(dict.fromkeys(variable.name for variable, _ in located.values())),
    }
    return _Job(experiment, references, arguments, located, tuple(notes), tuple(lesser))


def _timed(experiment: ReferenceExperiment, references: Table, name: str) -> tuple[ReferenceExperiment, list[str]]:
    """The experiment with its times complete, and what is wrong with the times of its references."""
    times = references.times
    start = 0.0 if experiment.start_time is None else experiment.start_time
    stop = times[-1] if experiment.stop_time is None else experiment.stop_time
    gaps = [later - earlier for earlier, later in itertools.pairwise(times) if later > earlier]
    step = experiment.step_size or min(gaps, default=stop - start)
    filled = replace(experiment, start_time=start, stop_time=stop, step_size=step)
    if not step > 0.0 or not stop > start:
        return filled, [f"start {start:g} s, stop {stop:g} s, step size {step:g} s: stop must be later, steps above 0."]
    for row, time in enumerate(times):
        steps = (time - start) / step
        if abs(steps - round(steps)) > 1e-6 or not -0.5 < steps < (stop - start) / step + 0.5:
            return filled, [
                f"{name}, row {row + 1}: time {time!r} s is no communication point of {start:g} s + k*{step!r} s up to "
                f"{stop:g} s. Write rows at communication points, or state the right step size."
            ]
    return filled, []


def _find(name: str, variables: Mapping[str, Any]) -> tuple[Any, int | None]:
    """The variable of a column; of a column ``name[i]`` the array ``name`` (FMI 3.0) and the place in it."""
    if name in variables:
        return variables[name], None
    match = ELEMENT.fullmatch(name)
    if match and match["name"] in variables and variables[match["name"]].shape:
        return variables[match["name"]], int(match["index"]) - 1
    return None, None


def _values(file: str, name: str, table: Table, variable: Any, element: int | None) -> Array:
    """The numbers of a column, a row or more cells each. Raises DescriptionError for what is none."""
    size = 1 if element is not None or not variable.shape else int(np.prod(variable.shape))
    values = np.empty((len(table.rows), size))
    problems: list[str] = []
    for row, cell in enumerate(table.column(name)):
        parts = cell.split() if size > 1 else [cell]
        try:
            numbers = [_TRUTH[part] if part in _TRUTH else float(part) for part in parts]
        except ValueError:
            numbers = [math.nan]
        if len(numbers) != size or not all(map(math.isfinite, numbers)):
            kind = "a finite number" if size == 1 else f"{size} finite numbers"
            problems.append(f"{file}, row {row + 1}: {name} = '{cell}' is not {kind}.")
            continue
        values[row] = numbers
    if problems:
        raise DescriptionError([*problems[:5], *([f"and {len(problems) - 5} more rows."] if len(problems) > 5 else [])])
    return values[:, 0] if size == 1 else values


_TRUTH = {"true": 1.0, "false": 0.0}


_INTEGERS = {
    **{f"{sign}Int{bits}": f"{sign.lower()}int{bits}" for sign in ("", "U") for bits in (8, 16, 32, 64)},
    "Integer": "int32",
    "Enumeration": "int64",
    "Boolean": "bool",
}


def _stimuli(path: Path, variables: Mapping[str, Any], held: bool) -> Any:
    """The structured array that FMPy takes; held inputs as a staircase, each time with the values before and after."""
    table = lsref.read_csv(path)
    problems: list[str] = []
    columns: list[tuple[Any, list[Any]]] = [(("time", "float64"), list(table.times))]
    for name in table.names:
        variable = variables.get(name)
        if variable is None or (variable.causality != "input" and variable.variability != "tunable"):
            known = [v.name for v in variables.values() if v.causality == "input"]
            problems.append(f"{path.name}: the FMU has no input '{name}'.{suggest(name, known)}")
            continue
        if variable.type in TEXT_TYPES:
            problems.append(f"{path.name}: input '{name}' is of type {variable.type}, which FMPy cannot set in a run.")
            continue
        kind = _INTEGERS.get(variable.type, "float64")
        try:
            numbers = _values(path.name, name, table, variable, None)
        except DescriptionError as error:
            problems += error.problems
            continue
        if kind not in ("float64", "bool") and not variable.shape:
            cells = [
                int(float(cell)) if not re.fullmatch(r"[+-]?\d+", cell) else int(cell) for cell in table.column(name)
            ]
        else:
            cells = list(numbers)
        columns.append(((name, kind, variable.shape) if variable.shape else (name, kind), cells))
    if problems:
        raise DescriptionError(problems)
    signals = np.empty(len(table.rows), dtype=[entry for entry, _ in columns])
    for entry, cells in columns:
        signals[entry[0]] = np.asarray(cells).reshape(signals[entry[0]].shape)
    if not held or len(signals) < 2:
        return signals
    stairs = np.repeat(signals, 2)[:-1]
    stairs["time"] = np.repeat(signals["time"], 2)[1:]
    return stairs


def _parameters(path: Path, variables: Mapping[str, Any]) -> dict[str, Any]:
    """Start values of an SSV file (SSP 1.0 or 2.0), with their units."""
    try:
        root = parse(path.read_bytes())
    except _lxml.XMLSyntaxError as error:
        raise DescriptionError(f"{path.name}: not valid XML: {error}") from None
    values: dict[str, Any] = {}
    problems: list[str] = []
    for parameter in root.iterfind(".//{*}Parameters/{*}Parameter"):
        name, typed = str(parameter.get("name")), next(iter(parameter), None)
        variable, element = _find(name, variables)
        if variable is None:
            problems.append(f"{path.name}: the FMU has no variable '{name}'.{suggest(name, variables)}")
            continue
        text = None if typed is None else typed.get("value")
        if typed is None or text is None:
            problems.append(f"{path.name}: '{name}' has no value.")
            continue
        items = {item.name: item.value for item in variable.declaredType.items or ()} if variable.declaredType else {}
        unit = typed.get("unit")
        value: Any = items.get(text, text)
        if element is not None:
            values.setdefault(variable.name, _start_array(variable))[element] = float(value)
            continue
        values[name] = (float(value), unit) if unit and variable.unit and unit != variable.unit else value
    if problems:
        raise DescriptionError(problems)
    return values


def _start_array(variable: Any) -> Array:
    """The start values of an array of FMI 3.0; one value stands for all elements."""
    start = variable.start if isinstance(variable.start, list) else str(variable.start).split()
    return np.resize(np.array([float(item) for item in start]), int(np.prod(variable.shape)))


# ---- running ----


def _run(jobs: Sequence[_Job], folder: Path, tolerance: float, timeout: float) -> list[Replay]:
    """Run the jobs in a process, in another one after it ended or hung."""
    outcomes: list[Replay] = []
    context = multiprocessing.get_context("spawn")
    while len(outcomes) < len(jobs):
        waiting = jobs[len(outcomes) :]
        here, there = context.Pipe(duplex=False)
        printed = folder / "printed.txt"
        arguments = (there, str(folder), [dict(job.arguments) for job in waiting], str(printed))
        process = context.Process(target=_child, args=arguments, daemon=True)
        process.start()
        there.close()
        for job in waiting:
            failure, columns, ended = _answer(here, process, timeout)
            if failure:
                words = _last_words(printed)
                failure += f" It printed: {words}" if words else ""
            outcomes.append(_compared(job, columns, tolerance) if columns is not None else _failed(job, failure))
            if ended:
                break
        process.kill()
        process.join()
        here.close()
    return outcomes


def _last_words(printed: Path) -> str:
    """The end of what was printed, without FMPy's remarks on inputs that keep their start values."""
    lines = printed.read_text(errors="replace").splitlines() if printed.exists() else []
    return " ".join(" ".join(line for line in lines if "Warning: missing input" not in line).split())[-LAST_WORDS:]


def _answer(pipe: Any, process: Any, timeout: float) -> tuple[str, dict[str, Any] | None, bool]:
    """What the process says about the next job: a failure or columns, and whether it has ended."""
    try:
        if pipe.poll(timeout):
            return (*pipe.recv(), False)
    except EOFError:
        process.join()
        code = process.exitcode
        how = f"signal {-code}" if code is not None and code < 0 else f"exit code {code}"
        return f"the process with the FMU ended ({how}).", None, True
    process.kill()
    process.join()
    return f"no answer within {timeout:g} s.", None, True


def _child(pipe: Any, folder: str, jobs: list[dict[str, Any]], printed: str) -> None:
    """Run the jobs one by one; what the FMU or FMPy prints goes to a file."""
    from fmpy.model_description import read_model_description

    simulate: Any = importlib.import_module("fmpy.simulation").simulate_fmu
    model = read_model_description(folder, validate=False)
    for job in jobs:
        file = os.open(printed, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(file, 1)
        os.dup2(file, 2)
        try:
            result = simulate(folder, model_description=model, remote_platform=None, **job)
        except Exception as error:  # FMPy raises bare exceptions
            pipe.send((f"{str(error).strip().rstrip('.') or type(error).__name__}.", None))
        else:
            pipe.send(("", {name: np.array(result[name]) for name in result.dtype.names or ()}))
        finally:
            os.close(file)
    pipe.close()


def _failed(job: _Job, failure: str) -> Replay:
    return Replay(job.experiment, len(job.references.rows), failure=failure, notes=job.notes)


def _compared(job: _Job, columns: Mapping[str, Any], tolerance: float) -> Replay:
    """The signals at the times of the references.

    At an event FMPy gives several rows of one time. With held stimuli the first counts, before new inputs are set,
    else the last, after the event; of references of one time the first and the last meet those.
    """
    step = job.experiment.step_size or 1.0
    times = np.array(job.references.times)
    found = np.asarray(columns["time"], dtype=float)
    first = np.searchsorted(found, times - 1e-6 * step)
    last = np.maximum(np.searchsorted(found, times + 1e-6 * step, side="right") - 1, first)
    same = np.diff(times) == 0.0
    before, after = np.append(same, False), np.insert(same, 0, False)
    rows = np.where(before, first, np.where(after, last, first if job.experiment.held else last))
    late = (rows >= len(found)) | (np.abs(found[np.minimum(rows, len(found) - 1)] - times) > 1e-6 * step)
    if late.any():
        return _failed(job, f"the FMU gave no values at {times[late][0]:g} s; its last are those of {found[-1]:g} s.")
    signals: list[Signal] = []
    for name, (variable, element) in job.variables.items():
        reference = _values("", name, job.references, variable, element)
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
