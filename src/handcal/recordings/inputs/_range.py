"""Is a sensor at the end of its range for long? It piles up at one extreme reading, without the
noise that it has elsewhere, or while gravity turns further than a gyro says. A brief stay at a
usual full scale is ``_checks``' matter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from handcal.recordings.inputs._checks import RESTING_RATE, held, least_step, turned
from handcal.types import Array, BoolArray, IntArray

# Below it nothing is the end of an accelerometer's range, m/s^2: a quarter of the smallest made.
LEAST_FORCE = 4.0
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
# Readings that stay equal, five or more in a row: so many at the extreme, of so many elsewhere at
# most this part as often, are no coincidence; where the other axes change by so many of their
# steps meanwhile, the noise is too large for it too.
EQUAL, OTHERS, ELSEWHERE, STEPS = 20, 50, 0.05, 1.5


@dataclass(frozen=True)
class _Plateau:
    """An axis and a sense: the extreme reading that many samples share, and which (n,)."""

    axis: int
    sign: int
    extreme: float
    at: BoolArray


def at_range_end(t: Array, gyro: Array, accel: Array) -> tuple[list[str], BoolArray]:
    """Warnings where a sensor stays at the end of its range, and where that is (n,): what is read
    there is no measurement. t (n,) s; (n, 3) each, on these stamps, rad/s and m/s^2."""
    said, where = [], np.zeros(len(t), dtype=np.bool_)
    for name, value, least, unit in (
        ("gyroscope", gyro, RESTING_RATE, "rad/s"),
        ("accelerometer", accel, LEAST_FORCE, "m/s^2"),
    ):
        found = _plateaus(value, least)
        limits = [
            p.extreme for p in found
            if _alone(value, p, found) or (value is gyro and _missed(t, gyro, accel, p))
        ]  # fmt: skip
        ends = [p for p in found
                if any(abs(p.extreme - one) <= SAME_RANGE * one for one in limits)]  # fmt: skip
        if ends:
            own = np.any([p.at for p in ends], axis=0)
            axes = ", ".join(f"{'+' if p.sign > 0 else '-'}{'xyz'[p.axis]}" for p in ends)
            said.append(
                f"The {name} stays at {max(limits):.3g} {unit} (on {axes}) for "
                f"{100 * own.mean():.0f} % of the time: it was at the end of its measuring range "
                "(saturated). These readings count as missing; set a larger range, or move less."
            )
            where |= own
    return said, where


def _plateaus(value: Array, least: float) -> list[_Plateau]:
    """Where many samples share an extreme, and few come near. value (n, 3)."""
    out = []
    table, step = held(value), least_step(value)
    for k, column in enumerate(value.T):
        for sign in (1, -1):
            signed = sign * column
            extreme = float(signed.max())
            if extreme < least + 2.0 * step[k]:
                continue
            there = signed == extreme
            at = there & ~table
            count = int(at.sum())
            below = int((signed > 0.97 * extreme).sum() - there.sum())
            if count >= 5 and count > 2 * below and bool(np.any(at[1:] & at[:-1])):
                out.append(_Plateau(k, sign, extreme, at))
    return out


def _alone(value: Array, one: _Plateau, all_of: list[_Plateau]) -> bool:
    """Whether an axis of (n, 3) repeats its extreme alone, while the others show that the noise
    is larger than a step."""
    ends = np.any([p.at for p in all_of if p.axis == one.axis], axis=0)
    equal = held(value[:, [one.axis]])
    inside, elsewhere = equal & one.at, equal & ~ends
    if inside.sum() < EQUAL or (~ends).sum() < OTHERS or elsewhere.sum() > ELSEWHERE * inside.sum():
        return False
    step = least_step(value)
    for k in {0, 1, 2} - {one.axis}:
        free = inside & ~np.any([p.at for p in all_of if p.axis == k] or [inside & False], axis=0)
        pairs = free[1:] & free[:-1]
        changes = np.abs(np.diff(value[:, k]))[pairs]
        if len(changes) >= EQUAL and float(np.median(changes)) >= STEPS * step[k] > 0.0:
            return True
    return False


def _missed(t: Array, gyro: Array, accel: Array, one: _Plateau) -> bool:
    """Whether gravity turns about the axis further than is read in the stays at its extreme."""
    k, sign, at = one.axis, one.sign, one.at
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
