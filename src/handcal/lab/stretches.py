"""Averaged readings of stretches in which nothing changes, and how well each mean is known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from handcal.signals import temperature_of
from handcal.types import Array, BoolArray, IntArray, Recording

BLOCKS = 8
# Sum of squares of the fourth difference's weights: it amplifies white noise by that.
FOURTH = 70
# What a perfect recording is taken to be good for: rad/s, m/s^2.
PERFECT = 1e-11


@dataclass(frozen=True)
class Means:
    """Of r stretches.

    span (r, 2): start and end, s; first, last (r,): indices of their samples, inclusive.
    count (r,): of samples that are measurements. reading (r, 6): mean of gyro rad/s and
    accelerometer m/s^2. variance (r, 6): of that mean, from the noise of this stretch and the
    means of blocks, so that noise that is not white counts as much as it should. temperature
    (r,) degC or None. white (6,): power of the noise of all, variance times time.
    """

    span: Array
    first: IntArray
    last: IntArray
    count: Array
    reading: Array
    variance: Array
    temperature: Array | None
    white: Array

    def __len__(self) -> int:
        return len(self.span)

    def only(self, chosen: BoolArray) -> Means:
        """Some of the stretches."""
        T = None if self.temperature is None else self.temperature[chosen]
        return Means(self.span[chosen], self.first[chosen], self.last[chosen], self.count[chosen],
                     self.reading[chosen], self.variance[chosen], T, self.white)  # fmt: skip


def means(recording: Recording, spans: Array) -> Means:
    """Averages over stretches spans (r, 2), s, of the samples that are measurements."""
    imu = recording.imu
    raw = np.hstack([imu.gyro, imu.accel])
    warm = temperature_of(recording)
    ends = [(np.searchsorted(imu.t, a), np.searchsorted(imu.t, b, side="right")) for a, b in spans]
    own = [raw[a:b][imu.valid[a:b]] for a, b in ends]
    reading = np.array([x.mean(axis=0) for x in own]).reshape(-1, 6)
    T = [] if warm is None else [warm[a:b].mean() for a, b in ends]
    # how much more a mean scatters than white noise would make it is one figure for all
    # stretches, how loud each is its own
    loud = np.array([np.maximum(x.var(axis=0), _quantum(x) ** 2 / 12.0) for x in own])
    loud = loud.reshape(-1, 6) + PERFECT**2
    excess, count = (
        noise_power([x / np.sqrt(v) for x, v in zip(own, loud, strict=True)])
        if own else (np.zeros(6), np.zeros(0))
    )  # fmt: skip
    power = excess * loud
    variance = power / np.maximum(count, 1.0)[:, None] + PERFECT**2
    white = np.average(power, axis=0, weights=count) if own else np.zeros(6)
    first, last = np.array(ends, dtype=np.int64).reshape(-1, 2).T
    return Means(
        np.asarray(spans), first, last - 1, count, reading, variance,
        np.array(T) if T else None, white / recording.rate_hz,
    )  # fmt: skip


def _quantum(x: Array) -> Array:
    """Least change (d,) from one sample of x (n, d) to the next: a converter's step."""
    change = np.abs(np.diff(x, axis=0))
    least = np.where(change > 0.0, change, np.inf).min(axis=0)
    return np.asarray(np.where(np.isfinite(least), least, 0.0))


def noise_power(stretches: Sequence[Array]) -> tuple[Array, Array]:
    """Variance (d,) of a sample, and number (r,) of samples, of stretches (n_i, d).

    From the means of blocks, multiplied by their length, so that noise that is not white
    counts in a mean as much as it should. One figure for all stretches: of so few blocks each
    alone would be a poor one.
    """
    power, count = [], []
    for x in stretches:
        blocks = [block.mean(axis=0) for block in np.array_split(x, min(BLOCKS, len(x)))]
        power.append(np.var(blocks, axis=0, ddof=1) * (len(x) / len(blocks)))
        count.append(float(len(x)))
    return np.asarray(np.average(power, axis=0, weights=count)), np.array(count)


def white_variance(x: Array) -> Array:
    """Variance (d,) of the white noise in x (n, d) about a cubic through five samples at a time."""
    rough = np.diff(x, n=4, axis=0)
    return np.asarray((rough**2).mean(axis=0) / FOURTH)


def extra_variance(residual: Array, variance: Array, dof: float) -> float:
    """What variances (m,) lack so that residuals (m,) are as large as they should be.

    The moment estimate of Paule and Mandel (J. Res. NBS 87, 1982): the sum of
    residual^2 / (variance + extra) is ``dof``; 0 where it is less already.
    """

    def excess(extra: float) -> float:
        return float((residual**2 / (variance + extra)).sum()) - dof

    if dof <= 0.0 or excess(0.0) <= 0.0:
        return 0.0
    high = 1.001 * float((residual**2).sum()) / dof
    return float(brentq(excess, 0.0, max(high, 1e-300), xtol=1e-4 * high))
