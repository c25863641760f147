"""Compiled: the readings between two epochs, integrated once into one transition."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from handcal.compiled.covariance import add_unknown_force
from handcal.compiled.jit import copy1, copy2, inlined, inner, local_matrix, njit, zero2
from handcal.compiled.kernel import BASE, Nodes, interval
from handcal.compiled.rows import BLOCK, add_gram, blank, padded, product
from handcal.compiled.so3 import exp, matmul
from handcal.compiled.strapdown import advance, increments
from handcal.types import Array, IntArray

# Rows of what noise brings that are added up together: those of 64 intervals.
_TOGETHER = 3 * 64


class PreintegrationWork(NamedTuple):
    """Work space of ``preintegrate``, its rows wider than need be, to a multiple of eight: the
    transitions of an epoch's intervals (., 9, 16), that from an interval's end to the epoch's, and
    that from its beginning (9, 16); what noise of gyro (b, 16) and accelerometer (b, 8) brings, b
    rows at a time, and its sums (16, 16), (8, 8); two of (9, 9)."""

    Phi: Array
    later: Array
    whole: Array
    by_gyro: Array
    by_accel: Array
    Q_gyro: Array
    Q_accel: Array
    squares: Array


def preintegration_work(longest: int) -> PreintegrationWork:
    """Work space where an epoch has at most so many intervals."""
    wide = padded(BASE)
    return PreintegrationWork(
        blank(longest, 9, wide), blank(9, wide), blank(9, wide), blank(_TOGETHER, wide),
        blank(_TOGETHER, BLOCK), blank(wide, wide), blank(BLOCK, BLOCK), blank(2, 9, 9),
    )  # fmt: skip


@njit
def preintegrate(
    nodes: Nodes,
    epoch: IntArray,
    nominal: tuple[Array, Array, Array],
    biases: tuple[Array, Array],
    g_n: Array,
    omega_ie_n: Array,
    out: tuple[Array, Array, Array, Array, Array],
    W: Array,
    work: PreintegrationWork,
) -> None:
    """Phi (k, 9, 15), d and the three Q of every epoch but the first, into ``out`` (see
    ``Linear``), and what an error of the readings over each interval makes of the state at the
    next epoch, into W (n, 9, 6), or (0, 9, 6) if not asked for.

    biases: of gyro and of accelerometer from each epoch on (k, 3). Within an epoch it goes
    backwards: noise and errors are carried to its end, which needs no covariance on the way.
    """
    bg, ba = biases
    Phi_out, d_out, Qg_out, Qa_out, Q0_out = out
    J, none = np.empty((6, 0)), np.empty(0)
    p, v, C = np.empty(3), np.empty(3), np.empty((3, 3))
    for j in range(1, len(epoch)):
        a, b = epoch[j - 1], epoch[j]
        copy1(nominal[0][j - 1], p)
        copy1(nominal[1][j - 1], v)
        copy2(nominal[2][j - 1], C)
        for i in range(a + 1, b + 1):
            interval(nodes, i, bg[j - 1], ba[j - 1], none, none, g_n, omega_ie_n, p, v, C,
                     work.Phi[i - a - 1], J)  # fmt: skip
        _backwards(nodes, a, b, Phi_out[j], (Qg_out[j], Qa_out[j], Q0_out[j]), W, work)
        for k in range(3):
            d_out[j, k] = p[k] - nominal[0][j, k]
            d_out[j, 3 + k] = v[k] - nominal[1][j, k]
        _angle_between(C, nominal[2][j], d_out[j, 6:9])


@inlined
def _backwards(
    nodes: Nodes,
    a: int,
    b: int,
    total: Array,
    Q: tuple[Array, Array, Array],
    W: Array,
    work: PreintegrationWork,
) -> None:
    """The transition ``total`` (9, 15) from node a to node b, which was zero, the three Q on the
    way, and W, from the transitions of the intervals between them."""
    later, new, rows = work.later, work.whole, 0
    zero2(work.Q_gyro)
    zero2(work.Q_accel)
    zero2(later)
    for k in range(9):
        later[k, k] = 1.0
    for i in range(b, a, -1):
        dt, extra = nodes.t[i] - nodes.t[i - 1], nodes.extra[i]
        root = math.sqrt(dt)
        for k in range(3):
            for r in range(9):
                work.by_gyro[rows + k, r] = root * later[r, 6 + k]
            # (no attitude depends on a velocity)
            for r in range(6):
                work.by_accel[rows + k, r] = root * later[r, 3 + k]
        rows += 3
        if rows == len(work.by_gyro) or i == a + 1:
            add_gram(work.by_gyro, 0, rows, work.Q_gyro)
            add_gram(work.by_accel, 0, rows, work.Q_accel)
            rows = 0
        if extra[0] != 0.0 or extra[1] != 0.0 or extra[2] != 0.0:
            _add_extra(Q[2], later, dt, extra, work.squares)
        product(later, work.Phi[i - a - 1], 9, new)
        for r in range(9):
            for c in range(9, BASE):
                total[r, c] += new[r, c]
        if len(W) > 0:
            for r in range(9):
                for c in range(6):
                    W[i, r, c] = new[r, 9 + c]
        later, new = new, later
    for r in range(9):
        for c in range(9):
            total[r, c] = later[r, c]
            Q[0][r, c] = work.Q_gyro[max(r, c), min(r, c)]
            if max(r, c) < 6:
                Q[1][r, c] = work.Q_accel[max(r, c), min(r, c)]


@njit
def responses(W: Array, values: Array, channel: IntArray, column: IntArray, epoch: IntArray,
              out: Array) -> None:  # fmt: skip
    """What constants make of the state at the next epoch: derivatives (k, 9, c), added to ``out``.

    W: see ``preintegrate``; values (n, s), channel, column (s,): see ``model.Slopes``.
    """
    s = len(channel)
    mean, sums = np.empty(s), np.empty((9, s))
    edges = np.searchsorted(channel, np.arange(7))
    for j in range(1, len(epoch)):
        zero2(sums)
        for i in range(epoch[j - 1] + 1, epoch[j] + 1):
            for k in range(s):
                mean[k] = 0.5 * (values[i - 1, k] + values[i, k])
            for r in range(9):
                for c in range(6):
                    w = W[i, r, c]
                    if w != 0.0:
                        for k in range(edges[c], edges[c + 1]):
                            sums[r, k] += w * mean[k]
        for r in range(9):
            for k in range(s):
                out[j, r, column[k]] += sums[r, k]


@njit
def turn_noise(Phi: Array, d: Array) -> None:
    """Let an attitude error turn the noise that the trajectory implies, in Phi (k, 9, 15 + c).

    Sensor noise lives in the body: what the measured rate and force differ from those of
    the nominal trajectory turns with the attitude and is no information about it. Taking
    it for a signal makes a heading observable that is not (in a z turn without a heading,
    sigma of the vertical gyro bias falls to a tenth).
    """
    turned = np.empty((3, Phi.shape[2]))
    for j in range(1, len(Phi)):
        for a in range(3):
            for c in range(Phi.shape[2]):
                turned[a, c] = 0.5 * Phi[j, 6 + a, c]
            turned[a, 6 + a] += 0.5
        _turn(turned, d[j], Phi[j])


@njit
def turn_errors(W: Array, epoch: IntArray, d: Array) -> None:
    """The same for what errors of the readings bring, W (n, 9, 6) (see ``preintegrate``)."""
    turned = np.empty((3, W.shape[2]))
    for j in range(1, len(epoch)):
        for i in range(epoch[j - 1] + 1, epoch[j] + 1):
            for a in range(3):
                for c in range(W.shape[2]):
                    turned[a, c] = 0.5 * W[i, 6 + a, c]
            _turn(turned, d[j], W[i])


@inner
def _turn(turned: Array, d: Array, out: Array) -> None:
    """Add to out (9, c) what the noise d (9,) does when it is turned by ``turned`` (3, c)."""
    for first in range(0, 9, 3):
        for a in range(3):
            b, e = (a + 1) % 3, (a + 2) % 3
            less, more = -d[first + e], d[first + b]
            for c in range(out.shape[1]):
                out[first + a, c] += less * turned[b, c] + more * turned[e, c]


@njit
def integrate(
    nodes: Nodes,
    epoch: IntArray,
    nominal: tuple[Array, Array, Array],
    biases: tuple[Array, Array],
    g_n: Array,
    omega_ie_n: Array,
    out: tuple[Array, Array, Array],
    d: Array,
) -> None:
    """Position, velocity (n, 3) and attitude (n, 3, 3) at all nodes, into ``out``, and where the
    integration ends beside the next epoch, d (k, 9): predicted minus nominal.

    Each epoch begins anew from the nominal; what it lacks at its end is spread over its time.
    biases: as in ``preintegrate``.
    """
    bg, ba = biases
    inc, f_n, w, psi = np.empty((3, 3)), np.empty(3), np.empty((4, 3)), np.empty(3)
    p, v, C, turn = np.empty(3), np.empty(3), np.empty((3, 3)), np.empty((3, 3))
    for j in range(1, len(epoch)):
        copy1(nominal[0][j - 1], p)
        copy1(nominal[1][j - 1], v)
        copy2(nominal[2][j - 1], C)
        a, b = epoch[j - 1], epoch[j]
        for k in range(3):
            out[0][a, k], out[1][a, k] = p[k], v[k]
        copy2(C, out[2][a])
        for i in range(a + 1, b + 1):
            if i == a + 1:
                _less(nodes, i - 1, bg[j - 1], ba[j - 1], w[0], w[2])
            else:
                copy1(w[1], w[0])
                copy1(w[3], w[2])
            _less(nodes, i, bg[j - 1], ba[j - 1], w[1], w[3])
            dt = nodes.t[i] - nodes.t[i - 1]
            increments(w[0], w[1], w[2], w[3], dt, inc)
            advance(p, v, C, inc, dt, g_n, omega_ie_n, f_n)
            copy1(p, out[0][i])
            copy1(v, out[1][i])
            copy2(C, out[2][i])
        for k in range(3):
            d[j, k] = p[k] - nominal[0][j, k]
            d[j, 3 + k] = v[k] - nominal[1][j, k]
        _angle_between(C, nominal[2][j], d[j, 6:9])
        span = nodes.t[b] - nodes.t[a]
        for i in range(a + 1, b + 1):
            share = (nodes.t[i] - nodes.t[a]) / span if span > 0.0 else 1.0
            for k in range(3):
                out[0][i, k] -= share * d[j, k]
                out[1][i, k] -= share * d[j, 3 + k]
                psi[k] = -share * d[j, 6 + k]
            exp(psi, turn)
            copy2(out[2][i], C)
            matmul(turn, C, out[2][i])


@inner
def _less(nodes: Nodes, i: int, bg: Array, ba: Array, w: Array, f: Array) -> None:
    """Rate and force at a node without the biases, as they are integrated."""
    for k in range(3):
        w[k] = nodes.gyro[i, k] - bg[k] + nodes.bend[i, k]
        f[k] = nodes.accel[i, k] - ba[k] + nodes.bend[i, 3 + k]


@inner
def _add_extra(Q: Array, later: Array, dt: float, extra: Array, work: Array) -> None:
    """Add to Q (9, 9) what an interval of dt seconds brings besides the noise of what was read,
    which the transition ``later`` then carries on."""
    new, half = work[0], work[1]
    zero2(new)
    zero2(half)
    for a in range(3):
        new[a, a] = extra[2]
        new[6 + a, 6 + a] = extra[0]
        add_unknown_force(new, a, dt, extra[1])
    for a in range(9):
        for b in range(9):
            for k in range(9):
                half[a, b] += later[a, k] * new[k, b]
    for a in range(9):
        for b in range(9):
            for k in range(9):
                Q[a, b] += half[a, k] * later[b, k]


@inner
def _angle_between(A: Array, B: Array, out: Array) -> None:
    """Rotation vector of A B', which must not be near half a turn."""
    D = local_matrix(3, 3)
    for a in range(3):
        for b in range(3):
            D[a, b] = 0.0
            for c in range(3):
                D[a, b] += A[a, c] * B[b, c]
    x = 0.5 * (D[2, 1] - D[1, 2])
    y = 0.5 * (D[0, 2] - D[2, 0])
    z = 0.5 * (D[1, 0] - D[0, 1])
    s = math.sqrt(x * x + y * y + z * z)
    angle = math.atan2(s, 0.5 * (D[0, 0] + D[1, 1] + D[2, 2] - 1.0))
    k = 1.0 if s < 1e-9 else angle / s
    out[0], out[1], out[2] = k * x, k * y, k * z
