"""The compiled way back over the moving states alone, for means, covariances and slopes given the
whole recording (see ``evidence``)."""

from __future__ import annotations

from typing import NamedTuple

from handcal.compiled.jit import copy2, inner, lean
from handcal.compiled.reduced_kernel import Reduced, both_sides, copied
from handcal.compiled.rows import (
    add_listed,
    add_outer,
    add_product,
    add_row,
    product,
    set_row,
    squares,
    symmetrise,
)
from handcal.compiled.sparse import Entries, list_entries, times_entries, turn_over
from handcal.types import Array, IntArray


class BackwardWork(NamedTuple):
    """Work space of ``reduced_backward``, of which an epoch has n scalars at the most: entries of
    the transition, and turned over; r carried (m, w) and transposed (w, p); covariances (m, p),
    twice; innovations (n, w), their gains (n, m) and rows of h (m, n); u (1, p), h and what the
    latter is multiplied by (p,)."""

    entries: Entries
    turned: Entries
    carried: Array
    over: Array
    square: Array
    other: Array
    errors: Array
    gains: Array
    seen: Array
    u: Array
    h: Array
    v: Array


@inner
def _adjoint_errors(
    a: Reduced, j: int, gain: Array, S: Array, r: Array, by_R: Array, w: BackwardWork
) -> None:
    """Take r (m, w) from after the scalars of epoch j to before them, together.

    ``w.errors`` (n, w) has their innovations at the constants' posterior mean and spread, and is
    used up. by_R (s,) receives half the derivative of the log-evidence by each scalar's variance
    but for what is uncertain of the states.
    """
    begin, end = a.first[j], a.first[j + 1]
    _, place, value = w.entries
    for q in range(begin, end):
        set_row(1.0 / S[q], w.errors[q - begin], 0, w.errors[q - begin])
        for i in range(len(r)):
            w.gains[q - begin, i] = -gain[q, i]
            w.seen[i, q - begin] = a.h[q, i]
    count = end - begin
    add_product(w.gains[:count], r, len(r), w.errors[:count])
    for q in range(end - 1, begin - 1, -1):
        n = 0
        for p in range(q + 1, end):
            x = 0.0
            for i in a.at[p, : a.nonzero[p]]:
                x += gain[q, i] * a.h[p, i]
            if x != 0.0:
                place[n], value[n] = p - begin, -x
                n += 1
        own = w.errors[q - begin]
        add_listed(place, value, 0, n, w.errors, own)
        by_R[q] = 0.5 * (squares(own) - 1.0 / S[q])
    add_product(w.seen, w.errors, count, r)


@inner
def _adjoint_covariance(
    a: Reduced, j: int, gain: Array, S: Array, N: Array, by_R: Array, w: BackwardWork
) -> None:
    """Take N (m, p) from after the scalars of epoch j to before them, symmetric but for round-off:
    (I - K h)' N (I - K h) + h' h / S; and off by_R (s,) what is uncertain of the states."""
    m = len(N)
    for q in range(a.first[j + 1] - 1, a.first[j] - 1, -1):
        product(gain[q : q + 1], N, m, w.u)
        s = 0.0
        for i in range(m):
            w.h[i] = a.h[q, i]
            s += gain[q, i] * w.u[0, i]
        set_row(0.5 * (s + 1.0 / S[q]), w.h, 0, w.v)
        add_row(-1.0, w.u, 0, w.v)
        add_outer(w.h, w.v, w.v, w.h, N)
        by_R[q] -= 0.5 * s


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
    work: BackwardWork,
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
    (k, e, e) and by the prior of the moving states (m, m; here (m, p)). by_step: derivatives by
    the Markov states' own transitions (k, e, 3 + e), from psi and from each other, and by what is
    added to them (k, e), or empty; passed: X and P after each epoch, for these, with work space
    (3 + e, w), (w, b), (m, m), (m, b), (e, b), b >= 3 + e.

    Source: Durbin & Koopman, Time Series Analysis by State Space Methods, 4.5 and 7.3.3;
    with constants as in de Jong (1991).
    """
    m, v = len(r), a.A.shape[1]
    e = m - v
    score = len(N) > 0
    for j in range(len(a.first) - 2, -1, -1):
        if len(states[0]) > 0 and keep[j] >= 0:
            copied(r, states[0][keep[j]])
        if len(states[1]) > 0 and keep[j] >= 0:
            copied(N, states[1][keep[j]])
        begin, end = a.first[j], a.first[j + 1]
        product(nu[begin:end], given, len(given), work.errors[: end - begin])
        _adjoint_errors(a, j, gain, S, r, slopes[0], work)
        if score:
            _adjoint_covariance(a, j, gain, S, N, slopes[0], work)
            _covariance_slope(r, N, work.over, work.square, slopes[3])
            for i in range(v):
                for k in range(v):
                    slopes[1][0] += slopes[3][i, k] * Q_unit[0][j, i, k]
                    slopes[1][1] += slopes[3][i, k] * Q_unit[1][j, i, k]
            for i in range(e):
                for k in range(e):
                    slopes[2][j, i, k] = slopes[3][v + i, v + k]
        if j > 0:
            list_entries(a.A[j], a.B[j], a.Phi_e[j], a.Phi_psi[j], work.entries)
        if j > 0 and len(by_step[0]) > 0:
            times_entries(work.entries, passed[1][j - 1], work_step[2])
            _step_slope(r, slopes[3], passed[0][j - 1], given, work_step, by_step[0][j])
            for i in range(e):
                by_step[1][j, i] = r[v + i, 0]
        if j > 0:
            turn_over(work.entries, m, work.turned)
            times_entries(work.turned, r, work.carried)
            copy2(work.carried, r)
            if score:
                both_sides(work.turned, N, work.square, work.other)
                symmetrise(N)


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
    v = len(r) - e
    # (where nothing is navigated there is no psi, and nothing by it)
    psi = 3 if v > 0 else 0
    product(X[v - psi :], given, len(given), state)
    for i in range(psi + e):
        for c in range(state.shape[1]):
            over[c, i] = state[i, c]
    for i in range(v + e):
        for c in range(psi + e):
            some[i, c] = 2.0 * FP[i, v - psi + c]
    product(r[v:], over, r.shape[1], total)
    add_product(by_Q[v:], some, v + e, total)
    for i in range(e):
        for c in range(psi + e):
            out[i, 3 - psi + c] = total[i, c]
