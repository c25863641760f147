"""Compiled steps of the covariance: carried by a transition, updated by observations."""

from __future__ import annotations

import math

import numpy as np

from handcal._jit import inner
from handcal.types import Array


@inner
def times_transition(
    Phi: Array, B: Array, Phi_e: Array, Phi_psi: Array, e0: int, X: Array, out: Array
) -> None:
    """The rows of out = F X that differ from those of X; the others are left alone.

    F is the full transition made of Phi (9, 15 + mi) in its first nine rows, the identity,
    and from row e0 on, where the Markov states begin, Phi_e (e, e) and Phi_psi (e, 3): how
    Markov states depend on psi. B (9, e), or empty: how the first nine depend on Markov
    states. Without constants, e0 = 9 and Phi is cut to nine columns.
    """
    n = X.shape[1]
    width = min(Phi.shape[1], e0)
    for i in range(9):
        for j in range(n):
            out[i, j] = 0.0
        for k in range(width):
            a = Phi[i, k]
            if a != 0.0:
                for j in range(n):
                    out[i, j] += a * X[k, j]
        for k in range(B.shape[1]):
            a = B[i, k]
            if a != 0.0:
                for j in range(n):
                    out[i, j] += a * X[e0 + k, j]
    for i in range(Phi_e.shape[0]):
        for j in range(n):
            out[e0 + i, j] = 0.0
        for k in range(Phi_e.shape[0]):
            a = Phi_e[i, k]
            if a != 0.0:
                for j in range(n):
                    out[e0 + i, j] += a * X[e0 + k, j]
        for k in range(3):
            a = Phi_psi[i, k]
            if a != 0.0:
                for j in range(n):
                    out[e0 + i, j] += a * X[6 + k, j]


@inner
def propagate(
    P: Array,
    Phi: Array,
    B: Array,
    Phi_e: Array,
    Phi_psi: Array,
    e0: int,
    work: tuple[Array, Array, Array],
) -> None:
    """P = F P F' in place (without Q), F as in ``times_transition``.

    work: (N, N), (N, 9 + e), (N, 9 + e). The constants' own block of P does not change,
    and their rows and columns only once.
    """
    W, W_t, new = work
    n = P.shape[0]
    moved = 9 + Phi_e.shape[0]
    shift = e0 - 9
    times_transition(Phi, B, Phi_e, Phi_psi, e0, P, W)
    for i in range(moved):
        row = i if i < 9 else i + shift
        for j in range(n):
            W_t[j, i] = W[row, j]
    times_transition(Phi, B, Phi_e, Phi_psi, e0, W_t, new)
    for i in range(moved):
        row = i if i < 9 else i + shift
        for j in range(9, e0):
            P[row, j] = W[row, j]
            P[j, row] = W[row, j]
        for j in range(i + 1):
            column = j if j < 9 else j + shift
            s = 0.5 * (new[row, j] + new[column, i])
            P[row, column] = s
            P[column, row] = s


@inner
def propagation_work(n: int, e: int) -> tuple[Array, Array, Array]:
    """Work space of ``propagate`` for n states, e of them Markov states."""
    return np.empty((n, n)), np.empty((n, 9 + e)), np.empty((n, 9 + e))


@inner
def scalar_update(
    P: Array, x: Array, h: Array, r: float, R: float, ph: Array, gain: Array
) -> tuple[float, float]:
    """One scalar Kalman update in Joseph form; returns innovation and its variance.

    (I - K h) P (I - K h)' + K R K', evaluated as two rank-one corrections, then kept
    symmetric. x (N,) and P (N, N) are changed in place; ph, gain (N,) are work space.
    """
    n = len(x)
    S = R
    nu = r
    for i in range(n):
        ph[i] = 0.0
    for a in range(n):
        # most of a row of H is zero
        if h[a] != 0.0:
            nu -= h[a] * x[a]
            for i in range(n):
                ph[i] += h[a] * P[a, i]
    for a in range(n):
        S += h[a] * ph[a]
    for i in range(n):
        gain[i] = ph[i] / S
        x[i] += gain[i] * nu
    for i in range(n):
        for j in range(n):
            P[i, j] -= gain[i] * ph[j]
        # (I - K h) P is not symmetric in round-off: multiply by (I - K h)' from what it is
        s = gain[i] * R
        for a in range(n):
            if h[a] != 0.0:
                s -= P[i, a] * h[a]
        for j in range(n):
            P[i, j] += s * gain[j]
    for i in range(n):
        for j in range(i):
            s = 0.5 * (P[i, j] + P[j, i])
            P[i, j] = s
            P[j, i] = s
    return nu, S


@inner
def update_linear(
    r: Array,
    H: Array,
    d: int,
    R: Array,
    P: Array,
    x: Array,
    out: tuple[Array, Array, Array, Array],
) -> None:
    """Joint update of x and P by d scalars r with rows H and variances R.

    out: the innovation (d,), the square root of the diagonal of S (d,), the NIS (1,) and
    the log of the predictive density (1,).
    """
    residual, sigma, nis, loglik = out
    n = P.shape[0]
    ph, gain = np.empty(n), np.empty(n)
    for j in range(d):
        S = R[j]
        residual[j] = r[j]
        for a in range(n):
            if H[j, a] != 0.0:
                residual[j] -= H[j, a] * x[a]
                for b in range(n):
                    S += H[j, a] * P[a, b] * H[j, b]
        sigma[j] = math.sqrt(S)
    nis[0] = 0.0
    loglik[0] = 0.0
    for j in range(d):
        nu, S = scalar_update(P, x, H[j], r[j], R[j], ph, gain)
        nis[0] += nu * nu / S
        loglik[0] -= 0.5 * (nu * nu / S + math.log(2.0 * math.pi * S))
