"""The values that do not come from FMUs: values of records, and noise, for each communication point.

The inner loop reads them from a table with one row for each communication point. Python fills the table for the next
part of the run. A row depends only on the number of its point. Therefore a part may begin at any point.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ..system.parts import Connection, SignalSource
from ..system.system import System

Array = NDArray[np.float64]

POINTS = 8192
"""Number of communication points in the table.

It is small enough for the cache, and large enough that filling the table costs little for each point.
"""

BLOCK = 4096
"""Number of noise values in a block. The seed and the number of the block determine its values."""


class Tables:
    """The table of a system. Its columns are ``columns`` (name of a signal, name of its column), then the noise."""

    def __init__(self, system: System) -> None:
        wanted = {*(connection.source for connection in system.connections), *system.record}
        self.signals: list[tuple[SignalSource, list[str]]] = []
        self.columns: list[tuple[str, str]] = []
        for signal in system.signals:
            names = [name for name in signal.outputs if (signal.name, name) in wanted]
            if names:
                self.signals.append((signal, names))
                self.columns += [(signal.name, name) for name in names]
        self.noise: list[Connection] = [c for c in system.connections if c.noise is not None]
        self.width = len(self.columns) + len(self.noise)
        self.buffer = np.zeros((POINTS + 1 if self.width else 0, self.width))
        self._samples: list[tuple[Array, Array | None]] = []
        """For each record, its columns; and their slopes, if they are interpolated."""
        for signal, names in self.signals:
            matrix = np.column_stack([signal.columns[name] for name in names])
            self._samples.append((matrix, signal.resampler.slopes(matrix) if signal.resampler.linear else None))
        self._blocks: dict[tuple[int, int], Array] = {}
        self._clock = 0.0, 0.0
        self.begin(system)

    def begin(self, system: System) -> None:
        """Use start time and step size of a variant of the system."""
        self._clock = float(system.start_time), float(system.step_size)

    def fill(self, first: int, last: int) -> None:
        """Fill the table for the communication points ``first`` to ``last``, at most ``POINTS`` after ``first``."""
        if not self.width:
            return
        points = np.arange(first, last + 1, dtype=np.float64)
        start, step = self._clock
        times = start + points * step
        lines = self.buffer[: points.size]
        column = 0
        for (signal, names), samples in zip(self.signals, self._samples, strict=True):
            lines[:, column : column + len(names)] = _values(signal, names, samples, times)
            column += len(names)
        for connection in self.noise:
            lines[:, column] = self._noise(connection, first, last)
            column += 1

    def _noise(self, connection: Connection, first: int, last: int) -> Array:
        noise = connection.noise
        assert noise is not None
        blocks = range(first // BLOCK, last // BLOCK + 1)
        for number in blocks:
            if (noise.seed, number) not in self._blocks:
                # Blocks of earlier parts of the run are not needed soon.
                self._blocks = {key: block for key, block in self._blocks.items() if key[1] >= blocks.start}
                generator = np.random.Generator(np.random.PCG64(np.random.SeedSequence([noise.seed, number])))
                self._blocks[noise.seed, number] = generator.standard_normal(BLOCK)
        together = np.concatenate([self._blocks[noise.seed, number] for number in blocks])
        return noise.rms * together[first - blocks.start * BLOCK : last + 1 - blocks.start * BLOCK]


def _values(signal: SignalSource, names: Sequence[str], samples: tuple[Array, Array | None], times: Array) -> Array:
    """The values of columns of a record at times of the run in s, shape (times, columns)."""
    own = signal.resampler
    at = times + signal.shift if signal.shift else times
    values = own.values(samples[0], at, samples[1])
    if not own.repeat and any(name in signal.rates for name in names):
        outside = own.outside(at)
        for column, name in enumerate(names):
            if name in signal.rates:
                # Before and after the record its values are constant.
                values[outside, column] = 0.0
    return values


def table_slots(tables: Tables, first: int) -> Mapping[tuple[str, str], int]:
    """The slots of the columns of records; the first one is ``first``."""
    return {column: first + number for number, column in enumerate(tables.columns)}
