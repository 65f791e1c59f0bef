"""Experiments of an FMU, read with everything that a replay needs: stimuli, parameters, references, tolerances."""

# FMPy and numpy's structured arrays leave types open:
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import importlib
import itertools
import math
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..errors import DescriptionError, shortened, suggest
from ..fmu.archive import opened, unpack
from ..fmu.description import ELEMENT
from ..fmu.xml import parse
from ..reference import fmi_ls_ref as lsref
from .fmi_ls_ref import ReferenceExperiment, Related, Table

Interface = Literal["cs", "me"]

Array = NDArray[np.float64]

FMI_TYPES: Mapping[Interface, str] = {"cs": "CoSimulation", "me": "ModelExchange"}

SAME_TIME = 1e-3
"""Largest distance of two times that are the same, as a share of the step: many files give times with six digits."""

TEXT_TYPES = ("String", "Binary", "Clock")
"""Types of variables whose references are not compared."""

_lxml: Any = importlib.import_module("lxml.etree")


@dataclass(frozen=True, eq=False)
class Job:
    """An experiment with the contents of all its files."""

    experiment: ReferenceExperiment
    references: Table
    arguments: Mapping[str, Any] = field(default_factory=dict[str, Any])
    """Arguments of FMPy's ``simulate_fmu``."""
    variables: Mapping[str, tuple[Any, int | None]] = field(default_factory=dict[str, tuple[Any, int | None]])
    """Column -> its variable, and the index of the element for a column of an array, else None."""
    notes: tuple[str, ...] = ()
    problems: tuple[str, ...] = ()
    """Problems that do not prevent a comparison of the other columns."""


def unpack_fmu(path: Path, folder: Path) -> None:
    """Unpack an FMU into ``folder``. Raises DescriptionError if the file is no FMU."""
    try:
        with opened(path) as archive:
            unpack(archive, folder)
    except OSError as error:
        raise DescriptionError(f"{path}: cannot be read ({error.strerror or error}).") from None
    if not (folder / "modelDescription.xml").is_file():
        raise DescriptionError(f"{path.name}: no modelDescription.xml inside. This is not an FMU.")


def read_model(folder: Path) -> Any:
    """The description of the unpacked FMU, as FMPy reads it. Raises DescriptionError if FMPy cannot read it."""
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


def missing_files(related: Sequence[Related], folder: Path) -> list[str]:
    """Files that the manifest lists but the FMU does not have."""
    problems: list[str] = []
    for file in related:
        try:
            lsref.locate(file.source, folder / lsref.FOLDER, folder)
        except DescriptionError as error:
            problems += [f"{lsref.MANIFEST}: {text}" for text in error.problems]
    return problems


def listed_experiments(
    related: Sequence[Related], folder: Path, model: Any
) -> tuple[list[tuple[ReferenceExperiment, Path]], list[str]]:
    """Experiments, each with the folder of its relative URIs, and problems of the files.

    They come from the experiments files; without such files, each result file makes a default experiment.
    """
    found: list[tuple[ReferenceExperiment, Path]] = []
    problems: list[str] = []
    beside = folder / lsref.FOLDER
    files = [f for f in related if f.role.split("/")[0] == "experiment" and f.role != "experiment/uncertainty-analysis"]
    for file in files:
        try:
            path = lsref.locate(file.source, beside, folder)
        except DescriptionError:
            continue  # reported with the problems of the manifest
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


def _located(
    file: str, references: Table, variables: Mapping[str, Any], problems: list[str], notes: list[str]
) -> tuple[dict[str, tuple[Any, int | None]], list[str]]:
    """The variable, and the index of its element, of each column that can be compared; and the names of no variable.

    Adds columns with wrong values to ``problems``, columns of text to ``notes``.
    """
    located: dict[str, tuple[Any, int | None]] = {}
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
                values_of(file, name, references, variable, element)
            except DescriptionError as error:
                problems += error.problems
    return located, unknown


def make_job(experiment: ReferenceExperiment, beside: Path, folder: Path, model: Any, interface: Interface) -> Job:
    """An experiment with everything that ``simulate_fmu`` needs.

    Raises DescriptionError with all problems of the experiment's files.
    """
    variables = {variable.name: variable for variable in model.modelVariables}
    if experiment.references is None:
        raise DescriptionError("has no references to compare with.")
    problems: list[str] = []
    notes: list[str] = []
    start: dict[str, Any] = {}
    stimuli: Any = None
    if experiment.parameters is not None:
        try:
            start = _parameters(lsref.locate(experiment.parameters, beside, folder), variables)
        except DescriptionError as error:
            problems += error.problems
    if experiment.stimuli is not None:
        try:
            stimuli = _stimuli(lsref.locate(experiment.stimuli, beside, folder), variables, experiment.held, notes)
        except DescriptionError as error:
            problems += error.problems
    try:
        path = lsref.locate(experiment.references, beside, folder)
        references = lsref.read_csv(path)
    except DescriptionError as error:
        raise DescriptionError([*problems, *error.problems]) from None
    experiment, more = _timed(experiment, references, path.name)
    problems += more
    located, unknown = _located(path.name, references, variables, problems, notes)
    lesser = [
        f"{path.name}: a tolerance is stated for '{name}', which it has not."
        for name in experiment.tolerances
        if name not in references.names
    ]
    if unknown:
        # One file may serve FMUs of several versions of FMI, whose variables differ.
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
    return Job(experiment, references, arguments, located, tuple(notes), tuple(lesser))


def _timed(experiment: ReferenceExperiment, references: Table, name: str) -> tuple[ReferenceExperiment, list[str]]:
    """The experiment with all its times, and the problems with the times of its references."""
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
        if abs(steps - round(steps)) > SAME_TIME or not -0.5 < steps < (stop - start) / step + 0.5:
            return filled, [
                f"{name}, row {row + 1}: time {time!r} s is no communication point of {start:g} s + k*{step!r} s up to "
                f"{stop:g} s. Write rows at communication points, or state the right step size."
            ]
    return filled, []


def _find(name: str, variables: Mapping[str, Any]) -> tuple[Any, int | None]:
    """The variable of a column; for a column ``name[i]`` the array ``name`` (FMI 3.0) and the index in it."""
    if name in variables:
        return variables[name], None
    match = ELEMENT.fullmatch(name)
    if match and match["name"] in variables and variables[match["name"]].shape:
        return variables[match["name"]], int(match["index"]) - 1
    return None, None


def values_of(file: str, name: str, table: Table, variable: Any, element: int | None) -> Array:
    """The numbers of a column, of one element or of all of the variable.

    Raises DescriptionError for a cell that does not hold as many numbers as it should.
    """
    size = 1 if element is not None or not variable.shape else int(np.prod(variable.shape))
    values = np.empty((len(table.rows), size))
    problems: list[str] = []
    for row, cell in enumerate(table.column(name)):
        parts = cell.split() if size > 1 else [cell]
        try:
            numbers = [_TRUTH[part.lower()] if part.lower() in _TRUTH else float(part) for part in parts]
        except ValueError:
            numbers = [math.nan]
        if len(numbers) != size or not all(map(math.isfinite, numbers)):
            kind = "a finite number" if size == 1 else f"{size} finite numbers"
            problems.append(f"{file}, row {row + 1}: {name} = '{cell}' is not {kind}.")
            continue
        values[row] = numbers
    if problems:
        raise DescriptionError(shortened(problems, "rows"))
    return values[:, 0] if size == 1 else values


_TRUTH = {"true": 1.0, "false": 0.0}

_INTEGERS = {
    **{f"{sign}Int{bits}": f"{sign.lower()}int{bits}" for sign in ("", "U") for bits in (8, 16, 32, 64)},
    "Integer": "int32",
    "Enumeration": "int64",
    "Boolean": "bool",
}


def _stimuli(path: Path, variables: Mapping[str, Any], held: bool, notes: list[str]) -> Any:
    """The structured array that FMPy takes. Held inputs are steps: each time has two rows, with old and new values.

    A file may serve FMUs of several versions of FMI, whose inputs differ: then ``notes`` gets the names of the others.
    """
    table = lsref.read_csv(path)
    problems: list[str] = []
    unknown: list[str] = []
    columns: list[tuple[Any, list[Any]]] = [(("time", "float64"), list(table.times))]
    for name in table.names:
        variable = variables.get(name)
        if variable is None or (variable.causality != "input" and variable.variability != "tunable"):
            unknown.append(name)
            continue
        if variable.type in TEXT_TYPES:
            notes.append(f"{path.name}: input '{name}' is of type {variable.type}, which is not set in a replay.")
            continue
        kind = _INTEGERS.get(variable.type, "float64")
        try:
            numbers = values_of(path.name, name, table, variable, None)
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
    if problems or len(columns) == 1:
        known = [v.name for v in variables.values() if v.causality == "input"]
        wrong = [f"{path.name}: the FMU has no input '{name}'.{suggest(name, known)}" for name in unknown]
        raise DescriptionError([*problems, *wrong] or [f"{path.name}: no input in it that can be set."])
    if unknown:
        names = ", ".join(f"'{name}'" for name in unknown)
        notes.append(f"{path.name}: the FMU has no input {names}: not set.")
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
