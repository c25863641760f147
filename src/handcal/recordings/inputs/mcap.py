"""MCAP files with ROS 2 messages (CDR or JSON), the format of handcal's own recordings.

The file is walked record by record and not through its index, so that a truncated one
gives what it holds. Every length in it is checked against what is really there before
memory is spent: 16 kB of hostile file can ask for a gigabyte.
"""

from __future__ import annotations

import math
import re
import struct
import zlib
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

import lz4.frame
import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, DataEnd, Metadata, Schema, Statistics

from handcal.recordings.inputs._magic import begins_with
from handcal.recordings.inputs._messages import ByteArray, Part, Topic, schema_key
from handcal.recordings.inputs._options import Options
from handcal.recordings.inputs._topics import (
    parts_of,
    readable,
    recording_from_topics,
    rows_of,
)
from handcal.recordings.streams import as_corrected
from handcal.types import InputError, IntArray, Recording

UNDERSTOOD = "MCAP with ROS 2 messages (.mcap)"
UNITS = "rad/s, m/s^2, tesla, degC, m (REP 103); at rest +g on the axis up (REP 145)"
STREAMS_READ = "all"
TRIED = "real recordings; files written by the library mcap"
ENDINGS = (".mcap",)
MAGIC = b"\x89MCAP0\r\n"
LARGEST_CHUNK = 128 * 2**20
TOGETHER = 2**21  # bytes of chunks that are decoded at once
LARGEST_METADATA = 2**20  # bytes: of a device there are two short texts
# Beyond a few MiB nothing that sensors write shrinks to a thousandth.
LARGEST_RATIO, RATIO_FROM = 1000, 4 * 2**20
NOTED = ("device", "vehicle", "corrected")
_SHA256 = re.compile("[0-9a-f]{64}")
_MESSAGE = int(Opcode.MESSAGE)  # compared once a message: an enum is slow
_DAMAGED = (struct.error, EndOfFile, UnicodeDecodeError, OverflowError)


@dataclass
class Walk:
    """What has been found in the file so far: found, by channel; base: bytes before the file;
    about: what the metadata records of ``NOTED`` say: of the device ``id`` and ``model``, of the
    vehicle its parameters, by which results the readings were corrected."""

    path: Path
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    found: dict[int, list[Part]] = field(default_factory=dict)
    base: int = 0
    messages: int = 0
    stated: int | None = None
    complete: bool = False
    about: dict[str, dict[str, str]] = field(default_factory=dict)


def can_read(path: Path) -> bool:
    """By its first bytes, or by its name, so that a damaged one gets a fitting message."""
    named = path.is_file() and path.suffix.lower() == ".mcap"
    return named or begins_with(path, MAGIC)


def read(path: Path, options: Options) -> Recording:
    """Read the recording; truncated files as far as they go. Errors: InputError."""
    walk = walked(path, options)
    made = recording_from_topics(path, topics_of(walk), options, warnings_of(walk))
    return with_notes(made, walk.about)


def with_notes(recording: Recording, about: Mapping[str, Mapping[str, str]]) -> Recording:
    """The recording with what the metadata records of its files say."""
    said = about.get("device", {})
    device, model = (said.get(k, "").strip() for k in ("id", "model"))
    vehicle = _numbers(about.get("vehicle", {}))
    corrected = {
        sha256: "".join(c if c.isprintable() else "?" for c in name)[:100]
        for sha256, name in about.get("corrected", {}).items()
        if _SHA256.fullmatch(sha256)
    }
    made = replace(recording, device=device, model=model, vehicle=vehicle)
    return as_corrected(made, corrected)


def _numbers(texts: Mapping[str, str]) -> dict[str, float]:
    """Those of the texts that are finite numbers."""
    out = {}
    for name, text in texts.items():
        with suppress(ValueError):
            out[name] = float(text)
    return {name: value for name, value in out.items() if math.isfinite(value)}


def walked(path: Path, options: Options, base: int = 0) -> Walk:
    """What a file holds. base: bytes of the files before it, of a recording in several. Errors:
    InputError."""
    walk = Walk(path, base=base)
    with path.open("rb") as file:
        if file.read(8) != MAGIC:
            raise InputError(f"{path} is not an MCAP file, or its first bytes are damaged.")
        loose: list[bytes] = []
        some = _Together()
        for opcode, content in _records(file, walk, options):
            if opcode != Opcode.CHUNK:
                loose.append(struct.pack("<BQ", opcode, len(content)) + content)
            if len(loose) > 4000 or (loose and opcode in (Opcode.CHUNK, Opcode.DATA_END)):
                some.take(b"".join(loose), walk)
                loose = []
            if opcode == Opcode.CHUNK:
                some.take(unpacked(walk, content), walk)
        some.take(b"".join(loose), walk)
        some.decode(walk)
    return walk


def warnings_of(walk: Walk) -> tuple[str, ...]:
    """What of the file is lost, in a sentence."""
    if not walk.complete:
        return (
            "The file ends early or is damaged towards its end: "
            f"{walk.messages} messages were recovered.",
        )
    if walk.stated is not None and walk.stated != walk.messages:
        return (f"The file says it holds {walk.stated} messages, but {walk.messages} were found.",)
    return ()


def _records(file: BinaryIO, walk: Walk, options: Options) -> Iterator[tuple[int, bytes]]:
    """Top-level records of the data section that matter, with its checksum checked."""
    size = file.seek(0, 2)
    position = file.seek(8)
    crc, data_section = zlib.crc32(MAGIC), True
    while True:
        head = file.read(9)
        if len(head) < 9:
            return
        opcode, length = struct.unpack("<BQ", head)
        if opcode == 0 or length > size - position - 9:
            return
        if opcode == Opcode.FOOTER:
            walk.complete = True
            options.progress(1.0)
            return
        content = b""
        before = crc
        if opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK):
            content = _bounded(file, length, walk)
            crc = zlib.crc32(content, zlib.crc32(head, crc))
        elif opcode in (Opcode.DATA_END, Opcode.STATISTICS):
            content = file.read(min(length, 2**20))
            file.seek(position + 9 + length)
        elif opcode == Opcode.METADATA and data_section and length <= LARGEST_METADATA:
            content = file.read(length)
            crc = zlib.crc32(content, zlib.crc32(head, crc))
            _note(walk, content)
            content = b""
        elif data_section:
            crc = _skipped(file, length, zlib.crc32(head, crc))
        else:
            file.seek(length, 1)
        position += 9 + length
        if opcode == Opcode.DATA_END:
            data_section = False
            _check_data_crc(content, before, walk)
        elif opcode == Opcode.STATISTICS:
            walk.stated = _statistics(content)
        elif data_section and content:
            yield opcode, content
            options.progress(position / size)


def _bounded(file: BinaryIO, length: int, walk: Walk) -> bytes:
    if length > LARGEST_CHUNK:
        raise InputError(
            f"{walk.path} has a record of {length / 2**20:.0f} MiB, more than the "
            f"{LARGEST_CHUNK // 2**20} MiB that are read at once: write it with smaller chunks."
        )
    return file.read(length)


def _skipped(file: BinaryIO, length: int, crc: int) -> int:
    """Pass over a record (an attachment may be large), keeping the checksum."""
    while length > 0:
        block = file.read(min(length, 2**20))
        crc, length = zlib.crc32(block, crc), length - len(block)
    return crc


def _check_data_crc(content: bytes, crc: int, walk: Walk) -> None:
    try:
        stated = DataEnd.read(ReadDataStream(BytesIO(content))).data_section_crc
    except _DAMAGED:
        return
    if stated not in (0, crc):
        raise InputError(
            f"{walk.path} is damaged: the checksum of its data section is wrong "
            "(at least one byte was flipped)."
        )


def _note(walk: Walk, content: bytes) -> None:
    """What a metadata record says."""
    try:
        record = Metadata.read(ReadDataStream(BytesIO(content)))
    except _DAMAGED:
        return
    if record.name in NOTED:
        walk.about[record.name] = dict(record.metadata)


def _statistics(content: bytes) -> int | None:
    try:
        return int(Statistics.read(ReadDataStream(BytesIO(content))).message_count)
    except _DAMAGED:
        return None


def unpacked(walk: Walk, content: bytes) -> bytes:
    """The records of a chunk, decompressed within bounds and checked. Errors: InputError."""
    try:
        chunk = Chunk.read(ReadDataStream(BytesIO(content)))
    except _DAMAGED as error:
        raise InputError(f"{walk.path} is damaged: a chunk's header makes no sense.") from error
    size, packed = chunk.uncompressed_size, chunk.data
    if size > LARGEST_CHUNK or size > max(RATIO_FROM, LARGEST_RATIO * len(packed)):
        raise InputError(
            f"{walk.path} has a chunk that would unpack from {len(packed)} bytes to "
            f"{size / 2**20:.0f} MiB; it was not unpacked."
        )
    data = _decompressed(walk, chunk.compression, packed, size)
    if len(data) != size:
        raise InputError(f"{walk.path} has a chunk that lies about its size; it was not read.")
    if chunk.uncompressed_crc not in (0, zlib.crc32(data)):
        raise InputError(
            f"{walk.path} is damaged: the checksum of a chunk is wrong "
            "(at least one byte was flipped)."
        )
    return data


def _decompressed(walk: Walk, compression: str, packed: bytes, size: int) -> bytes:
    """At most `size` bytes, or one more. The frame's own header may lie as well."""
    if compression == "":
        return packed
    try:
        if compression == "zstd":
            stated = zstandard.get_frame_parameters(packed).content_size
            if stated not in (size, zstandard.CONTENTSIZE_UNKNOWN):
                raise InputError(f"{walk.path} has a chunk that lies about its size.")
            return zstandard.ZstdDecompressor().decompress(packed, max_output_size=size)
        if compression == "lz4":
            unpacked: bytes = lz4.frame.LZ4FrameDecompressor().decompress(packed, size + 1)
            return unpacked
    except (zstandard.ZstdError, RuntimeError, EOFError) as error:
        raise InputError(f"{walk.path} is damaged: a chunk cannot be decompressed.") from error
    raise InputError(
        f"{walk.path} is compressed with {compression[:40]!r}; zstd, lz4 and none are understood."
    )


class _Together:
    """The records of several chunks: many are so small that each costs less than its beginning."""

    def __init__(self) -> None:
        self.chunks: list[bytes] = []
        self.length = 0
        self.places: dict[int, tuple[list[int], list[int]]] = {}

    def take(self, data: bytes, walk: Walk) -> None:
        """Schemas, channels and messages of a chunk. Errors: InputError."""
        read_head, position, end = struct.Struct("<BQH").unpack_from, 0, len(data)
        places, before = self.places, self.length
        while position + 11 <= end:
            opcode, length, channel = read_head(data, position)
            following = position + 9 + length
            if following > end:
                raise InputError(f"{walk.path} is damaged: a record reaches beyond its chunk.")
            if opcode == _MESSAGE and length >= 22:
                if channel not in places:
                    places[channel] = [], []
                starts, lengths = places[channel]
                starts.append(before + position + 31)
                lengths.append(length - 22)
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                _register(opcode, data[position + 9 : following], walk)
            position = following
        self.chunks.append(data)
        self.length += end
        if self.length > TOGETHER:
            self.decode(walk)

    def decode(self, walk: Walk) -> None:
        """Decode what was taken, and forget it. Errors: InputError."""
        buffer = np.frombuffer(b"".join(self.chunks), dtype=np.uint8)
        for channel, (starts, lengths) in self.places.items():
            walk.messages += len(starts)
            _decode(buffer, channel, np.array(starts), np.array(lengths), walk)
        walk.base += self.length
        self.chunks, self.length, self.places = [], 0, {}


def take_records(data: bytes, walk: Walk) -> None:
    """Schemas, channels and messages of a chunk. Errors: InputError."""
    some = _Together()
    some.take(data, walk)
    some.decode(walk)


def _register(opcode: int, content: bytes, walk: Walk) -> None:
    try:
        if opcode == Opcode.SCHEMA:
            schema = Schema.read(ReadDataStream(BytesIO(content)))
            walk.schemas[schema.id] = schema
        else:
            channel = Channel.read(ReadDataStream(BytesIO(content)))
            walk.channels[channel.id] = channel
    except _DAMAGED as error:
        raise InputError(f"{walk.path} is damaged: a schema or channel is illegible.") from error


def _decode(buffer: ByteArray, id: int, starts: IntArray, lengths: IntArray, walk: Walk) -> None:
    """Decode the messages of one channel, if handcal knows their schema."""
    channel = walk.channels.get(id)
    if channel is None:
        return
    topic = Topic(channel.topic, _schema_name(walk, channel), channel.message_encoding, ())
    if not readable(topic):
        return
    # A message follows its log time and publish time (8 bytes each).
    log = rows_of(buffer, starts - 16, 8).view("<u8")[:, 0]
    if np.any(log > 9 * 10**18):
        raise InputError(f"A log time on {channel.topic} is further away than 280 years.")
    parts = parts_of(buffer, starts, lengths, log.astype(np.int64), walk.base + starts, topic)
    walk.found.setdefault(id, []).extend(parts)


def _schema_name(walk: Walk, channel: Channel) -> str:
    schema = walk.schemas.get(channel.schema_id)
    return schema_key(schema.name) if schema else ""


def topics_of(walk: Walk) -> list[Topic]:
    """The channels that were found, with what was decoded of them."""
    return [
        Topic(c.topic, _schema_name(walk, c), c.message_encoding, tuple(walk.found.get(id, ())))
        for id, c in walk.channels.items()
        if not c.topic.startswith("/truth/")
    ]
