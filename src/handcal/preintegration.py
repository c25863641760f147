"""Compiled: the readings between two epochs, integrated once into one transition."""

from __future__ import annotations

import math

import numpy as np

from handcal._jit import copy1, copy2, inner, local_matrix, njit, zero2
from handcal.covariance import Propagation, add_unknown_force, propagate
from handcal.kernel import BASE, Nodes, corrected, interval
from handcal.so3 import exp, matmul
from handcal.strapdown import advance, increments
from handcal.types import Array, IntArray


@njit
def preintegrate(
    nodes: Nodes,
    epoch: IntArray,
    nominal: tuple[Array, Array, Array],
    constants: tuple[Array, Array, Array, Array],
    g_n: Array,
    omega_ie_n: Array,
    out: tuple[Array, Array, Array, Array, Array],
    work: Propagation,
) -> None:
    """Phi, d and the three Q of every epoch but the first, into ``out`` (see ``Linear``).

    constants: bias of gyro and of accelerometer from each epoch on (k, 3), constants, reference.
    """
    bg, ba, extras, ref = constants
    Phi_out, d_out, Qg_out, Qa_out, Q0_out = out
    mi = nodes.J.shape[2]
    width = BASE + mi
    Phi, J = np.empty((9, width)), np.empty((6, mi))
    none = np.empty((0, 0))
    total, new = np.zeros((9, width)), np.zeros((9, width))
    Q = np.zeros((3, 9, 9))
    p, v, C = np.empty(3), np.empty(3), np.empty((3, 3))
    for j in range(1, len(epoch)):
        copy1(nominal[0][j - 1], p)
        copy1(nominal[1][j - 1], v)
        copy2(nominal[2][j - 1], C)
        zero2(total)
        for a in range(9):
            total[a, a] = 1.0
        for s in range(3):
            zero2(Q[s])
        for i in range(epoch[j - 1] + 1, epoch[j] + 1):
            interval(nodes, i, bg[j - 1], ba[j - 1], extras, ref, g_n, omega_ie_n, p, v, C, Phi, J)
            _chain(Phi, total, new)
            copy2(new, total)
            _add_noise(Q, Phi, none, nodes.t[i] - nodes.t[i - 1], nodes.extra[i], work)
        copy2(total, Phi_out[j])
        copy2(Q[0], Qg_out[j])
        copy2(Q[1], Qa_out[j])
        copy2(Q[2], Q0_out[j])
        for a in range(3):
            d_out[j, a] = p[a] - nominal[0][j, a]
            d_out[j, 3 + a] = v[a] - nominal[1][j, a]
        _angle_between(C, nominal[2][j], d_out[j, 6:9])


@njit
def integrate(
    nodes: Nodes,
    epoch: IntArray,
    nominal: tuple[Array, Array, Array],
    constants: tuple[Array, Array, Array, Array],
    g_n: Array,
    omega_ie_n: Array,
    out: tuple[Array, Array, Array],
    d: Array,
) -> None:
    """Position, velocity (n, 3) and attitude (n, 3, 3) at all nodes, into ``out``, and where the
    integration ends beside the next epoch, d (k, 9): predicted minus nominal.

    Each epoch begins anew from the nominal; what it lacks at its end is spread over its time.
    constants: as in ``preintegrate``.
    """
    bg, ba, extras, ref = constants
    mi = nodes.J.shape[2]
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
            if mi > 0 or i == a + 1:
                corrected(nodes.gyro[i - 1], nodes.J[i - 1], 0, bg[j - 1], extras, ref, w[0])
                corrected(nodes.accel[i - 1], nodes.J[i - 1], 3, ba[j - 1], extras, ref, w[2])
            else:
                copy1(w[1], w[0])
                copy1(w[3], w[2])
            corrected(nodes.gyro[i], nodes.J[i], 0, bg[j - 1], extras, ref, w[1])
            corrected(nodes.accel[i], nodes.J[i], 3, ba[j - 1], extras, ref, w[3])
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
def _chain(Phi: Array, total: Array, out: Array) -> None:
    """out = the transition ``total`` followed by Phi, both (9, 15 + mi): biases and constants
    do not move, so their part of Phi is only added."""
    for a in range(9):
        for j in range(9):
            out[a, j] = 0.0
        for j in range(9, Phi.shape[1]):
            out[a, j] = Phi[a, j]
        for k in range(9):
            s = Phi[a, k]
            if s != 0.0:
                for j in range(Phi.shape[1]):
                    out[a, j] += s * total[k, j]


@inner
def _add_noise(
    Q: Array, Phi: Array, none: Array, dt: float, extra: Array, work: Propagation
) -> None:
    """Carry the three Q (3, 9, 9), of gyro, accelerometer and gaps, over one interval."""
    for s in range(3):
        if s < 2 or Q[s, 3, 3] != 0.0 or Q[s, 6, 6] != 0.0:
            propagate(Q[s], Phi, none, none, none, Q.shape[1], work)
    for a in range(3):
        Q[0, 6 + a, 6 + a] += dt
        Q[1, 3 + a, 3 + a] += dt
        Q[2, 6 + a, 6 + a] += extra[0]
        add_unknown_force(Q[2], a, dt, extra[1])


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
