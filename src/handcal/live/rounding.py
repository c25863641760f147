"""Readings that a browser has rounded: what of them cannot be believed.

At rest on a table a rounded gyro may read the same number for minutes, up to half a step off; no
mean of them knows better, whatever their scatter says. In turns it is averaged out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from handcal.types import Array, Parameter, Recording

# Steps that browsers round to, deg/s and m/s^2.
STEPS = (0.1, 0.1)
# So many readings are looked at; a tenth of them would do.
LOOKED_AT = 2000
# Of a step, how far a value may be off one.
NEAR = 1e-3


def rounded(recording: Recording) -> tuple[bool, bool]:
    """Whether the gyro, and the accelerometer, have been rounded so."""
    imu = recording.imu
    return _rounded(np.degrees(imu.gyro), STEPS[0]), _rounded(imu.accel, STEPS[1])


def _rounded(value: Array, step: float) -> bool:
    some = value[:LOOKED_AT] / step
    return bool(np.all(np.abs(some - np.rint(some)) < NEAR))


def floors(recording: Recording) -> dict[str, float]:
    """By effect, how well a bias can be known at best, SI (that of an even spread over a step)."""
    gyro, accel = rounded(recording)
    out = {}
    if gyro:
        out["gyro_bias"] = float(np.radians(STEPS[0])) / np.sqrt(12.0)
    if accel:
        out["accel_bias"] = STEPS[1] / np.sqrt(12.0)
    return out


def no_better(
    parameters: Sequence[Parameter], covariance: Array, floor: dict[str, float]
) -> tuple[tuple[Parameter, ...], Array]:
    """Parameters and covariance (k, k) with what the rounding adds."""
    added = np.array([floor.get(p.effect, 0.0) for p in parameters])
    told = tuple(
        replace(p, sigma=float(np.hypot(p.sigma, a)))
        for p, a in zip(parameters, added, strict=True)
    )
    return told, covariance + np.diag(added**2)
