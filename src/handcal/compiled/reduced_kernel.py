"""The compiled filter over the moving states alone, and its adjoint (see ``evidence``)."""

from __future__ import annotations

from typing import NamedTuple

from handcal.compiled.covariance import Propagation, propagate, symmetrise, times_transition
from handcal.compiled.jit import copy2, inner, lean, zero1, zero2
from handcal.compiled.rows import add_outer, add_product, add_row, product, set_row
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
    nu: Array,
    h: Array,
    at: IntArray,
    R: float,
    work: tuple[Array, Array, Array],
    gain: Array,
) -> float:
    """``scalar_update`` of X (m, w) and P (m, p), wider than the states by zeros; at: where h is
    not zero.

    nu (w,) is what was observed minus predicted about X = 0, and becomes the innovation; gain (m,)
    is written. Returns the innovation's variance.
    """
    minus_ph, own, back = work
    m = len(gain)
    zero1(minus_ph)
    for a in at:
        add_row(-h[a], X, a, nu)
        add_row(-h[a], P, a, minus_ph)
    S: float = R
    for a in at:
        S -= h[a] * minus_ph[a]
    set_row(-1.0 / S, minus_ph, 0, own)
    for i in range(m):
        gain[i] = own[i]
        add_row(own[i], nu, 0, X[i])
    # (I - K h) P is not symmetric in round-off: multiply by (I - K h)' from what it is
    set_row(R, own, 0, back)
    for a in at:
        for i in range(m):
            back[i] -= (P[i, a] + own[i] * minus_ph[a]) * h[a]
    add_outer(own, minus_ph, back, own, P)
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
    extra: tuple[Array, tuple[Array, Array, Array], tuple[Array, Array]],
    keep: IntArray,
) -> None:
    """Kalman filter over the moving states alone, for all values of the constants at once.

    X (m, w), w >= 1 + nc, and P (m, m). states: X (., m, 1 + nc) and P (., m, m) after each epoch,
    in the row that ``keep`` (k,) says (-1: nowhere); scalars: gain (s, m), innovation (s, 1 + nc)
    and its variance (s,). gram (w, w) receives the sum of nu nu' / S, which is all that the
    evidence and the constants need. extra: work space (m, w); three (m,); (w, b) and (b, w) for
    innovations that are added up b at a time.
    """
    m, columns = len(X), scalars[1].shape[1]
    e = m - 9
    new, update, some = extra
    e0 = m - e  # (nine; the literal would have numba compile its callees once more)
    waiting = 0
    for j in range(len(a.first) - 1):
        if j > 0:
            times_transition(a.A[j], a.B[j], a.Phi_e[j], a.Phi_psi[j], e0, X, new)
            propagate(P, a.A[j], a.B[j], a.Phi_e[j], a.Phi_psi[j], e0, work)
            copy2(new, X)
            for i in range(9):
                for c in range(columns):
                    X[i, c] += a.D[j, i, c]
                for c in range(9):
                    P[i, c] += a.Q[j, i, c]
            for i in range(e):
                X[9 + i, 0] += a.d_e[j, i]
                for c in range(e):
                    P[9 + i, 9 + c] += a.Q_e[j, i, c]
        for q in range(a.first[j], a.first[j + 1]):
            nu = some[1][waiting]
            for c in range(columns):
                nu[c] = a.g[q, c]
            at = a.at[q, : a.nonzero[q]]
            S = reduced_update(P, X, nu, a.h[q], at, a.R[q], update, scalars[0][q])
            scalars[2][q] = S
            for c in range(columns):
                scalars[1][q, c] = nu[c]
                some[0][c, waiting] = nu[c] / S
            waiting += 1
            if waiting == len(some[1]):
                add_product(some[0], some[1], waiting, gram)
                waiting = 0
        symmetrise(P)
        if keep[j] >= 0:
            _copied(X, states[0][keep[j]])
            copy2(P, states[1][keep[j]])
    add_product(some[0], some[1], waiting, gram)


@inner
def _copied(x: Array, out: Array) -> None:
    """As much of x as there is room for in ``out``."""
    for i in range(out.shape[0]):
        for c in range(out.shape[1]):
            out[i, c] = x[i, c]


@inner
def _turned_over(Phi: Array, B: Array, Phi_e: Array, Phi_psi: Array, out: Array) -> None:
    """out (m, m) = F', the transition of the moving states turned over."""
    e = Phi_e.shape[0]
    zero2(out)
    for i in range(9):
        for k in range(9):
            out[k, i] = Phi[i, k]
        for k in range(B.shape[1]):
            out[9 + k, i] = B[i, k]
    for i in range(e):
        for k in range(e):
            out[9 + k, 9 + i] = Phi_e[i, k]
        for k in range(3):
            out[6 + k, 9 + i] = Phi_psi[i, k]


@inner
def adjoint_update(
    r: Array,
    N: Array,
    h: Array,
    at: IntArray,
    gain: Array,
    S: float,
    error: Array,
    u: Array,
) -> float:
    """Take r (m, w) and N (m, p) from after a scalar update to before it.

    error (w,) is the innovation at the constants' posterior mean and its spread, and is used up; u
    (p,) is work space. Returns the derivative of the log-evidence by the scalar's variance R.
    """
    m = len(r)
    set_row(1.0 / S, error, 0, error)
    for i in range(m):
        add_row(-gain[i], r, i, error)
    slope = -1.0 / S
    for c in range(len(error)):
        slope += error[c] * error[c]
    for a in at:
        add_row(h[a], error, 0, r[a])
    if len(N) == 0:
        return 0.0
    zero1(u)
    for i in range(m):
        add_row(gain[i], N, i, u)
    s = 0.0
    for i in range(m):
        s += gain[i] * u[i]
    for a in at:
        add_row(-h[a], u, 0, N[a])
        for i in range(m):
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
    work: tuple[Array, Array, Array, Array, Array, Array],
    keep: IntArray,
    by_step: tuple[Array, Array],
    passed: tuple[Array, Array],
    work_step: tuple[Array, Array, Array, Array, Array],
) -> None:
    """Fixed-interval recursion of Bryson and Frazier, and with it the score.

    r (m, w) and N (m, p; or empty if only the mean is wanted) start as zeros and end
    as those of the prior; both may be wider than what is wanted by columns of zeros. given
    (1 + nc, w): what makes of an innovation the one at the constants' posterior mean, and its
    spread. states: r and N after the observations of each epoch, in the row that ``keep`` (k,)
    says (-1: nowhere), or empty. slopes: derivatives of the
    log-evidence by R (s,), by the two densities whose Q (k, 9, 9) are Q_unit (2,), by Q_e
    (k, e, e) and by the prior of the moving states (m, m). work: as r; as it turned over, (w, p);
    (m, m), (m, p), as many innovations as an epoch has, (n, w), and (p,). by_step: derivatives by
    the Markov states' own transitions (k, e, 3 + e), from psi and from each other, and by what is
    added to them (k, e), or empty; passed: X and P after each epoch, for these, with work space
    (3 + e, w), (w, b), (m, m), (m, b), (e, b), b >= 3 + e.

    Source: Durbin & Koopman, Time Series Analysis by State Space Methods, 4.5 and 7.3.3;
    with constants as in de Jong (1991).
    """
    m = len(r)
    e = m - 9
    new, over, back, square, errors, u = work
    score = len(N) > 0
    for j in range(len(a.first) - 2, -1, -1):
        if len(states[0]) > 0 and keep[j] >= 0:
            _copied(r, states[0][keep[j]])
        if len(states[1]) > 0 and keep[j] >= 0:
            _copied(N, states[1][keep[j]])
        begin, end = a.first[j], a.first[j + 1]
        product(nu[begin:end], given, len(given), errors[: end - begin])
        for q in range(end - 1, begin - 1, -1):
            at = a.at[q, : a.nonzero[q]]
            slopes[0][q] = adjoint_update(r, N, a.h[q], at, gain[q], S[q], errors[q - begin], u)
        if score:
            _covariance_slope(r, N, over, square, slopes[3])
            for i in range(9):
                for k in range(9):
                    slopes[1][0] += slopes[3][i, k] * Q_unit[0][j, i, k]
                    slopes[1][1] += slopes[3][i, k] * Q_unit[1][j, i, k]
            for i in range(e):
                for k in range(e):
                    slopes[2][j, i, k] = slopes[3][9 + i, 9 + k]
        if j > 0 and len(by_step[0]) > 0:
            times_transition(
                a.A[j], a.B[j], a.Phi_e[j], a.Phi_psi[j], m - e, passed[1][j - 1], work_step[2]
            )
            _step_slope(r, slopes[3], passed[0][j - 1], given, work_step, by_step[0][j])
            for i in range(e):
                by_step[1][j, i] = r[9 + i, 0]
        if j > 0:
            _turned_over(a.A[j], a.B[j], a.Phi_e[j], a.Phi_psi[j], back)
            product(back, r, m, new)
            copy2(new, r)
            if score:
                _carried_back(back, N, square)


@inner
def _carried_back(back: Array, N: Array, work: Array) -> None:
    """N (m, p) becomes F' N F, symmetric; back (m, m) is F'."""
    m = len(back)
    product(back, N, m, work)
    for i in range(m):
        for k in range(m):
            N[k, i] = work[i, k]
    product(back, N, m, work)
    for i in range(m):
        for k in range(i + 1):
            s = 0.5 * (work[i, k] + work[k, i])
            N[i, k] = s
            N[k, i] = s


@inner
def _covariance_slope(r: Array, N: Array, over: Array, square: Array, out: Array) -> None:
    """Derivative (m, m) of the log-evidence by a covariance added here: (E r r' - N) / 2."""
    m, columns = r.shape
    for i in range(m):
        for c in range(columns):
            over[c, i] = r[i, c]
    product(r, over, columns, square)
    for i in range(m):
        for k in range(m):
            out[i, k] = 0.5 * (square[i, k] - N[i, k])


@inner
def _step_slope(
    r: Array,
    by_Q: Array,
    X: Array,
    given: Array,
    work: tuple[Array, Array, Array, Array, Array],
    out: Array,
) -> None:
    """Derivative (e, 3 + e) of the log-evidence by the transition F of the Markov states, from psi
    and from each other: E r a' + (E r r' - N) F P, where a and P are the state before.

    The log-evidence depends on F by the predicted state, F a, and its covariance, F P F'. by_Q:
    (E r r' - N) / 2; X (m, 1 + nc) of the epoch before; work: as in ``reduced_backward``, the third
    of them F P.
    """
    state, over, FP, some, total = work
    e = len(out)
    product(X[6:], given, len(given), state)
    for i in range(3 + e):
        for c in range(state.shape[1]):
            over[c, i] = state[i, c]
    for i in range(9 + e):
        for c in range(3 + e):
            some[i, c] = 2.0 * FP[i, 6 + c]
    product(r[9:], over, r.shape[1], total)
    add_product(by_Q[9:], some, 9 + e, total)
    for i in range(e):
        for c in range(3 + e):
            out[i, c] = total[i, c]
