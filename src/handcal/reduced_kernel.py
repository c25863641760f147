"""The compiled filter over the moving states alone, and its adjoint (see ``evidence``)."""

from __future__ import annotations

from typing import NamedTuple

from handcal._jit import copy1, copy2, inner, lean, zero1, zero2
from handcal.covariance import Propagation, propagate, times_transition
from handcal.types import Array, IntArray


class Reduced(NamedTuple):
    """A linearised problem of m = 9 + e moving states, as columns of 1 + nc numbers.

    The first column is for constants as the trajectory has them, the others are derivatives
    by the nc biases and constants, each in units of its prior sigma. k epochs, s scalars.
    A (k, 9, 15 + mi), of which the first nine columns count; D (k, 9, 1 + nc) added by an
    interval; Q (k, 9, 9); B (k, 9, e), Phi_e, Q_e (k, e, e), Phi_psi (k, e, 3), d_e (k, e):
    Markov states; first (k + 1,): scalars of each epoch; g (s, 1 + nc): observed minus
    predicted; h (s, m) with its nonzero (s,) entries listed in at (s, m); R (s,).
    """

    A: Array
    D: Array
    Q: Array
    B: Array
    Phi_e: Array
    Q_e: Array
    d_e: Array
    Phi_psi: Array
    first: IntArray
    g: Array
    h: Array
    at: IntArray
    nonzero: IntArray
    R: Array


@inner
def reduced_update(
    P: Array,
    X: Array,
    g: Array,
    h: Array,
    at: IntArray,
    R: float,
    ph: Array,
    gain: Array,
    nu: Array,
) -> float:
    """``scalar_update`` of X (m, 1 + nc) and P (m, m); at: where h is not zero.

    gain (m,) and the innovation nu (1 + nc,) are written; returns the innovation's variance.
    """
    m, columns = X.shape
    copy1(g, nu)
    zero1(ph)
    for a in at:
        for c in range(columns):
            nu[c] -= h[a] * X[a, c]
        for i in range(m):
            ph[i] += h[a] * P[a, i]
    S: float = R
    for a in at:
        S += h[a] * ph[a]
    for i in range(m):
        k = ph[i] / S
        gain[i] = k
        for c in range(columns):
            X[i, c] += k * nu[c]
    for i in range(m):
        for j in range(m):
            P[i, j] -= gain[i] * ph[j]
        s = gain[i] * R
        for a in at:
            s -= P[i, a] * h[a]
        for j in range(m):
            P[i, j] += s * gain[j]
    for i in range(m):
        for j in range(i):
            s = 0.5 * (P[i, j] + P[j, i])
            P[i, j] = s
            P[j, i] = s
    return S


@lean
def reduced_forward(
    a: Reduced,
    P: Array,
    X: Array,
    states: tuple[Array, Array],
    scalars: tuple[Array, Array, Array],
    gram: Array,
    work: Propagation,
    extra: tuple[Array, Array],
    keep: IntArray,
) -> None:
    """Kalman filter over the moving states alone, for all values of the constants at once.

    states: X (., m, 1 + nc) and P (., m, m) after each epoch, in the row that ``keep`` (k,) says
    (-1: nowhere); scalars: gain (s, m), innovation (s, 1 + nc) and its variance (s,). gram
    (1 + nc, 1 + nc) receives the lower half of the sum of nu nu' / S, which is all that the
    evidence and the constants need. extra (m, 1 + nc), (m,): work space.
    """
    m, columns = X.shape
    e = m - 9
    new, ph = extra
    e0 = m - e  # (nine; the literal would have numba compile its callees once more)
    for j in range(len(a.first) - 1):
        if j > 0:
            times_transition(a.A[j], a.B[j], a.Phi_e[j], a.Phi_psi[j], e0, X, new)
            propagate(P, a.A[j], a.B[j], a.Phi_e[j], a.Phi_psi[j], e0, work)
            for i in range(9):
                for c in range(columns):
                    X[i, c] = new[i, c] + a.D[j, i, c]
                for c in range(9):
                    P[i, c] += a.Q[j, i, c]
            for i in range(e):
                for c in range(columns):
                    X[9 + i, c] = new[9 + i, c]
                X[9 + i, 0] += a.d_e[j, i]
                for c in range(e):
                    P[9 + i, 9 + c] += a.Q_e[j, i, c]
        for q in range(a.first[j], a.first[j + 1]):
            scalars[2][q] = reduced_update(
                P,
                X,
                a.g[q],
                a.h[q],
                a.at[q, : a.nonzero[q]],
                a.R[q],
                ph,
                scalars[0][q],
                scalars[1][q],
            )
            for i in range(columns):
                s = scalars[1][q, i] / scalars[2][q]
                for c in range(i + 1):
                    gram[i, c] += s * scalars[1][q, c]
        if keep[j] >= 0:
            copy2(X, states[0][keep[j]])
            copy2(P, states[1][keep[j]])


@inner
def times_transposed(
    Phi: Array, B: Array, Phi_e: Array, Phi_psi: Array, X: Array, out: Array
) -> None:
    """out = F' X for the moving states (m, n)."""
    n = X.shape[1]
    e = Phi_e.shape[0]
    zero2(out)
    for i in range(9):
        for k in range(9):
            a = Phi[i, k]
            if a != 0.0:
                for j in range(n):
                    out[k, j] += a * X[i, j]
        for k in range(B.shape[1]):
            a = B[i, k]
            if a != 0.0:
                for j in range(n):
                    out[9 + k, j] += a * X[i, j]
    for i in range(e):
        for k in range(e):
            a = Phi_e[i, k]
            if a != 0.0:
                for j in range(n):
                    out[9 + k, j] += a * X[9 + i, j]
        for k in range(3):
            a = Phi_psi[i, k]
            if a != 0.0:
                for j in range(n):
                    out[6 + k, j] += a * X[9 + i, j]


@inner
def adjoint_update(
    r: Array,
    N: Array,
    h: Array,
    at: IntArray,
    gain: Array,
    nu: Array,
    S: float,
    given: Array,
    error: Array,
    u: Array,
) -> float:
    """Take r (m, columns) and N (m, m) from after a scalar update to before it.

    given (1 + nc, columns) turns the innovation nu into the one at the constants' posterior
    mean and its spread. Returns the derivative of the log-evidence by the scalar's variance
    R. error (columns,) and u (m,) are work space.
    """
    m, columns = r.shape
    zero1(error)
    for i in range(len(nu)):
        weight = nu[i] / S
        for c in range(columns):
            error[c] += weight * given[i, c]
    for i in range(m):
        for c in range(columns):
            error[c] -= gain[i] * r[i, c]
    slope = -1.0 / S
    for c in range(columns):
        slope += error[c] * error[c]
    for a in at:
        for c in range(columns):
            r[a, c] += h[a] * error[c]
    if len(N) == 0:
        return 0.0
    zero1(u)
    for i in range(m):
        for j in range(m):
            u[j] += gain[i] * N[i, j]
    s = 0.0
    for i in range(m):
        s += gain[i] * u[i]
    for a in at:
        for i in range(m):
            N[a, i] -= h[a] * u[i]
            N[i, a] -= h[a] * u[i]
        for b in at:
            N[a, b] += h[a] * h[b] * (s + 1.0 / S)
    by_R: float = 0.5 * (slope - s)
    return by_R


@lean
def reduced_backward(
    a: Reduced,
    gain: Array,
    nu: Array,
    S: Array,
    given: Array,
    Q_unit: tuple[Array, Array],
    r: Array,
    N: Array,
    states: tuple[Array, Array],
    slopes: tuple[Array, Array, Array, Array],
    work: tuple[Array, Array, Array, Array, Array],
    keep: IntArray,
) -> None:
    """Fixed-interval recursion of Bryson and Frazier, and with it the score.

    r (m, columns) and N (m, m, or empty if only the mean is wanted) start as zeros and end
    as those of the prior. given (1 + nc, columns): as in ``adjoint_update``. states: r and
    N after the observations of each epoch, in the row that ``keep`` (k,) says (-1: nowhere), or
    empty. slopes: derivatives of the
    log-evidence by R (s,), by the two densities whose Q (k, 9, 9) are Q_unit (2,), by Q_e
    (k, e, e) and by the prior of the moving states (m, m). work: (m, columns), (m, m),
    (m, m), (columns,), (m,).

    Source: Durbin & Koopman, Time Series Analysis by State Space Methods, 4.5 and 7.3.3;
    with constants as in de Jong (1991).
    """
    m = len(r)
    e = m - 9
    new, left, half, error, u = work
    score = len(N) > 0
    for j in range(len(a.first) - 2, -1, -1):
        if len(states[0]) > 0 and keep[j] >= 0:
            copy2(r, states[0][keep[j]])
        if len(states[1]) > 0 and keep[j] >= 0:
            copy2(N, states[1][keep[j]])
        for q in range(a.first[j + 1] - 1, a.first[j] - 1, -1):
            at = a.at[q, : a.nonzero[q]]
            slopes[0][q] = adjoint_update(r, N, a.h[q], at, gain[q], nu[q], S[q], given, error, u)
        if score:
            _covariance_slope(r, N, slopes[3])
            for i in range(9):
                for k in range(9):
                    slopes[1][0] += slopes[3][i, k] * Q_unit[0][j, i, k]
                    slopes[1][1] += slopes[3][i, k] * Q_unit[1][j, i, k]
            for i in range(e):
                for k in range(e):
                    slopes[2][j, i, k] = slopes[3][9 + i, 9 + k]
        if j > 0:
            times_transposed(a.A[j], a.B[j], a.Phi_e[j], a.Phi_psi[j], r, new)
            copy2(new, r)
            if score:
                times_transposed(a.A[j], a.B[j], a.Phi_e[j], a.Phi_psi[j], N, left)
                for i in range(m):
                    for k in range(m):
                        half[k, i] = left[i, k]
                times_transposed(a.A[j], a.B[j], a.Phi_e[j], a.Phi_psi[j], half, left)
                for i in range(m):
                    for k in range(m):
                        N[i, k] = 0.5 * (left[i, k] + left[k, i])


@inner
def _covariance_slope(r: Array, N: Array, out: Array) -> None:
    """Derivative (m, m) of the log-evidence by a covariance added here: (E r r' - N) / 2."""
    m, columns = r.shape
    for i in range(m):
        for k in range(i + 1):
            s = -N[i, k]
            for c in range(columns):
                s += r[i, c] * r[k, c]
            out[i, k] = 0.5 * s
            out[k, i] = 0.5 * s
