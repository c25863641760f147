"""Priors with tails: what a device's errors usually are, and that some are far larger.

A prior's standard deviation is the scale of a mixture of normal densities of one centre. A scale
error of 14 % is nothing unheard of where 1 % is usual; under the normal density of 1 % alone it
would cost a hundred nats, and whatever else may stand in for half of it is believed instead. All
parameters of an effect have the same scale, as devices are good or bad. The evidence is the sum
over the scales, never the best of them.

And of an effect with several parameters each is as likely zero as not: the gyro's x axis may have a
scale error and the others none. Were that not in the prior, a law of that one axis, which has but
one number to pay for, would be believed instead. Of each parameter, the density at zero after the
recording over that before it is the odds of its absence, all else being there (Savage and Dickey's
ratio); the evidence is the mean of both, and mean and covariance are those without this.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from handcal.compiled.dense import congruent, forward, forward_rows, gram, rooted
from handcal.compiled.jit import njit
from handcal.effects import catalogue
from handcal.estimate.case import name_of
from handcal.estimate.quadratic import Posterior, Quadratic, posterior
from handcal.types import Array, BoolArray, IntArray

# Scales, in standard deviations of the prior, and the share of devices that have them.
SCALES = np.array([1.0, 5.0, 25.0])
LOG_SHARES = np.log([0.9, 0.09, 0.01])
# Of a parameter within so many standard deviations the wide scales say nothing worth a pass.
NEAR = 2.0
ROUNDS = 6
# Below this the logarithm of the normal distribution function is that of its asymptote.
FAR_BELOW = -20.0


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
    mean, covariance = np.empty(len(index)), np.empty((len(index), len(index)))
    value = _tailed(*_prepared(q, index, root, positive), -1.0, mean, covariance)
    return Posterior(q.a + value, mean, covariance)


def usual(q: Quadratic, index: IntArray, root: Array | None = None) -> Posterior:
    """As ``tailed``, of the usual scale alone: what the others add is left out."""
    found = posterior(q, index, root)
    begin, tails, sparse = _effects(q, index, None)
    left_out = tails.sum() * float(LOG_SHARES[0])
    for e in np.flatnonzero(sparse):
        own = slice(begin[e], begin[e + 1])
        variance = np.diag(found.covariance)[own]
        left_out += sum(_spared(m, v, 1.0) for m, v in zip(found.mean[own], variance, strict=True))
    return Posterior(found.log_evidence + left_out, found.mean, found.covariance)


def log_evidence(
    q: Quadratic,
    index: IntArray,
    root: Array | None = None,
    positive: BoolArray | None = None,
    owners: Owners | None = None,
) -> float:
    """As ``tailed``, only the evidence: what a search over subsets needs, which knows the
    ``owners`` of all parameters beforehand."""
    mean, covariance = np.empty(len(index)), np.empty((len(index), len(index)))
    return q.a + _tailed(*_prepared(q, index, root, positive, owners), NEAR, mean, covariance)


@dataclass(frozen=True)
class Owners:
    """Of each parameter of a quadratic (k,): a number that is its effect's own, whether the prior
    has tails, and whether it may be zero while others of the effect are not."""

    number: IntArray
    tails: BoolArray
    sparse: BoolArray


def owners_of(q: Quadratic) -> Owners:
    """Whose the parameters of a quadratic are."""
    at: dict[str, int] = {}
    number = np.array([at.setdefault(n[0], len(at)) for n in q.names], dtype=np.int64)
    tails = np.array([_has_tails(owner) for owner in at], dtype=np.bool_)
    sparse = np.array([_is_sparse(owner) for owner in at], dtype=np.bool_)
    return Owners(number, tails[number], sparse[number]) if at else Owners(number, tails, sparse)


def _prepared(
    q: Quadratic,
    index: IntArray,
    root: Array | None,
    positive: BoolArray | None,
    owners: Owners | None = None,
) -> tuple[Array, Array, Array, IntArray, Array, BoolArray, BoolArray, BoolArray]:
    """b, G, R of the subset; of its effects where each begins, the rank of its prior, whether it
    has tails and is sparse; and which parameters are positive."""
    begin, tails, sparse = _effects(q, index, owners)
    size = np.diff(begin).astype(np.float64)
    R = np.empty((0, 0)) if root is None else root
    if root is not None:
        # (of a projection the rank is the trace)
        size = np.asarray(np.round(np.add.reduceat(np.diag(R), begin[:-1])), dtype=np.float64)
    half = np.zeros(len(index), dtype=np.bool_) if positive is None else positive
    return q.b[index], q.G[index[:, None], index], R, begin, size, tails, sparse, half


def _effects(
    q: Quadratic, index: IntArray, owners: Owners | None
) -> tuple[IntArray, BoolArray, BoolArray]:
    """Where the parameters of each effect, which are neighbours, begin in the subset, and its end;
    whether its prior has tails: a term that was found in a recording has a prior that suits that
    recording; and whether it is sparse."""
    owners = owners_of(q) if owners is None else owners
    number = owners.number[index]
    begin = np.flatnonzero(np.diff(number, prepend=-1))
    first = index[begin]
    return np.append(begin, len(index)), owners.tails[first], owners.sparse[first]


def _is_sparse(owner: str) -> bool:
    """Whether parameters of an effect may be zero one by one: not where they are but so many views
    of fewer (``Effect.together``), nor of a law, whose form was chosen."""
    known = catalogue().get(name_of(owner))
    return known is not None and len(known.parameters) > 1 and known.together is None


def _has_tails(owner: str) -> bool:
    known = catalogue().get(owner)
    return "+=" not in owner and not owner.startswith("basis:") and (known is None or known.tails)


@njit
def _tailed(
    b: Array,
    G: Array,
    R: Array,
    begin: IntArray,
    rank: Array,
    tails: BoolArray,
    sparse: BoolArray,
    half: BoolArray,
    near: float,
    mean: Array,
    covariance: Array,
) -> float:
    """Log-evidence against no parameter at all; mean (m,) and covariance (m, m) are written.

    near: of means within so many standard deviations the usual scale alone counts (not
    positive: never).
    """
    # (loops, and nothing of numpy's algebra: that took a third of all compiling on a first run)
    scale = np.zeros(len(begin) - 1, dtype=np.int64)
    more = 0.0
    for _ in range(ROUNDS):
        value = _posterior(b, G, R, begin, scale, mean, covariance)
        if near > 0.0 and _small(mean, half, near):
            more = 0.0
            for e in range(len(scale)):
                more += LOG_SHARES[0] if tails[e] else 0.0
            break
        more, same = _summed(mean, covariance, begin, rank, tails, half, scale)
        if same:
            break
    return value + more + _all_spared(mean, covariance, begin, scale, sparse)


@njit
def _small(mean: Array, half: BoolArray, near: float) -> bool:
    """Whether no mean is beyond this, and none must be positive."""
    small = True
    for i in range(len(mean)):
        small = small and not half[i] and abs(mean[i]) <= near
    return small


@njit
def _summed(
    mean: Array,
    covariance: Array,
    begin: IntArray,
    rank: Array,
    tails: BoolArray,
    half: BoolArray,
    scale: IntArray,
) -> tuple[float, bool]:
    """Log of the sum over the scales of each effect, those of the others as they are; and whether
    each effect has its best scale already, which is written."""
    out, same = 0.0, True
    shares = np.empty(len(SCALES))
    for e in range(len(scale)):
        count = len(SCALES) if tails[e] else 1
        best = 0
        for k in range(count):
            shares[k] = _share(
                mean, covariance, begin[e], begin[e + 1], rank[e], SCALES[scale[e]], SCALES[k], half
            )
            if tails[e]:
                shares[k] += LOG_SHARES[k]
            if shares[k] > shares[best]:
                best = k
        total = 0.0
        for k in range(count):
            total += math.exp(shares[k] - shares[best])
        out += shares[best] + math.log(total)
        same = same and best == scale[e]
        scale[e] = best
    return out, same


@njit
def _all_spared(
    mean: Array, covariance: Array, begin: IntArray, scale: IntArray, sparse: BoolArray
) -> float:
    """Nats of evidence that the sparse effects gain as any of their parameters may be zero."""
    out = 0.0
    for e in range(len(sparse)):
        if sparse[e]:
            for i in range(begin[e], begin[e + 1]):
                out += _spared(mean[i], covariance[i, i], SCALES[scale[e]])
    return out


@njit
def _spared(m: float, variance: float, scale: float) -> float:
    """The same of one parameter of this mean and variance, its prior being of that scale."""
    absent: float = -0.5 * m**2 / variance + math.log(scale) - 0.5 * math.log(variance)
    # log of the mean of 1 and exp(absent)
    return max(absent, 0.0) + math.log1p(math.exp(-abs(absent))) - math.log(2.0)


@njit
def _posterior(
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
