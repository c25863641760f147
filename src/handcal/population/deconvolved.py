"""Mean, spread and tail of the true errors of a population, the estimates' sigmas deconvolved.

Each device's estimate is its true error plus what its own sigma allows, and the true errors are
drawn from one density. That density's numbers maximise the product of the estimates' marginal
likelihoods (empirical Bayes; Efron & Morris, JASA 70, 1975); how well they are known, the same
function says: over the spread it is integrated on a grid, over the mean by its curvature there.
The density is normal or Student's t, whichever has the more evidence.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from handcal.population.grouped import Devices, devices
from handcal.types import Array, HandcalError, IntArray

# Degrees of freedom on trial beside the normal density (infinite): one device in 40, 150 and 600
# is beyond four spreads; of a normal population one in 16,000. Below 3 no variance would exist.
TAILS = (math.inf, 10.0, 5.0, 3.0)
# Nats by which a tail must be the better before a population has one: of a normal population a
# ratio of evidence is above 10 in at most one of 10 (Markov's inequality), and three are tried.
SURE = math.log(30.0)
# Nodes of Student's t as a mixture of normal densities: its log-density is right to 0.01 nats
# within six spreads (measured against scipy's).
NODES = 24
# Spreads on trial, as parts of the raw scatter, and zero. Above 8 times nothing is left, and a
# fiftieth of it is no different from zero.
GRID = np.r_[0.0, np.geomspace(0.02, 8.0, 48)]
# Of a normal population the furthest device is beyond so many standard deviations in one of 20 of
# 4 devices and nearly always of 200; where none is, no tail has evidence.
FAR = 2.5
ROUNDS = 60  # of the search for a mean; each is at least linear, and stops at a thousandth of sigma
# The fewest devices of which a spread is told: with two, one difference is all that there is.
LEAST = 3


@dataclass(frozen=True)
class Population:
    """mean and its sigma; spread, the scale of the density, and where it is with 95 %: low, high;
    dof: of Student's t (inf: normal); log_evidence, nats; apart: by how much one device differs
    from one switching on to the next (0 for what stays; nan where no device was seen twice);
    count: of devices."""

    mean: float
    mean_sigma: float
    spread: float
    low: float
    high: float
    dof: float
    log_evidence: float
    apart: float
    count: int

    @property
    def deviation(self) -> float:
        """Standard deviation of the density."""
        if math.isinf(self.dof):
            return self.spread
        return self.spread * math.sqrt(self.dof / (self.dof - 2.0))


def population(value: Array, sigma: Array, owner: IntArray, stays: bool = True) -> Population:
    """Of recordings' values (n,) with sigmas (n,), of devices owner (n,). stays: a device has one
    value in all of its recordings; else one of each switching on, about the device's own.

    Errors: HandcalError with fewer than ``LEAST`` devices.
    """
    apart = 0.0 if stays else _apart(value, sigma, owner)
    d = devices(value, sigma, owner, 0.0 if math.isnan(apart) else apart)
    if len(d.value) < LEAST:
        raise HandcalError(f"A population takes {LEAST} devices, and there are {len(d.value)}.")
    g = _density(d)
    low, middle, high = g.spread_at((0.025, 0.5, 0.975))
    return Population(*g.mean(), middle, low, high, g.dof, g.evidence + d.log_within, apart,
                      len(d.value))  # fmt: skip


def foretold(value: Array, sigma: Array, new: float, new_sigma: float) -> float:
    """Probability that one more device, read with a sigma of its own, is as far from the mean of
    others (n,) or farther; all that they leave open of mean and spread is in it."""
    from scipy.special import ndtr

    g = _density(devices(value, sigma, np.arange(len(value), dtype=np.int64)))
    share, widen = _nodes(g.dof)
    v = (new_sigma**2 + 1.0 / g.curvature)[:, None] + (g.spreads**2)[:, None] * widen
    tails = 2.0 * ndtr(-np.abs(new - g.centre)[:, None] / np.sqrt(v))
    return float(g.weight @ (tails @ np.exp(share)))


@dataclass(frozen=True)
class _Density:
    """Of one tail: spreads (s,) on trial, the weight of each (their sum is one) and what the
    posterior has below it; the best mean and its information at each; log-evidence, without what
    recordings of one device say of each other."""

    dof: float
    spreads: Array
    weight: Array
    below: Array
    centre: Array
    curvature: Array
    evidence: float

    def mean(self) -> tuple[float, float]:
        """The population's mean, and its sigma."""
        mean = float(self.weight @ self.centre)
        variance = float(self.weight @ (1.0 / self.curvature + (self.centre - mean) ** 2))
        return mean, math.sqrt(variance)

    def spread_at(self, shares: Sequence[float]) -> list[float]:
        """Quantiles of the spread."""
        return [float(np.interp(q, self.below, self.spreads)) for q in shares]


def _density(d: Devices) -> _Density:
    """Normal, or with the tail that has clearly more evidence."""
    normal = _of_tail(d, TAILS[0])
    off = np.abs(d.value - np.median(d.value)) / np.sqrt(d.sigma**2 + core(d) ** 2)
    if off.max() < FAR:
        return normal
    best = max((_of_tail(d, dof) for dof in TAILS[1:]), key=lambda p: p.evidence)
    return best if best.evidence > normal.evidence + SURE else normal


def core(d: Devices) -> float:
    """A spread that few odd devices do not move: of the middle half, less what sigmas explain."""
    away = np.abs(d.value - np.median(d.value))
    return math.sqrt(
        max(0.0, (1.4826 * float(np.median(away))) ** 2 - float(np.median(d.sigma**2)))
    )


def _of_tail(d: Devices, dof: float) -> _Density:
    spreads = GRID * _raw_scatter(d)
    centre, curvature, log = _means(d, spreads, *_nodes(dof))
    # (the mean is integrated out by its curvature; over the spread the prior is flat)
    log = log + 0.5 * np.log(2.0 * np.pi / curvature)
    p = np.exp(log - log.max())
    area = 0.5 * (p[1:] + p[:-1]) * np.diff(spreads)
    total = float(area.sum())
    weight = np.gradient(spreads) * p
    # the prior of the spread is flat up to the largest on trial, that of the mean as wide
    evidence = float(log.max()) + math.log(total / spreads[-1]) - math.log(2.0 * spreads[-1])
    below = np.r_[0.0, np.cumsum(area)] / total
    return _Density(dof, spreads, weight / weight.sum(), below, centre, curvature, evidence)


def _raw_scatter(d: Devices) -> float:
    """Of the estimates: what is left of it without their sigmas is at most as much."""
    middle = np.median(d.value)
    robust_scale = 1.4826 * float(np.median(np.abs(d.value - middle)))
    return max(robust_scale, 0.2 * float(np.std(d.value)), float(d.sigma.min()))


def _nodes(dof: float) -> tuple[Array, Array]:
    """Student's t as a mixture of normal densities: log shares (k,) and variances (k,)."""
    if math.isinf(dof):
        return np.zeros(1), np.ones(1)
    from scipy.stats import gamma

    # log of the precision, whose density is smooth, by the trapezoidal rule
    x = np.linspace(
        math.log(gamma.ppf(1e-7, dof / 2)), math.log(gamma.ppf(1 - 1e-9, dof / 2)), NODES
    )
    log = gamma.logpdf(np.exp(x), dof / 2) + x
    log -= np.log(np.exp(log - log.max()).sum()) + log.max()
    return np.asarray(log), np.asarray((dof / 2) / np.exp(x))


def log_density(x: Array, variance: Array, share: Array, widen: Array, spread: Array) -> Array:
    """Log of the marginal density of residuals x (..., d) with variances (d,), of spreads (...,
    1); shape (..., d, k), by node."""
    v = variance[:, None] + (spread**2)[..., None] * widen
    return np.asarray(share - 0.5 * (x[..., None] ** 2 / v + np.log(2.0 * np.pi * v)))


def _means(d: Devices, spreads: Array, share: Array, widen: Array) -> tuple[Array, Array, Array]:
    """For each spread (s,) the best mean (s,), the curvature (s,) and the log-likelihood (s,)."""
    centre = np.full(len(spreads), float(np.median(d.value)))
    variance = d.sigma**2
    v = variance[None, :, None] + (spreads**2)[:, None, None] * widen
    for _ in range(ROUNDS):
        log = log_density(d.value - centre[:, None], variance, share, widen, spreads[:, None])
        top = log.max(axis=2, keepdims=True)
        r = np.exp(log - top)
        r /= r.sum(axis=2, keepdims=True)
        w = (r / v).sum(axis=2)
        new = (w * d.value).sum(axis=1) / w.sum(axis=1)
        moved = np.abs(new - centre)
        centre = new
        if (moved < 1e-3 / np.sqrt(w.sum(axis=1))).all():
            break
    x = d.value - centre[:, None]
    slope = (r * x[..., None] / v).sum(axis=2)
    # (information as observed: of each device the weight less the scatter of its nodes' slopes)
    bend = w - ((r * (x[..., None] / v) ** 2).sum(axis=2) - slope**2)
    curvature = np.maximum(bend.sum(axis=1), 0.05 * w.sum(axis=1))
    log = log_density(x, variance, share, widen, spreads[:, None])
    top = log.max(axis=2)
    return centre, curvature, (top + np.log(np.exp(log - top[..., None]).sum(axis=2))).sum(axis=1)


def _apart(value: Array, sigma: Array, owner: IntArray) -> float:
    """By how much devices differ from one switching on to the next: at the best of the likelihood
    of recordings about their own device's mean; nan where none was seen twice."""
    if np.bincount(owner).max() < 2:
        return math.nan
    raw = float(np.std(value)) or float(sigma.min())
    steps = GRID * raw
    log = [devices(value, sigma, owner, float(s)).log_within for s in steps]
    return float(steps[int(np.argmax(log))])


def chance(p: Population, value: Array, sigma: Array) -> Array:
    """Probability (d,) that a device of the population is read as far from its mean or farther."""
    from scipy.special import ndtr

    share, widen = _nodes(p.dof)
    v = sigma[:, None] ** 2 + p.mean_sigma**2 + p.spread**2 * widen
    return np.asarray(
        (np.exp(share) * 2.0 * ndtr(-np.abs(value - p.mean)[:, None] / np.sqrt(v))).sum(1)
    )
