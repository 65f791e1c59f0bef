"""What comes into a run from outside of its FMUs, point by point: values of records, and noise.

The inner loop takes them out of a table, one line a communication point. Python fills the table for the points of the
next part of the run. What stands in a line depends on the number of its point only: parts may begin anywhere.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ..system.parts import Connection, SignalSource
from ..system.system import System

Array = NDArray[np.float64]

POINTS = 8192
"""Communication points in the table: it stays in the cache, and filling it costs little a point."""

BLOCK = 4096
"""Numbers of noise that are drawn together, from the seed and the number of their block."""


class Tables:
    """The values from outside for a system: ``columns`` are (name of a signal, column), noise comes behind them."""

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
        """Of each record its columns, and their slopes where they are interpolated."""
        for signal, names in self.signals:
            matrix = np.column_stack([signal.columns[name] for name in names])
            self._samples.append((matrix, signal.resampler.slopes(matrix) if signal.resampler.linear else None))
        self._blocks: dict[tuple[int, int], Array] = {}
        self._clock = 0.0, 0.0
        self.begin(system)

    def begin(self, system: System) -> None:
        """Take the times of a variant of the system."""
        self._clock = float(system.start_time), float(system.step_size)

    def fill(self, first: int, last: int) -> None:
        """Fill the table for the communication points ``first`` to ``last``, at most ``POINTS`` behind it."""
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
                # Those of another part of the run are not needed again soon.
                self._blocks = {key: block for key, block in self._blocks.items() if key[1] >= blocks.start}
                generator = np.random.Generator(np.random.PCG64(np.random.SeedSequence([noise.seed, number])))
                self._blocks[noise.seed, number] = generator.standard_normal(BLOCK)
        together = np.concatenate([self._blocks[noise.seed, number] for number in blocks])
        return noise.rms * together[first - blocks.start * BLOCK : last + 1 - blocks.start * BLOCK]


def _values(signal: SignalSource, names: Sequence[str], samples: tuple[Array, Array | None], times: Array) -> Array:
    """The values of columns of a record at times of the run."""
    own = signal.resampler
    at = times + signal.shift if signal.shift else times
    values = own.values(samples[0], at, samples[1])
    if not own.repeat and any(name in signal.rates for name in names):
        outside = own.outside(at)
        for column, name in enumerate(names):
            if name in signal.rates:
                # Where the first or the last sample holds, nothing changes.
                values[outside, column] = 0.0
    return values


def table_slots(tables: Tables, first: int) -> Mapping[tuple[str, str], int]:
    """The slots of the columns of records, which begin at ``first``."""
    return {column: first + number for number, column in enumerate(tables.columns)}
