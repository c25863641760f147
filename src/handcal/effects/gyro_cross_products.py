"""Gyro cross products: turning about two axes at once leaks into the reading."""

from __future__ import annotations

import numpy as np

from handcal.effects import Effect, Param, Signals
from handcal.effects._linear import added
from handcal.types import Array


def features(signals: Signals) -> list[tuple[int, int, Array]]:
    """Of ``p_i,jk omega_j omega_k`` on gyro i; p (9,): x_xy x_yz x_xz y_xy ..."""
    x, y, z = signals.gyro.T
    products = np.stack([x * y, y * z, x * z], axis=1)
    return [(i, 3 * i, products) for i in range(3)]


EFFECT = Effect(
    id="gyro_cross_products",
    title="Gyro cross products",
    parameters=tuple(
        Param(f"{i}_{pair}", "s/rad", 0.005) for i in "xyz" for pair in ("xy", "yz", "xz")
    ),
    story="When the device turns about two axes at once, the gyro is a little off.",
    source="paper 000, equation 10",
    motion="Fast turns about slanted axes, between x and y, y and z, x and z.",
    validated="the simulator's injection",
    imu_error=added(features),
    features=features,
)
