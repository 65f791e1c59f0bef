"""The plan of a sweep: the values of its parameters, its runs and its figures."""

from __future__ import annotations

import hashlib
import itertools
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np

from ..errors import DescriptionError, SimulationError, shortened, suggest
from ..fmu.places import shipped_file
from ..fmu.tables import checked
from ..fmu.text import read_toml
from ..fmu.variables import Variable
from ..master.metadata import result_columns, system_metadata
from ..result import metrics as figures
from ..result.metrics import OF_ONE_SIGNAL
from ..result.result import Result
from ..result.summary import not_finite, tracking, tracking_units
from ..system.signals import setting
from ..system.system import System, read_system
from ..system.values import start_value
from .documents import MOST_RUNS, AxisData, RunsData, SweepData

Value = float | str | bool

Point = tuple[Value, ...]


@dataclass(frozen=True)
class Metric:
    """A figure of one signal."""

    name: str
    of: str
    signal: str


def measure(result: Result, wanted: Sequence[Metric], window: tuple[float, float]) -> dict[str, float]:
    """The figures of a run within ``window`` (begin and end in s); without ``wanted``, the tracking figures.

    Raises SimulationError if a signal that a figure needs is not finite.
    """
    wrong = not_finite(result)
    if wanted:
        wrong = {name: since for name, since in wrong.items() if name in {metric.signal for metric in wanted}}
    if wrong:
        raise SimulationError("; ".join(f"{name} is not finite from {since:.9g} s on" for name, since in wrong.items()))
    if not wanted:
        return tracking(result, window)
    part = figures.window(result.time, *window)
    time = result.time[part]
    return {metric.name: OF_ONE_SIGNAL[metric.of](time, result[metric.signal][part]) for metric in wanted}


def figure_units(system: System, wanted: Sequence[Metric]) -> dict[str, str]:
    """The unit of each figure that ``measure`` gives of a run of the system, by name."""
    system = recording(system, wanted)
    columns, nothing = result_columns(system), np.empty(0)
    if not wanted:
        empty = np.empty((0, len(columns)))
        return tracking_units(Result(nothing, empty, columns, False, (), 0, {}, system_metadata(system)))
    units = {column.name: column.unit for column in columns}
    return {m.name: units[m.signal] + ("/s" if m.of == "total_variation" else "") for m in wanted}


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
    timeout: float | None = None
    """Time limit of a run in s; None if it is computed from the times of earlier runs."""

    @property
    def digest(self) -> str:
        """SHA-256 of all data that determine the results."""
        content: list[Any] = [
            self.system.digest,
            self.parameters,
            self.points,
            [vars(m) for m in self.metrics],
            self.window,
        ]
        files = sorted({file for _, file in _records(self.system, self.parameters, self.points)})
        if files:
            folder = Path(self.system.folder)
            content.append([hashlib.sha256((folder / file).read_bytes()).hexdigest() for file in files])
        return hashlib.sha256(json.dumps(content).encode()).hexdigest()


# The sweep file


def read_sweep(path: str | Path, *, fmus: str | Path | None = None) -> Sweep:
    """Read and check a sweep file. Raises DescriptionError with every problem found."""
    path = shipped_file(path)
    return make_sweep(read_toml(path), name=path.name, folder=path.parent, fmus=fmus)


RUN_COLUMNS = ("run", "seconds", "error")
"""Columns of every data set of a sweep: neither parameters nor figures."""


def make_sweep(
    document: Mapping[str, Any], *, name: str = "sweep", folder: str | Path = ".", fmus: str | Path | None = None
) -> Sweep:
    """Check a sweep given as nested tables, as a sweep file holds them. Raises DescriptionError with all problems."""
    data, problems = checked(document, SweepData, name)
    if data is None:
        raise DescriptionError(problems)
    system = system_of(data, folder, fmus, problems)
    points: tuple[Point, ...] = ()
    try:
        variables = {path: variable_of(system, path) for path in data.parameters}
        points = _points(data, variables)
        for path, file in _records(system, tuple(data.parameters), points):
            system.changed({path: file})  # raises an error for a wrong record
    except DescriptionError as error:
        problems += [f"{name}: {problem}" for problem in error.problems]
    wanted, window, found = figures_of(data, system)
    found += [
        f"metrics.{metric.name}: the data set has a column of this name already. Take another, such as "
        f"{metric.name}_{metric.of}."
        for metric in wanted
        if metric.name in (*RUN_COLUMNS, *data.parameters)
    ]
    problems += [f"{name}: {problem}" for problem in found]
    if problems:
        raise DescriptionError(problems)
    return Sweep(
        name,
        data.description,
        recording(system, wanted),
        data.method,
        tuple(data.parameters),
        points,
        wanted,
        window,
        data.timeout,
    )


def system_of(data: RunsData, folder: str | Path, fmus: str | Path | None, problems: Sequence[str]) -> System:
    """The system that a file names, with the file's changes of its experiment.

    Raises DescriptionError with ``problems`` and all problems of the system.
    """
    try:
        return read_system(
            shipped_file(data.system, folder), fmus=fmus, **data.experiment.model_dump(exclude_none=True)
        )
    except DescriptionError as error:
        raise DescriptionError([*problems, *error.problems]) from None


def recording(system: System, wanted: Sequence[Metric]) -> System:
    """The system that also records the signals of the metrics ``wanted``."""
    needed = dict.fromkeys([*(".".join(end) for end in system.record), *(metric.signal for metric in wanted)])
    return system.changed(record=list(needed))


def variable_of(system: System, path: str) -> Variable:
    """The variable INSTANCE.VARIABLE of a system. Raises DescriptionError if it does not exist or cannot be set."""
    instance, _, variable = path.partition(".")
    signal = next((signal for signal in system.signals if signal.name == instance), None)
    found = system.variable(instance, variable) if signal is None else setting(signal, variable)
    if not found.settable:
        raise DescriptionError(f"parameters.{path}: a {found.variability} {found.causality} cannot be set.")
    return found


def _records(system: System, parameters: Sequence[str], points: Sequence[Point]) -> list[tuple[str, str]]:
    """The records that parameters name, as pairs of the parameter's path and the file."""
    names = {f"{signal.name}.file" for signal in system.signals}
    wanted = {(path, str(point[i])): None for i, path in enumerate(parameters) if path in names for point in points}
    return list(wanted)


def check_values(variables: Mapping[str, Variable], rows: Sequence[Point]) -> None:
    """Raise DescriptionError for values that the variables do not accept; the first of them are listed."""
    problems: dict[str, None] = {}
    for row in rows:
        for (path, variable), value in zip(variables.items(), row, strict=True):
            problem = start_value(variable, value)[1]
            if problem:
                problems[f"parameters.{path}: {problem}"] = None
    if problems:
        raise DescriptionError(shortened(list(problems)))


def _points(data: SweepData, variables: Mapping[str, Variable]) -> tuple[Point, ...]:
    """The parameter values of each run, checked against types and bounds."""
    if data.method in ("grid", "list"):
        axes = [_axis(path, given) for path, given in data.parameters.items()]
        if data.method == "grid":
            runs = math.prod(map(len, axes))
            if runs > MOST_RUNS:
                raise DescriptionError(f"parameters: the grid has {runs} runs; at most {MOST_RUNS} are possible.")
            rows = list(itertools.product(*axes))
        else:
            lengths = {path: len(axis) for path, axis in zip(data.parameters, axes, strict=True)}
            if len(set(lengths.values())) > 1:
                raise DescriptionError(f"parameters: a list takes equally many values of each, not {lengths}.")
            rows = list(zip(*axes, strict=True))
    else:
        shares = _shares(data.method, len(data.parameters), data.count or 1, data.seed)
        columns = [_spread(given, shares[:, i]) for i, given in enumerate(data.parameters.values())]
        rows = list(zip(*columns, strict=True))
    check_values(variables, rows)
    return tuple(rows)


def _axis(path: str, given: AxisData | list[Value]) -> list[Value]:
    """The values of a parameter of a grid or list."""
    if isinstance(given, list):
        return given
    if given.count is None:
        raise DescriptionError(f"parameters.{path}.count: missing. Give how many values, at least 1.")
    spaced = (np.geomspace if given.log else np.linspace)(given.low, given.high, given.count)
    return [float(value) for value in spaced]


def _shares(method: str, dimensions: int, count: int, seed: int) -> figures.Array:
    """``count`` points of the unit cube."""
    import warnings

    from scipy.stats import qmc as _qmc

    qmc: Any = _qmc
    engine = qmc.LatinHypercube(d=dimensions, rng=seed) if method == "latin" else qmc.Sobol(d=dimensions, rng=seed)
    with warnings.catch_warnings():
        # scipy warns that Sobol points are less balanced if their number is no power of two; the user chose the number.
        warnings.simplefilter("ignore", UserWarning)
        return cast(figures.Array, engine.random(count))


def _spread(given: AxisData | list[Value], shares: figures.Array) -> list[Value]:
    """The values of a parameter at ``shares`` (0 ... 1) of its range or list."""
    if isinstance(given, list):
        return [given[min(int(share * len(given)), len(given) - 1)] for share in shares]
    return [given.at(float(share)) for share in shares]


def figures_of(data: RunsData, system: System) -> tuple[tuple[Metric, ...], tuple[float, float], list[str]]:
    """Metrics, window and problems of a file."""
    wanted: list[Metric] = []
    window = (-math.inf, math.inf)
    problems: list[str] = []
    for name, given in data.metrics.items():
        if isinstance(given, list):
            if name != "window":
                problems.append(f'metrics.{name}: write {{ of = "rms", signal = "INSTANCE.VARIABLE" }}.')
            elif not given[0] < given[1]:
                problems.append(f"metrics.window: {given} ends before it begins.")
            else:
                window = given[0], given[1]
        elif name == "window":
            problems.append("metrics.window: give begin and end in seconds, such as [1.0, 2.0].")
        elif given.of not in OF_ONE_SIGNAL:
            problems.append(f"metrics.{name}.of: '{given.of}' is no figure.{suggest(given.of, OF_ONE_SIGNAL)}")
        else:
            try:
                signal = given.signal
                system.variable(*signal.split(".", 1)) if "." in signal else system.instance(signal)
                wanted.append(Metric(name, given.of, signal))
            except DescriptionError as error:
                problems += [f"metrics.{name}.signal: {problem}" for problem in error.problems]
    return tuple(wanted), window, problems
