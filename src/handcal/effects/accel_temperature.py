"""Accelerometer temperature: the bias changes as the device warms up."""

from __future__ import annotations

import numpy as np

from handcal.effects import Effect, Param, Signals
from handcal.types import Array


def imu_error(c: Array, signals: Signals) -> Array:
    """``c_i (T - 25 degC)`` on the accelerometer; c (3,) (m/s^2)/K, result (n, 6)."""
    out = np.zeros((len(signals.t), 6))
    out[:, 3:] = signals.warmth[:, None] * c
    return out


EFFECT = Effect(
    id="accel_temperature",
    title="Accelerometer temperature",
    parameters=tuple(Param(axis, "(m/s^2)/K", 0.01) for axis in "xyz"),
    story="The accelerometer's bias follows the temperature of the device.",
    source="IEEE Std 1293, thermal drift; linear about 25 degC",
    motion="Many attitudes, while the device warms up or cools down by some degrees.",
    validated="the simulator's injection",
    common="0.15 to 1 mg/K in data sheets of MEMS accelerometers",
    imu_error=imu_error,
    needs=("temperature",),
)
