"""Fuzzy inference of the fuzzy sliding-mode controller: nine rules, exact centroid.

Inputs on -1 ... 1 with triangles N, Z, P (peaks -1, 0, 1, half-width 1); outputs on -1 ... 1 with triangles NB, NS, ZO,
PS, PB (peaks -1, -1/2, 0, 1/2, 1, half-width 1/2); minimum for "and" and for implication, maximum for aggregation.

Source: Shams & Safdari, Fuzzy sliding mode control of a ball screw driven stage, Motion Control (IntechOpen), 2010,
sec. 6 (rules 1-9, figs. 8-9); Mamdani & Assilian, Int. J. Man-Machine Studies 7(1), 1975. The closed form of the
centroid is derived below.
"""

from __future__ import annotations

from cosim.model import clip, maximum, minimum


def nine_rules(s: float, s_c: float) -> float:
    """Centroid of the nine rules for the scaled surfaces ``s`` and ``s_c``, clipped to -1 ... 1.

        s \\ s_c   N    Z    P
        N         ZO   PS   PB
        Z         NS   ZO   PS
        P         NB   NS   ZO

    Odd: nine_rules(-s, -s_c) = -nine_rules(s, s_c), exactly. Its magnitude is at most 5/6.
    """
    a, b = clip(s, -1.0, 1.0), clip(s_c, -1.0, 1.0)
    n, z, p = maximum(-a, 0.0), 1.0 - abs(a), maximum(a, 0.0)
    n_c, z_c, p_c = maximum(-b, 0.0), 1.0 - abs(b), maximum(b, 0.0)
    return centroid(
        minimum(p, n_c),
        maximum(minimum(p, z_c), minimum(z, n_c)),
        maximum(minimum(z, z_c), maximum(minimum(n, n_c), minimum(p, p_c))),
        maximum(minimum(n, z_c), minimum(z, p_c)),
        minimum(n, p_c),
    )


def centroid(nb: float, ns: float, zo: float, ps: float, pb: float) -> float:
    """Centroid over -1 ... 1 of the five output triangles cut off at the given heights (0 ... 1) and joined by maximum.

    Only neighbouring triangles overlap, so that the integral of the maximum is the sum over the triangles less the
    sum over the overlaps. In units of the half-width, a triangle cut off at h has the area h*(2 - h), half of it at
    an end of the universe, where its first moment about its peak is (1 - (1 - h)^3)/6; the overlap of neighbours is
    the trapezoid of height k = minimum of both heights and 1/2, whose area k*(1 - k) lies about its middle.
    At least one height must be above 0.
    """
    negative_end, positive_end = 0.5 * nb * (2.0 - nb), 0.5 * pb * (2.0 - pb)
    negative, middle, positive = ns * (2.0 - ns), zo * (2.0 - zo), ps * (2.0 - ps)
    outer_n, inner_n = _overlap(nb, ns), _overlap(ns, zo)
    inner_p, outer_p = _overlap(zo, ps), _overlap(ps, pb)
    area = (negative_end + positive_end) + (negative + positive) + middle - (outer_n + outer_p) - (inner_n + inner_p)
    ends = ((1.0 - pb) ** 3 - (1.0 - nb) ** 3) / 12.0
    moment = (
        (positive_end - negative_end)
        + 0.5 * (positive - negative)
        - 0.75 * (outer_p - outer_n)
        - 0.25 * (inner_p - inner_n)
        + ends
    )
    return moment / area


def _overlap(one: float, other: float) -> float:
    k = minimum(minimum(one, other), 0.5)
    return k * (1.0 - k)
