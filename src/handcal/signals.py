"""What effects act on: the only place where ``Signals`` are made.

From a recording with whatever was taken off its readings, or from numbers, if the truth is
known or thought of. Further streams come along, so that an effect that needs one has it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from handcal.compiled import so3
from handcal.effects import ROOM, Effect, Signals
from handcal.recordings.streams import STREAMS, Stream
from handcal.types import Array, BoolArray, IntArray, Recording, Series


def of_recording(
    recording: Recording,
    effects: Sequence[Effect] = (),
    *,
    read: Array | None = None,
    C_nb: Array | None = None,
    alpha: Array | None = None,
) -> Signals:
    """Signals at the IMU's samples.

    read (n, 6): the readings without what is known of their errors (biases); None: as they are.
    effects: whose needs are to be met. C_nb (n, 3, 3), alpha (n, 3): see ``Signals``.
    """
    imu = recording.imu
    gyro, accel = (imu.gyro, imu.accel) if read is None else (read[:, :3], read[:, 3:])
    return Signals(
        imu.t, gyro, accel, C_nb=C_nb, alpha=alpha, streams=further(recording, effects),
        bias_temperature=recording.bias_temperature,
    )  # fmt: skip


def further(recording: Recording, effects: Sequence[Effect] = ()) -> Mapping[str, Array]:
    """Each stream (n, d) at the IMU's samples that no observation looks at or an effect needs."""
    needed = {need for e in effects for need in e.needs}
    return {
        name: at_times(STREAMS[name], series, recording.imu.t)
        for name, series in recording.streams.items()
        if name in needed or not STREAMS[name].observation
    }


def at_times(row: Stream, series: Series, t: Array) -> Array:
    """A stream at times t (n,), on a straight line between two readings; (n, d)."""
    value = np.unwrap(series.value, axis=0) if row.circular else series.value
    out = np.stack([np.interp(t, series.t, column) for column in value.T], axis=1)
    if row.posed:
        out[:, 3:] /= np.linalg.norm(out[:, 3:], axis=1, keepdims=True)
    return out


def temperature_of(recording: Recording) -> Array | None:
    """Temperature (n,) degC at the IMU's samples, None without a thermometer."""
    return _temperature_at(recording, recording.imu.t)


def at_its_temperature(recording: Recording) -> Recording:
    """The recording with its mean temperature as that at which biases are what they are."""
    series = recording.streams.get("temperature")
    if series is None or not len(series.t):
        return recording
    return replace(recording, bias_temperature=float(np.nanmean(series.value)))


def warmth_at(recording: Recording, t: Array) -> Array:
    """Temperature less ``ROOM`` (n,), K, at times t (n,); zero without a thermometer."""
    temperature = _temperature_at(recording, t)
    return np.zeros(len(t)) if temperature is None else temperature - ROOM


def _temperature_at(recording: Recording, t: Array) -> Array | None:
    series = recording.streams.get("temperature")
    return None if series is None else at_times(STREAMS["temperature"], series, t)[:, 0]


def of_arrays(t: Array, gyro: Array, accel: Array, temperature: Array | None = None) -> Signals:
    """Signals of a truth that is known: rate and force (n, 3) at times t (n,), and how warm."""
    streams = {} if temperature is None else {"temperature": temperature[:, None]}
    return Signals(t, gyro, accel, streams=streams)


def some(signals: Signals, rows: BoolArray | IntArray) -> Signals:
    """The signals at some of their samples."""
    s = signals
    return Signals(
        s.t[rows], s.gyro[rows], s.accel[rows],
        C_nb=None if s.C_nb is None else s.C_nb[rows],
        alpha=None if s.alpha is None else s.alpha[rows],
        streams={name: value[rows] for name, value in s.streams.items()},
        bias_temperature=s.bias_temperature,
    )  # fmt: skip


def reading(signals: Signals, read: Array) -> Signals:
    """The signals with other rates and forces, (n, 6)."""
    return replace(signals, gyro=read[:, :3], accel=read[:, 3:])


def units() -> Signals:
    """Six samples, in each of which one rate or one force is 1 and the others are 0."""
    one = np.eye(6)
    return Signals(np.zeros(6), one[:, :3], one[:, 3:])


def probe(n: int = 400) -> Signals:
    """A motion of which no two signals are alike, nor any made of others, n samples over 8 s: to
    see on which an effect depends. With all streams that there are."""
    t = np.linspace(0.0, 8.0, n)
    widths = [3, 3, 3, *(len(row.columns) for row in STREAMS.values())]
    # (square roots of primes have no common measure: three tones for each column)
    tones = np.sqrt(_primes(3 * sum(widths))).reshape(3, -1)
    tones *= 9.0 / tones.max()
    columns = np.sin(t[:, None, None] * tones + 2.4 * tones[::-1]).sum(axis=1)
    parts = np.split(columns, np.cumsum(widths)[:-1], axis=1)
    gyro, accel, turn = 1.5 * parts[0], 4.0 * parts[1], parts[2]
    streams = {name: 30.0 + 5.0 * x for name, x in zip(STREAMS, parts[3:], strict=True)}
    return Signals(t, gyro, accel, C_nb=so3.rotations(turn), streams=streams)


def _primes(count: int) -> Array:
    found: list[int] = []
    number = 2
    while len(found) < count:
        if all(number % p for p in found):
            found.append(number)
        number += 1
    return np.array(found, dtype=np.float64)
