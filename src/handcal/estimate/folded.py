"""Readings between two looks at the held point, folded into one epoch at their own times.

A heading that is read a hundred times a second need not be an epoch of the filter each time: of
all that happens in a tenth of a second, the sensors' noise is far less than the heading's. The
readings of one kind are carried to the first epoch of their window through the transition in
between, each from its own time, and two combinations of them go into the filter, their mean and
their slope over time. How they scatter beyond that counts for the noise level. What is neglected:
the sensors' noise within a window, and how a parameter's effect bends within it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from handcal.compiled.jit import copy1, copy2, inner, njit, zero1, zero2
from handcal.compiled.kernel import BASE, MAX_DIM
from handcal.estimate.linear import Linear
from handcal.estimate.trajectory import Trajectory
from handcal.types import Array, BoolArray, IntArray

# As long (s), and as far turned (rad), is a window at the most.
WINDOW_S, WINDOW_RAD = 0.07, 0.2
# Fewer epochs than this share of them, or it is not worth the while.
WORTH = 0.7


@dataclass(frozen=True)
class Folded:
    """A linearised problem with K of its k epochs, and the way back to all of them.

    start (K,): which epochs they are; of (k,): whose window each epoch is in; T (k, 9, 15 + mi)
    and D (k, 9): from the state at the window's first epoch to that at each epoch. extra, scatter
    (kinds * MAX_DIM,): by how many readings there are more than rows, and the sum of the squares
    that the rows do not hold; markov (k, e): the trajectory's Markov states at all epochs. row
    (q,), share (q, 2): the first row of those into which each reading went (-1: left out), and by
    how much into that and the next.
    """

    linear: Linear
    start: IntArray
    of: IntArray
    T: Array
    D: Array
    extra: Array
    scatter: Array
    markov: Array
    row: IntArray
    share: Array


def fold(linear: Linear) -> Folded | None:
    """The problem with fewer epochs; None where there would be hardly fewer."""
    kinds = linear.problem.observations
    folds = np.array([o.folds for o in kinds], dtype=np.bool_)
    if not folds.any() or not linear.problem.navigated:
        return None
    start = _windows(linear.t, linear.rate, linear.first, folds[linear.kind])
    k, count = len(linear.t), len(start)
    if count > WORTH * k:
        return None
    of = np.searchsorted(start, np.arange(k), side="right") - 1
    nav = linear.Phi.shape[2]
    T, D = np.zeros((k, 9, nav)), np.zeros((k, 9))
    Phi, d, Q = np.zeros((count, 9, nav)), np.zeros((count, 9)), np.zeros((3, count, 9, 9))
    _carried(linear.Phi, linear.d, (linear.Q_gyro, linear.Q_accel, linear.Q_extra), start,
             (T, D, Phi, d, Q))  # fmt: skip
    at = np.repeat(np.arange(k), np.diff(linear.first))
    r, H = linear.r.copy(), linear.H.copy()
    away = np.flatnonzero(linear.used & (at != start[of[at]]))
    dim = linear.problem.tables.dim
    _brought_back(away, at, dim[linear.kind], T, D, r, H)
    e0 = BASE + linear.problem.constants
    for state, column in linear.problem.walks:
        own = slice(e0 + state, e0 + state + 3)
        H[away, :, own] = H[away, :, 9 + column : 12 + column]
    share, row = np.zeros((len(at), 2)), np.full(len(at), -1, dtype=np.int64)
    count_of = np.zeros(len(at), dtype=np.int64)
    first, rows = _grouped(of[at], linear.kind, linear.used, folds, count, row, count_of)
    _shares(linear.t[at], row, count_of, share)
    r_out, H_out = np.zeros((rows, H.shape[1])), np.zeros((rows, *H.shape[1:]))
    kind, scatter = np.zeros(rows, dtype=np.int64), np.zeros((len(kinds), MAX_DIM))
    _summed(r, H, linear.kind, dim, (row, count_of, share), (r_out, H_out, kind, scatter))
    extra = _more(linear.kind[row >= 0], kind, dim)
    folded = replace(
        linear, trajectory=_at(linear.trajectory, start), Phi=Phi, d=d, Q_gyro=Q[0], Q_accel=Q[1],
        Q_extra=Q[2], t=linear.t[start], rate=linear.rate[start], first=first, kind=kind, r=r_out,
        H=H_out, used=np.ones(rows, dtype=np.bool_),
    )  # fmt: skip
    markov = linear.trajectory.markov[:k]
    return Folded(folded, start, of, T, D, extra, scatter.ravel(), markov, row, share)


def _at(whole: Trajectory, some: IntArray) -> Trajectory:
    """The trajectory at some of its epochs."""
    return replace(
        whole, node=whole.node[some], p=whole.p[some], v=whole.v[some], C=whole.C[some],
        markov=whole.markov[some],
    )  # fmt: skip


def _more(read: IntArray, summed: IntArray, dim: IntArray) -> Array:
    """How many more readings (kinds * MAX_DIM,) of each kind and channel there were, of kinds
    ``read``, than sums of them, of kinds ``summed``."""
    count = len(dim)
    more = np.bincount(read, minlength=count) - np.bincount(summed, minlength=count)
    return np.where(np.arange(MAX_DIM) < dim[:, None], more[:, None].astype(float), 0.0).ravel()


def unfolded(f: Folded, t: Array, x: Array) -> Array:
    """Errors (k, N) at all epochs, t (k,) s, from those at the windows' (K, N).

    What one window adds to what follows from the one before, noise, came in on the way.
    """
    linear, nav = f.linear, f.T.shape[2]
    e0 = x.shape[1] - linear.problem.markov_size
    state = x[:, :nav].copy()
    for s, column in linear.problem.walks:
        state[:, 9 + column : 12 + column] += x[:, e0 + s : e0 + s + 3]
    out = x[f.of].copy()
    out[:, :9] = np.einsum("kij,kj->ki", f.T, state[f.of]) + f.D
    arrived = np.einsum("kij,kj->ki", linear.Phi[1:], state[:-1]) + linear.d[1:]
    noise = np.vstack([x[1:, :9] - arrived, np.zeros((1, 9))])
    after = np.r_[linear.t[1:], max(t[-1], linear.t[-1]) + 1.0]
    share = ((t - linear.t[f.of]) / (after - linear.t)[f.of])[:, None]
    out[:, :9] += share * noise[f.of]
    # (whatever the trajectory had within a window, nothing else would ever correct it)
    there = linear.trajectory.markov + x[:, e0:]
    step = np.vstack([np.diff(there, axis=0), np.zeros((1, there.shape[1]))])
    out[:, e0:] = there[f.of] + share * step[f.of] - f.markov
    return out


@njit
def _windows(t: Array, rate: Array, first: IntArray, folds: BoolArray) -> IntArray:
    """Epochs (K,) at which a window begins: one that holds more than what may be folded, or is
    too long after the last, or turned too far since."""
    out = np.empty(len(t), dtype=np.int64)
    count, turned, since = 0, 0.0, 0.0
    for j in range(len(t)):
        if j > 0:
            turned += rate[j] * (t[j] - t[j - 1])
        look = j == 0
        for q in range(first[j], first[j + 1]):
            if not folds[q]:
                look = True
        if look or t[j] - since > WINDOW_S or turned > WINDOW_RAD:
            out[count] = j
            count += 1
            turned, since = 0.0, t[j]
    return out[:count]


@njit
def _carried(
    Phi: Array,
    d: Array,
    Q: tuple[Array, Array, Array],
    start: IntArray,
    out: tuple[Array, Array, Array, Array, Array],
) -> None:
    """T, D of every epoch, and Phi, d, Q from window to window."""
    T, D, Phi_out, d_out, Q_out = out
    width = Phi.shape[2]
    off, moved = np.zeros(9), np.zeros(9)
    noise, half = np.zeros((3, 9, 9)), np.zeros((9, 9))
    # (most recordings have no gap; what numba makes of `any`, and of arrays put into arrays, takes
    # it seconds to compile)
    sources = 3 if _any(Q[2]) else 2
    w = 0
    for j in range(len(Phi)):
        # (written where it belongs at once: T is the largest thing here)
        new = T[j]
        if j > 0:
            for a in range(9):
                moved[a] = d[j, a]
                for c in range(9, width):
                    new[a, c] = Phi[j, a, c]
                for b in range(9):
                    f = Phi[j, a, b]
                    if f != 0.0:
                        moved[a] += f * off[b]
                        for c in range(width):
                            new[a, c] += f * T[j - 1, b, c]
            copy1(moved, off)
            for s in range(sources):
                _propagated(Phi[j], noise[s], half, Q[s][j])
        if w < len(start) and j == start[w]:
            if w > 0:
                copy2(new, Phi_out[w])
                copy1(off, d_out[w])
                for s in range(3):
                    copy2(noise[s], Q_out[s, w])
            zero2(new)
            zero1(off)
            for s in range(3):
                zero2(noise[s])
            for a in range(9):
                new[a, a] = 1.0
            w += 1
        copy1(off, D[j])


@inner
def _any(Q: Array) -> bool:
    """Whether any number of Q (k, 9, 9) is not zero."""
    for j in range(len(Q)):
        for a in range(9):
            for b in range(9):
                if Q[j, a, b] != 0.0:
                    return True
    return False


@inner
def _propagated(Phi: Array, P: Array, half: Array, Q: Array) -> None:
    """P (9, 9) becomes F P F' + Q; F: the first nine columns of Phi, mostly zeros."""
    zero2(half)
    for a in range(9):
        for b in range(9):
            f = Phi[a, b]
            if f != 0.0:
                for c in range(9):
                    half[a, c] += f * P[b, c]
    copy2(Q, P)
    for c in range(9):
        for b in range(9):
            f = Phi[c, b]
            if f != 0.0:
                for a in range(9):
                    P[a, c] += half[a, b] * f


@njit
def _brought_back(
    away: IntArray, at: IntArray, dim: IntArray, T: Array, D: Array, r: Array, H: Array
) -> None:
    """Residuals and rows of the readings ``away``, seen from where their windows begin."""
    by_nav = np.empty(9)
    for q in away:
        for i in range(dim[q]):
            for b in range(9):
                by_nav[b] = H[q, i, b]
                H[q, i, b] = 0.0
            for b in range(9):
                h = by_nav[b]
                if h != 0.0:
                    r[q, i] -= h * D[at[q], b]
                    for c in range(T.shape[2]):
                        H[q, i, c] += h * T[at[q], b, c]


@njit
def _grouped(
    window: IntArray,
    kind: IntArray,
    used: BoolArray,
    folds: BoolArray,
    count: int,
    row: IntArray,
    count_of: IntArray,
) -> tuple[IntArray, int]:
    """First row of each window (K + 1,) and the number of rows.

    row (q,) receives the first row of those into which each reading goes (-1: left out), count_of
    (q,) how many readings go there; three or more make two rows.
    """
    first = np.zeros(count + 1, dtype=np.int64)
    rows, begin = 0, 0
    for w in range(count):
        first[w] = rows
        end = begin
        while end < len(kind) and window[end] == w:
            end += 1
        for k in range(len(folds)):
            mine = 0
            for q in range(begin, end):
                if used[q] and kind[q] == k:
                    mine += 1
            for q in range(begin, end):
                if used[q] and kind[q] == k:
                    row[q] = rows
                    count_of[q] = mine if folds[k] else 1
                    if not folds[k] or mine < 2:
                        rows += 1
            if folds[k] and mine >= 2:
                rows += 2
        begin = end
    first[count] = rows
    return first, rows


@njit
def _shares(t: Array, row: IntArray, count_of: IntArray, share: Array) -> None:
    """What each reading contributes to its rows (q, 2): to the mean, and to the slope over time;
    orthonormal, so that the variance of both is that of a reading."""
    for q in range(len(row)):
        n = count_of[q]
        if row[q] < 0 or share[q, 0] != 0.0:
            continue
        if n < 2:
            share[q, 0] = 1.0
            continue
        members = np.empty(n, dtype=np.int64)
        found, i = 0, q
        mean, size = 0.0, 0.0
        while found < n:
            if row[i] == row[q]:
                members[found] = i
                mean += t[i] / n
                found += 1
            i += 1
        for i in members:
            size += (t[i] - mean) ** 2
        for i in members:
            share[i, 0] = 1.0 / math.sqrt(n)
            share[i, 1] = (t[i] - mean) / math.sqrt(size) if size > 0.0 else 0.0


@njit
def _summed(
    r: Array,
    H: Array,
    kind: IntArray,
    dim: IntArray,
    go: tuple[IntArray, IntArray, Array],
    out: tuple[Array, Array, IntArray, Array],
) -> None:
    """The rows, their kinds, and the squares (kinds, MAX_DIM) that are left."""
    row, count_of, share = go
    r_out, H_out, kind_out, scatter = out
    folded = np.zeros(len(kind_out), dtype=np.bool_)
    for q in range(len(row)):
        if row[q] < 0:
            continue
        for part in range(2 if count_of[q] > 1 else 1):
            to, s = row[q] + part, share[q, part]
            kind_out[to] = kind[q]
            for i in range(dim[kind[q]]):
                r_out[to, i] += s * r[q, i]
                for c in range(H.shape[2]):
                    H_out[to, i, c] += s * H[q, i, c]
        if count_of[q] > 1:
            folded[row[q]] = True
            folded[row[q] + 1] = True
            for i in range(H.shape[1]):
                scatter[kind[q], i] += r[q, i] ** 2
    for to in range(len(kind_out)):
        if folded[to]:
            for i in range(H.shape[1]):
                scatter[kind_out[to], i] = max(scatter[kind_out[to], i] - r_out[to, i] ** 2, 0.0)
