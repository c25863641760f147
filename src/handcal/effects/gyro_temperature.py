"""Gyro temperature: the bias changes as the device warms up."""

from __future__ import annotations

import numpy as np

from handcal.effects import Effect, Param, Signals
from handcal.types import Array


def imu_error(c: Array, signals: Signals) -> Array:
    """``c_i (T - 25 degC)`` on the gyro; c (3,) (rad/s)/K, result (n, 6)."""
    out = np.zeros((len(signals.t), 6))
    out[:, :3] = signals.warmth[:, None] * c
    return out


EFFECT = Effect(
    id="gyro_temperature",
    title="Gyro temperature",
    parameters=tuple(Param(axis, "(rad/s)/K", 9e-4) for axis in "xyz"),
    story="The gyro's bias follows the temperature of the device.",
    source="IEEE Std 1431, thermal drift; linear about 25 degC",
    motion="Any, while the device warms up or cools down by some degrees.",
    validated="the simulator's injection",
    common="0.01 to 0.05 deg/s/K in data sheets of MEMS gyros",
    imu_error=imu_error,
    needs=("temperature",),
)
