"""Correlated heading noise: the heading errs for a while, then forgets it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from handcal.compiled.jit import residual_function
from handcal.effects import Effect, Param
from handcal.types import Array, Level

SIGMA, TAU = "heading_correlated_noise_sigma", "heading_correlated_noise_tau"


class _GaussMarkov:
    """One stationary state of root mean square sigma that decays as exp(-dt / tau)."""

    size, vectors = 1, 0

    def transition(
        self,
        levels: Mapping[str, float],
        dt: Array,
        rate: Array,  # noqa: ARG002
    ) -> tuple[Array, Array]:
        """Phi and Q (n, 1, 1)."""
        decay = dt / levels[TAU]
        Q = -(levels[SIGMA] ** 2) * np.expm1(-2.0 * decay)
        return np.exp(-decay)[:, None, None], Q[:, None, None]

    def start(self, levels: Mapping[str, float], rate: float) -> Array:  # noqa: ARG002
        """Stationary variance (1, 1)."""
        return np.array([[levels[SIGMA] ** 2]])


def _heading(nav: Any, state: Any, z: Any, r: Any) -> int:  # noqa: ARG001
    r[0] -= state[0]
    return 0


EFFECT = Effect(
    id="heading_correlated_noise",
    title="Correlated heading noise",
    parameters=(
        Param("sigma", "rad", 0.15, positive=True),
        Param("tau", "s", 3.0, positive=True),
    ),
    story="The heading's noise is not fresh at every reading: it errs to one side for seconds, "
    "so more readings do not help as much as they seem to.",
    source="first-order Gauss-Markov process; Brown & Hwang, Introduction to Random Signals and "
    "Applied Kalman Filtering",
    motion="Any motion, many times longer than the noise remembers.",
    validated="the simulator's injection",
    observation_error={"heading": residual_function(_heading)},
    process=_GaussMarkov(),
    levels=(
        Level(SIGMA, "rad", 0.05, 1.5e-4, 4.5),
        Level(TAU, "s", 1.0, 3e-3, 90.0),
    ),
)
