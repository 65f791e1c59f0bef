"""Plant ``NominalStage``: the linear model K*alpha/(s*(s + alpha)) that NCTF control assumes."""

from __future__ import annotations

from typing import ClassVar

from cosim.model import Experiment, Plant, Record, parameter, round_to, variable
from fmus.physics.sampling import saturate


class NominalStage(Plant):
    """Linear stage of first-order velocity response, without friction.

        der(position) = velocity
        der(velocity) = alpha*(K*command - velocity) - disturbance

    Positive command moves to positive position; a positive disturbance (a force divided by the mass) opposes
    positive motion. The command is limited to +-command_max. Resolution rounds the measured position only.

    Start values: the stage of Purtojo et al. with alpha = 215.2 1/s; the paper prints 0.2152 without a unit.

    Source: Purtojo, Wahyudi et al., fuzzy NCTF control of a PTP positioning system, 2015; Maeda & Sato, Precision
    Engineering 32, 2008, sec. 4.1 (simplified object of control).
    """

    K: float = parameter(5.672e-3, "m/(s.V)", "Steady velocity a unit of command", min=0.0, nominal=1e-2)
    alpha: float = parameter(215.2, "1/s", "Pole of the velocity", min=0.0, nominal=100.0)
    command_max: float = parameter(0.0, "V", "Limit of the command, 0 for none", min=0.0)
    position_resolution: float = parameter(
        0.0, "m", "Resolution of position, 0 for none", min=0.0, nominal=1e-9, display_unit="um"
    )
    position_start: float = parameter(0.0, "m", "Position at the start", display_unit="mm")
    velocity_start: float = parameter(0.0, "m/s", "Velocity at the start", display_unit="mm/s")

    experiment: ClassVar[Experiment] = Experiment(stop_time=2.0, step_size=1e-4)

    class State(Record):
        position: float = variable(0.0, "m", "Position", nominal=1e-3, display_unit="mm")
        velocity: float = variable(0.0, "m/s", "Velocity", nominal=1e-2, display_unit="mm/s")

    class Input(Record):
        command: float = variable(0.0, "V", "Command")
        disturbance: float = variable(0.0, "m/s2", "Disturbance, positive against positive motion")

    class Output(Record):
        position: float = variable(0.0, "m", "Measured position", display_unit="mm")
        velocity: float = variable(0.0, "m/s", "Velocity", display_unit="mm/s")

    def initial(self) -> State:
        return self.State(position=self.position_start, velocity=self.velocity_start)

    def derivative(self, t: float, x: State, u: Input) -> State:
        target = self.K * saturate(u.command, self.command_max)
        return self.State(position=x.velocity, velocity=self.alpha * (target - x.velocity) - u.disturbance)

    def output(self, t: float, x: State, u: Input) -> Output:
        return self.Output(position=round_to(x.position, self.position_resolution), velocity=x.velocity)
