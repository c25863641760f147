"""A bias that wanders: three random walks in the body's axes, from zero at the start."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from handcal.types import Array


class RandomWalk:
    """Three independent walks of the density that the noise level ``level`` names.

    They belong to the sensor's axes, not to n (vectors 0). Where they start is the constant
    bias, so their own start is zero and certain.
    """

    size, vectors = 3, 0

    def __init__(self, level: str) -> None:
        self.level = level

    def transition(
        self,
        levels: Mapping[str, float],
        dt: Array,
        rate: Array,  # noqa: ARG002
    ) -> tuple[Array, Array]:
        """Phi (the identity) and Q, each (n, 3, 3)."""
        eye = np.eye(3)
        Phi = np.broadcast_to(eye, (len(dt), 3, 3)).copy()
        return Phi, (levels[self.level] ** 2 * dt)[:, None, None] * eye

    def start(self, levels: Mapping[str, float], rate: float) -> Array:  # noqa: ARG002
        """Nothing has been walked yet."""
        return np.zeros((3, 3))
