"""Controller ``CascadeP``: P position and P velocity cascade, velocity from the mean of two positions."""

from __future__ import annotations

from typing import ClassVar

from cosim.model import Controller, Experiment, Record, parameter, variable, where
from fmus.physics.sampling import saturate


class CascadeP(Controller):
    """Two proportional loops in a row, as many drives have them, without integral part and feed-forward.

        error    = position_ref - position
        mean[k]  = (position[k] + position[k-1])/2
        velocity = (mean[k] - mean[k-1])/T_s = (position[k] - position[k-2])/(2*T_s)
        command  = K_vel*(K_pos*error - velocity), limited to command_max

    A difference of positions turns the resolution of an encoder into noise. The mean of two positions halves this noise
    and adds half a sample of delay. Before the first sample the axis is assumed to rest at its first position. A
    positive command drives towards positive position.

    Source: Janot, Gautier & Brunot, Data set and reference models of EMPS, Workshop on Nonlinear System Identification
    Benchmarks, 2019 (position and velocity loop; the start values are its gains). The mean of two positions was found
    in the data of that benchmark: with it the logged command follows from the logged positions to 0.24 %.
    """

    T_s: float = parameter(1e-3, "s", "Sampling time", min=1e-9, nominal=1e-3, display_unit="ms")
    K_pos: float = parameter(160.18, "1/s", "Position gain", min=0.0, nominal=100.0)
    K_vel: float = parameter(243.45, "V.s/m", "Velocity gain", min=0.0, nominal=100.0)
    command_max: float = parameter(10.0, "V", "Largest command (0 = no limit)", min=0.0)

    experiment: ClassVar[Experiment] = Experiment(stop_time=10.0, step_size=1e-3)

    class State(Record):
        started: float = variable(0.0, "1", "1 after the first sample")
        position_last: float = variable(0.0, "m", "Position of the sample before", nominal=1e-3)
        position_before: float = variable(0.0, "m", "Position two samples before", nominal=1e-3)

    class Input(Record):
        position_ref: float = variable(0.0, "m", "Position reference", nominal=1e-3, display_unit="mm")
        position: float = variable(0.0, "m", "Measured position", nominal=1e-3, display_unit="mm")

    class Output(Record):
        command: float = variable(0.0, "V", "Command of the drive")
        error: float = variable(0.0, "m", "Position error", nominal=1e-6, display_unit="um")
        velocity_estimate: float = variable(0.0, "m/s", "Velocity used", nominal=1e-3, display_unit="mm/s")

    def output(self, t: float, x: State, u: Input) -> Output:
        before = where(x.started > 0.5, x.position_before, u.position)
        velocity = (u.position - before) / (2.0 * self.T_s)
        error = u.position_ref - u.position
        command = saturate(self.K_vel * (self.K_pos * error - velocity), self.command_max)
        return self.Output(command=command, error=error, velocity_estimate=velocity)

    def update(self, t: float, x: State, u: Input, y: Output) -> State:
        return self.State(
            started=1.0,
            position_last=u.position,
            position_before=where(x.started > 0.5, x.position_last, u.position),
        )
