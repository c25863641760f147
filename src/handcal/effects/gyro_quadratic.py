"""Gyro quadratic error: the scale error grows with the rate."""

from __future__ import annotations

from handcal.effects import Effect, Param, Signals
from handcal.effects._linear import added
from handcal.types import Array


def features(signals: Signals) -> list[tuple[int, int, Array]]:
    """Of ``q_i omega_i^2`` on the gyro; q (3,) s/rad."""
    return [(i, i, signals.gyro[:, i : i + 1] ** 2) for i in range(3)]


EFFECT = Effect(
    id="gyro_quadratic",
    title="Gyro quadratic error",
    parameters=tuple(Param(axis, "s/rad", 0.005) for axis in "xyz"),
    story="Fast turns one way are reported too large, the same turns back too small.",
    source="IEEE Std 1431, scale factor nonlinearity",
    motion="Fast turns both ways about each axis.",
    validated="the simulator's injection",
    imu_error=added(features),
    features=features,
)
