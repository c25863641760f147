"""Compiled steps of the covariance: carried by a transition, updated by observations.

P may be wider than the state by rows and columns of zeros, which stay zero: products of rows
that are a multiple of eight long are several times as fast (see ``rows``).
"""

from __future__ import annotations

import math

import numpy as np

from handcal.compiled.jit import inlined, inner
from handcal.compiled.rows import (
    add_outer,
    add_product,
    add_row,
    blank,
    nonzero,
    padded,
    product,
    set_row,
)
from handcal.types import Array, IntArray

Propagation = tuple[Array, Array, Array]
# Work space of ``scalar_update``: -P h, the gain K, the second correction and a row of (I - K h) P.
ScalarUpdate = tuple[Array, Array, Array, Array]
Update = tuple[ScalarUpdate, IntArray, IntArray]


def propagation_work(n: int, e: int) -> Propagation:
    """Work space of ``propagate`` for n states, e of them Markov states."""
    width = padded(9 + e)
    return blank(n, n), blank(n, width), blank(n, width)


def scalar_work(n: int) -> ScalarUpdate:
    """Work space of ``scalar_update`` for n states."""
    return blank(n), blank(n), blank(n), blank(n)


def update_work(n: int, d: int) -> Update:
    """Work space of ``update_linear`` for n states and at most d scalars: that of
    ``scalar_update``, and of each scalar where its row of H is not zero, and how often."""
    return scalar_work(n), np.zeros((d, n), dtype=np.int64), np.zeros(d, dtype=np.int64)


@inlined
def times_transition(
    Phi: Array, B: Array, Phi_e: Array, Phi_psi: Array, e0: int, X: Array, out: Array
) -> None:
    """The rows of out = F X that differ from those of X; the others are left alone.

    F is the full transition made of Phi (9, 15 + mi) in its first nine rows, the identity,
    and from row e0 on, where the Markov states begin, Phi_e (e, e) and Phi_psi (e, 3): how
    Markov states depend on psi. B (9, e), or empty: how the first nine depend on Markov
    states. Without constants, e0 = 9 and Phi is cut to nine columns.
    """
    product(Phi, X, min(Phi.shape[1], e0), out)
    if B.shape[1] > 0:
        add_product(B, X[e0:], B.shape[1], out)
    if len(Phi_e) > 0:
        product(Phi_e, X[e0:], len(Phi_e), out[e0:])
        add_product(Phi_psi, X[6:], Phi_psi.shape[1], out[e0:])


@inner
def add_unknown_force(P: Array, axis: int, dt: float, variance: float) -> None:
    """What an interval of dt seconds without a measured force leaves open on one axis: a change of
    velocity of that variance, and of position by what a force that changes all the time (white
    noise) makes of it."""
    P[3 + axis, 3 + axis] += variance
    P[axis, axis] += dt * dt * variance / 3.0
    P[axis, 3 + axis] += 0.5 * dt * variance
    P[3 + axis, axis] += 0.5 * dt * variance


@inlined
def propagate(
    P: Array,
    Phi: Array,
    B: Array,
    Phi_e: Array,
    Phi_psi: Array,
    e0: int,
    work: Propagation,
) -> None:
    """P = F P F' in place (without Q), F as in ``times_transition``; ``symmetrise`` it afterwards.

    The constants' own block of P does not change, and their rows and columns only once.
    """
    W, W_t, new = work
    n, e = P.shape[0], Phi_e.shape[0]
    times_transition(Phi, B, Phi_e, Phi_psi, e0, P, W)
    for j in range(n):
        for i in range(9):
            W_t[j, i] = W[i, j]
        for i in range(e):
            W_t[j, 9 + i] = W[e0 + i, j]
    times_transition(Phi, B, Phi_e, Phi_psi, e0, W_t, new)
    for j in range(9, e0):
        for i in range(9):
            P[j, i] = W_t[j, i]
        for i in range(e):
            P[j, e0 + i] = W_t[j, 9 + i]
    for a in range(9 + e):
        i = a if a < 9 else a + e0 - 9
        set_row(1.0, W, i, P[i])
        for j in range(9):
            P[i, j] = new[i, j]
        for j in range(e):
            P[i, e0 + j] = new[i, 9 + j]


@inlined
def scalar_update(
    P: Array, h: Array, at: IntArray, count: int, R: float, work: ScalarUpdate
) -> float:
    """One scalar Kalman update of P in Joseph form; returns the innovation's variance.

    (I - K h) P (I - K h)' + K R K', evaluated as two rank-one corrections. P (m, p), symmetric but
    for round-off and wider than the states by zeros, is changed in place. h is zero but for
    at[:count]; at[0] must be valid in any case. The gain is in work[1] afterwards, (p,).
    """
    minus_ph, gain, back, row = work
    S = R
    set_row(-h[at[0]], P, at[0], minus_ph)
    for k in range(1, count):
        add_row(-h[at[k]], P, at[k], minus_ph)
    for k in range(count):
        S -= h[at[k]] * minus_ph[at[k]]
    set_row(-1.0 / S, minus_ph, 0, gain)
    # what round-off left of (I - K h) P is taken as it is: times (I - K h)'
    set_row(R, gain, 0, back)
    for k in range(count):
        a = at[k]
        set_row(1.0, P, a, row)
        add_row(gain[a], minus_ph, 0, row)
        add_row(-h[a], row, 0, back)
    add_outer(gain, minus_ph, back, gain, P)
    return S


@inlined
def update_linear(
    r: Array,
    H: Array,
    d: int,
    R: Array,
    P: Array,
    x: Array,
    out: tuple[Array, Array, Array, Array],
    work: Update,
) -> None:
    """Joint update of x and P by d scalars r with rows H and variances R.

    out: the innovation (d,), the square root of the diagonal of S (d,), the NIS (1,) and
    the log of the predictive density (1,). ``symmetrise`` P after the last update.
    """
    residual, sigma, nis, loglik = out
    own, at, count = work
    # S of all scalars as P is now; that of the first is found below anyway
    for j in range(d):
        S = R[j]
        nu = r[j]
        at[j, 0] = 0
        m = nonzero(H[j], at[j])
        count[j] = m
        for k in range(m):
            a = at[j, k]
            nu -= H[j, a] * x[a]
            for l in range(m if j > 0 else 0):
                S += H[j, a] * P[a, at[j, l]] * H[j, at[j, l]]
        residual[j] = nu
        sigma[j] = math.sqrt(S)
    nis[0] = 0.0
    loglik[0] = 0.0
    volume = 1.0
    for j in range(d):
        nu = r[j]
        for k in range(count[j]):
            nu -= H[j, at[j, k]] * x[at[j, k]]
        S = scalar_update(P, H[j], at[j], count[j], R[j], own)
        add_row(nu, own[1], 0, x)
        if j == 0:
            sigma[j] = math.sqrt(S)
        nis[0] += nu * nu / S
        # (of two that are negative the product would not tell)
        volume = volume * 2.0 * math.pi * S if S > 0.0 else math.nan
    loglik[0] = -0.5 * (nis[0] + math.log(volume))
