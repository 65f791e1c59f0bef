"""The parts of a system: instances, signals, connections, and the digest of everything that decides its results."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from ..fmu.description import Array, Fmu
from ..fmu.variables import Value, Variable
from ..units import Unit, resolve_unit

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from ..record.resample import Resampler

Order = Literal["sequential", "parallel"] | tuple[str, ...]


@dataclass(frozen=True)
class Instance:
    """One use of an FMU in a system."""

    name: str
    fmu: Fmu
    start: Mapping[str, Value]
    step_multiple: int


@dataclass(frozen=True)
class SignalSource:
    """A record as a source: an entry of ``[signals]``. Its columns feed inputs as the outputs of an FMU do."""

    name: str
    path: Path
    digest: str
    """SHA-256 of the file."""
    table: Mapping[str, Any]
    """The entry of ``[signals]`` as it is written."""
    variables: Mapping[str, Variable]
    columns: Mapping[str, NDArray[np.float64]] = field(repr=False, compare=False)
    """Values of the columns and of their derivatives, by name, after factor and offset."""
    rates: frozenset[str]
    """Names of the derivatives among the columns. They are 0 before and after a record that holds its values there."""
    resampler: Resampler = field(repr=False, compare=False)
    shift: float
    """Time of the record minus time of the run, in s."""
    converted: Mapping[str, str]
    """For each column whose unit is converted: the unit that the file states, or the description beside it."""

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the columns."""
        return tuple(self.variables)

    @property
    def inputs(self) -> tuple[str, ...]:
        """Always empty: nothing feeds a record."""
        return ()

    @property
    def arrays(self) -> Mapping[str, Array]:
        """Always empty: ``a[1]`` is a column of its own."""
        return {}

    def unit(self, name: str) -> Unit | None:
        """The unit of this name; None if it is unknown."""
        return resolve_unit(name)


Ports = Fmu | SignalSource
"""The possible sources of a connection; only an Fmu can be a target."""


@dataclass(frozen=True)
class Noise:
    """Normally distributed noise that is added to an input, with a new value each communication step.

    ``rms`` is in the unit of the input.
    """

    rms: float
    seed: int


Units = Literal["same", "converted", "given", "suppressed"]
"""How a connection treats the units of its two ends.

"same": the units are equal. "converted": the values are converted from the source's unit to the target's.
"given": the factor in the system file converts. "suppressed": the values are passed on unchanged, whatever the units.
"""


@dataclass(frozen=True)
class Connection:
    """``target = factor*source + offset``; both ends are (instance, variable)."""

    source: tuple[str, str]
    target: tuple[str, str]
    factor: float = 1.0
    offset: float = 0.0
    units: Units = "same"
    stated: tuple[float, float] = (1.0, 0.0)
    """Factor and offset as written in the system file. They act after a conversion of units.

    Without a conversion they are equal to ``factor`` and ``offset``.
    """
    added: bool = False
    """Whether this connection is a later addend of a sum. Its value is added to the connection before it."""
    noise: Noise | None = None
    """Noise that is added to the input. In a sum, only the first connection has it."""

    def __str__(self) -> str:
        return f"{'.'.join(self.source)} -> {'.'.join(self.target)}"


def sources(connections: Sequence[Connection]) -> dict[tuple[str, str], tuple[tuple[str, str], ...]]:
    """For each connected input, the outputs that feed it; a sum has several."""
    found: dict[tuple[str, str], tuple[tuple[str, str], ...]] = {}
    for connection in connections:
        found[connection.target] = (*found.get(connection.target, ()), connection.source)
    return found
