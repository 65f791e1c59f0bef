"""Fuzzy sliding-mode controller."""

from __future__ import annotations

from typing import ClassVar

from cosim.model import Experiment, Record, parameter, variable
from fmus.physics.fuzzy import nine_rules
from fmus.physics.sampling import saturate
from fmus.physics.sliding import SlidingController


class FuzzySlidingMode(SlidingController):
    """Fuzzy sliding-mode controller of a ballscrew stage with friction model.

        s   = der_e + 2*lambda_*e + lambda_^2*xi
        s_c = der_e - lambda_^2*xi
        command = friction_hat + J_hat*(r'' - 3*lambda_*der_e - 3*lambda_^2*e - lambda_^3*xi)
                  + G_u*fz(G_s*s, G_c*s_c)

    fz, odd and at most 5/6 in magnitude, is the exact centroid of the paper's nine rules
    (``fmus.physics.fuzzy.nine_rules``). Near the surfaces it goes with -(G_s*s - G_c*s_c): with G_c = G_s/2 with
    -(der_e/2 + 2*lambda_*e + 1.5*lambda_^2*xi), with G_c = G_s it does not damp. The error e, its integral xi and
    friction_hat, all at the screw, are those of the base (``fmus.physics.sliding``); r'' is acceleration_ref/l_p. The
    command is limited to -command_max ... command_max; meanwhile xi is held if it drives further out.

    Sign: a positive command drives to positive position; s is positive ahead of the reference, while the output
    ``error`` is reference minus measured.

    Valid while 0.75*G_u*(G_s - G_c)*T_s/J_hat stays below about 1: beyond, the sampled loop chatters. 5/6*G_u must
    exceed the error of the friction model.

    Source: Shams & Safdari, Fuzzy sliding mode control of a ball screw driven stage, Motion Control (IntechOpen),
    2010, sec. 4.4 and 6, eq. (17), rules 1-9; the scaling factors (its fig. 10) are chosen for 10 kHz.
    """

    experiment: ClassVar[Experiment] = Experiment(stop_time=10.0, step_size=1e-4)

    G_s: float = parameter(0.09, "s/rad", "Scaling of the sliding surface s", min=0.0, nominal=0.1)
    G_c: float = parameter(0.045, "s/rad", "Scaling of the complementary surface s_c", min=0.0, nominal=0.1)
    G_u: float = parameter(100.0, "N.m", "Scaling of the fuzzy output", min=0.0, nominal=100.0)

    class Output(Record):
        command: float = variable(0.0, "N.m", "Command to the drive")
        error: float = variable(0.0, "m", "Position error, reference minus measured", nominal=1e-6, display_unit="um")
        sliding_surface: float = variable(0.0, "rad/s", "Sliding surface s")
        complementary_surface: float = variable(0.0, "rad/s", "Complementary surface s_c")
        fuzzy_command: float = variable(0.0, "N.m", "Fuzzy part of the command")
        friction_hat: float = variable(0.0, "N.m", "Torque of the friction model")

    def output(self, t: float, x: SlidingController.State, u: SlidingController.Input) -> Output:
        e, rate, xi = self.errors(x, u)
        friction_hat = self.friction_hat(x, u)
        surface = rate + self.lambda_ * (2.0 * e + self.lambda_ * xi)
        complementary = rate - self.lambda_**2 * xi
        fuzzy_command = self.G_u * nine_rules(self.G_s * surface, self.G_c * complementary)
        equivalent = friction_hat + self.J_hat * self.equivalent_acceleration(u, e, rate, xi)
        return self.Output(
            command=saturate(equivalent + fuzzy_command, self.command_max),
            error=u.position_ref - u.position,
            sliding_surface=surface,
            complementary_surface=complementary,
            fuzzy_command=fuzzy_command,
            friction_hat=friction_hat,
        )
