"""Compiled: what further constants do to a pass of the reduced filter (see ``columns``)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from handcal.compiled.jit import copy2, inner, lean, njit, zero2
from handcal.compiled.kernel import (
    BASE,
    MAX_DIM,
    NAV,
    Nodes,
    Tables,
    back_in_time,
    extras_columns,
    fill_nav,
)
from handcal.compiled.reduced_kernel import Reduced, innovation
from handcal.compiled.rows import BLOCK, add_gram, add_product, add_row
from handcal.compiled.sparse import Entries, list_entries, times_entries
from handcal.types import Array, BoolArray, IntArray


@njit
def carried(
    Phi: Array,
    W: Array,
    epoch: IntArray,
    start: IntArray,
    seen: tuple[IntArray, IntArray, Array],
    far: tuple[IntArray, IntArray],
    out: tuple[Array, Array],
) -> None:
    """Carry what an error of the readings over each interval does to the end of its window, and to
    the scalars that look at the window on the way.

    Phi (k, 9, .), W (n, 9, 6): see ``Linear`` and ``preintegrate``; epoch (k,): nodes; start (K,):
    epochs at which windows begin. seen: of every epoch (k + 1,) the first of those looks, and of
    each look the scalar (counted within its window) and h (9,). far: first of each window's scalars
    that look so (K + 1,), and where its rows of out[1] begin (K,). out: (n, 9, 6), and (., 6), one
    row a scalar for each sample in turn.
    """
    first, which, h = seen
    count = len(start)
    most = 0
    for w in range(count):
        most = max(most, far[0][w + 1] - far[0][w])
    later, new = np.zeros((9 + most, 9)), np.zeros((9 + most, 9))
    for w in range(count):
        rows = 9 + far[0][w + 1] - far[0][w]
        last = start[w + 1] if w + 1 < count else len(epoch) - 1
        zero2(later)
        if w + 1 < count:
            for a in range(9):
                later[a, a] = 1.0
        for j in range(last, start[w], -1):
            for q in range(first[j], first[j + 1]):
                for b in range(9):
                    later[9 + which[q], b] += h[q, b]
            for i in range(epoch[j - 1] + 1, epoch[j] + 1):
                to = far[1][w] + (i - epoch[start[w]] - 1) * (rows - 9)
                _through(later, W[i], 0, 9, out[0][i])
                _through(later, W[i], 9, rows, out[1][to : to + rows - 9])
            _before(later, Phi[j], rows, new)


@inner
def _through(later: Array, W: Array, begin: int, end: int, out: Array) -> None:
    """out (end - begin, 6) = later[begin:end] W (9, 6)."""
    for a in range(begin, end):
        for c in range(6):
            out[a - begin, c] = 0.0
        for b in range(9):
            x = later[a, b]
            if x != 0.0:
                for c in range(6):
                    out[a - begin, c] += x * W[b, c]


@inner
def _before(later: Array, Phi: Array, rows: int, new: Array) -> None:
    """The first rows of later (., 9) become those of later Phi[:, :9]."""
    for a in range(rows):
        for c in range(9):
            new[a, c] = 0.0
        for b in range(9):
            x = later[a, b]
            if x != 0.0:
                for c in range(9):
                    new[a, c] += x * Phi[b, c]
    copy2(new, later)


@njit
def responses(
    values: Array,
    channel: IntArray,
    column: IntArray,
    windows: tuple[IntArray, IntArray, IntArray],
    weights: tuple[Array, Array],
    scalars: tuple[IntArray, IntArray],
    out: tuple[Array, Array],
) -> None:
    """What constants do within every window: added to D (K, 9, c) at its end, taken from g (s, c).

    values (n, s), channel, column (s,): see ``model.Slopes``. windows: first and last node of each
    (K,), and where its rows of weights[1] begin; weights: see ``carried``. scalars: first of each
    window's (K + 1,), and which they are.
    """
    s = len(channel)
    most = 0
    for w in range(len(windows[0])):
        most = max(most, scalars[0][w + 1] - scalars[0][w])
    # (columns of one channel begin at a multiple of eight)
    place, edges = np.empty(s, dtype=np.int64), np.zeros(7, dtype=np.int64)
    begins = np.searchsorted(channel, np.arange(7))
    for c in range(6):
        count = begins[c + 1] - begins[c]
        edges[c + 1] = edges[c] - (-count // BLOCK) * BLOCK
        for k in range(count):
            place[begins[c] + k] = edges[c] + k
    mean, sums = np.zeros(edges[6]), np.empty((9 + most, edges[6]))
    for w in range(len(windows[0])):
        rows = 9 + scalars[0][w + 1] - scalars[0][w]
        zero2(sums)
        to = windows[2][w]
        for i in range(windows[0][w] + 1, windows[1][w] + 1):
            for k in range(s):
                mean[place[k]] = 0.5 * (values[i - 1, k] + values[i, k])
            _summed(weights[0][i], mean, edges, 0, sums)
            _summed(weights[1][to : to + rows - 9], mean, edges, 9, sums)
            to += rows - 9
        if w + 1 < len(windows[0]):
            for r in range(9):
                for k in range(s):
                    out[0][w + 1, r, column[k]] += sums[r, place[k]]
        for r in range(9, rows):
            q = scalars[1][scalars[0][w] + r - 9]
            for k in range(s):
                out[1][q, column[k]] -= sums[r, place[k]]


@inner
def _summed(weight: Array, mean: Array, edges: IntArray, at: int, sums: Array) -> None:
    """Add weight (r, 6), of each column's channel, times its mean to the rows of sums from at on;
    edges (7,): where the columns of each channel begin and end."""
    for r in range(weight.shape[0]):
        for c in range(6):
            if weight[r, c] != 0.0 and edges[c + 1] > edges[c]:
                own = slice(edges[c], edges[c + 1])
                add_row(weight[r, c], mean[own], 0, sums[at + r, own])


@njit
def seen_at_once(
    values: Array,
    channel: IntArray,
    column: IntArray,
    node: IntArray,
    by_reading: Array,
    rows: tuple[IntArray, Array],
    g: Array,
) -> None:
    """Take from g (s, c) what readings (q,) that look at rate and force, by_reading (q, m, 6), see
    of constants at their own nodes (q,). rows: first of the scalars of each (q, 2), or -1, and
    its shares in them (q, 2)."""
    for q in range(len(node)):
        for i in range(by_reading.shape[1]):
            for k in range(len(channel)):
                x = by_reading[q, i, channel[k]]
                if x != 0.0:
                    x *= values[node[q], k]
                    for part in range(2):
                        if rows[0][q, part] >= 0:
                            g[rows[0][q, part] + i, column[k]] -= rows[1][q, part] * x


@njit
def seen_by_readings(
    nodes: Nodes,
    tables: Tables,
    nominal: tuple[IntArray, Array, Array, Array, Array, Array],
    size: int,
    rows: tuple[IntArray, Array],
    place: IntArray,
    used: BoolArray,
    by_state: Array,
    own: tuple[Tables, Array],
    g: Array,
) -> None:
    """Take from g (s, c) what constants (size,), all zero, add to the readings themselves.

    nominal: nodes (k,) of the epochs, p, v, C there, and the biases of both sensors; place (c',):
    column of g of each constant. rows: as in ``seen_at_once``; by_state (q, m, N), N >= 9: rows of
    the readings by the errors of position, velocity and attitude; own: the functions of what the
    model has already, which tell how late readings are, and its constants.
    """
    extras, nav, w, f = np.zeros(size), np.empty(NAV), np.empty(3), np.empty(3)
    H = np.zeros((MAX_DIM, BASE + size))
    plus, minus, then = np.empty(MAX_DIM), np.empty(MAX_DIM), np.empty(NAV)
    for j in range(len(nominal[0])):
        i = nominal[0][j]
        if nodes.first[i] == nodes.first[i + 1]:
            continue
        for a in range(3):
            w[a] = nodes.gyro[i, a] - nominal[4][j, a]
            f[a] = nodes.accel[i, a] - nominal[5][j, a]
        fill_nav(nominal[1][j], nominal[2][j], nominal[3][j], w, f, nav)
        for q in range(nodes.first[i], nodes.first[i + 1]):
            d = tables.dim[nodes.kind[q]]
            if not used[q] or rows[0][q, 0] < 0:
                continue
            zero2(H)
            for a in range(d):
                for c in range(9):
                    H[a, c] = by_state[q, a, c]
            back_in_time(nodes.kind[q], own[0], nav, own[1], nodes.z[q], plus, then)
            extras_columns(nodes.kind[q], tables, then, extras, nodes.z[q], d, plus, minus, H)
            for part in range(2):
                first = rows[0][q, part]
                if first >= 0:
                    for a in range(d):
                        for c in range(len(place)):
                            g[first + a, place[c]] -= rows[1][q, part] * H[a, BASE + c]


class FollowedWork(NamedTuple):
    """Work space of ``followed``: entries of the transition; the columns and these carried (m, w);
    innovations (b, w) and their gains (m, b)."""

    entries: Entries
    X: Array
    carried: Array
    some: Array
    gains: Array


@lean
def followed(
    a: Reduced,
    gain: Array,
    driven: tuple[Array, Array, Array],
    nu: Array,
    work: FollowedWork,
    epochs: tuple[int, int],
) -> None:
    """Innovations nu (s, c) of further columns beside a pass that has been made already, from one
    epoch up to another.

    gain (s, m): of that pass; driven: D (K + 1, v, c) of these epochs and the next one, and g
    (s, c) of these, as in ``Reduced``, and what they are multiplied by (c,). work.X: the columns of
    the state at the first epoch before its observations; then those at the next one.
    """
    scale = driven[2]
    X, m, columns = work.X, len(work.X), nu.shape[1]
    e, before = a.Phi_e.shape[1], a.first[epochs[0]]
    for j in range(epochs[0], epochs[1]):
        begin, last = a.first[j], a.first[j + 1]
        while begin < last:
            end = min(last, begin + len(work.some))
            for q in range(begin, end):
                own = work.some[q - begin]
                for c in range(columns):
                    own[c] = scale[c] * driven[1][q - before, c]
                innovation(a, q, begin, X, gain, work.some, 0, work.entries)
                for i in range(m):
                    work.gains[i, q - begin] = gain[q, i]
                for c in range(columns):
                    nu[q - before, c] = own[c]
            add_product(work.gains, work.some, end - begin, X)
            begin = end
        if j + 1 < len(a.A):
            list_entries(a.A[j + 1], a.B[j + 1], a.Phi_e[j + 1], a.Phi_psi[j + 1], work.entries)
            times_entries(work.entries, X, work.carried)
            copy2(work.carried, X)
            for i in range(m - e):
                for c in range(columns):
                    X[i, c] += scale[c] * driven[0][j + 1 - epochs[0], i, c]


@lean
def products(nu: Array, further: Array, S: Array, first: int, both: Array, gram: Array) -> None:
    """Sums over scalars of products of innovations nu (s, a) and further (s, c), over their
    variances S (s,): in the lower half of gram (v + w, v + w), rows from ``first`` on, which is v;
    v and w are a and c, each as wide as a multiple of eight. both (b, v + w): zeros, as many rows
    as are added up at once. (A library would share it among threads, and round differently with
    their number.)"""
    for begin in range(0, len(nu), len(both)):
        count = min(len(both), len(nu) - begin)
        for q in range(count):
            # (of a variance that ran away the sums are none either way)
            weight = 1.0 / math.sqrt(abs(S[begin + q]))
            for c in range(nu.shape[1]):
                both[q, c] = weight * nu[begin + q, c]
            for c in range(further.shape[1]):
                both[q, first + c] = weight * further[begin + q, c]
        add_gram(both, first, count, gram)
