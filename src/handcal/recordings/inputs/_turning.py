"""How gravity turns, against what the gyro says: one linear map of the gyro's reading.

Between two moments the accelerometer shows in which direction up was, before and after; seen from
the body it obeys du/dt = u x (M w + c), with the rate w as read. M (3, 3) holds the gyro's factor
and its axes at once: the identity where all is well, twice that where the gyro reads half, a signed
permutation where axes are exchanged. Moments are chosen by how far *gravity* turns between them,
and by how calm they are, never by what the gyro reads: a wrong unit does not choose its evidence.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations, product

import numpy as np

from handcal.types import Array, BoolArray, Imu, IntArray

# A moment is the mean over so long, s, and readings are averaged to so many in a second.
BLOCK_S, ENOUGH_HZ = 0.1, 100.0
# Moments are compared that are so many blocks apart.
LAGS = (2, 3, 5, 8, 13, 21, 34, 55)
# A step of so many usual ones is a gap, across which nothing is known.
GAP = 5.0
# Errors of up at a moment, rad, and what a gyro adds to them in a second, at the least.
LEAST, DRIFT = 0.01, 0.01
# Windows: by how many of their sigmas gravity turns in one, and as a part of what it does in most;
# how many are enough, and how many are looked at.
SHOWN, SHARE, FEWEST, MOST = 3.0, 0.3, 12, 150
# Of what is missed as read, and of gravity's own turning, a map leaves this part at the most.
CLEARLY = 0.25
# A usual zero-rate offset, rad/s; rounds of a fit, and the step at which it rests.
OFFSET, ROUNDS, SETTLED = 0.1, 8, 1e-3
SIGNED = tuple(
    np.diag(signs) @ np.eye(3)[list(order)]
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3))
)
# Other maps that leave as much, but for this factor and this angle, rad, are as good; those are
# looked at that the fit itself is no further from than this, in squares of sigmas.
AS_GOOD, AS_LITTLE, NEAR, CANDIDATES = 1.25, 0.005, 30.0, 6


@dataclass(frozen=True)
class Windows:
    """k windows between two moments: up before and after (k, 3) and how uncertain their angle is
    (k,), rad; rates as read (k, m, 3), and the steps (k, m), s, in which they hold: zero behind
    the end; up as it was read on the way (k, m, 3)."""

    before: Array
    after: Array
    sigma: Array
    rate: Array
    dt: Array
    way: Array


@dataclass(frozen=True)
class Turning:
    """Median angles, rad, by which gravity is missed at the end of a window: as_read; still, were
    there no turn; mapped, with factor times axes (3, 3, a signed permutation) times the rate.
    sigma: of the factor's logarithm. alike: whether other axes would do as well."""

    as_read: float
    still: float
    mapped: float
    factor: float
    axes: Array
    sigma: float
    alike: bool = False

    @property
    def tells(self) -> bool:
        """Whether these axes, and no others, are seen to be the gyro's as read."""
        return self.sigma > 0.0 and not self.alike and np.array_equal(self.axes, np.eye(3))


def named(A: Array) -> list[str]:
    """The axes that the rows of a signed permutation (3, 3) take."""
    return [f"{'-' if row.sum() < 0 else ''}{'xyz'[int(abs(row).argmax())]}" for row in A]


def turning(imu: Imu, gravity: float, enough: float = 0.0) -> Turning | None:
    """What the motion says of the gyro; None where gravity does not turn, or nothing is calm.

    gravity: what the accelerometer reads at rest; enough: where less than this is missed as read,
    rad, no other map is looked for.
    """
    w = windows(imu, gravity)
    if len(w.dt) < FEWEST:
        return None
    still = float(np.median(_angles(w.before, w.after)))
    one = np.eye(3)
    as_read = _left(w, one)
    if as_read < enough:
        return Turning(as_read, still, as_read, 1.0, one, 0.0)
    M, c, information = _fitted(w)
    if _missed(w, M, c) > CLEARLY * (min(as_read, still) if enough > 0.0 else still):
        # (no factor and axes leave less)
        return Turning(as_read, still, as_read, 1.0, one, 0.0)
    near = sorted((_read_off(M, information, P) for P in SIGNED), key=lambda r: r[0])
    tried = [(_left(w, f * P), f, P, s) for cost, f, P, s in near
             if f > 0.0 and cost < NEAR + 4.0 * near[0][0]][:CANDIDATES]  # fmt: skip
    most = AS_GOOD * min((left for left, *_ in tried), default=np.inf) + AS_LITTLE
    as_good = [r for r in tried if r[0] <= most]
    if not as_good:
        return Turning(as_read, still, as_read, 1.0, one, 0.0)
    left, f, P, sigma = max(as_good, key=lambda r: (np.trace(r[2]), -r[0]))
    return Turning(as_read, still, left, f, P, sigma, len(as_good) > 1)


def _read_off(M: Array, information: Array, P: Array) -> tuple[float, float, Array, float]:
    """How far from the fit a signed permutation is, with the best factor; that; and its sigma."""
    p, x = P.ravel(), M.ravel()
    own = max(float(p @ information @ p), 1e-12)
    f = float(p @ information @ x) / own
    d = x - f * p
    return float(d @ information @ d), f, P, 1.0 / (max(abs(f), 1e-12) * np.sqrt(own))


def windows(imu: Imu, gravity: float) -> Windows:
    """Those in which gravity turns most: for each moment the best end."""
    t, gyro, accel, bad = _averaged(imu)
    step = float(np.median(np.diff(t)))
    size = max(2, round(BLOCK_S / step))
    n = len(t) // size
    f = accel[: n * size].reshape(n, size, 3)
    up, sigma = _moments(f, gravity)
    holes = np.concatenate([[0], np.cumsum(bad[: n * size].reshape(n, size).any(axis=1))])
    last, best, error = np.arange(n), np.zeros(n), np.ones(n)
    for lag in (k for k in LAGS if k < n):
        i = np.arange(n - lag)
        s = np.sqrt(sigma[i] ** 2 + sigma[i + lag] ** 2 + (DRIFT * lag * BLOCK_S) ** 2)
        score = np.linalg.norm(up[i + lag] - up[i], axis=1) / s
        more = (score > best[i]) & (holes[i + lag + 1] == holes[i])
        last[i], error[i] = np.where(more, i + lag, last[i]), np.where(more, s, error[i])
        best[i] = np.where(more, score, best[i])
    enough = max(SHOWN, SHARE * float(np.quantile(best, 0.98))) if n else SHOWN
    first = np.flatnonzero(best > enough)
    if len(first):
        first = first[np.unique(np.linspace(0, len(first) - 1, MOST).astype(np.int64))]
    last = last[first]
    rate, dt, way = _between(t, gyro, accel, first * size + size // 2, last * size + size // 2)
    return Windows(up[first], up[last], error[first], rate, dt, way)


def _averaged(imu: Imu) -> tuple[Array, Array, Array, BoolArray]:
    """Stamps (n,), rates and forces (n, 3) of groups of readings, and which are followed by a gap
    or hold a reading that is none (n,)."""
    step = np.diff(imu.t)
    usual = float(np.median(step))
    bad = ~imu.valid
    bad[:-1] |= step > GAP * usual
    group = max(1, int(1.0 / (ENOUGH_HZ * usual)))
    n = len(imu.t) // group
    own = slice(n * group)
    t, gyro, accel = (x[own].reshape(n, group, -1).mean(axis=1)
                      for x in (imu.t, imu.gyro, imu.accel))  # fmt: skip
    return t[:, 0], gyro, accel, np.asarray(bad[own].reshape(n, group).any(axis=1))


def _moments(f: Array, gravity: float) -> tuple[Array, Array]:
    """Up (n, 3) in each block of forces (n, m, 3), and how uncertain it is (n,), rad: by how much
    the forces' lengths differ from gravity's there and beside."""
    mean = f.mean(axis=1)
    beside = np.clip(np.arange(len(f))[:, None] + [-1, 0, 1], 0, len(f) - 1)
    off = np.mean((np.linalg.norm(f, axis=2) / gravity - 1.0) ** 2, axis=1)
    sigma = np.sqrt(LEAST**2 + off[beside].mean(axis=1))
    return mean / np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-9), sigma


def _between(
    t: Array, gyro: Array, accel: Array, first: IntArray, last: IntArray
) -> tuple[Array, Array, Array]:
    """Rates (k, m, 3), steps (k, m) and up as read (k, m, 3) from first to last readings (k,)."""
    index = first[:, None] + np.arange(int((last - first).max(initial=1)))
    inside = index < last[:, None]
    index = np.minimum(index, len(t) - 2)
    dt = np.where(inside, t[index + 1] - t[index], 0.0)
    way = accel[index] + accel[index + 1]
    way /= np.maximum(np.linalg.norm(way, axis=2, keepdims=True), 1e-9)
    return 0.5 * (gyro[index] + gyro[index + 1]), dt, way


def cross(v: Array) -> Array:
    """[v x] (..., 3, 3) of v (..., 3)."""
    out = np.zeros((*v.shape, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    return np.asarray(out - np.swapaxes(out, -1, -2))


def rotations(phi: Array) -> Array:
    """(..., 3, 3) of rotation vectors (..., 3), rad."""
    a = np.linalg.norm(phi, axis=-1)[..., None, None]
    K = cross(phi)
    half = np.sinc(a / (2 * np.pi))
    return np.asarray(np.eye(3) + np.sinc(a / np.pi) * K + 0.5 * half**2 * (K @ K))


def turned(w: Windows, M: Array, c: Array) -> tuple[Array, Array]:
    """Rotation (k, 3, 3) from the end of each window to its beginning, of rates M w + c, and the
    derivative (k, 3, 12) of its rotation vector, at the beginning, by M and c."""
    k, m = w.dt.shape
    step = rotations((w.rate @ M.T + c) * w.dt[..., None])
    R, sums = np.broadcast_to(np.eye(3), (k, 3, 3)), np.zeros((k, 3, 12))
    for i in range(m):
        D = R * w.dt[:, i, None, None]
        sums[:, :, :9] += (D[..., None] * w.rate[:, i, None, None, :]).reshape(k, 3, 9)
        sums[:, :, 9:] += D
        R = R @ step[:, i]
    return R, sums


def _angles(a: Array, b: Array) -> Array:
    """Between directions (k, 3), rad."""
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), np.sum(a * b, axis=1)))


def _left(w: Windows, M: Array) -> float:
    """Median angle by which gravity is missed with this map and the offset that suits it, rad."""
    held = np.diag([1e12] * 9 + [1.0 / OFFSET**2] * 3)
    M, c, _ = _descended(w, M, np.zeros(3), held, rounds=2)
    return _missed(w, M, c)


def _missed(w: Windows, M: Array, c: Array) -> float:
    R, _ = turned(w, M, c)
    return float(np.median(_angles((R @ w.after[..., None])[..., 0], w.before)))


def _fitted(w: Windows) -> tuple[Array, Array, Array]:
    """The map M (3, 3) and offset c (3,) that explain best how gravity turns, and the information
    (9, 9) of M, by rows; begun where up as read on the way puts it, which is linear in M."""
    free = np.diag([1e-6] * 9 + [1.0 / OFFSET**2] * 3)
    S = cross(w.way) * w.dt[..., None, None]
    by_M = np.einsum("kmij,kml->kijl", S, w.rate).reshape(len(w.dt), 3, 9)
    J = np.concatenate([by_M, S.sum(axis=1)], axis=2)
    x, _ = _solved(J, w.after - w.before, w.sigma, free, np.zeros(12))
    M, c, A = _descended(w, x[:9].reshape(3, 3), x[9:], free, rounds=ROUNDS)
    return M, c, A[:9, :9] - A[:9, 9:] @ np.linalg.solve(A[9:, 9:], A[9:, :9])


def _descended(
    w: Windows, M: Array, c: Array, prior: Array, rounds: int
) -> tuple[Array, Array, Array]:
    """Gauss-Newton on M and c, and the information (12, 12) where it ends; c has its prior about
    zero, M (as it is at each round) about what it was."""
    A = prior
    for _ in range(rounds):
        R, sums = turned(w, M, c)
        seen = (R @ w.after[..., None])[..., 0]
        x = np.concatenate([np.zeros(9), c])
        step, A = _solved(cross(seen) @ sums, seen - w.before, w.sigma, prior, x)
        most = 0.5 * float(np.linalg.norm(M)) / max(float(np.linalg.norm(step[:9])), 1e-12)
        step *= min(1.0, most)
        M, c = M + step[:9].reshape(3, 3), c + step[9:]
        if np.abs(step).max() < SETTLED * np.abs(M).max():
            break
    return M, c, A


def _solved(J: Array, r: Array, sigma: Array, prior: Array, x: Array) -> tuple[Array, Array]:
    """The step that least squares of r (k, 3) ask for, large ones counted less (Huber), and the
    information; x: how far from their prior the unknowns are."""
    size = np.linalg.norm(r, axis=1) / sigma
    scale = max(1.0, float(np.median(size)))
    weight = np.minimum(1.0, 2.0 * scale / np.maximum(size, 1e-9)) / (sigma * scale) ** 2
    A = np.einsum("k,kij,kil->jl", weight, J, J) + prior
    b = np.einsum("k,kij,ki->j", weight, J, r)
    return np.linalg.solve(A, b - prior @ x), A
