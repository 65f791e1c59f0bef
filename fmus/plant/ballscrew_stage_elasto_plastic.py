"""Rigid ballscrew stage with elasto-plastic friction."""

from __future__ import annotations

from cosim.model import minimum, parameter, where
from fmus.physics.ballscrew import BristleBallscrew
from fmus.physics.elasto_plastic import elastoplastic_rate


class BallscrewStageElastoPlastic(BristleBallscrew):
    """Stage on a rigid ballscrew as BallscrewStage, with elasto-plastic friction at the screw: it does not drift.

        der(angle)   = speed
        J*der(speed) = drive - friction_torque - load_torque                   J = J_rot + m*l_p^2
        der(bristle) = speed - alpha*sigma_0*abs(speed)*bristle/level
        friction_torque = sigma_0*bristle + S_1*der(bristle) + S_2*speed
        S_1 = sigma_1*exp(-(speed/v_d)^2)                                       sigma_1 where v_d = 0
        alpha = 0 where bristle and speed oppose each other or abs(bristle) <= z_ba
                (1 - cos(pi*w))/2 between,  w = (abs(bristle) - z_ba)/(level/sigma_0 - z_ba)
                1 where abs(bristle) >= level/sigma_0
        z_ba  = elastic_share*load*min(C, S)/sigma_0
        level = load*(C + (S - C)*exp(-(speed/v_s)^2))
        load  = friction_scale*(1 + drift_amplitude*sin(2*pi*drift_frequency*t))

    C, S, S_2, drive, play and rounding are those of BallscrewStage.

    Positive command, angle and position go together; friction and load torque are positive where they oppose
    positive motion. Valid for motion below the first axial resonance.

    Valid limits of elasto-plastic friction: no drift while the torque stays below elastic_share*min(F_C, F_S) = 4.37
    N.m, beyond it drifts as LuGre friction does, and minor loops do not close. Passive at all speeds if
    sigma_1*v_d < 9.32*min(F_C, F_S), as with the start values; with v_d = 0 up to 0.079 rad/s = 0.126 mm/s.

    Source: Dupont, Hayward, Armstrong, Altpeter, Single state elastoplastic friction models, IEEE Trans. Automatic
    Control 47(5), 2002; Olsson, Control systems with friction, thesis, Lund, 1996 (v_d); stage as in Shams & Safdari,
    Motion Control (IntechOpen), 2010, sec. 2 and 3.
    """

    v_d: float = parameter(
        1e-2, "rad/s", "Speed over which the damping of the bristles falls (0 = constant)", min=0.0, nominal=1e-2
    )
    elastic_share: float = parameter(
        0.7, "1", "Break-away deflection as a share of the smaller of F_C and F_S over sigma_0", min=0.0, max=0.99
    )

    def initial(self) -> BristleBallscrew.State:
        speed = self.velocity_start / self.l_p
        return self.State(
            angle=self.position_start / self.l_p,
            speed=speed,
            bristle=self.steady_bristle(speed),
            table=self.position_start,
        )

    def break_away(self, t: float, speed: float) -> float:
        """Deflection up to which the contact is elastic [rad]."""
        factor = where(
            speed < 0.0,
            minimum(self.F_C * self.F_C_negative, self.F_S * self.F_S_negative),
            minimum(self.F_C, self.F_S),
        )
        return self.elastic_share * self.normal_load(t) * factor / self.sigma_0

    def rate(self, t: float, x: BristleBallscrew.State) -> float:
        """Rate of the bristle [rad/s]."""
        level = self.level(t, x.speed)
        return elastoplastic_rate(x.bristle, x.speed, self.break_away(t, x.speed), level, self.sigma_0)

    def derivative(self, t: float, x: BristleBallscrew.State, u: BristleBallscrew.Input) -> BristleBallscrew.State:
        rate = self.rate(t, x)
        torque = self.torque(x, rate)
        return self.State(angle=x.speed, speed=self.acceleration(u, self.drive(u), torque), bristle=rate, table=0.0)

    def output(self, t: float, x: BristleBallscrew.State, u: BristleBallscrew.Input) -> BristleBallscrew.Output:
        return self.measured(x, self.torque(x, self.rate(t, x)))
