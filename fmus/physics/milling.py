"""Cutting force of a two-flute end mill with run-out: closed form of the uncut chip thickness, with its memory.

Each tooth leaves a surface; the next tooth cuts the material that the feed has moved since then. At an angle ``phi`` of
the tool the advance of one passage is ``a = feed*sin(phi)``. Because of the run-out ``r``, tooth 1 runs outside the
mean radius by ``r`` and tooth 2 inside by ``r``. A tooth with a chip below ``h_min`` ploughs: it presses, and the
surface stays. With n passages since the last cut, the chip is

    h = max(0, n*a + own offset - offset of the tooth that cut last),   cut where h >= h_min

This sequence is periodic. The tooth that cut last, and n, follow from the number of passages alone, so no memory is
kept. With h_min = 0 it is the known form h = max(0, min(a + offset - other offset, 2*a)).

Forces of a tooth of axial depth w at the angle phi, on the tool:

    tangential  f_t = K_t*(h/h_0)**-p_t*w*h      normal  f_n = K_n*(h/h_0)**-p_n*w*h        (h >= h_min)
    tangential  f_t = K_t*(h_min/h_0)**-p_t*w*h  normal  f_n = q*K_n*(h_min/h_0)**-p_n*w*h  (h < h_min: ploughing)
    force_x = -f_t*cos(phi) - f_n*sin(phi)       force_y = f_t*sin(phi) - f_n*cos(phi)

x is the feed direction, y points across it; the tooth enters at entry_angle and leaves at exit_angle, 0 and pi for
a slot. The work starts with the surface that tooth 1 would have left one revolution before. This start has no effect
after one revolution wherever 2*a >= h_min and 2*r >= h_min - a. With a small run-out each tooth could do all the
cutting alone; then the start decides that tooth 1 does. Where 2*a < h_min the teeth cut in some revolutions only.

The law is exact for rigid tool and table: the vibration of the axis does not enter the chip (no regenerative
chatter), the path of a tooth is a circle (feed much smaller than the radius), ploughing removes nothing.
With h_min = 0 the force is continuous in time, with kinks where teeth enter, leave or lose contact. With
h_min > 0 it jumps where cutting turns into ploughing.

Source: Rubio, Ibeas & Luo, P-PI and super twisting sliding mode control schemes comparison for high-precision CNC
machining, 2015 (spindle, depth, number of teeth); the cut surface, minimum chip thickness and size effect as in
Martellotti 1941 and Vogler, DeVor & Kapoor, J. Manuf. Sci. Eng. 126 (2004) 695-705; the closed form is derived here.
"""

from __future__ import annotations

from dataclasses import dataclass

from cosim.model import Choice, Component, Rule, both, cos, floor, maximum, parameter, sin, where

PI = 3.141592653589793
TINY = 1e-15
"""Advance in m below which a tooth has no chip; 1e-9 of a micro-mill's feed per tooth."""


class Side(Choice):
    """Which of the two bodies the force acts on."""

    tool = 1, "Force on the tool"
    table = 2, "Force on the table: the opposite"


@dataclass(frozen=True, kw_only=True)
class Forces:
    """Forces on the tool in N, and the uncut chip thickness in front of each of the two teeth in m."""

    x: float
    y: float
    uncut_thickness: tuple[float, float]


def _passages(distance: float, advance: float) -> float:
    """Number of revolutions, at least 1, after which an advance of ``2*advance`` each has reached ``distance``."""
    return maximum(1.0, -floor(-distance / (2.0 * advance)))


def _cycle(passage: float, period: float) -> float:
    """Number of the passage within its period, 1 ... ``period``."""
    return passage - period * floor((passage - 1.0) / period)


def _is_odd(number: float) -> bool:
    return number - 2.0 * floor(0.5 * number) > 0.5


def uncut_thickness(advance: float, passage: float, run_out: float, h_min: float) -> float:
    """Uncut chip thickness in m in front of a tooth at a given angle of the tool.

    ``advance`` is the feed in m between two passages at this angle. ``passage`` counts the passages since the cut of
    tooth 1 that left the first surface: it is odd for tooth 2 and even for tooth 1. ``run_out`` and ``h_min`` are in m.
    """
    a = maximum(advance, TINY)
    offset = 2.0 * run_out
    # Revolutions until the tooth that cut last cuts again, unless the other tooth cuts before.
    again = _passages(h_min, a)
    first_after_one = _passages(h_min + offset + a, a)
    first_after_two = _passages(h_min - offset + a, a)
    two_takes_over = first_after_one <= again
    one_takes_over = first_after_two <= again
    # Passages from a cut of tooth 1 to the next cut of tooth 2, and back; together they are one cycle.
    until_two = 2.0 * first_after_one - 1.0
    until_one = 2.0 * first_after_two - 1.0
    alternating = _cycle(passage, until_two + until_one)
    behind = where(one_takes_over, alternating, passage)
    last_cut_by_two = both(two_takes_over, behind > until_two)
    since_one = where(two_takes_over, behind, _cycle(passage, 2.0 * again))
    since_two = where(one_takes_over, behind - until_two, _cycle(passage - until_two, 2.0 * again))
    after_one = since_one * a - where(_is_odd(since_one), offset, 0.0)
    after_two = since_two * a + where(_is_odd(since_two), offset, 0.0)
    return where(advance > TINY, maximum(0.0, where(last_cut_by_two, after_two, after_one)), 0.0)


class Milling(Component):
    """Base of the components with a cut: tool, material and the forces between them; not used itself."""

    start_time: float = parameter(0.0, "s", "Time at which cutting begins")
    feed_per_tooth: float = parameter(
        1e-6, "m", "Feed per tooth, 0 for no cutting", min=0.0, nominal=1e-6, display_unit="um"
    )
    axial_depth: float = parameter(50e-6, "m", "Axial depth of cut", min=0.0, nominal=1e-5, display_unit="um")
    spindle_speed: float = parameter(192.0, "Hz", "Revolutions of the spindle in a second", min=0.0, nominal=100.0)
    run_out: float = parameter(
        0.2e-6, "m", "Run-out: tooth 1 outside, tooth 2 inside", min=0.0, nominal=1e-7, display_unit="um"
    )
    h_min: float = parameter(
        0.0, "m", "Minimum chip thickness, ploughing below", min=0.0, nominal=1e-7, display_unit="um"
    )
    K_t: float = parameter(3.5e9, "Pa", "Specific tangential force at h_0", min=0.0, nominal=1e9, display_unit="MPa")
    K_n: float = parameter(2.1e9, "Pa", "Specific normal force at h_0", min=0.0, nominal=1e9, display_unit="MPa")
    h_0: float = parameter(
        1e-6, "m", "Chip thickness of the specific forces", min=1e-9, nominal=1e-6, display_unit="um"
    )
    p_t: float = parameter(0.25, "1", "Exponent of the size effect, tangential", min=0.0, max=0.9)
    p_n: float = parameter(0.35, "1", "Exponent of the size effect, normal", min=0.0, max=0.9)
    ploughing_factor: float = parameter(1.5, "1", "Normal force of ploughing over that of cutting", min=0.0)
    entry_angle: float = parameter(0.0, "rad", "Angle at which a tooth enters", min=0.0, max=PI, display_unit="deg")
    exit_angle: float = parameter(PI, "rad", "Angle at which a tooth leaves", min=0.0, max=PI, display_unit="deg")

    def rules(self) -> tuple[Rule, ...]:
        return (Rule(self.exit_angle >= self.entry_angle, "exit_angle must not be below entry_angle. Exchange them."),)

    def forces_on_tool(self, t: float) -> Forces:
        """Forces on the tool at the time ``t`` in s; 0 before ``start_time``, at which tooth 1 enters."""
        since = t - self.start_time
        revolutions = maximum(0.0, self.spindle_speed * since)
        revolution = floor(revolutions)
        angle = 2.0 * PI * (revolutions - revolution)
        began = since >= 0.0
        one = self._tooth(angle, 2.0 * revolution + 2.0, began)
        # Tooth 2 comes half a revolution later: it finds the surface of tooth 1 of this revolution.
        ahead = angle >= PI
        two = self._tooth(where(ahead, angle - PI, angle + PI), 2.0 * revolution + 3.0, began)
        return Forces(x=one[0] + two[0], y=one[1] + two[1], uncut_thickness=(one[2], two[2]))

    def _tooth(self, angle: float, passage: float, began: bool) -> tuple[float, float, float]:
        """Force in x and y [N] and chip thickness [m] of one tooth at its ``angle`` of 0 ... 2 pi."""
        engaged = both(began, both(angle >= self.entry_angle, angle <= self.exit_angle))
        thickness = uncut_thickness(self.feed_per_tooth * sin(angle), passage, self.run_out, self.h_min)
        h = where(engaged, thickness, 0.0)
        # Below h_min the specific force has its value at h_min; TINY keeps the power finite without a chip.
        ratio = maximum(maximum(h, self.h_min), TINY) / self.h_0
        area = self.axial_depth * h
        ploughing = where(h < self.h_min, self.ploughing_factor, 1.0)
        tangential = self.K_t * ratio**-self.p_t * area
        normal = ploughing * self.K_n * ratio**-self.p_n * area
        x = -tangential * cos(angle) - normal * sin(angle)
        y = tangential * sin(angle) - normal * cos(angle)
        return x, y, h
