"""Controller ``PPi``: P position and PI velocity control of a linear motor with feed-forward."""

from __future__ import annotations

from typing import ClassVar

from cosim.model import Controller, Experiment, Record, parameter, variable, where
from fmus.physics.sampling import VelocitySource, measured_velocity, saturate, winds_up


class PPi(Controller):
    """P-PI position and velocity control with mass feed-forward and compensation of the measured damping.

        error = position_ref - position
        beta  = K_v*error + velocity_ref - velocity
        force = m_hat*acceleration_ref + K_p*beta + integral + b_hat*velocity - disturbance_estimate
        command = force/(k_t*K_a), limited to command_max
        integral[k+1] = integral + K_p*K_i*beta*T_s, held while the command is at its limit and beta drives it on

    A positive command drives towards positive position; a positive disturbance estimate is a force that pushes
    there. b_hat*velocity feeds the velocity back positively: with exact velocity the loop is stable if and only if
    K_p > b_hat - b and (K_p + b - b_hat)*(K_v + K_i) > m*K_i*K_v.

    Source: Rubio, Ibeas & Luo, P-PI and super twisting sliding mode control schemes comparison for high-precision CNC
    machining, 2015, eqs. (5)-(8); velocity by backward difference and first-order filter, its time constant chosen.
    """

    T_s: float = parameter(1e-4, "s", "Sampling time", min=1e-9, nominal=1e-4, display_unit="ms")
    K_v: float = parameter(30.0, "1/s", "Position gain", min=0.0, nominal=10.0)
    K_p: float = parameter(50.0, "N.s/m", "Velocity gain", min=0.0, nominal=10.0)
    K_i: float = parameter(0.5, "1/s", "Integral gain of the velocity loop", min=0.0)
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
        integral: float = variable(0.0, "N", "Integral part of the force", nominal=1e-3)
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
        beta: float = variable(0.0, "m/s", "Velocity error with position loop", nominal=1e-6, display_unit="um/s")
        velocity_estimate: float = variable(0.0, "m/s", "Measured velocity used", nominal=1e-6, display_unit="um/s")

    def output(self, t: float, x: State, u: Input) -> Output:
        velocity = measured_velocity(self, x, u)
        error = u.position_ref - u.position
        beta = self.K_v * error + u.velocity_ref - velocity
        feed_forward = self.m_hat * u.acceleration_ref + self.b_hat * velocity
        force = feed_forward + self.K_p * beta + x.integral - u.disturbance_estimate
        command = saturate(force / (self.k_t * self.K_a), self.command_max)
        return self.Output(
            command=command,
            force=self.k_t * self.K_a * command,
            error=error,
            beta=beta,
            velocity_estimate=velocity,
        )

    def update(self, t: float, x: State, u: Input, y: Output) -> State:
        increment = self.K_p * self.K_i * y.beta * self.T_s
        held = winds_up(y.command, self.command_max, y.beta)
        return self.State(
            integral=x.integral + where(held, 0.0, increment),
            started=1.0,
            position_last=u.position,
            velocity_last=y.velocity_estimate,
        )
