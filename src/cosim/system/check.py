"""Checks a document and reports all problems at once."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from decimal import Decimal
from fractions import Fraction
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import Any, TypedDict, cast

from ..errors import DescriptionError, suggest
from ..fmu.description import Fmu, Value, Variable, missing_binary, read_fmu
from ..fmu.places import FMU_FOLDER, find_fmus
from .connections import ACCEPTED_TYPES, ARROW, is_same_unit, unit_remedy
from .order import evaluation_order, feedthrough
from .parts import Connection, Instance, Order, system_digest
from .values import decimal, flat_table, is_numeric, show_value, start_value

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")


class SystemFields(TypedDict):
    """The fields of a System, as a check finds them."""

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
    tolerance: float | None
    record: tuple[tuple[str, str], ...]
    decimation: int
    notes: tuple[str, ...]
    digest: str
    document: Mapping[str, Any]
    folder: Path
    fmus: Path | None


class SystemCheck:
    """Turns a document into the fields of a System, collecting problems instead of stopping at the first."""

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

    def fields(self) -> SystemFields:
        """The fields of the checked System. Raises DescriptionError with every problem found."""
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
        return SystemFields(
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
            digest=system_digest(instances, connections, (start, stop, step), order, tolerance, record, decimation),
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
        number = decimal(value) if not isinstance(value, str) else None
        if number is None or not number.is_finite() or number != number.to_integral_value() or number < 1:
            self.problem(where, f"{show_value(value)} is not a count. Give a whole number of at least 1.")
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
            number = decimal(table["tolerance"])
            if number is None or not number.is_finite() or not 0 < number < 1:
                self.problem(
                    "experiment.tolerance", f"{show_value(table['tolerance'])}: give a number between 0 and 1."
                )
            else:
                tolerance = float(number)
        return start, stop, step, steps, self.order(table.get("order", "sequential"), instances), tolerance

    def seconds(self, table: Mapping[str, Any], key: str, default: Decimal | None) -> Decimal | None:
        where = f"experiment.{key}"
        if key not in table:
            if default is None:
                self.problem(where, f"missing. Give it in seconds, such as {key} = 1.0.")
            return default
        number = None if isinstance(table[key], str) else decimal(table[key])
        if number is None or not number.is_finite():
            self.problem(where, f"{show_value(table[key])} is not a finite number of seconds.")
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
        for name, given in flat_table(cast("Mapping[str, Any]", value)):
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
            self.problem(
                where, f"{show_value(given)} is no list: {fmu.name} has an array of {len(elements)} elements here."
            )
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
            match = ARROW.fullmatch(item)
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
            numbers = {key: decimal(table.get(key, default)) for key, default in (("factor", 1), ("offset", 0))}
            for key, numeric in numbers.items():
                if numeric is None or not numeric.is_finite() or isinstance(table.get(key), str):
                    self.problem(f"{where}, {key}", f"{show_value(table.get(key))} is not a finite number.")
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
        if source.type not in ACCEPTED_TYPES.get(target.type, ()):
            self.problem(where, f"an output of type {source.type} cannot feed an input of type {target.type}.")
            return
        transformed = connection.factor != 1.0 or connection.offset != 0.0
        if transformed and target.type != "Real":
            self.problem(where, f"factor and offset need an input of type Real, not {target.type}.")
        if connection.converts or source.unit is None or target.unit is None:
            return
        one, other = instances[connection.source[0]].fmu, instances[connection.target[0]].fmu
        if is_same_unit(one, source.unit, other, target.unit):
            return
        self.problem(
            where,
            f"unit {source.unit} does not match {target.unit}. "
            + unit_remedy(source.unit, target.unit, ".".join(connection.source), ".".join(connection.target)),
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
        value = decimal(variable.start_text if given is None else given)
        return value if value is not None and value.is_finite() and value > 0 else None

    # Record

    def record(self, instances: Mapping[str, Instance]) -> tuple[tuple[tuple[str, str], ...], int]:
        table = self.table("record")
        self.known_keys("record", table, ("variables", "decimation"))
        decimation = self.integer("record.decimation", table.get("decimation", 1))
        patterns = table.get("variables")
        if patterns is None:
            chosen = [(i.name, v) for i in instances.values() for v in i.fmu.outputs if is_numeric(i.fmu.variables[v])]
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
            self.problem(where, f"{show_value(pattern)} is not a text.")
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
            elif not is_numeric(fmu.variables[variable]):
                self.problem(where, f"'{pattern}' is a String; only numbers are recorded.")
            else:
                yield name, variable
            return
        expression = re.compile(re.escape(pattern).replace(r"\*", ".*").replace(r"\?", "."))
        found = False
        for name, instance in instances.items():
            for variable in instance.fmu.variables.values():
                varies = variable.causality in ("input", "output", "local") and variable.variability != "constant"
                if varies and is_numeric(variable) and expression.fullmatch(f"{name}.{variable.name}"):
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
        outputs = feedthrough(instances, connected)
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
            return evaluation_order(list(instances), outputs, connected)
        for connection in connections:
            source, target = connection.source, connection.target
            if source in outputs and order.index(source[0]) >= order.index(target[0]):
                self.note(
                    f"connection {connection}",
                    f"one step of delay: {source[0]} comes after {target[0]} in the order, and its output depends "
                    f"directly on its inputs. Put {source[0]} before {target[0]}.",
                )
        return order
