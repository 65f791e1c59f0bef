"""Complementary sliding-mode controller."""

from __future__ import annotations

from typing import ClassVar

from cosim.model import Experiment, Record, parameter, variable
from fmus.physics.sampling import saturate
from fmus.physics.sliding import SlidingController, saturation


class ComplementarySlidingMode(SlidingController):
    """Complementary sliding-mode controller of a ballscrew stage with boundary layer and friction model.

        s   = der_e + 2*lambda_*e + lambda_^2*xi
        s_c = der_e - lambda_^2*xi
        command = friction_hat + J_hat*(r'' - 3*lambda_*der_e - 3*lambda_^2*e - lambda_^3*xi) - K*sat((s + s_c)/phi)
        K = bound + J_hat*eta

    The error e, its integral xi, friction_hat and bound, all at the screw, are those of the base
    (``fmus.physics.sliding``); sat limits to -1 ... 1, r'' is acceleration_ref/l_p. The command is limited to
    -command_max ... command_max; meanwhile xi is held if it drives further out.

    Sign: a positive command drives to positive position; s is positive ahead of the reference, while the output
    ``error`` is reference minus measured.

    Valid while 2*K*T_s/(phi*J_hat) stays below about 1: beyond, the sampled loop chatters (10 kHz: phi = 4 rad/s up to
    some 20 rad/s at the screw; the paper's 0.1 rad/s needs 2 us).

    Source: Shams & Safdari, Fuzzy sliding mode control of a ball screw driven stage, Motion Control (IntechOpen),
    2010, sec. 4.3, eqs. (14)-(16), (10) multiplied by the inertia, which eq. (6) leaves out.
    """

    experiment: ClassVar[Experiment] = Experiment(stop_time=10.0, step_size=1e-4)

    phi: float = parameter(4.0, "rad/s", "Thickness of the boundary layer", min=1e-12)
    eta: float = parameter(20.0, "rad/s2", "Margin of the switching gain", min=0.0, nominal=100.0)
    sigma_2_tilde: float = parameter(1.0, "N.m.s/rad", "Bound of the error of viscous friction", min=0.0)

    class Output(Record):
        command: float = variable(0.0, "N.m", "Command to the drive")
        error: float = variable(0.0, "m", "Position error, reference minus measured", nominal=1e-6, display_unit="um")
        sliding_surface: float = variable(0.0, "rad/s", "Sliding surface s")
        complementary_surface: float = variable(0.0, "rad/s", "Complementary surface s_c")
        friction_hat: float = variable(0.0, "N.m", "Torque of the friction model")

    def output(self, t: float, x: SlidingController.State, u: SlidingController.Input) -> Output:
        e, rate, xi = self.errors(x, u)
        friction_hat = self.friction_hat(x, u)
        surface = rate + self.lambda_ * (2.0 * e + self.lambda_ * xi)
        complementary = rate - self.lambda_**2 * xi
        gain = self.bound(x, u, self.sigma_2_tilde) + self.J_hat * self.eta
        switching = gain * saturation((surface + complementary) / self.phi)
        equivalent = friction_hat + self.J_hat * self.equivalent_acceleration(u, e, rate, xi)
        return self.Output(
            command=saturate(equivalent - switching, self.command_max),
            error=u.position_ref - u.position,
            sliding_surface=surface,
            complementary_surface=complementary,
            friction_hat=friction_hat,
        )
