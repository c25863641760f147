"""Accelerometer misalignment: an axis also feels a little of the force along the others."""

from __future__ import annotations

from handcal.effects import Effect, Param, Signals
from handcal.effects._linear import added
from handcal.types import Array

_PAIRS = ((1, 0), (2, 0), (2, 1))


def features(signals: Signals) -> list[tuple[int, int, Array]]:
    """Of ``m_ij f_j`` on accelerometer i; m (3,) in the order yx zx zy.

    Accelerometer x defines body x, accelerometer y the body x-y plane.
    """
    return [(3 + i, k, signals.accel[:, j : j + 1]) for k, (i, j) in enumerate(_PAIRS)]


# Beyond it axes are other axes.
MOST = 0.3

EFFECT = Effect(
    id="accel_misalignment",
    title="Accelerometer misalignment",
    parameters=tuple(Param("xyz"[i] + "xyz"[j], "rad", 0.01, most=MOST) for i, j in _PAIRS),
    story="The accelerometer's axes are not square to each other.",
    source="paper 003, equation 2",
    motion="Gravity along each axis and between them.",
    validated="the simulator's injection",
    common="1 to 2 % cross-axis sensitivity in data sheets; 0.4 to 2 % by imu_tk and imucal",
    imu_error=added(features),
    features=features,
    proportional=True,
)
