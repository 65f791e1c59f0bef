"""A controller that tells what it sampled: made for tests of the sampling instants."""

from __future__ import annotations

from typing import Any

from cosim.model import Controller, Record, exp, parameter, variable


class Counter(Controller):
    """Counts its samples and shows the input it saw at the last one.

    Source: made for tests.
    """

    log_scale: float = parameter(0.0, "1", "Logarithm of the factor of what is shown", variability="tunable")

    class State(Record):
        count: float = variable(0.0, "1", "Samples taken")

    class Input(Record):
        step: float = variable(0.0, "1", "Number of the communication step")

    class Output(Record):
        seen: float = variable(0.0, "1", "Input at the last sample, times exp(log_scale)")
        samples: float = variable(0.0, "1", "Samples taken, the last one included")

    def output(self, t: float, x: Any, u: Any) -> Any:
        return self.Output(seen=u.step * exp(self.log_scale), samples=x.count + 1.0)

    def update(self, t: float, x: Any, u: Any, y: Any) -> Any:
        return self.State(count=y.samples)
