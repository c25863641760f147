"""What a session records: in the file before it is acknowledged, and its last minutes in memory.

A file that a killed process left is gone on with: its last note says which batch is due.
"""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from handcal.recordings import append
from handcal.recordings.export import Pieces
from handcal.recordings.streams import STREAMS
from handcal.types import Array, InputError, IntArray

SYNC_S = 1.0  # so much at most is lost where the whole machine dies
# In memory, for the estimates on the way, whatever else: at 400 Hz some 10 MB.
LONGEST_NS = 300 * 1_000_000_000

# Thermometers speak once in some seconds: so far back a piece of the recording has their readings.
SELDOM_NS = 30 * 1_000_000_000

Stream = deque[tuple[IntArray, Array]]


@dataclass
class Recorder:
    """An open recording. next: number of the batch that is due; first_ns, last_ns: stamps of the
    first and the last sample, None before there is one; newest: by stream; kept: in memory."""

    path: Path
    growing: append.Growing
    next: int = 0
    samples: int = 0
    first_ns: int | None = None
    newest: dict[str, int] = field(default_factory=dict)
    kept: dict[str, Stream] = field(default_factory=lambda: {n: deque() for n in append.IDS})
    note: Mapping[str, Any] = field(default_factory=dict)
    synced: float = 0.0

    def add(self, pieces: Pieces, note: Mapping[str, Any]) -> None:
        """Write one batch, and only then count it: by stream stamps (n,) ns and values (n, d);
        the note has its number, "seq"."""
        append.append(self.growing, pieces, note)
        if time.monotonic() - self.synced > SYNC_S:
            os.fsync(self.growing.file.fileno())
            self.synced = time.monotonic()
        self.next, self.note = int(note["seq"]) + 1, note
        for name, piece in pieces.items():
            self._keep(name, piece)

    def _keep(self, name: str, piece: tuple[IntArray, Array]) -> None:
        ns = piece[0]
        if not len(ns):
            return
        self.kept[name].append(piece)
        self.newest[name] = int(ns[-1])
        if name == "imu":
            self.samples += len(ns)
            self.first_ns = int(ns[0]) if self.first_ns is None else self.first_ns
            self.forget(int(ns[-1]) - LONGEST_NS)

    def forget(self, before_ns: int) -> None:
        """Keep in memory only what came at that stamp or later (pieces as a whole)."""
        for stream in self.kept.values():
            while stream and stream[0][0][-1] < before_ns:
                stream.popleft()

    @property
    def last_ns(self) -> int | None:
        """Stamp of the last sample of the IMU."""
        return self.newest.get("imu")

    @property
    def seconds(self) -> float:
        """How long it is."""
        if self.first_ns is None or self.last_ns is None:
            return 0.0
        return (self.last_ns - self.first_ns) / 1e9

    def recent(self, n: int) -> IntArray:
        """Stamps of at least the last n samples, fewer if there are not so many."""
        parts: list[IntArray] = []
        for ns, _ in reversed(self.kept["imu"]):
            parts.insert(0, ns)
            if sum(map(len, parts)) >= n:
                break
        return np.concatenate(parts) if parts else np.zeros(0, dtype=np.int64)

    def streams(self) -> dict[str, tuple[IntArray, Array]]:
        """Stamps (n,) ns and values (n, d) that are in memory, by stream."""
        return {n: _joined(n, parts) for n, parts in self.kept.items() if parts or n == "imu"}

    def since(self, ns: int) -> dict[str, tuple[IntArray, Array]]:
        """As ``streams``, in batches that hold stamps of ns or later; of others than the IMU from
        SELDOM_NS before it on."""
        out = {}
        for name, parts in self.kept.items():
            from_ns, some = ns if name == "imu" else ns - SELDOM_NS, []
            for piece in reversed(parts):
                if piece[0][-1] < from_ns:
                    break
                some.append(piece)
            if some or name == "imu":
                out[name] = _joined(name, some[::-1])
        return out

    def close(self) -> None:
        """No more comes."""
        os.fsync(self.growing.file.fileno())
        self.growing.file.close()


def _joined(name: str, parts: Iterable[tuple[IntArray, Array]]) -> tuple[IntArray, Array]:
    """Stamps (n,) ns and values (n, d) of pieces of one stream."""
    parts = list(parts)
    return (
        np.concatenate([np.zeros(0, dtype=np.int64), *(ns for ns, _ in parts)]),
        np.concatenate([np.zeros((0, len(STREAMS[name].columns))), *(v for _, v in parts)]),
    )


def opened(path: Path) -> Recorder:
    """A new recording, or one that was broken off. Errors: InputError where it has ended."""
    if not path.exists():
        return Recorder(path, append.begin(path))
    over = InputError(f"{path} is a recording that has ended; name another folder with --out.")
    if append.ended(path):
        raise over
    recorder, last = Recorder(path, append.reopened(path)), append.Held({}, {}, 0, False)
    for last in append.each(path):
        for name, piece in last.streams.items():
            recorder._keep(name, piece)
    if last.complete or last.end == 0:
        recorder.growing.file.close()
        raise over
    append.go_on(recorder.growing, last)
    recorder.next, recorder.note = int(last.note.get("seq", -1)) + 1, last.note
    return recorder
