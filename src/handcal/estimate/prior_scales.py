"""One scale of a prior against another: posteriors at given scales of the effects, what a scale is
worth, and the mean over the scales."""

from __future__ import annotations

import math

import numpy as np

from handcal.compiled.dense import congruent, forward, forward_rows, gram, rooted
from handcal.compiled.jit import njit
from handcal.types import Array, BoolArray, IntArray

# Scales, in standard deviations of the prior, and the share of devices that have them.
SCALES = np.array([1.0, 5.0, 25.0])
LOG_SHARES = np.log([0.9, 0.09, 0.01])
# Below this the logarithm of the normal distribution function is that of its asymptote.
FAR_BELOW = -20.0
# Share of a scale below which its mean is not worth a factorisation.
LEAST = 1e-3


@njit
def posterior_at(
    b: Array, G: Array, R: Array, begin: IntArray, scale: IntArray, mean: Array, C: Array
) -> float:
    """``quadratic.posterior`` at these scales of the effects: log-evidence, mean (m,), C (m, m).
    R (m, m), or (0, 0) for the identity."""
    m = len(b)
    rows = np.zeros((m, m))
    for e in range(len(scale)):
        for j in range(begin[e], begin[e + 1]):
            rows[j, j] = SCALES[scale[e]]
            for i in range(len(R)):
                rows[j, i] = R[i, j] * SCALES[scale[e]]
    A = congruent(rows, G, len(R) == 0)
    y = np.zeros(m)
    for i in range(m):
        A[i, i] += 1.0
        for k in range(m):
            y[i] += rows[i, k] * b[k]
    if not rooted(A):
        for i in range(m):
            mean[i] = 0.0
            for j in range(m):
                C[i, j] = 0.0
        return -np.inf
    forward(A, y)
    forward_rows(A, rows, len(R) == 0)
    gram(rows, y, mean, C, len(R) == 0)
    value = 0.0
    for i in range(m):
        value += 0.5 * y[i] * y[i] - math.log(A[i, i])
    return value


@njit
def _share(
    mean: Array,
    covariance: Array,
    first: int,
    last: int,
    rank: float,
    now: float,
    new: float,
    half: BoolArray,
) -> float:
    """Log of what a scale of an effect's prior is worth against the one it has in the posterior,
    the effect's parameters being those from first to last: the mean, over the posterior, of the
    ratio of the priors; half: those that are positive."""
    k = last - first
    tighter = 1.0 / new**2 - 1.0 / now**2
    # E exp(-t u'u / 2) for u ~ N(m, C), with C = S S', is |I + t S'S|^-1/2 times an exponential
    A = np.zeros((k, k))
    x = np.zeros(k)
    for i in range(k):
        x[i] = mean[first + i]
        for j in range(k):
            A[i, j] = tighter * covariance[first + i, first + j]
        A[i, i] += 1.0
    # (positive: no posterior is wider than its prior, but for round-off)
    if not rooted(A):
        return -np.inf
    forward(A, x)
    out: float = rank * math.log(now / new)
    for i in range(k):
        out -= math.log(A[i, i]) + 0.5 * tighter * x[i] ** 2
    return out + _positive_share(A, x, covariance, first, half)


@njit
def all_shares(
    mean: Array,
    covariance: Array,
    own: tuple[int, int, float],
    now: int,
    tailed: bool,
    half: BoolArray,
    out: Array,
) -> int:
    """How many scales an effect's prior has; of each the log of what it is worth against the one
    ``now`` (see ``_share``), with its share of devices, is written. own: first parameter, the one
    after the last, rank."""
    first, last, rank = own
    count = len(SCALES) if tailed else 1
    for k in range(count):
        out[k] = _share(mean, covariance, first, last, rank, SCALES[now], SCALES[k], half)
        if tailed:
            out[k] += LOG_SHARES[k]
    return count


@njit
def average(
    b: Array,
    G: Array,
    R: Array,
    begin: IntArray,
    rank: Array,
    tails: BoolArray,
    half: BoolArray,
    scale: IntArray,
    mean: Array,
    covariance: Array,
) -> None:
    """Mean and covariance, those at the best scales, become those over the scales of each effect,
    the others at their best. (Covariance that narrower scales would take away stays: of several
    effects that go together, more than all of it might go.)

    (At the best scale alone the mean jumps where another becomes the better one, and a fit that is
    moved there goes to and fro between the two.)
    """
    m = len(mean)
    other, C, shares = np.empty(m), np.empty((m, m)), np.empty(len(SCALES))
    best_mean, best_C = mean.copy(), covariance.copy()
    for e in range(len(scale)):
        if not tails[e]:
            continue
        now = scale[e]
        own = begin[e], begin[e + 1], rank[e]
        all_shares(best_mean, best_C, own, now, True, half, shares)
        shares -= shares.max()
        total = np.exp(shares).sum()
        moved = np.zeros(m)
        for k in range(len(SCALES)):
            weight = math.exp(shares[k]) / total
            if k == now or weight < LEAST:
                continue
            scale[e] = k
            posterior_at(b, G, R, begin, scale, other, C)
            for i in range(m):
                other[i] -= best_mean[i]
                moved[i] += weight * other[i]
            for i in range(m):
                for j in range(m):
                    more = C[i, j] - best_C[i, j] if k > now else 0.0
                    covariance[i, j] += weight * (other[i] * other[j] + more)
        scale[e] = now
        for i in range(m):
            mean[i] += moved[i]
            for j in range(m):
                covariance[i, j] -= moved[i] * moved[j]


@njit
def _positive_share(L: Array, x: Array, covariance: Array, first: int, half: BoolArray) -> float:
    """What it is worth that some of an effect's parameters are positive: of root L (k, k) and
    L^-1 m in x (k,)."""
    k = len(x)
    out = 0.0
    row, column = np.zeros(k), np.zeros(k)
    for i in range(k):
        if not half[first + i]:
            continue
        # row i of (L L')^-1, on m and on the covariance's column i
        for j in range(k):
            row[j] = 1.0 if i == j else 0.0
            column[j] = covariance[first + j, first + i]
        forward(L, row)
        forward(L, column)
        value, spread = 0.0, 0.0
        for j in range(k):
            value += row[j] * x[j]
            spread += row[j] * column[j]
        out += math.log(2.0) + _log_normal(value / math.sqrt(spread))
    return out


@njit
def _log_normal(x: float) -> float:
    """Log of the normal distribution function."""
    if x < FAR_BELOW:
        return -0.5 * x * x - math.log(-x) - 0.5 * math.log(2.0 * math.pi)
    return math.log(0.5 * math.erfc(-x / math.sqrt(2.0)))
