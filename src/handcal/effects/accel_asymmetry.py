"""Accelerometer asymmetry: pushing and pulling are not measured alike."""

from __future__ import annotations

import numpy as np

from handcal.effects import Effect, Param, Signals
from handcal.effects._linear import added
from handcal.types import Array


def features(signals: Signals) -> list[tuple[int, int, Array]]:
    """Of ``a_i |f_i|`` on the accelerometer; a (3,)."""
    return [(3 + i, i, np.abs(signals.accel[:, i : i + 1])) for i in range(3)]


EFFECT = Effect(
    id="accel_asymmetry",
    title="Accelerometer asymmetry",
    parameters=tuple(Param(axis, "1", 0.01) for axis in "xyz"),
    story="The accelerometer's scale is not the same for forces up and down an axis.",
    source="paper 001",
    motion="Gravity along each axis, up, down and across.",
    validated="the simulator's injection",
    imu_error=added(features),
    features=features,
)
