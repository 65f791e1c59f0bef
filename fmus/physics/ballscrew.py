"""The parts that the rigid ballscrew plants have in common: everything except the law of friction."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, ClassVar

from cosim.model import (
    Experiment,
    Note,
    Plant,
    Record,
    Rule,
    both,
    clip,
    either,
    maximum,
    minimum,
    parameter,
    round_to,
    sin,
    variable,
    where,
)
from fmus.physics.lugre import (
    BRISTLE_NOMINAL,
    bristle_damping,
    bristle_rate,
    contact_rules,
    counted,
    damping_rule,
    friction,
    friction_level,
    passive_speed,
    passivity_note,
    rising_notes,
    steady_bristle,
)
from fmus.physics.sampling import saturate

TWO_PI = 6.283185307179586
FLANK = 1e-9
"""A table counts as touching a flank of the play if its distance is below this share of the whole play."""


def drift_rule(drift_amplitude: float, drift_frequency: float) -> Rule:
    """Rule of the drift of friction: a drift with an amplitude needs a frequency."""
    return Rule(
        either(drift_amplitude <= 0.0, drift_frequency > 0.0),
        "drift_amplitude needs a drift_frequency. Set it above 0.",
    )


def drift(t: float, amplitude: float, frequency: float) -> float:
    """Factor on F_C and F_S at the time ``t``: 1 + amplitude*sin(2*pi*frequency*t); ``frequency`` in Hz."""
    # Without drift the angle is the constant 0, so the compiled equations call no sine.
    return 1.0 + amplitude * sin(where(amplitude > 0.0, TWO_PI * frequency * t, 0.0))


class RigidBallscrew(Plant):
    """Base of the rigid ballscrew plants: motion, level of friction, play and ports; not used itself.

    Source: Shams & Safdari, Fuzzy sliding mode control of a ball screw driven stage, Motion Control (IntechOpen),
    2010, sec. 2 and 3.
    """

    experiment: ClassVar[Experiment] = Experiment(stop_time=10.0, step_size=1e-4)

    m: float = parameter(62.4, "kg", "Moving mass of table and work", min=0.0, nominal=10.0)
    J_rot: float = parameter(2.12e-4, "kg.m2", "Inertia of motor, coupling and screw", min=1e-9, nominal=1e-4)
    l_p: float = parameter(1.5923e-3, "m/rad", "Lead of the screw for one radian", min=1e-9, nominal=1e-3)
    sigma_2: float = parameter(0.4, "N.m.s/rad", "Viscous friction", min=0.0)
    F_C: float = parameter(6.24, "N.m", "Coulomb friction", min=0.0)
    F_S: float = parameter(9.36, "N.m", "Static friction; below F_C for friction that rises with speed", min=0.0)
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
        table: float = variable(0.0, "m", "Position of the table, with play", nominal=1e-3, discrete=True)
        largest_speed: float = variable(
            0.0, "rad/s", "Largest magnitude of speed since the start", nominal=1e-2, discrete=True
        )

    class Input(Record):
        command: float = variable(0.0, "N.m", "Torque of the motor")
        load_torque: float = variable(0.0, "N.m", "Load torque at the screw, opposing positive motion")

    class Output(Record):
        position: float = variable(0.0, "m", "Position of the table", nominal=1e-3, display_unit="mm")
        velocity: float = variable(0.0, "m/s", "Velocity of the table", nominal=1e-3, display_unit="mm/s")
        angle: float = variable(0.0, "rad", "Angle of the screw")
        speed: float = variable(0.0, "rad/s", "Speed of the screw")
        friction_torque: float = variable(0.0, "N.m", "Friction torque at the screw, opposing positive motion")

    def contact_rules(self, compliance: float) -> tuple[Rule, ...]:
        """Rules of friction and drift; ``compliance`` is the smallest deflection per torque [rad/N.m]."""
        return (
            *contact_rules(
                self.F_C,
                self.F_S,
                self.F_C_negative,
                self.F_S_negative,
                load=self.friction_scale * (1.0 - self.drift_amplitude),
                compliance=compliance,
            ),
            drift_rule(self.drift_amplitude, self.drift_frequency),
        )

    def notes(self, x: Any) -> tuple[Note, ...]:
        return rising_notes(self.F_C, self.F_S, self.F_C_negative, self.F_S_negative, unit="N.m")

    def least_level(self) -> float:
        """The smallest value of ``level`` at any time and speed [N.m]."""
        forward = minimum(self.F_C, self.F_S)
        backward = minimum(self.F_C * self.F_C_negative, self.F_S * self.F_S_negative)
        return self.friction_scale * (1.0 - self.drift_amplitude) * minimum(forward, backward)

    def level(self, t: float, speed: float) -> float:
        """Magnitude of the friction torque without viscous part, in steady sliding at ``speed`` [N.m]."""
        F_C = where(speed < 0.0, self.F_C * self.F_C_negative, self.F_C)
        F_S = where(speed < 0.0, self.F_S * self.F_S_negative, self.F_S)
        return self.normal_load(t) * friction_level(speed, F_C, F_S, self.v_s)

    def normal_load(self, t: float) -> float:
        """Factor on F_C and F_S at the time ``t``, from friction_scale and drift."""
        return self.friction_scale * drift(t, self.drift_amplitude, self.drift_frequency)

    def viscous(self, speed: float) -> float:
        """Coefficient of the viscous friction at ``speed`` [N.m.s/rad]."""
        return where(speed < 0.0, self.sigma_2 * self.sigma_2_negative, self.sigma_2)

    def acceleration(self, u: Input, drive: float, torque: float) -> float:
        """Angular acceleration under the torque of the drive and the friction torque [rad/s2]."""
        J = self.J_rot + self.m * self.l_p**2
        return (drive - torque - u.load_torque) / J

    def drive(self, u: Input) -> float:
        """Torque of a drive without lag [N.m]."""
        return saturate(u.command, self.command_max)

    def nut(self, angle: float) -> float:
        """Travel of the nut [m] for a lead without error; plants with lead errors override it."""
        return self.l_p * angle

    def nut_velocity(self, x: Any) -> float:
        """Velocity of the nut [m/s] for a lead without error; plants with lead errors override it."""
        return self.l_p * x.speed

    def pushed(self, x: State) -> float:
        """Position of the table [m]: unchanged, unless a flank of the play pushes the table."""
        nut = self.nut(x.angle)
        return clip(x.table, nut - self.play_positive, nut + self.play_negative)

    def update(self, t: float, x: Any, u: Any) -> Any:
        return replace(x, table=self.pushed(x), largest_speed=maximum(x.largest_speed, abs(x.speed)))

    def table_velocity(self, x: State, position: float) -> float:
        """Velocity of the table at ``position`` [m/s]: that of the nut, or 0 between the flanks of the play."""
        nut = self.nut(x.angle)
        near = FLANK * (self.play_positive + self.play_negative)
        moves = either(
            both(x.speed >= 0.0, position <= nut - self.play_positive + near),
            both(x.speed <= 0.0, position >= nut + self.play_negative - near),
        )
        return where(moves, self.nut_velocity(x), 0.0)

    def measured(self, x: State, torque: float) -> Output:
        """The outputs, with the position from an encoder without interpolation error."""
        position = self.pushed(x)
        return self.Output(
            position=round_to(position, self.resolution),
            velocity=self.table_velocity(x, position),
            angle=x.angle,
            speed=x.speed,
            friction_torque=torque,
        )


class BristleBallscrew(RigidBallscrew):
    """Base of the rigid ballscrew plants whose friction has one bristle at the screw; not used itself.

    Source: Canudas de Wit et al., IEEE Trans. Automatic Control 40(3), 1995; Olsson, Control systems with friction,
    thesis, Lund, 1996 (v_d).
    """

    sigma_0: float = parameter(1e5, "N.m/rad", "Stiffness of the bristles", min=1e-9, nominal=1e5)
    sigma_1: float = parameter(316.22776601683796, "N.m.s/rad", "Damping of the bristles", min=0.0, nominal=100.0)
    v_d: float = parameter(
        0.0, "rad/s", "Speed over which the damping of the bristles falls (0 = constant)", min=0.0, nominal=1e-2
    )

    class State(RigidBallscrew.State):
        bristle: float = variable(0.0, "rad", "Deflection of the bristles", nominal=BRISTLE_NOMINAL)

    def rules(self) -> tuple[Rule, ...]:
        return (*self.contact_rules(1.0 / self.sigma_0), damping_rule(self.v_d))

    def notes(self, x: State) -> tuple[Note, ...]:
        limit = passive_speed(4.0 * self.least_level(), self.sigma_1, self.v_d)
        bound = "4*min(F_C, F_S)/sigma_1"
        return (*RigidBallscrew.notes(self, x), passivity_note(x.largest_speed, limit, "rad/s", bound=bound))

    def steady_bristle(self, speed: float) -> float:
        """Deflection of the bristle at the start [rad]."""
        return self.bristle_start * steady_bristle(speed, self.level(0.0, speed), self.sigma_0)

    def torque(self, x: State, rate: float) -> float:
        """Friction torque [N.m] while the deflection of the bristle changes at ``rate`` [rad/s]."""
        return friction(
            counted(x.bristle, self.friction_scale),
            rate,
            x.speed,
            sigma_0=self.sigma_0,
            sigma_1=bristle_damping(x.speed, self.sigma_1, self.v_d),
            sigma_2=self.viscous(x.speed),
        )

    def lugre(self, x: State, level: float) -> tuple[float, float]:
        """Rate of the bristle [rad/s] and friction torque [N.m] of LuGre friction with ``level`` [N.m]."""
        rate = bristle_rate(x.bristle, x.speed, level, self.sigma_0)
        return rate, self.torque(x, rate)
