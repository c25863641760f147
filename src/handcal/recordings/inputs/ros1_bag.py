"""ROS 1 bags (.bag, version 2.0): the messages that mcap.py reads of ROS 2, by the same decoders.

Rate in rad/s, specific force in m/s^2 with +g on the axis up at rest (REP 103, REP 145), tesla,
metres. Of several that hold a pose a PoseStamped comes first, then Odometry and TransformStamped
(the child's axes in the header's frame). The file is walked record by record and not through its
index, so that one that was never closed gives what it holds; chunks are unpacked within bounds.
"""

from __future__ import annotations

import bz2
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

import lz4.frame
import numpy as np

from handcal.recordings.inputs._magic import begins_with
from handcal.recordings.inputs._messages import Part, Topic, schema_key
from handcal.recordings.inputs._options import Options
from handcal.recordings.inputs._topics import parts_of, readable, recording_from_topics
from handcal.recordings.inputs.mcap import LARGEST_CHUNK, LARGEST_RATIO, RATIO_FROM
from handcal.types import InputError, Recording

UNDERSTOOD = "a ROS 1 bag (.bag)"
UNITS = "rad/s, m/s^2, tesla, degC, m (REP 103); at rest +g on the axis up (REP 145)"
STREAMS_READ = "all that MCAP has, also from Odometry and TransformStamped"
TRIED = "bags written by the package rosbags, in each compression"
ENDINGS = (".bag",)
MARK = "it does not begin with #ROSBAG V2.0"
MAGIC = b"#ROSBAG V2.0\n"
_MESSAGE, _CHUNK, _CONNECTION = 2, 5, 7
_WITH_DATA = (_MESSAGE, _CHUNK, _CONNECTION)
LARGEST_HEAD = 2**20


@dataclass
class _Walk:
    """What has been found so far. base: bytes of unpacked chunks."""

    path: Path
    topics: dict[int, Topic] = field(default_factory=dict)
    found: dict[int, list[Part]] = field(default_factory=dict)
    base: int = 0
    messages: int = 0
    complete: bool = True


def can_read(path: Path) -> bool:
    """By its first line."""
    return begins_with(path, MAGIC)


def read(path: Path, options: Options) -> Recording:
    """Read the recording; one that ends early as far as it goes. Errors: InputError."""
    walk = _Walk(path)
    with path.open("rb") as file:
        for op, head, data in _records(file, walk, options):
            if op == _CHUNK:
                _take(_unpacked(path, head, data), walk)
            else:  # (a bag may have messages outside of chunks)
                _take(_packed(head, data), walk)
    options.progress(1.0)
    said = () if walk.complete else (
        f"The bag ends early: {walk.messages} messages were recovered.",
    )  # fmt: skip
    topics = [
        Topic(t.name, t.schema, t.encoding, tuple(walk.found.get(id, ())))
        for id, t in walk.topics.items()
    ]
    return recording_from_topics(path, topics, options, said)


def _records(
    file: BinaryIO, walk: _Walk, options: Options
) -> Iterator[tuple[int, Mapping[bytes, bytes], bytes]]:
    """Top-level records that matter: kind, header fields, data. Errors: InputError."""
    size, position = file.seek(0, 2), file.seek(len(MAGIC))
    while position < size:
        head = _sized(file, size)
        length = _length(file)
        if head is None or length is None or length > size - file.tell():
            walk.complete = False
            return
        fields = _fields(head)
        op = fields.get(b"op", b"\0")[0] if fields.get(b"op") else 0
        if op in _WITH_DATA:
            if length > LARGEST_CHUNK:
                raise InputError(
                    f"{walk.path} has a record of {length / 2**20:.0f} MiB, more than the "
                    f"{LARGEST_CHUNK // 2**20} MiB that are read at once."
                )
            yield op, fields, file.read(length)
            options.progress(position / size)
        position = file.seek(0, 1) if op in _WITH_DATA else file.seek(length, 1)


def _length(file: BinaryIO) -> int | None:
    word = file.read(4)
    return int(struct.unpack("<I", word)[0]) if len(word) == 4 else None


def _sized(file: BinaryIO, size: int) -> bytes | None:
    """A header, or None where it is not whole or absurd."""
    length = _length(file)
    if length is None or length > min(LARGEST_HEAD, size - file.tell()):
        return None
    return file.read(length)


def _packed(head: Mapping[bytes, bytes], data: bytes) -> bytes:
    """A record as it stands in a file."""
    fields = b"".join(
        struct.pack("<I", len(k) + 1 + len(v)) + k + b"=" + v for k, v in head.items()
    )
    return struct.pack("<I", len(fields)) + fields + struct.pack("<I", len(data)) + data


def _fields(head: bytes) -> dict[bytes, bytes]:
    """The fields of a header, each a length and name=value; those before damage."""
    out, at = {}, 0
    while at + 4 <= len(head):
        (length,) = struct.unpack_from("<I", head, at)
        name, sign, value = head[at + 4 : at + 4 + length].partition(b"=")
        if not sign or at + 4 + length > len(head):
            break
        out[name] = value
        at += 4 + length
    return out


def _number(fields: Mapping[bytes, bytes], name: bytes) -> int:
    """A field of four bytes; -1 where it is none."""
    value = fields.get(name, b"")
    return int(struct.unpack("<I", value)[0]) if len(value) == 4 else -1


def _unpacked(path: Path, head: Mapping[bytes, bytes], data: bytes) -> bytes:
    """The records of a chunk, decompressed within bounds. Errors: InputError."""
    kind, size = head.get(b"compression", b"none"), _number(head, b"size")
    if kind == b"none":
        return data
    if size > LARGEST_CHUNK or size > max(RATIO_FROM, LARGEST_RATIO * len(data)):
        raise InputError(
            f"{path} has a chunk that would unpack from {len(data)} bytes to "
            f"{size / 2**20:.0f} MiB; it was not unpacked."
        )
    try:
        if kind == b"bz2":
            out = bz2.BZ2Decompressor().decompress(data, size + 1)
        elif kind == b"lz4":
            out = lz4.frame.LZ4FrameDecompressor().decompress(data, size + 1)
        else:
            raise InputError(f"{path}: the compression {kind[:20]!r} of a chunk is unknown.")
    except InputError:
        raise
    except (OSError, EOFError, RuntimeError, ValueError) as error:
        raise InputError(f"{path} is damaged: a chunk cannot be decompressed.") from error
    if len(out) != size:
        raise InputError(f"{path} has a chunk that lies about its size; it was not read.")
    return out


def _take(data: bytes, walk: _Walk) -> None:
    """Connections and messages among records. Errors: InputError."""
    u32, at, end = struct.Struct("<I").unpack_from, 0, len(data)
    places: dict[int, list[tuple[int, int, int]]] = {}
    while at + 8 <= end:
        begin = at + 4 + u32(data, at)[0]
        if begin + 4 > end:
            break
        fields, length = _fields(data[at + 4 : begin]), u32(data, begin)[0]
        at = begin + 4 + length
        if at > end:
            break
        op, connection = fields.get(b"op"), _number(fields, b"conn")
        if op == bytes([_CONNECTION]):
            _register(connection, fields, data[begin + 4 : at], walk)
        elif op == bytes([_MESSAGE]) and len(fields.get(b"time", b"")) == 8:
            seconds, ns = struct.unpack("<II", fields[b"time"])
            places.setdefault(connection, []).append((begin + 4, length, seconds * 10**9 + ns))
            walk.messages += 1
    if at < end:
        walk.complete = False
    buffer = np.frombuffer(data, dtype=np.uint8)
    for connection, found in places.items():
        if connection in walk.topics and readable(walk.topics[connection]):
            starts, lengths, log_ns = np.array(found, dtype=np.int64).T
            order, topic = walk.base + starts, walk.topics[connection]
            parts = parts_of(buffer, starts, lengths, log_ns, order, topic)
            walk.found.setdefault(connection, []).extend(parts)
    walk.base += end


def _register(id: int, fields: Mapping[bytes, bytes], data: bytes, walk: _Walk) -> None:
    """A connection: its topic and the type of its messages."""
    name = fields.get(b"topic", b"").decode("utf-8", "replace")
    schema = schema_key(_fields(data).get(b"type", b"").decode("utf-8", "replace"))
    walk.topics[id] = Topic(name, schema, "bag", ())
