"""The parts that the three sliding-mode controllers of a ballscrew stage have in common."""

from __future__ import annotations

from typing import Any

from cosim.model import Choice, Controller, Note, Record, clip, parameter, sign, variable, where
from fmus.physics.lugre import bristle_damping, friction, friction_level, observer_step, rising_note
from fmus.physics.sampling import VelocitySource, measured_velocity, winds_up


class FrictionVelocity(Choice):
    """The velocity that drives the friction model inside a controller."""

    reference = 1, "Reference velocity"
    measured = 2, "Measured velocity"
    none = 3, "No friction model"


class SlidingController(Controller):
    """Base of the sliding-mode controllers: errors at the screw, friction model, integral; not used itself.

    Everything inside is in rad at the screw, position = l_p*angle. At sample k:

        e     = (position - position_ref)/l_p
        der_e = (measured velocity - velocity_ref)/l_p
        xi[k] = xi[k-1] + T_s*e[k],  xi[0] = 0; held while the command is at its limit and e drives it further out

    The friction model is LuGre with the hat parameters, driven by v, the chosen velocity at the screw, and solved by
    backward Euler; it starts at steady sliding:

        G            = F_C_hat + (F_S_hat - F_C_hat)*exp(-(v/v_s_hat)^2)
        z[k]         = (z[k-1] + T_s*v)/(1 + T_s*abs(v)*sigma_0_hat/G),  z[-1] = sign(v)*G/sigma_0_hat
        friction_hat = sigma_0_hat*z[k] + sigma_1_hat*exp(-(v/v_d_hat)^2)*(z[k] - z[k-1])/T_s + sigma_2_hat*v
        bound        = G + sigma_2_tilde*abs(v)

    Without friction model friction_hat is 0; the bound goes with the measured velocity.
    """

    l_p: float = parameter(1.5923e-3, "m/rad", "Lead of the screw for one radian", min=1e-9, nominal=1e-3)
    J_hat: float = parameter(3.70210163696e-4, "kg.m2", "Inertia at the screw", min=0.0, nominal=1e-4)
    lambda_: float = parameter(150.0, "1/s", "Slope of the sliding surface", min=0.0, nominal=100.0)
    sigma_0_hat: float = parameter(2e5, "N.m/rad", "Stiffness of the bristles", min=1e-9, nominal=1e5)
    sigma_1_hat: float = parameter(632.4555320336759, "N.m.s/rad", "Damping of the bristles", min=0.0, nominal=100.0)
    sigma_2_hat: float = parameter(1.2, "N.m.s/rad", "Viscous friction", min=0.0)
    F_C_hat: float = parameter(6.24, "N.m", "Coulomb friction", min=1e-12)
    F_S_hat: float = parameter(9.36, "N.m", "Static friction; below F_C_hat where it rises with speed", min=1e-12)
    v_s_hat: float = parameter(5e-3, "rad/s", "Stribeck speed", min=1e-12, nominal=1e-3)
    v_d_hat: float = parameter(
        0.0, "rad/s", "Speed over which the damping of the bristles falls (0 = constant)", min=0.0, nominal=1e-2
    )
    friction_velocity: FrictionVelocity = parameter(
        FrictionVelocity.reference, "1", "Velocity that drives the friction model"
    )
    velocity_source: VelocitySource = parameter(VelocitySource.input, "1", "Source of the measured velocity")
    velocity_filter_time: float = parameter(
        0.0, "s", "Time constant of the filter of a differenced position (0 = no filter)", min=0.0, display_unit="ms"
    )
    command_max: float = parameter(0.0, "N.m", "Largest command (0 = no limit)", min=0.0)

    class State(Record):
        started: float = variable(0.0, "1", "1 after the first sample")
        bristle: float = variable(0.0, "rad", "Deflection in the friction model", nominal=1e-5)
        integral: float = variable(0.0, "rad.s", "Integral of the position error at the screw", nominal=1e-3)
        position_last: float = variable(0.0, "m", "Position of the sample before", nominal=1e-3)
        velocity_last: float = variable(0.0, "m/s", "Measured velocity of the sample before", nominal=1e-3)

    class Input(Record):
        position_ref: float = variable(0.0, "m", "Reference position", nominal=1e-3, display_unit="mm")
        velocity_ref: float = variable(0.0, "m/s", "Reference velocity", nominal=1e-3, display_unit="mm/s")
        acceleration_ref: float = variable(0.0, "m/s2", "Reference acceleration", nominal=1e-3, display_unit="mm/s2")
        position: float = variable(0.0, "m", "Measured position", nominal=1e-3, display_unit="mm")
        velocity: float = variable(0.0, "m/s", "Measured velocity", nominal=1e-3, display_unit="mm/s")

    def notes(self, x: State) -> tuple[Note, ...]:
        return (rising_note(self.F_C_hat, self.F_S_hat, "N.m", "F_C_hat", "F_S_hat"),)

    def measured_velocity(self, x: State, u: Input) -> float:
        """Velocity of the table [m/s]."""
        return measured_velocity(self, x, u)

    def errors(self, x: State, u: Input) -> tuple[float, float, float]:
        """Position error e [rad], its rate [rad/s] and its integral xi [rad.s]."""
        e = (u.position - u.position_ref) / self.l_p
        rate = (self.measured_velocity(x, u) - u.velocity_ref) / self.l_p
        return e, rate, x.integral + where(x.started > 0.5, self.T_s * e, 0.0)

    def friction_speed(self, x: State, u: Input) -> float:
        """Speed used by the friction model and its bound [rad/s]."""
        if self.friction_velocity is FrictionVelocity.reference:
            return u.velocity_ref / self.l_p
        return self.measured_velocity(x, u) / self.l_p

    def bristles(self, x: State, u: Input) -> tuple[float, float]:
        """Deflection in the friction model at the previous sample and at this sample [rad]."""
        if self.friction_velocity is FrictionVelocity.none:
            return 0.0, 0.0
        v = self.friction_speed(x, u)
        level = friction_level(v, self.F_C_hat, self.F_S_hat, self.v_s_hat)
        last = where(x.started > 0.5, x.bristle, sign(v) * level / self.sigma_0_hat)
        return last, observer_step(last, v, level, self.sigma_0_hat, self.T_s)

    def friction_hat(self, x: State, u: Input) -> float:
        """Torque of the friction model [N.m]."""
        if self.friction_velocity is FrictionVelocity.none:
            return 0.0
        last, z = self.bristles(x, u)
        v = self.friction_speed(x, u)
        return friction(
            z,
            (z - last) / self.T_s,
            v,
            sigma_0=self.sigma_0_hat,
            sigma_1=bristle_damping(v, self.sigma_1_hat, self.v_d_hat),
            sigma_2=self.sigma_2_hat,
        )

    def bound(self, x: State, u: Input, sigma_2_tilde: float) -> float:
        """Bound of the uncertainty of the friction model [N.m]."""
        v = self.friction_speed(x, u)
        return friction_level(v, self.F_C_hat, self.F_S_hat, self.v_s_hat) + sigma_2_tilde * abs(v)

    def equivalent_acceleration(self, u: Input, e: float, rate: float, xi: float) -> float:
        """Acceleration [rad/s2] that keeps s of the surface with integral constant, plus -lambda*s; eq. (10)."""
        return u.acceleration_ref / self.l_p - self.lambda_ * (
            3.0 * rate + self.lambda_ * (3.0 * e + self.lambda_ * xi)
        )

    def update(self, t: float, x: State, u: Input, y: Any) -> State:
        e, _, xi = self.errors(x, u)
        _, z = self.bristles(x, u)
        held = winds_up(y.command, self.command_max, -e)
        return self.State(
            started=1.0,
            bristle=z,
            integral=where(held, x.integral, xi),
            position_last=u.position,
            velocity_last=self.measured_velocity(x, u),
        )


def saturation(x: float) -> float:
    """``x`` limited to -1 ... 1."""
    return clip(x, -1.0, 1.0)
