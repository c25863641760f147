"""Earth rate: the gyro also measures the turning of the Earth."""

from __future__ import annotations

import numpy as np

from handcal.effects import ATTITUDE, Effect, Param, Signals
from handcal.types import Array


def imu_error(rate: Array, signals: Signals) -> Array:
    """``C_nb^T (0, north, up)`` on the gyro; rate (2,) rad/s, result (n, 6)."""
    out = np.zeros((len(signals.t), 6))
    if signals.C_nb is not None:
        out[:, :3] = rate[0] * signals.C_nb[:, 1, :] + rate[1] * signals.C_nb[:, 2, :]
    return out


EFFECT = Effect(
    id="earth_rate",
    title="Earth rate",
    parameters=(Param("north", "rad/s", 7.3e-5), Param("up", "rad/s", 7.3e-5)),
    story="The Earth turns, the gyro feels it, and the calculation left it out.",
    source="WGS84: 7.292e-5 rad/s, cos and sin of the latitude along north and up",
    motion="Many attitudes over minutes, with a heading and a gyro of little noise.",
    validated="the simulator's injection",
    imu_error=imu_error,
    needs=(ATTITUDE,),
    world=True,
    tails=False,
)
