"""Accelerometer asymmetry: pushing and pulling are not measured alike."""

from __future__ import annotations

import numpy as np

from handcal.effects import Effect, Param, Signals
from handcal.types import Array


def imu_error(a: Array, signals: Signals) -> Array:
    """``a_i |f_i|`` on the accelerometer; a (3,), result (n, 6)."""
    out = np.zeros((len(signals.t), 6))
    out[:, 3:] = a * np.abs(signals.accel)
    return out


EFFECT = Effect(
    id="accel_asymmetry",
    title="Accelerometer asymmetry",
    parameters=tuple(Param(axis, "1", 0.01) for axis in "xyz"),
    story="The accelerometer's scale is not the same for forces up and down an axis.",
    source="paper 001",
    motion="Gravity along each axis, up, down and across.",
    validated="the simulator's injection",
    imu_error=imu_error,
)
