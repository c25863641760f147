"""Gyro g-sensitivity: the gyro reports a rate that is only a force."""

from __future__ import annotations

from handcal.effects import Effect, Param, Signals
from handcal.effects._linear import added
from handcal.types import Array


def features(signals: Signals) -> list[tuple[int, int, Array]]:
    """Of ``g_ij f_j`` on gyro i; g (9,) in the order xx xy xz yx ... zz."""
    return [(i, 3 * i, signals.accel) for i in range(3)]


EFFECT = Effect(
    id="gyro_g_sensitivity",
    title="Gyro g-sensitivity",
    parameters=tuple(Param(i + j, "(rad/s)/(m/s^2)", 1.8e-4) for i in "xyz" for j in "xyz"),
    story="Gravity and shocks push the gyro's vibrating mass, and it reports a turn for it.",
    source="IEEE Std 1431, acceleration-sensitive drift",
    motion="Gravity along each axis, up and down, in one recording.",
    validated="the simulator's injection",
    common="0.1 deg/s/g in data sheets of MEMS gyros",
    imu_error=added(features),
    features=features,
    proportional=True,
)
