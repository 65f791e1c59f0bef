"""Generalised Maxwell slip friction of one contact, as pure functions: elements that stick or slip, in parallel.

    friction = sum of F[i] + damping*(sum of der(F[i]))/(sum of k[i]) + sigma_2*speed
    sticking:  der(F[i]) = k[i]*speed                    until F[i] along the motion reaches alpha[i]*level
    slipping:  der(F[i]) = sign(speed)*C*(alpha[i] - abs(F[i])/level)            until the motion reverses

k[i] are stiffnesses, alpha[i] the parts of the level (sum 1), C the rate at which a slipping element follows its part
of the level. The force of a slipping element rises no faster than that of a sticking one: along the motion,
der(F[i]) <= k[i]*abs(speed). So an element never gives back more energy than it has stored. The law of the paper has
no such bound and feeds energy into a motion that comes to rest.

Whether an element slips is a discrete state, set after each integration step. An element that reaches its part slips at
once, within the step: its rate jumps, and the step size control of the integrator locates the jump. With a constant
level the law is rate-independent: it has return-point memory, and the virgin curve is the sum of its elements.

Valid for one contact at constant normal load. Passive where damping*abs(speed) <= level*alpha[i]*(sum of k)/k[i] for
each element.

Source: Al-Bender, Lampaert, Swevers, The generalized Maxwell-slip model: a novel model for friction simulation and
compensation, IEEE Trans. Automatic Control 50(11), 2005; the bound of the slipping rate is added here.
"""

from __future__ import annotations

from cosim.model import both, either, minimum, sign, where


def element_rate(F: float, slips: float, speed: float, level: float, *, k: float, alpha: float, C: float) -> float:
    """Time derivative of the torque or force ``F`` of one element; 0 where ``level`` is 0.

    ``level`` and ``F`` in N.m with ``speed`` in rad/s and ``k`` in N.m/rad, or N, m/s, N/m; ``C`` in N.m/s or N/s.
    ``slips`` is 1 for an element that slips, else 0, from ``slips_now``.
    """
    positive = where(level > 0.0, level, 1.0)
    along = F * sign(speed)
    sticking = k * abs(speed)
    slipping = minimum(sticking, C * (alpha - along / positive))
    # Until its flag is set, an element that has reached its part keeps its force. Its rate changes when the flag is
    # set, so that a solver that restarts after a change of rates restarts there.
    held = where(along < alpha * positive, sticking, 0.0)
    rate = where(both(slips > 0.5, along > 0.0), slipping, held)
    return where(level > 0.0, sign(speed) * rate, 0.0)


def slips_now(F: float, slips: float, speed: float, level: float, alpha: float) -> float:
    """1 if an element slips, else 0. It slips from reaching its part of the level until the motion reverses."""
    along = F * sign(speed)
    return where(both(along > 0.0, either(slips > 0.5, along >= alpha * level)), 1.0, 0.0)
