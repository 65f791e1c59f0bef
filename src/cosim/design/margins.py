"""Margins of sampled loops: the loop transfer function from the plant's command back to itself.

The plant is linearized at the operating point, its command is held over the sampling time. The rest of the loop, from
the plant's outputs back to its command, is a sampled model of its responses to small pulses on these outputs, beginning
with the state that it has in the run. Meanwhile positions move on at their speed and all other signals hold.

Source: Astrom & Wittenmark, Computer-Controlled Systems, 1997, secs. 2.3 and 3.3; Skogestad & Postlethwaite,
Multivariable Feedback Control, 2005, sec. 2.4 (margins of loops with several crossovers).
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from ..errors import DescriptionError
from ..public import public_names
from ..result.metrics import Array
from ..system.system import System, read_system
from .linearize import StateSpace, linearize
from .rest_of_loop import rest_of_loop

__dir__ = public_names(globals())

FREQUENCIES = 4000
"""Number of frequencies at which margins are searched, over four decades up to half of the sampling frequency.

Neighbours differ by 0.23 %; crossings are interpolated between them.
"""


@dataclass(frozen=True)
class Margins:
    """Margins of a sampled loop; NaN or infinity where the loop transfer function has no such crossing."""

    stable: bool
    spectral_radius: float
    """Largest magnitude of the closed loop's eigenvalues."""
    mode_frequency: float
    """Frequency at which the motion of this eigenvalue swings, rad/s; 0 if it does not."""
    gain: float
    """Gain margin: the smallest factor above 1 on the loop gain that reaches the limit of stability."""
    gain_frequency: float
    """Frequency of the gain margin, rad/s."""
    phase: float
    """Phase margin: the smallest additional lag at a crossover that reaches the limit of stability, rad."""
    crossover: float
    """Frequency of the phase margin, at which the loop gain is 1, rad/s."""
    delay: float
    """Delay margin: the additional delay that reaches the limit of stability, s. The least of all crossovers."""
    sensitivity: float
    """Largest magnitude of 1/(1 + L)."""


def series(first: StateSpace, second: StateSpace) -> StateSpace:
    """The series connection second*first of two sampled models: the outputs of ``first`` go into ``second``."""
    n, m = first.A.shape[0], second.A.shape[0]
    A = np.zeros((n + m, n + m))
    A[:n, :n], A[n:, n:], A[n:, :n] = first.A, second.A, second.B @ first.C
    B = np.vstack((first.B, second.B @ first.D))
    C = np.hstack((second.D @ first.C, second.C))
    return StateSpace(A, B, C, second.D @ first.D, T_s=second.T_s)


def largest_eigenvalue(A: Array, B: Array, C: Array) -> complex:
    """The eigenvalue of ``A`` with the largest magnitude, without constants of motion.

    A constant of motion is an eigenvalue of magnitude 1 that ``B`` does not excite or ``C`` does not show. For
    instance, bristle, deflection and position of a stage at rest always obey the same linear relation.
    """
    from scipy import linalg as _linalg

    linalg: Any = _linalg
    values, left, right = linalg.eig(A, left=True)
    share = np.abs(C @ right).max(axis=0) * np.abs(left.conj().T @ B).max(axis=1)
    share /= np.abs((left.conj() * right).sum(axis=0))
    hidden = (share < 1e-9 * share.max()) & (np.abs(values) < 1.0 + 1e-9)
    values = values[~hidden]
    return complex(values[np.argmax(np.abs(values))])


def margins(loop: StateSpace) -> Margins:
    """Margins of the sampled loop L, closed with negative feedback."""
    if loop.T_s is None:
        raise DescriptionError("margins of a sampled loop need a sampled model: give one with T_s.")
    closed = loop.A - loop.B @ loop.C / (1.0 + float(loop.D[0, 0]))
    largest = largest_eigenvalue(closed, loop.B, loop.C)
    radius = abs(largest)
    omega = np.geomspace(1e-4, 1.0, FREQUENCIES) * math.pi / loop.T_s
    L = loop.response(omega)[:, 0, 0]
    size, angle = np.abs(L), np.unwrap(np.angle(L))
    angle -= 2.0 * math.pi * round(float(angle[0] + 0.5 * math.pi) / (2.0 * math.pi))
    phase, crossover, delay = math.inf, math.nan, math.inf
    for i in (int(i) for i in np.flatnonzero((size[:-1] >= 1.0) != (size[1:] >= 1.0))):
        share = math.log(size[i]) / math.log(size[i] / size[i + 1])
        found = float(angle[i] + share * (angle[i + 1] - angle[i])) + math.pi
        found = found % (2.0 * math.pi) if radius < 1.0 else math.remainder(found, 2.0 * math.pi)
        frequency = float(omega[i] * (omega[i + 1] / omega[i]) ** share)
        if found < phase:
            phase, crossover = found, frequency
        # A delay turns every crossover clockwise, until the first one reaches -1.
        delay = min(delay, found / frequency)
    gain, at = math.inf, math.nan
    turns = (angle + math.pi) / (2.0 * math.pi)
    for i in (int(i) for i in np.flatnonzero(np.floor(turns[:-1]) != np.floor(turns[1:]))):
        level = max(math.floor(turns[i]), math.floor(turns[i + 1]))
        share = (level - turns[i]) / (turns[i + 1] - turns[i])
        factor = 1.0 / math.exp((1.0 - share) * math.log(size[i]) + share * math.log(size[i + 1]))
        if 1.0 < factor < gain:
            gain, at = factor, float(omega[i] + share * (omega[i + 1] - omega[i]))
    if size[-1] > 0.0 and abs(abs(angle[-1] / math.pi) % 2.0 - 1.0) < 1e-6 and 1.0 < 1.0 / size[-1] < gain:
        gain, at = 1.0 / float(size[-1]), float(omega[-1])
    return Margins(
        stable=radius < 1.0,
        spectral_radius=radius,
        mode_frequency=abs(cmath.phase(largest)) / loop.T_s,
        gain=gain,
        gain_frequency=at,
        phase=phase,
        crossover=crossover,
        delay=delay,
        sensitivity=float(np.max(1.0 / np.abs(1.0 + L))),
    )


def loop_margins(
    source: str | Path | System,
    *,
    at: float,
    controller: str = "controller",
    plant: str = "plant",
    command: str = "command",
    step: float | None = None,
    start: Mapping[str, object] | None = None,
    fmus: str | Path | None = None,
) -> tuple[StateSpace, Margins]:
    """Loop transfer function and margins of a system's loop, around its state at the time ``at`` in s.

    The loop is opened at the command of the plant. It closes through all outputs of the plant that come back to the
    command, through ``controller`` and all other instances between; each output is moved for a sample to find
    the model of this rest, by ``step`` in its unit (default: the size at which the response is most linear).
    Delays of the order of evaluation count. ``start`` gives start values (``{"controller.sensor_resolution": 0.0}``).
    Raises DescriptionError if the command moves nothing (at its limit), if a measured output is rounded, if the rest
    of the loop is not linear there, and if ``controller`` is no part of the loop.
    """
    system = source if isinstance(source, System) else read_system(source, fmus=fmus)
    system = system.changed(start)
    rest = rest_of_loop(system, plant, command, controller)
    model = linearize(system, instance=plant, at=at, inputs=[command], outputs=rest.measured)
    if model.idle_inputs:
        raise DescriptionError(
            f"{plant}.{command} changes nothing at t = {at:g} s, so there is no loop and no margin. It is saturated "
            "there: linearize at another time, or raise the limit."
        )
    if model.idle_outputs:
        raise DescriptionError(
            f"{plant}.{model.idle_outputs[0]} has no derivative at t = {at:g} s: it is rounded. Set the resolution of "
            f"{plant} to 0 for the margins."
        )
    sampled = rest.linear(at, step)
    held = model.reduced().held(cast(float, sampled.T_s))
    # Negative feedback: the rest of the loop sees measurements, not errors.
    loop = series(held, replace(sampled, C=-sampled.C, D=-sampled.D))
    return loop, margins(loop)
