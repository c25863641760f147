"""The overlapping Allan deviation of a rate, its degrees of freedom and its confidence band.

As in Riley, Handbook of frequency stability analysis (NIST SP 1065), 5.2.4 and 5.4; degrees of
freedom by the sum of Greenhall and Riley (2003), over the correlation of the second differences.
"""

from __future__ import annotations

import math

import numpy as np

from handcal.types import Array, HandcalError

NOISES = ("white", "flicker", "walk")  # of the rate
STEPS = 128  # of correlation in one averaging time; where there are more, it is taken at so many
LENGTHS = 3  # averaging times after which second differences no longer remember each other


def deviation(x: Array, rate_hz: float, factors: Array) -> Array:
    """Overlapping Allan deviation (m,) of readings x (n,) at averaging factors (m,).

    Errors: HandcalError where a factor is over half the record.
    """
    angle = np.r_[0.0, np.cumsum(x - x.mean())] / rate_hz
    out = np.empty(len(factors))
    for i, m in enumerate(np.round(factors).astype(int)):
        if 2 * m >= angle.size:
            raise HandcalError("The record is too short for these averaging times.")
        second = angle[2 * m :] - 2.0 * angle[m:-m] + angle[: -2 * m]
        out[i] = math.sqrt(float(second @ second) / second.size / 2.0) * rate_hz / m
    return out


def freedom(noise: str, factor: int, n: int) -> float:
    """Degrees of freedom of the variance of n readings of such noise at an averaging factor.

    Exact for white noise and for the sum of white noise, sampled.
    """
    steps = min(factor, STEPS)
    looks = (n - 2 * factor + 1) * steps / factor
    apart = np.arange(math.ceil(min(looks, LENGTHS * steps)), dtype=float)
    alike = _correlation(noise, apart, steps)
    return float(looks / (1.0 + 2.0 * ((1.0 - apart / looks) * alike**2)[1:].sum()))


def _correlation(noise: str, apart: Array, m: int) -> Array:
    """Of two second differences of the angle over m samples each, so many samples apart."""

    def angles(k: Array) -> Array:  # structure of the angle's noise, but for a factor
        k = np.abs(k)
        if noise == "white":
            return -k
        if noise == "flicker":
            return k**2 * np.log(np.maximum(k, 1.0))
        return k**3 - k  # of a sum over whole samples

    def fourth(k: Array) -> Array:
        return (angles(k - 2 * m) + angles(k + 2 * m) + 6.0 * angles(k)
                - 4.0 * (angles(k - m) + angles(k + m)))  # fmt: skip

    out: Array = fourth(apart) / fourth(np.zeros(1))
    return out


def band(dev: Array, edf: Array, within: float) -> tuple[Array, Array]:
    """Bounds (m,), (m,) that hold the true deviation with that probability: the observed variance
    is a scaled chi-square."""
    from scipy.special import gammaincinv

    def bound(p: float) -> Array:
        out: Array = dev * np.sqrt(0.5 * edf / gammaincinv(0.5 * edf, p))
        return out

    return bound(0.5 * (1.0 + within)), bound(0.5 * (1.0 - within))
