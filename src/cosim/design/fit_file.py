"""The file of a fit: which parameters are free, which records tell about them, and what is compared.

A fit file is TOML::

    system = "stage.toml"              # a system file, relative to this file
    description = "Friction of the X axis"
    loss = "linear"                    # or soft_l1, huber, cauchy: outliers count less
    starts = 1                         # how many starting points are tried; seed = 1
    loops = 200                        # most runs of a record

    [parameters]                       # start values of FMUs that are free
    "plant.m" = {}                     # start: that of the system; bounds: those of the FMU
    "plant.F_C" = { start = 0.4, from = 0.1, to = 5.0, log = true }
    "plant.F_S" = { log = true, also = ["controller.F_S_hat"] }    # sets more variables to the same value

    [outputs.position]                 # what is compared
    signal = "plant.position"          # of the system
    column = "x"                       # of the records; default: the name of the output
    reference = "x_ref"                # optional: figures are told of the column less this one, the tracking error
    noise = 2e-8                       # standard deviation in the unit of the signal; default: taken from the records
    delay = { from = 0.0, to = 2e-3 }  # s by which the record is late, free; or a number
    gain = 1.0                         # record = gain*signal + bias; numbers, or ranges where they are free
    bias = 0.0

    [records.first]
    file = "first.csv"
    time = "t"                         # optional: column of time, or sampling_time = 1e-3
    signals = ["log"]                  # tables [signals] of the system that read this file; default: all of them
    window = [0.1, 4.0]                # s; default: all of it
    period = 1.5                       # s after which the machine repeats itself; optional
    start = { "plant.position_start" = 0.0 }                        # start values in this record
    free = { "plant.velocity_start" = { from = -0.1, to = 0.1 } }   # free in this record only

    [records.second]
    file = "second.csv"
    use = "validate"                   # never fitted

    [experiment]                       # optional, as in a sweep file; stop_time: default the end of each record
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import Any, cast

import numpy as np

from ..errors import DescriptionError, suggest
from ..fmu.places import shipped_file
from ..fmu.tables import checked
from ..fmu.text import read_toml
from ..fmu.variables import Variable
from ..record.read import Record, read_record
from ..result.metrics import Array
from ..system.document import load_document
from ..system.system import System, make_system
from ..units import conversion
from .documents import FitData, FreeData, OutputData, ParameterData, RecordData
from .fit_statistics import fast_noise

LEAST_SAMPLES = 20
"""Least number of samples of a record in its window: with fewer samples the noise cannot be estimated."""
STILL = 3.0
"""A record has no excitation if the variation of its column is below this number times the noise.

Below three standard deviations, the variation may be noise alone.
"""


@dataclass(frozen=True)
class Free:
    """A free value."""

    name: str
    """INSTANCE.VARIABLE, followed by the record if it is free in one record only; or OUTPUT delay, gain or bias."""
    unit: str
    start: float
    low: float
    high: float
    log: bool
    variables: tuple[str, ...] = ()
    """The variables that get this value; empty for delay, gain and bias of an output."""
    record: str = ""
    """The record in which it is free; "" for all."""
    output: str = ""
    part: str = ""
    """"delay", "gain" or "bias" for a value of an output, else ""."""

    @property
    def scale(self) -> float:
        """The size of a change that matters: the start value itself, or a part of its range if it starts at 0."""
        if self.start != 0.0:
            return abs(self.start)
        if math.isfinite(self.high - self.low):
            return 0.1 * (self.high - self.low)
        return 1.0


@dataclass(frozen=True)
class Output:
    """A signal that is compared."""

    name: str
    signal: str
    unit: str
    noise: float
    """Standard deviation in the unit of the signal; default: that of the fast part of the records."""
    noise_given: bool
    fixed: Mapping[str, float]
    """Values of delay, gain and bias; for a free one, its start value."""


@dataclass(frozen=True)
class FitRecord:
    """A record, and the system that it is compared with."""

    name: str
    path: Path
    system: System
    time: Array
    values: Mapping[str, Array]
    """Output -> measured values in the unit of its signal."""
    references: Mapping[str, Array]
    """Output -> reference that is subtracted for its figures, for outputs with a reference."""
    part: slice
    """The samples in the window of the record."""
    validates: bool
    period: float | None


@dataclass(frozen=True)
class Fit:
    """A checked fit."""

    name: str
    description: str
    folder: Path
    system: str
    """The system file as the fit file names it."""
    free: tuple[Free, ...]
    outputs: tuple[Output, ...]
    records: tuple[FitRecord, ...]
    loss: str
    starts: int
    seed: int
    loops: int
    timeout: float | None
    notes: tuple[str, ...] = ()

    @property
    def fitted(self) -> tuple[FitRecord, ...]:
        """The records that are fitted."""
        return tuple(record for record in self.records if not record.validates)


def read_fit(path: str | Path, *, fmus: str | Path | None = None) -> Fit:
    """Read and check a fit file and its records. Raises DescriptionError with every problem found."""
    path = shipped_file(path)
    return make_fit(read_toml(path), name=path.name, folder=path.parent, fmus=fmus)


def make_fit(
    document: Mapping[str, Any], *, name: str = "fit", folder: str | Path = ".", fmus: str | Path | None = None
) -> Fit:
    """Check a fit given as nested tables, as a fit file holds them. Raises DescriptionError with all problems."""
    data, problems = checked(document, FitData, name)
    if data is None:
        raise DescriptionError(problems)
    return _Reader(data, name, Path(folder), None if fmus is None else Path(fmus), problems).fit()


class _Reader:
    """Checks a fit file, and reads the system and the records that it names."""

    def __init__(self, data: FitData, name: str, folder: Path, fmus: Path | None, problems: list[str]) -> None:
        self.data, self.name, self.folder, self.fmus = data, name, folder, fmus
        self.problems = problems
        self.notes: list[str] = []
        path = shipped_file(data.system, folder)
        try:
            self.system_folder, self.document = path.parent, load_document(path)
        except DescriptionError as error:
            raise DescriptionError([*problems, *error.problems]) from None

    def fit(self) -> Fit:
        if all(record.use == "validate" for record in self.data.records.values()):
            self._problem("records", 'every record has use = "validate". Leave one to be fitted.')
        read = {name: found for name, given in self.data.records.items() if (found := self._read(name, given))}
        systems = {name: found for name, record in read.items() if (found := self._system(name, record))}
        if not systems:
            raise DescriptionError(self.problems)
        first = next(iter(systems.values()))
        units = {name: unit for name, given in self.data.outputs.items() if (unit := self._unit(name, given, first))}
        given = self.data.outputs
        columns = {
            name: {
                output: self._column(record, output, given[output].column or output, unit)
                for output, unit in units.items()
            }
            for name, record in read.items()
        }
        references = {
            name: {
                output: self._column(record, output, column, unit)
                for output, unit in units.items()
                if (column := given[output].reference) is not None
            }
            for name, record in read.items()
        }
        self._stop_if_wrong()
        records = tuple(self._record(name, read[name], systems[name], columns[name], references[name]) for name in read)
        self._stop_if_wrong()
        outputs = tuple(self._output(name, unit, records) for name, unit in units.items())
        free = self._free(first, outputs, systems)
        for record in records:
            self._check_excitation(record, outputs)
        self._stop_if_wrong()
        data = self.data
        return Fit(
            self.name,
            data.description,
            self.folder,
            data.system,
            free,
            outputs,
            records,
            data.loss,
            data.starts,
            data.seed,
            data.loops,
            data.timeout,
            tuple(self.notes),
        )

    def _problem(self, key: str, text: str) -> None:
        self.problems.append(f"{self.name}: {key}: {text}")

    def _problems(self, key: str, error: DescriptionError | ValueError) -> None:
        for text in error.problems if isinstance(error, DescriptionError) else (str(error),):
            self._problem(key, text)

    def _stop_if_wrong(self) -> None:
        if self.problems:
            raise DescriptionError(self.problems)

    # records and their systems

    def _read(self, name: str, given: RecordData) -> Record | None:
        outputs = self.data.outputs.items()
        columns = [output.column or key for key, output in outputs]
        columns = list(dict.fromkeys([*columns, *(output.reference for _, output in outputs if output.reference)]))
        try:
            record = read_record(
                self.folder / given.file, time=given.time, sampling_time=given.sampling_time, columns=columns
            )
        except DescriptionError as error:
            self._problems(f"records.{name}", error)
            return None
        if note := record.uneven():
            self.notes.append(note)
        return record

    def _system(self, name: str, record: Record) -> System | None:
        """The system for this record. If the record is a source of the system, the run begins with its first sample."""
        given = self.data.records[name]
        signals = dict(cast("Mapping[str, Any]", self.document.get("signals", {})))
        for table in signals if given.signals is None else given.signals:
            if table not in signals:
                self._problem(f"records.{name}.signals", f"no table [signals.{table}].{suggest(table, signals)}")
                continue
            begin = {} if "start_time" in signals[table] else {"start_time": float(record.time[0])}
            signals[table] = {**signals[table], "file": str(record.path.resolve()), **begin}
        experiment = {key: value for key, value in self.data.experiment.model_dump().items() if value is not None}
        document = {**self.document, **({"signals": signals} if signals else {})}
        try:
            step = Fraction(str(experiment.get("step_size", document.get("experiment", {}).get("step_size", 0))))
            if step > 0 and "stop_time" not in experiment:
                # The run ends at the last communication point within the record.
                last = float(record.time[-1]) - self._shift(record)
                steps = math.floor(Fraction(repr(last)) / step + Fraction(1, 10**6))
                experiment["stop_time"] = Decimal(repr(float(max(steps, 1) * step)))
            system = make_system(
                {**document, "experiment": {**document.get("experiment", {}), **experiment}},
                name=self.data.system,
                folder=self.system_folder,
                fmus=self.fmus,
            )
            wanted = [output.signal for output in self.data.outputs.values()]
            return system.changed(given.start, record=list(dict.fromkeys(wanted)), decimation=1)
        except (DescriptionError, ValueError) as error:
            self._problems(f"records.{name}", error)
            return None

    def _shift(self, record: Record) -> float:
        """Time of the record minus time of the run in s; 0 if the record is no source of the run."""
        start = float(self.document.get("experiment", {}).get("start_time", 0))
        return float(record.time[0]) - start if self.document.get("signals") else 0.0

    def _record(
        self, name: str, record: Record, system: System, columns: Mapping[str, Array], references: Mapping[str, Array]
    ) -> FitRecord:
        given, shift = self.data.records[name], self._shift(record)
        time = record.time - shift if shift else record.time
        low, high = (end - shift for end in given.window or (-math.inf, math.inf))
        # With a delay, the first samples show the time before the start of the run: they are left out.
        latest = max(_most(output.delay) for output in self.data.outputs.values())
        low = max(low, float(system.start_time) + latest)
        high = min(high, float(system.stop_time) + 1e-9)
        begin, end = int(np.searchsorted(time, low - 1e-9)), int(np.searchsorted(time, high, side="right"))
        if end - begin < LEAST_SAMPLES:
            self._problem(
                f"records.{name}",
                f"{end - begin} samples from {low + shift:g} s to {high + shift:g} s. At least {LEAST_SAMPLES} are "
                f"needed; the record goes from {record.time[0]:g} s to {record.time[-1]:g} s.",
            )
        if given.period is not None and not 0.0 < given.period < time[-1] - time[0]:
            self._problem(f"records.{name}.period", f"{given.period:g} s is longer than the record.")
        if given.use == "validate" and given.free:
            self._problem(
                f"records.{name}.free", "a record that validates has nothing free. Give start values in its start."
            )
        return FitRecord(
            name,
            record.path,
            system,
            time,
            columns,
            references,
            slice(begin, end),
            given.use == "validate",
            given.period,
        )

    # outputs

    def _unit(self, name: str, given: OutputData, system: System) -> str:
        instance, _, variable = given.signal.partition(".")
        try:
            return system.variable(instance, variable).unit or "1"
        except DescriptionError as error:
            self._problems(f"outputs.{name}.signal", error)
            return ""

    def _column(self, record: Record, output: str, column: str, unit: str) -> Array:
        """A column of an output in the unit of its signal."""
        given = self.data.outputs[output]
        values, stated = record.column(column), given.unit or record.units.get(column, "")
        try:
            factor = conversion(stated, unit) if stated and stated != unit else 1.0
        except DescriptionError as error:
            if given.unit is None and given.factor != 1.0:
                factor = 1.0  # The factor in the file replaces the conversion of units.
            else:
                self._problem(f"outputs.{output}", f"{record.path.name}, column {column}: {error}")
                factor = 1.0
        where = f"outputs.{output}: {record.path.name}, column {column}"
        if not stated and unit != "1" and given.factor == 1.0:
            self.notes.append(f'{where}: nothing says its unit: taken as {unit}. Say it: unit = "{unit}".')
        if factor != 1.0 and math.isclose(abs(given.factor), factor, rel_tol=1e-3):
            self.notes.append(
                f"{where}: converted from {stated} to {unit}, and then multiplied by factor = {given.factor:g}. If "
                "the factor is this conversion, leave it out."
            )
        return values * (factor * given.factor)

    def _output(self, name: str, unit: str, records: Sequence[FitRecord]) -> Output:
        given = self.data.outputs[name]
        noise = given.noise
        if noise is None:
            found = [fast_noise(record.values[name][record.part]) for record in records if not record.validates]
            noise = max(found)
            if noise <= 0.0:
                least = max(float(np.ptp(record.values[name][record.part])) for record in records)
                noise = 1e-6 * least if least > 0.0 else 1.0
        fixed = {part: _first(value, 1.0 if part == "gain" else 0.0) for part, value in given.sensor.items()}
        if isinstance(given.delay, FreeData) and not math.isfinite(given.delay.bounds[1]):
            self._problem(f"outputs.{name}.delay", "give its upper end: { from = 0.0, to = 2e-3 }.")
        return Output(name, given.signal, unit, noise, given.noise is not None, fixed)

    def _check_excitation(self, record: FitRecord, outputs: Sequence[Output]) -> None:
        """Report columns that do not vary: such a record tells nothing about the values."""
        found = [(output, record.values[output.name][record.part]) for output in outputs]
        if all(float(np.std(values)) <= STILL * output.noise or np.ptp(values) == 0.0 for output, values in found):
            said = ", ".join(_still(output, values) for output, values in found)
            self._problem(
                f"records.{record.name}", f"a record without excitation: {said}. Take one in which the machine moves."
            )

    # free values

    def _free(self, system: System, outputs: Sequence[Output], systems: Mapping[str, System]) -> tuple[Free, ...]:
        parameters = self.data.parameters.items()
        found = [self._parameter(f"parameters.{path}", path, given, system) for path, given in parameters]
        for name, record in self.data.records.items():
            if name in systems and record.use == "fit":
                found += [
                    self._parameter(f"records.{name}.free.{path}", path, given, systems[name], name)
                    for path, given in record.free.items()
                ]
        for output in outputs:
            units = {"delay": "s", "gain": "1", "bias": output.unit}
            for part, value in self.data.outputs[output.name].sensor.items():
                if isinstance(value, FreeData):
                    name, start = f"{output.name} {part}", output.fixed[part]
                    found.append(
                        Free(name, units[part], start, *value.bounds, value.log, output=output.name, part=part)
                    )
        kept = [free for free in found if free is not None]
        taken: dict[tuple[str, str], str] = {}
        for free in kept:
            for variable in free.variables:
                other = taken.setdefault((variable, free.record), free.name)
                if other != free.name or (free.record and (variable, "") in taken):
                    self._problem(f"parameters.{free.name}", f"'{variable}' is free twice. Keep one.")
        return tuple(kept)

    def _parameter(self, key: str, path: str, given: ParameterData, system: System, record: str = "") -> Free | None:
        before = len(self.problems)
        variables = [found for name in (path, *given.also) if (found := self._variable(key, name, system))]
        if len(self.problems) > before:
            return None
        variable = variables[0]
        start = given.start
        if start is None:
            instance, _, name = path.partition(".")
            value = system.instance(instance).start.get(name, variable.start)
            start = float(value) if isinstance(value, int | float) else 0.0
        low = max([-math.inf if v.min is None else v.min for v in variables])
        high = min([math.inf if v.max is None else v.max for v in variables])
        for end, text in ((given.low, "from"), (given.high, "to")):
            if end is not None and not low <= end <= high:
                self._problem(f"{key}.{text}", f"{end:g} lies outside {low:g} ... {high:g}, the bounds of the FMU.")
        low, high = max(low, given.bounds[0]), min(high, given.bounds[1])
        unit = variable.unit or "1"
        if not low <= start <= high:
            self._problem(key, f"starts at {start:g} {unit}, outside {low:g} ... {high:g}. Give a start within.")
        if start == 0.0 and not math.isfinite(high - low):
            self._problem(key, "starts at 0: give another start, or from and to, so that its size is known.")
        if given.log and start <= 0.0:
            self._problem(key, f"starts at {start:g} {unit}: log needs a positive start.")
        return Free(
            f"{path} ({record})" if record else path,
            unit,
            start,
            low,
            high,
            given.log,
            (path, *given.also),
            record,
        )

    def _variable(self, key: str, path: str, system: System) -> Variable | None:
        instance, _, name = path.partition(".")
        try:
            variable = system.variable(instance, name)
        except DescriptionError as error:
            self._problems(key, error)
            return None
        if not variable.settable or variable.type != "Real":
            what = f"of type {variable.type}" if variable.settable else f"a {variable.variability} {variable.causality}"
            self._problem(key, f"'{path}' is {what}. Only start values that are real numbers can be free.")
            return None
        if any(connection.target == (instance, name) for connection in system.connections):
            self._problem(key, f"'{path}' is connected, so its start value has no effect.")
            return None
        return variable


def _still(output: Output, values: Array) -> str:
    """What a record without motion holds of an output, in words."""
    if float(np.ptp(values)) == 0.0:
        return f"{output.name} is {values[0]:g} {output.unit} throughout"
    varies = f"{output.name} varies by {float(np.std(values)):.3g} {output.unit} rms"
    return f"{varies}, its noise is {output.noise:.3g} {output.unit}"


def _first(value: float | FreeData, default: float) -> float:
    """The first value of the search, or the value of a number that is not free."""
    if not isinstance(value, FreeData):
        return value
    low, high = value.bounds
    return min(max(default if value.start is None else value.start, low), high)


def _most(value: float | FreeData) -> float:
    """The largest value that a fixed or free number can take, but at least 0; 0 without upper bound."""
    if isinstance(value, FreeData):
        return max(value.high or 0.0, 0.0)
    return max(value, 0.0)
