"""Gyro bias step: the bias jumps at one moment."""

from __future__ import annotations

import numpy as np

from handcal.effects import Effect, Param, Signals
from handcal.effects._moments import moments
from handcal.types import Array


def imu_error(p: Array, signals: Signals) -> Array:
    """x y z (rad/s) on the gyro from ``at`` (s after the first sample) on; p (4,), (n, 6).

    Between two samples the jump goes in proportion, so that the moment has a derivative.
    """
    out = np.zeros((len(signals.t), 6))
    t = signals.t - signals.t[0]
    step = t[-1] / (len(t) - 1)
    out[:, :3] = np.clip((t - p[3]) / step + 0.5, 0.0, 1.0)[:, None] * p[:3]
    return out


EFFECT = Effect(
    id="gyro_bias_step",
    title="Gyro bias step",
    parameters=(*(Param(axis, "rad/s", 0.01) for axis in "xyz"), Param("at", "s", 30.0)),
    story="The gyro's bias jumps at one moment, as after a knock or a change of its mode.",
    source="contract of this project",
    motion="Any; with a heading for a jump about the vertical.",
    validated="the simulator's injection",
    imu_error=imu_error,
    moments=moments(4),
    of_one_day=True,
)
