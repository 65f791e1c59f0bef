"""Plant ``LinearMotorAxis``: the linear motor axis with lag of its amplifier and cogging."""

from __future__ import annotations

from dataclasses import replace

from cosim.model import parameter, variable
from fmus.physics.drive import behind_lag, harmonics, lag_rate
from fmus.physics.milling import PI
from fmus.plant.linear_motor import LinearMotor


class LinearMotorAxis(LinearMotor):
    """Linear motor axis as LinearMotor, with lag of its amplifier and force ripple over the magnets.

        drive_lag*der(drive) = target - drive           target = k_t*command, limited to force_max/K_a
        current      = drive                            target where drive_lag = 0
        motor_force  = K_a*current + force ripple
        force ripple = sum of force_ripple[i]*sin(2*pi*i*position/magnet_pitch + force_phase[i]),  i = 1, 2

    All else is that of LinearMotor; with all options off the plant is that one. The force ripple is the cogging of an
    iron core, which acts without current, too. A delay of the drive belongs to the controller.

    Positive command, cutting force and disturbance push towards positive position. Valid as LinearMotor, for voltages
    that the amplifier can give.

    Source: as LinearMotor; lag and ripple are elementary: first-order lag, Fourier series.
    """

    drive_lag: float = parameter(
        0.0, "s", "Time constant of the amplifier (0 = none)", min=0.0, nominal=1e-3, display_unit="ms"
    )
    magnet_pitch: float = parameter(0.03, "m", "Period of the force ripple", min=1e-9, nominal=1e-2, display_unit="mm")
    force_ripple: tuple[float, float] = parameter(
        (0.0, 0.0), "N", "Amplitude of the ripple once and twice a magnet_pitch (0 = off)", min=0.0
    )
    force_phase: tuple[float, float] = parameter(
        (0.0, 0.0), "rad", "Phase of force_ripple at position 0", display_unit="deg"
    )

    class State(LinearMotor.State):
        drive: float = variable(0.0, "A", "Current behind the lag of the amplifier", nominal=1e-3)

    def motor_current(self, x: State, u: LinearMotor.Input) -> float:
        return behind_lag(self.target(u), x.drive, self.drive_lag)

    def motor_force(self, x: State, u: LinearMotor.Input) -> float:
        turn = 2.0 * PI * x.position / self.magnet_pitch
        return self.K_a * self.motor_current(x, u) + harmonics(turn, self.force_ripple, (1.0, 2.0), self.force_phase)

    def derivative(self, t: float, x: State, u: LinearMotor.Input) -> State:
        rate = lag_rate(self.target(u), x.drive, self.drive_lag)
        return replace(LinearMotor.derivative(self, t, x, u), drive=rate)
