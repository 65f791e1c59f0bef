"""The plan of a sweep: which values, which runs, which figures."""

from __future__ import annotations

import hashlib
import itertools
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np

from ..errors import DescriptionError, suggest
from ..fmu.places import shipped_file
from ..fmu.text import read_toml
from ..fmu.variables import Variable
from ..result import metrics as figures
from ..result.result import Result
from ..result.summary import tracking
from ..system.system import System, read_system
from ..system.values import start_value

METHODS = ("grid", "list", "latin", "sobol")


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
    """The figures of a run; those of ``result.summary.tracking`` if none are named."""
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
    document = read_toml(path)
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
    try:
        system = read_system(Path(folder) / document["system"], fmus=fmus, **experiment)
    except DescriptionError as error:
        raise DescriptionError([*problems, *error.problems]) from None
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
