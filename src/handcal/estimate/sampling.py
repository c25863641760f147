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
    most = len(BEND) - 1
    count = len(imu.t) - most
    if count > 0:
        even = _even(imu)
        whole = np.all([even[k : k + count] for k in range(most)], axis=0)
        bends = sum(share * readings[k : k + count] for k, share in enumerate(BEND))
        out[most // 2 : most // 2 + count] = np.where(whole[:, None], -smooth / 12.0 * bends, 0.0)
    return interpolated(t, imu.t, out)


def smoothness(imu: Imu) -> Array:
    """How much of what bends in the readings of gyro and accelerometer, each of three channels
    (6,), goes on so between the samples: 0 (rough) to 1.

    Of x0 to x3, two samples apart, the cubic rule says that what is read between x1 and x2 lies
    (x1 + x2 - x0 - x3) / 12 above the straight line. It is asked of smooth motion (a share FOUND of
    the square of what it says comes true, which grows with the sixth power of the spacing) and
    white noise, and tells how much of the second differences at the samples' own spacing is which.
    """
    out = np.zeros(6)
    even = _even(imu)
    span = len(even) - 5
    if span < 1:
        return out
    whole = np.all([even[k : k + span] for k in range(6)], axis=0)
    for sensor, x in enumerate((imu.gyro, imu.accel)):
        x0, x1, between, x2, x3 = (x[k : k + span + 1][:span][whole] for k in (0, 2, 3, 4, 6))
        said = (x1 + x2 - x0 - x3) / 12.0
        square = float((said**2).mean()) if len(said) else 0.0
        product = float(((between - 0.5 * (x1 + x2)) * said).mean()) if len(said) else 0.0
        # (two equations for the square of what smooth motion says, and for the noise)
        noise = (FOUND * square - product) / (FOUND * NOISE_SQUARE - NOISE_PRODUCT)
        motion = (square - NOISE_SQUARE * noise) / 64.0
        if noise <= 0.0:
            out[3 * sensor : 3 * sensor + 3] = 1.0 if square > 0.0 else 0.0
        else:
            share = motion / (motion + NOISE_SQUARE_FINE * noise)
            out[3 * sensor : 3 * sensor + 3] = max(0.0, share)
    return out


def _even(imu: Imu) -> BoolArray:
    """Which intervals (n - 1,) are as long as usual, between readings that were taken."""
    dt = np.diff(imu.t)
    even = np.abs(dt - np.median(dt)) < UNEVEN * np.median(dt) if len(dt) else dt > 0.0
    return np.asarray(even & imu.valid[1:] & imu.valid[:-1])
