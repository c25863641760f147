"""A law outside the catalogue, for docs/stories.md: a gyro's z axis takes in the size of
the turning about x."""

from __future__ import annotations

import numpy as np

from handcal.effects import Effect, Param, Signals
from handcal.types import Array


def imu_error(k: Array, signals: Signals) -> Array:
    """``k |omega_x|`` on gyro z; k (1,), result (n, 6)."""
    out = np.zeros((len(signals.t), 6))
    out[:, 2] = k[0] * np.abs(signals.gyro[:, 0])
    return out


EFFECT = Effect(
    id="gyro_rectifies",
    title="Gyro z rectifies the turning about x",
    parameters=(Param("k", "1", 0.01),),
    story="Whichever way the device turns about x, the z axis reads a little more.",
    source="invented",
    motion="Turns both ways about x.",
    validated="docs/stories.md",
    imu_error=imu_error,
)
