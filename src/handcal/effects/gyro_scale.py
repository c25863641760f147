"""Gyro scale error: the reading is a fixed fraction too large, axis by axis."""

from __future__ import annotations

from handcal.effects import Effect, Param, Signals
from handcal.effects._linear import added
from handcal.types import Array


def features(signals: Signals) -> list[tuple[int, int, Array]]:
    """Of ``s_i omega_i`` on the gyro; s (3,)."""
    return [(i, i, signals.gyro[:, i : i + 1]) for i in range(3)]


# Beyond it the full scale or the unit is wrong.
MOST = 0.3

EFFECT = Effect(
    id="gyro_scale",
    title="Gyro scale error",
    parameters=tuple(Param(axis, "1", 0.01, most=MOST) for axis in "xyz"),
    story="The gyro reports every turn a fixed fraction too large or too small.",
    source="paper 002, equation 2",
    motion="At least one full turn about each axis, or a turn and its reverse with a heading.",
    validated="three turns simulated with 200 seeds; motion capture of a hand-held IMU",
    common="0.5 to 3 % in data sheets of MEMS gyros; 0.04 to 0.8 % in five MPU-9150 (imu- "
    "calib, ICINS 2020)",
    imu_error=added(features),
    features=features,
    proportional=True,
)
