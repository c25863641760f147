"""Rotations: exponential, logarithm and quaternions, compiled and vectorised.

The compiled functions write into ``out`` because the filter calls them for every
sample; the ``_many`` functions work on arrays of rotations for readers and plots.
"""

from __future__ import annotations

import numpy as np

from handcal.compiled.jit import lean
from handcal.types import Array


@lean
def exp(phi: Array, out: Array) -> None:
    """Rotation matrix of the rotation vector phi (3,) rad (Rodrigues), into out (3, 3)."""
    x, y, z = phi[0], phi[1], phi[2]
    a2 = x * x + y * y + z * z
    if a2 < 0.02:
        # (8 degrees, more than an IMU turns between two samples; what is left out is below
        # round-off, and the quotients are taken beforehand)
        s = 1 - a2 * (1 / 6) * (1 - a2 * (1 / 20) * (1 - a2 * (1 / 42) * (1 - a2 * (1 / 72))))
        c = 0.5 - a2 * (1 / 24) * (1 - a2 * (1 / 30) * (1 - a2 * (1 / 56) * (1 - a2 * (1 / 90))))
    else:
        a = np.sqrt(a2)
        s = np.sin(a) / a
        c = (1.0 - np.cos(a)) / a2
    out[0, 0] = 1.0 - c * (y * y + z * z)
    out[1, 1] = 1.0 - c * (x * x + z * z)
    out[2, 2] = 1.0 - c * (x * x + y * y)
    out[0, 1] = c * x * y - s * z
    out[1, 0] = c * x * y + s * z
    out[0, 2] = c * x * z + s * y
    out[2, 0] = c * x * z - s * y
    out[1, 2] = c * y * z - s * x
    out[2, 1] = c * y * z + s * x


@lean
def left_jacobian(phi: Array, out: Array) -> None:
    """J (3, 3) of exp(phi + d) = exp(J d) exp(phi), to the first order in d, into out."""
    a2 = phi[0] * phi[0] + phi[1] * phi[1] + phi[2] * phi[2]
    if a2 < 1e-4:
        c, s = 0.5 - a2 / 24.0, 1.0 / 6.0 - a2 / 120.0
    else:
        a = np.sqrt(a2)
        c, s = (1.0 - np.cos(a)) / a2, (1.0 - np.sin(a) / a) / a2
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        out[i, i] = 1.0 - s * (phi[j] * phi[j] + phi[k] * phi[k])
        out[i, j] = s * phi[i] * phi[j] - c * phi[k]
        out[i, k] = s * phi[i] * phi[k] + c * phi[j]


@lean
def matrix_into(w: float, x: float, y: float, z: float, out: Array) -> None:
    """Rotation matrix of a unit quaternion, into out (3, 3)."""
    out[0, 0] = 1 - 2 * (y * y + z * z)
    out[1, 1] = 1 - 2 * (x * x + z * z)
    out[2, 2] = 1 - 2 * (x * x + y * y)
    out[0, 1], out[1, 0] = 2 * (x * y - w * z), 2 * (x * y + w * z)
    out[0, 2], out[2, 0] = 2 * (x * z + w * y), 2 * (x * z - w * y)
    out[1, 2], out[2, 1] = 2 * (y * z - w * x), 2 * (y * z + w * x)


@lean
def matmul(A: Array, B: Array, out: Array) -> None:
    """out = A B for 3x3; out must be neither A nor B."""
    for i in range(3):
        for j in range(3):
            out[i, j] = A[i, 0] * B[0, j] + A[i, 1] * B[1, j] + A[i, 2] * B[2, j]


@lean
def rotate(C: Array, x: Array, out: Array) -> None:
    """out = C x for a 3x3 and a vector (3,); out must not be x."""
    for i in range(3):
        out[i] = C[i, 0] * x[0] + C[i, 1] * x[1] + C[i, 2] * x[2]


@lean
def orthonormalise(C: Array) -> None:
    """Remove round-off from a rotation matrix in place (one Newton step of the polar form)."""
    for i in range(3):
        for j in range(i, 3):
            d = 0.5 * (C[i, 0] * C[j, 0] + C[i, 1] * C[j, 1] + C[i, 2] * C[j, 2])
            if i == j:
                n = 1.5 - d
                for k in range(3):
                    C[i, k] *= n
            else:
                for k in range(3):
                    a = C[i, k]
                    b = C[j, k]
                    C[i, k] = a - d * b
                    C[j, k] = b - d * a


def matrix_exp(phi: Array) -> Array:
    """Rotation matrix of a rotation vector (3,) rad, as a new (3, 3) array."""
    out = np.empty((3, 3))
    exp(np.ascontiguousarray(phi, dtype=np.float64), out)
    return out


def rotations(phi: Array) -> Array:
    """Rotation matrices (n, 3, 3) of rotation vectors (n, 3) rad."""
    half = 0.5 * np.linalg.norm(phi, axis=1, keepdims=True)
    return matrix_of(np.hstack([np.cos(half), 0.5 * np.sinc(half / np.pi) * phi]))


def between(t_known: Array, C: Array, t: Array) -> Array:
    """Attitudes (n, 3, 3) at times t (n,), turning at a constant rate between the known ones
    C (k, 3, 3) at t_known (k,); before and after those, the first and the last."""
    at = np.clip(np.searchsorted(t_known, t, side="right") - 1, 0, len(t_known) - 2)
    turn = matrix_log(C[:-1].transpose(0, 2, 1) @ C[1:])
    share = np.clip((t - t_known[at]) / (t_known[at + 1] - t_known[at]), 0.0, 1.0)
    return np.asarray(C[at] @ rotations(turn[at] * share[:, None]))


def matrix_log(C: Array) -> Array:
    """Rotation vector (..., 3) rad of rotation matrices (..., 3, 3), angle in [0, pi]."""
    q = quaternion_of(C)
    s = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(s, q[..., :1])
    ratio = np.where(s > 1e-9, angle / np.where(s > 1e-9, s, 1.0), 2.0)
    return np.asarray(ratio * q[..., 1:])


def quaternion_of(C: Array) -> Array:
    """Quaternions w x y z (..., 4), w >= 0, of rotation matrices (..., 3, 3) (Shepperd)."""
    C = np.asarray(C, dtype=np.float64)
    d = np.stack([C[..., 0, 0], C[..., 1, 1], C[..., 2, 2]], -1)
    trace = d.sum(-1)
    candidates = np.stack([trace, d[..., 0], d[..., 1], d[..., 2]], -1)
    four = np.empty((*C.shape[:-2], 4, 4))
    four[..., 0, :] = np.stack(
        [
            1 + trace,
            C[..., 2, 1] - C[..., 1, 2],
            C[..., 0, 2] - C[..., 2, 0],
            C[..., 1, 0] - C[..., 0, 1],
        ],
        -1,
    )
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        row = np.empty((*C.shape[:-2], 4))
        row[..., 0] = C[..., k, j] - C[..., j, k]
        row[..., 1 + i] = 1 + 2 * d[..., i] - trace
        row[..., 1 + j] = C[..., j, i] + C[..., i, j]
        row[..., 1 + k] = C[..., k, i] + C[..., i, k]
        four[..., 1 + i, :] = row
    best = np.argmax(candidates, -1)[..., None, None]
    q = np.take_along_axis(four, best, axis=-2)[..., 0, :]
    q = np.where(q[..., :1] < 0, -q, q)
    return np.asarray(q / np.linalg.norm(q, axis=-1, keepdims=True))


def matrix_of(q: Array) -> Array:
    """Rotation matrices (..., 3, 3) of unit quaternions w x y z (..., 4)."""
    w, x, y, z = np.moveaxis(np.asarray(q, dtype=np.float64), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(r, -1) for r in rows], -2)


def skew(x: Array) -> Array:
    """Matrices [x cross] (..., 3, 3) of vectors (..., 3)."""
    out = np.zeros((*np.shape(x), 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -x[..., 2], x[..., 1], -x[..., 0]
    return np.asarray(out - np.swapaxes(out, -1, -2))


def along_skew(A: Array) -> Array:
    """Vectors (..., 3) whose products with any x are the sums of A (..., 3, 3) times [x cross]."""
    rows = A[..., 2, 1] - A[..., 1, 2], A[..., 0, 2] - A[..., 2, 0], A[..., 1, 0] - A[..., 0, 1]
    return np.stack(rows, axis=-1)


def yaw_of(C: Array) -> Array:
    """Heading atan2(C[1, 0], C[0, 0]) of rotation matrices (..., 3, 3), rad."""
    return np.asarray(np.arctan2(C[..., 1, 0], C[..., 0, 0]))


def wrap(angle: Array) -> Array:
    """Angles brought to (-pi, pi]."""
    wrapped = np.pi - np.remainder(np.pi - angle, 2 * np.pi)
    # just above pi the remainder rounds to a whole turn
    return np.asarray(np.where(wrapped <= -np.pi, np.pi, wrapped))
