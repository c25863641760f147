"""Time derivative of sampled signals (no effect of its own: several need it)."""

from __future__ import annotations

from functools import cache

import numpy as np

from handcal.types import Array

# Half the width, s, of the cubic that is fitted around each sample.
REACH_S = 0.01


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
