"""What a recording is, by numbers that need no model: rates, jitter, gaps, ranges, rests, turns."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from handcal.recordings.inputs._checks import rest_magnitude
from handcal.recordings.inputs._field import turns_with_imu
from handcal.recordings.inputs._turning import turning
from handcal.recordings.segment import Rest, each_rest
from handcal.types import Array, Recording

# A gap is a step of so many usual ones.
GAP = 5.0
# What turns more slowly is a hand that holds, or a bias, rad/s.
TURNING = math.radians(8.0)
SENSORS = ("gyro", "accel")


@dataclass(frozen=True)
class Stamps:
    """The stamps of one stream.

    readings: how many; rate_hz: by the median step; jitter_s: standard deviation of the steps
    that are no gaps; gaps: steps of over five usual ones; longest_s, at_s: the longest of them,
    and when it begins (0 without gaps); first_s, last_s: on the IMU's clock. topic: of a bag.
    """

    stream: str
    readings: int
    rate_hz: float
    jitter_s: float
    gaps: int
    longest_s: float
    at_s: float
    first_s: float
    last_s: float
    topic: str = ""


@dataclass(frozen=True)
class Turned:
    """How far the device turned about one of its axes while it did not rest, rad, each way, and
    the fastest rate, rad/s."""

    axis: str
    forward: float
    backward: float
    fastest: float


@dataclass(frozen=True)
class Overview:
    """A recording in numbers.

    largest: by channel of the IMU the largest size read, SI; saturated: samples that are not
    trusted because a sensor sat at its full scale, or by the file's own word. rests: as
    ``segment.each_rest`` finds them. gravity: size of the specific force where stillest, m/s^2.
    turning: median angles by which gravity is missed at the end of a window, as the gyro turns it
    and were there no turn, rad; empty where too little turns to tell. axes_told: whether that tells
    the gyro's axes; field_told: whether the magnetometer's are seen to be the IMU's.
    """

    recording: Recording
    streams: tuple[Stamps, ...]
    largest: Array
    saturated: int
    rests: tuple[Rest, ...]
    turns: tuple[Turned, ...]
    gravity: float
    turning: tuple[float, ...]
    axes_told: bool = False
    field_told: bool = False


def overview(recording: Recording) -> Overview:
    """The numbers of a recording."""
    imu = recording.imu
    found = tuple(each_rest(recording))
    gravity = rest_magnitude(imu.accel, recording.rate_hz)
    missed = turning(imu, gravity) if gravity > 0.0 else None
    streams = [_stamps("imu", imu.t)]
    streams += [_stamps(name, series.t) for name, series in recording.streams.items()]
    streams = [replace(s, topic=recording.topics.get(s.stream, "")) for s in streams]
    return Overview(
        recording,
        tuple(streams),
        np.abs(np.hstack([imu.gyro, imu.accel])).max(axis=0),
        int((~imu.valid).sum()),
        found,
        _turns(recording, found),
        gravity,
        () if missed is None else (missed.as_read, missed.still),
        missed is not None and missed.tells,
        turns_with_imu(recording),
    )


def _stamps(name: str, t: Array) -> Stamps:
    if len(t) < 2:
        return Stamps(name, len(t), 0.0, 0.0, 0, 0.0, 0.0, float(t[0]), float(t[0]))
    step = np.diff(t)
    usual = float(np.median(step))
    gap = step > GAP * usual
    at = int(np.argmax(step))
    longest, begins = (float(step[at]), float(t[at])) if gap.any() else (0.0, 0.0)
    return Stamps(
        name, len(t), 1.0 / usual, float(np.std(step[~gap])), int(gap.sum()), longest, begins,
        float(t[0]), float(t[-1]),
    )  # fmt: skip


def rate_at_rest(found: Sequence[Rest]) -> Array:
    """What the gyro reads at rest (3,), rad/s: the mean over the time at rest, else zero."""
    if not found:
        return np.zeros(3)
    return np.average([r.rate for r in found], axis=0, weights=[r.seconds for r in found])


def _turns(recording: Recording, found: Sequence[Rest]) -> tuple[Turned, ...]:
    imu = recording.imu
    rate = imu.gyro - rate_at_rest(found)
    moving = np.linalg.norm(rate, axis=1) > TURNING
    for r in found:
        moving[slice(*np.searchsorted(imu.t, [r.start, r.end]))] = False
    # (what it did in a gap is unknown)
    step = np.minimum(np.diff(imu.t, append=imu.t[-1]), GAP / recording.rate_hz)
    angle = rate * (step * moving)[:, None]
    return tuple(
        Turned(a, float(x[x > 0].sum()), float(-x[x < 0].sum()), float(np.abs(w).max()))
        for a, x, w in zip("xyz", angle.T, rate.T, strict=True)
    )
