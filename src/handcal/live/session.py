"""One session: numbered batches come in, are recorded once each, and acknowledged.

A batch is recorded before it is acknowledged. One that arrives again, because its acknowledgement
was lost, is acknowledged again and nothing else; one that arrives too early is refused with the
number that is due. Stamps are the sender's clock; the arrivals only say whether it is still there.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from handcal.live.recorder import Recorder
from handcal.types import Array, HandcalError, Imu, IntArray, Recording, Series

SILENT_S = 10.0  # after which another page may take the session over
MOST_SAMPLES = 2_000_000  # five hours at 100 Hz
LONGEST_GAP_NS = 3600 * 1_000_000_000
RECENT = 200


class Refused(HandcalError):
    """A sentence for the sender, and the HTTP status that says the same."""

    def __init__(self, status: int, sentence: str) -> None:
        super().__init__(sentence)
        self.status = status


@dataclass(frozen=True)
class Batch:
    """What arrives at once: client and number; ns (n,) stamps, gyro (n, 3) rad/s, accel (n, 3)
    m/s^2; heading: stamps (m,) ns and yaw (m, 1) rad."""

    client: str
    seq: int
    ns: IntArray
    gyro: Array
    accel: Array
    heading: tuple[IntArray, Array] | None = None


@dataclass
class Session:
    """What has arrived so far. ``clock``: seconds, of any origin; ``state``: recording, working,
    done or failed; ``told``: what is shown beside the counts."""

    recorder: Recorder
    clock: Callable[[], float] = time.monotonic
    state: str = "recording"
    told: dict[str, Any] = field(default_factory=dict)
    client: str = ""
    seen: float = -np.inf
    late: int = 0
    lock: threading.Lock = field(default_factory=threading.Lock)

    @property
    def next(self) -> int:
        """The number of the batch that is due."""
        return self.recorder.next

    def hello(self, client: str) -> None:
        """A sender begins, or takes over from one that fell silent. Errors: Refused."""
        with self.lock:
            self._claim(client)

    def take(self, batch: Batch) -> bool:
        """Record a batch; False where it had been recorded. Errors: Refused."""
        with self.lock:
            self._claim(batch.client)
            if self.state != "recording":
                raise Refused(409, "The recording has ended.")
            if batch.seq < self.next:
                return False
            if batch.seq > self.next:
                raise Refused(409, f"Batch {self.next} is due, not {batch.seq}.")
            self._record(batch)
            return True

    def _claim(self, client: str) -> None:
        now = self.clock()
        if self.client and client != self.client and now - self.seen < SILENT_S:
            raise Refused(409, "Another page is recording; close it, and try again in 10 seconds.")
        self.client, self.seen = client, now

    def _record(self, batch: Batch) -> None:
        last = self.recorder.last_ns
        if self.recorder.samples + len(batch.ns) > MOST_SAMPLES:
            raise Refused(413, "The recording is full; stop it.")
        if last is not None and len(batch.ns) and batch.ns[-1] - last > LONGEST_GAP_NS:
            raise Refused(400, "The clock of the sender has jumped by more than an hour.")
        highest = np.maximum.accumulate(np.r_[-1 if last is None else last, batch.ns])[:-1]
        fresh = batch.ns > highest
        self.late += int((~fresh).sum())
        self.recorder.add(
            batch.ns[fresh], np.hstack([batch.gyro, batch.accel])[fresh], batch.heading, batch.seq
        )

    def status(self) -> Mapping[str, Any]:
        """What the page is answered."""
        ns = self.recorder.recent(RECENT)
        steps = np.diff(ns)
        return {
            "next": self.next,
            "state": self.state,
            "samples": self.recorder.samples,
            "seconds": round(self.recorder.seconds, 2),
            "rate_hz": round(1e9 / float(np.median(steps)), 1) if len(steps) else None,
            "late": self.late,
            **self.told,
        }

    def recording(self) -> Recording | None:
        """All there is so far, None below two samples."""
        with self.lock:
            streams = self.recorder.streams()
        return recording_of(self.recorder.path, streams)


def recording_of(path: Path, streams: Mapping[str, tuple[IntArray, Array]]) -> Recording | None:
    """A recording of stamps (n,) ns and values (n, d) by stream; None below two samples."""
    ns, value = streams["imu"]
    if len(ns) < 2:
        return None
    t = (ns - ns[0]) / 1e9
    gyro, accel = np.ascontiguousarray(value[:, :3]), np.ascontiguousarray(value[:, 3:])
    further = {
        name: Series((at - ns[0]) / 1e9, v)
        for name, (at, v) in streams.items()
        if name != "imu" and len(at)
    }
    imu = Imu(t, gyro, accel, np.ones(len(t), dtype=np.bool_))
    return Recording(str(path), imu, further, int(ns[0]))
