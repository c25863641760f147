"""The magnetic field as it is predicted, for effects that act on a magnetometer."""

from __future__ import annotations

from typing import Any

from handcal._jit import njit

# Places in a magnetometer's z of the field's horizontal and upward strength, as believed.
NORTH, UP = 6, 7


@njit
def field_of(nav: Any, z: Any) -> tuple[float, float, float]:
    """The field (3,) in b at its strengths as they are believed to be, which z holds, tesla."""
    north, up = z[NORTH], z[UP]
    return (
        nav[9] * north + nav[12] * up,
        nav[10] * north + nav[13] * up,
        nav[11] * north + nav[14] * up,
    )
