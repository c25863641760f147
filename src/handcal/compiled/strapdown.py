"""Strapdown mechanization in the local-level frame and the transition of its errors.

Readings are values at their stamps and taken as linear in between, so an interval's
increments carry the coning and sculling terms of a linear rate and force. The Earth's
rate enters through its (constant) vector in n; position is a displacement of metres,
so transport rate and the gravity gradient are left out.
"""

from __future__ import annotations

import numpy as np

from handcal.compiled.jit import copy1, copy2, lean, local_matrix, local_vector, zero2
from handcal.compiled.so3 import exp, matmul, orthonormalise, rotate
from handcal.types import Array


@lean
def increments(w0: Array, w1: Array, f0: Array, f1: Array, dt: float, out: Array) -> None:
    """Rotation, velocity and position increments of one interval, in b at its start.

    w0, w1 (3,) rad/s and f0, f1 (3,) m/s^2: readings at the two ends, dt s apart.
    out (3, 3): rows are the rotation vector (rad), the velocity (m/s) and the position
    increment (m). With rate and force linear in time the rotation vector is exact to
    O(dt^5) (Bortz: phi' = w + phi x w / 2) and the velocity to O(dt^4) (rotation and
    sculling terms of Savage, J. Guidance 21(2), 1998, generalised to linear profiles).
    """
    dt2 = dt * dt
    for i in range(3):
        j = (i + 1) % 3
        k = (i + 2) % 3
        out[0, i] = 0.5 * dt * (w0[i] + w1[i]) + dt2 / 12.0 * (w0[j] * w1[k] - w0[k] * w1[j])
        # integral of theta(t) x f(t), theta the integral of the linear rate
        c00 = w0[j] * f0[k] - w0[k] * f0[j]
        c01 = w0[j] * f1[k] - w0[k] * f1[j]
        c10 = w1[j] * f0[k] - w1[k] * f0[j]
        c11 = w1[j] * f1[k] - w1[k] * f1[j]
        out[1, i] = 0.5 * dt * (f0[i] + f1[i]) + dt2 / 24.0 * (3 * c00 + 5 * c01 + c10 + 3 * c11)
        out[2, i] = dt2 / 6.0 * (2 * f0[i] + f1[i]) + dt2 * dt / 6.0 * (
            0.25 * (c00 + c01 + c10 + c11)
        )
    # second order in the rotation, with the mean rate and force
    wx, wy, wz = 0.5 * (w0[0] + w1[0]), 0.5 * (w0[1] + w1[1]), 0.5 * (w0[2] + w1[2])
    fx, fy, fz = 0.5 * (f0[0] + f1[0]), 0.5 * (f0[1] + f1[1]), 0.5 * (f0[2] + f1[2])
    w2 = wx * wx + wy * wy + wz * wz
    wf = wx * fx + wy * fy + wz * fz
    s = dt2 * dt / 6.0
    out[1, 0] += s * (wx * wf - fx * w2)
    out[1, 1] += s * (wy * wf - fy * w2)
    out[1, 2] += s * (wz * wf - fz * w2)


@lean
def advance(
    p: Array, v: Array, C: Array, inc: Array, dt: float, g_n: Array, omega_ie_n: Array, f_n: Array
) -> None:
    """Carry p_n, v_n, C_nb (in place) over one interval with its increments.

    f_n (3,) receives the mean specific force of the interval in n, m/s^2, which the
    error transition needs.
    """
    dv = local_vector(3)
    dp = local_vector(3)
    turn = local_matrix(3, 3)
    new = local_matrix(3, 3)
    rotate(C, inc[1], dv)
    rotate(C, inc[2], dp)
    ox, oy, oz = omega_ie_n[0], omega_ie_n[1], omega_ie_n[2]
    coriolis = local_vector(3)
    coriolis[0] = -2.0 * (oy * v[2] - oz * v[1])
    coriolis[1] = -2.0 * (oz * v[0] - ox * v[2])
    coriolis[2] = -2.0 * (ox * v[1] - oy * v[0])
    earth_turns = ox != 0.0 or oy != 0.0 or oz != 0.0
    if earth_turns:
        # n turns while the force acts: its moment about the start is dt dv - dp
        mx, my, mz = dt * dv[0] - dp[0], dt * dv[1] - dp[1], dt * dv[2] - dp[2]
        third = dt / 3.0
        px, py, pz = dp[0], dp[1], dp[2]
        dv[0] -= oy * mz - oz * my
        dv[1] -= oz * mx - ox * mz
        dv[2] -= ox * my - oy * mx
        dp[0] -= third * (oy * pz - oz * py)
        dp[1] -= third * (oz * px - ox * pz)
        dp[2] -= third * (ox * py - oy * px)
    for i in range(3):
        a = g_n[i] + coriolis[i]
        p[i] += dt * v[i] + dp[i] + 0.5 * dt * dt * a
        v[i] += dv[i] + dt * a
        f_n[i] = dv[i] / dt
    exp(inc[0], turn)
    matmul(C, turn, new)
    if earth_turns:
        dv[0], dv[1], dv[2] = -dt * ox, -dt * oy, -dt * oz
        exp(dv, turn)
        matmul(turn, new, C)
    else:
        copy2(new, C)
    orthonormalise(C)


@lean
def error_transition(
    C_mid: Array, f_n: Array, dt: float, omega_ie_n: Array, J: Array, Phi: Array
) -> None:
    """First nine rows of the transition of the error state over one interval.

    The state is (position, velocity, psi, gyro bias, accelerometer bias, then parameters
    whose effect on the readings is J (6, k): gyro error rows 0-2, accelerometer error rows
    3-5). Phi (9, 15 + k) is overwritten. Equations 7-9 of paper 002 with psi defined by
    C = exp([psi x]) C_est, integrated to second order in dt, plus Coriolis and Earth rate
    where given.
    """
    zero2(Phi)
    for i in range(9):
        Phi[i, i] = 1.0
    h = 0.5 * dt * dt
    for i in range(3):
        j = (i + 1) % 3
        l = (i + 2) % 3
        Phi[i, 3 + i] = dt
        # -[f x] psi dt
        Phi[3 + i, 6 + j] = dt * f_n[l]
        Phi[3 + i, 6 + l] = -dt * f_n[j]
        Phi[i, 6 + j] = h * f_n[l]
        Phi[i, 6 + l] = -h * f_n[j]
        Phi[3 + i, 3 + j] = 2.0 * dt * omega_ie_n[l]
        Phi[3 + i, 3 + l] = -2.0 * dt * omega_ie_n[j]
        Phi[6 + i, 6 + j] = dt * omega_ie_n[l]
        Phi[6 + i, 6 + l] = -dt * omega_ie_n[j]
    for i in range(3):
        j = (i + 1) % 3
        l = (i + 2) % 3
        for c in range(3):
            Phi[6 + i, 9 + c] = -dt * C_mid[i, c]
            Phi[3 + i, 12 + c] = -dt * C_mid[i, c]
            Phi[i, 12 + c] = -h * C_mid[i, c]
            # a gyro error turns the force it rides on: half of its rotation within the interval
            turned = dt * (f_n[j] * C_mid[l, c] - f_n[l] * C_mid[j, c])
            Phi[3 + i, 9 + c] = 0.5 * dt * turned
            Phi[i, 9 + c] = dt * dt / 6.0 * turned
    for i in range(9):
        for b in range(3 if i >= 6 else 6):
            for c in range(J.shape[1]):
                Phi[i, 15 + c] += Phi[i, 9 + b] * J[b, c]


def integrate(
    t: Array,
    gyro: Array,
    accel: Array,
    p0: Array,
    v0: Array,
    C0: Array,
    g_n: Array,
    omega_ie_n: Array,
) -> tuple[Array, Array, Array]:
    """Free inertial navigation: positions (n, 3), velocities (n, 3), C_nb (n, 3, 3).

    t (n,) s; gyro (n, 3) rad/s; accel (n, 3) m/s^2; start p0, v0 (3,), C0 (3, 3).
    """
    n = len(t)
    p, v, C = np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3, 3))
    p[0], v[0], C[0] = p0, v0, C0
    _integrate(t, gyro, accel, g_n, omega_ie_n, p, v, C)
    return p, v, C


@lean
def _integrate(
    t: Array, gyro: Array, accel: Array, g_n: Array, omega_ie_n: Array, p: Array, v: Array, C: Array
) -> None:
    inc = local_matrix(3, 3)
    f_n = local_vector(3)
    for i in range(len(t) - 1):
        dt = t[i + 1] - t[i]
        increments(gyro[i], gyro[i + 1], accel[i], accel[i + 1], dt, inc)
        copy1(p[i], p[i + 1])
        copy1(v[i], v[i + 1])
        copy2(C[i], C[i + 1])
        advance(p[i + 1], v[i + 1], C[i + 1], inc, dt, g_n, omega_ie_n, f_n)
