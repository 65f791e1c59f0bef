"""Rigid ballscrew stage with generalised Maxwell slip friction."""

from __future__ import annotations

from dataclasses import replace

from cosim.model import Note, Rule, both, minimum, parameter, sign, variable, where
from fmus.physics.ballscrew import RigidBallscrew
from fmus.physics.lugre import ALWAYS, bristle_damping, counted, damping_rule, passive_speed, passivity_note
from fmus.physics.maxwell_slip import element_rate, slips_now


class BallscrewStageMaxwellSlip(RigidBallscrew):
    """Stage on a rigid ballscrew as BallscrewStage, with generalised Maxwell slip friction: its minor loops close.

        der(angle)   = speed
        J*der(speed) = drive - friction_torque - load_torque                   J = J_rot + m*l_p^2
        friction_torque = sum of element[i] + S_1*(sum of der(element[i]))/(sum of k[i]) + S_2*speed,   i = 1 ... 4
        S_1 = sigma_1*exp(-(speed/v_d)^2)                                       sigma_1 where v_d = 0
        element i sticks, until it holds alpha[i]*level along the motion
            der(element[i]) = k[i]*speed
        then it slips, until the motion reverses
            der(element[i]) = sign(speed)*min(k[i]*abs(speed), C*(alpha[i] - abs(element[i])/level))
        level = friction_scale*(1 + drift_amplitude*sin(2*pi*drift_frequency*t))
                *(F_C + (F_S - F_C)*exp(-(speed/v_s)^2))

    F_C, F_S and sigma_2 count times their factors at negative speed; S_2 is sigma_2 then. Drive, play and rounding are
    those of BallscrewStage. slips[i] is set after each integration step; an element that passes its part slips at
    once, and the integrator takes some ten small steps there.

    Positive command, angle and position go together; friction and load torque are positive where they oppose
    positive motion. Valid for motion below the first axial resonance.

    Valid limits of generalised Maxwell slip: where the level is constant it neither drifts nor forgets, but a
    speed that reaches v_s within presliding lowers the level and lets elements slip. Passive at all speeds if
    0.43*sigma_1*v_d is at most min(F_C, F_S)*alpha[i]*(sum of k)/k[i] for each element, as with the start values.

    Source: Al-Bender, Lampaert, Swevers, The generalized Maxwell-slip model: a novel model for friction simulation and
    compensation, IEEE Trans. Automatic Control 50(11), 2005; stage as in Shams & Safdari, Motion Control
    (IntechOpen), 2010, sec. 2 and 3.
    """

    k: tuple[float, float, float, float] = parameter(
        (3.2e4, 3.0e4, 2.3e4, 1.5e4), "N.m/rad", "Stiffness of each element", min=0.0, nominal=1e4
    )
    alpha: tuple[float, float, float, float] = parameter(
        (0.1, 0.2, 0.3, 0.4), "1", "Part of the friction level that each element holds", min=1e-6, max=1.0
    )
    C: float = parameter(1e3, "N.m/s", "Rate at which an element that holds too much gives way", min=0.0, nominal=1e3)
    sigma_1: float = parameter(316.22776601683796, "N.m.s/rad", "Damping of presliding", min=0.0, nominal=100.0)
    v_d: float = parameter(
        1e-2, "rad/s", "Speed over which the damping of presliding falls (0 = constant)", min=0.0, nominal=1e-2
    )

    class State(RigidBallscrew.State):
        element: tuple[float, float, float, float] = variable(
            (0.0, 0.0, 0.0, 0.0), "N.m", "Torque of each element", nominal=1.0
        )
        slips: tuple[float, float, float, float] = variable(
            (0.0, 0.0, 0.0, 0.0), "1", "1 for an element that slips, 0 for one that sticks", discrete=True
        )

    def rules(self) -> tuple[Rule, ...]:
        return (
            *self.contact_rules(self.share()),
            damping_rule(self.v_d),
            Rule(
                abs(sum(self.alpha) - 1.0) <= 1e-6,
                "alpha[1] + ... + alpha[4] is not 1: steady friction would not be the level. Change them.",
            ),
            Rule(sum(self.k) > 0.0, "k[1] ... k[4] are all 0. Give at least one element a stiffness."),
        )

    def initial(self) -> State:
        speed = self.velocity_start / self.l_p
        torque = self.bristle_start * sign(speed) * self.level(0.0, speed)
        a, b, c, d = (part * torque for part in self.alpha)
        # Elements that start at their full part slip; rounding must not decide this.
        slips = where(self.bristle_start >= 1.0, abs(sign(speed)), 0.0)
        return self.State(
            angle=self.position_start / self.l_p,
            speed=speed,
            element=(a, b, c, d),
            slips=(slips, slips, slips, slips),
            table=self.position_start,
        )

    def friction(self, t: float, x: State) -> tuple[tuple[float, float, float, float], float]:
        """Rates of the elements [N.m/s] and friction torque [N.m]."""
        level = self.level(t, x.speed)
        a, b, c, d = (
            element_rate(F, slips, x.speed, level, k=k, alpha=alpha, C=self.C)
            for F, slips, k, alpha in zip(x.element, x.slips, self.k, self.alpha, strict=True)
        )
        mean = (a + b + c + d) / sum(self.k)
        damping = bristle_damping(x.speed, self.sigma_1, self.v_d)
        return (a, b, c, d), counted(sum(x.element), self.friction_scale) + damping * mean + self.viscous(
            x.speed
        ) * x.speed

    def derivative(self, t: float, x: State, u: RigidBallscrew.Input) -> State:
        rates, torque = self.friction(t, x)
        return self.State(
            angle=x.speed, speed=self.acceleration(u, self.drive(u), torque), element=rates, slips=x.slips, table=0.0
        )

    def update(self, t: float, x: State, u: RigidBallscrew.Input) -> State:
        level = self.level(t, x.speed)
        a, b, c, d = (
            slips_now(F, slips, x.speed, level, alpha)
            for F, slips, alpha in zip(x.element, x.slips, self.alpha, strict=True)
        )
        return replace(RigidBallscrew.update(self, t, x, u), slips=(a, b, c, d))

    def share(self) -> float:
        """The smallest deflection at which an element slips, for each torque of the level [rad/N.m]."""
        share = ALWAYS
        for k, alpha in zip(self.k, self.alpha, strict=True):
            share = where(both(k > 0.0, alpha > 0.0), minimum(share, alpha / where(k > 0.0, k, 1.0)), share)
        return share

    def notes(self, x: State) -> tuple[Note, ...]:
        limit = passive_speed(self.least_level() * self.share() * sum(self.k), self.sigma_1, self.v_d)
        bound = "min(F_C, F_S)*min(alpha[i]/k[i])*(sum of k)/sigma_1"
        return (*RigidBallscrew.notes(self, x), passivity_note(x.largest_speed, limit, "rad/s", bound=bound))

    def output(self, t: float, x: State, u: RigidBallscrew.Input) -> RigidBallscrew.Output:
        _, torque = self.friction(t, x)
        return self.measured(x, torque)
