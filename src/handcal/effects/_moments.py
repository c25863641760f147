"""Moments at which something may have happened (no effect of its own: steps need them)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from handcal.types import Array

MOST_MOMENTS = 64


def moments(count: int) -> Callable[[Array], Array]:
    """``Effect.moments`` of an effect of so many parameters, the last of which is the moment (s
    after the first sample): reference points (k, count), nothing yet, about a second apart."""

    def points(t: Array) -> Array:
        duration = float(t[-1] - t[0])
        tried = int(np.clip(round(0.9 * duration) + 1, 2, MOST_MOMENTS))
        out = np.zeros((tried, count))
        out[:, -1] = np.linspace(0.05, 0.95, tried) * duration
        return out

    return points
