"""Schemas of the files that ask for runs of a system: sweeps, tunings, maps of limits, fits."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal

from pydantic import BeforeValidator, Discriminator, Field, Tag, model_validator

from ..fmu.tables import Number, Pair, Positive, Scalar, Seconds, Seed, Step, Table, Text, number, whole
from ..result.metrics import OF_ONE_SIGNAL

MOST_RUNS = 10**6
"""Largest number of runs that a file may ask for. Their rows fit into memory; a larger number is probably a slip."""

Runs = Annotated[int, Field(ge=1, le=MOST_RUNS), BeforeValidator(whole)]


class RangeData(Table):
    """Values between two ends, in equal steps or equal ratios."""

    EXAMPLE: ClassVar[str] = "{ from = 1.0, to = 2.0 }"

    low: Annotated[Number, Field(alias="from")]
    """Lower end, in the unit of the variable."""
    high: Annotated[Number, Field(alias="to")]
    """Upper end, in the unit of the variable."""
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

    count: Runs | None = None
    """Number of values. A grid and a list need it; latin and sobol take ``count`` of the file."""


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

    of: Annotated[Text, Field(json_schema_extra={"enum": [*OF_ONE_SIGNAL]})]
    """The figure."""
    signal: Text
    """``INSTANCE.VARIABLE``. It is recorded for the figure."""


Figure = Annotated[
    Annotated[MetricData, Tag("table")] | Annotated[Pair, Tag("list")],
    Discriminator(_list_or_table),
]
"""A figure. Under the key ``window``: begin and end in s of the time in which all figures are taken."""


class ExperimentData(Table):
    """What is changed of the experiment of the system."""

    stop_time: Seconds | None = None
    """End of the run in s. Default: that of the system."""
    step_size: Step | None = None
    """Communication step in s. Default: that of the system."""
    order: Text | list[Text] | None = None
    """``"sequential"``, ``"parallel"`` or a list of instances. Default: that of the system."""


class RunsData(Table):
    """What files have in common that ask for runs of a system."""

    system: Text
    """A system file, relative to this file, or the name of a system that comes with cosim."""
    description: str = ""
    """One line about the study; the report shows it."""
    timeout: Positive | None = None
    """Longest time of a run in s of the clock. Default: 20 times the longest run so far, at least 10 s."""
    metrics: Mapping[str, Figure] = {}
    """Figures of a run by name; ``window`` gives begin and end in s. Default: the tracking figures."""
    experiment: ExperimentData = ExperimentData()
    """What is changed of the experiment of the system."""


class SweepData(RunsData):
    """A sweep file."""

    method: Literal["grid", "list", "latin", "sobol"] = "grid"
    """``grid``: all combinations; ``list``: values side by side; ``latin``, ``sobol``: random designs of ranges."""
    count: Runs | None = None
    """Number of runs, for latin and sobol only."""
    seed: Seed = 1
    """Seed of latin and sobol."""
    parameters: Annotated[dict[str, Axis], Field(min_length=1)]
    """``INSTANCE.VARIABLE`` (or the setting of a signal) and its values: a list or a range."""

    @model_validator(mode="after")
    def _counts(self) -> SweepData:
        if self.method in ("latin", "sobol") and self.count is None:
            raise ValueError(f"count: missing; {self.method} needs a number of runs, such as count = 64")
        return self


class TuningData(RunsData):
    """A tuning file."""

    objective: Text
    """Name of the metric that is minimized."""
    generations: Runs = 30
    """Most generations of the search."""
    population: Runs = 15
    """Number of points in a generation for each parameter."""
    seed: Seed = 1
    """Seed of the random numbers."""
    parameters: Annotated[dict[str, RangeData], Field(min_length=1)]
    """``INSTANCE.VARIABLE`` and the range in which its value is looked for."""
    limits: Mapping[str, Number] = {}
    """Largest value of a metric, in its unit."""

    @model_validator(mode="after")
    def _not_too_many(self) -> TuningData:
        runs = self.generations * self.population * len(self.parameters)
        if runs > MOST_RUNS:
            raise ValueError(f"generations times population ask for {runs} runs; at most {MOST_RUNS} are possible")
        return self


Frequency = Annotated[float, Field(allow_inf_nan=False, gt=0.0, lt=math.pi), BeforeValidator(number)]
Frequencies = Annotated[list[Frequency], Field(min_length=1)]
"""Values of omega_n*T_s: a sampled loop has no frequency above pi."""


class CaseData(Table):
    """One object of a map."""

    W: Frequencies | None = None
    """Values of omega_n*T_s for this case. Default: those of the file."""
    alpha: Positive | None = None
    """Inclination of the NCT for this case, 1/s. Default: that of the file."""
    nct: bool = False
    """Whether the controller gets the NCT of this alpha."""
    first: Positive = 300.0
    """Gain at which the scan begins."""
    overrides: Mapping[str, Any] = {}
    """Start values of this case, besides those of the file."""


class MapData(Table):
    """A map file."""

    system: Text
    """A system file, relative to this file, or the name of a system that comes with cosim."""
    description: str = ""
    """One line about the map."""
    timeout: Positive | None = None
    """Longest time of a run in s of the clock. Default: none."""
    alpha: Positive
    """Inclination of the NCT in the gain formulas, 1/s."""
    K: Positive
    """Displacement in m for a command of one unit during one second, m/s for a unit of command."""
    W: Frequencies
    """Values of omega_n*T_s."""
    pulse: Text | None = None
    """System file of the pulse that identifies the NCT of cases with ``nct = true``."""
    controller: Text | None = None
    """The instance that gets the NCT. Default: that of the study's names."""
    overrides: Mapping[str, Any] = {}
    """Start values of all cases."""
    cases: Annotated[dict[str, CaseData], Field(min_length=1)]
    """The objects that are compared, by the names that the picture shows."""

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
    """First value of the search."""
    low: Annotated[Number | None, Field(alias="from")] = None
    """Lower bound."""
    high: Annotated[Number | None, Field(alias="to")] = None
    """Upper bound."""
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

    @property
    def bounds(self) -> tuple[float, float]:
        """Lower and upper bound; infinite where none is given."""
        return -math.inf if self.low is None else self.low, math.inf if self.high is None else self.high


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
    """``INSTANCE.VARIABLE`` of the system."""
    column: Text | None = None
    """Column of the records. Default: the name of the output."""
    unit: Text | None = None
    """Unit of the column. Default: the unit in the record, else the unit of the signal."""
    factor: Number = 1.0
    """Factor on the column, beside the conversion of its unit, before it is compared."""
    reference: Text | None = None
    """Column that is subtracted for the figures: the reference of a loop gives figures of the tracking error."""
    noise: Positive | None = None
    """Standard deviation of the sensor in the unit of the signal. Default: taken from the records."""
    delay: FixedOrFree = 0.0
    """Delay of the record in s: a number, or a free value."""
    gain: FixedOrFree = 1.0
    """Gain of the sensor, ``record = gain*signal + bias``: a number, or a free value."""
    bias: FixedOrFree = 0.0
    """Bias of the sensor in the unit of the signal: a number, or a free value."""

    @property
    def sensor(self) -> Mapping[str, float | FreeData]:
        """Delay, gain and bias by name."""
        return {"delay": self.delay, "gain": self.gain, "bias": self.bias}


class RecordData(Table):
    """A record."""

    EXAMPLE: ClassVar[str] = '{ file = "stage.csv" }'

    file: Text
    """The record, relative to this file."""
    use: Literal["fit", "validate"] = "fit"
    """``fit``: the parameters are fitted to it; ``validate``: it is only compared, at the end."""
    time: Text | None = None
    """Column of time. Default: the column called time or t."""
    sampling_time: Positive | None = None
    """Sampling time in s of a record without a column of time."""
    signals: list[Text] | None = None
    """Tables ``[signals]`` of the system that read this record. Default: all of them."""
    window: Pair | None = None
    """Begin and end in s of the samples that are used. Default: all."""
    period: Positive | None = None
    """Time in s after which the machine repeats itself: its repeatability from lap to lap is then told."""
    start: Mapping[str, Scalar] = {}
    """Start values by ``INSTANCE.VARIABLE`` in this record only."""
    free: Mapping[str, ParameterData] = {}
    """Values by ``INSTANCE.VARIABLE`` that are free in this record only."""


class FitData(Table):
    """A fit file."""

    system: Text
    """A system file, relative to this file, or the name of a system that comes with cosim."""
    description: str = ""
    """One line about the fit; the page shows it."""
    timeout: Positive | None = None
    """Longest time of a run in s of the clock. Default: none."""
    loss: Literal["linear", "soft_l1", "huber", "cauchy"] = "linear"
    """``linear`` is least squares; with the others outliers count less."""
    starts: Runs = 1
    """Number of starting points that are tried."""
    seed: Seed = 1
    """Seed of the starting points."""
    loops: Runs = 200
    """Most runs of a record."""
    parameters: Annotated[dict[str, ParameterData], Field(min_length=1)]
    """Free start values by ``INSTANCE.VARIABLE``; bounds default to those of the FMU."""
    outputs: Annotated[dict[str, OutputData], Field(min_length=1)]
    """What is compared, by name."""
    records: Annotated[dict[str, RecordData], Field(min_length=1)]
    """The records, by name."""
    experiment: ExperimentData = ExperimentData()
    """What is changed of the experiment of the system. ``stop_time`` defaults to the end of each record."""
