"""The magnetic field as it is predicted, for effects that act on a magnetometer."""

from __future__ import annotations

from typing import Any

from handcal.compiled.jit import njit

# Places in a magnetometer's z of the field's horizontal and upward strength, as believed.
NORTH, UP = 6, 7
# Of how it changes with place (xx, yy, xy, xz, yz), as believed, tesla/m.
GRADIENT = 8


@njit
def gradient_of(nav: Any, G: Any, first: int) -> tuple[float, float, float]:
    """By how much the field (3,) in b is another here than at the origin, tesla, where it changes
    with place as the five numbers G[first:] say."""
    x, y, z = nav[0], nav[1], nav[2]
    xx, yy, xy, xz, yz = G[first], G[first + 1], G[first + 2], G[first + 3], G[first + 4]
    east = xx * x + xy * y + xz * z
    north = xy * x + yy * y + yz * z
    up = xz * x + yz * y - (xx + yy) * z
    return (
        nav[6] * east + nav[9] * north + nav[12] * up,
        nav[7] * east + nav[10] * north + nav[13] * up,
        nav[8] * east + nav[11] * north + nav[14] * up,
    )


@njit
def field_of(nav: Any, z: Any) -> tuple[float, float, float]:
    """The field (3,) in b that the device stands in, as it is believed to be, which z holds,
    tesla."""
    north, up = z[NORTH], z[UP]
    more = gradient_of(nav, z, GRADIENT)
    return (
        nav[9] * north + nav[12] * up + more[0],
        nav[10] * north + nav[13] * up + more[1],
        nav[11] * north + nav[14] * up + more[2],
    )
