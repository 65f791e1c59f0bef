"""Models of a system file, for its JSON Schema and for editors.

The reader of system files does not use these models. It checks values against the FMUs, and it starts without pydantic.
A test keeps the keys of both the same.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from ..fmu.tables import Count, Number, Seconds, Seed, Share, Step, Table, Text, number
from .signals import ColumnData, SignalData, SmoothingData

Arrow = Annotated[str, Field(pattern="->", description="INSTANCE.OUTPUT -> INSTANCE.INPUT")]
Name = Annotated[str, Field(pattern="^[A-Za-z_][A-Za-z0-9_]*$")]
Start = Annotated[Any, Field(description="number, true or false, text, name of an enumeration, or list for an array")]


class NoiseData(Table):
    """Seeded white noise on a connection, with one value for each communication step."""

    rms: Annotated[float, Field(allow_inf_nan=False, ge=0.0), BeforeValidator(number)]
    """Root mean square of the noise, in the unit of the input."""
    seed: Seed
    """Seed of the random numbers: the same seed gives the same noise."""


class ConnectionData(Table):
    """A connection as a table: ``input = factor*output + offset``, or a sum of several outputs."""

    source: Annotated[Text | list[Text], Field(alias="from")]
    """``INSTANCE.OUTPUT`` or ``SIGNAL.COLUMN``; a list gives the sum of all."""
    target: Annotated[Text, Field(alias="to")]
    """``INSTANCE.INPUT``."""
    factor: Number | None = None
    """Factor on the output. With it, the values are taken as they are: units are not converted. Default: 1."""
    factors: list[Number] | None = None
    """Factors of a sum, one for each source. Default: 1 for all."""
    offset: Number | None = None
    """Number that is added, in the unit of the input. Default: 0."""
    units: Literal["convert", "suppress"] | None = None
    """``"convert"`` converts units beside a factor; ``"suppress"`` passes values of other units unchanged."""
    noise: NoiseData | None = None
    """Noise that is added to the input."""


class ExperimentData(Table):
    """Times in s, and the order in which instances step."""

    start_time: Seconds = 0.0
    """Start of the run in s."""
    stop_time: Seconds | None = None
    """End of the run in s. It must be given, unless a signal with ``extend = "stop"`` ends the run."""
    step_size: Step | None = None
    """Communication step in s, such as ``1e-4`` or ``"1/30"``. It must be given and divide the length of the run."""
    order: Literal["sequential", "parallel"] | list[Name] = "sequential"
    """``"sequential"``, ``"parallel"`` (outputs are one step late), or all instances in the order of their steps."""
    tolerance: Share | None = None
    """Relative tolerance below 1, passed to every FMU. Default: each FMU takes its own."""


class InstanceData(Table):
    """An FMU by its name or by its path, and its start values."""

    fmu: Text | None = None
    """Name of an FMU, such as ``"BallscrewStage"``, or the path of an ``.fmu`` file, relative to this file."""
    start: Mapping[str, Start] = {}
    """Start values by variable, in the unit of the variable. An array takes a list, or single elements ``p[2]``."""
    step_multiple: Count = 1
    """The instance steps over this number of communication steps at a time."""


class ColumnEntry(ColumnData):
    """A column of a record. Its derivatives are smoothed, or explicitly not smoothed ("none")."""

    smoothing: SmoothingData | Literal["none"] | None = None  # pyright: ignore[reportIncompatibleVariableOverride]
    """How derivatives are smoothed, or ``"none"``: central differences. Must be given with derivatives."""


class SignalEntry(SignalData):
    """A record as a source of the run; a column may be named by a text alone."""

    columns: Mapping[Name, ColumnEntry | Text] | None = None  # pyright: ignore[reportIncompatibleVariableOverride]
    """Signals of this source by name; a text alone is the name of a column. Default: all columns."""


class RecordData(Table):
    """The recorded variables. With decimation = n, every n-th communication point is recorded."""

    variables: list[Text] | None = None
    """``INSTANCE.VARIABLE``, where ``*`` stands for any characters. Default: all outputs."""
    decimation: Count = 1
    """Every n-th communication point is recorded."""


class SystemData(Table):
    """A system file; with ``base`` it completes another one."""

    base: Text | None = None
    """A system file that this file completes: its path from here, or a name such as ``shams2010/fsmc_5sin``."""
    description: Annotated[str, Field()] = ""
    """One line about the system; pictures and reports show it."""
    connections: list[Arrow | ConnectionData] = Field(default_factory=list[Arrow | ConnectionData])
    """What feeds each input: texts ``INSTANCE.OUTPUT -> INSTANCE.INPUT``, or tables."""
    experiment: ExperimentData = ExperimentData()
    """Times, step, order and tolerance."""
    instances: Mapping[Name, InstanceData] = {}
    """The FMUs, by the names of their instances."""
    signals: Mapping[Name, SignalEntry] = {}
    """Records that feed inputs, by name."""
    record: RecordData = RecordData()
    """What the result holds."""
