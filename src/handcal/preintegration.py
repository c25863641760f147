"""Compiled: the readings between two epochs, integrated once into one transition."""

from __future__ import annotations

import math

import numpy as np

from handcal._jit import copy1, copy2, inner, local_matrix, njit, zero2
from handcal.covariance import Propagation, propagate
from handcal.kernel import BASE, Nodes, interval
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
        Q[2, 3 + a, 3 + a] += extra[1]


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
