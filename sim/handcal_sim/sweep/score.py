"""How good a calibration over time was, and how that spreads over seeds. Arrays only.

Estimates x (n, m) of m parameters at the times t (n,); errors are about the truth (m,).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
# Of the seeds; the rest lies outside, half at either end.
BAND = 0.95
SETTLED_S = 10.0
NEIGHBOURS = 20


@dataclass(frozen=True)
class Chunk:
    """Runs of one cell: k seeds, m parameters, in the units that are shown.

    names, units (m,); truth, bound (m,) at the end; scores (k, m) by quantity, and the
    sigmas that are claimed at the end; r_h (k,) rad; t (p,), series (k, p, m) of estimates.
    """

    numbers: Sequence[int]
    names: tuple[tuple[str, str], ...]
    units: tuple[str, ...]
    truth: Array
    bound: Array
    scores: Mapping[str, Array]
    r_h: Array
    t: Array
    series: Array


def converged_at(t: Array, x: Array, threshold: Array) -> Array:
    """When each parameter has converged by the rule of paper 002, section 3.3.1; NaN: never.

    The first point (1) whose distance from the mean of the last ten seconds is at most twice
    their standard deviation, and (2) about which 20 points vary by at most the threshold
    (m,), in the unit of x. (The paper does not say its threshold.)
    """
    n, m = x.shape
    at = np.full(m, np.nan)
    if n < NEIGHBOURS:
        return at
    last = x[t >= t[-1] - SETTLED_S]
    near = np.abs(x - last.mean(axis=0)) <= 2.0 * last.std(axis=0)
    steady = np.zeros((n, m), dtype=bool)
    width = n - NEIGHBOURS + 1
    steady[NEIGHBOURS // 2 : NEIGHBOURS // 2 + width] = _variation(x, width) <= threshold
    both = near & steady
    found = both.any(axis=0)
    at[found] = t[both.argmax(axis=0)[found]]
    return at


def _variation(x: Array, width: int) -> Array:
    """Largest minus smallest of each 20 points, (width, m), by doubling."""
    high, low, span = x, x, 1
    while 2 * span <= NEIGHBOURS:
        high = np.maximum(high[:-span], high[span:])
        low = np.minimum(low[:-span], low[span:])
        span *= 2
    rest = NEIGHBOURS - span
    high = np.maximum(high[:width], high[rest : rest + width])
    low = np.minimum(low[:width], low[rest : rest + width])
    return high - low


def scores(t: Array, x: Array, truth: Array, threshold: Array) -> dict[str, Array]:
    """Of one run, each (m,): convergence_s, rms_error, rms (both from then on), final_error.

    `rms_error` is what the paper calls STD: it is taken about the truth.
    """
    at = converged_at(t, x, threshold)
    rms_error, rms = np.full(len(at), np.nan), np.full(len(at), np.nan)
    for k, since in enumerate(at):
        if np.isfinite(since):
            late = x[t >= since, k]
            rms_error[k] = np.sqrt(np.mean((late - truth[k]) ** 2))
            rms[k] = np.sqrt(np.mean(late**2))
    return {"convergence_s": at, "rms_error": rms_error, "rms": rms, "final_error": x[-1] - truth}


def spread(values: Array) -> dict[str, Any]:
    """Median, central 95 % and extremes of one quantity over seeds (k,), NaN left out."""
    kept = values[np.isfinite(values)]
    if not len(kept):
        names = ("median", "low", "high", "least", "most")
        return {"n": 0, **dict.fromkeys(names)}
    tail = 0.5 * (1.0 - BAND)
    low, median, high = np.quantile(kept, [tail, 0.5, 1.0 - tail])
    return {
        "n": len(kept), "median": float(median), "low": float(low), "high": float(high),
        "least": float(kept.min()), "most": float(kept.max()),
    }  # fmt: skip


def beside(found: Mapping[str, Any], printed: float | None) -> dict[str, Any]:
    """A spread with what the paper prints, and whether that lies in the central 95 %."""
    inside = None
    if printed is not None:
        inside = bool(found["n"] and found["low"] <= printed <= found["high"])
    return {**found, "printed": printed, "inside": inside}


def final(errors: Array, sigmas: Array, bound: float) -> dict[str, Any]:
    """Final errors over seeds (k,), the sigmas (k,) that the filter claims, and the bound."""
    rms = float(np.sqrt(np.mean(errors**2)))
    return {
        "mean": float(errors.mean()), "rms": rms, "bound": bound, "over_bound": rms / bound,
        "claimed": float(np.median(sigmas)), "nees": float(np.mean((errors / sigmas) ** 2)),
    }  # fmt: skip


def bands(x: Array) -> dict[str, list[list[float]]]:
    """Median and central 95 % of series (seeds, n, m), each as (m, n) to five digits."""
    tail = 0.5 * (1.0 - BAND)
    low, median, high = np.quantile(x, [tail, 0.5, 1.0 - tail], axis=0)
    return {
        name: [[float(f"{v:.5g}") for v in row] for row in array.T]
        for name, array in (("low", low), ("median", median), ("high", high))
    }


def chunks(count: int, size: int) -> list[Sequence[int]]:
    """The numbers 0 to count - 1 in pieces of this size."""
    return [range(i, min(i + size, count)) for i in range(0, count, size)]
