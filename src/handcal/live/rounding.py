"""Readings that a browser has rounded: how much less sure of them one can be.

Rounding is no noise that a fit could see: at rest on a table a rounded gyro reads the same number
all the time, up to half a step off. In turns it is averaged out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from handcal.types import Array, Parameter, Recording

# Steps that browsers round to, deg/s and m/s^2.
STEPS = (0.1, 0.1)
# So many times as large as their sigmas errors are at most in 22 simulated phones at 60 Hz, rounded
# so: biases 1.2 times where the hand trembles, 1.8 (gyro) and 2.5 (accelerometer) where all
# rests are on a table; scale errors 1.3 to 1.5 times.
TOO_SURE = 2.0
# So many readings are looked at; a tenth of them would do.
LOOKED_AT = 2000
# Of a step, how far a value may be off one.
NEAR = 1e-3


def rounded(recording: Recording) -> bool:
    """Whether the gyro or the accelerometer has been rounded so."""
    imu = recording.imu
    return _rounded(np.degrees(imu.gyro), STEPS[0]) or _rounded(imu.accel, STEPS[1])


def _rounded(value: Array, step: float) -> bool:
    some = value[:LOOKED_AT] / step
    return bool(np.all(np.abs(some - np.rint(some)) < NEAR))


def less_sure(
    parameters: Sequence[Parameter], covariance: Array
) -> tuple[tuple[Parameter, ...], Array]:
    """Parameters and covariance (k, k) of rounded readings; never less sure than at the start."""
    sigma = np.array([p.sigma for p in parameters])
    usual = np.array([p.prior_sigma for p in parameters])
    times = np.minimum(TOO_SURE, np.maximum(usual / sigma, 1.0))
    told = tuple(
        replace(p, sigma=float(p.sigma * k)) for p, k in zip(parameters, times, strict=True)
    )
    return told, covariance * np.outer(times, times)
