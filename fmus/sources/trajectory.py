"""Reference trajectories."""

from __future__ import annotations

from typing import ClassVar

from cosim.model import (
    Choice,
    Experiment,
    Record,
    Rule,
    Source,
    both,
    clip,
    cos,
    either,
    floor,
    maximum,
    minimum,
    parameter,
    sign,
    sin,
    sqrt,
    variable,
    where,
)

TWO_PI = 6.283185307179586
INSTANT = 1e-9
"""A jump that lies at most this time in s after a sample belongs to the sample, since k*T_s is rounded."""
TINY = 1e-30
"""Replaces a denominator of 0 whose numerator is 0, too."""

QUINTIC_VELOCITY = 1.875
QUINTIC_ACCELERATION = 5.773502691896258
QUINTIC_JERK = 60.0
"""Largest derivatives of 10*s^3 - 15*s^4 + 6*s^5 on 0 ... 1: first, second and third."""

Motion = tuple[float, float, float]
"""Position, velocity, acceleration; or a path coordinate and its two rates."""
Phases = tuple[float, float, float, float]


class TrajectoryKind(Choice):
    """Form of the reference."""

    step = 1, "Step by amplitude"
    stairs = 2, "Steps by amplitude, one a dwell"
    ramp = 3, "By amplitude at constant feed"
    sine = 4, "Sine of amplitude"
    quintic = 5, "Moves by amplitude, polynomial of fifth order"
    trapezoidal = 6, "Moves by amplitude, trapezoidal velocity"
    jerk_limited = 7, "Moves by amplitude, trapezoidal acceleration"
    circle = 8, "One axis of a circle of radius"


class Trajectory(Source):
    """Reference position of one axis with its analytic derivatives.

    With tau = t - start_time, at rest before tau = 0, and s the path of ramp, sine and circle:

        step        position = offset + amplitude
        stairs      position = offset + amplitude*n,  n = 1, 2 ... repetitions, one a dwell
        ramp        position = offset + s,                         s' = feed, over abs(amplitude), without end where 0
        sine        position = offset + amplitude*sin(s + phase),  s' = 2*pi*frequency, turns periods
        circle      position = offset + radius*cos(s + phase),     s' = feed/radius, turns turns
        quintic, trapezoidal, jerk_limited
                    moves by amplitude, as fast as the limits allow that the kind has: a quintic and a jerk-limited
                    move keep velocity_max, acceleration_max and jerk_max, a trapezoidal one the first two

    Soft start: within T_r = soft_start the path is s = s'*T_r*(h^3 - h^4/2) with h = tau/T_r; a path that ends stops
    in the mirror image. With soft_start = 0 a circle gains and loses its speed with tangential_acceleration; the rest,
    and the circle if that is 0 too, start and stop at full speed. A path too short for it gets a lower top speed.

    The axes of a plane are two trajectories that differ in phase: on a circle that starts at angle phi the X axis has
    phase = phi, the Y axis phase = phi - pi/2. A negative feed turns it clockwise, and lets a ramp go down.

    A dwell follows every move. With out_and_back a move, its dwell, the way back and its dwell are one repetition,
    and stairs go down again by as many steps as up; without it, each repetition starts where the one before ended.
    At a reversal without dwell the acceleration of a trapezoidal move goes on without interruption.

    At a jump every output has its value after it, and a jump within 1 ns after a time counts as at that time.

    Source: quintic: Craig, Introduction to Robotics, 3rd ed. 2005, sec. 7.3; seven segments: Biagiotti & Melchiorri,
    Trajectory Planning for Automatic Machines and Robots, 2008, sec. 3.4; circles: ISO 230-4; sines, steps: Shams &
    Safdari 2010, sec. 6; stairs: Maeda & Sato, Precision Engineering 32, 2008, fig. 16; out and back: Feng et al. 2015.
    """

    experiment: ClassVar[Experiment] = Experiment(stop_time=10.0, step_size=1e-4)

    T_s: float = parameter(1e-4, "s", "Time by which position_next leads", min=0.0, nominal=1e-4, display_unit="ms")
    kind: TrajectoryKind = parameter(TrajectoryKind.sine, "1", "Form of the reference")
    amplitude: float = parameter(5e-3, "m", "Amplitude, or distance of a step or move", nominal=1e-3, display_unit="mm")
    frequency: float = parameter(0.15915494309189535, "Hz", "Frequency of a sine", min=0.0)
    phase: float = parameter(0.0, "rad", "Phase of a sine or circle at the start", display_unit="deg")
    offset: float = parameter(0.0, "m", "Position added to everything", nominal=1e-3, display_unit="mm")
    start_time: float = parameter(0.0, "s", "Time of the start")
    soft_start: float = parameter(0.0, "s", "Time to full speed of a ramp, sine or circle (0 = at once)", min=0.0)
    turns: float = parameter(0.0, "1", "Number of periods of a sine or turns of a circle (0 = without end)", min=0.0)
    repetitions: float = parameter(1.0, "1", "Number of steps or moves (0 = without end)", min=0.0)
    out_and_back: bool = parameter(False, "1", "Whether stairs and moves return")
    dwell: float = parameter(0.0, "s", "Rest after a move; duration of a stair", min=0.0)
    feed: float = parameter(
        8.333333333333333e-3, "m/s", "Speed of a ramp or along a circle", nominal=1e-2, display_unit="mm/s"
    )
    radius: float = parameter(0.02, "m", "Radius of the circle", min=1e-12, nominal=1e-2, display_unit="mm")
    tangential_acceleration: float = parameter(
        0.0, "m/s2", "Acceleration along a circle without soft_start (0 = at once)", min=0.0, nominal=0.1
    )
    velocity_max: float = parameter(
        0.05, "m/s", "Largest velocity of a move", min=1e-12, nominal=0.1, display_unit="mm/s"
    )
    acceleration_max: float = parameter(1.0, "m/s2", "Largest acceleration of a move", min=1e-12)
    jerk_max: float = parameter(50.0, "m/s3", "Largest jerk of a quintic or jerk-limited move", min=1e-12, nominal=10.0)

    class Output(Record):
        position: float = variable(0.0, "m", "Reference position", nominal=1e-3, display_unit="mm")
        velocity: float = variable(0.0, "m/s", "Reference velocity", nominal=1e-3, display_unit="mm/s")
        acceleration: float = variable(0.0, "m/s2", "Reference acceleration", nominal=1e-3, display_unit="mm/s2")
        position_next: float = variable(0.0, "m", "Reference position one T_s later", nominal=1e-3, display_unit="mm")

    def rules(self) -> tuple[Rule, ...]:
        if self.kind is TrajectoryKind.stairs:
            return (Rule(self.dwell > 0.0, "stairs need a dwell. Set it above 0."),)
        return ()

    def output(self, t: float) -> Output:
        position, velocity, acceleration = self.motion(t)
        position_next, _, _ = self.motion(t + self.T_s)
        return self.Output(position=position, velocity=velocity, acceleration=acceleration, position_next=position_next)

    def motion(self, t: float) -> Motion:
        """Position, velocity and acceleration at time ``t``."""
        tau = t - self.start_time
        kind = self.kind
        if kind is TrajectoryKind.step:
            return self.offset + where(tau > -INSTANT, self.amplitude, 0.0), 0.0, 0.0
        if kind is TrajectoryKind.stairs:
            return self.offset + self.amplitude * self.stair(tau), 0.0, 0.0
        if kind is TrajectoryKind.ramp:
            path, rate, rate_2 = soft_path(tau, abs(self.feed), abs(self.amplitude), self.soft_start)
            direction = sign(self.feed)
            return self.offset + direction * path, direction * rate, direction * rate_2
        if kind is TrajectoryKind.sine:
            path, rate, rate_2 = soft_path(tau, TWO_PI * self.frequency, TWO_PI * self.turns, self.soft_start)
            s, c = self.amplitude * sin(path + self.phase), self.amplitude * cos(path + self.phase)
            return self.offset + s, c * rate, c * rate_2 - s * rate**2
        if kind is TrajectoryKind.circle:
            path, rate, rate_2 = self.arc(tau)
            s, c = self.radius * sin(path + self.phase), self.radius * cos(path + self.phase)
            return self.offset + c, -s * rate, -s * rate_2 - c * rate**2
        return self.moves(tau)

    def stair(self, tau: float) -> float:
        """Number of steps above the offset."""
        step = 1.0 + floor((tau + INSTANT) / maximum(self.dwell, INSTANT))
        top = where(self.repetitions > 0.0, self.repetitions, maximum(step, 1.0))
        if self.out_and_back:
            return maximum(top - abs(step - top), 0.0)
        return clip(step, 0.0, top)

    def arc(self, tau: float) -> Motion:
        """Angle on the circle from its start [rad], and its first and second derivatives."""
        rate, length = abs(self.feed) / self.radius, TWO_PI * self.turns
        acceleration = self.tangential_acceleration / self.radius
        soft = soft_path(tau, rate, length, self.soft_start)
        linear = accelerated_path(tau, rate, length, acceleration)
        direction, is_soft = sign(self.feed), self.soft_start > 0.0
        return (
            direction * where(is_soft, soft[0], linear[0]),
            direction * where(is_soft, soft[1], linear[1]),
            direction * where(is_soft, soft[2], linear[2]),
        )

    def moves(self, tau: float) -> Motion:
        """Moves, each followed by a dwell."""
        distance = abs(self.amplitude)
        way = self.duration(distance) + self.dwell
        last = (2.0 if self.out_and_back else 1.0) * self.repetitions - 1.0
        n = floor((tau + INSTANT) / maximum(way, INSTANT))
        n = maximum(where(self.repetitions > 0.0, minimum(n, last), n), 0.0)
        path, rate, rate_2 = self.move(tau - n * way, distance)
        if self.out_and_back:
            back = n - 2.0 * floor(0.5 * n)
            start, direction = self.amplitude * back, sign(self.amplitude) * (1.0 - 2.0 * back)
        else:
            start, direction = self.amplitude * n, sign(self.amplitude)
        return self.offset + start + direction * path, direction * rate, direction * rate_2

    def duration(self, distance: float) -> float:
        """Time of one move [s]."""
        if self.kind is TrajectoryKind.quintic:
            by_velocity = QUINTIC_VELOCITY * distance / self.velocity_max
            by_acceleration = sqrt(QUINTIC_ACCELERATION * distance / self.acceleration_max)
            by_jerk = (QUINTIC_JERK * distance / self.jerk_max) ** (1.0 / 3.0)
            return maximum(by_velocity, maximum(by_acceleration, by_jerk))
        top, rise, flat, _ = self.phases(distance)
        return 2.0 * rise + flat + distance / maximum(top, TINY)

    def phases(self, distance: float) -> Phases:
        """Top velocity, time of rising and of constant acceleration, and largest acceleration of one move."""
        v, a, j = self.velocity_max, self.acceleration_max, self.jerk_max
        if self.kind is TrajectoryKind.trapezoidal:
            top = minimum(v, sqrt(a * distance))
            return top, 0.0, top / a, a
        full = 0.5 * a * (sqrt((a / j) ** 2 + 4.0 * distance / a) - a / j)
        short = (0.5 * distance) ** (2.0 / 3.0) * j ** (1.0 / 3.0)
        top = minimum(v, where(full * j < a**2, short, full))
        rise = minimum(sqrt(top / j), a / j)
        return top, rise, maximum(top / a - a / j, 0.0), j * rise

    def move(self, tau: float, distance: float) -> Motion:
        """One move by ``distance`` >= 0 from 0."""
        T = maximum(self.duration(distance), TINY)
        if self.kind is TrajectoryKind.quintic:
            s = clip(tau / T, 0.0, 1.0)
            rest = 1.0 - s
            return (
                distance * s**3 * (10.0 - s * (15.0 - 6.0 * s)),
                distance / T * 30.0 * (s * rest) ** 2,
                distance / T / T * 60.0 * s * rest * (rest - s),
            )
        top, rise, flat, a = self.phases(distance)
        second_half = tau > 0.5 * T
        h = maximum(where(second_half, T - tau, tau), 0.0)
        r_1, r_2, r_3 = clip(h, 0.0, rise), clip(h - rise, 0.0, flat), clip(h - rise - flat, 0.0, rise)
        j = self.jerk_max
        v_1 = 0.5 * j * r_1**2
        v_2 = v_1 + a * r_2
        velocity = v_2 + (a - 0.5 * j * r_3) * r_3
        path = j * r_1**3 / 6.0 + (v_1 + 0.5 * a * r_2) * r_2 + (v_2 + (0.5 * a - j * r_3 / 6.0) * r_3) * r_3
        path = path + top * (h - r_1 - r_2 - r_3)
        if self.kind is TrajectoryKind.trapezoidal:
            instant = tau + INSTANT
            acceleration = pulse(instant, 0.0, flat, a) - pulse(instant, T - flat, T, a)
        else:
            acceleration = j * where(second_half, r_3 - r_1, r_1 - r_3)
        return where(second_half, distance - path, path), velocity, acceleration


def soft_path(tau: float, rate: float, length: float, rise: float) -> Motion:
    """Path from 0: smoothly to ``rate`` >= 0 within ``rise`` [s] (0 = at once), up to ``length`` (0 = without end)."""
    has_rise, ends = rise > 0.0, length > 0.0
    top = where(both(has_rise, ends), minimum(rate, length / where(has_rise, rise, 1.0)), rate)
    total = length / maximum(top, TINY) + rise
    stops = both(ends, tau > 0.5 * total)
    h = maximum(where(stops, total - tau, tau), 0.0)
    runs = both(tau > -INSTANT, either(length <= 0.0, tau < total - INSTANT))
    s = where(has_rise, minimum(h / where(has_rise, rise, 1.0), 1.0), where(runs, 1.0, 0.0))
    path = top * (rise * s**3 * (1.0 - 0.5 * s) + maximum(h - rise, 0.0))
    gain = 6.0 * top / where(has_rise, rise, 1.0) * s * (1.0 - s)
    return where(stops, length - path, path), top * s**2 * (3.0 - 2.0 * s), where(stops, -gain, gain)


def accelerated_path(tau: float, rate: float, length: float, acceleration: float) -> Motion:
    """Path from 0: to ``rate`` >= 0 with ``acceleration`` (0 = at once), up to ``length`` (0 = without end)."""
    accelerates, ends = acceleration > 0.0, length > 0.0
    top = where(both(accelerates, ends), minimum(rate, sqrt(acceleration * length)), rate)
    rise = where(accelerates, top / where(accelerates, acceleration, 1.0), 0.0)
    total = length / maximum(top, TINY) + rise
    stops = both(ends, tau > 0.5 * total)
    h = maximum(where(stops, total - tau, tau), 0.0)
    runs = both(tau > -INSTANT, either(length <= 0.0, tau < total - INSTANT))
    ramp = minimum(h, rise)
    path = 0.5 * acceleration * ramp**2 + top * (h - ramp)
    velocity = where(accelerates, acceleration * ramp, where(runs, top, 0.0))
    instant = tau + INSTANT
    braking = where(ends, pulse(instant, total - rise, total, acceleration), 0.0)
    return where(stops, length - path, path), velocity, pulse(instant, 0.0, rise, acceleration) - braking


def pulse(t: float, start: float, end: float, height: float) -> float:
    """``height`` from ``start`` until before ``end`` (times in s), else 0."""
    return where(both(t >= start, t < end), height, 0.0)
