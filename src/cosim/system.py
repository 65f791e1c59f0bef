"""A system: FMU instances, their start values and connections, and the experiment, read and checked.

A system file is TOML::

    base = "common.toml"                      # optional: a file of the same folder that this one completes
    description = "Two lags in a row"
    connections = [
        "source.position -> controller.position_ref",
        { from = "controller.command", to = "plant.command", factor = 628.3, offset = 0.0 },
    ]

    [experiment]
    start_time = 0.0
    stop_time = 10.0
    step_size = 1e-4
    order = ["source", "controller", "plant"]  # or "sequential" (default: derived), or "parallel"
    tolerance = 1e-6                           # optional, told to every FMU

    [instances.plant]
    fmu = "BallscrewStage"                     # in the FMU folder; or a path to an .fmu, relative to this file
    start = { m = 62.4, kind = "sine", "nct.error" = [0.0, 1e-6] }
    step_multiple = 1                          # doStep every this many communication steps

    [record]
    variables = ["plant.position", "controller.*"]   # default: all outputs of all instances
    decimation = 1

Everything that can be wrong is found here, before any FMU is started, and reported at once. Times and step sizes
stay decimals, so that ``0.1`` divides ``1.0``.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from decimal import Decimal, InvalidOperation
from fractions import Fraction
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import Any, Literal, cast

from .errors import DescriptionError, suggest
from .fmu import Fmu, Value, Variable, missing_binary, read_fmu
from .units import conversion, same_unit

Order = Literal["sequential", "parallel"] | tuple[str, ...]
FMU_FOLDER = Path("build") / "fmus" / "native"

_PACKAGE = Path(__file__).resolve().parent
PREBUILT = _PACKAGE / "prebuilt"
"""FMUs that come with the installed package; a checkout has none there."""

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_ARROW = re.compile(r"\s*(\S+)\s*->\s*(\S+)\s*")
_WIDER = {
    "Real": ("Real", "Integer", "Enumeration", "Boolean"),
    "Integer": ("Integer", "Enumeration", "Boolean"),
    "Boolean": ("Boolean",),
    "Enumeration": ("Enumeration",),
}
"""Types of outputs that an input of a type takes; what loses nothing is converted."""


@dataclass(frozen=True)
class Instance:
    """One use of an FMU in a system."""

    name: str
    fmu: Fmu
    start: Mapping[str, Value]
    step_multiple: int


@dataclass(frozen=True)
class Connection:
    """``target = factor*source + offset``; both ends are (instance, variable)."""

    source: tuple[str, str]
    target: tuple[str, str]
    factor: float = 1.0
    offset: float = 0.0
    converts: bool = False
    """Whether a factor is given, so that the units of the ends may differ."""

    def __str__(self) -> str:
        return f"{'.'.join(self.source)} -> {'.'.join(self.target)}"


@dataclass(frozen=True)
class System:
    """A checked system; ``read_system`` and ``make_system`` create it."""

    name: str
    description: str
    instances: tuple[Instance, ...]
    connections: tuple[Connection, ...]
    start_time: Decimal
    stop_time: Decimal
    step_size: Decimal
    steps: int
    order: Order
    visits: tuple[str, ...]
    """Instances in the order in which inputs are set and feedthrough is evaluated at a communication point."""
    tolerance: float | None
    record: tuple[tuple[str, str], ...]
    decimation: int
    notes: tuple[str, ...]
    """What is legal but worth knowing."""
    digest: str
    """SHA-256 of everything that decides the results: FMUs, start values, connections, experiment."""
    document: Mapping[str, Any] = field(repr=False)
    folder: Path = field(repr=False)
    fmus: Path | None = field(repr=False)

    @property
    def parallel(self) -> bool:
        """Whether all instances step with the outputs of the previous communication point (Jacobi)."""
        return self.order == "parallel"

    def instance(self, name: str) -> Instance:
        """The instance of that name. Raises DescriptionError."""
        for instance in self.instances:
            if instance.name == name:
                return instance
        raise DescriptionError(f"{self.name}: no instance '{name}'.{suggest(name, (i.name for i in self.instances))}")

    def variable(self, instance: str, name: str) -> Variable:
        """A variable of an instance. Raises DescriptionError."""
        fmu = self.instance(instance).fmu
        if name not in fmu.variables:
            raise DescriptionError(f"{self.name}: {fmu.name} has no variable '{name}'.{suggest(name, fmu.variables)}")
        return fmu.variables[name]

    def changed(
        self,
        overrides: Mapping[str, object] | None = None,
        *,
        stop_time: float | str | Decimal | None = None,
        step_size: float | str | Decimal | None = None,
        order: str | Sequence[str] | None = None,
        record: Sequence[str] | None = None,
        decimation: int | None = None,
    ) -> System:
        """The same system with other start values (``{"plant.m": 70.0}``) or another experiment, checked again."""
        document, problems = _changed(
            self.document,
            self.name,
            overrides or {},
            stop_time=stop_time,
            step_size=step_size,
            order=order,
            record=record,
            decimation=decimation,
        )
        experiment = (stop_time, step_size, order, record, decimation)
        plain = overrides and not problems and all(value is None for value in experiment)
        if plain and (starts := self._starts(overrides or {})) is not None:
            return self._with_starts(starts, document)
        return _Reader(document, self.name, self.folder, self.fmus, problems).system()

    def _starts(self, overrides: Mapping[str, object]) -> dict[str, dict[str, Value]] | None:
        """Start values by instance, if they are right and the rest of the system cannot depend on them."""
        starts: dict[str, dict[str, Value]] = {}
        for path, given in overrides.items():
            name, _, variable_name = path.partition(".")
            variable = self.instance(name).fmu.variables.get(variable_name)
            if variable is None or variable_name == "T_s" or not variable.settable:
                return None
            value, _ = start_value(variable, given)
            if value is None:
                return None
            starts.setdefault(name, {})[variable_name] = value
        return starts

    def _with_starts(self, starts: Mapping[str, Mapping[str, Value]], document: Mapping[str, Any]) -> System:
        """What ``make_system`` gives for ``document``, without checking again what start values cannot change."""
        instances = {
            i.name: replace(i, start={**i.start, **starts[i.name]}) if i.name in starts else i for i in self.instances
        }
        times = (self.start_time, self.stop_time, self.step_size)
        digest = _digest(instances, self.connections, times, self.order, self.tolerance, self.record, self.decimation)
        return replace(self, instances=tuple(instances.values()), digest=digest, document=document)


def read_system(
    path: str | Path,
    overrides: Mapping[str, object] | None = None,
    *,
    fmus: str | Path | None = None,
    stop_time: float | str | Decimal | None = None,
    step_size: float | str | Decimal | None = None,
    order: str | Sequence[str] | None = None,
    record: Sequence[str] | None = None,
    decimation: int | None = None,
) -> System:
    """Read and check the system at ``path`` (.toml, .ssp, .ssd); ``fmus`` is the folder of FMUs given by name.

    A system that comes with cosim can be given by name, such as "shams2010/fsmc_5sin".
    ``overrides`` replaces start values (``{"plant.m": 70.0}``), the other arguments the experiment's.
    Raises DescriptionError with every problem found.
    """
    path = shipped_file(path)
    loaded, folder = _read_ssp(path) if path.suffix.lower() in (".ssp", ".ssd") else (_load(path, ()), path.parent)
    document, problems = _changed(
        loaded,
        path.name,
        overrides or {},
        stop_time=stop_time,
        step_size=step_size,
        order=order,
        record=record,
        decimation=decimation,
    )
    return _Reader(document, path.name, folder, None if fmus is None else Path(fmus), problems).system()


def make_system(
    document: Mapping[str, Any], *, name: str = "system", folder: str | Path = ".", fmus: str | Path | None = None
) -> System:
    """Check a system given as nested tables, as a system file holds them. ``folder`` is where its paths start."""
    return _Reader(document, name, Path(folder), None if fmus is None else Path(fmus), []).system()


def parse_value(text: str) -> object:
    """A value typed at a prompt: what TOML reads it as, else the text itself (an enumeration item)."""
    try:
        return tomllib.loads(f"value = {text}", parse_float=Decimal)["value"]
    except tomllib.TOMLDecodeError:
        return text


def _read_ssp(path: Path) -> tuple[dict[str, Any], Path]:
    from .ssp import read_ssp  # reads XML schemas: only where one is needed

    return read_ssp(path)


def _load(path: Path, parents: tuple[Path, ...]) -> dict[str, Any]:
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        near = suggest(path.name, (p.name for p in path.parent.glob("*.toml"))) if path.parent.is_dir() else ""
        raise DescriptionError(f"{path}: no such file.{near}") from None
    except (OSError, UnicodeDecodeError) as error:
        raise DescriptionError(f"{path}: cannot be read ({error}).") from None
    try:
        document = tomllib.loads(text, parse_float=Decimal)
    except tomllib.TOMLDecodeError as error:
        raise DescriptionError(f"{path.name}: not valid TOML: {error}.") from None
    base = document.pop("base", None)
    if base is None:
        return document
    if not isinstance(base, str) or Path(base).name != base:
        raise DescriptionError(f"{path.name}: base: give the name of a file in the same folder.")
    parent = path.parent / base
    if parent.resolve() in (path.resolve(), *(p.resolve() for p in parents)):
        raise DescriptionError(f"{path.name}: base: '{base}' leads back to this file.")
    return _merged(_load(parent, (*parents, path)), document)


def _merged(under: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    result = dict(under)
    for key, value in over.items():
        old = result.get(key)
        if isinstance(old, Mapping) and isinstance(value, Mapping):
            result[key] = _merged(cast("Mapping[str, Any]", old), cast("Mapping[str, Any]", value))
        else:
            result[key] = value
    return result


def _changed(
    document: Mapping[str, Any], name: str, overrides: Mapping[str, object], **experiment: object
) -> tuple[dict[str, Any], list[str]]:
    """``document`` with start values and experiment replaced, and problems: what cannot be placed."""
    instances = document.get("instances")
    known = list(cast("Mapping[str, Any]", instances)) if isinstance(instances, Mapping) else []
    problems: list[str] = []
    starts: dict[str, dict[str, object]] = {}
    for path, value in overrides.items():
        instance, dot, variable = path.partition(".")
        if not dot or not variable:
            problems.append(f"{name}: value for '{path}': write INSTANCE.VARIABLE, such as plant.m.")
        elif instance not in known:
            problems.append(f"{name}: value for {path}: no instance '{instance}'.{suggest(instance, known)}")
        else:
            starts.setdefault(instance, {})[variable] = value
    over: dict[str, Any] = {}
    if starts:
        tables = dict(cast("Mapping[str, Any]", instances))
        for instance, values in starts.items():
            table = tables[instance]
            if isinstance(table, Mapping):
                old = cast("Mapping[str, Any]", table)
                start = old.get("start", {})
                flat = dict(_flat(cast("Mapping[str, Any]", start))) if isinstance(start, Mapping) else {}
                tables[instance] = {**old, "start": {**flat, **values}}
        document = {**document, "instances": tables}
    record = {
        key: value
        for key, value in (("variables", experiment.pop("record")), ("decimation", experiment.pop("decimation")))
        if value is not None
    }
    if record:
        over["record"] = record
    given = {key: _decimal(value) or value for key, value in experiment.items() if value is not None}
    if given:
        over["experiment"] = given
    return _merged(document, over), problems


def _flat(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted names and values: TOML reads ``nct.error = [...]`` as a table in a table."""
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from _flat(cast("Mapping[str, Any]", value), f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def _decimal(value: object) -> Decimal | None:
    """``value`` as a decimal if it is a number; floats as they are written."""
    if isinstance(value, bool):
        return None
    if isinstance(value, Decimal):
        return value
    if isinstance(value, int):
        return Decimal(value)
    try:
        if isinstance(value, str):
            return Decimal(value)
        return Decimal(repr(float(cast(Any, value))))
    except (InvalidOperation, TypeError, ValueError):
        return None


def _show(value: object) -> str:
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, bool):
        return str(value).lower()
    return str(value)


def _unit(variable: Variable) -> str:
    return f" {variable.unit}" if variable.unit and variable.unit != "1" else ""


class _Reader:
    """Turns a document into a System, collecting problems instead of stopping at the first."""

    def __init__(
        self, document: Mapping[str, Any], name: str, folder: Path, fmus: Path | None, problems: Sequence[str]
    ) -> None:
        self.document = document
        self.name = name
        self.folder = folder
        self.fmus = fmus
        self.problems = list(problems)
        self.notes: list[str] = []

    def problem(self, where: str, text: str) -> None:
        self.problems.append(f"{self.name}: {where}: {text}")

    def note(self, where: str, text: str) -> None:
        self.notes.append(f"{where}: {text}")

    def system(self) -> System:
        self.known_keys("", self.document, ("description", "connections", "experiment", "instances", "record"))
        instances = self.instances()
        start, stop, step, steps, order, tolerance = self.experiment(instances)
        connections = self.connections(instances)
        if step is not None:
            self.steps(instances, step, steps)
        record, decimation = self.record(instances)
        if decimation > steps > 0:
            self.problem("record.decimation", f"{decimation} is more than the {steps} steps of the run. Take less.")
        visits = tuple(instances)
        if not self.problems:
            visits = self.visits(instances, connections, order)
        if self.problems or start is None or stop is None or step is None:
            raise DescriptionError(self.problems)
        description = str(self.document.get("description", ""))
        return System(
            name=self.name,
            description=description,
            instances=tuple(instances.values()),
            connections=connections,
            start_time=start,
            stop_time=stop,
            step_size=step,
            steps=steps,
            order=order,
            visits=visits,
            tolerance=tolerance,
            record=record,
            decimation=decimation,
            notes=tuple(self.notes),
            digest=_digest(instances, connections, (start, stop, step), order, tolerance, record, decimation),
            document=self.document,
            folder=self.folder,
            fmus=self.fmus,
        )

    # Tables and values

    def known_keys(self, where: str, table: Mapping[str, Any], known: Sequence[str]) -> None:
        for key in table:
            if key not in known:
                path = f"{where}.{key}" if where else key
                self.problem(path, f"unknown key.{suggest(key, known)}")

    def table(self, key: str) -> Mapping[str, Any]:
        value = self.document.get(key, {})
        if isinstance(value, Mapping):
            return cast("Mapping[str, Any]", value)
        self.problem(key, f"must be a table: write [{key}].")
        return {}

    def integer(self, where: str, value: object) -> int:
        """A count of at least 1."""
        number = _decimal(value) if not isinstance(value, str) else None
        if number is None or not number.is_finite() or number != number.to_integral_value() or number < 1:
            self.problem(where, f"{_show(value)} is not a count. Give a whole number of at least 1.")
            return 1
        return int(number)

    # Experiment

    def experiment(
        self, instances: Mapping[str, Instance]
    ) -> tuple[Decimal | None, Decimal | None, Decimal | None, int, Order, float | None]:
        table = self.table("experiment")
        self.known_keys("experiment", table, ("start_time", "stop_time", "step_size", "order", "tolerance"))
        before = len(self.problems)
        start = self.seconds(table, "start_time", Decimal(0))
        stop = self.seconds(table, "stop_time", None)
        step = self.seconds(table, "step_size", None)
        if step is not None and step <= 0:
            self.problem("experiment.step_size", f"{step} s must be positive.")
        if start is not None and stop is not None and stop <= start:
            self.problem("experiment.stop_time", f"{stop} s must be after start_time = {start} s.")
        steps = 0
        if len(self.problems) == before and start is not None and stop is not None and step is not None:
            ratio = Fraction(stop - start) / Fraction(step)
            if ratio.denominator == 1:
                steps = int(ratio)
            else:
                whole = Decimal(math.floor(ratio))
                self.problem(
                    "experiment.step_size",
                    f"{step} s does not divide stop_time - start_time = {stop - start} s into whole steps "
                    f"({float(ratio):.6g}). Change step_size, or take stop_time = "
                    + (f"{start + whole * step} or " if whole > 0 else "")
                    + f"{start + (whole + 1) * step}.",
                )
        tolerance = None
        if "tolerance" in table:
            number = _decimal(table["tolerance"])
            if number is None or not number.is_finite() or not 0 < number < 1:
                self.problem("experiment.tolerance", f"{_show(table['tolerance'])}: give a number between 0 and 1.")
            else:
                tolerance = float(number)
        return start, stop, step, steps, self.order(table.get("order", "sequential"), instances), tolerance

    def seconds(self, table: Mapping[str, Any], key: str, default: Decimal | None) -> Decimal | None:
        where = f"experiment.{key}"
        if key not in table:
            if default is None:
                self.problem(where, f"missing. Give it in seconds, such as {key} = 1.0.")
            return default
        number = None if isinstance(table[key], str) else _decimal(table[key])
        if number is None or not number.is_finite():
            self.problem(where, f"{_show(table[key])} is not a finite number of seconds.")
            return None
        return number

    def order(self, value: object, instances: Mapping[str, Instance]) -> Order:
        where = "experiment.order"
        if value == "parallel":
            return "parallel"
        if value == "sequential":
            return "sequential"
        if isinstance(value, str):
            self.problem(where, f"'{value}' is no order.{suggest(value, ('parallel', 'sequential'))}")
            return "sequential"
        if not isinstance(value, Sequence) or not all(isinstance(name, str) for name in cast("Sequence[Any]", value)):
            self.problem(where, 'give "sequential", "parallel" or a list of all instances.')
            return "sequential"
        names = tuple(cast("Sequence[str]", value))
        wanted = self.table("instances")
        for name in dict.fromkeys(names):
            if name not in wanted:
                self.problem(where, f"no instance '{name}'.{suggest(name, wanted)}")
            elif names.count(name) > 1:
                self.problem(where, f"instance '{name}' is named {names.count(name)} times. Name it once.")
        missing = [name for name in wanted if name not in names]
        if missing:
            self.problem(where, f"instance {', '.join(missing)} is missing. Name every instance.")
        return names

    # Instances

    def instances(self) -> dict[str, Instance]:
        tables = self.table("instances")
        if not tables:
            self.problem("instances", 'none given. Write [instances.NAME] with fmu = "...".')
        result: dict[str, Instance] = {}
        used: dict[Path, str] = {}
        for name, table in tables.items():
            where = f"instances.{name}"
            if not _NAME.fullmatch(name):
                self.problem(where, "an instance's name is made of letters, digits and _, and starts with no digit.")
                continue
            if not isinstance(table, Mapping):
                self.problem(where, f"must be a table: write [instances.{name}].")
                continue
            items = cast("Mapping[str, Any]", table)
            self.known_keys(where, items, ("fmu", "start", "step_multiple"))
            multiple = self.integer(f"{where}.step_multiple", items.get("step_multiple", 1))
            fmu = self.fmu(where, items.get("fmu"))
            if fmu is None:
                continue
            if fmu.once_per_process and fmu.path in used:
                self.problem(where, f"{fmu.name} allows one instance a process; {used[fmu.path]} is one already.")
            used[fmu.path] = name
            result[name] = Instance(name, fmu, self.start(where, fmu, items.get("start", {})), multiple)
        return result

    def fmu(self, where: str, value: object) -> Fmu | None:
        where = f"{where}.fmu"
        if not isinstance(value, str) or not value:
            self.problem(where, "missing. Give the name of an FMU or a path to an .fmu file.")
            return None
        try:
            fmu = read_fmu(self.fmu_path(value))
        except DescriptionError as error:
            for problem in error.problems:
                self.problem(where, problem)
            return None
        missing = missing_binary(fmu)
        if missing:
            self.problem(where, f"{fmu.path.name}: {missing}")
            return None
        return fmu

    def fmu_path(self, value: str) -> Path:
        if value.endswith(".fmu") or "/" in value or "\\" in value:
            return self.folder / value
        folder = self.fmus if self.fmus is not None else find_fmus(self.folder)
        if folder is None:
            raise DescriptionError(
                f"no FMU folder found for '{value}': there is no {FMU_FOLDER.as_posix()} in or above "
                f"{self.folder.resolve()}. Build the FMUs, or name the folder with --fmus."
            )
        path = folder / f"{value}.fmu"
        if not path.is_file():
            known = [p.stem for p in folder.glob("*.fmu")] if folder.is_dir() else []
            raise DescriptionError(
                f"no FMU '{value}' in {folder}.{suggest(value, known)}"
                + ("" if known else " The folder has no FMUs: build them, or name another with --fmus.")
            )
        return path

    def start(self, where: str, fmu: Fmu, value: object) -> dict[str, Value]:
        where = f"{where}.start"
        if not isinstance(value, Mapping):
            self.problem(where, "must be a table, such as start = { m = 62.4 }.")
            return {}
        result: dict[str, Value] = {}
        for name, given in _flat(cast("Mapping[str, Any]", value)):
            if name in fmu.variables:
                self.one_start(f"{where}.{name}", fmu.variables[name], given, result)
            elif name in fmu.arrays:
                self.array_start(f"{where}.{name}", fmu, fmu.arrays[name], given, result)
            else:
                known = [n for n, v in fmu.variables.items() if v.settable and not n.endswith("]")] + list(fmu.arrays)
                self.problem(f"{where}.{name}", f"{fmu.name} has no variable '{name}'.{suggest(name, known)}")
        return result

    def array_start(
        self, where: str, fmu: Fmu, elements: Sequence[str], given: object, result: dict[str, Value]
    ) -> None:
        if isinstance(given, str) or not isinstance(given, Iterable):
            self.problem(where, f"{_show(given)} is no list: {fmu.name} has an array of {len(elements)} elements here.")
            return
        values = list(cast("Iterable[object]", given))
        if len(values) != len(elements):
            self.problem(where, f"{len(values)} values for an array of {len(elements)} elements.")
            return
        for i, (element, item) in enumerate(zip(elements, values, strict=True)):
            self.one_start(f"{where}[{i + 1}]", fmu.variables[element], item, result)

    def one_start(self, where: str, variable: Variable, given: object, result: dict[str, Value]) -> None:
        if not variable.settable:
            remedy = "Only parameters, inputs and initial states can be set."
            self.problem(where, f"a {variable.variability} {variable.causality} cannot be set. {remedy}")
            return
        value, problem = start_value(variable, given)
        if problem:
            self.problem(where, problem)
        elif value is not None:
            result[variable.name] = value

    # Connections

    def connections(self, instances: Mapping[str, Instance]) -> tuple[Connection, ...]:
        value = self.document.get("connections", [])
        if isinstance(value, str) or not isinstance(value, Sequence):
            self.problem("connections", 'must be a list, such as ["a.y -> b.u"].')
            return ()
        result: list[Connection] = []
        taken: dict[tuple[str, str], Connection] = {}
        for number, item in enumerate(cast("Sequence[object]", value), 1):
            connection = self.connection(number, item)
            if connection is None:
                continue
            if self.ends(connection, instances):
                result.append(connection)
            if connection.target in taken:
                self.problem(
                    f"connection {connection}",
                    f"input '{'.'.join(connection.target)}' is connected already, to "
                    f"'{'.'.join(taken[connection.target].source)}'. Keep one.",
                )
            taken.setdefault(connection.target, connection)
        return tuple(result)

    def connection(self, number: int, item: object) -> Connection | None:
        where = f"connections, number {number}"
        factor, offset, converts = 1.0, 0.0, False
        if isinstance(item, str):
            match = _ARROW.fullmatch(item)
            if match is None:
                self.problem(where, f"cannot read '{item}'. Write it like 'controller.command -> plant.command'.")
                return None
            ends = match[1], match[2]
        elif isinstance(item, Mapping):
            table = cast("Mapping[str, Any]", item)
            self.known_keys(where, table, ("from", "to", "factor", "offset"))
            ends = table.get("from"), table.get("to")
            if not isinstance(ends[0], str) or not isinstance(ends[1], str):
                self.problem(where, 'give both ends: { from = "a.y", to = "b.u", factor = 1.0, offset = 0.0 }.')
                return None
            numbers = {key: _decimal(table.get(key, default)) for key, default in (("factor", 1), ("offset", 0))}
            for key, numeric in numbers.items():
                if numeric is None or not numeric.is_finite() or isinstance(table.get(key), str):
                    self.problem(f"{where}, {key}", f"{_show(table.get(key))} is not a finite number.")
                    return None
            factor, offset = float(cast(Decimal, numbers["factor"])), float(cast(Decimal, numbers["offset"]))
            converts = "factor" in table
        else:
            self.problem(where, "write a text 'a.y -> b.u' or a table { from = ..., to = ... }.")
            return None
        source, target = cast("tuple[str, str]", ends)
        if "." not in source or "." not in target:
            self.problem(where, f"'{source} -> {target}': write INSTANCE.VARIABLE at both ends.")
            return None
        a, _, b = source.partition(".")
        c, _, d = target.partition(".")
        return Connection((a, b), (c, d), factor, offset, converts)

    def ends(self, connection: Connection, instances: Mapping[str, Instance]) -> bool:
        where = f"connection {connection}"
        before = len(self.problems)
        found: list[Variable] = []
        declared = self.table("instances")
        for (name, variable), causality in ((connection.source, "output"), (connection.target, "input")):
            if name not in instances:
                if name not in declared:
                    self.problem(where, f"no instance '{name}'.{suggest(name, declared)}")
                continue
            fmu = instances[name].fmu
            known = fmu.outputs if causality == "output" else fmu.inputs
            if variable in known:
                found.append(fmu.variables[variable])
            elif variable in fmu.variables:
                what = fmu.variables[variable].causality
                self.problem(
                    where,
                    f"'{name}.{variable}' is of causality {what}; the {'left' if causality == 'output' else 'right'} "
                    f"end must be an {causality}." + (f" Known: {', '.join(known)}." if 0 < len(known) <= 12 else ""),
                )
            else:
                self.problem(where, f"{fmu.name} has no {causality} '{variable}'.{suggest(variable, known)}")
        if len(self.problems) > before or len(found) < 2:
            return False
        self.types_and_units(where, connection, found[0], found[1], instances)
        return len(self.problems) == before

    def types_and_units(
        self,
        where: str,
        connection: Connection,
        source: Variable,
        target: Variable,
        instances: Mapping[str, Instance],
    ) -> None:
        if source.type not in _WIDER.get(target.type, ()):
            self.problem(where, f"an output of type {source.type} cannot feed an input of type {target.type}.")
            return
        transformed = connection.factor != 1.0 or connection.offset != 0.0
        if transformed and target.type != "Real":
            self.problem(where, f"factor and offset need an input of type Real, not {target.type}.")
        if connection.converts or source.unit is None or target.unit is None:
            return
        one, other = instances[connection.source[0]].fmu, instances[connection.target[0]].fmu
        if _same_unit(one, source.unit, other, target.unit):
            return
        self.problem(
            where,
            f"unit {source.unit} does not match {target.unit}. "
            + _unit_remedy(source.unit, target.unit, ".".join(connection.source), ".".join(connection.target)),
        )

    # Steps and samples

    def steps(self, instances: Mapping[str, Instance], step: Decimal, steps: int) -> None:
        for name, instance in instances.items():
            where = f"instances.{name}"
            if steps and steps % instance.step_multiple:
                self.problem(
                    f"{where}.step_multiple", f"{instance.step_multiple} does not divide the {steps} steps of the run."
                )
            sampling = self.sampling_time(instance)
            if sampling is None:
                continue
            own = step * instance.step_multiple
            ratio = Fraction(own) / Fraction(sampling)
            if ratio.denominator != 1 and ratio.numerator != 1:
                self.problem(
                    where,
                    f"T_s = {sampling} s against a communication step of {own} s: neither is a multiple of the other, "
                    "so samples would fall between communication points. Change start.T_s, step_size or step_multiple.",
                )

    def sampling_time(self, instance: Instance) -> Decimal | None:
        """``T_s`` of a sampled controller: a parameter of that name in seconds, of an FMU with inputs."""
        variable = instance.fmu.variables.get("T_s")
        if variable is None or variable.causality != "parameter" or variable.unit != "s" or not instance.fmu.inputs:
            return None
        given = instance.start.get("T_s")
        value = _decimal(variable.start_text if given is None else given)
        return value if value is not None and value.is_finite() and value > 0 else None

    # Record

    def record(self, instances: Mapping[str, Instance]) -> tuple[tuple[tuple[str, str], ...], int]:
        table = self.table("record")
        self.known_keys("record", table, ("variables", "decimation"))
        decimation = self.integer("record.decimation", table.get("decimation", 1))
        patterns = table.get("variables")
        if patterns is None:
            chosen = [(i.name, v) for i in instances.values() for v in i.fmu.outputs if _numeric(i.fmu.variables[v])]
            return tuple(chosen), decimation
        if isinstance(patterns, str) or not isinstance(patterns, Sequence):
            self.problem("record.variables", 'must be a list, such as ["plant.position", "controller.*"].')
            return (), decimation
        result: dict[tuple[str, str], None] = {}
        for pattern in cast("Sequence[object]", patterns):
            for entry in self.recorded(pattern, instances):
                result[entry] = None
        return tuple(result), decimation

    def recorded(self, pattern: object, instances: Mapping[str, Instance]) -> Iterator[tuple[str, str]]:
        where = "record.variables"
        if not isinstance(pattern, str):
            self.problem(where, f"{_show(pattern)} is not a text.")
            return
        if "*" not in pattern and "?" not in pattern:
            name, _, variable = pattern.partition(".")
            if name not in instances:
                declared = self.table("instances")
                if name not in declared:
                    self.problem(where, f"'{pattern}': no instance '{name}'.{suggest(name, declared)}")
                return
            fmu = instances[name].fmu
            if variable not in fmu.variables:
                known = [v for v in fmu.variables if not v.endswith("]")]
                self.problem(where, f"'{pattern}': {fmu.name} has no variable '{variable}'.{suggest(variable, known)}")
            elif not _numeric(fmu.variables[variable]):
                self.problem(where, f"'{pattern}' is a String; only numbers are recorded.")
            else:
                yield name, variable
            return
        expression = re.compile(re.escape(pattern).replace(r"\*", ".*").replace(r"\?", "."))
        found = False
        for name, instance in instances.items():
            for variable in instance.fmu.variables.values():
                varies = variable.causality in ("input", "output", "local") and variable.variability != "constant"
                if varies and _numeric(variable) and expression.fullmatch(f"{name}.{variable.name}"):
                    found = True
                    yield name, variable.name
        if not found and instances:
            self.problem(where, f"'{pattern}' matches no input, output or local variable.")

    # Order of evaluation

    def visits(
        self, instances: Mapping[str, Instance], connections: Sequence[Connection], order: Order
    ) -> tuple[str, ...]:
        """In which order instances get their inputs and give their feedthrough outputs at a communication point."""
        connected = {connection.target: connection.source for connection in connections}
        outputs = _feedthrough(instances, connected)
        graph = {**outputs, **{target: (source,) for target, source in connected.items()}}
        try:
            TopologicalSorter(graph).prepare()
        except CycleError as error:
            if order == "parallel":
                return tuple(instances)
            loop = " -> ".join(".".join(end) for end in cast("list[tuple[str, str]]", error.args[1]))
            self.problem(
                "connections",
                f"algebraic loop: {loop}. Each depends directly on the one before; put a component without "
                'feedthrough between, or take order = "parallel" (one step of delay).',
            )
            return tuple(instances)
        if not isinstance(order, tuple):
            return _evaluation(list(instances), outputs, connected)
        for connection in connections:
            source, target = connection.source, connection.target
            if source in outputs and order.index(source[0]) >= order.index(target[0]):
                self.note(
                    f"connection {connection}",
                    f"one step of delay: {source[0]} comes after {target[0]} in the order, and its output depends "
                    f"directly on its inputs. Put {source[0]} before {target[0]}.",
                )
        return order


def find_fmus(folder: Path) -> Path | None:
    """Where FMUs given by name are: ``build/fmus/native`` in or above ``folder`` or the working directory, else the
    FMUs that come with the package. None if there are none.
    """
    for start in (folder.resolve(), Path.cwd()):
        for place in (start, *start.parents):
            if (place / FMU_FOLDER).is_dir():
                return place / FMU_FOLDER
    return PREBUILT if PREBUILT.is_dir() else None


def study_folders() -> tuple[Path, ...]:
    """Where studies are looked for: beside the package's source tree, then inside the installed package."""
    return (_PACKAGE.parents[1] / "studies", _PACKAGE / "studies")


def shipped_file(path: str | Path) -> Path:
    """``path``; if there is no such file, the one of that name which comes with cosim, if there is one.

    The name is that in the folder ``studies``: ``shams2010/fsmc_5sin`` or ``studies/shams2010/fsmc_5sin.toml``.
    """
    path = Path(path)
    name = path.relative_to("studies") if path.is_relative_to("studies") else path
    places = () if path.exists() or path.is_absolute() else study_folders()
    candidates = (place / f"{name.as_posix()}{ending}" for place in places for ending in ("", ".toml"))
    return next(filter(Path.is_file, candidates), path)


def shipped_systems() -> dict[str, Path]:
    """System files that come with the project: ``study/system`` -> path."""
    found: dict[str, Path] = {}
    for place in study_folders():
        for path in sorted(place.glob("*/*.toml")):
            found.setdefault(f"{path.parent.name}/{path.stem}", path)
    return found


def _numeric(variable: Variable) -> bool:
    return variable.type != "String"


def start_value(variable: Variable, given: object) -> tuple[Value | None, str]:
    """The start value for ``variable``, or what is wrong with it."""
    kind, unit = variable.type, _unit(variable)
    if kind == "String":
        return (given, "") if isinstance(given, str) else (None, f"{_show(given)} is not a text. Write it in quotes.")
    if kind == "Boolean":
        return (given, "") if isinstance(given, bool) else (None, f"{_show(given)}: give true or false.")
    if kind == "Enumeration" and isinstance(given, str):
        if given in variable.items:
            return variable.items[given], ""
        return None, f"'{given}' is no item of this enumeration.{suggest(given, variable.items)}"
    number = None if isinstance(given, str) else _decimal(given)
    if number is None:
        return None, f"{_show(given)} is not a number." + (f" The unit is {variable.unit}." if unit else "")
    if not number.is_finite() or not math.isfinite(float(number)):
        return None, f"{_show(given)} is not finite. Give a number."
    if kind in ("Integer", "Enumeration"):
        if number != number.to_integral_value():
            return None, f"{_show(given)} is not a whole number."
        if not -(2**31) <= number < 2**31:
            return None, f"{_show(given)} does not fit 32 bits."
        if variable.items and int(number) not in variable.items.values():
            return None, f"{_show(given)} is no item of this enumeration.{suggest('', variable.items)}"
    if variable.min is not None and number < Decimal(repr(variable.min)):
        return None, f"{_show(given)}{unit} is below its minimum {variable.min:g}{unit}."
    if variable.max is not None and number > Decimal(repr(variable.max)):
        return None, f"{_show(given)}{unit} is above its maximum {variable.max:g}{unit}."
    return (float(number) if kind == "Real" else int(number)), ""


def _same_unit(one: Fmu, unit: str, other: Fmu, other_unit: str) -> bool:
    if unit == other_unit:
        return True
    try:
        return same_unit(unit, other_unit)
    except DescriptionError:
        # A unit this package cannot read: compare what the two files state about it.
        a, b = one.base_units.get(unit), other.base_units.get(other_unit)
        return a is not None and b is not None and a[1:] == b[1:] and math.isclose(a[0], b[0], rel_tol=1e-12)


def _unit_remedy(unit: str, other: str, source: str, target: str) -> str:
    try:
        factor = f"{conversion(unit, other):.12g}"
    except DescriptionError:
        factor = f"... ({other} per {unit})"
    return f'To convert, write {{ from = "{source}", to = "{target}", factor = {factor} }}.'


def _feedthrough(
    instances: Mapping[str, Instance], connected: Mapping[tuple[str, str], tuple[str, str]]
) -> dict[tuple[str, str], tuple[tuple[str, str], ...]]:
    """The outputs that depend directly on connected inputs, with these inputs."""
    outputs: dict[tuple[str, str], tuple[tuple[str, str], ...]] = {}
    for name, instance in instances.items():
        for output, inputs in instance.fmu.dependencies.items():
            wired = tuple((name, i) for i in inputs if (name, i) in connected)
            if wired:
                outputs[name, output] = wired
    return outputs


def _evaluation(
    names: Sequence[str],
    outputs: Mapping[tuple[str, str], tuple[tuple[str, str], ...]],
    connected: Mapping[tuple[str, str], tuple[str, str]],
) -> tuple[str, ...]:
    """Instances in the order of their feedthrough, which has no loop.

    An instance comes once all its inputs are known. Where two instances need each other through different
    variables, one comes twice: first for the outputs it can give.
    """
    pending = set(outputs)
    waiting = list(names)
    visits: list[str] = []

    def complete(name: str) -> bool:
        return not any(target[0] == name and source in pending for target, source in connected.items())

    def known(name: str) -> set[tuple[str, str]]:
        own = {output for output in pending if output[0] == name}
        return {output for output in own if not any(connected[needed] in pending for needed in outputs[output])}

    while waiting:
        name = next(filter(complete, waiting), None)
        if name is not None:
            waiting.remove(name)
        else:
            name = next(filter(known, waiting))
        pending -= known(name)
        visits.append(name)
    return tuple(visits)


def _digest(  # noqa: PLR0917
    instances: Mapping[str, Instance],
    connections: Sequence[Connection],
    times: Sequence[Decimal],
    order: Order,
    tolerance: float | None,
    record: Sequence[tuple[str, str]],
    decimation: int,
) -> str:
    content = {
        "instances": {
            name: [i.fmu.digest, sorted(i.start.items()), i.step_multiple] for name, i in sorted(instances.items())
        },
        "connections": sorted([str(c), c.factor, c.offset] for c in connections),
        "times": [float(time) for time in times],
        "order": order,
        "tolerance": tolerance,
        "record": record,
        "decimation": decimation,
    }
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
