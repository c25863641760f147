"""How good a device is: how far dead reckoning by its readings is off, before they are corrected
and after.

The standard motion is a minute of turning by hand about all axes (``motions.MINUTE``), begun from
rest with attitude, velocity and place known; the IMU stays in its place. Attitude is asked for at
its end, position after its first ten seconds. What counts is what gyro and accelerometer read too
much at the temperature of the recording: laws without a name do not, nor what happened once. To
first order in the errors (``propagation``); angles end at half a turn.

Priors have tails (``estimate.heavy_tails``): of what a motion did not show, some devices have 25
times as much as is usual. So an error is a sum of normal densities over the scales of each effect,
and its mean, its quantiles and what is left after correction are those of draws from that sum, not
of the one normal density of the same covariance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from handcal.earth import STANDARD_GRAVITY
from handcal.effects import Effect, catalogue, imu_jacobian
from handcal.estimate.heavy_tails import has_tails
from handcal.estimate.prior_scales import LOG_SHARES, SCALES, all_shares, posterior_at
from handcal.motions import MINUTE
from handcal.motions import attitude as attitude_of
from handcal.signals import of_arrays
from handcal.types import Array, BoolArray, IntArray, Parameter

# Seconds of the standard motion after which attitude and position are asked for.
ATTITUDE_S, POSITION_S = 60.0, 10.0
RATE_HZ = 50.0
DRAWS = 2000
# Of a posterior's variances, in those of the prior, what is no more than round-off.
ROUND_OFF = 1e-12
# Choices of each effect's likeliest scale, at the most.
ROUNDS = 6


@dataclass(frozen=True)
class Drift:
    """One error of dead reckoning, rad or m. before: expected of the device as it is, and low and
    high its 16 and 84 % points; after: expected of what correction leaves; better: share of usual
    devices that are better as they are."""

    before: float
    low: float
    high: float
    after: float
    better: float


@dataclass(frozen=True)
class Quality:
    """attitude: rad, after ``ATTITUDE_S``; position: m, after ``POSITION_S``."""

    attitude: Drift
    position: Drift


def quality(
    parameters: Sequence[Parameter],
    covariance: Array,
    rng: np.random.Generator,
    *,
    tails: bool = True,
) -> Quality | None:
    """How good the device is of which these parameters (k,), neighbours by effect, with their
    covariance (k, k) are known. None where its biases are not among them, or a number is none.

    tails: the priors were the catalogue's, with their tails, not those of a device or a model.
    """
    at = [i for i, p in enumerate(parameters) if _counts(p.effect)]
    own = [parameters[i] for i in at]
    owners, value = [p.effect for p in own], np.array([p.value for p in own])
    C = covariance[np.ix_(at, at)]
    if not {"gyro_bias", "accel_bias"} <= set(owners) or not np.isfinite([*value, *C.flat]).all():
        return None
    unit = np.array([p.prior_sigma for p in own])
    u, C = value / unit, C / np.outer(unit, unit)
    drawn = _drawn(u, C, owners, rng) if tails else rng.multivariate_normal(u, C, DRAWS)
    usual = [e for e in catalogue().values() if counts(e) and (e.baseline or e.common)]
    others = _usual(usual, rng)
    have = {e.id for e in usual}
    effects = [*usual, *(catalogue()[i] for i in dict.fromkeys(owners) if i not in have)]
    names = [(e.id, p.name) for e in effects for p in e.parameters]
    J, mine = propagation(effects), [names.index((p.effect, p.name)) for p in own]
    J_own, J_usual = J[:, mine] * unit, J[:, : others.shape[1]]
    error, left, usually = drawn @ J_own.T, (drawn - u) @ J_own.T, others @ J_usual.T
    attitude, position = (
        _drift(error[:, rows], left[:, rows], usually[:, rows], most)
        for rows, most in ((slice(0, 3), np.pi), (slice(3, 6), np.inf))
    )
    return Quality(attitude, position)


def counts(effect: Effect) -> bool:
    """Whether an effect belongs to gyro and accelerometer at all times."""
    return effect.misreads and effect.moments is None


def _counts(effect: str) -> bool:
    known = catalogue().get(effect)
    return known is not None and counts(known)


def propagation(effects: Sequence[Effect]) -> Array:
    """What a unit of each parameter of these effects makes of attitude at the end of the standard
    motion (rotation vector in n, rad) and of the position after ten seconds (m): (6, k)."""
    t = np.arange(0.0, ATTITUDE_S + 0.5 / RATE_HZ, 1.0 / RATE_HZ)
    C_nb, omega = attitude_of(MINUTE, t)
    truth = replace(of_arrays(t, omega, STANDARD_GRAVITY * C_nb[:, 2, :]), C_nb=C_nb)
    J = np.concatenate(
        [imu_jacobian(e, np.zeros(len(e.parameters)), truth) for e in effects], axis=2
    )
    turning, force = (np.einsum("nij,njk->nik", C_nb, J[:, c : c + 3]) for c in (0, 3))
    phi = _integral(turning)
    # (tilted, it takes a part of gravity for a push)
    force[:, 0] += STANDARD_GRAVITY * phi[:, 1]
    force[:, 1] -= STANDARD_GRAVITY * phi[:, 0]
    position = _integral(_integral(force[: round(POSITION_S * RATE_HZ) + 1]))
    return np.concatenate([phi[-1], position[-1]])


def _integral(x: Array) -> Array:
    """Over time, (n, ...), from zero on."""
    out = np.zeros_like(x)
    np.cumsum(0.5 / RATE_HZ * (x[1:] + x[:-1]), axis=0, out=out[1:])
    return out


def _drift(error: Array, left: Array, usual: Array, most: float) -> Drift:
    """Of draws (n, 3) of the error, of what correction leaves of it, and of other devices'."""
    before, after, others = (
        np.minimum(np.linalg.norm(x, axis=1), most) for x in (error, left, usual)
    )
    low, high = np.quantile(before, (0.16, 0.84))
    better = np.searchsorted(np.sort(others), before).mean() / len(others)
    return Drift(*map(float, (before.mean(), low, high, after.mean(), better)))


def _usual(effects: Sequence[Effect], rng: np.random.Generator) -> Array:
    """Parameters (n, k) of devices as the priors of the catalogue have them."""
    out = []
    for e in effects:
        scale = rng.choice(SCALES, DRAWS, p=np.exp(LOG_SHARES)) if _tailed(e.id) else np.ones(DRAWS)
        drawn = scale[:, None] * e.prior_sigma * rng.standard_normal((DRAWS, len(e.parameters)))
        positive = [p.positive for p in e.parameters]
        out.append(np.where(positive, np.abs(drawn), drawn))
    return np.concatenate(out, axis=1)


def _tailed(effect: str) -> bool:
    return has_tails(effect) and not catalogue()[effect].baseline


# --- draws from a posterior with tails ----------------------------------------------------------


def _drawn(u: Array, C: Array, owners: Sequence[str], rng: np.random.Generator) -> Array:
    """Draws (n, k), in units of the priors, of a posterior of mean u (k,) and covariance C (k, k).

    The scales of each effect's prior are weighed with those of the others at their best, as the
    fit weighs them (``estimate.heavy_tails``).
    """
    begin = [i for i, o in enumerate(owners) if i == 0 or o != owners[i - 1]]
    ends = np.array([*begin, len(u)], dtype=np.int64)
    tails = np.array([_tailed(owners[i]) for i in begin], dtype=np.bool_)
    b, G = _likelihood(u, C, ends, tails)
    best, weight = _scales(b, G, ends, tails)
    scales = np.tile(best, (DRAWS, 1))
    for e in np.flatnonzero(tails):
        scales[:, e] = rng.choice(len(SCALES), DRAWS, p=weight[e])
    out = rng.standard_normal((DRAWS, len(u)))
    kinds, of = np.unique(scales, axis=0, return_inverse=True)
    for n, kind in enumerate(kinds):
        mean, covariance = _at(b, G, ends, kind)
        root = np.linalg.cholesky(covariance + ROUND_OFF * np.eye(len(mean)))
        out[of == n] = mean + out[of == n] @ root.T
    return out


def _likelihood(u: Array, C: Array, ends: IntArray, tails: BoolArray) -> tuple[Array, Array]:
    """b (k,) and G (k, k), as of a ``quadratic.Quadratic``, behind a posterior.

    Its prior was of the usual scale, or where it has tails of several: their variance is no less
    than what is left of the effect, or what there is of it.
    """
    prior = np.ones(len(u))
    for e in np.flatnonzero(tails):
        own = slice(ends[e], ends[e + 1])
        left = np.linalg.eigvalsh(C[own, own])[-1]
        prior[own] = max(1.0, left, np.mean(u[own] ** 2))
    values, vectors = np.linalg.eigh(C)
    values = np.maximum(values, ROUND_OFF)
    # (seen from these axes the posterior's information is one, and the prior had no more of it)
    inverse = vectors / np.sqrt(values)
    root = vectors * np.sqrt(values)
    share, axes = np.linalg.eigh(root.T @ (root / prior[:, None]))
    told = inverse @ axes * np.sqrt(1.0 - np.minimum(share, 1.0))
    return inverse @ (inverse.T @ u), told @ told.T


def _scales(b: Array, G: Array, ends: IntArray, tails: BoolArray) -> tuple[IntArray, Array]:
    """The likeliest scale of each effect (e,), and how probable each scale is (e, scales)."""
    best = np.zeros(len(tails), dtype=np.int64)
    shares = np.full((len(tails), len(SCALES)), -np.inf)
    none = np.zeros(len(b), dtype=np.bool_)
    for _ in range(ROUNDS):
        mean, C = _at(b, G, ends, best)
        for e, (first, last) in enumerate(pairwise(ends)):
            own = first, last, float(last - first)
            all_shares(mean, C, own, best[e], tails[e], none, shares[e])
        before, best = best, shares.argmax(axis=1)
        if (best == before).all():
            break
    weight = np.exp(shares - shares.max(axis=1, keepdims=True))
    return best, weight / weight.sum(axis=1, keepdims=True)


def _at(b: Array, G: Array, ends: IntArray, scale: IntArray) -> tuple[Array, Array]:
    """Mean (k,) and covariance (k, k) at these scales of the effects."""
    mean, C = np.empty(len(b)), np.empty(G.shape)
    posterior_at(b, G, np.empty((0, 0)), ends, scale, mean, C)
    return mean, C
