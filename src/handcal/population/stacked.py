"""Evidence for an effect, summed over the devices of a model under one population prior.

Three accounts of the same values: no device has it; all have it, about a common mean with a common
spread; some, half of them at the most, have it, each of a size of its own. What each device's
motion tells of one parameter is its own; every parameter is as likely absent as not. Sigmas may be
too small by a factor common to the fleet, in each account alike, so that what a model leaves unsaid
in every recording is not taken for a spread.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from handcal.types import Array

# Probability from which an effect is said to be there: contract, `missing`.
FOUND = 0.5
# By how much sigmas may be too small: of parameters of simulated people's recordings within three
# sigma are 96 to 99 %, which a factor of 1.0 to 1.45 makes of a normal density.
HONEST = np.array([1.0, 1.2, 1.45])
# Spreads on trial, in usual sizes of the effect; their prior is flat from nothing to one.
SPREADS = np.r_[0.0, np.geomspace(0.003, 1.0, 30)]
# Shares of devices that have an effect of their own size: half of them at the most, since where
# nearly all have one it is common to them.
SHARES = (np.arange(20) + 0.5) / 40.0


@dataclass(frozen=True)
class Stack:
    """Of one effect: nats of all having it over none, and over some having it; probability that
    devices of the model have it in common, after as many trials as there were; devices, and the
    nats that the best of them gives alone."""

    effect: str
    gain: float
    over_some: float
    probability: float
    devices: int
    best_alone: float


def stack(effect: str, values: Sequence[tuple[Array, Array]], usual: Array, trials: int) -> Stack:
    """values: for each parameter the devices' values (d,) and sigmas (d,); usual (k,): size of each
    in the catalogue; trials: effects times models that were looked at."""
    common = some = 0.0
    alone: dict[int, float] = {}
    for (x, sigma), size in zip(values, usual, strict=True):
        log = np.array([_accounts(x, sigma * c, float(size)) for c in HONEST])
        none, shared, few = (float(log_mean(log[:, i])) for i in range(3))
        common += _half(shared - none)
        some += _half(few - none)
        for i, nats in enumerate(_alone(x, sigma, float(size))):
            alone[i] = alone.get(i, 0.0) + _half(float(nats))
    count = max((len(x) for x, _ in values), default=0)
    return weighed(effect, (common, some), trials, count, max(alone.values(), default=0.0))


def weighed(
    effect: str, gained: tuple[float, float], trials: int, devices: int, best_alone: float
) -> Stack:
    """gained: nats of all having the effect over none, and of some having it."""
    common, some = gained
    # (odds of one in as many as there were trials, of either account)
    log_odds = common - math.log(trials) - float(np.logaddexp(0.0, some - math.log(trials)))
    probability = 1.0 / (1.0 + math.exp(-max(-700.0, min(700.0, log_odds))))
    return Stack(effect, common, common - some, probability, devices, best_alone)


def _half(nats: float) -> float:
    """Of a parameter that is as likely absent as not."""
    return max(nats, 0.0) + math.log1p(math.exp(-abs(nats))) - math.log(2.0)


def log_mean(x: Array) -> float:
    """Logarithm of the mean of what x (n,) are the logarithms of."""
    return float(x.max() + np.log(np.exp(x - x.max()).mean()))


def _alone(x: Array, sigma: Array, usual: float) -> Array:
    """Nats (d,) for each device of having it at its own size."""
    return np.asarray(_normal(x, sigma**2 + usual**2) - _normal(x, sigma**2))


def _normal(x: Array, v: Array) -> Array:
    return np.asarray(-0.5 * (x**2 / v + np.log(2.0 * np.pi * v)))


def _accounts(x: Array, sigma: Array, usual: float) -> tuple[float, float, float]:
    """Log-evidence of none, of all, of some having one parameter."""
    v = sigma**2
    none = float(_normal(x, v).sum())
    # all: the mean is normal with the usual size, and integrated out
    w = 1.0 / (v + (SPREADS[:, None] * usual) ** 2)
    total, product = w.sum(1), (w * x).sum(1)
    log = 0.5 * (np.log(w / (2.0 * np.pi)) - w * x**2).sum(1)
    log += 0.5 * product**2 / (total + usual**-2) - 0.5 * np.log1p(total * usual**2)
    p = np.exp(log - log.max())
    area = float((0.5 * (p[1:] + p[:-1]) * np.diff(SPREADS)).sum())
    shared = float(log.max()) + math.log(max(area, 1e-300))
    have, lack = _normal(x, v + usual**2), _normal(x, v)
    each = np.logaddexp(np.log(SHARES)[:, None] + have, np.log1p(-SHARES)[:, None] + lack)
    return none, shared, log_mean(each.sum(1))
