"""Controller ``FrictionPulse``: trapezoidal velocity pulse at each reversal of the commanded motion."""

from __future__ import annotations

from typing import ClassVar

from cosim.model import (
    Choice,
    Controller,
    Experiment,
    Record,
    both,
    clip,
    exp,
    interpolate,
    log,
    minimum,
    parameter,
    sign,
    variable,
    where,
)

NODES = 60


class Mode(Choice):
    """Whether there are pulses, and the origin of their amplitude and duration."""

    off = 1, "No pulses"
    fixed = 2, "Amplitude A and duration T"
    table = 3, "Tables over the reverse acceleration"


def _geometric(first: float, last: float) -> tuple[float, ...]:
    return tuple(first * exp(log(last / first) * i / (NODES - 1)) for i in range(NODES))


def _log_nodes(points: tuple[tuple[float, float], ...]) -> tuple[float, ...]:
    """Values at ``ACCELERATIONS``, interpolated between ``points`` linearly over the logarithm of the acceleration."""
    x = tuple(log(acceleration) for acceleration, _ in points)
    y = tuple(value for _, value in points)
    return tuple(interpolate(log(acceleration), x, y) for acceleration in ACCELERATIONS)


ACCELERATIONS = _geometric(2e-3, 120e-3)
AMPLITUDES = _log_nodes(((2e-3, 0.38e-3), (10e-3, 0.56e-3), (40e-3, 0.812e-3), (120e-3, 0.848e-3)))
DURATIONS = _log_nodes(((2e-3, 0.1306), (10e-3, 0.0828), (40e-3, 0.0498), (120e-3, 0.0383)))


class FrictionPulse(Controller):
    """Friction compensation by a trapezoidal pulse on the velocity command after each reversal of the reference.

        increment = position_next - position_ref
        reversal where sign(increment) differs from its last value other than 0; then
            time = 0,  direction = sign(increment)
            reverse_acceleration = abs(increment - increment_last)/T_s**2
            amplitude, duration = A, T (fixed) or those of the tables at reverse_acceleration (table)
        rise  = min(t_r, duration/2)
        velocity_pulse = direction*amplitude*clip(min(time, duration - time)/rise, 0, 1)

    The reversal is found on the commanded increment, samples at rest ignored. The first motion is no reversal; a
    reversal during a pulse starts the new one. The tables are linear between nodes in ascending order and hold
    their ends. The pulse is added to the velocity command of a cascade with full feed-forward and pushes in the new
    direction. The reference must be exact, not rounded, or the reverse acceleration is noise.

    Do not combine it with a disturbance observer. Start tables pass through four points learned for the X axis.

    Source: Feng et al., A novel time-varying friction compensation method for servomechanism, Mathematical Problems in
    Engineering 2015, 269391; its formulas are not legible and the pulse is rebuilt from its figures and text.
    """

    T_s: float = parameter(2.5e-4, "s", "Sampling time", min=1e-9, nominal=1e-4, display_unit="ms")
    mode: Mode = parameter(Mode.table, "1", "Whether there are pulses, and which")
    A: float = parameter(
        0.8e-3,
        "m/s",
        "Amplitude of a fixed pulse",
        min=0.0,
        nominal=1e-3,
        display_unit="mm/s",
        variability="tunable",
    )
    T: float = parameter(
        0.05, "s", "Duration of a fixed pulse", min=0.0, nominal=1e-2, display_unit="ms", variability="tunable"
    )
    t_r: float = parameter(2e-3, "s", "Time of rise and of fall", min=1e-9, nominal=1e-3, display_unit="ms")
    acceleration_table: tuple[float, ...] = parameter(
        ACCELERATIONS,
        "m/s2",
        "Reverse acceleration at a node, ascending",
        min=0.0,
        nominal=1e-2,
        name="table.acceleration",
    )
    amplitude_table: tuple[float, ...] = parameter(
        AMPLITUDES, "m/s", "Amplitude at a node", min=0.0, nominal=1e-3, display_unit="mm/s", name="table.amplitude"
    )
    duration_table: tuple[float, ...] = parameter(
        DURATIONS, "s", "Duration at a node", min=0.0, nominal=1e-2, display_unit="ms", name="table.duration"
    )

    experiment: ClassVar[Experiment] = Experiment(stop_time=5.0, step_size=2.5e-4)

    class State(Record):
        increment_last: float = variable(0.0, "m", "Increment of the sample before", nominal=1e-5)
        moving: float = variable(0.0, "1", "Sign of the last increment other than 0")
        samples: float = variable(0.0, "1", "Samples since the last reversal")
        acceleration: float = variable(0.0, "m/s2", "Reverse acceleration of the last reversal", nominal=1e-2)
        reversals: float = variable(0.0, "1", "Number of reversals so far")

    class Input(Record):
        position_ref: float = variable(0.0, "m", "Position reference", display_unit="mm")
        position_next: float = variable(0.0, "m", "Position reference one sample ahead", display_unit="mm")

    class Output(Record):
        velocity_pulse: float = variable(0.0, "m/s", "Pulse on the velocity command", display_unit="mm/s")
        reverse_acceleration: float = variable(0.0, "m/s2", "Reverse acceleration of the last reversal")
        time_since_reversal: float = variable(0.0, "s", "Time since the last reversal, 0 before the first")
        reversals: float = variable(0.0, "1", "Number of reversals so far")

    def output(self, t: float, x: State, u: Input) -> Output:
        increment = u.position_next - u.position_ref
        reverses = sign(increment) * x.moving < 0.0
        measured = abs(increment - x.increment_last) / self.T_s**2
        acceleration = where(reverses, measured, x.acceleration)
        time = where(reverses, 0.0, x.samples * self.T_s)
        reversals = x.reversals + where(reverses, 1.0, 0.0)
        if self.mode is Mode.off:
            amplitude, duration = 0.0, 0.0
        elif self.mode is Mode.fixed:
            amplitude, duration = self.A, self.T
        else:
            amplitude = interpolate(acceleration, self.acceleration_table, self.amplitude_table)
            duration = interpolate(acceleration, self.acceleration_table, self.duration_table)
        lasts = both(reversals > 0.5, duration > 0.0)
        rise = where(lasts, minimum(self.t_r, 0.5 * duration), 1.0)
        share = where(lasts, clip(minimum(time, duration - time) / rise, 0.0, 1.0), 0.0)
        direction = where(reverses, sign(increment), x.moving)
        return self.Output(
            velocity_pulse=direction * amplitude * share,
            reverse_acceleration=acceleration,
            time_since_reversal=time,
            reversals=reversals,
        )

    def update(self, t: float, x: State, u: Input, y: Output) -> State:
        increment = u.position_next - u.position_ref
        reverses = y.reversals > x.reversals
        return self.State(
            increment_last=increment,
            moving=where(abs(increment) > 0.0, sign(increment), x.moving),
            samples=where(reverses, 1.0, x.samples + where(x.reversals > 0.5, 1.0, 0.0)),
            acceleration=y.reverse_acceleration,
            reversals=y.reversals,
        )
