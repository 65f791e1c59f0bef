"""Controller ``DisturbanceObserver``: estimate of the external force on an axis from velocity and applied force."""

from __future__ import annotations

from typing import ClassVar

from cosim.model import Controller, Experiment, Record, exp, parameter, variable, where
from fmus.physics.sampling import VelocitySource, velocity_estimate


class DisturbanceObserver(Controller):
    """First-order disturbance observer in a form without differentiation.

        disturbance_estimate = Q(s)*((m_hat*s + b_hat)*velocity - applied_force),   Q = g/(s + g)

        disturbance_estimate = g*m_hat*velocity - y
        y[k+1] = E*y + (1 - E)*(applied_force - b_hat*velocity + g*m_hat*velocity),   E = exp(-g*T_s)

    y starts so that the first estimate is 0. The estimate is the force that pushes towards positive position beyond
    applied_force; controllers subtract it, and friction, which opposes motion, is estimated negative for positive
    velocity. (Observers of a load force have the opposite sign and are added.) applied_force is the whole realised
    force of the motor, limited and with the correction by this estimate in it: a controller's ``force``. It does not
    feed through to the estimate, so there is no algebraic loop; a master that steps one component after the other
    hands it over one sample late, which moves the errors of the linear motor's loop by 0.2 %.

    A wrong m_hat or b_hat is estimated as a disturbance too. Do not combine it with a friction pulse, or with an
    integrator that is to compensate the same force.

    Source: Rubio, Ibeas & Luo, Super-twisting sliding mode control of a linear motor for micro-milling, 2015,
    sec. on the disturbance observer, after Li & Xu, IEEE Trans. Control Systems Technology 18 (2010) 798-810;
    the discretisation is exact for a held input.
    """

    T_s: float = parameter(1e-4, "s", "Sampling time", min=1e-9, nominal=1e-4, display_unit="ms")
    g: float = parameter(100.0, "rad/s", "Cut-off frequency", min=0.0, nominal=100.0)
    m_hat: float = parameter(11.0, "kg", "Estimated moving mass", min=0.0, nominal=10.0)
    b_hat: float = parameter(255.0, "N.s/m", "Estimated viscous damping", min=0.0, nominal=100.0)
    velocity_source: VelocitySource = parameter(VelocitySource.difference, "1", "Where the velocity comes from")
    velocity_filter_time: float = parameter(
        1e-3, "s", "Time constant of the velocity filter, 0 for none", min=0.0, nominal=1e-3, display_unit="ms"
    )

    experiment: ClassVar[Experiment] = Experiment(stop_time=20.0, step_size=1e-4)

    class State(Record):
        y: float = variable(0.0, "N", "Filtered model force", nominal=1e-3)
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
        velocity = velocity_estimate(
            self.velocity_source,
            x.started,
            u.position,
            u.velocity,
            position_last=x.position_last,
            velocity_last=x.velocity_last,
            T_s=self.T_s,
            filter_time=self.velocity_filter_time,
        )
        return self.Output(
            disturbance_estimate=where(x.started > 0.5, self.g * self.m_hat * velocity - x.y, 0.0),
            velocity_estimate=velocity,
        )

    def update(self, t: float, x: State, u: Input, y: Output) -> State:
        E = exp(-self.g * self.T_s)
        momentum_rate = self.g * self.m_hat * y.velocity_estimate
        filtered = momentum_rate - y.disturbance_estimate
        return self.State(
            y=E * filtered + (1.0 - E) * (u.applied_force - self.b_hat * y.velocity_estimate + momentum_rate),
            started=1.0,
            position_last=u.position,
            velocity_last=y.velocity_estimate,
        )
