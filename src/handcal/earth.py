"""Gravity and the turning of the Earth (WGS84), in the local-level ENU frame."""

from __future__ import annotations

import math

import numpy as np

from handcal.types import Array, InputError

STANDARD_GRAVITY = 9.80665
EARTH_RATE = 7.292115e-5


def normal_gravity(latitude: float, height: float = 0.0) -> float:
    """Normal gravity, m/s^2, at geodetic latitude (rad) and height (m) above the ellipsoid.

    Somigliana's closed form with the second-order height correction
    (NIMA TR8350.2, equations 4-1 and 4-3).
    """
    s2 = math.sin(latitude) ** 2
    gamma = 9.7803253359 * (1 + 0.00193185265241 * s2) / math.sqrt(1 - 0.00669437999014 * s2)
    a, f, m = 6378137.0, 1 / 298.257223563, 0.00344978650684
    return gamma * (1 - 2 / a * (1 + f + m - 2 * f * s2) * height + 3 / a**2 * height**2)


def local_earth(latitude: float | None, height: float = 0.0) -> tuple[Array, Array]:
    """Gravity vector g_n (3,) m/s^2 and Earth rate omega_ie_n (3,) rad/s in ENU.

    Without a latitude: standard gravity and no Earth rate (paper 002, equations 7-9).
    Raises InputError for a latitude outside +-90 degrees.
    """
    if latitude is None:
        return np.array([0.0, 0.0, -STANDARD_GRAVITY]), np.zeros(3)
    if not abs(latitude) <= math.pi / 2:
        raise InputError(
            f"The latitude must lie within +-90 degrees, not {math.degrees(latitude):g}."
        )
    if not -1000.0 <= height <= 20000.0:
        raise InputError(f"The height must lie between -1000 and 20000 m, not {height:g}.")
    rate = EARTH_RATE * np.array([0.0, math.cos(latitude), math.sin(latitude)])
    return np.array([0.0, 0.0, -normal_gravity(latitude, height)]), rate
