"""Accelerometer misalignment: an axis also feels a little of the force along the others."""

from __future__ import annotations

import numpy as np

from handcal.effects import Effect, Param, Signals
from handcal.types import Array

_PAIRS = ((1, 0), (2, 0), (2, 1))


def imu_error(m: Array, signals: Signals) -> Array:
    """``m_ij f_j`` on accelerometer i; m (3,) in the order yx zx zy, result (n, 6).

    Accelerometer x defines body x, accelerometer y the body x-y plane.
    """
    out = np.zeros((len(signals.t), 6))
    for value, (i, j) in zip(m, _PAIRS, strict=True):
        out[:, 3 + i] += value * signals.accel[:, j]
    return out


EFFECT = Effect(
    id="accel_misalignment",
    title="Accelerometer misalignment",
    parameters=tuple(Param("xyz"[i] + "xyz"[j], "rad", 0.01) for i, j in _PAIRS),
    story="The accelerometer's axes are not square to each other.",
    source="paper 003, equation 2",
    motion="Gravity along each axis and between them.",
    validated="the simulator's injection",
    imu_error=imu_error,
)
