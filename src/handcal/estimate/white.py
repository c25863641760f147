"""How noisy the readings themselves show a sensor to be."""

from __future__ import annotations

import math

import numpy as np

from handcal.types import Recording


def white_levels(recording: Recording) -> dict[str, float]:
    """White noise densities of gyro and accelerometer, a first guess from the readings.

    Fourth differences hardly see the motion of a hand (at 100 Hz, tremor of 10 Hz counts
    less than a thousandth), and the quieter third of half-second windows holds the least.
    """
    imu, fs = recording.imu, recording.rate_hz
    out = {}
    for name, x in (("gyro_noise", imu.gyro), ("accel_noise", imu.accel)):
        d4 = np.diff(x, n=4, axis=0)
        width = max(10, round(0.5 * fs))
        m = len(d4) // width
        if m == 0:
            variance = float(d4.var(axis=0).mean())
        else:
            windows = (d4[: m * width].reshape(m, width, 3) ** 2).mean(axis=(1, 2))
            variance = float(np.quantile(windows, 0.3))
        quantum = 1e-9
        out[name] = math.sqrt(max(variance / 70.0, quantum**2) / fs)
    return out
