"""Controller ``NctfFuzzy``: nominal characteristic trajectory following with a Mamdani compensator."""

from __future__ import annotations

from typing import ClassVar

from cosim.model import Choice, Controller, Experiment, Record, Rule, both, clip, floor, parameter, variable
from fmus.physics.nct import (
    Defuzzification,
    centroid,
    grid_centroid,
    memberships,
    root_nct_rate,
    rule_heights,
    singleton_mean,
)
from fmus.physics.sampling import VelocitySource, measured_velocity, saturate


class Variant(Choice):
    """The velocity with which the compensator compares the NCT."""

    proposed = 1, "Error rate: the reference's velocity less the stage's"
    existing = 2, "Velocity of the stage"


class NctfFuzzy(Controller):
    """Fuzzy NCTF controller: nine rules on the distance from the NCT and its integral give the command.

        proposed: u_p = NCT(e) + (velocity_ref - v),   existing: u_p = NCT(e) - v,   e = position_ref - position
        u_i[k] = u_i[k-1] + T_s*u_p
        command = K_f*defuzzified(rules(u_p, u_i)), limited to +-command_max

    NCT, sets, rules and centroid: ``fmus.physics.nct``. The sets N and P have their feet at 0 and Z is narrow, so
    outside Z the controller acts almost as a relay of about u_r/2: it chatters, less with a shorter T_s. The
    integral is limited to +-u_i_max, where its sets end. The exact centroid depends on the weight w_z of the
    singleton Z; a grid of n points is its approximation with w_z = 2*u_r/(n - 1).

    Start values: variant proposed at 0.1 ms. For the existing variant set variant, defuzzification = singleton,
    K_f = 0.53, h_zero = h_max/2 and u_i_zero = u_i_max/100: its design is not in the paper, these values fit
    its tables and steps.

    Source: Purtojo, Rochardjo, Nugroho & Herianto, Improvement of fuzzy based practical controller for continuous
    motion control, 2015, table 1, figs. 5 and 7, eqs. (1)-(4).
    """

    variant: Variant = parameter(Variant.proposed, "1", "Quantity compared with the NCT")
    alpha: float = parameter(215.2, "1/s", "Slope of the NCT at the origin", min=1e-6, nominal=100.0)
    e_1: float = parameter(
        1e-4, "m", "Position error where the linear part of the NCT ends", min=1e-12, nominal=1e-4, display_unit="mm"
    )
    A: float = parameter(1.354e-3, "m", "Position error at the NCT's end", min=1e-12, nominal=1e-3, display_unit="mm")
    h_max: float = parameter(
        56.72e-3, "m/s", "Velocity at the NCT's end, range of u_p", min=1e-9, nominal=1e-2, display_unit="mm/s"
    )
    h_zero: float = parameter(
        0.2152e-3, "m/s", "Half width of set Z of u_p", min=1e-12, nominal=1e-4, display_unit="mm/s"
    )
    u_i_max: float = parameter(38.4e-3, "m", "Range of u_i", min=1e-12, nominal=1e-2, display_unit="mm")
    u_i_zero: float = parameter(0.8e-6, "m", "Half width of set Z of u_i", min=1e-15, nominal=1e-6, display_unit="um")
    u_r: float = parameter(10.0, "V", "Rated input: range of the output sets", min=1e-9)
    defuzzification: Defuzzification = parameter(Defuzzification.exact, "1", "How the output sets become a command")
    w_z: float = parameter(0.2, "V", "Weight of the output singleton Z in the exact centroid", min=0.0, nominal=0.1)
    grid_points: int = parameter(101, "1", "Points of the grid, odd", min=3, max=1_000_001)
    K_f: float = parameter(1.0, "1", "Gain on the defuzzified output", min=0.0)
    command_max: float = parameter(10.0, "V", "Limit of the command, 0 for none", min=0.0)
    velocity_source: VelocitySource = parameter(VelocitySource.input, "1", "Origin of the measured velocity")
    velocity_filter_time: float = parameter(
        0.0, "s", "Time constant of the velocity filter, 0 for none", min=0.0, nominal=1e-3, display_unit="ms"
    )

    experiment: ClassVar[Experiment] = Experiment(stop_time=2.0, step_size=1e-4)

    class State(Record):
        integral: float = variable(0.0, "m", "Integral of u_p")
        started: float = variable(0.0, "1", "1 after the first sample")
        position_last: float = variable(0.0, "m", "Position of the sample before")
        velocity_last: float = variable(0.0, "m/s", "Velocity estimate of the sample before")

    class Input(Record):
        position_ref: float = variable(0.0, "m", "Position reference", display_unit="mm")
        velocity_ref: float = variable(0.0, "m/s", "Velocity reference", display_unit="mm/s")
        position: float = variable(0.0, "m", "Measured position", display_unit="mm")
        velocity: float = variable(0.0, "m/s", "Measured velocity", display_unit="mm/s")

    class Output(Record):
        command: float = variable(0.0, "V", "Command")
        error: float = variable(0.0, "m", "Position error", display_unit="um")
        nominal_rate: float = variable(0.0, "m/s", "Velocity of the NCT at this error", display_unit="mm/s")
        u_p: float = variable(0.0, "m/s", "Distance from the NCT", display_unit="mm/s")
        u_i: float = variable(0.0, "m", "Integral of u_p", display_unit="mm")
        height_n: float = variable(0.0, "1", "Firing of output set N")
        height_z: float = variable(0.0, "1", "Firing of output set Z")
        height_p: float = variable(0.0, "1", "Firing of output set P")
        velocity_hat: float = variable(0.0, "m/s", "Velocity estimate", display_unit="mm/s")

    def rules(self) -> tuple[Rule, ...]:
        return (
            Rule(self.e_1 < self.A, "e_1 must be below A. The linear part ends before the NCT does."),
            Rule(self.alpha * self.e_1 <= self.h_max * 1.000001, "alpha*e_1 must not exceed h_max. Lower e_1."),
            Rule(
                both(floor(0.5 * self.grid_points) * 2.0 < self.grid_points, self.grid_points >= 3),
                "grid_points must be odd, so that the singleton at 0 is a point of the grid.",
            ),
        )

    def output(self, t: float, x: State, u: Input) -> Output:
        velocity = measured_velocity(self, x, u)
        error = u.position_ref - u.position
        rate = root_nct_rate(error, alpha=self.alpha, e_1=self.e_1, A=self.A, h_max=self.h_max)
        u_p = rate - velocity
        if self.variant is Variant.proposed:
            u_p = u_p + u.velocity_ref
        u_i = clip(x.integral + self.T_s * u_p, -self.u_i_max, self.u_i_max)
        heights = rule_heights(
            memberships(u_p, self.h_max, self.h_zero),
            memberships(u_i, self.u_i_max, self.u_i_zero),
        )
        if self.defuzzification is Defuzzification.exact:
            result = centroid(heights, self.u_r, self.w_z)
        elif self.defuzzification is Defuzzification.grid:
            result = grid_centroid(heights, self.u_r, self.grid_points)
        else:
            result = singleton_mean(heights, self.u_r)
        return self.Output(
            command=saturate(self.K_f * result, self.command_max),
            error=error,
            nominal_rate=rate,
            u_p=u_p,
            u_i=u_i,
            height_n=heights[0],
            height_z=heights[1],
            height_p=heights[2],
            velocity_hat=velocity,
        )

    def update(self, t: float, x: State, u: Input, y: Output) -> State:
        return self.State(integral=y.u_i, started=1.0, position_last=u.position, velocity_last=y.velocity_hat)
