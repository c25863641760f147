"""A recording fed at its own pace, for practice and tests."""

from __future__ import annotations

import shlex
import time
from collections.abc import Callable, Iterator

import numpy as np

from handcal.live.session import Batch, Session
from handcal.recordings.streams import STREAMS
from handcal.show.words import listed
from handcal.types import Array, IntArray, Recording

BATCH_S = 0.25
# Streams that a batch holds besides the IMU.
TAKEN = ("heading",)


def batches(recording: Recording, first: int = 0) -> Iterator[tuple[float, Batch]]:
    """When each batch is complete (s since the start), and the batch; from number ``first`` on."""
    imu = recording.imu
    ns = stamps(recording, imu.t)
    which = np.floor(imu.t / BATCH_S).astype(np.int64)
    series = recording.streams.get("heading")
    for seq in range(first, int(which[-1]) + 1):
        rows = which == seq
        heading = None
        if series is not None:
            own = np.floor(series.t / BATCH_S) == seq
            heading = (stamps(recording, series.t[own]), series.value[own])
        batch = Batch("file", seq, ns[rows], imu.gyro[rows], imu.accel[rows], heading)
        yield (seq + 1) * BATCH_S, batch


def left_out(recording: Recording) -> str:
    """A sentence on the streams that a session does not take; empty if there are none."""
    names = [STREAMS[name].title for name in recording.streams if name not in TAKEN]
    if not names:
        return ""
    return (
        f"Left out of this session: {listed(names)}. The page on a phone sends gyro and "
        "accelerometer alone, so this is what it could have told; `handcal explain "
        f"{shlex.quote(recording.path)}` uses all that was recorded."
    )


def stamps(recording: Recording, t: Array) -> IntArray:
    """Times t (n,) s of the recording as ns since 1970, or since its start if that is unknown."""
    return recording.start_ns + np.rint(t * 1e9).astype(np.int64)


def feed(
    recording: Recording,
    session: Session,
    speed: float,
    sleep: Callable[[float], None] = time.sleep,
) -> None:
    """All batches that the session does not have, ``speed`` times as fast as they were recorded;
    0: no waiting."""
    begin = session.clock() - (session.next * BATCH_S / speed if speed else 0.0)
    for at, batch in batches(recording, session.next):
        if speed:
            sleep(max(0.0, begin + at / speed - session.clock()))
        session.take(batch)
