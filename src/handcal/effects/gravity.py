"""Gravity: here it is a little stronger or weaker than was assumed."""

from __future__ import annotations

import numpy as np

from handcal.effects import ATTITUDE, Effect, Param, Signals
from handcal.types import Array


def imu_error(delta: Array, signals: Signals) -> Array:
    """``C_nb^T (0, 0, delta)`` on the accelerometer; delta (1,) m/s^2, result (n, 6)."""
    out = np.zeros((len(signals.t), 6))
    if signals.C_nb is not None:
        out[:, 3:] = delta[0] * signals.C_nb[:, 2, :]
    return out


EFFECT = Effect(
    id="gravity",
    title="Local gravity",
    parameters=(Param("delta", "m/s^2", 0.02),),
    story="Gravity is not the same everywhere: here it differs from the standard value.",
    source="WGS84 normal gravity: 9.780 m/s^2 at the equator, 9.832 m/s^2 at the poles",
    motion="The device held in many attitudes, upside down too.",
    validated="the simulator's injection",
    imu_error=imu_error,
    needs=(ATTITUDE,),
    world=True,
    tails=False,
)
