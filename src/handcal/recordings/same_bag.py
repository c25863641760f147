"""A ROS 2 bag once more, as one MCAP, with corrected readings in the place of those that were read.

Channels, schemas, messages, their times and numbers are copied byte by byte. In the messages of a
topic that was corrected only the corrected fields are others, and the stamp of one that was late.
A message of such a topic of which there is no corrected reading is left out, and counted; one that
says itself that it holds no reading (covariance -1) stays.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mcap.exceptions import McapError
from mcap.records import Attachment, Channel, Metadata, Schema
from mcap.records import Message as Record
from mcap.stream_reader import StreamReader
from mcap.writer import Writer

from handcal.recordings.export import begun, metadata
from handcal.recordings.inputs import format_of, mcap, ros2_bag
from handcal.recordings.inputs._messages import ALIGNED, POSE_LIKE, Decoded, Topic, starts
from handcal.recordings.inputs._options import HALVES, Options
from handcal.recordings.inputs._sqlite import is_database
from handcal.recordings.inputs._topics import in_order
from handcal.recordings.streams import STREAMS
from handcal.types import Array, BoolArray, HandcalError, IntArray, Recording, Series

WHY = "a stamp that repeats or lies outside the IMU's time, or a reading that is not trusted"


@dataclass(frozen=True)
class Bag:
    """files: in their order; topics: with what was decoded of them."""

    files: tuple[Path, ...]
    topics: tuple[Topic, ...]

    def raw(self, name: str) -> tuple[Decoded, int, bool]:
        """The messages of a topic, in their order; how many strings stand between their header and
        their numbers; whether they have stamps."""
        own = [topic for topic in self.topics if topic.name == name and topic.parts]
        stamped = any(part.decoded.stamp.any() for topic in own for part in topic.parts)
        return in_order(own), POSE_LIKE.get(own[0].schema, 0), stamped


@dataclass(frozen=True)
class Change:
    """What is written into the messages of a topic, in their order: value (n, k) into the numbers
    at (k,), NaN where one stays; moved (n,): what the stamp changes by, ns; out (n,): left out."""

    at: Sequence[int]
    strings: int
    value: Array
    moved: IntArray
    out: BoolArray


def bag_of(path: Path, recording: Recording) -> Bag | None:
    """The bag that a recording was read from; None where it was read from another format, or from
    messages that are not CDR. Errors: InputError."""
    if not recording.topics or format_of(path) not in (mcap, ros2_bag):
        return None
    files = ros2_bag.files_of(path)
    topics, _, _ = ros2_bag.topics_in(files, Options())
    used = {n for name in recording.topics.values() for n in _apart(name, topics)}
    if any(topic.encoding != "cdr" for topic in topics if topic.name in used and topic.parts):
        return None
    return Bag(tuple(files), tuple(topics))


def _apart(name: str, topics: Sequence[Topic]) -> list[str]:
    """The topic of a stream, or those of the IMU's two sensors."""
    return [name] if any(topic.name == name for topic in topics) else name.split(" + ")


def write_bag(bag: Bag, given: Recording, corrected: Recording, out: Path) -> tuple[str, ...]:
    """Write the bag with the corrected readings, which are as many as those given; sentences about
    what was left out. Errors: HandcalError, InputError."""
    changes, said = _changes(bag, given, corrected)
    own = metadata(corrected)
    with begun(out) as writer:
        copy = _Copy(writer, changes)
        for file in bag.files:
            for record in ros2_bag.records(file) if is_database(file) else _in_mcap(file):
                if isinstance(record, Metadata) and record.name in own:
                    own[record.name] = {**record.metadata, **own[record.name]}
                else:
                    copy.take(record)
            copy.end_file()
        for name, text in own.items():
            writer.add_metadata(name, text)
    if any(copy.seen.get(name, 0) != len(c.out) for name, c in changes.items()):
        raise HandcalError(f"{bag.files[0]} holds other messages than were read of it.")
    return (*said, *copy.undefined(), *_left_out(changes))


def _left_out(changes: Mapping[str, Change]) -> Iterator[str]:
    for name, change in changes.items():
        if n := int(change.out.sum()):
            yield (
                f"{name}: {n} of {len(change.out)} messages have no corrected reading ({WHY}) and "
                f"{'was' if n == 1 else 'were'} left out."
            )


# --- what changes -------------------------------------------------------------------------------


def _changes(
    bag: Bag, given: Recording, corrected: Recording
) -> tuple[dict[str, Change], tuple[str, ...]]:
    """By topic, and sentences about what could not be changed."""
    out, said = {}, list[str]()
    if any(
        not np.array_equal(getattr(given.imu, sensor), getattr(corrected.imu, sensor))
        for sensor in HALVES
    ):
        out = _of_imu(bag, given, corrected)
    for stream, old in given.streams.items():
        new, name = corrected.streams[stream], given.topics[stream]
        same = np.array_equal(old.value, new.value)
        if same and np.array_equal(old.t, new.t):
            continue
        raw, strings, stamped = bag.raw(name)
        n, rows = len(raw.stamp), given.rows[stream]
        message = STREAMS[stream].message
        value, moved = np.full((n, len(message.needed)), np.nan), np.zeros(n, dtype=np.int64)
        late = np.rint((new.t - old.t) * 1e9).astype(np.int64)
        if stamped:
            moved[rows] = late
        if late.any():
            said.append(_of_stamps(name, late, stamped))
        if not same:
            value[rows] = _written(stream, raw.value[rows], old, new)
        without = np.ones(n, dtype=np.bool_)
        without[rows] = False
        out[name] = Change(message.index(message.needed), strings, value, moved, without)
    return out, tuple(said)


def _of_stamps(name: str, late: IntArray, stamped: bool) -> str:
    """What became of the stamps of a topic that came late by so much (n,), ns."""
    if not stamped:
        return f"{name}: its messages have no stamps of their own, and stay as late as they are."
    ms = float(np.median(late)) / 1e6
    return (
        f"{name}: its stamps are {abs(ms):.3g} ms {'earlier' if ms < 0 else 'later'}; its log "
        "times and all other topics keep theirs."
    )


def _of_imu(bag: Bag, given: Recording, corrected: Recording) -> dict[str, Change]:
    """Changes of the one topic of the IMU, or of those of its two sensors."""
    names = _apart(given.topics["imu"], bag.topics)
    channels = [topic for topic in bag.topics if topic.name in names and topic.parts]
    raw = in_order(channels)
    parts = [(part, names.index(topic.name)) for topic in channels for part in topic.parts]
    order = np.concatenate([part.order for part, _ in parts])
    of = np.repeat([k for _, k in parts], [len(part.order) for part, _ in parts])
    of = of[np.argsort(order, kind="stable")]
    held = ~raw.lacking
    if len(names) > 1:
        held &= of[:, None] == [0, 1]
    halves = [_of_sensor(k, raw, held[:, k], given, corrected) for k in range(2)]
    value = np.where(np.repeat(held, 3, axis=1), np.hstack(halves), np.nan)
    without = np.any(np.isnan(value).reshape(-1, 2, 3).any(axis=2) & held, axis=1)
    moved, message = np.zeros(len(value), dtype=np.int64), STREAMS["imu"].message
    at = message.index(message.needed)
    return {
        name: Change(at, 0, value[of == k], moved[of == k], without[of == k])
        for k, name in enumerate(names)
    }


def _of_sensor(
    k: int, raw: Decoded, held: BoolArray, given: Recording, corrected: Recording
) -> Array:
    """What the messages of gyro (k = 0) or accelerometer read (n, 3), corrected; NaN where there is
    no such reading, of which held (n,) are any."""
    sensor, read = HALVES[k], raw.value[:, 3 * k : 3 * k + 3]
    out, valid, t = np.full_like(read, np.nan), corrected.imu.valid, given.imu.t
    old, new = getattr(given.imu, sensor), getattr(corrected.imu, sensor)
    if sensor in given.rows:
        rows = given.rows[sensor]
        out[rows[valid]] = _in_file(read[rows], old, new)[valid]
        return out
    # The recording has the accelerometer at the gyro's stamps: its error is taken off at its own.
    own = (raw.stamp[held] - raw.stamp[given.rows["gyro"][0]]) / 1e9
    order = np.argsort(own, kind="stable")
    beside = _at(t, own[order], read[held][order])
    error = np.where(valid[:, None], beside - _in_file(beside, old, new), np.nan)
    out[held] = read[held] - _at(own, t, error)
    return out


def _at(wanted: Array, t: Array, value: Array) -> Array:
    """Columns of a value (n, d) at times t (n,), interpolated; NaN outside."""
    columns = [np.interp(wanted, t, c, left=np.nan, right=np.nan) for c in value.T]
    return np.column_stack(columns)


def _written(stream: str, read: Array, old: Series, new: Series) -> Array:
    """The fields of a stream's messages (m, k), which were read and became ``old``, as ``new``."""
    row = STREAMS[stream]
    if row.circular:  # (a heading: what is not level stays so, turned about the vertical)
        half = 0.5 * (new.value - old.value)[:, 0]
        c, s = np.cos(half), np.sin(half)
        x, y, z, w = read.T
        return np.column_stack([c * x - s * y, c * y + s * x, c * z + s * w, c * w - s * z])
    return new.value if row.posed else _in_file(read, old.value, new.value)


def _in_file(read: Array, old: Array, new: Array) -> Array:
    """Corrected readings (n, d) in the file's own units and axes: read became old, then new."""
    if np.array_equal(read, old):
        return new
    to_si = np.linalg.lstsq(read, old, rcond=None)[0]
    return np.asarray(read - (old - new) @ np.linalg.pinv(to_si))


def _rewritten(data: bytes, name: str, change: Change, k: int) -> bytes:
    """The k-th message of a topic with what is changed in it."""
    out, order = bytearray(data), "<" if data[1] == 1 else ">"
    if moved := int(change.moved[k]):
        seconds, ns = struct.unpack_from(f"{order}iI", data, 4)
        stamp = divmod(seconds * 10**9 + ns + moved, 10**9)
        struct.pack_into(f"{order}iI", out, 4, *stamp)
    block = np.frombuffer(data, dtype=np.uint8)[None]
    ((_, start),) = starts(block, order, change.strings, ALIGNED, name)
    for place, value in zip(change.at, change.value[k].tolist(), strict=True):
        if not math.isnan(value):
            struct.pack_into(f"{order}d", out, start + 8 * place, value)
    return bytes(out)


# --- what is copied -----------------------------------------------------------------------------


class _Copy:
    """Records of the bag's files on their way into one; seen: messages so far, by topic."""

    def __init__(self, writer: Writer, changes: Mapping[str, Change]) -> None:
        self.writer, self.changes = writer, changes
        self.seen: dict[str, int] = {}
        self.known: dict[tuple[object, ...], int] = {}
        self.empty: dict[str, None] = {}
        self.end_file()

    def end_file(self) -> None:
        """The next file numbers its channels by itself."""
        self.schemas, self.channels = dict[int, int]({0: 0}), dict[int, tuple[int, str]]()

    def take(self, record: object) -> None:
        if isinstance(record, Record):
            self._message(record)
        elif isinstance(record, Schema):
            one = record.name, record.encoding, record.data
            if one not in self.known:
                self.known[one] = self.writer.register_schema(*one)
            if not record.data:
                self.empty[record.name] = None
            self.schemas[record.id] = self.known[one]
        elif isinstance(record, Channel):
            if record.id not in self.channels:
                self.channels[record.id] = self._channel(record), record.topic
        elif isinstance(record, Metadata):
            # (of what was corrected the vehicle's own calibration is none any more)
            if record.name != "vehicle":
                self.writer.add_metadata(record.name, dict(record.metadata))
        elif isinstance(record, Attachment):
            a = record
            self.writer.add_attachment(a.create_time, a.log_time, a.name, a.media_type, a.data)

    def _channel(self, c: Channel) -> int:
        """The channel of the next file is that of the last: the first of those alike is the
        first."""
        key = c.topic, c.message_encoding, self.schemas.get(c.schema_id, 0)
        about, nth = tuple(sorted(c.metadata.items())), 0
        while (id := self.known.get((key, about, nth))) in [i for i, _ in self.channels.values()]:
            nth += 1
        if id is None:
            id = self.known[key, about, nth] = self.writer.register_channel(*key, dict(about))
        return id

    def _message(self, m: Record) -> None:
        if m.channel_id not in self.channels:
            return
        channel, name = self.channels[m.channel_id]
        k, change, data = self.seen.get(name, 0), self.changes.get(name), m.data
        self.seen[name] = k + 1
        if change is not None and k < len(change.out):
            if change.out[k]:
                return
            data = _rewritten(data, name, change, k)
        self.writer.add_message(channel, m.log_time, data, m.publish_time, m.sequence)

    def undefined(self) -> Iterator[str]:
        """That the bag does not define some of its messages."""
        if self.empty:
            yield (
                f"The bag does not define {', '.join(sorted(self.empty))}: where ROS 2 knows them, "
                "it plays them; other programs cannot read them."
            )


def _in_mcap(path: Path) -> Iterator[object]:
    """Records of an MCAP that was read already, as far as they go."""
    with path.open("rb") as file:
        try:
            yield from StreamReader(file).records
        except (McapError, struct.error, UnicodeDecodeError, OverflowError):
            return  # (that it ends early was said when it was read)
