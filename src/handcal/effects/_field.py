"""The magnetic field as it is predicted, for effects that act on a magnetometer."""

from __future__ import annotations

from typing import Any

from handcal._jit import njit


@njit
def field_of(nav: Any, z: Any) -> tuple[float, float, float]:
    """The field (3,) in b at the first guess of its strengths, which z holds behind the reading,
    tesla: by how much they are off is small beside the field, and so is what an effect does."""
    return (
        nav[9] * z[3] + nav[12] * z[4],
        nav[10] * z[3] + nav[13] * z[4],
        nav[11] * z[3] + nav[14] * z[4],
    )
