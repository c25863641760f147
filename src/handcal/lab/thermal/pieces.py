"""Stretches of rests, or of steady turns, in which the temperature hardly changes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from handcal.lab.sound import refuse_dead
from handcal.lab.stretches import PERFECT, Means, means, noise_power
from handcal.observations.known_input import axes_between
from handcal.recordings import segment
from handcal.types import Array, HandcalError, InputError, IntArray, Recording

# A rest is cut so that within a piece the temperature changes by this part of the whole.
FINE = 1.0 / 40.0
SHORTEST_S = 1.5


@dataclass(frozen=True)
class Pieces:
    """n stretches of rests (or steady turns): T (n,) degC, slope (n,) K/s, t (n,) s, reading and
    variance (n, 6), rest (n,) which they belong to; known (n, 6): rate and force by the
    reference, in the IMU's axes, or None; file (n,)."""

    T: Array
    slope: Array
    t: Array
    reading: Array
    variance: Array
    rest: IntArray
    known: Array | None
    file: IntArray

    def __len__(self) -> int:
        return len(self.T)


def pieces_of(recording: Recording, number: int) -> Pieces:
    """Of one recording, the number-th. Errors: InputError without temperature, HandcalError
    without rests."""
    series = recording.streams.get("temperature")
    if series is None:
        raise InputError(
            f"{recording.path} has no temperature: a stream /temperature (degC) is needed."
        )
    refuse_dead(recording)
    reference = recording.streams.get("reference")
    stretches = segment.rests(recording) if reference is None else segment.steady(recording)
    span = float(series.value.max() - series.value.min())
    spans, rest = [], []
    for i, (a, b) in enumerate(stretches):
        inside = (series.t >= a) & (series.t <= b)
        moved = float(np.ptp(series.value[inside])) if inside.sum() > 1 else 0.0
        parts = max(1, round(moved / max(FINE * span, 1e-9)))
        parts = min(parts, max(1, int((b - a) / SHORTEST_S)))
        edges = np.linspace(a, b, parts + 1)
        spans += list(pairwise(edges))
        rest += [i] * parts
    if not spans:
        raise HandcalError(f"{recording.path}: the device never rests.")
    found = means(recording, np.array(spans))
    t = found.span.mean(axis=1)
    T = found.temperature
    assert T is not None
    ends = np.interp(found.span.ravel(), series.t, series.value[:, 0]).reshape(-1, 2)
    slope = np.diff(ends, axis=1)[:, 0] / np.maximum(np.diff(found.span, axis=1)[:, 0], 1e-9)
    known, noise = None, found.variance
    if reference is not None:
        known, noise = _known(recording, found)
    # within a rest all pieces and axes of a sensor count alike
    of = np.array(rest)
    variance = np.empty_like(noise)
    for r in np.unique(of):
        for own in (slice(0, 3), slice(3, 6)):
            variance[of == r, own] = noise[of == r, own].mean()
    where = np.full(len(t), number, dtype=np.int64)
    return Pieces(T, slope, t, found.reading, variance, of, known, where)


def _known(recording: Recording, found: Means) -> tuple[Array, Array]:
    """Mean rate and force (n, 6) by the reference, in the IMU's axes, and variance (n, 6) of the
    readings beside them: a turn carries gravity around, which is no noise."""
    imu, reference = recording.imu, recording.streams["reference"]
    at = np.stack([np.interp(imu.t, reference.t, c) for c in reference.value.T], axis=1)
    rows = [np.arange(a, b + 1) for a, b in zip(found.first, found.last, strict=True)]
    rows = [r[imu.valid[r]] for r in rows]
    R = axes_between(found.reading, np.array([at[r].mean(axis=0) for r in rows]))
    at = np.hstack([at[:, :3] @ R.T, at[:, 3:] @ R.T])
    read = np.hstack([imu.gyro, imu.accel])
    power, count = noise_power([(read - at)[r] for r in rows])
    return np.array([at[r].mean(axis=0) for r in rows]), power / count[:, None] + PERFECT**2


def joined(parts: Sequence[Pieces]) -> Pieces:
    """Those of several recordings. Errors: InputError where only some have a reference."""
    if not parts:
        raise InputError("No recording is given.")
    known = [p.known for p in parts if p.known is not None]
    if known and len(known) < len(parts):
        raise InputError("Some of the recordings have a /reference and some have none.")
    first = np.cumsum([0, *(int(p.rest.max()) + 1 for p in parts)])

    def all_of(name: str) -> Array:
        return np.concatenate([getattr(p, name) for p in parts])

    return Pieces(
        all_of("T"), all_of("slope"), all_of("t"), all_of("reading"), all_of("variance"),
        np.concatenate([p.rest + n for p, n in zip(parts, first, strict=False)]),
        np.concatenate(known) if known else None,
        np.concatenate([p.file for p in parts]),
    )  # fmt: skip
