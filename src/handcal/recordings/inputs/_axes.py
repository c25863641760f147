"""Do gyro, accelerometer and heading count in the same axes? While something turns, gravity moves
in its axes as the gyro says, and the heading goes with the turn about the vertical. With two axes
exchanged or one of them reversed they do not, and nothing can be calibrated with such readings."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import permutations, product

import numpy as np

from handcal.recordings.inputs._checks import between, calm_windows, turned_by
from handcal.types import Array, InputError, IntArray

# Median by which gravity's direction is missed, rad: less is a hand's own acceleration. And the
# part of it that other axes may leave at the most before they are believed.
MISSED, CLEARLY = 0.15, 0.25
# Axes that leave as little (a turn about one does not tell the other two): the fewest changes are
# meant.
AS_GOOD = 1.25
FEWEST, MOST = 20, 200  # windows; of fewer, one push may decide, and of more no more is learnt
# Of a heading: how long it turns between two looks, s; and the share of gravity that has to stand
# across body x, or its yaw turns faster than the device.
HEADING_S, LEVEL = 0.5, 0.5
# Windows in which it should have turned so far, rad; a compass that swings turns by less.
TURNED = 0.2


def check_axes(t: Array, gyro: Array, accel: Array) -> None:
    """t (n,) s, gyro and accel (n, 3), rad/s and m/s^2. Errors: InputError where the gyro explains
    far better with other axes how gravity turns."""
    starts, size, u0, u1 = calm_windows(t, gyro, accel)
    if len(starts) < FEWEST:
        return
    some = np.unique(np.linspace(0, len(starts) - 1, MOST).astype(np.int64))
    starts, u0, u1 = starts[some], u0[some], u1[some]
    as_read = between(turned_by(t, gyro, starts, size, u0), u1)
    # (where gravity stays, any turn about it would fit)
    if as_read < MISSED or between(u0, u1) < MISSED:
        return
    left = [(P, _left(P, turns, u0, u1)) for P, turns in _other_axes(t, gyro, starts, size)]
    least = min(angle for _, angle in left)
    if least > CLEARLY * as_read:
        return
    ways = [way for P, angle in left if angle <= AS_GOOD * least for way in _changes(P)]
    sensor, A = max(ways, key=lambda way: float(np.trace(way[1])))
    axes = ", ".join(f"{'-' if row.sum() < 0 else ''}{'xyz'[int(abs(row).argmax())]}" for row in A)
    raise InputError(
        f"Gravity does not turn as the gyroscope says ({np.degrees(as_read):.0f} deg off after "
        f"0.4 s); with the {sensor}'s {axes} in the place of its x, y, z it does "
        f"({np.degrees(least):.1f} deg): the two sensors' axes are not the same. Exchange or "
        "reverse them in the file."
    )


def _other_axes(
    t: Array, gyro: Array, starts: IntArray, size: int
) -> Iterator[tuple[Array, Array]]:
    """Each of the 48 ways P (3, 3) to take a gyro's axes, and how the windows turn with it or, of a
    mirroring one, with its negative: (k, 3, 3), from first to last axes, in the gyro's own."""
    turns = {
        sign: np.stack([turned_by(t, sign * gyro, starts, size, np.tile(e, (len(starts), 1)))
                        for e in np.eye(3)], axis=2)
        for sign in (1, -1)
    }  # fmt: skip
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        P = np.diag(signs) @ np.eye(3)[list(order)]
        yield P, turns[1 if np.linalg.det(P) > 0 else -1]


def _left(P: Array, turns: Array, u0: Array, u1: Array) -> float:
    """Median angle, rad, between gravity u1 (k, 3) and u0 as the gyro turns it in these axes."""
    return between((turns @ (u0 @ P)[..., None])[..., 0] @ P.T, u1)


def _changes(P: Array) -> list[tuple[str, Array]]:
    """What makes the two agree: the gyro's axes, or the accelerometer's, whose sign as a whole no
    turn tells."""
    ways = [("gyroscope", P)]
    if np.linalg.det(P) > 0:
        ways += [("accelerometer", s * P.T) for s in (1.0, -1.0)]
    return ways


def check_heading_sense(t: Array, gyro: Array, accel: Array, when: Array, heading: Array) -> None:
    """heading (m,), rad, at when (m,), s, on the clock of t (n,). Errors: InputError where it turns
    the other way than the gyro about the vertical."""
    inside = (when >= t[0]) & (when <= t[-1]) & (np.abs(heading) < 1e7)
    first = np.flatnonzero(np.diff(np.floor(when[inside] / HEADING_S), prepend=-1.0))
    at, psi = when[inside][first], heading[inside][first]
    if len(at) < FEWEST:
        return
    up = accel / np.maximum(np.linalg.norm(accel, axis=1, keepdims=True), 1e-9)
    across = 1.0 - up[:, 0] ** 2
    rate = (gyro[:, 1] * up[:, 1] + gyro[:, 2] * up[:, 2]) / np.maximum(across, LEVEL**2)
    whole = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(t))])
    steep = np.concatenate([[0.0], np.cumsum((across[1:] < LEVEL**2) * np.diff(t))])
    own = np.diff(np.interp(at, t, whole))
    fair = (np.diff(np.interp(at, t, steep)) == 0) & (np.abs(own) > TURNED) & (np.diff(at) < 1.0)
    if fair.sum() < FEWEST:
        return
    as_read, reversed_ = (
        float(np.median(np.abs(np.angle(np.exp(1j * (s * np.diff(psi) - own)))[fair])))
        for s in (1.0, -1.0)
    )
    if as_read > MISSED and reversed_ < CLEARLY * as_read:
        raise InputError(
            f"The heading turns against the gyroscope ({np.degrees(as_read):.0f} deg off after "
            f"{HEADING_S:g} s; with its sign turned {np.degrees(reversed_):.1f}): it counts "
            "clockwise, as a compass does, and here counter-clockwise is meant. Turn its sign in "
            "the file; of a table give --units heading=deg-cw or rad-cw."
        )
