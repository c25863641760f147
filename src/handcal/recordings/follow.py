"""An MCAP file that somebody else is still writing, read as it grows.

What is whole is read: records of the file, and messages of whole chunks. Which topic is which
stream is decided as of a finished file, by what has been seen so far, and then kept.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from handcal.recordings.inputs._messages import Topic
from handcal.recordings.inputs._options import HALVES, Options
from handcal.recordings.inputs._topics import in_order
from handcal.recordings.inputs._which_topic import by_stream, chosen_topics
from handcal.recordings.inputs.mcap import (
    LARGEST_CHUNK,
    MAGIC,
    Walk,
    take_records,
    topics_of,
    unpacked,
)
from handcal.recordings.streams import STREAMS
from handcal.types import Array, BoolArray, InputError, IntArray

# Of MCAP's records: those that begin a file's end, and those that hold data.
_ENDS, _CHUNK, _DATA = (0x02, 0x0F), 0x06, (0x03, 0x04, 0x05)
# So much is read at a time; a recorder writes less in the time between two looks.
PIECE = 32 * 2**20


@dataclass(frozen=True)
class News:
    """What a stream has that is new: stamps (n,) ns, values (n, d) in SI, and of the IMU which
    rows hold no rate or no force, lacking (n, 2)."""

    ns: IntArray
    value: Array
    lacking: BoolArray


@dataclass
class Arriving:
    """Messages that arrive, and of which streams they are. name: of where they come from; seen: one
    part of each topic that had messages; taken: topic by stream."""

    name: Path
    options: Options = field(default_factory=Options)
    seen: dict[str, Topic] = field(default_factory=dict)
    taken: dict[str, str] = field(default_factory=dict)

    def news(self, topics: Sequence[Topic]) -> Mapping[str, News]:
        """By stream what these topics hold; nothing before there is an IMU, so that none of its
        companions is taken for it. Errors: InputError where several fit a stream."""
        there = [t for t in topics if t.parts]
        for topic in there:
            if not self.taken or topic.name not in self.seen:
                self.seen[topic.name] = replace(topic, parts=topic.parts[-1:])
        if not self._chosen():
            return {}
        held = by_stream(self.taken, there)
        return {name: _news(name, own, self.options) for name, own in held.items() if own}

    def _chosen(self) -> bool:
        """Whether there is an IMU; streams that came up since are taken too."""
        if not any(t.schema == STREAMS["imu"].message.schema for t in self.seen.values()):
            return False
        if any(name not in self.taken.values() for name in self.seen):
            wanted = replace(self.options, topics={**self.options.topics, **self.taken})
            taken, _ = chosen_topics(self.name, list(self.seen.values()), wanted)
            if "imu" not in taken and not set(HALVES) <= set(taken):
                return False  # (one sensor, or what reads nothing yet)
            self.taken = dict(taken)
        return True


@dataclass
class Followed:
    """A growing file. at: where the next record begins; complete: its end has been written."""

    path: Path
    options: Options = field(default_factory=Options)
    at: int = 0
    complete: bool = False
    walk: Walk = field(init=False)
    arriving: Arriving = field(init=False)

    def __post_init__(self) -> None:
        self.walk = Walk(self.path)
        self.arriving = Arriving(self.path, self.options)

    def news(self) -> Mapping[str, News]:
        """By stream, what came since the last time; empty before there is an IMU.

        Errors: InputError for what is no MCAP file, is damaged, or fits several streams.
        """
        while self._read():
            pass
        out = self.arriving.news(topics_of(self.walk))
        if out:
            self.walk.found.clear()
        return out

    def _read(self) -> bool:
        """Take the whole records of the next piece. False where there is none."""
        if not self.path.exists():
            return False
        with self.path.open("rb") as file:
            file.seek(self.at)
            data = file.read(PIECE)
        start = 0
        if self.at == 0:
            if len(data) < len(MAGIC):
                return False
            if not data.startswith(MAGIC):
                raise InputError(f"{self.path} is no MCAP file, so it cannot be followed.")
            start = len(MAGIC)
        end = self._records(data, start)
        self.at += end
        return end > 0 and not self.complete

    def _records(self, data: bytes, start: int) -> int:
        """Where the last whole record ends."""
        loose: list[bytes] = []
        while start + 9 <= len(data) and not self.complete:
            opcode, length = struct.unpack_from("<BQ", data, start)
            if length > LARGEST_CHUNK:
                raise InputError(f"{self.path} is damaged: a record of {length} bytes.")
            after = start + 9 + length
            # (a writer that asks for its space first leaves zeros, which are no record)
            if after > len(data) or opcode == 0:
                break
            if opcode in _ENDS:
                self.complete = True
            elif opcode == _CHUNK:
                take_records(unpacked(self.walk, data[start + 9 : after]), self.walk)
            elif opcode in _DATA:
                loose.append(data[start:after])
            start = after
        take_records(b"".join(loose), self.walk)
        return start


def _news(stream: str, topics: list[Topic], options: Options) -> News:
    raw, row = in_order(topics), STREAMS[stream]
    value = raw.value if row.decode is None else row.decode(raw.value)
    if row.quantities:
        factors = [options.factor(quantity) for quantity in row.quantities]
        value = value * np.repeat(factors, len(row.columns) // len(factors))
    return News(raw.stamp, value, raw.lacking)
