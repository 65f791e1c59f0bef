"""A system: FMU instances, their start values and connections, and the experiment, read and checked.

A system file is TOML::

    base = "common.toml"                      # optional: the file that this file completes; relative to this file,
                                              # or a system that comes with cosim, such as "shams2010/fsmc_5sin"
    description = "Two lags in a row"
    connections = [
        "source.position -> controller.position_ref",
        { from = "controller.command", to = "plant.command", factor = 628.3, offset = 0.0 },
        { from = "a.angle", to = "b.angle", units = "convert" },   # or "suppress": the values as they are
    ]

    [experiment]
    start_time = 0.0
    stop_time = 10.0                           # may be left out where a record ends the run
    step_size = 1e-4                           # or a fraction: "1/30"
    order = ["source", "controller", "plant"]  # or "sequential" (default: derived), or "parallel"
    tolerance = 1e-6                           # optional; every FMU gets it in place of its own tolerance

    [instances.plant]
    fmu = "BallscrewStage"                     # in the FMU folder; or a path to an .fmu, relative to this file
    start = { m = 62.4, kind = "sine", "nct.error" = [0.0, 1e-6] }   # a[1,1], a[1,2] ... as lists of rows
    step_multiple = 1                          # doStep every this many communication steps

    [record]
    variables = ["plant.position", "controller.*"]   # default: all outputs of all instances
    decimation = 1

A record of a machine, or of another run, feeds inputs as an FMU does: ``"log.position -> controller.position_ref"``::

    [signals.log]
    file = "stage.csv"                         # .csv (.txt, .tsv, .dat), .parquet, .mat; relative to this file
    time = "t"                                 # default: the column time, t or zeit; or sampling_time = 1e-3
    time_unit = "ms"                           # default: the unit in the file, else s
    start_time = 12.5                          # time of the record at the start of the run; default: record and run
                                               # have the same time
    interpolation = "hold"                     # or "linear"
    extend = "hold"                            # before and after the record; or "repeat"; or "stop": the run ends with
                                               # the record

    [signals.log.columns]                      # default: all columns by their names
    position = "x"
    force = { column = "current", factor = 2.1, offset = 0.0, unit = "N" }   # unit: after factor and offset
    reference = { column = "r", unit = "m", derivatives = 2, smoothing = { window = 0.01, polynomial = 3 } }

A record acts as a sampled signal: over the step that begins at t_k, an input gets the value at t_k. This value is held
or interpolated. ``derivatives = 2`` adds the signals ``log.der(reference)`` and ``log.der(reference,2)``. Then
``smoothing`` is required: ``"none"`` takes central differences; a table fits a polynomial to the samples in ``window``
seconds (Savitzky and Golay 1964). Only the derivatives are smoothed, not the values. Before and after a record that
holds its values there, the derivatives are 0. A record that repeats itself goes from its last sample to its first in
one usual step. The names of signals in results are ``log.position``.

Several sources of one input make a sum, and an input may get noise::

    { from = ["motor.torque", "log.force"], to = "plant.command", factors = [1.0, -1.0], offset = 0.0 }
    { from = "plant.position", to = "controller.position", noise = { rms = 2e-9, seed = 1 } }

``units`` and ``offset`` are as in other connections; factors of 1 and -1 do not convert units. Noise is normal and
white, with ``rms`` in the unit of the input and a new value each communication step. The same ``seed`` gives the same
noise in every run. Signals are changed like start values: ``--set log.file=other.csv``.

All problems are found before any FMU is started, and reported at once. Times and step sizes are kept as decimals, so
that ``0.1`` divides ``1.0``.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from functools import cached_property
from pathlib import Path
from typing import Any, cast

from ..errors import DescriptionError, suggest
from ..fmu.places import find_system, has_ending
from ..fmu.variables import Value, Variable, suggest_variable
from .connections import read_connections
from .document import Changes, changed_document, load_document
from .experiment import ExperimentTimes, read_experiment
from .findings import Findings
from .instances import Places, read_instances
from .order import evaluation_order
from .parts import Connection, Instance, Order, Ports, SignalSource
from .record import recorded_variables
from .samples import check_steps
from .single import fmu_document, full_names
from .values import fraction, show_value, start_value

KEYS = ("description", "connections", "experiment", "instances", "signals", "record")
"""The tables and keys at the top of a system file."""


@dataclass(frozen=True, repr=False)
class System:
    """A checked system; ``read_system`` and ``make_system`` create it."""

    name: str
    description: str
    instances: tuple[Instance, ...]
    signals: tuple[SignalSource, ...]
    connections: tuple[Connection, ...]
    start_time: Decimal
    stop_time: Decimal
    step_size: Decimal
    steps: int
    order: Order
    evaluation_order: tuple[str, ...]
    """Instances in the order in which inputs are set and feedthrough is evaluated at a communication point."""
    tolerance: float | None
    record: tuple[tuple[str, str], ...]
    decimation: int
    notes: tuple[str, ...]
    """Remarks on things that are legal but may surprise."""
    notes_of_file: tuple[str, ...]
    """The part of ``notes`` that was found while the file was read."""
    document: Mapping[str, Any]
    folder: Path
    fmus: Path | None

    def __repr__(self) -> str:
        instances = ", ".join(f"{instance.name} ({instance.fmu.name})" for instance in self.instances)
        return (
            f"<System {self.name}: {instances}; {self.steps} steps of {float(self.step_size):g} s "
            f"from {float(self.start_time):g} s to {float(self.stop_time):g} s>"
        )

    @cached_property
    def digest(self) -> str:
        """SHA-256, in hexadecimal digits, of everything that decides the results."""
        content: dict[str, Any] = {
            "instances": {i.name: [i.fmu.digest, sorted(i.start.items()), i.step_multiple] for i in self.instances},
            "connections": sorted(_connection_content(c) for c in self.connections),
            "times": [float(time) for time in (self.start_time, self.stop_time, self.step_size)],
            "order": self.order,
            "tolerance": self.tolerance,
            "record": self.record,
            "decimation": self.decimation,
        }
        if self.signals:
            content["signals"] = {s.name: {**s.table, "file": s.digest, "converted": s.converted} for s in self.signals}
        return hashlib.sha256(json.dumps(content, sort_keys=True, default=float).encode()).hexdigest()

    @property
    def parallel(self) -> bool:
        """Whether all instances step with the outputs of the previous communication point (Jacobi)."""
        return self.order == "parallel"

    def instance(self, name: str) -> Instance:
        """The instance called ``name``. Raises DescriptionError if there is none."""
        for instance in self.instances:
            if instance.name == name:
                return instance
        raise DescriptionError(f"{self.name}: no instance '{name}'.{suggest(name, (i.name for i in self.instances))}")

    def variable(self, instance: str, name: str) -> Variable:
        """A variable of an instance, or a column of a signal. Raises DescriptionError if there is none."""
        signal = next((signal for signal in self.signals if signal.name == instance), None)
        fmu: Ports = self.instance(instance).fmu if signal is None else signal
        if name not in fmu.variables:
            hint = suggest_variable(name, fmu.variables.values(), fmu.arrays)
            raise DescriptionError(f"{self.name}: {fmu.name} has no variable '{name}'.{hint}")
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
        """The same system with other start values (``{"plant.m": 70.0}``) or another experiment, checked again.

        Times are in s. Raises DescriptionError with all problems.
        """
        changes = Changes(stop_time, step_size, order, record, decimation)
        document, problems = changed_document(self.document, self.name, overrides or {}, changes)
        plain = overrides and not problems and changes == Changes()
        if plain and (starts := self._starts(overrides or {})) is not None:
            return self._with_starts(starts, document)
        return _checked(document, self.name, self.folder, self.fmus, problems=problems, notes=self.notes_of_file)

    def _starts(self, overrides: Mapping[str, object]) -> dict[str, dict[str, Value]] | None:
        """Start values by instance; None if one is wrong, or if the rest of the system may depend on one."""
        starts: dict[str, dict[str, Value]] = {}
        for path, given in overrides.items():
            name, _, variable_name = path.partition(".")
            if any(signal.name == name for signal in self.signals):
                return None
            variable = self.instance(name).fmu.variables.get(variable_name)
            if variable is None or variable_name == "T_s" or not variable.settable:
                return None
            value, _ = start_value(variable, given)
            if value is None:
                return None
            starts.setdefault(name, {})[variable_name] = value
        return starts

    def _with_starts(self, starts: Mapping[str, Mapping[str, Value]], document: Mapping[str, Any]) -> System:
        """The same system as ``make_system`` gives for ``document``, but only the start values are new.

        Start values cannot change the other checks. Therefore these are not repeated.
        """
        instances = tuple(replace(i, start={**i.start, **starts.get(i.name, {})}) for i in self.instances)
        return replace(self, instances=instances, document=document)


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
    """Read and check the system at ``path`` (.toml, .ssp, .ssd).

    A system that comes with cosim can be given by name, such as "shams2010/fsmc_5sin". An FMU, by path or name, is a
    system of one instance with the DefaultExperiment of its file; its ``overrides`` need no instance name.
    ``fmus`` is the folder of FMUs given by name. ``overrides`` replaces start values (``{"plant.m": 70.0}``). The other
    arguments replace entries of the experiment and the record; times are in s.
    Raises DescriptionError with all problems.
    """
    folder_of_fmus = None if fmus is None else Path(fmus)
    path = find_system(str(path), folder_of_fmus)
    folder, notes = path.parent, ()
    if has_ending(path, ".ssp", ".ssd"):
        loaded, folder, notes = _read_ssp(path)
    elif has_ending(path, ".fmu"):
        loaded, notes = fmu_document(path, stop_time, step_size)
        overrides = full_names(loaded, overrides or {})
        record = None if record is None else list(full_names(loaded, dict.fromkeys(record)))
    else:
        loaded = load_document(path)
    changes = Changes(stop_time, step_size, order, record, decimation)
    document, problems = changed_document(loaded, path.name, overrides or {}, changes)
    return _checked(document, path.name, folder, folder_of_fmus, problems=problems, notes=notes)


def make_system(
    document: Mapping[str, Any], *, name: str = "system", folder: str | Path = ".", fmus: str | Path | None = None
) -> System:
    """Check a system given as nested tables with the keys of a system file.

    ``name`` is used in messages. Relative paths start in ``folder``; ``fmus`` is the folder of FMUs given by name.
    Raises DescriptionError with all problems.
    """
    return _checked(document, name, Path(folder), None if fmus is None else Path(fmus))


def _checked(
    document: Mapping[str, Any],
    name: str,
    folder: Path,
    fmus: Path | None,
    *,
    problems: Sequence[str] = (),
    notes: Sequence[str] = (),
) -> System:
    """The System that a document describes.

    ``name`` is the file that messages name, ``folder`` the folder where relative paths start, ``fmus`` the folder of
    FMUs given by name. ``problems`` and ``notes`` were found before.
    Raises DescriptionError with all problems, the earlier ones included.
    """
    findings = Findings(name, problems)
    findings.known_keys("", document, KEYS)
    description = document.get("description", "")
    if not isinstance(description, str):
        findings.problem("description", f"must be a text, not {show_value(description)}.")
    instances = read_instances(document, Places(folder, fmus), findings)
    signals, experiment = _signals_and_experiment(document, instances, folder, findings)
    ports: dict[str, Ports] = {**{name: instance.fmu for name, instance in instances.items()}, **signals}
    connections = read_connections(document, ports, findings)
    signals = _units_of_inputs(signals, connections, ports)
    ports = {**ports, **signals}
    check_steps(instances, experiment, findings)
    record, decimation = recorded_variables(document, ports, connections, findings)
    if decimation > experiment.steps > 0:
        findings.problem(
            "record.decimation", f"{decimation} is more than the {experiment.steps} steps of the run. Take less."
        )
    elif decimation > 1 and experiment.steps:
        findings.note("record.decimation", _rare_rows(decimation, experiment))
    evaluated = tuple(instances)
    if not findings.problems:
        evaluated = evaluation_order(instances, connections, experiment.order, findings)
    if findings.problems:
        raise DescriptionError(list(dict.fromkeys(findings.problems)))
    return System(
        name=name,
        description=str(description),
        instances=tuple(instances.values()),
        signals=tuple(signals.values()),
        connections=connections,
        start_time=experiment.start_time,
        stop_time=experiment.stop_time,
        step_size=experiment.step_size,
        steps=experiment.steps,
        order=experiment.order,
        evaluation_order=evaluated,
        tolerance=experiment.tolerance,
        record=record,
        decimation=decimation,
        notes=(*notes, *findings.notes),
        notes_of_file=tuple(notes),
        document=document,
        folder=folder,
        fmus=fmus,
    )


def _signals_and_experiment(
    document: Mapping[str, Any], instances: Mapping[str, Instance], folder: Path, findings: Findings
) -> tuple[dict[str, SignalSource], ExperimentTimes]:
    """The signals of a document and its experiment. The end of a record may set the stop time."""
    if "signals" not in document:
        return {}, read_experiment(document, findings)
    from .signals import check_times, read_signals, record_ends  # imports NumPy: only for systems with records

    given = findings.table(document, "experiment")
    times = float(fraction(given.get("start_time", 0)) or 0.0), float(fraction(given.get("step_size")) or math.inf)
    signals = read_signals(document, folder, times, findings)
    multiple = math.lcm(*(instance.step_multiple for instance in instances.values()))
    tables = (
        cast("Mapping[str, Any]", t) for t in findings.table(document, "signals").values() if isinstance(t, Mapping)
    )
    ended = any(table.get("extend") == "stop" for table in tables)
    experiment = read_experiment(document, findings, list(record_ends(signals)) if ended else None, multiple)
    if experiment.steps:
        times = float(experiment.start_time), float(experiment.stop_time), float(experiment.step_size)
        check_times(signals, times, findings)
    return signals, experiment


def _rare_rows(decimation: int, experiment: ExperimentTimes) -> str:
    """What a decimation leaves out."""
    step, missed = float(experiment.step_size), experiment.steps % decimation
    last = float(experiment.stop_time) - missed * step
    end = f" The last row is at {last:.9g} s, before the end of the run." if missed else ""
    return (
        f"figures and pictures are of the recorded rows, {decimation * step:.6g} s apart: peaks between them are not "
        f"seen.{end}"
    )


def _units_of_inputs(
    signals: Mapping[str, SignalSource], connections: Sequence[Connection], ports: Mapping[str, Ports]
) -> dict[str, SignalSource]:
    """The signals, with units for columns that state none.

    Such a column gets the unit of the inputs that take its values unchanged, if they all have the same unit.
    """
    result = dict(signals)
    for name, signal in signals.items():
        variables = dict(signal.variables)
        for column, variable in signal.variables.items():
            taken = [c for c in connections if c.source == (name, column) and c.units == "same" and c.factor == 1.0]
            units = {ports[c.target[0]].variables[c.target[1]].unit for c in taken}
            if variable.unit is None and len(units) == 1:
                variables[column] = replace(variable, unit=units.pop())
        result[name] = replace(signal, variables=variables)
    return result


def _connection_content(connection: Connection) -> list[Any]:
    content: list[Any] = [str(connection), connection.factor, connection.offset]
    if connection.added:
        content.append("added")
    if connection.noise is not None:
        content.append(f"noise of {connection.noise.rms!r}, seed {connection.noise.seed}")
    return content


def _read_ssp(path: Path) -> tuple[dict[str, Any], Path, tuple[str, ...]]:
    from .ssp_read import read_ssp  # loads lxml: only for an SSP

    found = read_ssp(path)
    return found.document, found.folder, tuple(found.notes)
