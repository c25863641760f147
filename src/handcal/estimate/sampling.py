"""What a sensor did between its samples: what straight lines between the readings miss of it.

Of what is rough between two samples (noise, vibrations, a rate that is a random walk) straight
lines are the best that one can know; of what is smooth they are too low wherever it bends, by a
twelfth of the second difference (the cubic rule of integration, weights -1, 13, 13, -1 over 24).
At 190 Hz, in a hand that shakes, that is as much as a gyro's low-pass of 4 ms, and was told as one.
Which of the two a sensor's readings are they say themselves: of every second reading, as if it had
not been taken, the others predict how far it lies from a straight line.

The second difference is that of a parabola through five samples: a bend of three has 21 times the
noise in it, for hardly more of what a hand does.
"""

from __future__ import annotations

import numpy as np

from handcal.types import Array, BoolArray, Imu

# Second difference of the parabola nearest to five samples.
BEND = np.array([2.0, -1.0, -2.0, -1.0, 2.0]) / 7.0
# Intervals that differ from the usual one by more than this share of it are no such samples.
UNEVEN = 0.25
# What white noise of variance one gives at twice the spacing: the product of what lies between two
# readings with what the cubic rule predicts of it, and the square of the latter, at both spacings.
# A smooth motion's prediction has the same noise at half the spacing, and a 64th of the square.
NOISE_PRODUCT, NOISE_SQUARE, NOISE_SQUARE_FINE = -1.0 / 12.0, 1.0 / 36.0, 1.0 / 144.0
# Of what it predicts a cubic rule at twice the spacing finds this much in a smooth motion: the
# readings between are joined by straight lines as well.
FOUND = 0.75
# Where readings bend by so many times as much as nearly all of them do (of a hand that turns and
# trembles none does) something knocked; a knock is over so many samples later, and what lasts is
# a rate that the integral has.
KNOCKED, NEARLY, OVER = 6.0, 0.95, 4


def at_nodes(imu: Imu, smooth: Array, readings: Array, t: Array) -> tuple[Array, Array, Array]:
    """Rate, force (m, 3) and what integration adds to both (m, 6), at times t (m,), of readings
    (n, 6) at the IMU's samples; smooth (6,): see ``smoothness``."""
    return (
        interpolated(t, imu.t, readings[:, :3]),
        interpolated(t, imu.t, readings[:, 3:]),
        between_samples(imu, smooth, readings, t),
    )


def interpolated(t: Array, t_old: Array, x: Array) -> Array:
    """Columns x (k, m) at times t_old (k,), on straight lines at times t (n,)."""
    out = np.empty((len(t), x.shape[1]))
    for i in range(x.shape[1]):
        out[:, i] = np.interp(t, t_old, x[:, i])
    return out


def between_samples(imu: Imu, smooth: Array, readings: Array, t: Array) -> Array:
    """What has to be added (m, k) at times t (m,) to readings (n, k) at the IMU's samples, so that
    straight lines have the integral; smooth (k,): of the cubic rule's correction this share.

    Nothing within two samples of an end, a gap or a reading that was not taken.
    """
    out = np.zeros_like(readings)
    whole = _unbroken(imu, len(BEND))
    count, before = len(whole), len(BEND) // 2
    if count:
        bends = sum(share * readings[k : k + count] for k, share in enumerate(BEND))
        out[before : before + count] = np.where(whole[:, None], -smooth / 12.0 * bends, 0.0)
    return interpolated(t, imu.t, out)


def knocked(imu: Imu) -> Array:
    """What is not known (n, 2) of rate and force at the IMU's samples where something knocked: as
    much as straight lines may miss there."""
    out = np.zeros((len(imu.t), 2))
    near, whole = _unbroken(imu, 3), _unbroken(imu, 2 * OVER + 1)
    for k, x in enumerate((imu.gyro, imu.accel) if whole.any() else ()):
        # (of three samples: a parabola through five is as long as a knock)
        bends = np.linalg.norm(np.diff(x, 2, axis=0), axis=1)
        usual = np.quantile(bends[near], NEARLY)
        bends = bends[OVER - 1 : 1 - OVER]
        lasting = np.linalg.norm(x[2 * OVER :] - x[: -2 * OVER], axis=1)
        hard = whole & (bends - lasting > KNOCKED * usual)
        out[OVER:-OVER, k] = np.where(hard, bends / 12.0, 0.0)
    return out


def smoothness(imu: Imu) -> Array:
    """How much of what bends in the readings of gyro and accelerometer, each of three channels
    (6,), goes on so between the samples: 0 (rough) to 1.

    Of x0 to x3, two samples apart, the cubic rule says that what is read between x1 and x2 lies
    (x1 + x2 - x0 - x3) / 12 above the straight line. It is asked of smooth motion (a share FOUND of
    the square of what it says comes true, which grows with the sixth power of the spacing) and
    white noise, and tells how much of the second differences at the samples' own spacing is which.
    """
    whole = _unbroken(imu, 7)
    if not whole.any():
        return np.zeros(6)
    return np.repeat([_smooth(x, whole) for x in (imu.gyro, imu.accel)], 3)


def _smooth(x: Array, whole: BoolArray) -> float:
    """``smoothness`` of one sensor's readings (n, 3); whole (n - 6,): where seven are unbroken."""
    x0, x1, between, x2, x3 = (x[k : k + len(whole)][whole] for k in (0, 2, 3, 4, 6))
    said = (x1 + x2 - x0 - x3) / 12.0
    square = float((said**2).mean())
    product = float(((between - 0.5 * (x1 + x2)) * said).mean())
    # (two equations for the square of what smooth motion says, and for the noise)
    noise = (FOUND * square - product) / (FOUND * NOISE_SQUARE - NOISE_PRODUCT)
    if noise <= 0.0:
        return 1.0 if square > 0.0 else 0.0
    motion = (square - NOISE_SQUARE * noise) / 64.0
    return max(0.0, motion / (motion + NOISE_SQUARE_FINE * noise))


def _unbroken(imu: Imu, most: int) -> BoolArray:
    """From which samples (n - most + 1,) on so many follow each other at intervals as long as
    usual, all of them taken."""
    dt = np.diff(imu.t)
    count = len(dt) - most + 2
    if count < 1:
        return np.zeros(0, dtype=np.bool_)
    even = np.abs(dt - np.median(dt)) < UNEVEN * np.median(dt)
    even &= imu.valid[1:] & imu.valid[:-1]
    return np.asarray(np.all([even[k : k + count] for k in range(most - 1)], axis=0))
