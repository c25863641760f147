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
            out[:, channel] += columns @ parameters[first : first + columns.shape[1]]
        return out

    return imu_error
