"""The parts of a system: instances, connections, and the digest of everything that decides its results."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from typing import Literal

from ..fmu.description import Fmu
from ..fmu.variables import Value

Order = Literal["sequential", "parallel"] | tuple[str, ...]


@dataclass(frozen=True)
class Instance:
    """One use of an FMU in a system."""

    name: str
    fmu: Fmu
    start: Mapping[str, Value]
    step_multiple: int


Units = Literal["same", "converted", "given", "suppressed"]
"""How a connection treats the units of its ends: they are the same; the values are converted by what the files say
about the units; the factor that is given converts; the values are taken as they are, whatever the units."""


@dataclass(frozen=True)
class Connection:
    """``target = factor*source + offset``; both ends are (instance, variable)."""

    source: tuple[str, str]
    target: tuple[str, str]
    factor: float = 1.0
    offset: float = 0.0
    units: Units = "same"
    stated: tuple[float, float] = (1.0, 0.0)
    """Factor and offset as written, which act after a conversion of units; without one they are factor and offset."""

    def __str__(self) -> str:
        return f"{'.'.join(self.source)} -> {'.'.join(self.target)}"


def system_digest(  # noqa: PLR0917
    instances: Mapping[str, Instance],
    connections: Sequence[Connection],
    times: Sequence[Decimal],
    order: Order,
    tolerance: float | None,
    record: Sequence[tuple[str, str]],
    decimation: int,
) -> str:
    """SHA-256 of everything that decides the results."""
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
