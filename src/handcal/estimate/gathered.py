"""All readings between two looks at the held point, gathered into one epoch: for long recordings.

As in ``folded``, readings are carried to the first epoch of their window, each from its own time;
but windows are as long as the sensors' noise within them is small beside the readings', and of all
combinations of a window's readings those few are kept that say anything of the state there (a
pivoted orthogonalisation of their rows), instead of a mean and a slope for each tenth of a second.
An hour has a fifth of the epochs then. What no kept row holds is scatter, which an effect that is
looked for later might have explained: so scans go about ``folded`` problems.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from handcal.compiled.across import across, anything, arrived, at_first, brought_back, stepped
from handcal.compiled.jit import copy1, copy2, inner, njit
from handcal.compiled.kernel import BASE, MAX_DIM
from handcal.estimate.folded import at_epochs, readings_more
from handcal.estimate.linear import Linear
from handcal.estimate.problem import Problem, foldable
from handcal.types import ACCEL_BIAS_PRIOR, GYRO_BIAS_PRIOR, Array, BoolArray, IntArray

# Combinations of readings that say less of the state than this share of what the best one says,
# with errors as large as a prior has them, are scatter: a bias of 1 deg/s bends a heading within a
# third of a second by a thousandth of the rest, and after the first round it is known a thousand
# times better.
TINY = 1e-3


def gathered(linear: Linear, start: IntArray, whole: bool) -> tuple[Linear, Array, Array]:
    """A linearised problem of k epochs with its windows for epochs, which begin at ``start`` (K,),
    without the scatter of its readings; by how many readings there are more than rows, and the sum
    of the squares that no row holds, both (kinds * MAX_DIM,).

    whole: the last window has all that is left, else it has no readings of its own, and is there
    for what leads to it.
    """
    problem, kinds = linear.problem, linear.problem.observations
    folds = foldable(problem)
    used = linear.used.copy()
    if not whole:
        used[linear.first[start[-1]] :] = False
    most, count = int(used.sum()), len(start)
    Phi, d = np.zeros((count, *linear.Phi.shape[1:])), np.zeros((count, 9))
    Q, scatter = np.zeros((3, count, 9, 9)), np.zeros((len(kinds), MAX_DIM))
    r, H = np.zeros((most, linear.H.shape[1])), np.zeros((most, *linear.H.shape[1:]))
    kind, first = np.zeros(most, dtype=np.int64), np.zeros(count + 1, dtype=np.int64)
    e0 = BASE + problem.constants
    walks = np.array([(e0 + s, 9 + c) for s, c in problem.walks], dtype=np.int64).reshape(-1, 2)
    _gathered(
        (linear.Phi, linear.d, (linear.Q_gyro, linear.Q_accel, linear.Q_extra)), start,
        (linear.first, linear.kind, linear.r, linear.H), (used, folds), walks, _sizes(problem),
        (Phi, d, Q), (r, H, kind, first, scatter),
    )  # fmt: skip
    rows = int(first[-1])
    extra = readings_more(linear.kind[used], kind[:rows], problem.tables.dim)
    made = replace(
        linear, trajectory=at_epochs(linear.trajectory, start), Phi=Phi, d=d, Q_gyro=Q[0],
        Q_accel=Q[1], Q_extra=Q[2], t=linear.t[start], rate=linear.rate[start], first=first,
        kind=kind[:rows].copy(), r=r[:rows].copy(), H=H[:rows].copy(),
        used=np.ones(rows, dtype=np.bool_),
    )  # fmt: skip
    return made, extra, scatter.ravel()


def _sizes(problem: Problem) -> Array:
    """How large an error (N,) of each state may be, rad and SI."""
    biases = np.repeat([GYRO_BIAS_PRIOR, ACCEL_BIAS_PRIOR], 3)
    slots = [s.prior_sigma for s in problem.slots]
    return np.asarray(np.r_[np.ones(9), biases, slots, np.ones(problem.markov_size)])


@njit
def windows(t: Array, first: IntArray, folds: BoolArray, longest: float) -> IntArray:
    """Epochs (K,) of those at t (k,) s, with readings ``first`` (k + 1,) that fold or not (q,), at
    which a window begins: one that holds more than what may be gathered, or is later than
    ``longest`` (s) after the last beginning."""
    out = np.empty(len(t), dtype=np.int64)
    count, since = 0, 0.0
    for j in range(len(t)):
        look = j == 0
        for q in range(first[j], first[j + 1]):
            if not folds[q]:
                look = True
        if look or t[j] - since > longest:
            out[count] = j
            count += 1
            since = t[j]
    return out[:count]


@njit
def _gathered(
    dynamics: tuple[Array, Array, tuple[Array, Array, Array]],
    start: IntArray,
    rows: tuple[IntArray, IntArray, Array, Array],
    of: tuple[BoolArray, BoolArray],
    walks: IntArray,
    size: Array,
    carried: tuple[Array, Array, Array],
    out: tuple[Array, Array, IntArray, IntArray, Array],
) -> None:
    """Phi, d, Q from window to window, and the rows that are kept, r, H, their kinds, the first of
    each window, and the squares (kinds, MAX_DIM) of what none holds; of: which readings are used
    (q,), which kinds are gathered."""
    Phi, first, count = dynamics[0], rows[0], len(start)
    T, noise, work = across(Phi.shape[2])
    sources = 3 if anything(dynamics[2][2]) else 2
    most = 1
    for w in range(count):
        end = start[w + 1] if w + 1 < count else len(Phi)
        most = max(most, first[end] - first[start[w]])
    read = np.zeros((most, rows[3].shape[2])), np.zeros(most)
    mine, best = np.zeros(most, np.int64), np.zeros(most)
    for w in range(count):
        end = start[w + 1] if w + 1 < count else len(Phi)
        at_first(T, noise)
        to = out[3][w]
        for j in range(start[w], end):
            if j > start[w]:
                stepped(dynamics, j, sources, T, noise, work)
            to = _taken(j, start[w], rows, of, walks, (T, Phi.shape[2]), read, out, to)
        out[3][w + 1] = _kept(first[start[w]], first[end], rows[1], of, size, read,
                              (mine, best), out, to)  # fmt: skip
        if w + 1 < count:
            stepped(dynamics, end, sources, T, noise, work)
            arrived(T, noise, w + 1, carried)


@inner
def _taken(
    j: int,
    begin: int,
    rows: tuple[IntArray, IntArray, Array, Array],
    of: tuple[BoolArray, BoolArray],
    walks: IntArray,
    carried: tuple[Array, int],
    read: tuple[Array, Array],
    out: tuple[Array, Array, IntArray, IntArray, Array],
    to: int,
) -> int:
    """Readings of epoch j, seen from where their window begins: those that are gathered into
    ``read``, the others into rows from ``to`` on; the row after these."""
    first, kind, r, H = rows
    lines, left = read
    T, width = carried
    for q in range(first[j], first[j + 1]):
        if not of[0][q]:
            continue
        if of[1][kind[q]]:
            i = q - first[begin]
            left[i] = brought_back(r[q, 0], H[q, 0], j == begin, T, width, walks, lines[i])
        else:
            copy1(r[q], out[0][to])
            copy2(H[q], out[1][to])
            out[2][to] = kind[q]
            to += 1
    return to


@inner
def _kept(
    begin: int,
    end: int,
    kind: IntArray,
    of: tuple[BoolArray, BoolArray],
    size: Array,
    read: tuple[Array, Array],
    work: tuple[IntArray, Array],
    out: tuple[Array, Array, IntArray, IntArray, Array],
    to: int,
) -> int:
    """What is kept of a window's readings, from ``begin`` to ``end``, in rows from ``to`` on; the
    row after these."""
    lines, left = read
    mine, best = work
    for k in range(len(of[1])):
        n = 0
        for q in range(begin, end):
            if of[0][q] and of[1][k] and kind[q] == k:
                mine[n] = q - begin
                n += 1
        if n > 0:
            kept = _compressed(lines, left, mine[:n], size, best, out[0][to:], out[1][to:])
            for i in range(kept):
                out[2][to + i] = k
            for i in range(n):
                out[4][k, 0] += left[mine[i]] ** 2
            to += kept
    return to


@inner
def _compressed(
    lines: Array, left: Array, mine: IntArray, size: Array, best: Array, r: Array, H: Array
) -> int:
    """Rows into r (., m) and H (., m, N), of n readings ``mine`` with rows ``lines`` (., N) and
    residuals ``left`` (.,): orthonormal combinations of them, those first that say most of any one
    state; how many. What they hold is taken off the lines and the residuals.

    size (N,): how large an error of each state may be. best (n,): work space.
    """
    n, states, top = len(mine), len(size), 0.0
    for kept in range(n):
        most, at = 0.0, 0
        for c in range(states):
            square = 0.0
            for i in mine:
                square += lines[i, c] * lines[i, c]
            square *= size[c] * size[c]
            if square > most:
                most, at = square, c
        if kept == 0:
            top = most
        if most <= TINY * TINY * top:
            return kept
        for i in range(n):
            best[i] = lines[mine[i], at] * size[at] / np.sqrt(most)
        for c in range(states):
            share = 0.0
            for i in range(n):
                share += best[i] * lines[mine[i], c]
            H[kept, 0, c] = share
            if share != 0.0:
                for i in range(n):
                    lines[mine[i], c] -= share * best[i]
        share = 0.0
        for i in range(n):
            share += best[i] * left[mine[i]]
        r[kept, 0] = share
        for i in range(n):
            left[mine[i]] -= share * best[i]
    return n
