"""A Recording as an MCAP file with ROS 2 messages, readable by handcal and by ROS tools.

What is written reads back equal: values bit by bit, stamps to the nanosecond. Samples
that are not valid carry the covariance -1 by which ROS says "not measured".
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from mcap.writer import CompressionType, Writer

from handcal import output
from handcal.recordings.inputs._messages import ByteArray, body_offset
from handcal.recordings.inputs._repair import nanoseconds
from handcal.recordings.streams import STREAMS, TWINS, Stream
from handcal.types import Array, BoolArray, HandcalError, InputError, IntArray, Recording

# Small chunks, so that a truncated file gives back nearly all it holds.
CHUNK_SIZE = 64 * 1024
# By stream, stamps (n,) ns and values (n, d).
Pieces = Mapping[str, tuple[IntArray, Array]]


def write_mcap(recording: Recording, path: str | Path) -> None:
    """Write the recording. Errors: HandcalError if the file cannot be written."""
    _write({"": recording}, path)


def write_pieces(pieces: Iterable[Pieces], path: str | Path) -> None:
    """Write a recording piece by piece, of which no more than one is in memory: of each stream
    stamps (n,) ns and values (n, d), all valid, in the order of time within a piece. Errors as of
    ``write_mcap``."""
    known: dict[str, tuple[int, int]] = {}
    with begun(path) as writer:
        for some in pieces:
            _write_piece(writer, some, known)


@contextmanager
def begun(path: str | Path) -> Iterator[Writer]:
    """A file that is being written, and is ended with the context."""
    with output.whole(path) as place, place.open("wb") as file:
        writer = Writer(file, chunk_size=CHUNK_SIZE, compression=CompressionType.ZSTD)
        writer.start(profile="ros2", library="handcal")
        yield writer
        writer.finish()  # type: ignore[no-untyped-call]


def _write_piece(writer: Writer, pieces: Pieces, known: dict[str, tuple[int, int]]) -> None:
    """known: by stream its channel, and how many messages it has."""
    waiting: list[tuple[int, int, bytes, int]] = []
    for stream, (ns, value) in pieces.items():
        row = STREAMS[stream]
        if stream not in known:
            text = row.message.definition.encode()
            schema = writer.register_schema(row.message.schema, "ros2msg", text)
            known[stream] = writer.register_channel(row.topic, "cdr", schema), 0
        channel, count = known[stream]
        known[stream] = channel, count + len(ns)
        block = messages(stream, ns, value)
        waiting += [
            (time, channel, data.tobytes(), count + k)
            for k, (time, data) in enumerate(zip(ns.tolist(), block, strict=True))
        ]
    for time, channel, data, number in sorted(waiting, key=lambda entry: entry[0]):
        writer.add_message(channel, time, data, time, number)


def check_ending(path: Path) -> None:
    """Errors: InputError for a file's name of another format than is written."""
    if path.suffix.lower() != ".mcap" and (path.is_file() or not path.exists()):
        raise InputError(f"{path}: what is written is MCAP; give it a name that ends in .mcap.")


def write_twin(recorded: Recording, before: Recording, after: Recording, path: str | Path) -> None:
    """Write what was recorded and, under /before and /after, what two models say was read.

    handcal reads such a file as the recorded one. Errors: HandcalError if it cannot be written.
    """
    _write({"": recorded, TWINS[0]: before, TWINS[1]: after}, path)


def _write(recordings: Mapping[str, Recording], path: str | Path) -> None:
    with begun(path) as writer:
        _write_messages(writer, recordings)
        for name, about in metadata(recordings[""]).items():
            writer.add_metadata(name, about)


def metadata(recording: Recording) -> dict[str, dict[str, str]]:
    """Metadata records of a recording, by name: what it says of the device, the vehicle, and
    by which results it was corrected."""
    out = {}
    if recording.device or recording.model:
        out["device"] = {"id": recording.device, "model": recording.model}
    if recording.vehicle:
        out["vehicle"] = {name: repr(float(v)) for name, v in recording.vehicle.items()}
    if recording.corrected:
        out["corrected"] = dict(recording.corrected)
    return out


def _write_messages(writer: Writer, recordings: Mapping[str, Recording]) -> None:
    """All streams of the recordings, by the beginning of their topics, in the order of time."""
    schemas: dict[str, int] = {}
    channels, stamps, blocks = [], [], []
    streams = [(begin, *stream) for begin, r in recordings.items() for stream in _streams(r)]
    for begin, stream, ns, block in streams:
        message = STREAMS[stream].message
        schema, topic = message.schema, begin + STREAMS[stream].topic
        if schema not in schemas:
            text = message.definition.encode()
            schemas[schema] = writer.register_schema(schema, "ros2msg", text)
        channels.append(writer.register_channel(topic, "cdr", schemas[schema]))
        stamps.append(ns)
        blocks.append(block)
    lengths = [len(ns) for ns in stamps]
    which = np.repeat(np.arange(len(stamps)), lengths)
    row = np.concatenate([np.arange(n) for n in lengths])
    log = np.maximum(np.concatenate(stamps), 0)  # log times have no sign
    for at in np.argsort(log, kind="stable"):
        stream_at, time = int(which[at]), int(log[at])
        data = blocks[stream_at][row[at]].tobytes()
        writer.add_message(channels[stream_at], time, data, time, int(row[at]))


def _streams(recording: Recording) -> Iterator[tuple[str, IntArray, ByteArray]]:
    """Name, stamps and encoded messages of each stream."""
    imu = recording.imu
    ns = recording.start_ns + nanoseconds(imu.t)
    value = np.hstack([imu.gyro, imu.accel])
    yield "imu", ns, _encoded(ns, "imu", _body(STREAMS["imu"], value, imu.valid))
    for stream, series in recording.streams.items():
        ns = recording.start_ns + nanoseconds(series.t)
        yield stream, ns, messages(stream, ns, series.value)


def messages(stream: str, ns: IntArray, value: Array) -> ByteArray:
    """Encoded messages (n, length) of a stream: stamps (n,) ns, values (n, d) as in types.Series,
    of the IMU (n, 6) rates and forces; all of them valid. Errors: HandcalError beyond 2038."""
    valid = np.ones(len(ns), dtype=np.bool_)
    return _encoded(ns, stream, _body(STREAMS[stream], value, valid))


def _body(row: Stream, value: Array, valid: BoolArray) -> Array:
    """The float64 of a stream's messages, (m, k)."""
    message = row.message
    body = np.zeros((len(value), len(message.floats)))
    for name, filled in message.filled.items():
        body[:, message.floats.index(name)] = filled
    body[:, message.index(message.needed)] = value if row.encode is None else row.encode(value)
    body[:, message.index(message.absent)] = np.where(valid, 0.0, -1.0)[:, None]
    return body


def _encoded(ns: IntArray, stream: str, body: Array) -> ByteArray:
    """Messages (n, length) in little-endian CDR: header with stamp and frame, then the body."""
    frame = STREAMS[stream].frame.encode() + b"\0"
    start = body_offset(len(frame))
    block = np.zeros((len(ns), start + body.shape[1] * 8), dtype=np.uint8)
    block[:, 1] = 1
    seconds, rest = np.divmod(ns, 1_000_000_000)
    if np.any(np.abs(seconds) >= 2**31):
        raise HandcalError("ROS stamps end in 2038: this recording's time cannot be written.")
    block[:, 4:8] = seconds.astype("<i4")[:, None].view(np.uint8)
    block[:, 8:12] = rest.astype("<u4")[:, None].view(np.uint8)
    head = struct.pack("<I", len(frame)) + frame
    block[:, 12 : 12 + len(head)] = np.frombuffer(head, dtype=np.uint8)
    block[:, start:] = np.ascontiguousarray(body, dtype="<f8").view(np.uint8)
    return block
