"""An MCAP recording that grows: each piece is one chunk, whole or not there at all.

A piece is handed to the system before ``append`` returns, so what was appended survives the
process. The file has no end until the recording is written anew (``export.write_mcap``); readers
take what it holds. Beside the samples, each chunk holds a note (JSON) that is not older or newer
than they are.
"""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Header, Message, Schema

from handcal.recordings.export import Pieces, messages
from handcal.recordings.inputs._messages import ByteArray, decode_cdr
from handcal.recordings.streams import STREAMS
from handcal.types import Array, InputError, IntArray

MAGIC = b"\x89MCAP0\r\n"
LARGEST = 32 * 2**20  # no piece of ours unpacks to more
# Channels; 3 is the note (files that were broken off keep their numbers).
IDS = {"imu": 1, "heading": 2, "mag": 4, "temperature": 5, "pose": 6, "reference": 7}
NOTE_ID, NOTE_TOPIC, NOTE_SCHEMA = 3, "/live/batch", "handcal/live/batch"
# A message record up to its data.
_HEAD = np.dtype([("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"),
                  ("log", "<u8"), ("publish", "<u8")])  # fmt: skip
_DAMAGED = (struct.error, EndOfFile, UnicodeDecodeError, OverflowError, ValueError)


@dataclass
class Growing:
    """A file that is open for appending, and which channels it already knows."""

    file: BinaryIO
    known: set[int] = field(default_factory=set)


@dataclass(frozen=True)
class Held:
    """What a file holds, or one chunk of it: by stream, stamps (n,) ns and values (n, d); the last
    note; where the last whole chunk ends; whether somebody has written its end."""

    streams: Mapping[str, tuple[IntArray, Array]]
    note: Mapping[str, Any]
    end: int
    complete: bool


def begin(path: Path) -> Growing:
    """A new file. Errors: OSError; it must not be there yet."""
    file = path.open("xb")
    out = RecordBuilder()
    Header("ros2", "handcal").write(out)
    file.write(MAGIC + _bytes(out))
    file.flush()
    return Growing(file)


def reopened(path: Path) -> Growing:
    """A file that was broken off, as it is; ``go_on`` makes it ready for more. Errors: OSError."""
    return Growing(path.open("r+b"))


def go_on(growing: Growing, held: Held) -> None:
    """Cut the file behind its last whole chunk and go there."""
    growing.file.truncate(held.end)
    growing.file.seek(held.end)


def append(growing: Growing, pieces: Pieces, note: Mapping[str, Any]) -> None:
    """One chunk: of each stream stamps (n,) ns and values (n, d), and the note.

    Errors: OSError where the disk takes it no more; HandcalError beyond 2038.
    """
    out, parts, first, last = RecordBuilder(), [], 2**63, 0
    for stream, (ns, value) in pieces.items():
        _register(growing, out, stream)
        parts += [_bytes(out), _records_of(IDS[stream], ns, messages(stream, ns, value))]
        if len(ns):
            first, last = min(first, int(ns[0])), max(last, int(ns[-1]))
    _register_note(growing, out)
    said = json.dumps(note).encode()
    Message(
        channel_id=NOTE_ID, data=said, log_time=last, publish_time=last, sequence=0
    ).write(out)  # fmt: skip
    data = b"".join([*parts, _bytes(out)])
    packed = zstandard.ZstdCompressor().compress(data)
    Chunk("zstd", packed, last, min(first, last), zlib.crc32(data), len(data)).write(out)
    growing.file.write(_bytes(out))
    growing.file.flush()


def _records_of(id: int, ns: IntArray, data: ByteArray) -> bytes:
    """Message records of one channel: stamps (n,) ns and their data (n, length), all at once (one
    by one they would take longer than all else that is done with a sample)."""
    head = np.zeros(len(ns), dtype=_HEAD)
    head["opcode"], head["length"] = Opcode.MESSAGE, _HEAD.itemsize - 9 + data.shape[1]
    head["channel"], head["log"], head["publish"] = id, ns, ns
    return np.hstack([head.view(np.uint8).reshape(len(ns), _HEAD.itemsize), data]).tobytes()


def _bytes(out: RecordBuilder) -> bytes:
    """What was built since the last time."""
    data: bytes = out.end()  # type: ignore[no-untyped-call]
    return data


def _register(growing: Growing, out: RecordBuilder, stream: str) -> None:
    id, row = IDS[stream], STREAMS[stream]
    if id not in growing.known:
        growing.known.add(id)
        Schema(
            data=row.message.definition.encode(), encoding="ros2msg", id=id, name=row.message.schema
        ).write(out)
        Channel(
            id=id, topic=row.topic, message_encoding="cdr", metadata={}, schema_id=id
        ).write(out)  # fmt: skip


def _register_note(growing: Growing, out: RecordBuilder) -> None:
    if NOTE_ID not in growing.known:
        growing.known.add(NOTE_ID)
        Schema(data=b"{}", encoding="jsonschema", id=NOTE_ID, name=NOTE_SCHEMA).write(out)
        Channel(
            id=NOTE_ID, topic=NOTE_TOPIC, message_encoding="json", metadata={}, schema_id=NOTE_ID
        ).write(out)


def ended(path: Path) -> bool:
    """Whether somebody has written the end of a file (its channels may be any then)."""
    with path.open("rb") as file:
        size = file.seek(0, 2)
        file.seek(max(len(MAGIC), size - len(MAGIC)))
        return file.read() == MAGIC


def held(path: Path) -> Held:
    """What such a file holds, as far as it goes. Errors: InputError for a file of another kind."""
    parts: dict[str, list[tuple[IntArray, Array]]] = {}
    last = Held({}, {}, 0, False)
    for last in each(path):
        for name, piece in last.streams.items():
            parts.setdefault(name, []).append(piece)
    streams = {
        name: (np.concatenate([ns for ns, _ in some]), np.concatenate([v for _, v in some]))
        for name, some in parts.items()
    }
    return replace(last, streams=streams)


def each(path: Path) -> Iterator[Held]:
    """What such a file holds, record by record, so that no more than a chunk is in memory; the
    note, the end and whether there is one as known by then. Errors as of ``held``."""
    note: Mapping[str, Any] = {}
    complete = False
    with path.open("rb") as file:
        if file.read(8) != MAGIC:
            raise InputError(f"{path} is no recording of handcal live; name another folder.")
        for opcode, content, after in _records(file):
            complete = complete or opcode in (Opcode.DATA_END, Opcode.FOOTER)
            streams: Mapping[str, tuple[IntArray, Array]] = {}
            if opcode == Opcode.CHUNK:
                try:
                    blocks = _messages(_unpacked(content))
                    note = json.loads(blocks[NOTE_ID][-1]) if NOTE_ID in blocks else note
                except _DAMAGED:
                    return
                streams = {n: _decoded(n, blocks[id]) for n, id in IDS.items() if id in blocks}
            yield Held(streams, note, after, complete)


def _records(file: BinaryIO) -> Iterator[tuple[int, bytes, int]]:
    """Whole records with where they end."""
    size = file.seek(0, 2)
    at = file.seek(8)
    while at + 9 <= size:
        opcode, length = struct.unpack("<BQ", file.read(9))
        at += 9 + length
        if at > size:
            return
        yield opcode, file.read(length), at


def _unpacked(content: bytes) -> bytes:
    chunk = Chunk.read(ReadDataStream(BytesIO(content)))
    if chunk.uncompressed_size > LARGEST or chunk.compression != "zstd":
        raise ValueError
    try:
        data = zstandard.ZstdDecompressor().decompress(
            chunk.data, max_output_size=chunk.uncompressed_size
        )
    except zstandard.ZstdError:
        raise ValueError from None
    if zlib.crc32(data) != chunk.uncompressed_crc:
        raise ValueError
    return data


def _messages(data: bytes) -> dict[int, list[bytes]]:
    """The messages of a chunk, by channel."""
    blocks: dict[int, list[bytes]] = {}
    at = 0
    while at + 9 <= len(data):
        opcode, length = struct.unpack_from("<BQ", data, at)
        if opcode == Opcode.MESSAGE:
            (id,) = struct.unpack_from("<H", data, at + 9)
            blocks.setdefault(id, []).append(data[at + 31 : at + 9 + length])
        at += 9 + length
    return blocks


def _decoded(stream: str, parts: list[bytes]) -> tuple[IntArray, Array]:
    row = STREAMS[stream]
    block = np.frombuffer(b"".join(parts), dtype=np.uint8).reshape(len(parts), -1)
    ((_, decoded),) = decode_cdr(block, row.message, row.topic)
    value = decoded.value if row.decode is None else row.decode(decoded.value)
    return decoded.stamp, value
