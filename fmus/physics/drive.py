"""The drive of a motor, as pure functions: lag of its current loop, limit of its voltage, ripple over the motion.

    lag*der(drive) = target - drive                                     drive = target where lag = 0
    abs(R*current + back) <= voltage_max                                no limit where voltage_max = 0
    ripple = sum of amplitude[i]*sin(order[i]*angle + phase[i])

``back`` is the back-EMF, K_m*speed. The voltage limit acts on the current without delay: the lag stands for the
inductance.

Source: elementary: first-order lag, Ohm's law, Fourier series.
"""

from __future__ import annotations

from collections.abc import Sequence

from cosim.model import Plant, clip, parameter, sin, where


class RotaryDrive(Plant):
    """Base of the plants with a rotary motor whose drive has lag, voltage limit and torque ripple; not used itself."""

    drive_lag: float = parameter(
        0.0, "s", "Time constant of the current loop (0 = none)", min=0.0, nominal=1e-3, display_unit="ms"
    )
    voltage_max: float = parameter(0.0, "V", "Largest voltage of the drive (0 = no limit)", min=0.0, nominal=100.0)
    R: float = parameter(1.0, "Ohm", "Resistance of the motor, for the voltage limit", min=1e-9)
    torque_ripple: tuple[float, float] = parameter(
        (0.0, 0.0), "N.m", "Amplitude of the torque that the motor adds over the angle (0 = off)", min=0.0
    )
    torque_order: tuple[float, float] = parameter((1.0, 2.0), "1", "Periods of torque_ripple in a turn", min=0.0)
    torque_phase: tuple[float, float] = parameter(
        (0.0, 0.0), "rad", "Phase of torque_ripple at angle 0", display_unit="deg"
    )

    def ripple(self, angle: float) -> float:
        """Torque that the motor adds at ``angle`` [N.m]."""
        return harmonics(angle, self.torque_ripple, self.torque_order, self.torque_phase)


def behind_lag(target: float, drive: float, lag: float) -> float:
    """Output of the drive: its state ``drive`` if ``lag`` [s] is above 0, else ``target``."""
    return where(lag > 0.0, drive, target)


def lag_rate(target: float, drive: float, lag: float) -> float:
    """Time derivative of the state ``drive``; 0 without a lag."""
    return where(lag > 0.0, (target - drive) / where(lag > 0.0, lag, 1.0), 0.0)


def within_voltage(drive: float, per_volt: float, back: float, voltage_max: float) -> float:
    """``drive`` limited by the voltage; unlimited if ``voltage_max`` is 0.

    ``per_volt`` is the drive for one volt: 1/R for a current, K_m/R for a torque. ``back`` is the back-EMF [V].
    """
    low, high = per_volt * (-voltage_max - back), per_volt * (voltage_max - back)
    return where(voltage_max > 0.0, clip(drive, low, high), drive)


def harmonics(angle: float, amplitude: Sequence[float], order: Sequence[float], phase: Sequence[float]) -> float:
    """Sum of amplitude[i]*sin(order[i]*angle + phase[i]), angles in rad, in the unit of the amplitudes."""
    return sum((a * sin(n * angle + p) for a, n, p in zip(amplitude, order, phase, strict=True)), 0.0)
