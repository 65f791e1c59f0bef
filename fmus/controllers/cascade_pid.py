"""Controller ``CascadePid``: P position and PI velocity cascade of a feed drive with feed-forward."""

from __future__ import annotations

from typing import ClassVar

from cosim.model import Choice, Controller, Experiment, Record, parameter, variable, where
from fmus.physics.sampling import VelocitySource, saturate, velocity_estimate, winds_up


class FeedForward(Choice):
    """Where velocity and acceleration of the feed-forward come from."""

    lookahead = 1, "Differences of position_ref and position_next"
    input = 2, "Inputs velocity_ref and acceleration_ref"


class CascadePid(Controller):
    """Position P, velocity PI cascade with velocity and acceleration feed-forward, at one sampling time.

        error      = position_ref - position
        increment  = position_next - position_ref
        v_ref      = increment/T_s                     a_ref = (increment - increment_last)/T_s**2    (lookahead)
        v_command  = K_pos*error + k_vff*v_ref + velocity_pulse
        K_vel      = M*omega_v
        force      = K_vel*(v_command - velocity) + integral + k_aff*M*a_ref - disturbance_estimate
        command    = force*l_p, limited to command_max
        integral[k+1] = integral + K_vel/T_i*(v_command - velocity)*T_s, held while at the limit and driven on

    position is that of the table; with velocity_source difference the velocity is the filtered difference of
    motor_position (connect the plant's position there, too, if the plant is rigid). position_next is the
    reference one sample ahead; a_ref is 0 at the first sample. A positive command drives towards positive position;
    a positive disturbance estimate is a force that pushes there, so that friction at positive velocity is negative.

    For a start at speed set integral_start to the friction at that speed and connect velocity.

    Source: Feng et al., A novel time-varying friction compensation method for servomechanism, Mathematical Problems in
    Engineering 2015, 269391 (position and velocity cascade with feed-forward of a CNC; its gains are not legible and
    are common feed-drive values here).
    """

    T_s: float = parameter(2.5e-4, "s", "Sampling time", min=1e-9, nominal=1e-4, display_unit="ms")
    K_pos: float = parameter(40.0, "1/s", "Position gain", min=0.0, nominal=10.0)
    omega_v: float = parameter(250.0, "rad/s", "Bandwidth of the velocity loop", min=0.0, nominal=100.0)
    T_i: float = parameter(0.02, "s", "Integral time of the velocity loop", min=1e-6, nominal=1e-2, display_unit="ms")
    M: float = parameter(380.0, "kg", "Moving mass, that of the motor and screw included", min=0.0, nominal=100.0)
    k_vff: float = parameter(1.0, "1", "Share of velocity feed-forward", min=0.0)
    k_aff: float = parameter(1.0, "1", "Share of acceleration feed-forward", min=0.0)
    feedforward_source: FeedForward = parameter(FeedForward.lookahead, "1", "Where the feed-forward comes from")
    l_p: float = parameter(1.5915494309189535e-3, "m/rad", "Lead of the screw for one radian", min=1e-9, nominal=1e-3)
    integral_start: float = parameter(0.0, "N", "Integral part at the start", nominal=100.0)
    command_max: float = parameter(6.366197723675814, "N.m", "Limit of the command, 0 for none", min=0.0)
    velocity_source: VelocitySource = parameter(VelocitySource.difference, "1", "Where the velocity comes from")
    velocity_filter_time: float = parameter(
        5e-4, "s", "Time constant of the velocity filter, 0 for none", min=0.0, nominal=1e-3, display_unit="ms"
    )

    experiment: ClassVar[Experiment] = Experiment(stop_time=5.0, step_size=2.5e-4)

    class State(Record):
        integral: float = variable(0.0, "N", "Integral part of the force", nominal=100.0)
        started: float = variable(0.0, "1", "1 after the first sample")
        position_last: float = variable(0.0, "m", "Motor position of the sample before", nominal=1e-3)
        velocity_last: float = variable(0.0, "m/s", "Velocity estimate of the sample before", nominal=1e-2)
        increment_last: float = variable(0.0, "m", "Increment of the reference of the sample before", nominal=1e-5)

    class Input(Record):
        position_ref: float = variable(0.0, "m", "Position reference", display_unit="mm")
        position_next: float = variable(0.0, "m", "Position reference one sample ahead", display_unit="mm")
        velocity_ref: float = variable(0.0, "m/s", "Velocity reference", display_unit="mm/s")
        acceleration_ref: float = variable(0.0, "m/s2", "Acceleration reference")
        position: float = variable(0.0, "m", "Measured position of the table", display_unit="mm")
        motor_position: float = variable(0.0, "m", "Measured position of the motor, at the table", display_unit="mm")
        velocity: float = variable(0.0, "m/s", "Measured velocity", display_unit="mm/s")
        velocity_pulse: float = variable(0.0, "m/s", "Friction pulse added to the velocity command", nominal=1e-3)
        disturbance_estimate: float = variable(0.0, "N", "Estimated force towards positive position", nominal=100.0)

    class Output(Record):
        command: float = variable(0.0, "N.m", "Torque command")
        force: float = variable(0.0, "N", "Force at the table of this command", nominal=100.0)
        error: float = variable(0.0, "m", "Position error", nominal=1e-6, display_unit="um")
        velocity_command: float = variable(0.0, "m/s", "Command of the velocity loop", display_unit="mm/s")
        velocity_estimate: float = variable(0.0, "m/s", "Measured velocity used", display_unit="mm/s")

    def initial(self) -> State:
        return self.State(integral=self.integral_start)

    def output(self, t: float, x: State, u: Input) -> Output:
        velocity = velocity_estimate(
            self.velocity_source,
            x.started,
            u.motor_position,
            u.velocity,
            position_last=x.position_last,
            velocity_last=x.velocity_last,
            T_s=self.T_s,
            filter_time=self.velocity_filter_time,
        )
        error = u.position_ref - u.position
        increment = u.position_next - u.position_ref
        if self.feedforward_source is FeedForward.lookahead:
            v_ref = increment / self.T_s
            a_ref = where(x.started > 0.5, (increment - x.increment_last) / self.T_s**2, 0.0)
        else:
            v_ref, a_ref = u.velocity_ref, u.acceleration_ref
        v_command = self.K_pos * error + self.k_vff * v_ref + u.velocity_pulse
        proportional = self.M * self.omega_v * (v_command - velocity)
        force = proportional + x.integral + self.k_aff * self.M * a_ref - u.disturbance_estimate
        command = saturate(force * self.l_p, self.command_max)
        return self.Output(
            command=command,
            force=command / self.l_p,
            error=error,
            velocity_command=v_command,
            velocity_estimate=velocity,
        )

    def update(self, t: float, x: State, u: Input, y: Output) -> State:
        difference = y.velocity_command - y.velocity_estimate
        held = winds_up(y.command, self.command_max, difference)
        return self.State(
            integral=x.integral + where(held, 0.0, self.M * self.omega_v / self.T_i * difference * self.T_s),
            started=1.0,
            position_last=u.motor_position,
            velocity_last=y.velocity_estimate,
            increment_last=u.position_next - u.position_ref,
        )
