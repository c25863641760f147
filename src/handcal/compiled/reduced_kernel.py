"""The compiled filter over the moving states alone (see ``evidence``); ``reduced_adjoint`` is its
way back."""

from __future__ import annotations

import math
from typing import NamedTuple

from handcal.compiled.covariance import ScalarUpdate, scalar_update
from handcal.compiled.jit import copy2, inner, lean
from handcal.compiled.rows import add_gram, add_listed, add_product, set_row, symmetrise
from handcal.compiled.sparse import Entries, list_entries, times_entries
from handcal.types import Array, IntArray


class Reduced(NamedTuple):
    """A linearised problem of m = v + e moving states, as columns of 1 + nc numbers; v: 9 of the
    navigation, or 0 where nothing is navigated.

    The first column is for constants as the trajectory has them, the others are derivatives
    by the nc biases and constants, each in units of its prior sigma. k epochs, s scalars.
    A (k, v, 15 + mi), of which the first v columns count; D (k, v, 1 + nc) added by an
    interval; Q (k, v, v); B (k, v, e), Phi_e, Q_e (k, e, e), Phi_psi (k, e, 3), d_e (k, e):
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


class ForwardWork(NamedTuple):
    """Work space of ``reduced_forward``: entries of the transition; the columns carried (m, w);
    covariances (m, p), twice; what ``scalar_update`` needs; innovations (b, w), which are added up
    b at a time, and their gains (m, b)."""

    entries: Entries
    carried: Array
    square: Array
    over: Array
    update: ScalarUpdate
    some: Array
    gains: Array


@inner
def innovation(
    a: Reduced, q: int, begin: int, X: Array, gain: Array, some: Array, first: int, work: Entries
) -> None:
    """Of what was read in scalar q make the innovation, in a row of ``some`` (b, w), whose row
    ``first`` has that of scalar ``begin``: X (m, w) is still as it was before that one, so what
    came of those in between is taken off. work: entries of any kind."""
    nu, (_, place, value) = some[first + q - begin], work
    at = a.at[q, : a.nonzero[q]]
    for n in range(len(at)):
        value[n] = -a.h[q, at[n]]
    add_listed(at, value, 0, len(at), X, nu)
    count = 0
    for p in range(begin, q):
        x = 0.0
        for i in at:
            x += a.h[q, i] * gain[p, i]
        if x != 0.0:
            place[count], value[count] = first + p - begin, -x
            count += 1
    add_listed(place, value, 0, count, some, nu)


@inner
def _observed(
    a: Reduced,
    j: int,
    P: Array,
    X: Array,
    scalars: tuple[Array, Array, Array],
    gram: Array,
    waiting: int,
    w: ForwardWork,
) -> int:
    """Update P and X by the scalars of epoch j, together: each changes X by its gain times its
    innovation. Returns how many innovations wait to be added up in gram."""
    gain, nu, S = scalars
    begin, last = a.first[j], a.first[j + 1]
    while begin < last:
        end = min(last, begin + len(w.some) - waiting)
        for q in range(begin, end):
            own = w.some[waiting + q - begin]
            for c in range(nu.shape[1]):
                own[c] = a.g[q, c]
            innovation(a, q, begin, X, gain, w.some, waiting, w.entries)
            at = a.at[q, : a.nonzero[q]]
            S[q] = scalar_update(P, a.h[q], at, len(at), a.R[q], w.update)
            for i in range(len(X)):
                gain[q, i] = w.update[1][i]
                w.gains[i, q - begin] = gain[q, i]
            for c in range(nu.shape[1]):
                nu[q, c] = own[c]
        add_product(w.gains, w.some[waiting:], end - begin, X)
        for q in range(begin, end):
            own = w.some[waiting + q - begin]
            set_row(1.0 / math.sqrt(S[q]), own, 0, own)
        waiting += end - begin
        begin = end
        if waiting == len(w.some):
            add_gram(w.some, 0, waiting, gram)
            waiting = 0
    return waiting


@inner
def _carried(a: Reduced, j: int, P: Array, X: Array, w: ForwardWork) -> None:
    """Carry P and X over the interval that ends at epoch j."""
    m, e = len(X), a.Phi_e.shape[1]
    list_entries(a.A[j], a.B[j], a.Phi_e[j], a.Phi_psi[j], w.entries)
    times_entries(w.entries, X, w.carried)
    copy2(w.carried, X)
    both_sides(w.entries, P, w.square, w.over)
    for i in range(m - e):
        for c in range(a.D.shape[2]):
            X[i, c] += a.D[j, i, c]
        for c in range(m - e):
            P[i, c] += a.Q[j, i, c]
    for i in range(e):
        X[m - e + i, 0] += a.d_e[j, i]
        for c in range(e):
            P[m - e + i, m - e + c] += a.Q_e[j, i, c]
    symmetrise(P)


@inner
def both_sides(entries: Entries, P: Array, square: Array, over: Array) -> None:
    """P (m, p) becomes F P F' for the transition F that is listed, symmetric but for round-off."""
    times_entries(entries, P, square)
    for i in range(len(P)):
        for k in range(len(P)):
            over[k, i] = square[i, k]
    times_entries(entries, over, P)


@lean
def reduced_forward(
    a: Reduced,
    P: Array,
    X: Array,
    states: tuple[Array, Array],
    scalars: tuple[Array, Array, Array],
    gram: Array,
    work: ForwardWork,
    keep: tuple[IntArray, IntArray],
) -> None:
    """Kalman filter over the moving states alone, for all values of the constants at once.

    X (m, w), w >= 1 + nc, and P (m, p), both wider by zeros to a multiple of eight. states:
    X (., m, 1 + nc) and P (., m, m) after each epoch, in the rows that ``keep`` (k,) say of either
    (-1: nowhere); scalars: gain (s, m), innovation (s, 1 + nc) and its variance (s,). gram (w, w)
    receives the sum of nu nu' / S, its lower half, which is all that the evidence and the constants
    need.
    """
    waiting = 0
    for j in range(len(a.first) - 1):
        if j > 0:
            _carried(a, j, P, X, work)
        waiting = _observed(a, j, P, X, scalars, gram, waiting, work)
        symmetrise(P)
        if keep[0][j] >= 0:
            copied(X, states[0][keep[0][j]])
        if keep[1][j] >= 0:
            copied(P, states[1][keep[1][j]])
    add_gram(work.some, 0, waiting, gram)


@inner
def copied(x: Array, out: Array) -> None:
    """As much of x as there is room for in ``out``."""
    for i in range(out.shape[0]):
        for c in range(out.shape[1]):
            out[i, c] = x[i, c]


@lean
def reduced_means(
    a: Reduced, x: Array, by_D: Array, moved: tuple[Array, Array], entries: Entries, out: Array
) -> None:
    """States out (k, m, 1) after each epoch of a forward pass, for one value of the constants.

    x (m, 1): at the start; by_D (k, v): what each interval adds to the first v; moved: the gains
    (s, m) of the pass and its innovations (s,) for these constants.
    """
    gain, nu = moved
    m = len(x)
    e0 = m - a.Phi_e.shape[1]
    for j in range(len(a.first) - 1):
        if j > 0:
            list_entries(a.A[j], a.B[j], a.Phi_e[j], a.Phi_psi[j], entries)
            times_entries(entries, out[j - 1], x)
            for i in range(e0):
                x[i, 0] += by_D[j, i]
            for i in range(m - e0):
                x[e0 + i, 0] += a.d_e[j, i]
        for q in range(a.first[j], a.first[j + 1]):
            for i in range(m):
                x[i, 0] += gain[q, i] * nu[q]
        copy2(x, out[j])
