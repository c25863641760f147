"""Rows of the least squares for rests under gravity of unknown direction, and turns between.

Unknown are the parameters x (k,) and the directions d (r, 3) of the specific force in the
rests, each with two degrees of freedom across it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from handcal.compiled.so3 import skew
from handcal.effects import Effect, Signals
from handcal.estimate import regression
from handcal.estimate.regression import Unknown
from handcal.lab.stretches import Means
from handcal.lab.turns import Turns, turned
from handcal.signals import of_arrays
from handcal.types import Array, IntArray

KINDS = ("accel", "gyro", "turn")


@dataclass(frozen=True)
class Problem:
    """Effects (biases among them) with their parameters, rests, turns, and gravity in m/s^2."""

    effects: tuple[Effect, ...]
    unknowns: tuple[Unknown, ...]
    rests: Means
    turns: Turns
    gravity: float


@dataclass(frozen=True)
class Rows:
    """Rows (m, ...) in the order accel, gyro, turn: what is left y (m,), derivatives by the
    directions N (m, 2 r) and the parameters A (m, k), variances (m,), kind (m,) of KINDS, and
    the unit (m,) of the standard deviation that comes on top."""

    y: Array
    N: Array
    A: Array
    variance: Array
    kind: IntArray
    unit: Array

    @property
    def both(self) -> Array:
        """Derivatives (m, 2 r + k) by directions and parameters."""
        return np.hstack([self.N, self.A])

    def total(self, extra: Mapping[str, float]) -> Array:
        """Variances (m,) with what comes on top, by kind."""
        more = np.array([extra[k] for k in KINDS])[self.kind] * self.unit
        return np.asarray(self.variance + more**2)

    def reduced(self, variance: Array) -> Array:
        """Rows (m, k) about the parameters alone, of unit variance: what is left of A once the
        unknown directions have taken their share."""
        root = np.sqrt(variance)[:, None]
        Q, _ = np.linalg.qr(self.N / root)
        A = self.A / root
        return np.asarray(A - Q @ (Q.T @ A))


def rows_of(problem: Problem, x: Array, d: Array) -> Rows:
    """Rows linearised about the parameters x (k,), SI, and the directions of up d (n, 3) in the
    body at the rests: what the rests read and what the turns between them say."""
    rests, r, k = problem.rests, len(d), len(x)
    truth = resting(problem, d)
    error = regression.errors(problem.effects, x, truth)
    J = regression.columns(problem.effects, x, truth)
    by = regression.by_truth(problem.effects, x, truth)
    off = rests.reading - error
    off[:, 3:] -= truth.accel
    sideways = problem.gravity * across(d)
    N = np.zeros((r, 6, r, 2))
    N[range(r), :, range(r), :] = by[:, :, 3:] @ sideways
    y, N_t, A_t, v = _turn_rows(problem, x, d)
    order = [slice(3, None), slice(0, 3)]
    parts = [3 * r, 3 * r, len(y)]
    return Rows(
        np.concatenate([*(off[:, s].ravel() for s in order), y]),
        np.vstack([*(N[:, s].reshape(3 * r, 2 * r) for s in order), N_t]),
        np.vstack([*(J[:, s].reshape(3 * r, k) for s in order), A_t]),
        np.concatenate([*(rests.variance[:, s].ravel() for s in order), v]),
        np.repeat(np.arange(3), parts),
        np.r_[np.ones(6 * r), np.repeat(problem.turns.missed, 2)],
    )


def _turn_rows(problem: Problem, x: Array, d: Array) -> tuple[Array, Array, Array, Array]:
    """Two rows for each turn: gravity as the gyro carries it against where it is."""
    r, k, q = len(d), len(x), len(problem.turns)
    y, v = np.zeros((q, 2)), np.zeros((q, 2))
    N, A = np.zeros((q, 2, r, 2)), np.zeros((q, 2, k))
    sideways = across(d)
    C, slope = carried_by_gyro(problem, x, d)
    noise, mean = problem.rests.white[:3].mean(), problem.rests.variance[:, :3].mean(axis=1)
    for n, (i, j) in enumerate(zip(problem.turns.before, problem.turns.after, strict=True)):
        carried = C[n].T @ d[i]
        T = sideways[j].T
        y[n] = -T @ carried
        N[n, :, i] = T @ C[n].T @ sideways[i]
        # T follows d[j]: what turns with it is not seen, but carried is nearly d[j]
        N[n, :, j] = -(d[j] @ carried) * np.eye(2)
        A[n] = T @ skew(carried) @ slope[n]
        s = problem.turns.seconds[n]
        v[n] = noise * s + 0.5 * (mean[i] + mean[j]) * s**2
    return y.ravel(), N.reshape(2 * q, 2 * r), A.reshape(2 * q, k), v.ravel()


def carried_by_gyro(problem: Problem, x: Array, d: Array) -> tuple[Array, Array]:
    """The turns C (q, 3, 3) and their derivatives (q, 3, k), see ``turned``."""
    if len(problem.turns) == 0:
        return np.zeros((0, 3, 3)), np.zeros((0, 3, len(x)))
    truth = resting(problem, d)
    error = regression.errors(problem.effects, x, truth)[:, :3]
    bias = np.array([u.effect == "gyro_bias" for u in problem.unknowns])
    J = regression.columns(problem.effects, x, truth)[:, :3]
    still = np.concatenate([(error - x[bias])[:, :, None], np.where(bias, 0.0, J)], axis=2)
    return turned(problem.turns, problem.effects, x, still, bias)


def resting(problem: Problem, d: Array) -> Signals:
    """The truth at the rests, whose up is d (n, 3): no rate, and gravity, m/s^2."""
    rests = problem.rests
    return of_arrays(
        rests.span.mean(axis=1), np.zeros_like(d), problem.gravity * d, rests.temperature
    )


def unit(x: Array) -> Array:
    """Rows x (n, 3) of length one."""
    return np.asarray(x / np.linalg.norm(x, axis=1, keepdims=True))


def across(d: Array) -> Array:
    """Two directions (n, 3, 2) across each direction d (n, 3), of length one."""
    axis = np.eye(3)[np.argmin(np.abs(d), axis=1)]
    first = unit(np.cross(d, axis))
    return np.stack([first, np.cross(d, first)], axis=2)
