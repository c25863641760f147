"""Is the filter as good as it says? NEES, NIS, whiteness, and the bound no filter beats."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.special import chdtri

from handcal.estimate import smoother
from handcal.estimate.linear import linearise_about
from handcal.estimate.problem import Problem
from handcal.estimate.start import Start
from handcal.estimate.trajectory import Trajectory
from handcal.types import Array, Innovations


def nees(error: Array, P: Array) -> float:
    """Normalised estimation error squared e' P^-1 e of an error (d,) with covariance (d, d)."""
    scale = 1.0 / np.sqrt(np.diag(P))
    return float(error * scale @ np.linalg.solve(scale[:, None] * P * scale, error * scale))


def chi2_bounds(dof: int, level: float = 0.99, tests: int = 1) -> tuple[float, float]:
    """Two-sided bounds of a chi-square variable over its degrees of freedom.

    They hold simultaneously for ``tests`` such variables (Bonferroni).
    """
    tail = 0.5 * (1.0 - level) / tests
    return float(chdtri(dof, 1.0 - tail) / dof), float(chdtri(dof, tail) / dof)


def nis_between(innovations: Mapping[str, Innovations], after: float, before: float) -> float:
    """Mean NIS per degree of freedom of all kinds together, for after <= t < before (s)."""
    total, count = 0.0, 0
    for i in innovations.values():
        chosen = (i.t >= after) & (i.t < before)
        total += float(i.nis[chosen].sum())
        count += int(chosen.sum()) * i.residual.shape[1]
    return total / count if count else float("nan")


def bound(problem: Problem, start: Start, truth: Trajectory, levels: Mapping[str, float]) -> Array:
    """Posterior Cramer-Rao bound (k, N, N) at each epoch, with the filter's own priors.

    The covariance of the Kalman filter linearised about the truth (Tichavsky, Muravchik
    and Nehorai, IEEE Trans. Signal Processing 46(5), 1998).
    """
    return smoother.forward(linearise_about(problem, start, truth), levels).P
