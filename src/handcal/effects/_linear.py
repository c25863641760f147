"""Errors that are a sum of columns, each times a parameter: no effect of its own, many are that."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from handcal.effects import Signals
from handcal.types import Array

Features = Callable[[Signals], Sequence[tuple[int, int, Array]]]


def added(features: Features) -> Callable[[Array, Signals], Array]:
    """``Effect.imu_error`` of an effect with these ``Effect.features``."""

    def imu_error(parameters: Array, signals: Signals) -> Array:
        out = np.zeros((len(signals.t), 6))
        for channel, first, columns in features(signals):
            own = parameters[first : first + columns.shape[1]]
            # (a product with a matrix of one column takes four times as long)
            out[:, channel] += columns[:, 0] * own[0] if len(own) == 1 else columns @ own
        return out

    return imu_error
