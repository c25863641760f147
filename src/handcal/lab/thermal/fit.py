"""Linear estimates with priors, and their evidence: which curve, and how noisy the readings."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from handcal.types import Array

# Noise beyond that within the pieces is sought between these parts of what is left, and of one.
LEAST, MOST = 1e-12, 1.0
COARSE = 16


@dataclass(frozen=True)
class Rows:
    """What is left y (m,) at parameters x (k,), derivatives A (m, k) of the readings, variances
    (m,) and standard deviations prior (k,), of mean zero."""

    y: Array
    A: Array
    variance: Array
    prior: Array
    x: Array


def fitted(rows: Rows, extra: float) -> tuple[Array, Array]:
    """Parameters (k,), to which x is added already, and their covariance (k, k)."""
    w = 1.0 / np.sqrt(rows.variance + extra**2)
    A = np.vstack([rows.A * w[:, None] * rows.prior, np.eye(len(rows.prior))])
    y = np.r_[w * (rows.y + rows.A @ rows.x), np.zeros(len(rows.prior))]
    Q, R = np.linalg.qr(A)
    u = np.linalg.solve(R, Q.T @ y)
    # once more on what is left, against rounding
    u = u + np.linalg.solve(R, Q.T @ (y - A @ u))
    half = np.linalg.solve(R, np.eye(len(u))) * rows.prior[:, None]
    return rows.prior * u, half @ half.T


def log_evidence(rows: Rows, extra: float) -> float:
    """log p(readings) with the parameters integrated over their priors."""
    total = rows.variance + extra**2
    w = 1.0 / np.sqrt(total)
    k = len(rows.prior)
    A = np.vstack([(rows.A * rows.prior) * w[:, None], np.eye(k)])
    y = np.r_[w * (rows.y + rows.A @ rows.x), np.zeros(k)]
    # by R, not by squares: noise may be twelve orders below the priors
    R = np.asarray(np.linalg.qr(np.column_stack([A, y])).R)
    left = float(R[k, k] ** 2) if len(R) > k else 0.0
    wide = float(np.log(np.abs(np.diag(R)[:k])).sum())
    return -0.5 * (float(np.log(2.0 * math.pi * total).sum()) + left) - wide


def best_extra(rows: Rows) -> tuple[float, float]:
    """Standard deviation beyond the known variances that has most evidence, and the evidence."""
    grid = np.geomspace(LEAST, MOST, COARSE)
    values = [log_evidence(rows, float(s)) for s in grid]
    k = int(np.argmax(values))
    low, high = math.log(grid[max(k - 1, 0)]), math.log(grid[min(k + 1, COARSE - 1)])
    found = minimize_scalar(
        lambda v: -log_evidence(rows, math.exp(v)), bounds=(low, high), method="bounded",
        options={"xatol": 1e-3},
    )  # fmt: skip
    return math.exp(float(found.x)), -float(found.fun)
