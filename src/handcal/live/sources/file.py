"""A recording fed at its own pace, for practice and tests."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import numpy as np

from handcal.live.session import Batch, Session
from handcal.types import Array, IntArray, Recording

BATCH_S = 0.25


def batches(recording: Recording, first: int = 0) -> Iterator[tuple[float, Batch]]:
    """When each batch is complete (s since the start), and the batch; from number ``first`` on."""
    imu = recording.imu
    number = int(np.floor(imu.t[-1] / BATCH_S)) + 1
    edges = np.arange(number + 1) * BATCH_S
    imu_ns, at = stamps(recording, imu.t), np.searchsorted(imu.t, edges)
    others = {
        name: (stamps(recording, s.t), s.value, np.searchsorted(s.t, edges))
        for name, s in recording.streams.items()
    }
    for seq in range(first, number):
        rows = slice(at[seq], at[seq + 1])
        further = {
            name: (ns[edge[seq] : edge[seq + 1]], value[edge[seq] : edge[seq + 1]])
            for name, (ns, value, edge) in others.items()
            if edge[seq + 1] > edge[seq]
        }
        yield (
            edges[seq + 1],
            Batch("file", seq, imu_ns[rows], imu.gyro[rows], imu.accel[rows], further),
        )


def stamps(recording: Recording, t: Array) -> IntArray:
    """Times t (n,) s of the recording as ns since 1970, or since its start if that is unknown."""
    return recording.start_ns + np.rint(t * 1e9).astype(np.int64)


def feed(
    recording: Recording,
    session: Session,
    speed: float,
    sleep: Callable[[float], None] = time.sleep,
    tick: Callable[[], bool] = lambda: False,
) -> bool:
    """All batches that the session does not have, ``speed`` times as fast as they were recorded;
    0: no waiting. tick: called after each; it says when it is enough, which is then returned."""
    begin = session.clock() - (session.next * BATCH_S / speed if speed else 0.0)
    for at, batch in batches(recording, session.next):
        if speed:
            sleep(max(0.0, begin + at / speed - session.clock()))
        session.take(batch)
        if tick():
            return True
    return False
