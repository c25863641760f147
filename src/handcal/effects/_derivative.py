"""Time derivative of sampled signals (no effect of its own: several need it)."""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from handcal.types import Array, BoolArray

# Half the width, s, of the cubic that is fitted around each sample.
REACH_S = 0.01
# Of a spectrum: samples taken at a time, from which share of the highest frequency on it is noise,
# and by how many standard deviations power must exceed that to be motion.
SEGMENT, NOISE_FROM, SURE = 256, 0.8, 1.0
# As near to an end a slope is read off the samples themselves, s.
ENDS_S = 0.2


@cache
def _weights(m: int) -> Array:
    """Slope at the middle of a cubic fitted to 2 m + 1 samples, by sample number.

    For m = 2 the central difference of fourth order, (1, -8, 0, 8, -1) / 12.
    """
    k = np.arange(-m, m + 1)
    slope: Array = np.linalg.pinv(np.vander(k.astype(float), 4, increasing=True))[1]
    return slope


def reach(t: Array) -> int:
    """How many samples to either side a derivative at times t (n,) depends on."""
    return max(2, round(REACH_S * (len(t) - 1) / float(t[-1] - t[0])))


def sound(_: Array, t: Array, valid: BoolArray) -> BoolArray:
    """Which readings (n,) have a derivative at t (n,) that is made of measurements alone."""
    width = 2 * reach(t) + 1
    return np.asarray(valid & (np.convolve(~valid, np.ones(width), mode="same") < 0.5))


def derivative(t: Array, x: Array) -> Array:
    """dx/dt (n, 3) of x (n, 3) at times t (n,), which may be slightly irregular.

    At 200 Hz and below the central difference of fourth order; at higher rates the slope of
    a cubic over 20 ms, which amplifies the noise of single samples less. Times count
    like a signal, so that irregular ones do no harm to first order. At both ends the last
    slope is kept: one-sided differences would be noisier than all others.
    """
    m = reach(t)
    if len(t) <= 2 * m:
        return np.asarray(np.gradient(x, t, axis=0))
    weights = _weights(m)[::-1]
    out = np.empty_like(x)
    step = np.convolve(t - t[0], weights, mode="valid")
    for i in range(x.shape[1]):
        out[m:-m, i] = np.convolve(x[:, i], weights, mode="valid") / step
    out[:m], out[-m:] = out[m], out[-m - 1]
    return out


def quiet_derivative(t: Array, x: Array, at: Array) -> Array:
    """dx/dt (k, m) at the times ``at`` (k,) of x (n, m) at times t (n,), without what noise adds.

    Beside a reference that would be part of what is fitted to what: it made lever arms shorter,
    in a slow motion by a tenth. So of each frequency as much is kept as is motion (Wiener's
    filter), which is what the readings let expect, and a fit to that is right in the mean. The
    filter is as long after a sample as before it, so a sample's own noise is not in its slope.
    """
    from scipy.interpolate import CubicSpline
    from scipy.signal import welch

    if not np.isfinite(x).all():
        return np.full((len(at), x.shape[1]), np.nan)
    step = float(np.median(np.diff(t)))
    even = np.arange(t[0], t[-1] + 0.5 * step, step)
    spline = CubicSpline(t, x)
    value = spline(np.minimum(even, t[-1]))
    trend = np.linspace(0.0, 1.0, len(even))[:, None] * (value[-1] - value[0])
    count = 1 << (len(even) - 1).bit_length()
    # (what is left begins and ends alike; zeros behind it keep the ends apart)
    spectrum = np.fft.rfft(value - value[0] - trend, 2 * count, axis=0)
    f = np.fft.rfftfreq(2 * count, step)
    # (of the samples themselves: what is interpolated has less noise where most of it is)
    bins, power = welch(x, 1.0 / step, nperseg=min(SEGMENT, len(x)), axis=0)
    chance = 1.0 + SURE / math.sqrt(max(1.0, 2.0 * len(x) / SEGMENT - 1.0))
    floor = chance * np.median(power[bins > NOISE_FROM * bins[-1]], axis=0)
    kept = np.clip(1.0 - floor / np.maximum(power, 1e-300), 0.0, 1.0)
    gain = np.stack([np.interp(f, bins, kept[:, i]) for i in range(x.shape[1])], axis=1)
    slope = np.fft.irfft(spectrum * gain * (2j * np.pi * f)[:, None], axis=0)[: len(even)]
    slope += (value[-1] - value[0]) / (even[-1] - even[0])
    out = np.asarray(CubicSpline(even, slope)(np.clip(at, even[0], even[-1])))
    # (the filter goes on before the beginning and after the end, and rings there)
    ends = np.minimum(at - t[0], t[-1] - at) < ENDS_S
    out[ends] = spline(at[ends], 1)
    return out
