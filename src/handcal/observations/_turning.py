"""Errors that stay as long as the device does, and change as it turns.

A field bent by furniture, a marker seen from another side: Markov states whose clock is
the angle turned, or many minutes at rest.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from handcal.types import Array

FORGET_ANGLE = 1.0
REST_RATE = 0.02
FORGET_TIME = 1000.0


class Turning:
    """Independent states, each as large as the noise level named for it."""

    vectors = 0

    def __init__(self, *levels: str) -> None:
        self.levels, self.size = levels, len(levels)

    def transition(
        self, levels: Mapping[str, float], dt: Array, rate: Array
    ) -> tuple[Array, Array]:
        """Phi and Q (n, size, size): forgets over the angle turned; stationary."""
        phi = np.exp(-dt * (np.maximum(rate - REST_RATE, 0.0) / FORGET_ANGLE + 1.0 / FORGET_TIME))
        eye = np.eye(self.size)
        return phi[:, None, None] * eye, (1.0 - phi**2)[:, None, None] * self.start(levels, 0.0)

    def start(self, levels: Mapping[str, float], rate: float) -> Array:  # noqa: ARG002
        """Stationary variances."""
        return np.diag([levels[n] ** 2 for n in self.levels])
