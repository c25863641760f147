"""Gyro scale error: the reading is a fixed fraction too large, axis by axis."""

from __future__ import annotations

import numpy as np

from handcal.effects import Effect, Param, Signals
from handcal.types import Array


def imu_error(s: Array, signals: Signals) -> Array:
    """``s_i omega_i`` on the gyro; s (3,), result (n, 6)."""
    out = np.zeros((len(signals.t), 6))
    out[:, :3] = signals.gyro * s
    return out


EFFECT = Effect(
    id="gyro_scale",
    title="Gyro scale error",
    parameters=(Param("x", "1", 0.01), Param("y", "1", 0.01), Param("z", "1", 0.01)),
    story="The gyro reports every turn a fixed fraction too large or too small.",
    source="paper 002, equation 2",
    motion="At least one full turn about each axis, or a turn and its reverse with a heading.",
    validated="three turns simulated with 200 seeds; motion capture of a hand-held IMU",
    imu_error=imu_error,
)
