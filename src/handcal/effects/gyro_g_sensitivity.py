"""Gyro g-sensitivity: the gyro reports a rate that is only a force."""

from __future__ import annotations

import numpy as np

from handcal.effects import Effect, Param, Signals
from handcal.types import Array


def imu_error(g: Array, signals: Signals) -> Array:
    """``g_ij f_j`` on gyro i; g (9,) in the order xx xy xz yx ... zz, result (n, 6)."""
    out = np.zeros((len(signals.t), 6))
    out[:, :3] = signals.accel @ g.reshape(3, 3).T
    return out


EFFECT = Effect(
    id="gyro_g_sensitivity",
    title="Gyro g-sensitivity",
    parameters=tuple(Param(i + j, "(rad/s)/(m/s^2)", 1.8e-4) for i in "xyz" for j in "xyz"),
    story="Gravity and shocks push the gyro's vibrating mass, and it reports a turn for it.",
    source="IEEE Std 1431, acceleration-sensitive drift",
    motion="Gravity along each axis, up and down, in one recording.",
    validated="the simulator's injection",
    imu_error=imu_error,
)
