"""Controller ``SuperTwisting``: second-order sliding mode on a PID surface for a linear motor."""

from __future__ import annotations

from cosim.model import Choice, parameter, sign, sqrt, variable, where
from fmus.physics.linear_motor_control import LinearMotorController
from fmus.physics.sampling import measured_velocity, winds_up


class Switching(Choice):
    """How the second term of the switching law acts."""

    integral = 1, "Integral of W*sign(S): super-twisting"
    relay = 2, "W_relay*sign(S): the printed formula, chatters"


class SuperTwisting(LinearMotorController):
    """Super-twisting sliding mode control on a PID surface, with equivalent control from estimated mass and damping.

        error = position_ref - position
        S = velocity_ref - velocity + mu*error + lambda_*integral_error
        equivalent = m_hat*(acceleration_ref + lambda_*error) + b_hat*velocity_ref
        force = equivalent + Lambda*sqrt(abs(S))*sign(S) + v - disturbance_estimate
        command = force/(k_t*K_a), limited to command_max
        v[k+1] = v + W*sign(S)*T_s                       (switching integral)
        v      = W_relay*sign(S)                         (switching relay)
        integral_error[k+1] = integral_error + error*T_s

    sign(0) = 0. The integrals are held while the command is at its limit and they would drive it on. A positive
    command drives towards positive position; a positive disturbance estimate is a force that pushes there.

    The gains carry units with roots: 180 and 3400 in uN and um are 0.18 N/(m/s)0.5 and 0.0034 N/s. The equivalent
    control makes der(S) = 0 where mu = b/m; with another mu the loop is der2(e) + (b/m)*der(e) + lambda_*e plus
    the switching terms. Start values are a design with mu = b/m and lambda_ = mu**2/4.

    Source: Rubio, Ibeas & Luo, P-PI and super twisting sliding mode control schemes comparison for high-precision CNC
    machining, 2015, eqs. (6)-(12); the printed v = sign(S) is read as the derivative of v, as its eq. (12) and Levant,
    Int. J. Control 58 (1993) 1247-1263, have it.
    """

    mu: float = parameter(25.0, "1/s", "Weight of the error in the surface", min=0.0, nominal=10.0)
    lambda_: float = parameter(156.25, "1/s2", "Weight of the error integral in the surface", min=0.0, nominal=100.0)
    Lambda: float = parameter(0.18, "N.s0.5/m0.5", "Gain of the root of the surface", min=0.0)
    W: float = parameter(3.4e-3, "N/s", "Gain of the integral of sign(S)", min=0.0, nominal=1e-3)
    switching: Switching = parameter(Switching.integral, "1", "How the second switching term acts")
    W_relay: float = parameter(3.4e-3, "N", "Amplitude of the relay", min=0.0, nominal=1e-3)

    class State(LinearMotorController.State):
        v: float = variable(0.0, "N", "Integral of the switching law", nominal=1e-3)
        integral_error: float = variable(0.0, "m.s", "Integral of the position error", nominal=1e-6)

    class Output(LinearMotorController.Output):
        sliding_surface: float = variable(0.0, "m/s", "Sliding surface S", nominal=1e-6, display_unit="um/s")

    def output(self, t: float, x: State, u: LinearMotorController.Input) -> Output:
        velocity = measured_velocity(self, x, u)
        error = u.position_ref - u.position
        S = u.velocity_ref - velocity + self.mu * error + self.lambda_ * x.integral_error
        off_surface = abs(S) > 0.0
        root = where(off_surface, sqrt(where(off_surface, abs(S), 1.0)), 0.0)
        second = x.v if self.switching is Switching.integral else self.W_relay * sign(S)
        equivalent = self.m_hat * (u.acceleration_ref + self.lambda_ * error) + self.b_hat * u.velocity_ref
        force = equivalent + self.Lambda * root * sign(S) + second - u.disturbance_estimate
        command = self.limited_command(force)
        return self.Output(
            command=command,
            force=self.k_t * self.K_a * command,
            error=error,
            sliding_surface=S,
            velocity_estimate=velocity,
        )

    def update(self, t: float, x: State, u: LinearMotorController.Input, y: Output) -> State:
        toward = sign(y.sliding_surface)
        v_held = winds_up(y.command, self.command_max, toward)
        error_held = winds_up(y.command, self.command_max, y.error)
        v_increment = self.W * toward * self.T_s if self.switching is Switching.integral else 0.0
        return self.State(
            v=x.v + where(v_held, 0.0, v_increment),
            integral_error=x.integral_error + where(error_held, 0.0, y.error * self.T_s),
            started=1.0,
            position_last=u.position,
            velocity_last=y.velocity_estimate,
        )
