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

import numpy as np

from handcal.compiled.jit import njit
from handcal.effects import catalogue
from handcal.estimate.case import name_of
from handcal.estimate.prior_scales import LOG_SHARES, SCALES, all_shares, average, posterior_at
from handcal.estimate.quadratic import Posterior, Quadratic, posterior
from handcal.types import Array, BoolArray, IntArray

# Of a parameter within so many standard deviations the wide scales say nothing worth a pass.
NEAR = 2.0
# Choices of each effect's likeliest scale, at the most; two or three settle it.
ROUNDS = 6


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
    value = tailed_at(*_prepared(q, index, root, positive), -1.0, True, mean, covariance)
    return Posterior(q.a + value, mean, covariance)


def usual(q: Quadratic, index: IntArray, root: Array | None = None) -> Posterior:
    """As ``tailed``, of the usual scale alone: what the others add is left out."""
    found = posterior(q, index, root)
    begin, tails, sparse = _effects(q, index)
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
) -> float:
    """As ``tailed``, only the evidence (of thousands of subsets see ``subsets``)."""
    mean, covariance = np.empty(len(index)), np.empty((len(index), len(index)))
    return q.a + tailed_at(*_prepared(q, index, root, positive), NEAR, False, mean, covariance)


def _prepared(
    q: Quadratic,
    index: IntArray,
    root: Array | None,
    positive: BoolArray | None,
) -> tuple[Array, Array, Array, IntArray, Array, BoolArray, BoolArray, BoolArray]:
    """b, G, R of the subset; of its effects where each begins, the rank of its prior, whether it
    has tails and is sparse; and which parameters are positive."""
    begin, tails, sparse = _effects(q, index)
    size = np.diff(begin).astype(np.float64)
    R = np.empty((0, 0)) if root is None else root
    if root is not None:
        # (of a projection the rank is the trace)
        size = np.asarray(np.round(np.add.reduceat(np.diag(R), begin[:-1])), dtype=np.float64)
    half = np.zeros(len(index), dtype=np.bool_) if positive is None else positive
    return q.b[index], q.G[index[:, None], index], R, begin, size, tails, sparse, half


def _effects(q: Quadratic, index: IntArray) -> tuple[IntArray, BoolArray, BoolArray]:
    """Where the parameters of each effect, which are neighbours, begin in the subset, and its end;
    whether its prior has tails: a term that was found in a recording has a prior that suits that
    recording; and whether it is sparse."""
    owners = [q.names[i][0] for i in index]
    begin = [n for n, owner in enumerate(owners) if n == 0 or owner != owners[n - 1]]
    tails = np.array([has_tails(owners[n]) for n in begin], dtype=np.bool_)
    sparse = np.array([is_sparse(owners[n]) for n in begin], dtype=np.bool_)
    return np.array([*begin, len(index)], dtype=np.int64), tails, sparse


def is_sparse(owner: str) -> bool:
    """Whether parameters of an effect may be zero one by one: not where they are but so many views
    of fewer (``Effect.together``), nor of a law, whose form was chosen."""
    known = catalogue().get(name_of(owner))
    return known is not None and len(known.parameters) > 1 and known.together is None


def has_tails(owner: str) -> bool:
    """Whether the prior of an effect has other scales than the usual one."""
    known = catalogue().get(owner)
    return "+=" not in owner and not owner.startswith("basis:") and (known is None or known.tails)


def wider(count: int, square: float) -> float:
    """Nats by which all scales together make so many parameters, whose squares in usual variances
    add up to this, likelier than the usual scale does."""
    each = LOG_SHARES - count * np.log(SCALES) - 0.5 * square / SCALES**2
    return float(np.logaddexp.reduce(each) - each[0])


@njit
def tailed_at(
    b: Array,
    G: Array,
    R: Array,
    begin: IntArray,
    rank: Array,
    tails: BoolArray,
    sparse: BoolArray,
    half: BoolArray,
    near: float,
    averaged: bool,
    mean: Array,
    covariance: Array,
) -> float:
    """Log-evidence against no parameter at all; mean (m,) and covariance (m, m) are written.

    near: of means within so many standard deviations the usual scale alone counts (not
    positive: never). averaged: mean and covariance over the scales, not at the best alone.
    """
    # (loops, and nothing of numpy's algebra: that took a third of all compiling on a first run)
    scale = np.zeros(len(begin) - 1, dtype=np.int64)
    more = 0.0
    for _ in range(ROUNDS):
        value = posterior_at(b, G, R, begin, scale, mean, covariance)
        if near > 0.0 and _small(mean, half, near):
            more = 0.0
            for e in range(len(scale)):
                more += LOG_SHARES[0] if tails[e] else 0.0
            break
        more, same = _summed(mean, covariance, begin, rank, tails, half, scale)
        if same:
            break
    value += more + _all_spared(mean, covariance, begin, scale, sparse)
    if averaged:
        average(b, G, R, begin, rank, tails, half, scale, mean, covariance)
    return value


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
        own = begin[e], begin[e + 1], rank[e]
        count = all_shares(mean, covariance, own, scale[e], tails[e], half, shares)
        best, total = 0, 0.0
        for k in range(count):
            if shares[k] > shares[best]:
                best = k
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
