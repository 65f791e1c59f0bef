"""Plant ``CompliantBallscrew``: two inertias, nut stiffness or backlash between them, LuGre friction at both."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, ClassVar

from cosim.model import (
    Experiment,
    Note,
    Plant,
    Record,
    Rule,
    either,
    maximum,
    minimum,
    parameter,
    round_to,
    tanh,
    variable,
    where,
)
from fmus.physics.ballscrew import drift, drift_rule
from fmus.physics.lugre import (
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


class CompliantBallscrew(Plant):
    """Ballscrew stage of two inertias: screw with motor and table, joined by an elastic nut that may have backlash.

        der(angle)    = speed
        J*der(speed)  = K_m*current - friction_torque - load_torque - l_p*nut_force
        der(position) = velocity
        m*der(velocity) = nut_force - guide_force - load_force
        friction_torque = LuGre(speed) + T_cm*tanh(speed/omega_cm),   guide_force = LuGre(velocity)
        LuGre(v) = sigma_0*z + sigma_1*exp(-(v/v_d)^2)*der(z) + sigma_2*v      sigma_1 constant where v_d = 0
        der(z) = v - sigma_0*abs(v)*z/level,   level = F_C + (F_S - F_C)*exp(-(v/v_s)^2)
        d = l_p*angle - position
        without backlash: nut_force = K_n*d + C_n*der(d)
        with backlash:    nut_force = max(0, K_n*(d - gap_plus) + C_n*der(d))    where d > gap_plus
                          nut_force = min(0, K_n*(d + gap_minus) + C_n*der(d))   where d < -gap_minus
                          nut_force = 0                                          between

    Positive current moves the table to positive position; positive loads and frictions oppose positive motion. The
    limits at 0 keep the nut from sticking: an impact is a spring and damper that push only. The current follows the
    command at once, limited to +-command_max. The friction levels F_C and F_S of both contacts are multiplied by
    friction_scale*(1 + drift_amplitude*sin(2*pi*drift_frequency*t)), and F_C, F_S, sigma_2 by their factors for
    negative velocity. F_C = F_S = 0 leaves sigma_2 only: no bristles. Without
    guide_friction guide_force = guide_sigma_2*velocity; without motor_friction the tanh term is absent.

    The state is d instead of the angle, so that the forces between the inertias keep their digits far from the origin.
    Resolutions round the measured positions only. Valid for motion without end stops and for a current loop much
    faster than the nut mode; CompliantBallscrewAxis has a drive with lag, voltage limit and ripple.

    Valid limits of LuGre friction: passive for sure only where sigma_1*abs(speed) < 4*level, which with constant
    sigma_1 and the start values ends at 2.6 rad/s = 0.81 mm/s; v_d = 1 rad/s cures it. Under a load that oscillates
    below break-away the stage drifts (270 nm a cycle under 0.02 +- 0.01 N.m at 50 Hz); minor loops do not close.

    Start values: the stage of Maeda & Sato with LuGre friction in place of its stick rule; sigma_0 and sigma_1 are
    not in the paper (sigma_1 gives its practical stability limit).

    Source: Maeda & Sato, Practical control method for ultra-precision positioning using a ballscrew mechanism,
    Precision Engineering 32, 2008, table 1 and fig. 2; Shams & Safdari, Motion Control (IntechOpen), 2010, sec.
    2.1 (backlash); Feng et al., A novel time-varying friction compensation method for servomechanism, Mathematical
    Problems in Engineering 2015 (axis of two masses with motor friction); Canudas de Wit et al. 1995 (LuGre); Olsson,
    Control systems with friction, thesis, Lund, 1996 (v_d).
    """

    K_m: float = parameter(0.172, "N.m/A", "Torque constant of the motor", min=0.0, nominal=0.1)
    J: float = parameter(1.81e-4, "kg.m2", "Inertia of motor and screw", min=1e-9, nominal=1e-4)
    m: float = parameter(3.57, "kg", "Mass of the table", min=1e-6)
    l_p: float = parameter(3.183098861837907e-4, "m/rad", "Table travel a radian of the screw", min=1e-9, nominal=1e-3)
    K_n: float = parameter(8.3e5, "N/m", "Axial stiffness of nut and screw", min=0.0, nominal=1e6)
    C_n: float = parameter(1700.0, "N.s/m", "Axial damping of nut and screw", min=0.0, nominal=1e3)
    command_max: float = parameter(6.0, "A", "Largest current, 0 for no limit", min=0.0)

    sigma_0: float = parameter(14.6, "N.m/rad", "Bristle stiffness at the screw", min=1e-9)
    sigma_1: float = parameter(0.072, "N.m.s/rad", "Bristle damping at the screw", min=0.0)
    sigma_2: float = parameter(9.7e-4, "N.m.s/rad", "Viscous friction at the screw", min=0.0, nominal=1e-3)
    F_C: float = parameter(0.046, "N.m", "Coulomb friction at the screw", min=0.0)
    F_S: float = parameter(0.046, "N.m", "Static friction at the screw", min=0.0)
    v_s: float = parameter(1.0, "rad/s", "Stribeck speed at the screw", min=1e-9)
    v_d: float = parameter(
        0.0, "rad/s", "Speed over which the bristle damping at the screw falls, 0 for constant", min=0.0
    )
    motor_friction: bool = parameter(False, "1", "Smoothed Coulomb friction of the motor")
    T_cm: float = parameter(0.0, "N.m", "Coulomb friction of the motor", min=0.0)
    omega_cm: float = parameter(0.1, "rad/s", "Speed over which the motor friction changes sign", min=1e-9)

    guide_friction: bool = parameter(False, "1", "LuGre friction of the guide")
    guide_sigma_0: float = parameter(2e7, "N/m", "Bristle stiffness at the guide", min=1e-6, nominal=1e7)
    guide_sigma_1: float = parameter(0.0, "N.s/m", "Bristle damping at the guide", min=0.0, nominal=1e4)
    guide_sigma_2: float = parameter(0.0, "N.s/m", "Viscous friction at the guide", min=0.0, nominal=100.0)
    guide_F_C: float = parameter(0.0, "N", "Coulomb friction at the guide", min=0.0)
    guide_F_S: float = parameter(0.0, "N", "Static friction at the guide", min=0.0)
    guide_v_s: float = parameter(2e-3, "m/s", "Stribeck velocity at the guide", min=1e-12, nominal=1e-3)
    guide_v_d: float = parameter(
        0.0, "m/s", "Velocity over which the bristle damping at the guide falls, 0 for constant", min=0.0, nominal=1e-3
    )

    friction_scale: float = parameter(1.0, "1", "Factor of F_C and F_S", min=0.0, variability="tunable")
    F_C_negative: float = parameter(1.0, "1", "Factor of F_C for negative velocity", min=0.0)
    F_S_negative: float = parameter(1.0, "1", "Factor of F_S for negative velocity", min=0.0)
    sigma_2_negative: float = parameter(1.0, "1", "Factor of sigma_2 for negative velocity", min=0.0)
    drift_amplitude: float = parameter(0.0, "1", "Amplitude of the drift of F_C and F_S, 0 for none", min=0.0, max=0.99)
    drift_frequency: float = parameter(0.0, "Hz", "Frequency of the drift of F_C and F_S", min=0.0)

    backlash: bool = parameter(False, "1", "Dead band between nut and screw")
    gap_plus: float = parameter(
        5e-6, "m", "Gap of the dead band, screw ahead", min=0.0, nominal=1e-6, display_unit="um"
    )
    gap_minus: float = parameter(
        5e-6, "m", "Gap of the dead band, screw behind", min=0.0, nominal=1e-6, display_unit="um"
    )

    position_resolution: float = parameter(
        0.0, "m", "Resolution of position, 0 for none", min=0.0, nominal=1e-9, display_unit="um"
    )
    motor_resolution: float = parameter(
        0.0, "m", "Resolution of motor_position, 0 for none", min=0.0, nominal=1e-9, display_unit="um"
    )
    position_start: float = parameter(0.0, "m", "Position at the start", display_unit="mm")
    velocity_start: float = parameter(0.0, "m/s", "Velocity of table and screw at the start", display_unit="mm/s")
    bristle_start: float = parameter(
        1.0, "1", "Bristles at the start: 0 undeflected, 1 as in steady sliding at velocity_start", min=0.0, max=1.0
    )

    experiment: ClassVar[Experiment] = Experiment(stop_time=1.0, step_size=2e-4)

    class State(Record):
        position: float = variable(0.0, "m", "Position of the table", nominal=1e-3, display_unit="mm")
        velocity: float = variable(0.0, "m/s", "Velocity of the table", nominal=1e-3, display_unit="mm/s")
        deflection: float = variable(0.0, "m", "Travel of the screw less that of the table", nominal=1e-6)
        speed: float = variable(0.0, "rad/s", "Speed of the screw", nominal=1.0)
        bristle: float = variable(0.0, "rad", "Bristle deflection at the screw", nominal=1e-4)
        guide_bristle: float = variable(0.0, "m", "Bristle deflection at the guide", nominal=1e-6)
        largest_speed: float = variable(0.0, "rad/s", "Largest magnitude of speed since the start", discrete=True)
        largest_velocity: float = variable(0.0, "m/s", "Largest magnitude of velocity since the start", discrete=True)

    class Input(Record):
        command: float = variable(0.0, "A", "Current command")
        load_force: float = variable(0.0, "N", "Force on the table, positive against positive motion")
        load_torque: float = variable(0.0, "N.m", "Torque on the screw, positive against positive motion")

    class Output(Record):
        position: float = variable(0.0, "m", "Measured position of the table", display_unit="mm")
        velocity: float = variable(0.0, "m/s", "Velocity of the table", display_unit="mm/s")
        motor_position: float = variable(0.0, "m", "Measured travel of the screw", display_unit="mm")
        motor_velocity: float = variable(0.0, "m/s", "Velocity of the screw's travel", display_unit="mm/s")
        angle: float = variable(0.0, "rad", "Angle of the screw")
        speed: float = variable(0.0, "rad/s", "Speed of the screw")
        nut_force: float = variable(0.0, "N", "Force of the nut on the table")
        friction_torque: float = variable(0.0, "N.m", "Friction at screw and motor")
        guide_force: float = variable(0.0, "N", "Friction at the guide")
        current: float = variable(0.0, "A", "Motor current")

    def rules(self) -> tuple[Rule, ...]:
        negative = self.F_C_negative, self.F_S_negative
        load = self.friction_scale * (1.0 - self.drift_amplitude)
        screw, guide = 1.0 / self.sigma_0, 1.0 / self.guide_sigma_0
        return (
            *contact_rules(self.F_C, self.F_S, *negative, load=load, compliance=screw),
            *contact_rules(self.guide_F_C, self.guide_F_S, *negative, load=load, compliance=guide, prefix="guide_"),
            damping_rule(self.v_d),
            damping_rule(self.guide_v_d, "guide_v_d"),
            Rule(
                either(self.guide_friction, self.guide_F_S <= 0.0),
                "guide_F_S is given but guide_friction is false. Set it true.",
            ),
            Rule(
                either(self.motor_friction, self.T_cm <= 0.0), "T_cm is given but motor_friction is false. Set it true."
            ),
            drift_rule(self.drift_amplitude, self.drift_frequency),
        )

    def notes(self, x: State) -> tuple[Note, ...]:
        negative = self.F_C_negative, self.F_S_negative
        found = (
            *rising_notes(self.F_C, self.F_S, *negative, unit="N.m"),
            passivity_note(
                x.largest_speed,
                passive_speed(4.0 * self._least_level(self.F_C, self.F_S), self.sigma_1, self.v_d),
                "rad/s",
                bound="4*min(F_C, F_S)/sigma_1",
            ),
        )
        if not self.guide_friction:
            return found
        return (
            *found,
            *rising_notes(self.guide_F_C, self.guide_F_S, *negative, unit="N", prefix="guide_"),
            passivity_note(
                x.largest_velocity,
                passive_speed(
                    4.0 * self._least_level(self.guide_F_C, self.guide_F_S), self.guide_sigma_1, self.guide_v_d
                ),
                "m/s",
                name="largest_velocity",
                v_d="guide_v_d",
                bound="4*min(guide_F_C, guide_F_S)/guide_sigma_1",
            ),
        )

    def initial(self) -> State:
        speed = self.velocity_start / self.l_p
        screw = steady_bristle(speed, self.screw_level(0.0, speed), self.sigma_0)
        guide = steady_bristle(self.velocity_start, self.guide_level(0.0, self.velocity_start), self.guide_sigma_0)
        return self.State(
            position=self.position_start,
            velocity=self.velocity_start,
            speed=speed,
            bristle=self.bristle_start * screw,
            guide_bristle=self.bristle_start * guide,
        )

    def _level(self, t: float, speed: float, F_C: float, F_S: float, v_s: float) -> float:
        level = friction_level(
            speed,
            where(speed < 0.0, F_C * self.F_C_negative, F_C),
            where(speed < 0.0, F_S * self.F_S_negative, F_S),
            v_s,
        )
        return self.friction_scale * drift(t, self.drift_amplitude, self.drift_frequency) * level

    def _least_level(self, F_C: float, F_S: float) -> float:
        """The smallest friction level of a contact at any time and speed, in the unit of ``F_C``."""
        backward = minimum(F_C * self.F_C_negative, F_S * self.F_S_negative)
        return self.friction_scale * (1.0 - self.drift_amplitude) * minimum(minimum(F_C, F_S), backward)

    def screw_level(self, t: float, speed: float) -> float:
        """Magnitude of the LuGre friction torque without viscous part, in steady sliding at ``speed`` [N.m]."""
        return self._level(t, speed, self.F_C, self.F_S, self.v_s)

    def guide_level(self, t: float, velocity: float) -> float:
        """Magnitude of the guide's friction without viscous part, in steady sliding at ``velocity`` [N]."""
        return self._level(t, velocity, self.guide_F_C, self.guide_F_S, self.guide_v_s)

    def _frictions(self, t: float, x: State) -> tuple[float, float, float, float]:
        """Bristle rate [rad/s] and friction [N.m] at the screw, bristle rate [m/s] and friction [N] at the guide."""
        rate = bristle_rate(x.bristle, x.speed, self.screw_level(t, x.speed), self.sigma_0)
        torque = friction(
            counted(x.bristle, self.friction_scale),
            rate,
            x.speed,
            sigma_0=self.sigma_0,
            sigma_1=bristle_damping(x.speed, self.sigma_1, self.v_d),
            sigma_2=where(x.speed < 0.0, self.sigma_2 * self.sigma_2_negative, self.sigma_2),
        )
        if self.motor_friction:
            torque = torque + self.T_cm * tanh(x.speed / self.omega_cm)
        guide_sigma_2 = where(x.velocity < 0.0, self.guide_sigma_2 * self.sigma_2_negative, self.guide_sigma_2)
        if not self.guide_friction:
            return rate, torque, 0.0, guide_sigma_2 * x.velocity
        guide_rate = bristle_rate(x.guide_bristle, x.velocity, self.guide_level(t, x.velocity), self.guide_sigma_0)
        force = friction(
            counted(x.guide_bristle, self.friction_scale),
            guide_rate,
            x.velocity,
            sigma_0=self.guide_sigma_0,
            sigma_1=bristle_damping(x.velocity, self.guide_sigma_1, self.guide_v_d),
            sigma_2=guide_sigma_2,
        )
        return rate, torque, guide_rate, force

    def motor_current(self, x: Any, u: Input) -> float:
        """Current of the motor [A] for a drive without lag and voltage limit; CompliantBallscrewAxis overrides it."""
        return saturate(u.command, self.command_max)

    def motor_torque(self, x: Any, u: Input) -> float:
        """Torque of the motor [N.m] without ripple; CompliantBallscrewAxis overrides it."""
        return self.K_m * self.motor_current(x, u)

    def _nut_force(self, x: State) -> float:
        rate = self.l_p * x.speed - x.velocity
        if not self.backlash:
            return self.K_n * x.deflection + self.C_n * rate
        push = maximum(0.0, self.K_n * (x.deflection - self.gap_plus) + self.C_n * rate)
        pull = minimum(0.0, self.K_n * (x.deflection + self.gap_minus) + self.C_n * rate)
        return where(x.deflection > self.gap_plus, push, where(x.deflection < -self.gap_minus, pull, 0.0))

    def derivative(self, t: float, x: Any, u: Input) -> Any:
        rate, torque, guide_rate, force = self._frictions(t, x)
        nut_force = self._nut_force(x)
        drive = self.motor_torque(x, u)
        return self.State(
            position=x.velocity,
            velocity=(nut_force - force - u.load_force) / self.m,
            deflection=self.l_p * x.speed - x.velocity,
            speed=(drive - torque - u.load_torque - self.l_p * nut_force) / self.J,
            bristle=rate,
            guide_bristle=guide_rate,
        )

    def update(self, t: float, x: State, u: Input) -> State:
        return replace(
            x,
            largest_speed=maximum(x.largest_speed, abs(x.speed)),
            largest_velocity=maximum(x.largest_velocity, abs(x.velocity)),
        )

    def output(self, t: float, x: State, u: Input) -> Output:
        _, torque, _, force = self._frictions(t, x)
        travel = x.position + x.deflection
        return self.Output(
            position=round_to(x.position, self.position_resolution),
            velocity=x.velocity,
            motor_position=round_to(travel, self.motor_resolution),
            motor_velocity=self.l_p * x.speed,
            angle=travel / self.l_p,
            speed=x.speed,
            nut_force=self._nut_force(x),
            friction_torque=torque,
            guide_force=force,
            current=self.motor_current(x, u),
        )
