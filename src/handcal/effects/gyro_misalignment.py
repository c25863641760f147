"""Gyro misalignment: an axis also sees a little of the turns about the other two."""

from __future__ import annotations

import numpy as np

from handcal.effects import Effect, Param, Signals
from handcal.types import Array

_PAIRS = ((0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1))


def imu_error(m: Array, signals: Signals) -> Array:
    """``m_ij omega_j`` on gyro i; m (6,) in the order xy xz yx yz zx zy, result (n, 6)."""
    out = np.zeros((len(signals.t), 6))
    for value, (i, j) in zip(m, _PAIRS, strict=True):
        out[:, i] += value * signals.gyro[:, j]
    return out


EFFECT = Effect(
    id="gyro_misalignment",
    title="Gyro misalignment",
    parameters=tuple(Param("xyz"[i] + "xyz"[j], "rad", 0.01) for i, j in _PAIRS),
    story="The gyro's axes are not square to each other, or not square to the accelerometer's.",
    source="paper 003, equation 3",
    motion="At least one turn about each axis.",
    validated="the simulator's injection; motion capture of a hand-held IMU",
    imu_error=imu_error,
)
