"""What the rests say of a reference's own biases: at rest it reads them and gravity alone.

A gyro's bias is the mean of what it reads. Of the force only the size is known, so one
attitude shows the bias along gravity, several show more; what is not shown stays as uncertain
as any sensor's. Gravity's size is not believed further than a usual sensor's scale and axes,
which several attitudes tell from a bias. A held device turns a little in each rest: the rests
disagree, and count for as much less.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from handcal.types import ACCEL_BIAS_PRIOR, GYRO_BIAS_PRIOR, Array

# Rests are cut into pieces this long, s: how their means scatter is the noise.
PIECE_S = 0.25
# Prior of a usual sensor's scale (1) and of the angles between its axes (rad).
CROOKED = 0.01
# No mean is known better than this, rad/s and m/s^2 (the least levels of noise there are).
LEAST = (1e-6, 1e-5)
# The size of a force is not linear in a bias.
ROUNDS = 3


@dataclass(frozen=True)
class Bias:
    """A reference's bias: mean (6,) rad/s and m/s^2, and how uncertain it is in units of the
    usual priors: of the gyro, alike in all directions, and a lower triangular root (3, 3) of the
    accelerometer's covariance."""

    mean: Array
    gyro: float
    accel: Array


UNKNOWN = Bias(np.zeros(6), 1.0, np.eye(3))
NONE = Bias(np.zeros(6), 0.0, np.zeros((3, 3)))


@dataclass(frozen=True)
class _Rests:
    """Means (r, 6) of rests, and their variances by noise, of gyro and accelerometer, (2, r)."""

    mean: Array
    variance: Array


def of_rests(t: Array, value: Array, rests: Array, gravity: float, earth_rate: float) -> Bias:
    """The bias of a reference that reads rate and force (n, 6) at times t (n,) s.

    rests (r, 2) s; gravity m/s^2; earth_rate: rad/s, in an unknown direction.
    """
    seen = _means(t, value, rests)
    if seen is None:
        return UNKNOWN
    one = np.ones((len(seen.mean), 1))
    gyro, P = _posterior(seen.mean[:, :3], one, np.array([GYRO_BIAS_PRIOR]), seen.variance[0], 1)
    accel, P_accel = _by_size(seen.mean[:, 3:], seen.variance[1], gravity)
    sigma = math.sqrt(P[0, 0] + earth_rate**2 / 3.0)
    return Bias(
        np.r_[gyro[0], accel],
        sigma / GYRO_BIAS_PRIOR,
        np.asarray(np.linalg.cholesky(P_accel)) / ACCEL_BIAS_PRIOR,
    )


def _means(t: Array, value: Array, rests: Array) -> _Rests | None:
    """Of each rest that has two pieces; how far pieces scatter is taken to be the same in all."""
    means, counts, left = [], [], []
    for begin, end in rests:
        here = (t >= begin) & (t <= end)
        if not here.any():
            continue
        piece = ((t[here] - begin) / PIECE_S).astype(np.int64)
        # (the last is no whole one, and some may be empty)
        piece = np.minimum(piece, max(int((end - begin) / PIECE_S) - 1, 0))
        n = np.bincount(piece)
        each = np.stack([np.bincount(piece, x)[n > 0] / n[n > 0] for x in value[here].T], axis=1)
        if len(each) > 1:
            means.append(each.mean(axis=0))
            counts.append(len(each))
            left.append(each - means[-1])
    if not means:
        return None
    freedom = 3.0 * sum(c - 1 for c in counts)
    squares = (np.vstack(left) ** 2).sum(axis=0)
    scatter = np.array([squares[:3].sum(), squares[3:].sum()]) / freedom
    variance = np.maximum(scatter, np.square(LEAST))[:, None] / np.array(counts)
    return _Rests(np.array(means), variance)


def _by_size(force: Array, variance: Array, gravity: float) -> tuple[Array, Array]:
    """Mean (3,) and covariance (3, 3) of an accelerometer's bias from forces (r, 3) at rest."""
    prior = np.r_[np.full(3, ACCEL_BIAS_PRIOR), np.full(6, CROOKED)]
    bias, P = np.zeros(3), np.zeros((9, 9))
    for _ in range(ROUNDS):
        true = force - bias
        size = np.linalg.norm(true, axis=1)
        up = true / size[:, None]
        crooked = gravity * np.hstack([up**2, up * up[:, [1, 2, 0]]])
        beyond = (size - gravity + up @ bias)[:, None]
        found, P = _posterior(beyond, np.hstack([up, crooked]), prior, variance, 3)
        bias = found[:3, 0]
    return bias, P[:3, :3]


def _posterior(y: Array, X: Array, prior: Array, variance: Array, free: int) -> tuple[Array, Array]:
    """Mean (p, c) and covariance (p, p) of u in y = X u + noise, y (k, c), each column alike.

    prior (p,): standard deviations; variance (k,) of the noise. To it comes what the rows
    disagree beyond that, whatever the first ``free`` unknowns are (DerSimonian and Laird,
    Controlled Clinical Trials 7, 1986).
    """
    U, s, _ = np.linalg.svd(X[:, :free])
    blind = U[:, int((s > 1e-9 * s[0]).sum()) :].T
    more = 0.0
    if len(blind):
        known = blind @ (X[:, free:] * prior[free:])
        values, vectors = np.linalg.eigh(known @ known.T + (blind * variance) @ blind.T)
        squares = ((vectors.T @ blind @ y) ** 2).sum(axis=1)
        more = _excess(squares, values, float(y.shape[1] * len(blind)))
    sigma = np.sqrt(variance + more)[:, None]
    rows = np.vstack([X / sigma, np.diag(1.0 / prior)])
    Q, R = np.linalg.qr(rows)
    half = np.linalg.solve(R, np.eye(len(prior)))
    right = np.vstack([y / sigma, np.zeros((len(prior), y.shape[1]))])
    return half @ (Q.T @ right), half @ half.T


def _excess(squares: Array, values: Array, freedom: float) -> float:
    """The variance that, added to all ``values`` (k,), makes the sum of squares over them no
    more than ``freedom``; 0 where it is none."""
    low, high = 0.0, float(squares.sum()) / freedom
    if (squares / values).sum() <= freedom:
        return 0.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        if (squares / (values + middle)).sum() > freedom:
            low = middle
        else:
            high = middle
    return high
