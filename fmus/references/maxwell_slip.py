"""The stage with generalised Maxwell slip solved on its own: explicit modes, every change of mode located as an event.

The elements' rates jump where they begin to slip; a solver that steps over such a place loses its accuracy without a
sign (Radau at 1e-10: errors of 8e-5 of the speed). Here each element sticks or slips by a flag of its own, scipy's
Radau integrates the smooth equations between events, and the flags change at the events only. No equation of
``fmus.physics`` is used.
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
    """The motion of a stage ``p`` under inputs that are held over steps; without play."""

    def __init__(self, p: BallscrewStageMaxwellSlip, tolerance: float = TOLERANCE) -> None:
        self.p, self.tolerance = p, tolerance
        self.k, self.alpha = np.array(p.k), np.array(p.alpha)
        speed = p.velocity_start / p.l_p
        held = p.bristle_start * np.sign(speed) * self.alpha * self.level(0.0, speed)
        self.y: Any = np.array([p.position_start / p.l_p, speed, *held])
        self.slips: Any = np.full(4, p.bristle_start >= 1.0 and speed != 0.0)
        self.events = 0

    def level(self, t: float, speed: float) -> float:
        """Largest friction torque of all elements together."""
        p, back = self.p, speed < 0.0
        F_C, F_S = p.F_C * (p.F_C_negative if back else 1.0), p.F_S * (p.F_S_negative if back else 1.0)
        load = p.friction_scale * (1.0 + p.drift_amplitude * np.sin(2.0 * np.pi * p.drift_frequency * t))
        return float(load * (F_C + (F_S - F_C) * np.exp(-((speed / p.v_s) ** 2))))

    def rates(self, t: float, y: Any) -> tuple[Any, float]:
        """Rates of the elements and friction torque, with the flags as they are."""
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
                # Off the zero, the way the motion goes: it is not found again.
                self.y[1] = np.copysign(1e-300, right_side(t, self.y)[1])
            for i in range(4):
                if len(found.t_events[1 + i]):
                    self.slips[i] = True
            # Elements pass their parts together, or hold more than these when a motion sets in again: these cross no
            # more.
            self.slips |= np.sign(self.y[1]) * self.y[2:] >= self.alpha * self.level(t, self.y[1])

    def outputs(self, t: float) -> tuple[float, ...]:
        """Position, velocity, angle, speed and friction torque."""
        p, (angle, speed) = self.p, self.y[:2]
        position = p.l_p * angle
        if p.resolution > 0.0:
            position = p.resolution * np.floor(position / p.resolution + 0.5)
        return (float(position), float(p.l_p * speed), float(angle), float(speed), self.rates(t, self.y)[1])


def solution(stage: Any, step_size: float, inputs: Sequence[Any]) -> list[tuple[float, ...]]:
    """The outputs of every row of an experiment; ``inputs`` are held from their row to the next."""
    motion = Located(stage)
    rows = [motion.outputs(0.0)]
    for k, u in enumerate(inputs[:-1]):
        end = (k + 1) * step_size
        motion.step(k * step_size, end, u.command, u.load_torque)
        rows.append(motion.outputs(end))
    return rows
