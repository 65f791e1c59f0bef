"""The parts that the two controllers of a linear motor have in common."""

from __future__ import annotations

from typing import ClassVar

from cosim.model import Controller, Experiment, Record, parameter, variable
from fmus.physics.sampling import VelocitySource, saturate


class LinearMotorController(Controller):
    """Base of the controllers of a linear motor: model, limit, measured velocity and ports; not used itself.

    command = force/(k_t*K_a), limited to command_max; the output ``force`` is that of the limited command.
    """

    m_hat: float = parameter(11.0, "kg", "Estimated moving mass", min=0.0, nominal=10.0)
    b_hat: float = parameter(255.0, "N.s/m", "Estimated viscous damping", min=0.0, nominal=100.0)
    k_t: float = parameter(2.0, "A/V", "Amplifier gain", min=1e-9)
    K_a: float = parameter(50.0, "N/A", "Motor force constant", min=1e-9, nominal=10.0)
    command_max: float = parameter(0.0, "V", "Limit of the command, 0 for none", min=0.0)
    velocity_source: VelocitySource = parameter(VelocitySource.difference, "1", "Where the velocity comes from")
    velocity_filter_time: float = parameter(
        1e-3, "s", "Time constant of the velocity filter, 0 for none", min=0.0, nominal=1e-3, display_unit="ms"
    )

    experiment: ClassVar[Experiment] = Experiment(stop_time=20.0, step_size=1e-4)

    class State(Record):
        started: float = variable(0.0, "1", "1 after the first sample")
        position_last: float = variable(0.0, "m", "Position of the sample before", nominal=1e-6)
        velocity_last: float = variable(0.0, "m/s", "Velocity estimate of the sample before", nominal=1e-6)

    class Input(Record):
        position_ref: float = variable(0.0, "m", "Position reference", nominal=1e-6, display_unit="um")
        velocity_ref: float = variable(0.0, "m/s", "Velocity reference", nominal=1e-6, display_unit="um/s")
        acceleration_ref: float = variable(0.0, "m/s2", "Acceleration reference", nominal=1e-6)
        position: float = variable(0.0, "m", "Measured position", nominal=1e-6, display_unit="um")
        velocity: float = variable(0.0, "m/s", "Measured velocity", nominal=1e-6, display_unit="um/s")
        disturbance_estimate: float = variable(0.0, "N", "Estimated force towards positive position", nominal=1e-3)

    class Output(Record):
        command: float = variable(0.0, "V", "Command of the amplifier", nominal=1e-3)
        force: float = variable(0.0, "N", "Motor force of this command", nominal=1e-3)
        error: float = variable(0.0, "m", "Position error", nominal=1e-6, display_unit="um")
        velocity_estimate: float = variable(0.0, "m/s", "Measured velocity used", nominal=1e-6, display_unit="um/s")

    def limited_command(self, force: float) -> float:
        """Command for a force [N], limited [V]."""
        return saturate(force / (self.k_t * self.K_a), self.command_max)
