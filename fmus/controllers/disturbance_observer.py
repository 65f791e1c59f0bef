"""Controller ``DisturbanceObserver``: estimate of the external force on an axis from velocity and applied force."""

from __future__ import annotations

from typing import ClassVar

from cosim.model import Choice, Controller, Experiment, Record, exp, parameter, variable, where
from fmus.physics.sampling import VelocitySource, measured_velocity


class ForceTiming(Choice):
    """The sample whose force the input applied_force holds."""

    before = 1, "That of the sample before: the controller runs after the observer"
    present = 2, "That of this sample: the importer passes outputs on before it steps"


class DisturbanceObserver(Controller):
    """First-order disturbance observer in a form without differentiation.

        disturbance_estimate = Q(s)*((m_hat*s + b_hat)*velocity - applied_force),   Q = g/(s + g)

        disturbance_estimate[k] = g*m_hat*velocity[k] - y[k]
        y[k+1] = E*y[k] + (1 - E)*(applied_force[k] - b_hat*velocity[k] + g*m_hat*velocity[k]),   E = exp(-g*T_s)

    y starts so that the first estimate is 0. The estimate is the force that pushes towards positive position in
    addition to applied_force. Controllers subtract it. Friction opposes motion, so its estimate is negative for
    positive velocity. (Observers of a load force have the opposite sign and are added.) applied_force is the whole
    realised force of the motor, after the limit and including the correction by this estimate: a controller's
    ``force``.

    The estimate does not depend on applied_force of the same sample, so there is no algebraic loop with the
    controller. But the force of a sample is known only after the estimate: in a master that runs the observer
    before the controller, or all in parallel, the input brings the force of the sample before. With force_timing
    before, y is then kept exact, and only the last increment of the estimate uses a force one sample older, an error
    of (1 - E) times the change of the force within a sample.

    A wrong m_hat or b_hat is estimated as a disturbance too. Do not combine it with a friction pulse, or with an
    integrator that is to compensate the same force.

    Source: Rubio, Ibeas & Luo, P-PI and super twisting sliding mode control schemes comparison for high-precision CNC
    machining, 2015, sec. on the disturbance observer, after Li & Xu, IEEE Trans. Control Systems Technology 18 (2010)
    798-810; the discretisation is exact for a held input.
    """

    g: float = parameter(100.0, "rad/s", "Cut-off frequency", min=0.0, nominal=100.0)
    m_hat: float = parameter(11.0, "kg", "Estimated moving mass", min=0.0, nominal=10.0)
    b_hat: float = parameter(255.0, "N.s/m", "Estimated viscous damping", min=0.0, nominal=100.0)
    force_timing: ForceTiming = parameter(ForceTiming.before, "1", "Sample of the force that applied_force brings")
    velocity_source: VelocitySource = parameter(VelocitySource.difference, "1", "Where the velocity comes from")
    velocity_filter_time: float = parameter(
        1e-3, "s", "Time constant of the velocity filter, 0 for none", min=0.0, nominal=1e-3, display_unit="ms"
    )

    experiment: ClassVar[Experiment] = Experiment(stop_time=20.0, step_size=1e-4)

    class State(Record):
        y: float = variable(0.0, "N", "Filtered model force, of the sample before with timing before", nominal=1e-3)
        force_last: float = variable(0.0, "N", "Force brought at the sample before", nominal=1e-3)
        started: float = variable(0.0, "1", "1 after the first sample")
        position_last: float = variable(0.0, "m", "Position of the sample before", nominal=1e-6)
        velocity_last: float = variable(0.0, "m/s", "Velocity estimate of the sample before", nominal=1e-6)

    class Input(Record):
        position: float = variable(0.0, "m", "Measured position", nominal=1e-6, display_unit="um")
        velocity: float = variable(0.0, "m/s", "Measured velocity", nominal=1e-6, display_unit="um/s")
        applied_force: float = variable(0.0, "N", "Realised force of the motor", nominal=1e-3)

    class Output(Record):
        disturbance_estimate: float = variable(0.0, "N", "Estimated force towards positive position", nominal=1e-3)
        velocity_estimate: float = variable(0.0, "m/s", "Measured velocity used", nominal=1e-6, display_unit="um/s")

    def output(self, t: float, x: State, u: Input) -> Output:
        velocity = measured_velocity(self, x, u)
        momentum_rate = self.g * self.m_hat * velocity
        filtered = (
            x.y if self.force_timing is ForceTiming.present else self.filtered(x.y, x.force_last, x.velocity_last)
        )
        return self.Output(
            disturbance_estimate=where(x.started > 0.5, momentum_rate - filtered, 0.0), velocity_estimate=velocity
        )

    def filtered(self, y: float, force: float, velocity: float) -> float:
        """The filter state ``y`` one sample later [N]."""
        E = exp(-self.g * self.T_s)
        return E * y + (1.0 - E) * (force + (self.g * self.m_hat - self.b_hat) * velocity)

    def update(self, t: float, x: State, u: Input, y: Output) -> State:
        velocity = y.velocity_estimate
        first = self.g * self.m_hat * velocity
        if self.force_timing is ForceTiming.present:
            following = self.filtered(where(x.started > 0.5, x.y, first), u.applied_force, velocity)
        else:
            following = where(x.started > 0.5, self.filtered(x.y, u.applied_force, x.velocity_last), first)
        return self.State(
            y=following,
            force_last=u.applied_force,
            started=1.0,
            position_last=u.position,
            velocity_last=velocity,
        )
