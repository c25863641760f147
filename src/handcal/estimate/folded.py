"""Readings between two looks at the held point, folded into one epoch at their own times.

A heading that is read a hundred times a second need not be an epoch of the filter each time: of
all that happens in a tenth of a second, the sensors' noise is far less than the heading's. The
readings of one kind are carried to the first epoch of their window through the transition in
between, each from its own time, and two combinations of them go into the filter, their mean and
their slope over time. How they scatter beyond that counts for the noise level. What is neglected:
the sensors' noise within a window, and how a parameter's effect bends within it. Readings that see
noise with a memory are not folded: it moves within a window by as much as they scatter.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from handcal.compiled.across import across, anything, arrived, at_first, brought_back, stepped
from handcal.compiled.jit import inner, njit
from handcal.compiled.kernel import BASE, MAX_DIM
from handcal.estimate.linear import Linear
from handcal.estimate.problem import foldable
from handcal.estimate.trajectory import Trajectory
from handcal.types import Array, BoolArray, IntArray

# As long (s), and as far turned (rad), is a window at the most.
WINDOW_S, WINDOW_RAD = 0.07, 0.2
# Fewer epochs than this share of them, or it is not worth the while.
WORTH = 0.7


@dataclass(frozen=True)
class Folded:
    """A linearised problem with K of its k epochs, and the way back to all of them.

    start (K,): which epochs they are; of (k,): whose window each epoch is in; Phi (k, 9, 15 + mi)
    and d (k, 9): from each epoch to the next, as they were. extra, scatter (kinds * MAX_DIM,): by
    how many readings there are more than rows, and the sum of the squares that the rows do not
    hold; markov (k, e): the trajectory's Markov states at all epochs. row (q,), share (q, 2): the
    first row of those into which each reading went (-1: left out), and by how much into that and
    the next.
    """

    linear: Linear
    start: IntArray
    of: IntArray
    Phi: Array
    d: Array
    extra: Array
    scatter: Array
    markov: Array
    row: IntArray
    share: Array

    @property
    def by_pieces(self) -> bool:
        """Whether it was made piece by piece: then Phi, d, row and share are empty."""
        return len(self.Phi) == 0


def fold(linear: Linear) -> Folded | None:
    """The problem with fewer epochs; None where there would be hardly fewer."""
    kinds, problem = linear.problem.observations, linear.problem
    folds = foldable(problem)
    if not folds.any() or not problem.navigated:
        return None
    start = _windows(linear.t, linear.rate, linear.first, folds[linear.kind])
    k, count = len(linear.t), len(start)
    if count > WORTH * k:
        return None
    of = np.searchsorted(start, np.arange(k), side="right") - 1
    at = np.repeat(np.arange(k), np.diff(linear.first))
    share, row = np.zeros((len(at), 2)), np.full(len(at), -1, dtype=np.int64)
    count_of = np.zeros(len(at), dtype=np.int64)
    first, rows = _grouped(of[at], linear.kind, linear.used, folds, count, row, count_of)
    _shares(linear.t[at], row, count_of, share)
    Phi, d = np.zeros((count, *linear.Phi.shape[1:])), np.zeros((count, 9))
    Q = np.zeros((3, count, 9, 9))
    r, H = np.zeros((rows, linear.H.shape[1])), np.zeros((rows, *linear.H.shape[1:]))
    kind, scatter = np.zeros(rows, dtype=np.int64), np.zeros((len(kinds), MAX_DIM))
    e0 = BASE + problem.constants
    walks = np.array([(e0 + s, 9 + c) for s, c in problem.walks], dtype=np.int64).reshape(-1, 2)
    _folded(
        (linear.Phi, linear.d, (linear.Q_gyro, linear.Q_accel, linear.Q_extra)), start,
        (linear.first, linear.kind, linear.r, linear.H), problem.tables.dim, walks,
        (row, count_of, share), (Phi, d, Q), (r, H, kind, scatter),
    )  # fmt: skip
    _left(count_of, row, r, kind, scatter)
    extra = readings_more(linear.kind[row >= 0], kind, problem.tables.dim)
    folded = replace(
        linear, trajectory=at_epochs(linear.trajectory, start), Phi=Phi, d=d, Q_gyro=Q[0],
        Q_accel=Q[1], Q_extra=Q[2], t=linear.t[start], rate=linear.rate[start], first=first,
        kind=kind, r=r, H=H, used=np.ones(rows, dtype=np.bool_),
    )  # fmt: skip
    own = extra, scatter.ravel(), linear.trajectory.markov[:k], row, share
    return Folded(folded, start, of, linear.Phi, linear.d, *own)


def at_epochs(whole: Trajectory, some: IntArray) -> Trajectory:
    """The trajectory at some of its epochs."""
    at = {name: getattr(whole, name)[some] for name in ("node", "p", "v", "C", "markov")}
    return replace(whole, **at)


def readings_more(read: IntArray, summed: IntArray, dim: IntArray) -> Array:
    """How many more readings (kinds * MAX_DIM,) of each kind and channel there were, of kinds
    ``read``, than sums of them, of kinds ``summed``."""
    count = len(dim)
    more = np.bincount(read, minlength=count) - np.bincount(summed, minlength=count)
    return np.where(np.arange(MAX_DIM) < dim[:, None], more[:, None].astype(float), 0.0).ravel()


def unfolded(f: Folded, t: Array, x: Array) -> Array:
    """Errors (k, N) at all epochs, t (k,) s, from those at the windows' (K, N).

    What one window adds to what follows from the one before, noise, came in on the way.
    """
    linear, nav = f.linear, f.Phi.shape[2]
    e0 = x.shape[1] - linear.problem.markov_size
    state = x[:, :nav].copy()
    for s, column in linear.problem.walks:
        state[:, 9 + column : 12 + column] += x[:, e0 + s : e0 + s + 3]
    out = x[f.of].copy()
    _followed(f.Phi, f.d, f.of, state, out)
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
def _followed(Phi: Array, d: Array, of: IntArray, state: Array, out: Array) -> None:
    """The first nine of the errors at all epochs, out (k, N), from ``state`` (K, 15 + mi) at the
    windows' first."""
    for j in range(len(of)):
        w = of[j]
        if j == 0 or w != of[j - 1]:
            for a in range(9):
                out[j, a] = state[w, a]
            continue
        for a in range(9):
            x = d[j, a]
            for b in range(9):
                x += Phi[j, a, b] * out[j - 1, b]
            for b in range(9, state.shape[1]):
                x += Phi[j, a, b] * state[w, b]
            out[j, a] = x


@njit
def _folded(
    dynamics: tuple[Array, Array, tuple[Array, Array, Array]],
    start: IntArray,
    rows: tuple[IntArray, IntArray, Array, Array],
    dim: IntArray,
    walks: IntArray,
    go: tuple[IntArray, IntArray, Array],
    carried: tuple[Array, Array, Array],
    out: tuple[Array, Array, IntArray, Array],
) -> None:
    """Phi, d, Q from window to window, and the rows into which the readings go, their kinds and the
    squares (kinds, MAX_DIM) of those that share a row."""
    Phi, _, Q = dynamics
    first, kind = rows[0], rows[1]
    row = go[0]
    width = Phi.shape[2]
    T, noise, work = across(width)
    line = np.zeros(rows[3].shape[2])
    # (most recordings have no gap; what numba makes of `any`, and of arrays put into arrays, takes
    # it seconds to compile)
    sources = 3 if anything(Q[2]) else 2
    w = 0
    for j in range(len(Phi)):
        if j > 0:
            stepped(dynamics, j, sources, T, noise, work)
        begins = w < len(start) and j == start[w]
        if begins:
            if w > 0:
                arrived(T, noise, w, carried)
            at_first(T, noise)
            w += 1
        for q in range(first[j], first[j + 1]):
            if row[q] >= 0:
                for i in range(dim[kind[q]]):
                    residual = brought_back(
                        rows[2][q, i], rows[3][q, i], begins, T, width, walks, line
                    )
                    _added(q, i, kind[q], residual, line, go, out)


@inner
def _added(
    q: int,
    i: int,
    kind: int,
    residual: float,
    line: Array,
    go: tuple[IntArray, IntArray, Array],
    out: tuple[Array, Array, IntArray, Array],
) -> None:
    """Put channel i of reading q into its rows."""
    row, count_of, share = go
    r, H, kinds, scatter = out
    for part in range(2 if count_of[q] > 1 else 1):
        to, s = row[q] + part, share[q, part]
        kinds[to] = kind
        r[to, i] += s * residual
        for c in range(len(line)):
            H[to, i, c] += s * line[c]
    if count_of[q] > 1:
        scatter[kind, i] += residual**2


@njit
def _left(count_of: IntArray, row: IntArray, r: Array, kind: IntArray, scatter: Array) -> None:
    """Take off the squares (kinds, MAX_DIM) what the rows hold of them."""
    folded = np.zeros(len(kind), dtype=np.bool_)
    for q in range(len(row)):
        if row[q] >= 0 and count_of[q] > 1:
            folded[row[q]] = True
            folded[row[q] + 1] = True
    for to in range(len(kind)):
        if folded[to]:
            for i in range(r.shape[1]):
                scatter[kind[to], i] = max(scatter[kind[to], i] - r[to, i] ** 2, 0.0)


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
