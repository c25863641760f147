"""Does a magnetometer count in the IMU's axes? While the device turns, the Earth's field, less the
iron on the device, moves in its axes as the gyro says."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from handcal.recordings.inputs._turning import GAP, SIGNED, Windows, named, turned
from handcal.types import Array, Recording, Series

# Looks at the field are so far apart, s, at the least; those are compared that are so many apart.
LOOK_S, APART = 0.15, (3, 8, 20)
# Pairs that are enough, and that are looked at; how far the device turns in most, rad.
FEWEST, MOST, TURNED = 20, 150, 0.3
# Of what the field changes, and of what is missed as read, other axes leave this part at the most;
# the next best ones leave this many times as much, or the motion does not tell them apart.
CLEARLY, APART_BY = 0.35, 1.7
# A field is downward or upward if it stands out so far from level (sine of the dip).
DIPS = 0.2
# Turns are about all axes if the least seen has this share of what the most seen has.
ROUND = 0.1


@dataclass(frozen=True)
class _Pairs:
    """k pairs of looks: the field (k, 3) at either, and the rotation (k, 3, 3) from the second to
    the first as the gyro has it."""

    before: Array
    after: Array
    R: Array
    up: Array


@dataclass(frozen=True)
class _Judged:
    """Median by which the field is missed, tesla: as_read, and least with axes P (3, 3); what it
    changes; told: whether no other axes do nearly as well."""

    as_read: float
    least: float
    changes: float
    P: Array
    told: bool


def turns_with_imu(recording: Recording) -> bool:
    """Whether the motion shows that the magnetometer's axes are the IMU's."""
    seen = _judged(recording)
    good = seen is not None and seen.told and seen.as_read < CLEARLY * seen.changes
    return good and seen is not None and seen.as_read == seen.least


def _judged(recording: Recording) -> _Judged | None:
    """Of all axes that a magnetometer may have; None where the device turns too little."""
    pairs = _pairs(recording)
    if pairs is None:
        return None
    # (the negative of any explains a turn as well: the field's sense is the hemisphere's)
    proper = [P for P in SIGNED if np.linalg.det(P) > 0]
    left = sorted(((*_missed(pairs, P), P) for P in proper), key=lambda r: r[0])
    as_read, _ = _missed(pairs, np.eye(3))
    least, iron, P = left[0]
    changes = float(np.median(np.linalg.norm(pairs.after - pairs.before, axis=1)))
    told = bool(left[1][0] > APART_BY * least)
    return _Judged(as_read, least, changes, _with_its_sign(pairs, P, iron), told)


def with_axes_of_imu(
    recording: Recording, stated: bool, gyro_told: Callable[[], bool]
) -> Recording:
    """The recording with its magnetometer turned to the IMU's axes, and that said, or left out
    where they are others that the motion does not tell. stated: nothing is changed, but said;
    gyro_told: whether gravity tells the gyro's axes, without which either may be wrong."""
    seen = _judged(recording)
    if seen is None or seen.least > CLEARLY * min(seen.as_read, seen.changes):
        return recording
    streams = dict(recording.streams)
    if not (seen.told and gyro_told()):
        text = (
            "The magnetometer does not turn as the gyroscope says, and this motion does not tell "
            "in which axes either counts. "
        )
        text += (
            "It is used as stated."
            if stated
            else "It was left out; give --axes mag=... or gyro=..."
        )
        if not stated:
            del streams["mag"]
        return replace(recording, streams=streams, warnings=(*recording.warnings, text))
    P = seen.P
    axes, own = named(P), named(P.T)
    text = (
        f"The magnetometer's axes are ({', '.join(own)}) of the IMU's: with its "
        f"{', '.join(axes)} in the place of its x, y, z it turns as the gyroscope says. "
    )
    if stated:
        text += "It is used as stated."
    else:
        text += (
            f"It was turned so, as --axes mag={','.join(axes)} does; south of the magnetic "
            f"equator it may be the negative of that, --axes mag={','.join(named(-P))}."
        )
        mag = streams["mag"]
        streams["mag"] = Series(mag.t, np.ascontiguousarray(mag.value @ P.T))
    return replace(recording, streams=streams, warnings=(*recording.warnings, text))


def _with_its_sign(pairs: _Pairs, P: Array, iron: Array) -> Array:
    """Of P and -P the one with the field downwards, as north of the equator; where it is level, or
    turns about one axis do not tell it from iron, the fewest changes."""
    field = pairs.before @ P.T - iron
    dip = np.median(np.sum(field * pairs.up, axis=1) / np.linalg.norm(field, axis=1))
    J = np.eye(3) - pairs.R
    least, _, most = np.linalg.eigvalsh(np.einsum("kij,kil->jl", J, J))
    if least > ROUND * most and abs(dip) > DIPS:
        return -P if dip > 0.0 else P
    return max((P, -P), key=np.trace)


def _missed(pairs: _Pairs, P: Array) -> tuple[float, Array]:
    """Median by which the field in these axes is missed, tesla, and the iron (3,) that suits them:
    P m - iron turns with the device."""
    r = pairs.before @ P.T - (pairs.R @ (pairs.after @ P.T)[..., None])[..., 0]
    J, weight = np.eye(3) - pairs.R, np.ones(len(r))
    iron = np.zeros(3)
    for _ in range(6):
        A = np.einsum("k,kij,kil->jl", weight, J, J) + 1e-6 * np.eye(3)
        iron = np.linalg.solve(A, np.einsum("k,kij,ki->j", weight, J, r))
        size = np.linalg.norm(r - J @ iron, axis=1)
        weight = 1.0 / np.maximum(size, 0.3 * float(np.median(size)) + 1e-12)
    return float(np.median(size)), iron


def _pairs(recording: Recording) -> _Pairs | None:
    """Pairs of looks between which the device turns; None without enough of them."""
    mag = recording.streams.get("mag")
    if mag is None or len(mag.t) < FEWEST:
        return None
    imu, step = recording.imu, 1.0 / recording.rate_hz
    every = max(1, round(LOOK_S / float(np.median(np.diff(mag.t)))))
    at = np.arange(0, len(mag.t), every)
    index = np.searchsorted(imu.t, mag.t[at]).clip(0, len(imu.t) - 1)
    holes = np.concatenate([[0], np.cumsum((np.diff(imu.t) > GAP * step) | ~imu.valid[1:])])
    path = np.concatenate([[0.0], np.cumsum(np.linalg.norm(imu.gyro[1:], axis=1) * np.diff(imu.t))])
    pairs = np.array([(i, i + k) for k in APART for i in range(len(at) - k)]).reshape(-1, 2)
    first, last = index[pairs[:, 0]], index[pairs[:, 1]]
    good = (holes[first] == holes[last]) & (path[last] - path[first] > TURNED)
    pairs, first, last = pairs[good], first[good], last[good]
    if len(pairs) < FEWEST:
        return None
    some = np.unique(np.linspace(0, len(pairs) - 1, MOST).astype(np.int64))
    pairs, first, last = pairs[some], first[some], last[some]
    group = max(1, round(0.01 / step))
    grid = first[:, None] + group * np.arange(int((last - first).max() // group) + 1)
    inside = grid < last[:, None]
    ends = np.minimum(grid + group, last[:, None])
    summed = np.vstack([np.zeros(3), np.cumsum(
        0.5 * (imu.gyro[1:] + imu.gyro[:-1]) * np.diff(imu.t)[:, None], axis=0)])  # fmt: skip
    grid = np.minimum(grid, last[:, None])
    dt = np.where(inside, imu.t[ends] - imu.t[grid], 0.0)
    rate = (summed[ends] - summed[grid]) / np.maximum(dt, 1e-9)[..., None]
    none = np.zeros((len(pairs), 3))
    w = Windows(none, none, np.ones(len(pairs)), rate, dt, none[:, None])
    R, _ = turned(w, np.eye(3), np.zeros(3))
    up = imu.accel[first] / np.linalg.norm(imu.accel[first], axis=1, keepdims=True)
    value = mag.value[at]
    return _Pairs(value[pairs[:, 0]], value[pairs[:, 1]], R, up)
