"""Models of a system file, for its JSON Schema and for editors.

The reader of system files does not use these models. It checks values against the FMUs, and it starts without pydantic.
A test keeps the keys of both the same.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field

from ..fmu.tables import Count, Number, Positive, Seconds, Table, Text
from .signals import ColumnData, SignalData, SmoothingData

Arrow = Annotated[str, Field(pattern="->", description="INSTANCE.OUTPUT -> INSTANCE.INPUT")]
Name = Annotated[str, Field(pattern="^[A-Za-z_][A-Za-z0-9_]*$")]
Start = Annotated[Any, Field(description="number, true or false, text, name of an enumeration, or list for an array")]


class NoiseData(Table):
    """Seeded white noise on a connection, with one value for each communication step."""

    rms: Annotated[float, Field(ge=0.0, description="in the unit of the input")]
    seed: Annotated[int, Field(ge=0)]


class ConnectionData(Table):
    """A connection as a table: ``input = factor*output + offset``, or a sum of several outputs."""

    source: Annotated[Text | list[Text], Field(alias="from")]
    target: Annotated[Text, Field(alias="to")]
    factor: Number | None = None
    factors: list[Number] | None = None
    offset: Number | None = None
    units: Literal["convert", "suppress"] | None = None
    noise: NoiseData | None = None


class ExperimentData(Table):
    """Times in s, and the order in which instances step."""

    start_time: Seconds = 0.0
    stop_time: Seconds | None = None
    step_size: Seconds | None = None
    order: Literal["sequential", "parallel"] | list[Name] = "sequential"
    tolerance: Positive | None = None


class InstanceData(Table):
    """An FMU by its name or by its path, and its start values."""

    fmu: Text | None = None
    start: Mapping[str, Start] = {}
    step_multiple: Count = 1


class ColumnEntry(ColumnData):
    """A column of a record. Its derivatives are smoothed, or explicitly not smoothed ("none")."""

    smoothing: SmoothingData | Literal["none"] | None = None  # pyright: ignore[reportIncompatibleVariableOverride]


class SignalEntry(SignalData):
    """A record as a source of the run; a column may be named by a text alone."""

    columns: Mapping[Name, ColumnEntry | Text] | None = None  # pyright: ignore[reportIncompatibleVariableOverride]


class RecordData(Table):
    """The recorded variables. With decimation = n, every n-th communication point is recorded."""

    variables: list[Text] | None = None
    decimation: Count = 1


class SystemData(Table):
    """A system file; with ``base`` it completes another one."""

    base: Text | None = None
    description: Annotated[str, Field()] = ""
    connections: list[Arrow | ConnectionData] = Field(default_factory=list[Arrow | ConnectionData])
    experiment: ExperimentData = ExperimentData()
    instances: Mapping[Name, InstanceData] = {}
    signals: Mapping[Name, SignalEntry] = {}
    record: RecordData = RecordData()
