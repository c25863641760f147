"""What the gyro makes of the turns from one rest to the next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline

from handcal.compiled.jit import njit
from handcal.compiled.so3 import matmul, rotations
from handcal.effects import Effect, Signals
from handcal.estimate.regression import columns, truth_of
from handcal.lab.stretches import Means, white_variance
from handcal.signals import of_arrays, some
from handcal.types import Array, BoolArray, IntArray, Recording

GAP_S = 0.2
# Where a rate is taken within an interval, and how far apart.
POINTS = np.array([0.5 - np.sqrt(3.0) / 6.0, 0.5 + np.sqrt(3.0) / 6.0])
APART = float(np.sqrt(3.0) / 3.0)


@dataclass(frozen=True)
class Turns:
    """q turns, each from rest before (q,) to rest after (q,).

    signals: of all turns one after the other, start (q + 1,) where each begins: the gyro less
    what it read at rest, and the accelerometer. share (n,): how much of its turn has passed.
    seconds (q,): how long each takes. missed (q,): rad, what the samples may miss of it along
    each axis, as if what a cubic does not pass were new at each. lost: turns that cannot be
    used, because readings are saturated or missing.
    """

    before: IntArray
    after: IntArray
    signals: Signals
    start: IntArray
    share: Array
    seconds: Array
    missed: Array
    lost: int

    def __len__(self) -> int:
        return len(self.before)

    def only(self, chosen: BoolArray) -> Turns:
        """Those between rests that are among the chosen ones (r,), numbered as these then are."""
        place = np.cumsum(chosen) - 1
        kept = np.flatnonzero(chosen[self.before] & chosen[self.after])
        own = [np.arange(self.start[k], self.start[k + 1]) for k in kept]
        rows = np.concatenate([np.zeros(0, dtype=np.int64), *own])
        return replace(
            self, before=place[self.before[kept]], after=place[self.after[kept]],
            signals=some(self.signals, rows),
            start=np.r_[0, np.cumsum([len(o) for o in own], dtype=np.int64)],
            share=self.share[rows], seconds=self.seconds[kept], missed=self.missed[kept],
        )  # fmt: skip


def no_turns() -> Turns:
    """Where there are rests alone."""
    none, empty = np.zeros(0, dtype=np.int64), np.zeros(0)
    signals = of_arrays(empty, np.zeros((0, 3)), np.zeros((0, 3)))
    return Turns(none, none, signals, np.zeros(1, dtype=np.int64), empty, empty, empty, 0)


def turns(recording: Recording, rests: Means) -> Turns:
    """The turns between rests that follow each other.

    Readings are interpolated, by a cubic spline, at two points of each interval (Gauss).
    """
    imu = recording.imu
    kept, parts, seconds, missed = [], [], [], []
    for k in range(len(rests) - 1):
        a, b = int(rests.last[k]), int(rests.first[k + 1])
        t = imu.t[a : b + 1]
        if not imu.valid[a : b + 1].all() or np.diff(t).max() > GAP_S:
            continue
        kept.append(k)
        parts.append(_gauss(recording, rests, k))
        seconds.append(float(t[-1] - t[0]))
        passed = imu.gyro[_around(a, b)]
        rough = float(np.sqrt(white_variance(passed).mean() * (len(passed) - 4)))
        missed.append(seconds[-1] / len(t) * rough)
    before = np.array(kept, dtype=np.int64)
    all_rows = np.vstack([np.zeros((0, 9)), *parts])
    warm = None if rests.temperature is None else all_rows[:, 8]
    signals = of_arrays(all_rows[:, 0], all_rows[:, 2:5], all_rows[:, 5:8], warm)
    start = np.r_[0, np.cumsum([len(p) for p in parts], dtype=np.int64)]
    return Turns(before, before + 1, signals, start, all_rows[:, 1], np.array(seconds),
                 np.array(missed), max(len(rests) - 1, 0) - len(kept))  # fmt: skip


def _around(a: int, b: int) -> slice:
    """The samples that the spline from sample a to b passes: some of both rests too, so that a
    turn of a few samples has enough."""
    return slice(max(a - 3, 0), b + 4)


def _gauss(recording: Recording, rests: Means, k: int) -> Array:
    """Rows of time, share, gyro, accelerometer and temperature during the turn after rest k."""
    imu = recording.imu
    a, b = int(rests.last[k]), int(rests.first[k + 1])
    around = _around(a, b)
    t = imu.t[a : b + 1]
    at = (t[:-1, None] + np.diff(t)[:, None] * POINTS).ravel()
    share = ((at - t[0]) / (t[-1] - t[0]))[:, None]
    value = CubicSpline(imu.t[around], np.hstack([imu.gyro, imu.accel])[around])(at)
    still = rests.reading[k : k + 2, :3]
    value[:, :3] -= (1.0 - share) * still[0] + share * still[1]
    warm = np.zeros_like(share)
    if rests.temperature is not None:
        warm = (1.0 - share) * rests.temperature[k] + share * rests.temperature[k + 1]
    return np.hstack([at[:, None], share, value, warm])


def turned(
    turns: Turns, effects: Sequence[Effect], x: Array, still: Array, bias: BoolArray
) -> tuple[Array, Array]:
    """The turns that the readings amount to if the parameters are x (k,), those of the gyro's
    bias where ``bias`` (k,) says so.

    still (r, 3, 1 + k): what the effects but the bias add to the gyro in each rest, and its
    derivatives: it is in what was read there, and was taken off with it. Returns C (q, 3, 3),
    which takes vectors in body axes after the turn to those before, and slope (q, 3, k): the
    rotation vector, in body axes after the turn, by which C grows with each parameter.
    """
    s, q = turns.signals, len(turns)
    number = np.repeat(np.arange(q), np.diff(turns.start))
    share = turns.share[:, None, None]
    off = (1.0 - share) * still[turns.before[number]] + share * still[turns.after[number]]
    read = replace(s, gyro=s.gyro + off[:, :, 0] + x[bias])
    truth, by = truth_of(effects, x, read)
    J = columns(effects, x, truth)
    J[:, :3, :] -= off[:, :, 1:]
    to_rate = np.linalg.solve(by.transpose(0, 2, 1), np.eye(6)[:, :3])
    J = -(to_rate.transpose(0, 2, 1) @ J)
    # what the gyro reads at rest holds the bias, so the turn does not depend on it
    J[:, :, bias] = 0.0
    C, slope = np.zeros((q, 3, 3)), np.zeros((q, 3, len(x)))
    for n in range(q):
        own = slice(turns.start[n], turns.start[n + 1])
        step = np.diff(s.t[own])[::2, None] / APART
        w = truth.gyro[own].reshape(-1, 2, 3)
        # Magnus's series to fourth order, for a rate that turns the body behind what was before
        angle = step * w.mean(axis=1) + APART / 4.0 * step**2 * np.cross(w[:, 0], w[:, 1])
        way = _chain(rotations(angle))
        middle = way[:-1] @ rotations(0.5 * angle)
        left = np.einsum("nji,jk->nik", middle, way[-1])
        each = step[:, :, None] * J[own].reshape(-1, 2, 3, len(x)).mean(axis=1)
        C[n], slope[n] = way[-1], np.einsum("nji,njk->ik", left, each)
    return C, slope


@njit
def _chain(steps: Array) -> Array:
    """Products (n + 1, 3, 3) of the first 0, 1, ... n of rotations steps (n, 3, 3)."""
    out = np.empty((len(steps) + 1, 3, 3))
    out[0] = np.eye(3)
    for i in range(len(steps)):
        matmul(out[i], steps[i], out[i + 1])
    return out
