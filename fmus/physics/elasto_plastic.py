"""Elasto-plastic friction of one contact, as pure functions: LuGre friction, but elastic at small deflections.

    der(z)   = speed - alpha*sigma_0*abs(speed)*z/level
    friction = sigma_0*z + sigma_1*exp(-(speed/v_d)^2)*der(z) + sigma_2*speed
    alpha    = 0 where z and speed oppose each other or abs(z) <= z_ba
               (1 - cos(pi*w))/2, w = (abs(z) - z_ba)/(level/sigma_0 - z_ba), where 0 < w < 1
               1 where abs(z) >= level/sigma_0

``level``, the damping and the friction itself are those of ``lugre``. Below the break-away deflection z_ba the contact
is a spring and a damper: it does not drift. z_ba lies below level/sigma_0 at every speed. alpha has a continuous first
derivative over w; der(z) is continuous everywhere, with kinks where alpha sets in, as at speed 0.

Valid for one contact at constant normal load. Passive for sure where sigma_1*exp(-(speed/v_d)^2) < 4*level/abs(speed),
as LuGre friction. Above z_ba the model drifts as LuGre does, and minor loops that reach there do not close.

Source: Dupont, Hayward, Armstrong, Altpeter, Single state elastoplastic friction models, IEEE Trans. Automatic Control
47(5), 2002.
"""

from __future__ import annotations

from cosim.model import both, clip, cos, where

PI = 3.141592653589793


def plastic_share(z: float, speed: float, z_ba: float, level: float, sigma_0: float) -> float:
    """alpha: the share of the motion that slips, 0 ... 1. ``z_ba`` [unit of z] < ``level``/``sigma_0``."""
    width = level / sigma_0 - z_ba
    w = clip((abs(z) - z_ba) / where(width > 0.0, width, 1.0), 0.0, 1.0)
    return where(both(z * speed > 0.0, width > 0.0), 0.5 - 0.5 * cos(PI * w), 0.0)


def elastoplastic_rate(z: float, speed: float, z_ba: float, level: float, sigma_0: float) -> float:
    """Time derivative of the deflection ``z``; 0 if ``level`` is 0. ``lugre.friction_level`` gives ``level``."""
    share = plastic_share(z, speed, z_ba, level, sigma_0)
    rate = speed - share * sigma_0 * abs(speed) * z / where(level > 0.0, level, 1.0)
    return where(level > 0.0, rate, 0.0)
