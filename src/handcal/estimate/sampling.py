"""What a sensor did between its samples: what straight lines between the readings miss of it.

Of a rate that is a random walk, straight lines between the samples are the best that one can know;
of a smooth one they are too low wherever it bends, by a twelfth of the second difference (the
cubic rule of integration, weights -1, 13, 13, -1 over 24). At 190 Hz, in a hand that shakes, that
is as much as a gyro's low-pass of 4 ms, and was told as one.
"""

from __future__ import annotations

import numpy as np

from handcal.types import Array, Imu

# Of the cubic rule's correction: half-way between a rough motion and a smooth one. Nats better than
# straight lines: 55 in a simulated hand that shakes (all of the correction: 64), 756 and 38 in a
# fast BROAD trial and a phone beside its camera (-535, 40); -106 (-258), -5 (-13), -3 (-7), -3 (-6)
# in a slow one, on a flying robot and in two phones, where what is simplest remains the best.
SMOOTH = 0.5
# Intervals that differ from the usual one by more than this share of it are no such samples.
UNEVEN = 0.25


def at_nodes(imu: Imu, readings: Array, t: Array) -> tuple[Array, Array, Array]:
    """Rate, force (m, 3) and what integration adds to both (m, 6), at times t (m,), of readings
    (n, 6) at the IMU's samples."""
    return (
        interpolated(t, imu.t, readings[:, :3]),
        interpolated(t, imu.t, readings[:, 3:]),
        between_samples(imu, readings, t),
    )


def interpolated(t: Array, t_old: Array, x: Array) -> Array:
    """Columns x (k, m) at times t_old (k,), on straight lines at times t (n,)."""
    out = np.empty((len(t), x.shape[1]))
    for i in range(x.shape[1]):
        out[:, i] = np.interp(t, t_old, x[:, i])
    return out


def between_samples(imu: Imu, readings: Array, t: Array) -> Array:
    """What has to be added (m, k) at times t (m,) to readings (n, k) at the IMU's samples, so that
    straight lines have the integral."""
    out = np.zeros_like(readings)
    if len(imu.t) > 2:
        dt = np.diff(imu.t)
        even = np.abs(dt - np.median(dt)) < UNEVEN * np.median(dt)
        even &= imu.valid[1:] & imu.valid[:-1]
        bends = readings[2:] - 2.0 * readings[1:-1] + readings[:-2]
        out[1:-1] = np.where((even[1:] & even[:-1])[:, None], -SMOOTH / 12.0 * bends, 0.0)
    return interpolated(t, imu.t, out)
