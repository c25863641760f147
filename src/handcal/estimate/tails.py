"""Priors with tails: what a device's errors usually are, and that some are far larger.

A prior's standard deviation is the scale of a mixture of normal densities of one centre. A scale
error of 14 % is nothing unheard of where 1 % is usual; under the normal density of 1 % alone it
would cost a hundred nats, and whatever else may stand in for half of it is believed instead. All
parameters of an effect have the same scale, as devices are good or bad. The evidence is the sum
over the scales, never the best of them.
"""

from __future__ import annotations

import math
from itertools import groupby

import numpy as np
from scipy.special import log_ndtr

from handcal.estimate.quadratic import Posterior, Quadratic, posterior
from handcal.types import Array, BoolArray, IntArray

# Scales, in standard deviations of the prior, and the share of devices that have them.
SCALES = np.array([1.0, 5.0, 25.0])
LOG_SHARES = np.log([0.9, 0.09, 0.01])
# Of a parameter within so many standard deviations the wide scales say nothing worth a pass.
NEAR = 2.0
ROUNDS = 6
NORMAL = np.array([0.0, -np.inf, -np.inf])


def tailed(
    q: Quadratic,
    index: IntArray,
    root: Array | None = None,
    positive: BoolArray | None = None,
) -> Posterior:
    """Evidence and posterior of the subset ``index`` (m,) of parameters; all others are zero.

    root (m, m): square root of the subset's prior covariance at the usual scale (None: the
    identity); positive (m,): those that cannot be negative, of whose evidence only that half
    counts, twice as dense (mean and covariance are those without this). The scales of the effects
    are summed over one by one, those of the others at their best: exact for effects that the
    recording tells apart.
    """
    effects = _effects(q, index)
    R = np.eye(len(index)) if root is None else root
    half = np.zeros(len(index), dtype=np.bool_) if positive is None else positive
    scale = np.zeros(len(effects), dtype=np.int64)
    for _ in range(ROUNDS):
        wide = R * np.repeat(SCALES[scale], [len(e) for e in effects])
        found = posterior(q, index, wide)
        shares = [
            _shares(found, R, e, int(k), half[e])
            + (LOG_SHARES if _has_tails(q, int(index[e[0]])) else NORMAL)
            for e, k in zip(effects, scale, strict=True)
        ]
        best = np.array([int(np.argmax(s)) for s in shares], dtype=np.int64)
        if np.array_equal(best, scale):
            break
        scale = best
    value = found.log_evidence + sum(float(np.logaddexp.reduce(s)) for s in shares)
    return Posterior(value, found.mean, found.covariance)


def usual(q: Quadratic, index: IntArray, root: Array | None = None) -> Posterior:
    """As ``tailed``, of the usual scale alone: what the others add is left out."""
    found = posterior(q, index, root)
    value = found.log_evidence + _left_out(q, index)
    return Posterior(value, found.mean, found.covariance)


def log_evidence(q: Quadratic, index: IntArray, root: Array | None = None) -> float:
    """As ``tailed``, only the evidence: what a search over subsets needs."""
    b, G = q.b[index], q.G[np.ix_(index, index)]
    if root is not None:
        b, G = root.T @ b, root.T @ G @ root
    L = np.linalg.cholesky(0.5 * (G + G.T) + np.eye(len(b)))
    y = np.linalg.solve(L, b)
    x = np.linalg.solve(L.T, y)
    if np.abs(x).max(initial=0.0) > NEAR:
        return tailed(q, index, root).log_evidence
    return float(q.a + 0.5 * y @ y - np.log(np.diag(L)).sum()) + _left_out(q, index)


def _left_out(q: Quadratic, index: IntArray) -> float:
    """Nats by which the usual scale alone, with its share of devices, counts for less than one."""
    count = sum(_has_tails(q, int(index[e[0]])) for e in _effects(q, index))
    return count * float(LOG_SHARES[0])


def _effects(q: Quadratic, index: IntArray) -> list[IntArray]:
    """Places in the subset of each effect's parameters, which are neighbours."""
    owners = [q.names[i][0] for i in index]
    runs = groupby(range(len(owners)), key=lambda i: owners[i])
    return [np.array(list(run), dtype=np.int64) for _, run in runs]


def _has_tails(q: Quadratic, i: int) -> bool:
    """A term that was found in a recording has a prior that suits that recording."""
    return "+=" not in q.names[i][0] and not q.names[i][0].startswith("basis:")


def _shares(found: Posterior, R: Array, mine: IntArray, scale: int, half: BoolArray) -> Array:
    """Log of what each scale (3,) of an effect is worth against the one it has in ``found``: the
    mean, over the posterior, of the ratio of the priors; half (k,): those that are positive."""
    rank = float(np.linalg.matrix_rank(R[np.ix_(mine, mine)]))
    m, C = found.mean[mine], found.covariance[np.ix_(mine, mine)]
    out = np.empty(len(SCALES))
    for k, s in enumerate(SCALES):
        tighter = 1.0 / s**2 - 1.0 / SCALES[scale] ** 2
        A = np.eye(len(m)) + tighter * C
        mean = np.linalg.solve(A, m)
        widened = rank * math.log(SCALES[scale] / s) - 0.5 * float(np.linalg.slogdet(A)[1])
        out[k] = widened - 0.5 * tighter * float(m @ mean)
        if half.any():
            sigma = np.sqrt(np.diag(np.linalg.solve(A, C)))
            out[k] += float((math.log(2.0) + log_ndtr(mean / sigma))[half].sum())
    return out
