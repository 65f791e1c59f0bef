"""LuGre friction of one contact, as pure functions; in rad and N.m at a screw, or in m and N at a guide.

    level     = F_C + (F_S - F_C)*exp(-(speed/v_s)^2)              (sigma_0*g(speed))
    der(z)    = speed - sigma_0*abs(speed)*z/level
    friction  = sigma_0*z + sigma_1*exp(-(speed/v_d)^2)*der(z) + sigma_2*speed

``z`` is the mean deflection of the bristles. Friction opposes motion: it is positive for positive speed and is
subtracted from the driving force. Without Stribeck effect F_S equals F_C, and v_s is any positive number; F_S below
F_C is friction that rises with speed. v_d = 0 stands for a constant sigma_1. F_C and F_S are both positive or both
0: otherwise the level falls to 0 in sliding or at standstill, and der(z) grows without bound (``contact_rules``). A
level of 0 means that there is no contact: z stays where it is. It must not count then (``counted``): only
sigma_2*speed is left.
Every expression and its derivatives are finite for finite arguments.

Valid for one contact at constant normal load. The model is surely passive where sigma_1 < 4*level/abs(speed). With
constant sigma_1 this ends at some speed; with v_d it holds at all speeds if sigma_1*v_d < 9.32*min(F_C, F_S)
(abs(speed)*exp(-(speed/v_d)^2) is at most v_d/sqrt(2*e)). The model drifts under a load that oscillates below
break-away, and it does not close minor loops: see docs/physics.md.

Source: Canudas de Wit, Olsson, Astrom, Lischinsky, A new model for control of systems with friction,
IEEE Trans. Automatic Control 40(3), 1995, eqs. (1)-(4); Olsson, Control systems with friction, thesis, Lund, 1996
(velocity-dependent damping and passivity); Shams & Safdari, Fuzzy sliding mode control of a ball
screw driven stage, Motion Control (IntechOpen), 2010, sec. 2.3 and eq. (3).
"""

from __future__ import annotations

from cosim.model import Note, Rule, both, either, exp, minimum, sign, where

ALWAYS = 1e100
"""A speed that no contact reaches."""

SMALLEST_RATIO = 1e-6
"""Smallest of F_C and F_S as a share of the largest: with less, the level all but vanishes in sliding or standstill."""

SMALLEST_DEFLECTION = 1e-15
"""Smallest deflection of slipping bristles in rad or m: the integrator cannot resolve less beside an angle of 1 rad."""

SMALLEST_SPEED = 1e-12
"""Smallest v_d above 0, in rad/s or m/s, as that of v_s."""

BRISTLE_NOMINAL = 1e-5
"""Order of magnitude of a bristle's deflection in rad: declare a state ``z`` with this nominal value."""


def friction_level(speed: float, F_C: float, F_S: float, v_s: float) -> float:
    """Magnitude of the friction of steady sliding without its viscous part, in the unit of ``F_C``.

    F_C is the friction of sliding at high speed, F_S at the limit of standstill; v_s > 0 is the Stribeck speed.
    """
    # e**-700 is still a normal number: the C library's exp is slow where it underflows
    return F_C + (F_S - F_C) * exp(-minimum((speed / v_s) ** 2, 700.0))


def bristle_rate(z: float, speed: float, level: float, sigma_0: float) -> float:
    """Time derivative of the deflection ``z``; 0 if ``level`` is 0. ``friction_level`` gives ``level``."""
    rate = speed - sigma_0 * abs(speed) * z / where(level > 0.0, level, 1.0)
    return where(level > 0.0, rate, 0.0)


def bristle_damping(speed: float, sigma_1: float, v_d: float) -> float:
    """Damping of the bristles at ``speed``: sigma_1*exp(-(speed/v_d)^2), or sigma_1 if ``v_d`` is 0."""
    # With v_d = 0 the exponent is 0, where exp is exactly 1 and costs next to nothing.
    per_speed = where(v_d > 0.0, 1.0 / where(v_d > 0.0, v_d, 1.0), 0.0)
    return sigma_1 * exp(-((speed * per_speed) ** 2))


def passive_speed(bound: float, sigma_1: float, v_d: float) -> float:
    """Speed up to which damping times speed stays within ``bound``; ALWAYS if it does at all speeds.

    The damping is sigma_1*exp(-(speed/v_d)^2), or sigma_1 if ``v_d`` is 0. ``bound`` is in the unit of the friction:
    4*level for LuGre friction, 0 without contact.
    abs(speed)*exp(-(speed/v_d)^2) is at most v_d/sqrt(2*e) = v_d/2.3316.
    """
    constant = where(both(sigma_1 > 0.0, bound > 0.0), bound / where(sigma_1 > 0.0, sigma_1, 1.0), ALWAYS)
    return where(both(v_d > 0.0, v_d <= 2.3316 * constant), ALWAYS, constant)


def passivity_note(
    largest: float, limit: float, unit: str, *, name: str = "largest_speed", v_d: str = "v_d", bound: str
) -> Note:
    """Note for a run whose ``largest`` speed exceeded ``limit``, a ``passive_speed``; ``bound`` is its formula."""
    text = (
        "beyond it friction is not surely passive, a slow break-away may feed energy into the motion. "
        f"{v_d} of at most 2.33 times that speed cures it."
    )
    return Note(name, largest, bound, limit, unit, text)


def rising_note(F_C: float, F_S: float, unit: str, C: str = "F_C", S: str = "F_S") -> Note:
    """Note for friction that rises with speed, which is legal; ``C`` and ``S`` are the names of F_C and F_S."""
    text = f"friction rises with speed, against Stribeck's effect. Exchange {C} and {S} unless this is meant."
    return Note(C, F_C, S, F_S, unit, text)


def rising_notes(
    F_C: float, F_S: float, F_C_negative: float, F_S_negative: float, *, unit: str, prefix: str = ""
) -> tuple[Note, ...]:
    """``rising_note`` for both directions of a contact; ``prefix`` stands before its names in the text."""
    # The note for negative speed is given only if the factors cause the rise; else one note tells of both directions.
    negative = where(F_C > F_S, 0.0, F_C * F_C_negative)
    C, S = f"{prefix}F_C", f"{prefix}F_S"
    return (
        rising_note(F_C, F_S, unit, C, S),
        rising_note(negative, F_S * F_S_negative, unit, f"{C}*F_C_negative", f"{S}*F_S_negative"),
    )


def contact_rules(
    F_C: float,
    F_S: float,
    F_C_negative: float,
    F_S_negative: float,
    *,
    load: float,
    compliance: float,
    prefix: str = "",
) -> tuple[Rule, ...]:
    """Rules of a contact in each direction: F_C and F_S are both positive, or both 0 for no dry friction.

    ``load`` is the smallest factor on both, ``compliance`` the smallest deflection of the bristles per force
    [rad/N.m or m/N]. ``prefix`` stands before the names F_C and F_S in the texts.
    """

    def rules(coulomb: float, static: float, C: str, S: str) -> tuple[Rule, ...]:
        least = load * minimum(coulomb, static)
        return (
            Rule(
                either(static <= 0.0, both(coulomb > 0.0, coulomb >= SMALLEST_RATIO * static)),
                f"{C} = 0 with {S} > 0, or below {SMALLEST_RATIO:g} of it: the friction of fast sliding would be 0, "
                f"and the bristles could not be integrated. Set {C} larger, or {S} = 0 for no dry friction.",
            ),
            Rule(
                either(coulomb <= 0.0, both(static > 0.0, static >= SMALLEST_RATIO * coulomb)),
                f"{S} = 0 with {C} > 0, or below {SMALLEST_RATIO:g} of it: the friction at standstill would be 0, "
                f"and the bristles could not be integrated. Set {S} larger, or {C} = 0 for no dry friction.",
            ),
            Rule(
                either(least <= 0.0, least * compliance >= SMALLEST_DEFLECTION),
                f"friction_scale*{C} or friction_scale*{S} is so small that the bristles would slip within "
                f"{SMALLEST_DEFLECTION:g} rad or m, and could not be integrated. Set them larger, or to 0 for no dry "
                "friction.",
            ),
        )

    C, S = f"{prefix}F_C", f"{prefix}F_S"
    return (
        *rules(F_C, F_S, C, S),
        *rules(F_C * F_C_negative, F_S * F_S_negative, f"{C}*F_C_negative", f"{S}*F_S_negative"),
    )


def damping_rule(v_d: float, name: str = "v_d") -> Rule:
    """Rule of the speed over which the damping of the bristles falls."""
    return Rule(
        either(v_d <= 0.0, v_d >= SMALLEST_SPEED),
        f"{name} is above 0 but below {SMALLEST_SPEED:g}. Set it larger, or to 0 for a constant damping.",
    )


def counted(z: float, load: float) -> float:
    """The part of a deflection or force ``z`` that counts: nothing where the factor ``load`` on the level is 0."""
    return where(load > 0.0, z, 0.0)


def friction(z: float, z_rate: float, speed: float, *, sigma_0: float, sigma_1: float, sigma_2: float) -> float:
    """Friction force or torque, positive if it opposes positive speed. ``bristle_rate`` gives ``z_rate``."""
    return sigma_0 * z + sigma_1 * z_rate + sigma_2 * speed


def steady_bristle(speed: float, level: float, sigma_0: float) -> float:
    """Deflection of steady sliding at ``speed``; 0 at standstill. ``sigma_0`` > 0."""
    return sign(speed) * level / sigma_0


def observer_step(z: float, speed: float, level: float, sigma_0: float, T_s: float) -> float:
    """Deflection one sampling time later, ``speed`` held: one step of backward Euler, stable for any ``T_s``.

        z[k+1] = z[k] + T_s*(speed - sigma_0*abs(speed)*z[k+1]/level)

    Steady sliding is kept exactly. ``level`` must be positive.
    """
    return (z + T_s * speed) / (1.0 + T_s * sigma_0 * abs(speed) / level)
