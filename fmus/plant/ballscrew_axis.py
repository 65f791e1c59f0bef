"""Rigid ballscrew stage with the drive and the imperfections of a measured axis."""

from __future__ import annotations

from cosim.model import Rule, cos, parameter, round_to, variable
from fmus.physics.ballscrew import TWO_PI, BristleBallscrew
from fmus.physics.drive import RotaryDrive, behind_lag, harmonics, lag_rate, within_voltage


class BallscrewAxis(RotaryDrive, BristleBallscrew):
    """Stage on a rigid ballscrew as BallscrewStage, with drive, ripple, lead error and encoder of a measured axis.

        der(angle)   = speed
        J*der(speed) = drive_torque + torque ripple - friction_torque - load_torque     J = J_rot + m*l_p^2
        der(bristle) = speed - sigma_0*abs(speed)*bristle/level
        friction_torque = sigma_0*bristle + S_1*der(bristle) + S_2*speed
        S_1 = sigma_1*exp(-(speed/v_d)^2)                                       sigma_1 where v_d = 0
        level = friction_scale*(1 + drift_amplitude*sin(2*pi*drift_frequency*t))
                *(C + (S - C)*exp(-(speed/v_s)^2))*(1 + friction ripple)
        friction ripple = sum of friction_ripple[i]*sin(friction_order[i]*angle + friction_phase[i]),  i = 1, 2
        torque ripple   = sum of torque_ripple[i]*sin(torque_order[i]*angle + torque_phase[i])
        drive_lag*der(drive) = limited command - drive              drive = limited command where drive_lag = 0
        drive_torque = drive, but abs(R*drive_torque/K_m + K_m*speed) <= voltage_max    no limit where it is 0
        nut = l_p*(1 + lead_error)*angle + lead_ripple*sin(angle + lead_phase)
        position = table + sum of encoder_error[i]*sin(2*pi*i*table/encoder_period + encoder_phase[i])

    C, S, S_2, the limit of the command, play and rounding are those of BallscrewStage; with all options off the plant
    is that one. The voltage limit acts on the torque at once, without inductance; K_m is torque constant and back-EMF
    constant. Velocity is that of the table, without errors of the encoder. position_start is that of a lead without
    error. A delay of the drive belongs to the controller.

    Positive command, angle and position go together; friction and load torque are positive where they oppose
    positive motion. Valid for motion below the first axial resonance.

    Valid limits of LuGre friction: passive for sure only where S_1*abs(speed) < 4*level, which with constant sigma_1
    and the start values ends at 0.079 rad/s = 0.126 mm/s; v_d = 0.01 rad/s makes it passive. Under a load that
    oscillates below break-away the stage drifts, and minor loops do not close: see BallscrewStageMaxwellSlip.

    Source: Shams & Safdari, Motion Control (IntechOpen), 2010, sec. 2 and 3; Canudas de Wit et al., IEEE Trans.
    Automatic Control 40(3), 1995; Olsson, Control systems with friction, thesis, Lund, 1996 (v_d). Drive, ripple and
    errors of lead and encoder are elementary: first-order lag, Ohm's law, Fourier series.
    """

    K_m: float = parameter(0.5, "N.m/A", "Torque and back-EMF constant, for the voltage limit", min=1e-9)
    friction_ripple: tuple[float, float] = parameter(
        (0.0, 0.0), "1", "Part by which the friction level changes over the angle (0 = off)", min=0.0, max=0.99
    )
    friction_order: tuple[float, float] = parameter((1.0, 2.0), "1", "Periods of friction_ripple in a turn", min=0.0)
    friction_phase: tuple[float, float] = parameter(
        (0.0, 0.0), "rad", "Phase of friction_ripple at angle 0", display_unit="deg"
    )
    lead_error: float = parameter(
        0.0, "1", "Part by which the lead is too long (0 = off)", min=-0.1, max=0.1, nominal=1e-5
    )
    lead_ripple: float = parameter(
        0.0, "m", "Amplitude of the lead error once a turn (0 = off)", min=0.0, nominal=1e-6, display_unit="um"
    )
    lead_phase: float = parameter(0.0, "rad", "Phase of lead_ripple at angle 0", display_unit="deg")
    encoder_period: float = parameter(
        20e-6, "m", "Signal period of the encoder", min=1e-9, nominal=1e-5, display_unit="um"
    )
    encoder_error: tuple[float, float] = parameter(
        (0.0, 0.0),
        "m",
        "Interpolation error once and twice a signal period (0 = off)",
        min=0.0,
        nominal=1e-8,
        display_unit="nm",
    )
    encoder_phase: tuple[float, float] = parameter(
        (0.0, 0.0), "rad", "Phase of encoder_error at position 0", display_unit="deg"
    )

    class State(BristleBallscrew.State):
        drive: float = variable(0.0, "N.m", "Torque behind the lag of the current loop")

    class Output(BristleBallscrew.Output):
        drive_torque: float = variable(0.0, "N.m", "Torque of the drive, without torque ripple")

    def rules(self) -> tuple[Rule, ...]:
        return (
            *BristleBallscrew.rules(self),
            Rule(
                self.friction_ripple[0] + self.friction_ripple[1] < 1.0,
                "friction_ripple[1] + friction_ripple[2] reach 1: the friction level falls to 0. Take them smaller.",
            ),
            Rule(
                self.lead_ripple < self.l_p * (1.0 + self.lead_error),
                "lead_ripple reaches l_p*(1 + lead_error): the nut would run backwards. Take it smaller.",
            ),
        )

    def initial(self) -> State:
        speed, angle = self.velocity_start / self.l_p, self.position_start / self.l_p
        ripple = self.friction_ripple_factor(angle)
        return self.State(
            angle=angle, speed=speed, bristle=ripple * self.steady_bristle(speed), table=self.nut(angle), drive=0.0
        )

    def friction_ripple_factor(self, angle: float) -> float:
        """Factor of the friction level at ``angle``."""
        return 1.0 + harmonics(angle, self.friction_ripple, self.friction_order, self.friction_phase)

    def least_level(self) -> float:
        return BristleBallscrew.least_level(self) * (1.0 - self.friction_ripple[0] - self.friction_ripple[1])

    def nut(self, angle: float) -> float:
        ripple = harmonics(angle, (self.lead_ripple,), (1.0,), (self.lead_phase,))
        return self.l_p * (1.0 + self.lead_error) * angle + ripple

    def nut_velocity(self, x: State) -> float:
        return (self.l_p * (1.0 + self.lead_error) + self.lead_ripple * cos(x.angle + self.lead_phase)) * x.speed

    def drive_torque(self, x: State, u: BristleBallscrew.Input) -> float:
        """Torque of the drive, limited by its voltage [N.m]."""
        torque = behind_lag(self.drive(u), x.drive, self.drive_lag)
        return within_voltage(torque, self.K_m / self.R, self.K_m * x.speed, self.voltage_max)

    def rate_and_torque(self, t: float, x: State) -> tuple[float, float]:
        """Rate of the bristle [rad/s] and friction torque [N.m]."""
        return self.lugre(x, self.level(t, x.speed) * self.friction_ripple_factor(x.angle))

    def derivative(self, t: float, x: State, u: BristleBallscrew.Input) -> State:
        rate, torque = self.rate_and_torque(t, x)
        return self.State(
            angle=x.speed,
            speed=self.acceleration(u, self.drive_torque(x, u) + self.ripple(x.angle), torque),
            bristle=rate,
            table=0.0,
            drive=lag_rate(self.drive(u), x.drive, self.drive_lag),
        )

    def output(self, t: float, x: State, u: BristleBallscrew.Input) -> Output:
        _, torque = self.rate_and_torque(t, x)
        table = self.pushed(x)
        turn = TWO_PI * table / self.encoder_period
        error = harmonics(turn, self.encoder_error, (1.0, 2.0), self.encoder_phase)
        return self.Output(
            position=round_to(table + error, self.resolution),
            velocity=self.table_velocity(x, table),
            angle=x.angle,
            speed=x.speed,
            friction_torque=torque,
            drive_torque=self.drive_torque(x, u),
        )
