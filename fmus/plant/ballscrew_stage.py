"""Rigid ballscrew stage."""

from __future__ import annotations

from typing import ClassVar

from cosim.model import Experiment, Plant, Record, Rule, both, clip, either, parameter, round_to, sin, variable, where
from fmus.physics.lugre import (
    BRISTLE_NOMINAL,
    bristle_rate,
    friction,
    friction_level,
    steady_bristle,
)
from fmus.physics.sampling import saturate

TWO_PI = 6.283185307179586
FLANK = 1e-9
"""A table this part of the whole play away from a flank counts as resting on it."""


class BallscrewStage(Plant):
    """Stage on a rigid ballscrew driven by a motor torque, with LuGre friction at the screw.

        der(angle)   = speed
        J*der(speed) = drive - friction_torque - load_torque                   J = J_rot + m*l_p^2
        der(bristle) = speed - sigma_0*abs(speed)*bristle/level
        friction_torque = sigma_0*bristle + sigma_1*der(bristle) + S_2*speed
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
    positive motion. Valid for motion below the first axial resonance; with constant sigma_1 friction may exceed F_S
    for a moment at a fast break-away.

    Source: Shams & Safdari, Fuzzy sliding mode control of a ball screw driven stage, Motion Control (IntechOpen),
    2010, sec. 2 and 3, eqs. (1)-(5), tables 1 and 2; Canudas de Wit et al., IEEE Trans. Automatic Control 40(3), 1995.
    """

    experiment: ClassVar[Experiment] = Experiment(stop_time=10.0, step_size=1e-4)

    m: float = parameter(62.4, "kg", "Moving mass of table and work", min=0.0, nominal=10.0)
    J_rot: float = parameter(2.12e-4, "kg.m2", "Inertia of motor, coupling and screw", min=1e-9, nominal=1e-4)
    l_p: float = parameter(1.5923e-3, "m/rad", "Lead of the screw for one radian", min=1e-9, nominal=1e-3)
    sigma_0: float = parameter(1e5, "N.m/rad", "Stiffness of the bristles", min=1e-9, nominal=1e5)
    sigma_1: float = parameter(316.22776601683796, "N.m.s/rad", "Damping of the bristles", min=0.0, nominal=100.0)
    sigma_2: float = parameter(0.4, "N.m.s/rad", "Viscous friction", min=0.0)
    F_C: float = parameter(6.24, "N.m", "Coulomb friction", min=0.0)
    F_S: float = parameter(9.36, "N.m", "Static friction", min=0.0)
    v_s: float = parameter(1e-3, "rad/s", "Stribeck speed", min=1e-12, nominal=1e-3)
    F_C_negative: float = parameter(1.0, "1", "Factor of F_C for negative speed", min=0.0)
    F_S_negative: float = parameter(1.0, "1", "Factor of F_S for negative speed", min=0.0)
    sigma_2_negative: float = parameter(1.0, "1", "Factor of sigma_2 for negative speed", min=0.0)
    friction_scale: float = parameter(1.0, "1", "Factor of F_C and F_S", min=0.0, variability="tunable")
    drift_amplitude: float = parameter(0.0, "1", "Amplitude of the drift of F_C and F_S (0 = off)", min=0.0, max=0.99)
    drift_frequency: float = parameter(0.0, "Hz", "Frequency of the drift of F_C and F_S", min=0.0)
    command_max: float = parameter(0.0, "N.m", "Largest torque of the drive (0 = no limit)", min=0.0)
    resolution: float = parameter(
        0.0, "m", "Resolution of the position measured (0 = off)", min=0.0, nominal=1e-7, display_unit="um"
    )
    play_positive: float = parameter(
        0.0,
        "m",
        "Play of the table behind a screw moving in positive direction",
        min=0.0,
        nominal=1e-5,
        display_unit="um",
    )
    play_negative: float = parameter(
        0.0,
        "m",
        "Play of the table behind a screw moving in negative direction",
        min=0.0,
        nominal=1e-5,
        display_unit="um",
    )
    position_start: float = parameter(0.0, "m", "Position at the start", nominal=1e-3, display_unit="mm")
    velocity_start: float = parameter(0.0, "m/s", "Velocity at the start", nominal=1e-3, display_unit="mm/s")
    bristle_start: float = parameter(
        1.0, "1", "Bristle at the start: 0 undeflected, 1 as in steady sliding at velocity_start", min=0.0, max=1.0
    )

    class State(Record):
        angle: float = variable(0.0, "rad", "Angle of the screw", nominal=1e-2)
        speed: float = variable(0.0, "rad/s", "Speed of the screw", nominal=1e-2)
        bristle: float = variable(0.0, "rad", "Deflection of the bristles", nominal=BRISTLE_NOMINAL)
        table: float = variable(0.0, "m", "Position of the table, with play", nominal=1e-3, discrete=True)

    class Input(Record):
        command: float = variable(0.0, "N.m", "Torque of the motor")
        load_torque: float = variable(0.0, "N.m", "Load torque at the screw, opposing positive motion")

    class Output(Record):
        position: float = variable(0.0, "m", "Position of the table", nominal=1e-3, display_unit="mm")
        velocity: float = variable(0.0, "m/s", "Velocity of the table", nominal=1e-3, display_unit="mm/s")
        angle: float = variable(0.0, "rad", "Angle of the screw")
        speed: float = variable(0.0, "rad/s", "Speed of the screw")
        friction_torque: float = variable(0.0, "N.m", "Friction torque at the screw, opposing positive motion")

    def rules(self) -> tuple[Rule, ...]:
        return (
            Rule(self.F_S >= self.F_C, "F_S is below F_C. Static friction is at least Coulomb friction."),
            Rule(
                self.F_S * self.F_S_negative >= self.F_C * self.F_C_negative,
                "F_S*F_S_negative is below F_C*F_C_negative. Static friction is at least Coulomb friction.",
            ),
            Rule(
                either(self.drift_amplitude <= 0.0, self.drift_frequency > 0.0),
                "drift_amplitude needs a drift_frequency. Set it above 0.",
            ),
        )

    def initial(self) -> State:
        speed = self.velocity_start / self.l_p
        bristle = self.bristle_start * steady_bristle(speed, self.level(0.0, speed), self.sigma_0)
        return self.State(angle=self.position_start / self.l_p, speed=speed, bristle=bristle, table=self.position_start)

    def level(self, t: float, speed: float) -> float:
        """Magnitude of the friction torque without its viscous part, in steady sliding at ``speed``."""
        F_C = self.F_C * where(speed < 0.0, self.F_C_negative, 1.0)
        F_S = self.F_S * where(speed < 0.0, self.F_S_negative, 1.0)
        drift = 1.0 + self.drift_amplitude * sin(TWO_PI * self.drift_frequency * t)
        return self.friction_scale * drift * friction_level(speed, F_C, F_S, self.v_s)

    def friction(self, t: float, x: State) -> tuple[float, float]:
        """Rate of the bristle and friction torque."""
        rate = bristle_rate(x.bristle, x.speed, self.level(t, x.speed), self.sigma_0)
        sigma_2 = self.sigma_2 * where(x.speed < 0.0, self.sigma_2_negative, 1.0)
        torque = friction(x.bristle, rate, x.speed, sigma_0=self.sigma_0, sigma_1=self.sigma_1, sigma_2=sigma_2)
        return rate, torque

    def derivative(self, t: float, x: State, u: Input) -> State:
        rate, torque = self.friction(t, x)
        drive = saturate(u.command, self.command_max)
        J = self.J_rot + self.m * self.l_p**2
        return self.State(angle=x.speed, speed=(drive - torque - u.load_torque) / J, bristle=rate, table=0.0)

    def pushed(self, x: State) -> float:
        """Position of the table: where it was, unless a flank of the play pushes it."""
        nut = self.l_p * x.angle
        return clip(x.table, nut - self.play_positive, nut + self.play_negative)

    def update(self, t: float, x: State, u: Input) -> State:
        return self.State(angle=x.angle, speed=x.speed, bristle=x.bristle, table=self.pushed(x))

    def output(self, t: float, x: State, u: Input) -> Output:
        _, torque = self.friction(t, x)
        nut = self.l_p * x.angle
        position = self.pushed(x)
        near = FLANK * (self.play_positive + self.play_negative)
        moves = either(
            both(x.speed >= 0.0, position <= nut - self.play_positive + near),
            both(x.speed <= 0.0, position >= nut + self.play_negative - near),
        )
        return self.Output(
            position=round_to(position, self.resolution),
            velocity=where(moves, self.l_p * x.speed, 0.0),
            angle=x.angle,
            speed=x.speed,
            friction_torque=torque,
        )
