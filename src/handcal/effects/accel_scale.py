"""Accelerometer scale error: the reading is a fixed fraction too large, axis by axis."""

from __future__ import annotations

import numpy as np

from handcal.effects import Effect, Param, Signals
from handcal.types import Array


def imu_error(s: Array, signals: Signals) -> Array:
    """``s_i f_i`` on the accelerometer; s (3,), result (n, 6)."""
    out = np.zeros((len(signals.t), 6))
    out[:, 3:] = signals.accel * s
    return out


EFFECT = Effect(
    id="accel_scale",
    title="Accelerometer scale error",
    parameters=(Param("x", "1", 0.01), Param("y", "1", 0.01), Param("z", "1", 0.01)),
    story="The accelerometer reports every force a fixed fraction too large or too small.",
    source="paper 002, equation 1",
    motion="Each axis up and down for a while, so that gravity pulls on it from both sides.",
    validated="three turns simulated with 200 seeds",
    imu_error=imu_error,
)
