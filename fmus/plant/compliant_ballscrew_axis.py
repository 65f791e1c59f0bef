"""Plant ``CompliantBallscrewAxis``: the ballscrew of two inertias with the drive of a measured axis."""

from __future__ import annotations

from dataclasses import replace

from cosim.model import variable
from fmus.physics.drive import RotaryDrive, behind_lag, lag_rate, within_voltage
from fmus.physics.sampling import saturate
from fmus.plant.compliant_ballscrew import CompliantBallscrew


class CompliantBallscrewAxis(RotaryDrive, CompliantBallscrew):
    """Ballscrew stage of two inertias as CompliantBallscrew, with lag, voltage limit and torque ripple of its drive.

        J*der(speed) = K_m*current + torque ripple - friction_torque - load_torque - l_p*nut_force
        drive_lag*der(drive) = limited command - drive              drive = limited command where drive_lag = 0
        current = drive, but abs(R*current + K_m*speed) <= voltage_max          no limit where it is 0
        torque ripple = sum of torque_ripple[i]*sin(torque_order[i]*angle + torque_phase[i]),  i = 1, 2

    All else is that of CompliantBallscrew; with all options off the plant is that one. K_m is torque constant and
    back-EMF constant; the voltage limit acts on the current at once, without inductance. A delay of the drive belongs
    to the controller. Errors of lead and encoder are in BallscrewAxis.

    Positive current moves the table to positive position; positive loads and frictions oppose positive motion. Valid
    for motion without end stops. The lag is worth having where 1/drive_lag comes near the nut mode, 490 rad/s with the
    start values: it takes phase from the loop there.

    Valid limits of LuGre friction: as for CompliantBallscrew.

    Source: as CompliantBallscrew; drive and ripple are elementary: first-order lag, Ohm's law, Fourier series.
    """

    class State(CompliantBallscrew.State):
        drive: float = variable(0.0, "A", "Current behind the lag of the current loop")

    def motor_current(self, x: State, u: CompliantBallscrew.Input) -> float:
        current = behind_lag(saturate(u.command, self.command_max), x.drive, self.drive_lag)
        return within_voltage(current, 1.0 / self.R, self.K_m * x.speed, self.voltage_max)

    def motor_torque(self, x: State, u: CompliantBallscrew.Input) -> float:
        angle = (x.position + x.deflection) / self.l_p
        return self.K_m * self.motor_current(x, u) + self.ripple(angle)

    def derivative(self, t: float, x: State, u: CompliantBallscrew.Input) -> State:
        rate = lag_rate(saturate(u.command, self.command_max), x.drive, self.drive_lag)
        return replace(CompliantBallscrew.derivative(self, t, x, u), drive=rate)
