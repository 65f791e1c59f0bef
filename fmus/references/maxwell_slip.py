"""An independent solution of the stage with generalised Maxwell slip: every change of mode is located as an event.

The rate of an element jumps when it begins to slip. A solver that steps over such a jump loses accuracy without any
sign (Radau at 1e-10: errors of 8e-5 of the speed). Here each element has a flag for sticking or slipping. scipy's Radau
integrates the smooth equations between events, and the flags change at events only. No equation of ``fmus.physics`` is
used.
"""

# scipy leaves the types of its solvers open:
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from fmus.plant.ballscrew_stage_maxwell_slip import BallscrewStageMaxwellSlip

TOLERANCE = 1e-10
"""Relative tolerance of Radau, as for the other references."""


class Located:
    """The motion of the stage ``p``, without play, under inputs that are held over each step."""

    def __init__(self, p: BallscrewStageMaxwellSlip, tolerance: float = TOLERANCE) -> None:
        self.p, self.tolerance = p, tolerance
        self.k, self.alpha = np.array(p.k), np.array(p.alpha)
        speed = p.velocity_start / p.l_p
        held = p.bristle_start * np.sign(speed) * self.alpha * self.level(0.0, speed)
        self.y: Any = np.array([p.position_start / p.l_p, speed, *held])
        self.slips: Any = np.full(4, p.bristle_start >= 1.0 and speed != 0.0)
        self.events = 0

    def level(self, t: float, speed: float) -> float:
        """Largest friction torque of all elements together at time ``t`` [s] and ``speed`` [rad/s], N.m."""
        p, back = self.p, speed < 0.0
        F_C, F_S = p.F_C * (p.F_C_negative if back else 1.0), p.F_S * (p.F_S_negative if back else 1.0)
        load = p.friction_scale * (1.0 + p.drift_amplitude * np.sin(2.0 * np.pi * p.drift_frequency * t))
        return float(load * (F_C + (F_S - F_C) * np.exp(-((speed / p.v_s) ** 2))))

    def rates(self, t: float, y: Any) -> tuple[Any, float]:
        """Rates of the elements [N.m/s] and friction torque [N.m], with the present flags."""
        p, speed = self.p, y[1]
        direction, sticking = np.sign(speed), self.k * abs(speed)
        slipping = np.minimum(sticking, p.C * (self.alpha - direction * y[2:] / self.level(t, speed)))
        rates = direction * np.where(self.slips, slipping, sticking)
        damping = p.sigma_1 * (np.exp(-((speed / p.v_d) ** 2)) if p.v_d > 0.0 else 1.0)
        viscous = p.sigma_2 * (p.sigma_2_negative if speed < 0.0 else 1.0)
        return rates, float(np.sum(y[2:]) + damping * np.sum(rates) / np.sum(self.k) + viscous * speed)

    def _events(self) -> list[Any]:
        def reversal(_: float, y: Any) -> float:
            return float(y[1])

        def passing(i: int) -> Any:
            def excess(t: float, y: Any) -> float:
                # An element that already slips cannot pass its part again.
                return -1.0 if self.slips[i] else float(np.sign(y[1]) * y[2 + i] - self.alpha[i] * self.level(t, y[1]))

            excess.terminal, excess.direction = True, 1.0  # type: ignore[attr-defined]
            return excess

        reversal.terminal = True  # type: ignore[attr-defined]
        return [reversal, *(passing(i) for i in range(4))]

    def step(self, t: float, end: float, command: float, load_torque: float) -> None:
        """Go from ``t`` to ``end`` with held inputs, from event to event."""
        p = self.p
        inertia = p.J_rot + p.m * p.l_p**2
        drive = float(np.clip(command, -p.command_max, p.command_max)) if p.command_max > 0.0 else command

        def right_side(t: float, y: Any) -> Any:
            rates, friction = self.rates(t, y)
            return np.array([y[1], (drive - friction - load_torque) / inertia, *rates])

        while t < end:
            found: Any = solve_ivp(
                right_side,
                (t, end),
                self.y,
                "Radau",
                rtol=self.tolerance,
                atol=self.tolerance * np.array([1e-2, 1e-2, 1.0, 1.0, 1.0, 1.0]),
                events=self._events(),
                max_step=(end - t) / 2.0,
            )
            if not found.success:
                raise ArithmeticError(f"Radau stopped at {found.t[-1]:g} s: {found.message}")
            t, self.y = float(found.t[-1]), found.y[:, -1].copy()
            if found.status != 1:
                continue
            self.events += 1
            if len(found.t_events[0]):
                self.slips[:] = False
                # Move the speed off 0 in the direction of the acceleration, or the same reversal is found again.
                self.y[1] = np.copysign(1e-300, right_side(t, self.y)[1])
            for i in range(4):
                if len(found.t_events[1 + i]):
                    self.slips[i] = True
            # Other elements may reach their parts at the same event, or hold more than their parts when motion starts
            # again. They cause no event of their own, so their flags are set here.
            self.slips |= np.sign(self.y[1]) * self.y[2:] >= self.alpha * self.level(t, self.y[1])

    def outputs(self, t: float) -> tuple[float, ...]:
        """Position [m], velocity [m/s], angle [rad], speed [rad/s] and friction torque [N.m]."""
        p, (angle, speed) = self.p, self.y[:2]
        position = p.l_p * angle
        if p.resolution > 0.0:
            position = p.resolution * np.floor(position / p.resolution + 0.5)
        return (float(position), float(p.l_p * speed), float(angle), float(speed), self.rates(t, self.y)[1])


def solution(stage: Any, step_size: float, inputs: Sequence[Any]) -> list[tuple[float, ...]]:
    """The outputs of every row of an experiment; the inputs of a row are held until the next row."""
    motion = Located(stage)
    rows = [motion.outputs(0.0)]
    for k, u in enumerate(inputs[:-1]):
        end = (k + 1) * step_size
        motion.step(k * step_size, end, u.command, u.load_torque)
        rows.append(motion.outputs(end))
    return rows
