"""Is a gyro at the end of its range for long? It piles up at one extreme reading, and gravity
turns further meanwhile than it says. A brief stay at a usual full scale is ``_checks``' matter."""

from __future__ import annotations

import numpy as np

from handcal.recordings.inputs._checks import RESTING_RATE, held, least_step, turned
from handcal.types import Array, BoolArray, IntArray

# A stay that is long enough for gravity to show a missed turn, and how much of one is looked at, s.
SHORTEST_S, LONGEST_S = 0.2, 2.0
# So many stays of an axis and a sense, the longest: a hand repeats its turns.
STAYS = 20
# What gravity turns beyond the reading, rad and of what is read, before the reading is doubted: a
# hand's own acceleration tilts a reading by some hundredths, and no scale error is so large.
MISSED, MISSED_SHARE = 0.05, 0.05
# Of gravity, what stands across the axis: with less, a turn about it does not show.
ACROSS = 0.5
# The ends of one sensor's range are equal but for its bias and its scale error.
SAME_RANGE = 0.03


def at_range_end(t: Array, gyro: Array, accel: Array) -> tuple[list[str], BoolArray]:
    """A warning where the gyro stays at the end of its range while gravity turns further, and
    where that is (n,): what is read there is no measurement. t (n,) s; (n, 3) each, on these
    stamps, rad/s and m/s^2."""
    found = _plateaus(gyro)
    limits = [
        extreme for (k, sign), (extreme, at) in found.items()
        if _missed(t, gyro, accel, at, k, sign)
    ]  # fmt: skip
    where = np.zeros(len(t), dtype=np.bool_)
    axes: list[str] = []
    for (k, sign), (extreme, at) in found.items():
        if any(abs(extreme - one) <= SAME_RANGE * one for one in limits):
            where |= at
            axes.append(f"{'+' if sign > 0 else '-'}{'xyz'[k]}")
    if not axes:
        return [], where
    share = float(where.mean())
    said = (
        f"The gyroscope stays at {max(limits):.3g} rad/s (on {', '.join(axes)}) for "
        f"{100 * share:.0f} % of the time while gravity turns further: it was at the end of its "
        "measuring range (saturated). These readings count as missing; turn more slowly, or set "
        "a larger range."
    )
    return [said], where


def _plateaus(gyro: Array) -> dict[tuple[int, int], tuple[float, BoolArray]]:
    """By axis and sense: the extreme reading that many samples share, and few come near, and
    which they are (n,). gyro (n, 3)."""
    out: dict[tuple[int, int], tuple[float, BoolArray]] = {}
    table, step = held(gyro), least_step(gyro)
    for k, column in enumerate(gyro.T):
        for sign in (1, -1):
            signed = sign * column
            extreme = float(signed.max())
            if extreme < RESTING_RATE + 2.0 * step[k]:
                continue
            at = (signed == extreme) & ~table
            count = int(at.sum())
            below = int((signed > 0.97 * extreme).sum()) - int((signed == extreme).sum())
            if count >= 5 and count > 2 * below and bool(np.any(at[1:] & at[:-1])):
                out[k, sign] = extreme, at
    return out


def _missed(t: Array, gyro: Array, accel: Array, at: BoolArray, k: int, sign: int) -> bool:
    """Whether gravity turns about axis k further than is read in the stays ``at`` (n,)."""
    edges = np.flatnonzero(np.diff(at.astype(np.int8), prepend=0, append=0))
    a, b = edges[::2], edges[1::2] - 1
    b = np.minimum(b, np.searchsorted(t, t[a] + LONGEST_S, side="right") - 1)
    a, b = (x[t[b] - t[a] >= SHORTEST_S] for x in (a, b))
    longest = np.argsort(-(t[b] - t[a]), kind="stable")[:STAYS]
    a, b = a[longest], b[longest]
    if not len(a):
        return False
    half = max(1, round(0.04 / float(np.median(np.diff(t)))))
    first, last = (_up(accel, x, half) for x in (a, b))
    seen = first
    for i in range(int((b - a).max())):
        row = np.minimum(a + i, b - 1)
        angle = 0.5 * (gyro[row] + gyro[row + 1]) * (t[row + 1] - t[row])[:, None]
        seen = turned(seen, angle * (a + i < b)[:, None])
    p, q = np.delete(seen, k, axis=1), np.delete(last, k, axis=1)
    shown = (np.linalg.norm(p, axis=1) > ACROSS) & (np.linalg.norm(q, axis=1) > ACROSS)
    if not shown.any():
        return False
    about = -np.cross(seen, last)[:, k]
    more = sign * np.arctan2(about, np.sum(p * q, axis=1))[shown]
    read = np.abs(gyro[a, k] * (t[b] - t[a]))[shown]
    return bool(np.median(more) > MISSED and np.median(more - MISSED_SHARE * read) > 0.0)


def _up(accel: Array, at: IntArray, half: int) -> Array:
    """Mean direction of gravity (k, 3) over so many samples on either side of each."""
    sums = np.vstack([np.zeros(3), np.cumsum(accel, axis=0)])
    force = sums[np.minimum(at + half + 1, len(accel))] - sums[np.maximum(at - half, 0)]
    return np.asarray(force / np.maximum(np.linalg.norm(force, axis=1, keepdims=True), 1e-9))
