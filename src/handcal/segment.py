"""Finds where the device rests, from the readings alone."""

from __future__ import annotations

import numpy as np

from handcal.types import Array, Recording

WINDOW_S = 0.5
MIN_REST_S = 0.8
# A device lying on a table or held still turns slower than this and trembles less.
MAX_RATE = np.radians(4.0)
MAX_RATE_SPREAD = np.radians(2.5)
MAX_FORCE_SPREAD = 0.35
# A turn at a constant rate ripples by less than this part of it.
MAX_RIPPLE = 0.004


def _moving(x: Array, width: int) -> tuple[Array, Array]:
    """Centred moving mean and variance (n, d) of x (n, d) over ``width`` samples."""
    pad = width // 2
    padded = np.pad(x, ((pad, width - 1 - pad), (0, 0)), mode="edge")
    s1 = np.cumsum(np.vstack([np.zeros(x.shape[1]), padded]), axis=0)
    s2 = np.cumsum(np.vstack([np.zeros(x.shape[1]), padded**2]), axis=0)
    mean = (s1[width:] - s1[:-width]) / width
    variance = (s2[width:] - s2[:-width]) / width - mean**2
    return mean, np.maximum(variance, 0.0)


def spreads(recording: Recording) -> tuple[Array, Array]:
    """Standard deviation over half a second of gyro (n,) rad/s and accelerometer (n,) m/s^2."""
    imu = recording.imu
    width = max(5, round(WINDOW_S * recording.rate_hz))
    _, g = _moving(imu.gyro - imu.gyro.mean(0), width)
    _, a = _moving(imu.accel - imu.accel.mean(0), width)
    return np.sqrt(g.sum(1)), np.sqrt(a.sum(1))


def rests(recording: Recording) -> Array:
    """Rests as (r, 2) start and end, s; each at least 0.8 s long.

    A sample rests if, over half a second around it, gyro and accelerometer spread little
    more than they do in the quietest tenth of the recording (and less than a fixed limit),
    and the mean rate is that of the gyro bias: of the quiet stretch with the least rate. A
    steady turn about the vertical is quiet too, and may be the longest, but it turns faster.
    """
    imu = recording.imu
    gyro_spread, accel_spread = spreads(recording)
    width = max(5, round(WINDOW_S * recording.rate_hz))
    quiet = np.ones(len(imu.t), dtype=bool)
    for spread, limit in ((gyro_spread, MAX_RATE_SPREAD), (accel_spread, MAX_FORCE_SPREAD)):
        floor = float(np.quantile(spread, 0.1))
        quiet &= spread < min(max(3.0 * floor, 0.1 * limit), limit)
    quiet &= imu.valid
    mean, _ = _moving(imu.gyro, width)
    runs = _runs(quiet, imu.t, MIN_REST_S)
    if not len(runs):
        return np.zeros((0, 2))
    bias = min((mean[a:b].mean(axis=0) for a, b in runs), key=lambda rate: float(rate @ rate))
    if np.linalg.norm(bias) > np.radians(20.0):
        return np.zeros((0, 2))
    quiet &= np.linalg.norm(mean - bias, axis=1) < MAX_RATE
    found = _runs(quiet, imu.t, MIN_REST_S)
    # the window reaches into the motion on both sides of a rest
    margin = 0.25 * WINDOW_S
    out = [(imu.t[a] + margin, imu.t[b - 1] - margin) for a, b in found]
    if out and found[0][0] == 0:
        out[0] = (imu.t[0], out[0][1])
    if out and found[-1][1] == len(imu.t):
        out[-1] = (out[-1][0], imu.t[-1])
    return np.array(out).reshape(-1, 2)


def steady(recording: Recording) -> Array:
    """Rests and turns at a constant rate as (s, 2) start and end, s; each at least 0.8 s long.

    The rate of a turn may ripple by a part of itself; the force may be anything, since a turn
    about an axis that is not vertical carries gravity around.
    """
    imu = recording.imu
    spread, _ = spreads(recording)
    width = max(5, round(WINDOW_S * recording.rate_hz))
    mean, _ = _moving(imu.gyro, width)
    floor = float(np.quantile(spread, 0.1))
    limit = np.maximum(3.0 * floor, 0.1 * MAX_RATE_SPREAD)
    limit = np.maximum(limit, MAX_RIPPLE * np.linalg.norm(mean, axis=1))
    found = _runs((spread < np.minimum(limit, MAX_RATE_SPREAD)) & imu.valid, imu.t, MIN_REST_S)
    margin = 0.25 * WINDOW_S
    out = [(imu.t[a] + margin, imu.t[b - 1] - margin) for a, b in found]
    return np.array(out).reshape(-1, 2)


def _runs(mask: np.ndarray, t: Array, shortest: float) -> list[tuple[int, int]]:
    """Half-open index runs where mask holds for at least ``shortest`` seconds."""
    edge = np.flatnonzero(np.diff(np.r_[0, mask.astype(np.int8), 0]))
    pairs = edge.reshape(-1, 2)
    return [(int(a), int(b)) for a, b in pairs if t[b - 1] - t[a] >= shortest]
