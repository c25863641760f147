"""Devices of a model with all parameters at once: what looks like another effect in each recording
may be told apart by the devices together.

Of each recording the likelihood of all parameters is a Gaussian, b'u - u'G u / 2 in units of their
usual sizes. What does not stay with a device is integrated out, a device's recordings are added,
and the parameters of devices are drawn from a normal population, one mean and one spread each. A
gyro turned at one rate does not tell a scale error from a quadratic one; but if the latter is
common to the devices, their scale errors spread less than they would without it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from handcal.device.file import Name
from handcal.population.stacked import HONEST, SHARES, Stack, log_mean, weighed
from handcal.types import Array, IntArray

# Spreads on trial of an effect that devices have in common, in usual sizes.
SPREADS = (0.0, 0.03, 0.1, 0.3, 1.0)
# Steps towards the population (expectation and maximisation), and its spread at the first, in usual
# sizes; within the last of so many steps evidence moves by less than 0.1 nats (measured).
STEPS, BEGIN = 60, 0.3
# Steps from a population that is nearly the same: with and without one effect.
FURTHER = 15
# No spread is taken for less, in usual sizes: a spread of zero is a fixed point of the steps.
LEAST = 1e-3


@dataclass(frozen=True)
class Information:
    """What a recording tells: names (k,), b (k,), G (k, k), in units of the usual sizes."""

    names: tuple[Name, ...]
    b: Array
    G: Array


@dataclass(frozen=True)
class Told:
    """Of d devices: b (d, k), G (d, k, k) of the parameters ``names``."""

    names: tuple[Name, ...]
    b: Array
    G: Array


def of_devices(
    recordings: Sequence[Information], owner: IntArray, names: Sequence[Name],
    passing: Sequence[Name],
) -> Told:  # fmt: skip
    """Devices' information of ``names``: of each recording ``passing`` parameters integrated out
    with their usual sizes, and recordings of a device added. owner (n,)."""
    k = len(names)
    b, G = np.zeros((int(owner.max()) + 1, k)), np.zeros((int(owner.max()) + 1, k, k))
    for r, d in zip(recordings, owner.tolist(), strict=True):
        at = {n: i for i, n in enumerate(r.names)}
        here = [i for i, n in enumerate(names) if n in at]
        own, gone = [at[names[i]] for i in here], [at[n] for n in passing if n in at]
        own_b, own_G = kept(r.b, r.G, own, gone)
        b[d, here] += own_b
        G[np.ix_([d], here, here)] += own_G[None]
    return Told(tuple(names), b, G)


def kept(b: Array, G: Array, own: Sequence[int], gone: Sequence[int]) -> tuple[Array, Array]:
    """b (k,) and G (k, k) of the parameters ``own``, those of ``gone`` integrated out with their
    usual sizes; all others are zero."""
    A = G[np.ix_(gone, gone)] + np.eye(len(gone))
    X = np.linalg.solve(A, np.column_stack([b[gone], G[np.ix_(gone, own)]]))
    cross = G[np.ix_(own, gone)]
    return b[own] - cross @ X[:, 0], G[np.ix_(own, own)] - cross @ X[:, 1:]


def part(told: Told, names: Sequence[Name]) -> Told:
    """Some of the parameters; the others are zero."""
    at = [told.names.index(n) for n in names]
    return Told(tuple(names), told.b[:, at], told.G[:, at][:, :, at])


def evidence(told: Told, mean: Array, spread: Array) -> tuple[Array, Array, Array]:
    """Log-evidence (d,) of devices under a population with mean (k,) and spread (k,), and their
    posterior means (d, k) and covariances (d, k, k)."""
    S = np.maximum(spread, 1e-9)
    A = np.eye(len(S)) + told.G * np.outer(S, S)
    c = told.b - told.G @ mean
    C = np.linalg.solve(A, np.broadcast_to(np.eye(len(S)), A.shape))
    y = (C @ (c * S)[..., None])[..., 0]
    shift = told.b @ mean - 0.5 * np.einsum("i,dij,j->d", mean, told.G, mean)
    log = shift + 0.5 * (y * c * S).sum(1) - 0.5 * np.linalg.slogdet(A)[1]
    return log, mean + S * y, C * np.outer(S, S)


def fit(
    told: Told, begin: Array | None = None, held: int = 0, steps: int = STEPS
) -> tuple[Array, Array]:
    """Mean (k,) and spread (k,) of the population; begin: the spread (k,) at the first of so many
    steps, of which the last ``held`` numbers stay as they are."""
    k = len(told.names)
    spread = np.full(k, BEGIN) if begin is None else begin
    free = np.arange(k) < k - held
    for _ in range(steps):
        mean = _centre(told, spread)
        _, m, C = evidence(told, mean, spread)
        second = ((m - mean) ** 2 + np.diagonal(C, axis1=1, axis2=2)).mean(0)
        spread = np.where(free, np.sqrt(np.maximum(second, LEAST**2)), spread)
    return _centre(told, spread), spread


def _weights(told: Told, spread: Array) -> tuple[Array, Array]:
    """Information (k, k) of the population's mean, and with the prior of the usual size its
    gradient at zero (k,)."""
    S2 = np.diag(np.maximum(spread, 1e-9) ** 2)
    W = np.linalg.solve(np.eye(len(spread)) + told.G @ S2, np.concatenate(
        [told.G, told.b[..., None]], axis=2))  # fmt: skip
    return W[..., :-1].sum(0) + np.eye(len(spread)), W[..., -1].sum(0)


def _centre(told: Told, spread: Array) -> Array:
    """The population's best mean, given its spreads."""
    H, g = _weights(told, spread)
    return np.asarray(np.linalg.solve(H, g))


def _settled(told: Told, mean: Array, spread: Array) -> float:
    """Log-evidence of all devices, the population's mean (k,), here at its best, integrated out
    (prior: the usual sizes)."""
    log = float(evidence(told, mean, spread)[0].sum())
    H, _ = _weights(told, spread)
    return log - 0.5 * float(mean @ mean) - 0.5 * float(np.linalg.slogdet(H)[1])


Fits = Sequence[tuple[Array, Array]]


def without(told: Told, base: Sequence[Name]) -> Fits:
    """Mean and spread of the population of some parameters alone, for each factor by which sigmas
    may be too small."""
    return [fit(part(_honest(told, c), base)) for c in HONEST.tolist()]


def _honest(told: Told, c: float) -> Told:
    return Told(told.names, told.b / c**2, told.G / c**2)


def stack(
    told: Told, always: Sequence[Name], effect: str, trials: int, fits: Fits | None = None
) -> Stack:
    """Evidence for an effect beside those that are always in the model (its own are left out of
    them), as ``stacked.stack``; fits: ``without`` of these, if it is at hand."""
    own = [n for n in told.names if n[0] == effect]
    base = [n for n in always if n[0] != effect]
    none, shared, few, alone = [], [], [], []
    fits = without(told, base) if fits is None else fits
    for c, (mean, spread) in zip(HONEST.tolist(), fits, strict=True):
        honest = _honest(told, c)
        less, whole = part(honest, base), part(honest, [*base, *own])
        # (sigmas that are larger have a likelihood of their own: of the fit with everything)
        size = _scatter(whole, c)
        none.append(_settled(less, mean, spread) + size)
        pad = np.zeros(len(own))
        logs = [
            _settled(whole, *fit(whole, np.r_[spread, pad + s], len(own), FURTHER)) for s in SPREADS
        ]
        shared.append(log_mean(np.array(logs)) + size)
        lack = evidence(less, mean, spread)[0]
        have = evidence(whole, np.r_[mean, pad], np.r_[spread, pad + 1.0])[0]
        each = np.logaddexp(np.log(SHARES)[:, None] + have, np.log1p(-SHARES)[:, None] + lack)
        few.append(none[-1] + log_mean(each.sum(1)) - float(lack.sum()))
        alone.append(float((have - lack).max()))
    base_log = log_mean(np.array(none))
    common, some = log_mean(np.array(shared)) - base_log, log_mean(np.array(few)) - base_log
    return weighed(effect, (common, some), trials, len(told.b), alone[0])


def _scatter(told: Told, c: float) -> float:
    """Of sigmas c times as large, beyond what b and G (already divided by c^2) say: a density of as
    many numbers as there are parameters told is c times as wide."""
    rank = sum(int((np.linalg.eigvalsh(g * c**2) > 1.0).sum()) for g in told.G)
    at_best = sum(
        float(b @ np.linalg.lstsq(g, b, rcond=1e-9)[0]) for b, g in zip(told.b, told.G, strict=True)
    )
    # (b and G leave out the residuals' own part: at the best fit it is the same for all)
    return -rank * math.log(c) - 0.5 * at_best


def marginals(told: Told, mean: Array, spread: Array, of: Name) -> tuple[Array, Array]:
    """Value (d,) and sigma (d,) of one parameter as each device alone tells it, the others drawn
    from a population with this mean (k,) and spread (k,); in usual sizes. Sigma is infinite where
    a device does not tell it."""
    k = told.names.index(of)
    own = mean.copy()
    own[k], wide = 0.0, spread.copy()
    wide[k] = 1.0
    _, m, C = evidence(told, own, wide)
    information = 1.0 / C[:, k, k] - 1.0
    with np.errstate(divide="ignore", invalid="ignore"):
        return m[:, k] / C[:, k, k] / information, np.where(
            information > 0, information, 0.0
        ) ** -0.5
