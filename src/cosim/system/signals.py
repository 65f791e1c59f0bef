"""The table ``[signals]``: reads records as sources, scales their columns and computes derivatives."""

from __future__ import annotations

import contextlib
import hashlib
import math
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field

from ..errors import DescriptionError, suggest
from ..fmu.tables import Number, Positive, Step, Table, Text, checked, whole
from ..fmu.text import named_path
from ..fmu.variables import Variable
from ..record.derive import derivative_name, derivative_unit, differences, smoothed
from ..record.description import description_path
from ..record.header import is_unit
from ..record.read import Record, read_record
from ..record.resample import Resampler
from ..units import parse_unit
from .connections import compare_numbers
from .findings import Findings
from .instances import NAME
from .parts import SignalSource
from .values import fraction

SEEN = 0.05
"""Least share of a slow record that a run sees: less is probably a record whose times are not in s."""


class SmoothingData(Table):
    """How derivatives are smoothed: by a polynomial fitted to the samples in a window in s."""

    EXAMPLE: ClassVar[str] = 'smoothing = { window = 0.01, polynomial = 3 }, or smoothing = "none"'

    window: Positive
    """Length of the window in s."""
    polynomial: Annotated[int, Field(ge=1, le=7), BeforeValidator(whole)] = 3
    """Degree of the polynomial. It must be at least the order of the derivative."""


class ColumnData(Table):
    """A column of the file as a signal: ``factor*column + offset`` in ``unit``."""

    EXAMPLE: ClassVar[str] = '{ column = "current", factor = 2.1, offset = 0.0, unit = "N" }'

    column: Text
    """Name of the column in the file, without its unit."""
    factor: Number | None = None
    """Factor on the column, which then has the unit ``unit``. Default: the conversion from the unit in the file."""
    offset: Number = 0.0
    """Number that is added after the factor, in ``unit``."""
    unit: Text | None = None
    """Unit of the signal. Default: the unit in the file."""
    derivatives: Annotated[int, Field(ge=0, le=2), BeforeValidator(whole)] = 0
    """Highest derivative that is offered, as ``der(NAME)`` and ``der(NAME,2)``."""
    smoothing: SmoothingData | None = None
    """How derivatives are smoothed."""


class SignalData(Table):
    """An entry of ``[signals]``."""

    EXAMPLE: ClassVar[str] = 'file = "stage.csv"'

    file: Text
    """The record (.csv, .tsv, .txt, .dat, .parquet, .mat), relative to this file."""
    time: Text | None = None
    """Name of the column of time. Default: the column called time or t."""
    time_unit: Text | None = None
    """Unit of the column of time, such as ``ms``. Default: the unit in the file, else s."""
    sampling_time: Step | None = None
    """Sampling time in s of a record without a column of time, such as ``1e-3`` or ``"1/8000"``."""
    start_time: Number | None = None
    """Time of the record in s at which the run begins. Default: the times of the record are those of the run."""
    columns: Mapping[str, ColumnData] | None = None
    """Signals of this source, by name."""
    interpolation: Literal["hold", "linear"] = "hold"
    """Value between two samples: that of the last sample, or on the line between both."""
    extend: Literal["hold", "repeat", "stop"] = "hold"
    """Beyond the ends of the record: its end values hold, it repeats, or the run stops with it."""


class SignalsData(Table):
    """The part of a system file that this module reads."""

    signals: Mapping[str, SignalData]
    """Records that feed inputs, by name."""


def read_signals(
    document: Mapping[str, Any], folder: Path, times: tuple[float, float], findings: Findings
) -> dict[str, SignalSource]:
    """The signals of a document, by name. A signal with a problem is left out.

    Relative paths start in ``folder``. ``times`` are the start time and the communication step of the run in s.
    """
    tables = findings.table(document, "signals")
    result: dict[str, SignalSource] = {}
    for name, plain in _plain(tables).items():
        # Each signal is checked alone, so that a problem in one does not stop the others.
        data, problems = checked({"signals": {name: plain}}, SignalsData, findings.name)
        findings.problems += problems
        if data is None:
            continue
        entry = data.signals[name]
        where = f"signals.{name}"
        if not NAME.fullmatch(name):
            findings.problem(where, "the name is made of letters, digits and _, and starts with no digit.")
        elif name in findings.table(document, "instances"):
            findings.problem(where, "an instance has this name, too. Rename one.")
        else:
            try:
                source = _source(name, entry, cast("Mapping[str, Any]", tables[name]), folder, times, findings)
            except DescriptionError as error:
                for problem in error.problems:
                    findings.problem(where, problem)
                continue
            if source is not None:
                result[name] = source
    return result


def _plain(tables: Mapping[str, Any]) -> dict[str, Any]:
    """The tables in the form of the model: every column is a table, and smoothing "none" is left out."""
    plain: dict[str, Any] = {}
    for name, table in tables.items():
        items: Any = dict(cast("Mapping[str, Any]", table)) if isinstance(table, Mapping) else table
        if isinstance(table, Mapping) and isinstance(items.get("columns"), Mapping):
            columns = cast("Mapping[str, Any]", items["columns"])
            items["columns"] = {key: _plain_column(value) for key, value in columns.items()}
        plain[name] = items
    return plain


def _plain_column(value: object) -> object:
    if isinstance(value, str):
        return {"column": value}
    if not isinstance(value, Mapping):
        return value  # pyright: ignore[reportUnknownVariableType]
    items = cast("Mapping[str, Any]", value)
    return {key: item for key, item in items.items() if (key, item) != ("smoothing", "none")}


# ---- one entry ----


def _source(  # noqa: PLR0917
    name: str, entry: SignalData, table: Mapping[str, Any], folder: Path, times: tuple[float, float], findings: Findings
) -> SignalSource | None:
    where = f"signals.{name}"
    before = len(findings.problems)
    sampling_time = None if entry.sampling_time is None else fraction(entry.sampling_time)
    if entry.sampling_time is not None and sampling_time is None:
        findings.problem(f"{where}.sampling_time", f"'{entry.sampling_time}' is no number of seconds.")
        return None
    wanted = None if entry.columns is None else tuple(dict.fromkeys(c.column for c in entry.columns.values()))
    path = named_path(entry.file, folder)
    seconds = None if sampling_time is None else float(sampling_time)
    record, digest = _read(path, entry.time, entry.time_unit, seconds, wanted)
    found = _columns(where, entry, cast("Mapping[str, Any]", table.get("columns", {})), record, findings)
    if len(findings.problems) > before:
        return None
    if uneven := record.uneven():
        findings.note(where, uneven)
    linear, repeat = entry.interpolation == "linear", entry.extend == "repeat"
    return SignalSource(
        name,
        path,
        digest,
        table,
        found.variables,
        found.values,
        rates=frozenset(found.rates),
        resampler=Resampler(record.time, grid=times[1], linear=linear, repeat=repeat),
        shift=0.0 if entry.start_time is None else entry.start_time - times[0],
        converted=found.converted,
    )


@dataclass(frozen=True)
class _Columns:
    """The columns of a record and their derivatives; see the fields of ``SignalSource``."""

    values: dict[str, NDArray[np.float64]] = field(default_factory=dict[str, NDArray[np.float64]])
    variables: dict[str, Variable] = field(default_factory=dict[str, Variable])
    rates: set[str] = field(default_factory=set[str])
    converted: dict[str, str] = field(default_factory=dict[str, str])


def _columns(where: str, entry: SignalData, written: Mapping[str, Any], record: Record, findings: Findings) -> _Columns:
    """The columns of an entry; ``written`` is its table of columns. A column with a problem is left out."""
    found = _Columns()
    chosen = entry.columns or {column: ColumnData(column=column) for column in record.columns}
    for key, column in chosen.items():
        place = f"{where}.columns.{key}"
        if not _smoothing_said(place, column, written.get(key), findings):
            continue
        scaled = _scaled(place, column, record, findings)
        if scaled is None:
            continue
        found.values[key], unit = scaled
        stated = record.units[column.column]
        if column.factor is None and stated not in ("", unit):
            found.converted[key] = stated
        text = f"column {column.column} of {entry.file}"
        found.variables[key] = _variable(key, unit, text)
        for order in range(1, column.derivatives + 1):
            name = derivative_name(key, order)
            try:
                found.values[name] = _derivative(record, found.values[key], order, column.smoothing)
            except DescriptionError as error:
                findings.problem(place, str(error))
                break
            found.variables[name] = _variable(name, derivative_unit(unit, order), f"derivative of {text}")
            found.rates.add(name)
    return found


def _smoothing_said(where: str, column: ColumnData, written: object, findings: Findings) -> bool:
    """Whether a column has both derivatives and smoothing, or neither. Reports a problem if not."""
    said = isinstance(written, Mapping) and "smoothing" in cast("Mapping[str, Any]", written)
    if column.derivatives and not said:
        findings.problem(
            where,
            'say how derivatives are computed: smoothing = "none" for central differences, or smoothing = '
            "{ window = 0.01, polynomial = 3 } for polynomials fitted to the samples of so many seconds.",
        )
    elif said and not column.derivatives:
        findings.problem(where, "smoothing needs derivatives: write derivatives = 1 or 2, or leave it out.")
    return said == (column.derivatives > 0)


def _scaled(
    where: str, column: ColumnData, record: Record, findings: Findings
) -> tuple[NDArray[np.float64], str] | None:
    """The values of a column after factor and offset, and their unit; None if there was a problem."""
    told = record.units[column.column]
    factor, offset = column.factor, column.offset
    if column.unit is not None and not is_unit(column.unit):
        try:
            parse_unit(column.unit)
        except DescriptionError as error:
            findings.problem(f"{where}.unit", str(error))
            return None
    unit = column.unit or told
    if factor is None and column.unit and told:
        found = parse_unit(told).conversion(parse_unit(column.unit)) if is_unit(told) else None
        if found is None:
            findings.problem(
                f"{where}.unit",
                f"the file says {told}, which cannot be converted to {column.unit}. Give factor = ... "
                f"({column.unit} per {told}).",
            )
            return None
        factor, offset = found[0], found[1] + offset
    elif factor not in (None, 1.0) and not column.unit:
        unit = ""
        if told:
            findings.problem(f"{where}.factor", f'the file says {told}: say the unit after the factor, unit = "...".')
            return None
    elif factor is not None and told and column.unit and is_unit(told) and is_unit(column.unit):
        found = parse_unit(told).conversion(parse_unit(column.unit))
        if found is not None and found != (1.0, 0.0):
            remedy = f"write factor = {factor * found[0]:.6g}"
            compare_numbers(where, (factor, offset), (told, column.unit), found, remedy, findings)
    values = record.columns[column.column]
    # Adding 0.0 would turn -0.0 into 0.0.
    values = values if factor in (None, 1.0) else values * factor
    values = values if offset == 0.0 else values + offset
    if not np.all(np.isfinite(values)):
        findings.problem(where, f"factor {factor} and offset {offset:g} give values that are not finite.")
        return None
    return values, unit


def _derivative(
    record: Record, values: NDArray[np.float64], order: int, smoothing: SmoothingData | None
) -> NDArray[np.float64]:
    if smoothing is None:
        return differences(record.time, values, order)
    return smoothed(record.time, values, order, window=smoothing.window, polynomial=smoothing.polynomial)


def _variable(name: str, unit: str, text: str) -> Variable:
    return Variable(
        name=name,
        reference=0,
        type="Real",
        passed_as="Float64",
        causality="output",
        variability="discrete",
        initial=None,
        unit=unit or None,
        display_unit=None,
        start=None,
        start_text=None,
        min=None,
        max=None,
        description=text,
        items={},
    )


def _read(
    path: Path,
    time: str | None,
    time_unit: str | None,
    sampling_time: float | None,
    columns: tuple[str, ...] | None,
) -> tuple[Record, str]:
    """A record and the SHA-256 of its file. A file that has not changed is read only once in a process."""
    stamp: list[tuple[int, int]] = []
    for file in (path, description_path(path)):
        with contextlib.suppress(OSError):
            status = os.stat(file)
            stamp.append((status.st_mtime_ns, status.st_size))
    return _kept(path, tuple(stamp), time, time_unit, sampling_time, columns)


@lru_cache(maxsize=8)
def _kept(  # noqa: PLR0917
    path: Path,
    stamp: tuple[tuple[int, int], ...],
    time: str | None,
    time_unit: str | None,
    sampling_time: float | None,
    columns: tuple[str, ...] | None,
) -> tuple[Record, str]:
    record = read_record(path, time=time, time_unit=time_unit, sampling_time=sampling_time, columns=columns)
    return record, hashlib.sha256(path.read_bytes()).hexdigest()


# ---- settings that can be changed for each run ----

_SETTINGS = {"file": "", "time": "", "interpolation": "", "extend": "", "start_time": "s", "sampling_time": "s"}
"""The keys of an entry that can be changed, each with its unit; "" for a text."""


def setting(signal: SignalSource, path: str) -> Variable:
    """The setting ``path`` of a signal as a Variable: ``file``, ``start_time``, ``columns.force.factor`` ...

    These are the settings that ``System.changed`` accepts. Raises DescriptionError for another path.
    """
    known = {
        **_SETTINGS,
        **{f"columns.{name}.{key}": "1" for name in signal.table.get("columns", ()) for key in ("factor", "offset")},
    }
    if path not in known:
        raise DescriptionError(f"signals.{signal.name}: '{path}' cannot be set.{suggest(path, known)}")
    variable = _variable(path, known[path], f"{path} of signal {signal.name}")
    return replace(variable, causality="parameter", type="Real" if known[path] else "String")


# ---- signals and the experiment ----


def record_ends(signals: Mapping[str, SignalSource]) -> Iterator[tuple[str, float]]:
    """Names of the signals whose record ends the run, and the time of this end in s of the run."""
    for name, signal in signals.items():
        if signal.table.get("extend") == "stop":
            yield name, float(signal.resampler.time[-1]) - signal.shift


def check_times(signals: Mapping[str, SignalSource], times: tuple[float, float, float], findings: Findings) -> None:
    """Note records that do not cover the run, or that have more than one sample in a communication step.

    ``times`` are start, stop and step of the run in s. With extend = "stop", a record that begins too late is a
    problem.
    """
    start, stop, step = times
    for name, signal in signals.items():
        where = f"signals.{name}"
        own = signal.resampler
        first, last = float(own.time[0]) - signal.shift, float(own.time[-1]) - signal.shift
        extend = signal.table.get("extend")
        slack = 0.01 * own.step
        if first > start + slack:
            text = f"the record begins at {first:.9g} s, after the start of the run at {start:.9g} s"
            if extend == "stop":
                findings.problem(
                    where, f"{text}. Give start_time = {own.time[0]:.15g}, the record's time at that start."
                )
            elif extend is None:
                findings.note(
                    where,
                    f"{text}: its first values hold until then. start_time = {own.time[0]:.15g} would begin with it; "
                    'extend = "hold" says that this is meant.',
                )
        if last + own.step < stop - slack and extend is None:
            findings.note(
                where,
                f"the record ends at {last:.9g} s, before the end of the run at {stop:.9g} s: its last values "
                'hold from then on. extend = "hold" says that this is meant; others are "repeat" and "stop".',
            )
        seen = (stop - start) / own.step + 1.0
        if (seen < 3.0 and own.time.size > 3) or (seen < SEEN * own.time.size and own.step > 10.0 * step):
            findings.note(
                where,
                f"the record has a sample every {own.step:.6g} s, so the run of {stop - start:.6g} s sees only "
                f'{math.floor(seen)} of its {own.time.size} samples. If its times are not in s, say time_unit = "ms".',
            )
        if own.step < 0.99 * step and own.time.size > 1:
            findings.note(
                where,
                f"the record has a sample every {own.step:.6g} s, the run a communication step every {step:.6g} s: "
                f"samples between are not seen ({math.floor(step / own.step + 0.01)} a step).",
            )
