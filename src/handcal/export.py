"""A Recording as an MCAP file with ROS 2 messages, readable by handcal and by ROS tools.

What is written reads back equal: values bit by bit, stamps to the nanosecond. Samples
that are not valid carry the covariance -1 by which ROS says "not measured".
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
from mcap.writer import CompressionType, Writer

from handcal.inputs._messages import LAYOUTS, STREAM_SCHEMAS, TWINS, ByteArray, body_offset
from handcal.inputs._repair import nanoseconds
from handcal.types import Array, BoolArray, HandcalError, IntArray, Recording

# Small chunks, so that a truncated file gives back nearly all it holds.
CHUNK_SIZE = 64 * 1024
_TYPES = {
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
}
_IMU = """std_msgs/Header header
geometry_msgs/Quaternion orientation
float64[9] orientation_covariance
geometry_msgs/Vector3 angular_velocity
float64[9] angular_velocity_covariance
geometry_msgs/Vector3 linear_acceleration
float64[9] linear_acceleration_covariance"""
_MAG = """std_msgs/Header header
geometry_msgs/Vector3 magnetic_field
float64[9] magnetic_field_covariance"""
_DEFINITIONS = {
    "sensor_msgs/msg/Imu": (_IMU, ("Header", "Time", "Quaternion", "Vector3")),
    "sensor_msgs/msg/MagneticField": (_MAG, ("Header", "Time", "Vector3")),
    "sensor_msgs/msg/Temperature": (
        "std_msgs/Header header\nfloat64 temperature\nfloat64 variance",
        ("Header", "Time"),
    ),
    "geometry_msgs/msg/QuaternionStamped": (
        "std_msgs/Header header\ngeometry_msgs/Quaternion quaternion",
        ("Header", "Time", "Quaternion"),
    ),
    "geometry_msgs/msg/PoseStamped": (
        "std_msgs/Header header\ngeometry_msgs/Pose pose",
        ("Header", "Time", "Pose", "Point", "Quaternion"),
    ),
}


def definition(schema: str) -> str:
    """The message definition of a schema with all it refers to, as ROS 2 bags hold it."""
    top, names = _DEFINITIONS[schema]
    parts = [top]
    for full, text in _TYPES.items():
        if full.split("/")[1] in names:
            parts.append(f"MSG: {full}\n{text}")
    return f"\n{'=' * 80}\n".join(parts) + "\n"


def write_mcap(recording: Recording, path: str | Path) -> None:
    """Write the recording. Errors: HandcalError if the file cannot be written."""
    _write({"": recording}, path)


def write_twin(recorded: Recording, before: Recording, after: Recording, path: str | Path) -> None:
    """Write what was recorded and, under /before and /after, what two models say was read.

    handcal reads such a file as the recorded one. Errors: HandcalError if it cannot be written.
    """
    _write({"": recorded, TWINS[0]: before, TWINS[1]: after}, path)


def _write(recordings: Mapping[str, Recording], path: str | Path) -> None:
    try:
        with Path(path).open("wb") as file:
            writer = Writer(file, chunk_size=CHUNK_SIZE, compression=CompressionType.ZSTD)
            writer.start(profile="ros2", library="handcal")
            _write_messages(writer, recordings)
            writer.finish()  # type: ignore[no-untyped-call]
    except OSError as error:
        raise HandcalError(f"{path} cannot be written: {error.strerror or error}.") from error


def _write_messages(writer: Writer, recordings: Mapping[str, Recording]) -> None:
    """All streams of the recordings, by the beginning of their topics, in the order of time."""
    schemas: dict[str, int] = {}
    channels, stamps, blocks = [], [], []
    streams = [(begin, *stream) for begin, r in recordings.items() for stream in _streams(r)]
    for begin, stream, ns, block in streams:
        schema, topic = STREAM_SCHEMAS[stream]
        if schema not in schemas:
            text = definition(schema).encode()
            schemas[schema] = writer.register_schema(schema, "ros2msg", text)
        channels.append(writer.register_channel(begin + topic, "cdr", schemas[schema]))
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
    yield "imu", ns, _encoded(ns, "imu", _imu_body(np.hstack([imu.gyro, imu.accel]), imu.valid))
    for stream, series in recording.streams.items():
        ns = recording.start_ns + nanoseconds(series.t)
        yield stream, ns, _encoded(ns, stream, _body(stream, series.value))


def _body(stream: str, value: Array) -> Array:
    """The float64 of a stream's messages, (m, k)."""
    if stream == "reference":
        return _imu_body(value, np.ones(len(value), dtype=np.bool_))
    if stream == "heading":
        return _quaternions(value[:, 0])
    if stream == "pose":
        return value[:, [0, 1, 2, 4, 5, 6, 3]]
    unknown_covariance = 9 if stream == "mag" else 1
    return np.hstack([value, np.zeros((len(value), unknown_covariance))])


def _imu_body(value: Array, valid: BoolArray) -> Array:
    layout = LAYOUTS["sensor_msgs/msg/Imu"]
    body = np.zeros((len(value), len(layout.floats)))
    body[:, layout.floats.index("orientation.w")] = 1.0
    body[:, layout.floats.index("orientation_covariance.0")] = -1.0
    body[:, layout.index(layout.needed)] = value
    body[:, layout.index(layout.absent)] = np.where(valid, 0.0, -1.0)[:, None]
    return body


def _quaternions(yaw: Array) -> Array:
    """x y z w of pure yaws (m,), chosen so that they read back as the very same number.

    Rounding decides whether they do, so those that do not are tried again with z and w
    moved by a few units in the last place.
    """
    z, w = np.sin(yaw / 2), np.cos(yaw / 2)
    for k in range(31 * 31):
        wrong = 2 * np.arctan2(z, w) != yaw
        if not wrong.any():
            break
        z = np.where(wrong, np.sin(yaw / 2) * (1 - k % 31 * 2.0**-53), z)
        w = np.where(wrong, np.cos(yaw / 2) * (1 - k // 31 * 2.0**-53), w)
    return np.column_stack([np.zeros_like(z), np.zeros_like(z), z, w])


def _encoded(ns: IntArray, stream: str, body: Array) -> ByteArray:
    """Messages (n, length) in little-endian CDR: header with stamp and frame, then the body."""
    frame = (b"world" if stream == "pose" else b"map" if stream == "heading" else b"imu") + b"\0"
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
