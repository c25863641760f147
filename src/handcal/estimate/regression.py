"""Least squares on the catalogue: what readings of a known truth say of the effects.

A reading is the truth plus the errors of the effects, biases among them. Rows are readings
divided by their standard deviations, columns the parameters; what the rows cannot see is
found before anything is solved. The Kalman filter over the same rows is the same estimate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import qr, solve_triangular

from handcal.effects import Effect, Param, Signals, imu_jacobian, select
from handcal.types import Array, IntArray, Parameter

# Rounds in which the truth behind readings is found, at the most.
ROUNDS = 30
# Readings repeat themselves no better than this many units in the last place.
NOTHING = 1e-11


BIASES = select(("gyro_bias", "accel_bias"))


@dataclass(frozen=True)
class Unknown:
    """One parameter that is estimated: of which effect, and what is usual of it."""

    effect: str
    param: Param

    @property
    def title(self) -> str:
        """Effect and parameter, as typed."""
        return f"{self.effect} {self.param.name}"


def unknowns(effects: Sequence[Effect]) -> tuple[Unknown, ...]:
    """The parameters of these effects, in order."""
    return tuple(Unknown(e.id, p) for e in effects for p in e.parameters)


def priors(of: Sequence[Unknown]) -> Array:
    """Usual sizes (k,) of parameters."""
    return np.array([u.param.prior_sigma for u in of])


def parameters(of: Sequence[Unknown], x: Array, sigma: Array) -> tuple[Parameter, ...]:
    """What was estimated, as results tell it: values x (k,) and standard deviations (k,)."""
    return tuple(
        Parameter(u.effect, u.param.name, float(v), float(s), u.param.unit, u.param.prior_sigma,
                  None)
        for u, v, s in zip(of, x, sigma, strict=True)
    )  # fmt: skip


def errors(effects: Sequence[Effect], x: Array, truth: Signals) -> Array:
    """What all effects add to the readings at this truth, (n, 6); x (k,) their parameters."""
    out = np.zeros((len(truth.t), 6))
    for e, own in _parts(effects, x):
        if e.imu_error is not None:
            out += e.imu_error(own, truth)
    return out


def columns(effects: Sequence[Effect], x: Array, truth: Signals) -> Array:
    """Derivatives (n, 6, k) of the readings by the parameters, at x (k,) and this truth."""
    return np.concatenate([imu_jacobian(e, own, truth) for e, own in _parts(effects, x)], axis=2)


def _parts(effects: Sequence[Effect], x: Array) -> list[tuple[Effect, Array]]:
    ends = np.cumsum([len(e.parameters) for e in effects])
    return list(zip(effects, np.split(x, ends[:-1]), strict=True)) if effects else []


def by_truth(effects: Sequence[Effect], x: Array, truth: Signals) -> Array:
    """Derivatives (n, 6, 6) of the readings by rate and force: the identity, and the errors'.

    A step along one axis is made at all samples at once, so that what an effect makes of a
    rate of change stays what it is.
    """
    out = np.tile(np.eye(6), (len(truth.t), 1, 1))
    for i in range(6):
        # large against rounding, small against what a product of two signals would notice
        step = 1e-2 if i < 3 else 1e-1
        up, down = (_moved(effects, x, truth, i, s) for s in (step, -step))
        out[:, :, i] += (up - down) / (2.0 * step)
    return out


def _moved(effects: Sequence[Effect], x: Array, truth: Signals, i: int, step: float) -> Array:
    e = np.zeros(6)
    e[i] = step
    return errors(effects, x, replace(truth, gyro=truth.gyro + e[:3], accel=truth.accel + e[3:]))


def truth_of(effects: Sequence[Effect], x: Array, readings: Signals) -> tuple[Signals, Array]:
    """The truth whose readings these are, and ``by_truth`` there (Newton's method).

    Where the errors are too large for one truth to belong to each reading, the last round's.
    """
    raw = np.hstack([readings.gyro, readings.accel])
    truth, slope = readings, by_truth(effects, x, readings)
    for _ in range(ROUNDS):
        own = np.hstack([truth.gyro, truth.accel])
        off = own + errors(effects, x, truth) - raw
        if np.abs(off).max() <= 4e-16 * max(1.0, float(np.abs(own).max())):
            break
        if truth is not readings:
            slope = by_truth(effects, x, truth)
        own = own - np.linalg.solve(slope, off[:, :, None])[:, :, 0]
        truth = replace(truth, gyro=own[:, :3], accel=own[:, 3:])
    return truth, slope


# --- linear algebra -----------------------------------------------------------------------------


@dataclass(frozen=True)
class Estimate:
    """x (k,) and its covariance P (k, k) for rows of unit variance; residual (m,) of the rows;
    leverage (m,): the share of each row that the estimate fits by itself."""

    x: Array
    P: Array
    residual: Array
    leverage: Array

    @property
    def sigma(self) -> Array:
        """Standard deviations (k,)."""
        return np.asarray(np.sqrt(np.diag(self.P)))


def least_squares(A: Array, y: Array) -> Estimate:
    """x that makes A x nearest to y; A (m, k) of full rank, rows of unit variance.

    By singular values of A with columns of length one, so that units do not matter.
    """
    size = np.linalg.norm(A, axis=0)
    size = np.where(size > 0.0, size, 1.0)
    U, s, Vt = np.linalg.svd(A / size, full_matrices=False)
    root = Vt.T / s / size[:, None]
    x = root @ (U.T @ y)
    # once more on what is left, against rounding
    x = x + root @ (U.T @ (y - A @ x))
    return Estimate(x, root @ root.T, y - A @ x, np.einsum("ij,ij->i", U, U))


def kalman(A: Array, y: Array, prior: tuple[Array, Array] | None = None) -> tuple[Array, Array]:
    """The same estimate by a Kalman filter, one row after the other: x (k,), P (k, k).

    A (m, k), y (m,): rows of unit variance. prior: mean and covariance, of full rank. The filter
    starts from rows that together determine everything (and the prior), which it would
    otherwise have to tell from a prior far wider than the result, and lose digits. Joseph form.
    """
    first = _telling_rows(A)
    start, at = A[first], y[first]
    if prior is not None:
        L = np.linalg.cholesky(prior[1])
        start = np.vstack([start, solve_triangular(L, np.eye(len(L)), lower=True)])
        at = np.concatenate([at, solve_triangular(L, prior[0], lower=True)])
    begin = least_squares(start, at)
    # about the start, in units of what it knows: P begins as the identity
    root = np.linalg.cholesky(begin.P)
    z, P, one = np.zeros(len(root)), np.eye(len(root)), np.eye(len(root))
    for i in np.setdiff1d(np.arange(len(A)), first):
        H = A[i] @ root
        PH = P @ H
        gain = PH / (H @ PH + 1.0)
        z = z + gain * (y[i] - A[i] @ begin.x - H @ z)
        keep = one - np.outer(gain, H)
        P = keep @ P @ keep.T + np.outer(gain, gain)
    return begin.x + root @ z, root @ P @ root.T


def _telling_rows(A: Array) -> IntArray:
    """Indices (k,) of rows of A (m, k) that together determine everything well (QR, pivots)."""
    size = np.linalg.norm(A, axis=0)
    rows = qr((A / np.where(size > 0.0, size, 1.0)).T, mode="r", pivoting=True)[1]
    return np.asarray(np.sort(rows[: A.shape[1]]), dtype=np.int64)


def condition(A: Array) -> float:
    """Condition number of A (m, k) with columns of length one: units do not matter."""
    size = np.linalg.norm(A, axis=0)
    return float(np.linalg.cond(A / size)) if np.all(size > 0.0) else float("inf")


def unseen(A: Array, usual: Array, noise: bool = False) -> list[Array]:
    """Combinations (k,) of parameters that the rows A (m, k) do not show, each as sparse as can
    be and scaled by ``usual`` (k,): +-1 is a usual change of that parameter.

    noise: the rows have unit variance, and what is known worse than is usual counts as
    unseen too. Kronecker and Capelli: there are none if and only if rank A = k.
    """
    k = A.shape[1]
    B = A * usual
    size = np.linalg.norm(B, axis=0)
    size = np.where(size > 0.0, size, 1.0)
    _, s, Vt = np.linalg.svd(B if noise else B / size)
    s = np.r_[s, np.zeros(k - len(s))]
    least = max(NOTHING * s[0], 1.0 if noise else 0.0) if s[0] > 0.0 else 1.0
    null = Vt[s <= least]
    # where columns have length one, a small entry does little to any row
    found = _sparse(null * size if noise else null, 1e-2 if noise else 1e-8)
    combinations = [row / size / np.abs(row / size).max() for row in found]
    if noise:
        # a change that the noise hides need not be made up for by another
        kept = [(np.abs(c) * size >= 1.0) | (np.abs(c) == 1.0) for c in combinations]
        return [np.where(k, c, 0.0) for k, c in zip(kept, combinations, strict=True)]
    return combinations


def _sparse(basis: Array, nothing: float) -> list[Array]:
    """The same space by vectors with as many zeros (row echelon form, largest pivots)."""
    rows = basis.copy()
    done: list[int] = []
    for _ in range(len(rows)):
        free = [i for i in range(len(rows)) if i not in done]
        i = max(free, key=lambda r: float(np.abs(rows[r]).max()))
        j = int(np.argmax(np.abs(rows[i])))
        rows[i] /= rows[i, j]
        for other in range(len(rows)):
            if other != i:
                rows[other] -= rows[other, j] * rows[i]
        done.append(i)
    return [np.where(np.abs(row) < nothing * np.abs(row).max(), 0.0, row) for row in rows]
