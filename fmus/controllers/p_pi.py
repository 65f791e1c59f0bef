"""Controller ``PPi``: P position and PI velocity control of a linear motor with feed-forward."""

from __future__ import annotations

from cosim.model import parameter, variable, where
from fmus.physics.linear_motor_control import LinearMotorController
from fmus.physics.sampling import measured_velocity, winds_up


class PPi(LinearMotorController):
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

    K_v: float = parameter(30.0, "1/s", "Position gain", min=0.0, nominal=10.0)
    K_p: float = parameter(50.0, "N.s/m", "Velocity gain", min=0.0, nominal=10.0)
    K_i: float = parameter(0.5, "1/s", "Integral gain of the velocity loop", min=0.0)

    class State(LinearMotorController.State):
        integral: float = variable(0.0, "N", "Integral part of the force", nominal=1e-3)

    class Output(LinearMotorController.Output):
        beta: float = variable(0.0, "m/s", "Velocity error with position loop", nominal=1e-6, display_unit="um/s")

    def output(self, t: float, x: State, u: LinearMotorController.Input) -> Output:
        velocity = measured_velocity(self, x, u)
        error = u.position_ref - u.position
        beta = self.K_v * error + u.velocity_ref - velocity
        feed_forward = self.m_hat * u.acceleration_ref + self.b_hat * velocity
        force = feed_forward + self.K_p * beta + x.integral - u.disturbance_estimate
        command = self.limited_command(force)
        return self.Output(
            command=command,
            force=self.k_t * self.K_a * command,
            error=error,
            beta=beta,
            velocity_estimate=velocity,
        )

    def update(self, t: float, x: State, u: LinearMotorController.Input, y: Output) -> State:
        increment = self.K_p * self.K_i * y.beta * self.T_s
        held = winds_up(y.command, self.command_max, y.beta)
        return self.State(
            integral=x.integral + where(held, 0.0, increment),
            started=1.0,
            position_last=u.position,
            velocity_last=y.velocity_estimate,
        )
