"""Accelerometer delay: it reports what it felt a little earlier than its stamp says."""

from __future__ import annotations

import numpy as np

from handcal.effects import Effect, Param, Signals
from handcal.effects._stamps import measured
from handcal.types import Array, BoolArray


def imu_error(delay: Array, signals: Signals) -> Array:
    """``f(t - delay) - f(t)`` on the accelerometer; delay (1,) s, result (n, 6)."""
    out = np.zeros((len(signals.t), 6))
    if delay[0] != 0.0:
        from scipy.interpolate import PPoly  # (slow to import, and most never need it)

        # (straight lines between samples would average their noise, and less noise would
        # speak for half a sample's delay)
        then = np.clip(signals.t - delay[0], signals.t[0], signals.t[-1])
        if not np.isfinite(signals.accel).all():
            # (a fit that ran away, which its maker finds out)
            out[:, 3:] = np.nan
            return out
        pieces = signals.once((_cubic,), lambda: _cubic(signals))
        out[:, 3:] = PPoly.construct_fast(pieces, signals.t)(then) - signals.accel
    return out


def _cubic(signals: Signals) -> Array:
    """Coefficients (4, n - 1, 3) of a cubic spline through the specific force."""
    from scipy.interpolate import CubicSpline

    return np.asarray(CubicSpline(signals.t, signals.accel).c)


def imu_inverse(delay: Array, readings: Signals) -> Array:
    """The truth is what is read a delay later; result (n, 6)."""
    return np.hstack([readings.gyro, readings.accel + imu_error(-delay, readings)[:, 3:]])


def sound(delay: Array, t: Array, valid: BoolArray) -> BoolArray:
    """What was felt a delay ago was measured."""
    return valid & measured(t, valid, np.clip(t - delay[0], t[0], t[-1]))


EFFECT = Effect(
    id="accel_delay",
    title="Accelerometer delay",
    parameters=(Param("delay", "s", 0.02),),
    story="Accelerometer and gyro do not tell of the same moment: the stamps of one are late.",
    source="filter delay of a digital output; Kalibr's temporal calibration for the idea",
    motion="Brisk changes of attitude, so that gravity moves between the axes quickly.",
    validated="the simulator's injection",
    common="filters of the two sensors differ by some samples; Kalibr's temporal calibration",
    swings=True,
    imu_error=imu_error,
    imu_inverse=imu_inverse,
    sound=sound,
)
