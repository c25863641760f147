"""Rates for a table with three axes that tell a gyro's parameters best."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from handcal.effects import Effect
from handcal.estimate import regression
from handcal.lab.known_input import KnownInput
from handcal.lab.steady_tests import design, of_arrays
from handcal.types import Array, IntArray

STARTS = 20


def best_rates(effects: Sequence[Effect], limit: float, n: int = 10) -> Array:
    """n rates (n, 3), every axis at rest or at +-limit, with the largest determinant of the
    information on these effects (exchanges from random sets; the same at every call)."""
    levels = np.array(list(np.ndindex(3, 3, 3))) - 1.0
    J = _design(effects, limit * levels)
    size = np.abs(J).max(axis=(0, 1))
    each = np.einsum("nmi,nmj->nij", J / size, J / size)
    rng = np.random.default_rng(0)
    ways = [_exchanged(each, rng.integers(0, len(levels), n)) for _ in range(STARTS)]
    chosen = max(ways, key=lambda way: _determinant(each[way].sum(axis=0)))
    return limit * levels[np.sort(chosen)]


def _exchanged(each: Array, chosen: IntArray) -> IntArray:
    best = _determinant(each[chosen].sum(axis=0))
    while True:
        before = best
        for k in range(len(chosen)):
            others = each[chosen].sum(axis=0) - each[chosen[k]]
            score = _determinant(others + each)
            c = int(np.argmax(score))
            if score[c] > best + 1e-9:
                chosen[k], best = c, score[c]
        if best == before:
            return chosen


def _determinant(M: Array) -> Array:
    sign, log = np.linalg.slogdet(M)
    return np.asarray(np.where(sign > 0.0, log, -1e3))


def _design(effects: Sequence[Effect], rates: Array) -> Array:
    zero = np.zeros_like(rates)
    bench = of_arrays(rates, None, zero, None)
    x = np.zeros(sum(len(e.parameters) for e in effects))
    return design(bench, effects, x, bench.truth)[:, :3]


def magnification(effects: Sequence[Effect], rates: Array) -> Array:
    """Standard deviations (k,) of the parameters for gyro readings of standard deviation 1."""
    A = _design(effects, rates)
    return regression.least_squares(A.reshape(-1, A.shape[2]), np.zeros(3 * len(rates))).sigma


def proposal(result: KnownInput) -> tuple[Array, Array] | None:
    """Ten rates (10, 3) rad/s, each axis as fast as the fastest of these tests, and how many
    times better each parameter (k,) would be told; None where no gyro was read."""
    effects = [e for e in result.effects if e.id.startswith("gyro")]
    rates = result.bench.mean(result.bench.truth.gyro)
    limit = float(np.abs(rates).max())
    if not effects or not result.bench.used[:3].any() or limit == 0.0:
        return None
    better = best_rates(effects, limit)
    return better, magnification(effects, rates) / magnification(effects, better)
