"""Accelerometer bias: the reading is off by the same amount always. It is in every model."""

from __future__ import annotations

import numpy as np

from handcal.effects import Effect, Param, Signals
from handcal.types import ACCEL_BIAS_PRIOR, Array


def imu_error(b: Array, signals: Signals) -> Array:
    """b (3,) m/s^2 on the accelerometer; result (n, 6)."""
    out = np.zeros((len(signals.t), 6))
    out[:, 3:] = b
    return out


EFFECT = Effect(
    id="accel_bias",
    title="Accelerometer bias",
    parameters=tuple(Param(axis, "m/s^2", ACCEL_BIAS_PRIOR) for axis in "xyz"),
    story="The reading is off by the same amount always, until the next start or a warmer day.",
    source="contract of this project: part of every model, and never a candidate",
    motion="Rests with each axis pointing up, down and level.",
    validated="the simulator's injection; rests of real devices",
    imu_error=imu_error,
    baseline=True,
    of_one_day=True,
)
