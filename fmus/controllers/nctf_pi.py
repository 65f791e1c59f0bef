"""Controller ``NctfPi``: nominal characteristic trajectory following with a PI compensator and anti-windup."""

from __future__ import annotations

from typing import ClassVar

from cosim.model import Controller, Experiment, Note, Record, Rule, both, maximum, parameter, round_to, variable, where
from fmus.physics.nct import REFERENCE_ERROR, REFERENCE_RATE, nct_rate
from fmus.physics.sampling import VelocitySource, saturate, velocity_estimate


class NctfPi(Controller):
    """NCTF controller: a PI compensator makes the stage follow a velocity that depends on the position error.

        error = position_ref - p,    p = position rounded to sensor_resolution
        rate_error = NCT(error) - v,    v = (p[k] - p[k-1])/T_s
        q = K_P*rate_error + integral[k-1]
        frozen = antiwindup and abs(q) > command_max and rate_error*integral[k-1] >= 0
        integral[k] = integral[k-1] + (0 if frozen else T_s*K_I*rate_error)
        command = limit(K_P*rate_error + integral[k], -command_max, command_max)

    NCT is piecewise linear through 128 nodes, odd-symmetric, its last rate held beyond the last node; to give fewer,
    repeat the last one. Its slope at the origin, alpha, sets the time constant of the end of a move. With
    compute_delay = 1 the command of a sample is applied one sample later. Made for point-to-point moves: the
    reference's velocity is not used, so a moving reference is followed with a lag.

    Valid limits of the table: the rate between two nodes is a straight line, so the error of the reaching phase depends
    on the places of the 128 nodes: between 150 nm and 2.2 um. Place the nodes densely where the moves are judged.

    Start values: K_P = 2*zeta*omega_n/(alpha*K), K_I = omega_n^2/(alpha*K) with omega_n*T_s = 0.25, alpha = 505 1/s,
    K = 32.3 mm/(A.s) and zeta at 40 % of the practical stability limit; the NCT of 6 A for 0.1 s.

    Source: Maeda & Sato, Practical control method for ultra-precision positioning using a ballscrew mechanism,
    Precision Engineering 32, 2008, eqs. (1)-(6), table 2.
    """

    T_s: float = parameter(2e-4, "s", "Sampling time", min=1e-9, nominal=1e-4, display_unit="ms")
    K_P: float = parameter(960.0, "A.s/m", "Proportional gain", min=0.0, nominal=1e3)
    K_I: float = parameter(95791.31287741778, "A/m", "Integral gain", min=0.0, nominal=1e5)
    nct_error: tuple[float, ...] = parameter(
        REFERENCE_ERROR, "m", "Position error of a node of the NCT", min=0.0, nominal=1e-3, name="nct.error"
    )
    nct_rate: tuple[float, ...] = parameter(
        REFERENCE_RATE, "m/s", "Velocity at a node of the NCT", min=0.0, nominal=1e-2, name="nct.rate"
    )
    command_max: float = parameter(6.0, "A", "Limit of the command, 0 for none", min=0.0)
    antiwindup: bool = parameter(True, "1", "Hold the integrator while the command is saturated")
    compute_delay: int = parameter(0, "1", "Samples from measurement to command", min=0, max=1)
    sensor_resolution: float = parameter(
        1.24e-9, "m", "Resolution of the position sensor, 0 for none", min=0.0, nominal=1e-9, display_unit="nm"
    )
    velocity_source: VelocitySource = parameter(VelocitySource.difference, "1", "Origin of the measured velocity")
    velocity_filter_time: float = parameter(
        0.0, "s", "Time constant of the velocity filter, 0 for none", min=0.0, nominal=1e-3, display_unit="ms"
    )

    experiment: ClassVar[Experiment] = Experiment(stop_time=1.0, step_size=2e-4)

    class State(Record):
        integral: float = variable(0.0, "A", "Integral part of the command")
        started: float = variable(0.0, "1", "1 after the first sample")
        position_last: float = variable(0.0, "m", "Position of the sample before")
        velocity_last: float = variable(0.0, "m/s", "Velocity estimate of the sample before")
        command_last: float = variable(0.0, "A", "Command computed at the sample before")
        largest_error: float = variable(0.0, "m", "Largest magnitude of error since the start", display_unit="um")

    class Input(Record):
        position_ref: float = variable(0.0, "m", "Position reference", display_unit="mm")
        position: float = variable(0.0, "m", "Measured position", display_unit="mm")
        velocity: float = variable(0.0, "m/s", "Measured velocity, used if velocity_source is input")

    class Output(Record):
        command: float = variable(0.0, "A", "Current command")
        error: float = variable(0.0, "m", "Position error", display_unit="um")
        nominal_rate: float = variable(0.0, "m/s", "Velocity of the NCT at this error", display_unit="mm/s")
        velocity_hat: float = variable(0.0, "m/s", "Velocity estimate", display_unit="mm/s")
        rate_error: float = variable(0.0, "m/s", "Velocity of the NCT less that of the stage", display_unit="mm/s")
        integral: float = variable(0.0, "A", "Integral part of the command")
        frozen: float = variable(0.0, "1", "1 while the integrator is held")

    def rules(self) -> tuple[Rule, ...]:
        ascending = self.nct_error[0] <= 0.0
        for i in range(len(self.nct_error) - 1):
            ascending = both(ascending, self.nct_error[i] <= self.nct_error[i + 1])
        text = "nct.error must ascend from 0. Sort the nodes; repeat the last one to give fewer."
        return (Rule(ascending, text), Rule(self.nct_rate[0] <= 0.0, "nct.rate[1] must be 0: the NCT ends at rest."))

    def notes(self, x: State) -> tuple[Note, ...]:
        last = len(self.nct_error)
        text = (
            "the NCT says nothing there, its last rate is held. Identify it with a longer move, or move less at once."
        )
        return (Note("largest_error", x.largest_error, f"nct.error[{last}]", self.nct_error[-1], "m", text),)

    def output(self, t: float, x: State, u: Input) -> Output:
        position = round_to(u.position, self.sensor_resolution)
        velocity = velocity_estimate(
            self.velocity_source,
            x.started,
            position,
            u.velocity,
            position_last=x.position_last,
            velocity_last=x.velocity_last,
            T_s=self.T_s,
            filter_time=self.velocity_filter_time,
        )
        error = u.position_ref - position
        rate = nct_rate(error, self.nct_error, self.nct_rate)
        rate_error = rate - velocity
        frozen = 0.0
        if self.antiwindup:
            unlimited = self.K_P * rate_error + x.integral
            saturated = both(self.command_max > 0.0, abs(unlimited) > self.command_max)
            frozen = where(both(saturated, rate_error * x.integral >= 0.0), 1.0, 0.0)
        integral = x.integral + (1.0 - frozen) * (self.T_s * self.K_I * rate_error)
        command = saturate(self.K_P * rate_error + integral, self.command_max)
        return self.Output(
            command=where(self.compute_delay > 0, x.command_last, command),
            error=error,
            nominal_rate=rate,
            velocity_hat=velocity,
            rate_error=rate_error,
            integral=integral,
            frozen=frozen,
        )

    def update(self, t: float, x: State, u: Input, y: Output) -> State:
        return self.State(
            integral=y.integral,
            started=1.0,
            position_last=round_to(u.position, self.sensor_resolution),
            velocity_last=y.velocity_hat,
            command_last=saturate(self.K_P * y.rate_error + y.integral, self.command_max),
            largest_error=maximum(x.largest_error, abs(y.error)),
        )
