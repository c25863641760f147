"""One session: numbered batches come in, are recorded once each, and acknowledged.

A batch is recorded before it is acknowledged. One that arrives again, because its acknowledgement
was lost, is acknowledged again and nothing else; one that arrives too early is refused with the
number that is due. Stamps are the sender's clock; when each batch arrived stands beside them.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from handcal.live.clocks import Clocks
from handcal.live.recorder import Recorder
from handcal.recordings.export import Pieces
from handcal.types import Array, BoolArray, HandcalError, Imu, IntArray, Recording, Series

SILENT_S = 10.0  # after which another page may take the session over
MOST_SAMPLES = 40_000_000  # more than a day at 400 Hz; 4 GB
# Of all streams in one batch: what unpacks to a quarter of what the recorder takes back.
MOST_ROWS = 20_000
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
    m/s^2; further: of other streams, by name, stamps (m,) ns and values (m, d) as in types.Series;
    note: what its source has to know after a restart, as JSON."""

    client: str
    seq: int
    ns: IntArray
    gyro: Array
    accel: Array
    further: Pieces = field(default_factory=dict)
    note: Mapping[str, Any] = field(default_factory=dict)


@dataclass
class Session:
    """What has arrived so far.

    clock: seconds, of any origin; wall_ns: this machine's time, which stands beside the stamps in
    the file and is never mixed with them; state: recording, working, done or failed; source: where
    readings come from; told: what is shown beside the counts; news: set when something came.
    """

    recorder: Recorder
    clock: Callable[[], float] = time.monotonic
    wall_ns: Callable[[], int] = time.time_ns
    clocks: Clocks = field(default_factory=Clocks)
    state: str = "recording"
    told: dict[str, Any] = field(default_factory=dict)
    source: str = "page"
    client: str = ""
    seen: float = -np.inf
    late: int = 0
    lock: threading.Lock = field(default_factory=threading.Lock)
    news: threading.Event = field(default_factory=threading.Event)

    @property
    def note(self) -> Mapping[str, Any]:
        """What the last batch's source wanted to know after a restart."""
        return self.recorder.note

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
        rows = len(batch.ns) + sum(len(ns) for ns, _ in batch.further.values())
        if rows > MOST_ROWS:
            raise Refused(413, f"A batch may have {MOST_ROWS} readings at most.")
        if self.recorder.samples + len(batch.ns) > MOST_SAMPLES:
            raise Refused(413, "The recording is full; stop it.")
        if last is not None and len(batch.ns) and batch.ns[-1] - last > LONGEST_GAP_NS:
            raise Refused(400, "The clock of the sender has jumped by more than an hour.")
        fresh = self._fresh("imu", batch.ns)
        further = {}
        for name, (ns, value) in batch.further.items():
            own = self._fresh(name, ns)
            further[name] = (ns[own], value[own])
        arrived = self.wall_ns()
        if fresh.any():
            self.clocks.heard(int(batch.ns[fresh][-1]), arrived)
        values = np.hstack([batch.gyro, batch.accel])[fresh]
        note = {"seq": batch.seq, "host_ns": arrived, **batch.note}
        self.recorder.add({"imu": (batch.ns[fresh], values), **further}, note)
        self.news.set()

    def _fresh(self, stream: str, ns: IntArray) -> BoolArray:
        """Which stamps (n,) are newer than all before them."""
        last = self.recorder.newest.get(stream, -1)
        highest = np.maximum.accumulate(np.r_[last, ns])[:-1]
        fresh: BoolArray = ns > highest
        self.late += int((~fresh).sum())
        return fresh

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
            "source": self.source,
            **self.told,
        }

    def since(self, ns: int) -> tuple[IntArray, Array]:
        """Stamps (n,) ns and readings (n, 6) of the IMU in batches that hold newer ones."""
        with self.lock:
            parts: list[tuple[IntArray, Array]] = []
            for piece in reversed(self.recorder.kept["imu"]):
                if piece[0][-1] <= ns:
                    break
                parts.insert(0, piece)
        if not parts:
            return np.zeros(0, dtype=np.int64), np.zeros((0, 6))
        return np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts])

    def piece(self, from_ns: int, origin_ns: int, to_ns: int | None = None) -> Recording | None:
        """What is in memory from the batch on in which from_ns lies (of streams that are read
        seldom, from a while before it), to to_ns; times are since origin_ns. None below two
        samples, and where from_ns is older than what is in memory."""
        with self.lock:
            streams = self.recorder.since(from_ns)
        ns, value = streams["imu"]
        if to_ns is not None:
            ns, value = ns[ns <= to_ns], value[ns <= to_ns]
        if len(ns) < 2:
            return None
        return recording_of(self.recorder.path, {**streams, "imu": (ns, value)}, origin_ns)

    def forget(self, before_ns: int) -> None:
        """Keep in memory only what is not older than that stamp."""
        with self.lock:
            self.recorder.forget(before_ns)

    def recording(self) -> Recording | None:
        """What the recorder keeps in memory (the last minutes), None below two samples."""
        with self.lock:
            streams = self.recorder.streams()
        return recording_of(self.recorder.path, streams)


def recording_of(
    path: Path, streams: Mapping[str, tuple[IntArray, Array]], origin_ns: int | None = None
) -> Recording | None:
    """A recording of stamps (n,) ns and values (n, d) by stream; None below two samples.
    origin_ns: of time zero, instead of the first sample's."""
    ns, value = streams["imu"]
    if len(ns) < 2:
        return None
    begin = int(ns[0]) if origin_ns is None else origin_ns
    t = (ns - begin) / 1e9
    gyro, accel = np.ascontiguousarray(value[:, :3]), np.ascontiguousarray(value[:, 3:])
    further = {
        name: Series((at - begin) / 1e9, v)
        for name, (at, v) in streams.items()
        if name != "imu" and len(at)
    }
    imu = Imu(t, gyro, accel, np.ones(len(t), dtype=np.bool_))
    return Recording(str(path), imu, further, begin)
