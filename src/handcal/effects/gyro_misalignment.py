"""Gyro misalignment: an axis also sees a little of the turns about the other two."""

from __future__ import annotations

from handcal.effects import Effect, Param, Signals
from handcal.effects._linear import added
from handcal.types import Array

_PAIRS = ((0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1))


def features(signals: Signals) -> list[tuple[int, int, Array]]:
    """Of ``m_ij omega_j`` on gyro i; m (6,) in the order xy xz yx yz zx zy."""
    return [(i, k, signals.gyro[:, j : j + 1]) for k, (i, j) in enumerate(_PAIRS)]


# Beyond it axes are other axes.
MOST = 0.3

EFFECT = Effect(
    id="gyro_misalignment",
    title="Gyro misalignment",
    parameters=tuple(Param("xyz"[i] + "xyz"[j], "rad", 0.01, most=MOST) for i, j in _PAIRS),
    story="The gyro's axes are not square to each other, or not square to the accelerometer's.",
    source="paper 003, equation 3",
    motion="At least one turn about each axis.",
    validated="the simulator's injection; motion capture of a hand-held IMU",
    common="1 to 2 % cross-axis sensitivity in data sheets; 0.6 to 3 % by imu_tk and imucal",
    imu_error=added(features),
    features=features,
    proportional=True,
)
