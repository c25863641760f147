"""What a session records: in memory for the estimates, in the file before it is acknowledged.

A file that a killed process left is gone on with: its last note says which batch is due.
"""

from __future__ import annotations

import os
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from handcal.recordings import append
from handcal.types import Array, InputError, IntArray

SYNC_S = 1.0  # so much at most is lost where the whole machine dies

Stream = list[tuple[IntArray, Array]]


@dataclass
class Recorder:
    """An open recording. next: number of the batch that is due; last_ns: stamp of the last
    sample, None before the first."""

    path: Path
    growing: append.Growing
    next: int = 0
    samples: int = 0
    first_ns: int | None = None
    last_ns: int | None = None
    kept: dict[str, Stream] = field(default_factory=lambda: {"imu": [], "heading": []})
    synced: float = 0.0

    def add(
        self, ns: IntArray, value: Array, heading: tuple[IntArray, Array] | None, seq: int
    ) -> None:
        """Write one batch, and only then count it: ns (n,), value (n, 6) rates and forces."""
        pieces = {"imu": (ns, value)} | ({} if heading is None else {"heading": heading})
        append.append(self.growing, pieces, {"seq": seq})
        if time.monotonic() - self.synced > SYNC_S:
            os.fsync(self.growing.file.fileno())
            self.synced = time.monotonic()
        self.next = seq + 1
        for name, piece in pieces.items():
            self._keep(name, piece)

    def _keep(self, name: str, piece: tuple[IntArray, Array]) -> None:
        self.kept[name].append(piece)
        ns = piece[0]
        if name == "imu" and len(ns):
            self.samples += len(ns)
            self.first_ns = int(ns[0]) if self.first_ns is None else self.first_ns
            self.last_ns = int(ns[-1])

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
        """Stamps (n,) ns and values (n, d), by stream."""
        width = {"imu": 6, "heading": 1}
        return {
            name: (
                np.concatenate([np.zeros(0, dtype=np.int64), *(ns for ns, _ in parts)]),
                np.concatenate([np.zeros((0, width[name])), *(v for _, v in parts)]),
            )
            for name, parts in self.kept.items()
        }

    def close(self) -> None:
        """No more comes."""
        os.fsync(self.growing.file.fileno())
        self.growing.file.close()


def opened(path: Path) -> Recorder:
    """A new recording, or one that was broken off. Errors: InputError where it has ended."""
    if not path.exists():
        return Recorder(path, append.begin(path))
    held = append.held(path)
    if held.complete or held.end == 0:
        raise InputError(f"{path} is a recording that has ended; name another folder with --out.")
    recorder = Recorder(path, append.go_on(path, held), next=int(held.note.get("seq", -1)) + 1)
    for name, piece in held.streams.items():
        recorder._keep(name, piece)
    return recorder
