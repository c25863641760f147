"""Small dense matrices in plain loops: numpy's algebra takes numba far longer to compile."""

from __future__ import annotations

import math

import numpy as np

from handcal.compiled.jit import njit
from handcal.types import Array


@njit
def congruent(W: Array, G: Array, diagonal: bool) -> Array:
    """W G W' (m, m), of symmetric G."""
    m = len(W)
    out = np.zeros((m, m))
    if diagonal:
        for i in range(m):
            for j in range(m):
                out[i, j] = W[i, i] * G[i, j] * W[j, j]
        return out
    half = np.zeros((m, m))
    for i in range(m):
        for k in range(m):
            for j in range(m):
                half[i, j] += W[i, k] * G[k, j]
    for i in range(m):
        for k in range(m):
            for j in range(m):
                out[i, j] += half[i, k] * W[j, k]
    return out


@njit
def rooted(A: Array) -> bool:
    """Cholesky's root in the lower half of A (m, m); False where A is not positive."""
    for i in range(len(A)):
        for j in range(i + 1):
            s = 0.5 * (A[i, j] + A[j, i])
            for k in range(j):
                s -= A[i, k] * A[j, k]
            if i > j:
                A[i, j] = s / A[j, j]
                continue
            if not s > 0.0:
                return False
            A[i, i] = math.sqrt(s)
    return True


@njit
def forward(L: Array, y: Array) -> None:
    """y (m,) becomes L^-1 y."""
    for i in range(len(y)):
        for k in range(i):
            y[i] -= L[i, k] * y[k]
        y[i] /= L[i, i]


@njit
def forward_rows(L: Array, X: Array, diagonal: bool) -> None:
    """X (m, m) becomes L^-1 X; of a diagonal one that is a lower half."""
    for i in range(len(X)):
        for k in range(i):
            for j in range(k + 1 if diagonal else len(X)):
                X[i, j] -= L[i, k] * X[k, j]
        for j in range(i + 1 if diagonal else len(X)):
            X[i, j] /= L[i, i]


@njit
def gram(X: Array, y: Array, mean: Array, C: Array, lower: bool) -> None:
    """X' y and X' X are written to mean (m,) and C (m, m)."""
    m = len(X)
    for i in range(m):
        mean[i] = 0.0
        for j in range(m):
            C[i, j] = 0.0
    for i in range(m):
        for j in range(i + 1 if lower else m):
            mean[j] += X[i, j] * y[i]
            for k in range(j + 1):
                C[j, k] += X[i, j] * X[i, k]
    for j in range(m):
        for k in range(j):
            C[k, j] = C[j, k]
