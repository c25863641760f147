"""A table with three axes: how a body on it lies, and what its errors do to a calibration.

The body is turned about three of its axes one after the other, C_nb = R_1(alpha) R_2(beta)
R_3(gamma) with the axes of ``sequence`` (papers 000 and 001); n has z up. Each axis stops
beside its place by an error of its own, new in every pose; the base is tilted by one error
for all.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from handcal.compiled.so3 import rotations
from handcal.estimate import regression
from handcal.lab.known_input import KnownInput, turned
from handcal.types import Array, InputError

ARCSEC, ARCMIN = math.radians(1.0 / 3600.0), math.radians(1.0 / 60.0)
STEP = 1e-4


@dataclass(frozen=True)
class Table:
    """Poses: sequence ("ZXZ"), angles (n, 3) rad, gravity (m/s^2 or 1 for g)."""

    sequence: str
    angles: Array
    gravity: float

    def force(self, error: Array | None = None, tilt: Array | None = None) -> Array:
        """Specific force (..., n, 3) in body axes; error (..., n, 3) rad of the angles; tilt
        (..., 2) rad of the base about east and north."""
        angles = self.angles if error is None else self.angles + error
        up = np.zeros((*angles.shape[:-2], 1, 3))
        up[..., 2] = self.gravity
        f = np.broadcast_to(up, angles.shape)
        if tilt is not None:
            turn = np.concatenate([tilt, np.zeros((*tilt.shape[:-1], 1))], axis=-1)
            f = np.broadcast_to(_turned_back(turn, up[..., 0, :])[..., None, :], angles.shape)
        for i, axis in enumerate(self.sequence):
            f = _about("XYZ".index(axis), angles[..., i], f)
        return f


def table(sequence: str, angles: Array, gravity: float) -> Table:
    """Poses of a table. Errors: InputError for a sequence that is none."""
    name = sequence.upper()
    if len(name) != 3 or set(name) - set("XYZ") or name[0] == name[1] or name[1] == name[2]:
        raise InputError(
            f"--sequence {sequence}: three axes such as ZXZ or XYZ, none twice running."
        )
    return Table(name, angles, gravity)


def _about(axis: int, angle: Array, f: Array) -> Array:
    """R(angle)^T f for rotations about one axis; angle (...), f (..., 3)."""
    j, k = (axis + 1) % 3, (axis + 2) % 3
    s, c = np.sin(angle), np.cos(angle)
    out = f.copy()
    out[..., j] = c * f[..., j] + s * f[..., k]
    out[..., k] = -s * f[..., j] + c * f[..., k]
    return out


def _turned_back(turn: Array, v: Array) -> Array:
    """C^T v for rotation vectors turn (..., 3) and vectors v (..., 3)."""
    C = rotations(turn.reshape(-1, 3)).reshape(*turn.shape[:-1], 3, 3)
    return np.asarray(np.einsum("...ji,...j->...i", C, np.broadcast_to(v, turn.shape)))


def error_covariance(
    result: KnownInput, poses: Table, angle: float, tilt: float, kept: bool = True
) -> Array:
    """Covariance (k, k) of the parameters that errors of the table bring.

    angle: standard deviation of each axis in each pose, rad; tilt: of the base about east and
    about north, rad. Readings that a wrong input misses move the estimate by B = A^+ times
    them, so the covariance is B S B', S that of the readings missed: an axis turns all
    three readings of its pose, the base those of all poses. kept: False leaves these
    correlations out, as if every reading were missed on its own.

    Source: paper 000, section V, where delta U is what is missed and delta b follows from it.
    """
    rows = result.bench.used[3:]
    truth = turned(result.bench.truth, result.R)
    effects = result.effects
    x = result.x[-sum(len(e.parameters) for e in effects) :]
    by = result.bench.mean(regression.by_truth(effects, x, truth))[:, 3:, 3:] @ result.R
    n = len(result.bench)
    missed = np.zeros((n, 3, 3 * n + 2))
    for a in range(3):
        e = np.zeros((n, 3))
        e[:, a] = STEP
        slope = (poses.force(e) - poses.force(-e)) / (2.0 * STEP)
        missed[range(n), :, 3 * np.arange(n) + a] = angle * np.einsum("nij,nj->ni", by, slope)
    for a, base in enumerate(STEP * np.eye(2)):
        slope = (poses.force(tilt=base) - poses.force(tilt=-base)) / (2.0 * STEP)
        missed[:, :, 3 * n + a] = tilt * np.einsum("nij,nj->ni", by, slope)
    L = missed[:, rows].reshape(-1, 3 * n + 2)
    B = estimator(result)
    S = L @ L.T
    return np.asarray(B @ (S if kept else np.diag(np.diag(S))) @ B.T)


def estimator(result: KnownInput) -> Array:
    """B (k, m) by which the estimate follows the accelerometer's readings (m)."""
    used = np.tile(result.bench.used, len(result.bench))
    variance = (
        result.bench.variance + np.repeat([result.extra["gyro"], result.extra["accel"]], 3) ** 2
    )
    root = np.sqrt(variance.ravel()[used])
    of_accel = np.tile(np.arange(6) >= 3, len(result.bench))[used]
    return np.asarray((np.linalg.pinv(result.A) / root)[:, of_accel])
