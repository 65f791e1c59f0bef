"""Rigid ballscrew stage."""

from __future__ import annotations

from fmus.physics.ballscrew import BristleBallscrew


class BallscrewStage(BristleBallscrew):
    """Stage on a rigid ballscrew driven by a motor torque, with LuGre friction at the screw.

        der(angle)   = speed
        J*der(speed) = drive - friction_torque - load_torque                   J = J_rot + m*l_p^2
        der(bristle) = speed - sigma_0*abs(speed)*bristle/level
        friction_torque = sigma_0*bristle + S_1*der(bristle) + S_2*speed
        S_1 = sigma_1*exp(-(speed/v_d)^2)                                       sigma_1 where v_d = 0
        level = friction_scale*(1 + drift_amplitude*sin(2*pi*drift_frequency*t))
                *(C + (S - C)*exp(-(speed/v_s)^2))
        drive = command limited to -command_max ... command_max

    C, S, S_2 are F_C, F_S, sigma_2 at speed >= 0 and these times their factors for negative speed below. Without play
    the table follows the screw, position = l_p*angle rounded to a multiple of resolution. With play the table rests
    until the nut pushes it:

        table[i+1] = clip(table[i], l_p*angle - play_positive, l_p*angle + play_negative)

    after each integration step i, so that a reversal and its return within one step go unseen; the table's inertia
    stays with the screw. The velocity is that of the table, not rounded.

    Positive command, angle and position go together; friction and load torque are positive where they oppose
    positive motion. Valid for motion below the first axial resonance.

    Valid limits of LuGre friction: passive for sure only where S_1*abs(speed) < 4*level, which with constant sigma_1
    and the start values ends at 0.079 rad/s = 0.126 mm/s: a slow break-away then lets friction drive the screw for
    some microseconds (-957 N.m under 0.1 N.m/s); v_d = 0.01 rad/s cures it. Under a load that oscillates below
    break-away the stage drifts (28 nm a cycle under 3 +- 1 N.m at 10 Hz), and minor loops do not close: take
    BallscrewStageElastoPlastic or BallscrewStageMaxwellSlip where that matters.

    Source: Shams & Safdari, Fuzzy sliding mode control of a ball screw driven stage, Motion Control (IntechOpen),
    2010, sec. 2 and 3, eqs. (1)-(5), tables 1 and 2; Canudas de Wit et al., IEEE Trans. Automatic Control 40(3),
    1995; Olsson, Control systems with friction, thesis, Lund, 1996 (v_d).
    """

    def initial(self) -> BristleBallscrew.State:
        speed = self.velocity_start / self.l_p
        return self.State(
            angle=self.position_start / self.l_p,
            speed=speed,
            bristle=self.steady_bristle(speed),
            table=self.position_start,
        )

    def derivative(self, t: float, x: BristleBallscrew.State, u: BristleBallscrew.Input) -> BristleBallscrew.State:
        rate, torque = self.lugre(x, self.level(t, x.speed))
        return self.State(angle=x.speed, speed=self.acceleration(u, self.drive(u), torque), bristle=rate, table=0.0)

    def output(self, t: float, x: BristleBallscrew.State, u: BristleBallscrew.Input) -> BristleBallscrew.Output:
        _, torque = self.lugre(x, self.level(t, x.speed))
        return self.measured(x, torque)
