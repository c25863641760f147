"""Gyro quadratic error: the scale error grows with the rate."""

from __future__ import annotations

import numpy as np

from handcal.effects import Effect, Param, Signals
from handcal.types import Array


def imu_error(q: Array, signals: Signals) -> Array:
    """``q_i omega_i^2`` on the gyro; q (3,) s/rad, result (n, 6)."""
    out = np.zeros((len(signals.t), 6))
    out[:, :3] = q * signals.gyro**2
    return out


EFFECT = Effect(
    id="gyro_quadratic",
    title="Gyro quadratic error",
    parameters=tuple(Param(axis, "s/rad", 0.005) for axis in "xyz"),
    story="Fast turns one way are reported too large, the same turns back too small.",
    source="IEEE Std 1431, scale factor nonlinearity",
    motion="Fast turns both ways about each axis.",
    validated="the simulator's injection",
    imu_error=imu_error,
)
