"""Plant ``LinearMotor``: amplifier, mass and damping of a linear motor axis, micro-milling force along it."""

from __future__ import annotations

from typing import Any, ClassVar

from cosim.model import Experiment, Plant, Record, parameter, round_to, variable
from fmus.physics.milling import Milling, Side
from fmus.physics.sampling import saturate


class LinearMotor(Milling, Plant):
    """Linear motor axis: ideal current amplifier, moving mass on viscous guides, micro-milling force along the axis.

        current       = k_t*command, limited to force_max/K_a
        motor_force   = K_a*current
        cutting_force = force in the feed direction as in MillingForce, from start_time on
        m*der(velocity) = motor_force - b*velocity + cutting_force + disturbance_force
        der(position)   = velocity

    Positive command, cutting force and disturbance push towards positive position. The axis is the feed direction x
    of the cut: with ``side`` tool it carries the spindle, with table the work. Cutting is off while ``feed_per_tooth``
    is 0. Rigid tool and axis: position does not change the chip. The amplifier has no lag (LinearMotorAxis has one, and
    cogging) and the guides no dry friction. Positions are of the order of 1 um, and the integrator's tolerance is
    relative to this size. With ploughing (h_min > 0) the force jumps where teeth enter and leave: at 10 kHz and the
    default tolerance the position is then right to some 0.3 nm, in ten integration steps a sample, instead of 2 pm in
    three.

    Source: Rubio, Ibeas & Luo, P-PI and super twisting sliding mode control schemes comparison for high-precision CNC
    machining, 2015, plant equation and section on simulations (there k_t and K_a carry these units); cutting data are
    assumptions of the order of steel cut with 0.1 mm tools.
    """

    m: float = parameter(10.0, "kg", "Moving mass", min=1e-3)
    b: float = parameter(250.0, "N.s/m", "Viscous damping of the guides", min=0.0)
    k_t: float = parameter(2.0, "A/V", "Amplifier gain", min=1e-9)
    K_a: float = parameter(50.0, "N/A", "Motor force constant", min=1e-9)
    force_max: float = parameter(0.0, "N", "Largest motor force, 0 for no limit", min=0.0)
    position_start: float = parameter(0.0, "m", "Position at the start", nominal=1e-6, display_unit="um")
    velocity_start: float = parameter(0.0, "m/s", "Velocity at the start", nominal=1e-6, display_unit="um/s")
    position_resolution: float = parameter(
        0.0, "m", "Resolution of position, 0 for none", min=0.0, nominal=1e-9, display_unit="nm"
    )
    side: Side = parameter(Side.tool, "1", "Body that the axis carries")
    feed_per_tooth: float = parameter(
        0.0, "m", "Feed per tooth, 0 for no cutting", min=0.0, nominal=1e-6, display_unit="um"
    )

    class State(Record):
        position: float = variable(0.0, "m", "Position of the table", nominal=1e-6, display_unit="um")
        velocity: float = variable(0.0, "m/s", "Velocity of the table", nominal=1e-6, display_unit="um/s")

    class Input(Record):
        command: float = variable(0.0, "V", "Command of the amplifier")
        disturbance_force: float = variable(0.0, "N", "External force towards positive position")

    class Output(Record):
        position: float = variable(0.0, "m", "Position of the table", nominal=1e-6, display_unit="um")
        velocity: float = variable(0.0, "m/s", "Velocity of the table", nominal=1e-6, display_unit="um/s")
        current: float = variable(0.0, "A", "Motor current", nominal=1e-3)
        motor_force: float = variable(0.0, "N", "Force of the motor", nominal=1e-3)
        cutting_force: float = variable(0.0, "N", "Cutting force along the axis", nominal=0.1)

    experiment: ClassVar[Experiment] = Experiment(stop_time=20.0, step_size=1e-4)

    def initial(self) -> State:
        return self.State(position=self.position_start, velocity=self.velocity_start)

    def derivative(self, t: float, x: Any, u: Input) -> Any:
        force = self.motor_force(x, u) + self.cutting_force(t) + u.disturbance_force
        return self.State(position=x.velocity, velocity=(force - self.b * x.velocity) / self.m)

    def output(self, t: float, x: State, u: Input) -> Output:
        return self.Output(
            position=round_to(x.position, self.position_resolution),
            velocity=x.velocity,
            current=self.motor_current(x, u),
            motor_force=self.motor_force(x, u),
            cutting_force=self.cutting_force(t),
        )

    def target(self, u: Input) -> float:
        """Commanded current of the amplifier [A]."""
        return saturate(self.k_t * u.command, self.force_max / self.K_a)

    def motor_current(self, x: Any, u: Input) -> float:
        """Current of the motor [A] for an amplifier without lag; LinearMotorAxis overrides it."""
        return self.target(u)

    def motor_force(self, x: Any, u: Input) -> float:
        """Force of the motor [N] without ripple; LinearMotorAxis overrides it."""
        return self.K_a * self.motor_current(x, u)

    def cutting_force(self, t: float) -> float:
        """Cutting force along the axis [N]."""
        force = self.forces_on_tool(t).x
        return force if self.side is Side.tool else -force
