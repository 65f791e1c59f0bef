"""Schemas of the files that ask for runs of a system: sweeps, tunings, maps of limits, fits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Discriminator, Field, Tag, model_validator

from ..fmu.tables import Count, Number, Positive, Scalar, Seconds, Table, Text


class RangeData(Table):
    """Values between two ends, in equal steps or equal ratios."""

    EXAMPLE: ClassVar[str] = "{ from = 1.0, to = 2.0 }"

    low: Annotated[Number, Field(alias="from")]
    high: Annotated[Number, Field(alias="to")]
    log: bool = False
    """Equal ratios instead of equal steps."""

    @model_validator(mode="after")
    def _log_of_positive(self) -> RangeData:
        if self.log and not (self.low > 0.0 and self.high > 0.0):
            raise ValueError(f"log needs positive ends, not {self.low:g} and {self.high:g}")
        return self

    def at(self, share: float) -> float:
        """The value at ``share`` of the range: 0 is its lower end, 1 its upper end."""
        if self.log:
            return self.low * (self.high / self.low) ** share
        return self.low + (self.high - self.low) * share


class AxisData(RangeData):
    """A range with the number of its values, which a grid and a list need."""

    EXAMPLE: ClassVar[str] = "{ from = 1.0, to = 2.0, count = 5 }, or a list of values"

    count: Count | None = None


def _list_or_table(value: object) -> str:
    return "list" if isinstance(value, list | tuple) else "table"


Values = Annotated[list[Scalar], Field(min_length=1)]
Axis = Annotated[
    Annotated[AxisData, Tag("table")] | Annotated[Values, Tag("list")],
    Discriminator(_list_or_table),
]
"""The values of a parameter: a list, or a range."""


class MetricData(Table):
    """A figure of one signal."""

    EXAMPLE: ClassVar[str] = '{ of = "rms", signal = "controller.error" }'

    of: Text
    signal: Text


Window = Annotated[list[Number], Field(min_length=2, max_length=2)]
Figure = Annotated[
    Annotated[MetricData, Tag("table")] | Annotated[Window, Tag("list")],
    Discriminator(_list_or_table),
]
"""A figure. Under the key ``window``: begin and end in s of the time in which all figures are taken."""


class ExperimentData(Table):
    """What is changed of the experiment of the system."""

    stop_time: Seconds | None = None
    step_size: Seconds | None = None
    order: Text | list[Text] | None = None


class RunsData(Table):
    """What files have in common that ask for runs of a system."""

    system: Text
    """A system file, relative to this file, or the name of a system that comes with cosim."""
    description: str = ""
    timeout: Positive | None = None
    """Limit for a run, s."""
    metrics: Mapping[str, Figure] = {}
    experiment: ExperimentData = ExperimentData()


class SweepData(RunsData):
    """A sweep file."""

    method: Literal["grid", "list", "latin", "sobol"] = "grid"
    count: Count | None = None
    """Number of runs, for latin and sobol only."""
    seed: int = 1
    parameters: Annotated[dict[str, Axis], Field(min_length=1)]

    @model_validator(mode="after")
    def _counts(self) -> SweepData:
        if self.method in ("latin", "sobol") and self.count is None:
            raise ValueError(f"count: missing; {self.method} needs a number of runs, such as count = 64")
        return self


class TuningData(RunsData):
    """A tuning file."""

    objective: Text
    """Name of the metric that is minimized."""
    generations: Count = 30
    population: Count = 15
    """Number of points in a generation for each parameter."""
    seed: Count = 1
    parameters: Annotated[dict[str, RangeData], Field(min_length=1)]
    limits: Mapping[str, Number] = {}
    """Largest values of metrics."""


Frequencies = Annotated[list[Positive], Field(min_length=1)]


class CaseData(Table):
    """One object of a map."""

    W: Frequencies | None = None
    alpha: Positive | None = None
    nct: bool = False
    """Whether the controller gets the NCT of this alpha."""
    first: Positive = 300.0
    """Gain at which the scan begins."""
    overrides: Mapping[str, Any] = {}


class MapData(Table):
    """A map file."""

    system: Text
    """A system file, relative to this file, or the name of a system that comes with cosim."""
    description: str = ""
    timeout: Positive | None = None
    """Limit for a run, s."""
    alpha: Positive
    """Inclination of the NCT in the gain formulas, 1/s."""
    K: Positive
    """Displacement in m for a command of one unit during one second, m/s for a unit of command."""
    W: Frequencies
    """Values of omega_n*T_s."""
    pulse: Text | None = None
    """System file of the pulse that identifies the NCT of cases with ``nct = true``."""
    controller: Text | None = None
    """The instance that gets the NCT; default: that of the study's names."""
    overrides: Mapping[str, Any] = {}
    cases: Annotated[dict[str, CaseData], Field(min_length=1)]

    @model_validator(mode="after")
    def _pulse_for_nct(self) -> MapData:
        wanting = [name for name, case in self.cases.items() if case.nct]
        if wanting and self.pulse is None:
            raise ValueError(
                f"cases.{wanting[0]}.nct: the NCT is identified from a pulse, and none is named. "
                'Write pulse = "pulse.toml"'
            )
        return self


class FreeData(Table):
    """A free value: where it starts, between what it stays."""

    EXAMPLE: ClassVar[str] = "{ from = 1.0, to = 2.0 }"

    start: Number | None = None
    low: Annotated[Number | None, Field(alias="from")] = None
    high: Annotated[Number | None, Field(alias="to")] = None
    log: bool = False
    """Whether the search uses the logarithm of the value."""

    @model_validator(mode="after")
    def _in_order(self) -> FreeData:
        given = [value for value in (self.low, self.start, self.high) if value is not None]
        if sorted(given) != given or (self.low is not None and self.low == self.high):
            raise ValueError("from, start and to must rise")
        if self.log and given and given[0] <= 0.0:
            raise ValueError(f"log needs positive values, not {given[0]:g}")
        return self


class ParameterData(FreeData):
    """A free start value of an FMU."""

    also: Sequence[Text] = ()
    """More variables that get the same value."""


def _number_or_table(value: object) -> str:
    return "table" if isinstance(value, Mapping) else "number"


FixedOrFree = Annotated[
    Annotated[FreeData, Tag("table")] | Annotated[Number, Tag("number")], Discriminator(_number_or_table)
]


class OutputData(Table):
    """A signal of the system and the column that it is compared with."""

    EXAMPLE: ClassVar[str] = '{ signal = "plant.position", column = "x" }'

    signal: Text
    column: Text | None = None
    unit: Text | None = None
    """Unit of the column; default: the unit in the record, else the unit of the signal."""
    factor: Number = 1.0
    """Factor on the column before it is compared."""
    reference: Text | None = None
    """Column that is subtracted for the figures: the reference of a loop gives figures of the tracking error."""
    noise: Positive | None = None
    """Standard deviation in the unit of the signal."""
    delay: FixedOrFree = 0.0
    """Delay of the record in s."""
    gain: FixedOrFree = 1.0
    bias: FixedOrFree = 0.0


class RecordData(Table):
    """A record."""

    EXAMPLE: ClassVar[str] = '{ file = "stage.csv" }'

    file: Text
    use: Literal["fit", "validate"] = "fit"
    time: Text | None = None
    sampling_time: Positive | None = None
    signals: list[Text] | None = None
    window: Window | None = None
    period: Positive | None = None
    start: Mapping[str, Scalar] = {}
    free: Mapping[str, ParameterData] = {}


class FitData(Table):
    """A fit file."""

    system: Text
    """A system file, relative to this file, or the name of a system that comes with cosim."""
    description: str = ""
    timeout: Positive | None = None
    """Limit for a run, s."""
    loss: Literal["linear", "soft_l1", "huber", "cauchy"] = "linear"
    starts: Count = 1
    seed: int = 1
    loops: Count = 200
    """Most runs of a record."""
    parameters: Annotated[dict[str, ParameterData], Field(min_length=1)]
    outputs: Annotated[dict[str, OutputData], Field(min_length=1)]
    records: Annotated[dict[str, RecordData], Field(min_length=1)]
    experiment: ExperimentData = ExperimentData()
