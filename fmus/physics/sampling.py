"""Functions for all sampled controllers: measured velocity, saturation of the command, hold of an integrator.

A controller that estimates its velocity keeps three discrete states, all starting at 0::

    started         1 after the first sample
    position_last   position of the sample before
    velocity_last   velocity estimate of the sample before

Source: the laws are elementary; the velocity estimate is that of Rubio, Ibeas & Luo 2015 (backward difference and
first-order filter), the hold of the integrator is the conditional integration of Astrom & Hagglund,
Advanced PID Control, ISA, 2006, sec. 3.5.
"""

from __future__ import annotations

from typing import Protocol

from cosim.model import Choice, both, clip, exp, where


class VelocitySource(Choice):
    """The origin of a controller's measured velocity."""

    input = 1, "Input velocity"
    difference = 2, "Backward difference of position with first-order filter"


def filter_pole(T_s: float, time_constant: float) -> float:
    """Pole exp(-T_s/time_constant) of a sampled first-order filter, times in s; 0 (no filter) for a constant of 0."""
    return where(time_constant > 0.0, exp(-T_s / where(time_constant > 0.0, time_constant, 1.0)), 0.0)


def velocity_estimate(
    source: VelocitySource,
    started: float,
    position: float,
    velocity: float,
    *,
    position_last: float,
    velocity_last: float,
    T_s: float,
    filter_time: float,
) -> float:
    """Measured velocity at this sample, m/s.

        input:       velocity
        difference:  a*velocity_last + (1 - a)*(position - position_last)/T_s,   a = exp(-T_s/filter_time)

    ``started`` is 0 at the first sample and 1 afterwards. The first sample has no previous position, so the estimate is
    the input ``velocity`` (0 if it is not connected).
    """
    if source is VelocitySource.input:
        return velocity
    pole = filter_pole(T_s, filter_time)
    difference = pole * velocity_last + (1.0 - pole) * (position - position_last) / T_s
    return where(started > 0.5, difference, velocity)


class Sampled(Protocol):
    """A controller that measures its velocity."""

    @property
    def T_s(self) -> float: ...
    @property
    def velocity_source(self) -> VelocitySource: ...
    @property
    def velocity_filter_time(self) -> float: ...


class Memory(Protocol):
    """The states of a controller that measures its velocity, see above."""

    @property
    def started(self) -> float: ...
    @property
    def position_last(self) -> float: ...
    @property
    def velocity_last(self) -> float: ...


class Measurement(Protocol):
    """The inputs of a controller that measures its velocity."""

    @property
    def position(self) -> float: ...
    @property
    def velocity(self) -> float: ...


def measured_velocity(controller: Sampled, x: Memory, u: Measurement) -> float:
    """``velocity_estimate`` for a controller whose parameters, states and inputs have the names used here, m/s."""
    return velocity_estimate(
        controller.velocity_source,
        x.started,
        u.position,
        u.velocity,
        position_last=x.position_last,
        velocity_last=x.velocity_last,
        T_s=controller.T_s,
        filter_time=controller.velocity_filter_time,
    )


def saturate(command: float, command_max: float) -> float:
    """``command`` limited to -command_max ... command_max; unlimited where ``command_max`` is 0."""
    return where(command_max > 0.0, clip(command, -command_max, command_max), command)


def winds_up(command: float, command_max: float, push: float) -> bool:
    """Whether the realised ``command`` is at its limit and an integrator would drive it further out.

    ``push`` has the sign in which the next increment of the integrator moves the command. False if ``command_max`` is
    0, which is no limit.
    """
    at_limit = both(command_max > 0.0, abs(command) >= command_max)
    return both(at_limit, command * push > 0.0)
