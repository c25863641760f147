"""What wanders: random walks, three to a level, from zero at the start."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from handcal.types import Array


class RandomWalk:
    """Three independent walks for each of the noise levels named, which are their densities.

    vectors: how many of the threes turn with n; a sensor's axes do not (0). Where they start is a
    constant of its own, so their own start is zero and certain.
    """

    def __init__(self, *levels: str, vectors: int = 0) -> None:
        self.levels, self.size, self.vectors = levels, 3 * len(levels), vectors

    def transition(
        self,
        levels: Mapping[str, float],
        dt: Array,
        rate: Array,  # noqa: ARG002
    ) -> tuple[Array, Array]:
        """Phi (the identity) and Q, each (n, size, size)."""
        eye = np.eye(self.size)
        density = np.repeat([levels[name] ** 2 for name in self.levels], 3)
        Phi = np.broadcast_to(eye, (len(dt), self.size, self.size)).copy()
        return Phi, dt[:, None, None] * (density * eye)

    def start(self, levels: Mapping[str, float], rate: float) -> Array:  # noqa: ARG002
        """Nothing has been walked yet."""
        return np.zeros((self.size, self.size))
