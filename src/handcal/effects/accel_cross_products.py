"""Accelerometer cross products: forces along two axes at once leak into the reading."""

from __future__ import annotations

import numpy as np

from handcal.effects import Effect, Param, Signals
from handcal.effects._linear import added
from handcal.types import Array


def features(signals: Signals) -> list[tuple[int, int, Array]]:
    """Of ``l_i,jk f_j f_k`` on accelerometer i; l (9,): x_xy x_yz x_xz y_xy ..."""
    x, y, z = signals.accel.T
    products = np.stack([x * y, y * z, x * z], axis=1)
    return [(3 + i, 3 * i, products) for i in range(3)]


EFFECT = Effect(
    id="accel_cross_products",
    title="Accelerometer cross products",
    parameters=tuple(
        Param(f"{i}_{pair}", "s^2/m", 4e-4) for i in "xyz" for pair in ("xy", "yz", "xz")
    ),
    story="A force between two axes bends the sensing mass, and the reading is a little off.",
    source="paper 000, equation 4",
    motion="Gravity between the axes: the device held slanted in many directions.",
    validated="the simulator's injection",
    imu_error=added(features),
    features=features,
)
