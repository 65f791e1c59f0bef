"""Nominal characteristic trajectories (NCT) and the Mamdani compensator of NCTF control, as pure functions.

An NCT gives the velocity a stage should have at a distance from its target: odd-symmetric, from (0, 0) to the last
node, its last rate held beyond.

The compensator has three sets an input, nine rules and three output sets::

    P(x) = max(0, x)/x_max,  N(x) = P(-x),  Z(x) = max(0, 1 - abs(x)/x_zero),  x limited to +-x_max
    rule table: the sign of the sum of the signs (N,N -> N; N,Z -> N; N,P -> Z ...), min as AND, max over the rules
    P of the output: the s-shape of 0 ... u_r, 2*(u/u_r)^2 up to u_r/2 and 1 - 2*(1 - u/u_r)^2 above; N its mirror
    image; Z a singleton at 0

Its centroid is exact: the clipped sets N and P do not overlap, so areas and moments are polynomials in
t = sqrt(h/2) or s = sqrt((1 - h)/2) of the height h. A singleton has no area: the centroid over a continuum
ignores it, over a grid of n points it counts with a weight of one point, 2*u_r/(n - 1). ``w_z`` is that weight
in volt, so it is part of the controller, not of the numerics.

Source: Maeda & Sato, Practical control method for ultra-precision positioning using a ballscrew mechanism,
Precision Engineering 32, 2008 (NCT); Purtojo, Rochardjo, Nugroho & Herianto, Improvement of fuzzy based practical
controller for continuous motion control, 2015, table 1, fig. 5, eqs. (1)-(2) (compensator).
"""

from __future__ import annotations

from cosim.model import Choice, clip, floor, interpolate, maximum, minimum, sign, sqrt, where

REFERENCE_ERROR = (
    0,
    6.425839269e-07,
    6.941304264e-07,
    7.498118591e-07,
    8.099599192e-07,
    8.749329085e-07,
    9.451178708e-07,
    1.020932898e-06,
    1.10282962e-06,
    1.191295895e-06,
    1.286858717e-06,
    1.390087353e-06,
    1.501596735e-06,
    1.622051126e-06,
    1.752168071e-06,
    1.892722677e-06,
    2.044552227e-06,
    2.20856117e-06,
    2.385726506e-06,
    2.577103608e-06,
    2.783832511e-06,
    3.007144696e-06,
    3.248370435e-06,
    3.508946708e-06,
    3.790425769e-06,
    4.094484385e-06,
    4.422933835e-06,
    4.777730691e-06,
    5.160988476e-06,
    5.574990257e-06,
    6.02220224e-06,
    6.505288467e-06,
    7.027126682e-06,
    7.590825471e-06,
    8.19974279e-06,
    8.857505955e-06,
    9.56803326e-06,
    1.033555732e-05,
    1.116465026e-05,
    1.2060251e-05,
    1.302769462e-05,
    1.407274419e-05,
    1.520162506e-05,
    1.642106197e-05,
    1.77383191e-05,
    1.916124336e-05,
    2.069831109e-05,
    2.235867862e-05,
    2.415223673e-05,
    2.608966966e-05,
    2.818251868e-05,
    3.04432509e-05,
    3.288533348e-05,
    3.552331392e-05,
    3.837290664e-05,
    4.145108668e-05,
    4.477619073e-05,
    4.836802644e-05,
    5.224799035e-05,
    5.643919542e-05,
    6.096660863e-05,
    6.585719977e-05,
    7.114010209e-05,
    7.684678581e-05,
    8.301124564e-05,
    8.967020326e-05,
    9.686332605e-05,
    0.0001046334634,
    0.0001130269021,
    0.0001220936417,
    0.0001318876928,
    0.0001424673986,
    0.0001538957824,
    0.0001662409229,
    0.0001795763601,
    0.0001939815333,
    0.000209542254,
    0.0002263512174,
    0.0002445085544,
    0.0002641224283,
    0.0002853096788,
    0.0003081965183,
    0.0003329192837,
    0.0003596252484,
    0.0003884734999,
    0.000419635887,
    0.000453298044,
    0.0004896604963,
    0.0005289398549,
    0.000571370107,
    0.0006172040093,
    0.0006667145943,
    0.0007201967965,
    0.0007779692092,
    0.0008403759825,
    0.0009077888734,
    0.0009806094604,
    0.001059271535,
    0.001144243688,
    0.001236032098,
    0.001335183548,
    0.001479866719,
    0.00164022805,
    0.001817966457,
    0.002014964954,
    0.002233310604,
    0.002475316628,
    0.002743546911,
    0.003040843166,
    0.00337035504,
    0.003735573483,
    0.00414036773,
    0.004589026295,
    0.005086302404,
    0.005637464351,
    0.006411148663,
    0.007291013233,
    0.008291630215,
    0.009429571641,
    0.01072368389,
    0.0121953998,
    0.01386909367,
    0.0161834283,
    0.01660507861,
    0.01703771478,
    0.01748162305,
    0.0179370971,
    0.01840443828,
)
"""Errors [m] of the reference NCT: 6 A for 0.1 s, linear with alpha = 505 1/s up to 0.643 um.

The lines through its 128 nodes are within 2.4e-4 of the identified points (tests/references/nctf/nct_table.py).
"""

REFERENCE_RATE = (
    0,
    0.0003244104359,
    0.0003372651663,
    0.0003506330726,
    0.0003645350022,
    0.0003789926025,
    0.0003940283933,
    0.0004096659376,
    0.0004259297057,
    0.000442845228,
    0.0004604391155,
    0.000478739098,
    0.0004977740791,
    0.0005175742062,
    0.0005381708444,
    0.0005595968061,
    0.0005818862525,
    0.0006050747739,
    0.0006291995727,
    0.0006542993915,
    0.0006804147375,
    0.0007075877728,
    0.0007358626122,
    0.0007652852042,
    0.0007959036063,
    0.0008277679282,
    0.0008609305629,
    0.0008954461892,
    0.0009313719501,
    0.0009687675571,
    0.001007695411,
    0.001048220735,
    0.00109041172,
    0.001134339684,
    0.001180079197,
    0.00122770832,
    0.001277308671,
    0.001328965722,
    0.001382768939,
    0.001438811984,
    0.001497192995,
    0.001558014761,
    0.001621385011,
    0.001687416636,
    0.001756228049,
    0.001827943419,
    0.001902692998,
    0.001980613491,
    0.002061848399,
    0.002146548409,
    0.002234871783,
    0.002326984831,
    0.002423062349,
    0.002523288125,
    0.002627855461,
    0.002736967747,
    0.002850839064,
    0.002969694819,
    0.003093772438,
    0.003223322106,
    0.003358607553,
    0.003499906894,
    0.003647513517,
    0.003801737088,
    0.003962904544,
    0.004131361229,
    0.004307472062,
    0.004491622839,
    0.004684221589,
    0.004885700035,
    0.005096515192,
    0.005317151058,
    0.005548120434,
    0.00578996689,
    0.006043266873,
    0.006308631985,
    0.006586711422,
    0.006878194609,
    0.007183814029,
    0.007504348302,
    0.007840625454,
    0.008193526482,
    0.008563989187,
    0.008953012301,
    0.009361659961,
    0.009791066508,
    0.01024244171,
    0.01071707635,
    0.01121634833,
    0.01174172919,
    0.01229479122,
    0.01287721511,
    0.01349079824,
    0.01413746362,
    0.01481926958,
    0.01553842026,
    0.01629727692,
    0.01709837023,
    0.01794441351,
    0.0188383171,
    0.01978320389,
    0.02112818951,
    0.02257843988,
    0.02414346209,
    0.02583372412,
    0.02766075879,
    0.02963727938,
    0.03177730805,
    0.03409631859,
    0.03661139496,
    0.03934140747,
    0.0423072085,
    0.04553184979,
    0.04904082379,
    0.05286233166,
    0.05812657216,
    0.06399653438,
    0.07054988788,
    0.07787488093,
    0.0860718103,
    0.0952546879,
    0.1055529168,
    0.1196417619,
    0.1221445969,
    0.1244743386,
    0.127195272,
    0.1313857726,
    0.1344729824,
)
"""Rates [m/s] of the reference NCT."""


def nct_rate(error: float, errors: tuple[float, ...], rates: tuple[float, ...]) -> float:
    """Nominal velocity at ``error`` [m] on the NCT through the nodes: odd-symmetric, held beyond the last node.

    ``errors`` ascend from 0. Above 0 the first rate should be 0, or the NCT jumps there.
    """
    return sign(error) * interpolate(abs(error), errors, rates)


def root_nct_rate(error: float, *, alpha: float, e_1: float, A: float, h_max: float) -> float:
    """Nominal velocity at ``error`` on an NCT of a line of slope ``alpha`` and the parabola of constant deceleration.

        alpha*e                                                     for e <= e_1
        sqrt(v_1^2 + (h_max^2 - v_1^2)*(e - e_1)/(A - e_1))          for e_1 < e < A,    v_1 = alpha*e_1
        h_max                                                       for e >= A

    Odd-symmetric. Needs 0 < e_1 < A and 0 < alpha*e_1 <= h_max; alpha*e_1 = h_max is a line with saturation.
    """
    size = abs(error)
    v_1 = alpha * e_1
    part = clip((size - e_1) / (A - e_1), 0.0, 1.0)
    parabola = sqrt(v_1 * v_1 + (h_max * h_max - v_1 * v_1) * part)
    return sign(error) * where(size <= e_1, alpha * size, parabola)


class Defuzzification(Choice):
    """The method that makes a command of the output sets."""

    exact = 1, "Exact centroid of z- and s-shape, singleton weight w_z"
    grid = 2, "Centroid over a grid of grid_points points"
    singleton = 3, "Weighted mean of singletons at -u_r, 0 and u_r"


def memberships(x: float, x_max: float, x_zero: float) -> tuple[float, float, float]:
    """Membership of ``x`` in N, Z, P."""
    inside = clip(x, -x_max, x_max)
    return (
        maximum(0.0, -inside) / x_max,
        maximum(0.0, 1.0 - abs(inside) / x_zero),
        maximum(0.0, inside) / x_max,
    )


def rule_heights(
    proportional: tuple[float, float, float], integral: tuple[float, float, float]
) -> tuple[float, float, float]:
    """Heights at which the nine rules clip the output sets N, Z, P, from the memberships of both inputs."""
    n_1, z_1, p_1 = proportional
    n_2, z_2, p_2 = integral
    return (
        maximum(minimum(n_1, n_2), maximum(minimum(n_1, z_2), minimum(z_1, n_2))),
        maximum(minimum(z_1, z_2), maximum(minimum(n_1, p_2), minimum(p_1, n_2))),
        maximum(minimum(p_1, p_2), maximum(minimum(p_1, z_2), minimum(z_1, p_2))),
    )


def _root(x: float) -> float:
    """sqrt(x) for x >= 0, with a finite derivative at 0."""
    return where(x > 0.0, sqrt(where(x > 0.0, x, 1.0)), 0.0)


def clipped_set(height: float) -> tuple[float, float]:
    """Area and first moment of the s-shape over 0 ... 1 clipped at ``height``."""
    t = _root(0.5 * minimum(height, 0.5))
    s = _root(0.5 * (1.0 - maximum(height, 0.5)))
    low_area = t**3 * 2.0 / 3.0 + height * (1.0 - t)
    low_moment = 0.5 * t**4 + 0.5 * height * (1.0 - t * t)
    high_area = 0.5 - (s - 2.0 * s**3 / 3.0) + height * s
    high_moment = 17.0 / 48.0 - (s - 0.5 * s * s - 2.0 * s**3 / 3.0 + 0.5 * s**4) + 0.5 * height * s * (2.0 - s)
    low = height <= 0.5
    return where(low, low_area, high_area), where(low, low_moment, high_moment)


def centroid(heights: tuple[float, float, float], u_r: float, w_z: float) -> float:
    """Exact centroid of the output sets clipped at ``heights`` (N, Z, P); ``w_z`` is the singleton's weight.

    0 where nothing fires. ``u_r`` and ``w_z`` in the unit of the result.
    """
    h_n, h_z, h_p = heights
    area_n, moment_n = clipped_set(h_n)
    area_p, moment_p = clipped_set(h_p)
    weight = u_r * (area_n + area_p) + w_z * h_z
    return where(weight > 0.0, u_r * u_r * (moment_p - moment_n) / where(weight > 0.0, weight, 1.0), 0.0)


def _sum_1(n: float) -> float:
    """1 + 2 + ... + n."""
    return 0.5 * n * (n + 1.0)


def _sum_2(n: float) -> float:
    """1 + 4 + ... + n^2."""
    return n * (n + 1.0) * (2.0 * n + 1.0) / 6.0


def clipped_set_sums(height: float, half: float) -> tuple[float, float]:
    """Sums over j = 1 ... half of m_j and of j*m_j/half, m_j the s-shape at j/half clipped at ``height``.

    The sums are in closed form. From 1 up to j = k the shape is 2*(j/half)^2. From ``half`` down to half - i it is
    1 - 2*(i/half)^2. Between these parts it is clipped.
    """
    middle = floor(0.5 * half)
    k = minimum(middle, floor(half * _root(0.5 * minimum(height, 0.5))))
    # Points clipped at the upper end: i = half - j from 0 to top, where 1 - 2*(i/half)^2 is above the height.
    top = minimum(half - middle - 1.0, floor(half * _root(0.5 * (1.0 - maximum(height, 0.5)))))
    top = where(height <= 0.5, half - k - 1.0, top)
    n = half - top - 1.0 - k
    squares = _sum_2(half - k - 1.0) - _sum_2(top)
    # Between: n points of 1 - 2*(i/half)^2 with i from top + 1 to half - k - 1.
    ones = _sum_1(half - k - 1.0) - _sum_1(top)
    cubes = _sum_1(half - k - 1.0) ** 2 - _sum_1(top) ** 2
    q = half * half
    total = 2.0 * _sum_2(k) / q + (n - 2.0 * squares / q) + height * (top + 1.0)
    first = (
        2.0 * _sum_1(k) ** 2 / q
        + (half * n - ones - 2.0 * (half * squares - cubes) / q)
        + height * (half * (top + 1.0) - _sum_1(top))
    )
    return total, first / half


def grid_centroid(heights: tuple[float, float, float], u_r: float, points: float) -> float:
    """Centroid over ``points`` (odd, at least 3) equally spaced points of -u_r ... u_r, both ends included.

    The sums are in closed form, so the cost does not depend on ``points``. 0 where nothing fires.
    """
    half = 0.5 * (points - 1.0)
    h_n, h_z, h_p = heights
    total_n, moment_n = clipped_set_sums(h_n, half)
    total_p, moment_p = clipped_set_sums(h_p, half)
    weight = total_n + total_p + h_z
    return where(weight > 0.0, u_r * (moment_p - moment_n) / where(weight > 0.0, weight, 1.0), 0.0)


def singleton_mean(heights: tuple[float, float, float], u_r: float) -> float:
    """Weighted mean of singletons at -u_r, 0 and u_r; 0 where nothing fires."""
    h_n, h_z, h_p = heights
    weight = h_n + h_z + h_p
    return where(weight > 0.0, u_r * (h_p - h_n) / where(weight > 0.0, weight, 1.0), 0.0)
