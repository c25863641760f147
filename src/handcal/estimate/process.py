"""What is known of the parameters of an effect that is noise: levels, found by the evidence."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from handcal.effects import Effect
from handcal.estimate.evidence import reduce, reduced_pass
from handcal.estimate.model import Fitted, Model
from handcal.types import Array, Parameter

# Step of second differences in the logarithm of a level.
STEP = 0.15
# Standard deviation of a level's logarithm before anything is known.
PRIOR = 2.0
# How far a grid over the posterior reaches, in standard deviations, and in how many steps.
REACH, NODES = 4.0, 9
# Times that not knowing other levels widens one, at the most: beyond, evidence is no parabola.
MOST_BY_OTHERS = 3.0


def process_parameters(model: Model, effect: Effect) -> tuple[Parameter, ...]:
    """Posterior mean and standard deviation of each parameter of a noise effect.

    A time or a density found from a few of its own lengths is known to a factor, not to a sum:
    how the evidence bends at its peak would promise too much. So it is integrated over a grid
    of logarithms, about the peak; what the other levels leave open comes on top, from the
    curvature that the noise search found.
    """
    names = [lv.name for lv in effect.levels]
    k = len(names)
    log_posterior = _log_posterior(model, effect, names)
    spread = _spread(log_posterior, k)
    axis = np.linspace(-REACH, REACH, NODES)
    grid = np.array(list(itertools.product(axis, repeat=k))) @ spread.T
    values = np.array([log_posterior(x) for x in grid])
    weight = np.exp(values - values.max())
    weight /= weight.sum()
    at = np.array([model.parts[0].levels[n] for n in names])
    levels = at * np.exp(grid)
    mean = weight @ levels
    sigma = np.sqrt(weight @ (levels - mean) ** 2) * _by_others(model.parts[0], names)
    return tuple(
        Parameter(effect.id, p.name, float(m), float(s), p.unit, p.prior_sigma, None)
        for p, m, s in zip(effect.parameters, mean, sigma, strict=True)
    )


def _log_posterior(model: Model, effect: Effect, names: Sequence[str]) -> Callable[[Array], float]:
    """Of the levels' logarithms, counted from where they are (k,); all other levels stay."""
    reductions = [(reduce(f.linear), f.levels) for f in model.parts]
    levels = {lv.name: lv for lv in effect.levels}
    first = np.array([math.log(model.parts[0].levels[n] / levels[n].initial) for n in names])
    low, high = (
        np.array([math.log(getattr(levels[n], side) / levels[n].initial) for n in names]) - first
        for side in ("lower", "upper")
    )

    def value(x: Array) -> float:
        if np.any(x < np.minimum(low, 0.0)) or np.any(x > np.maximum(high, 0.0)):
            return -math.inf
        evidence = sum(
            reduced_pass(r, {**lv, **_scaled(lv, names, x)}).log_evidence for r, lv in reductions
        )
        return evidence - 0.5 * float(((first + x) ** 2).sum()) / PRIOR**2

    return value


def _spread(log_posterior: Callable[[Array], float], k: int) -> Array:
    """A square root (k, k) of the covariance that the curvature at the peak suggests."""
    here, H = log_posterior(np.zeros(k)), np.zeros((k, k))
    for i in range(k):
        for j in range(i + 1):
            a, b = STEP * np.eye(k)[i], STEP * np.eye(k)[j]
            if i == j:
                H[i, i] = log_posterior(a) - 2 * here + log_posterior(-a)
            else:
                mixed = log_posterior(a + b) - log_posterior(a - b)
                H[i, j] = H[j, i] = (mixed - log_posterior(b - a) + log_posterior(-a - b)) / 4
    curved = np.where(np.isfinite(H), -H / STEP**2, 0.0)
    values, vectors = np.linalg.eigh(curved)
    return np.asarray(vectors / np.sqrt(np.maximum(values, 1.0 / PRIOR**2)))


def _by_others(f: Fitted, names: Sequence[str]) -> Array:
    """How much wider (k,) the levels' posterior is because other levels are not known either."""
    known, B = f.curvature.names, f.curvature.matrix
    if not set(names) <= set(known):
        return np.ones(len(names))
    at = [known.index(n) for n in names]
    whole = np.linalg.solve(B, np.eye(len(B))[:, at])[at]
    alone = np.linalg.solve(B[np.ix_(at, at)], np.eye(len(at)))
    share = np.sqrt(np.maximum(np.diag(whole) / np.diag(alone), 1.0))
    return np.asarray(np.minimum(share, MOST_BY_OTHERS))


def _scaled(levels: Mapping[str, float], names: Sequence[str], x: Array) -> dict[str, float]:
    return {n: levels[n] * math.exp(v) for n, v in zip(names, x, strict=True)}
