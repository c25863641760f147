"""Accelerometer scale error: the reading is a fixed fraction too large, axis by axis."""

from __future__ import annotations

from handcal.effects import Effect, Param, Signals
from handcal.effects._linear import added
from handcal.types import Array


def features(signals: Signals) -> list[tuple[int, int, Array]]:
    """Of ``s_i f_i`` on the accelerometer; s (3,)."""
    return [(3 + i, i, signals.accel[:, i : i + 1]) for i in range(3)]


# Beyond it the full scale or the unit is wrong.
MOST = 0.3

EFFECT = Effect(
    id="accel_scale",
    title="Accelerometer scale error",
    parameters=tuple(Param(axis, "1", 0.01, most=MOST) for axis in "xyz"),
    story="The accelerometer reports every force a fixed fraction too large or too small.",
    source="paper 002, equation 1",
    motion="Each axis up and down for a while, so that gravity pulls on it from both sides.",
    validated="three turns simulated with 200 seeds",
    common="0.5 to 3 % in data sheets of MEMS accelerometers; 0.3 to 0.7 % in five MPU-9150 "
    "(imu-calib)",
    imu_error=added(features),
    features=features,
    proportional=True,
)
