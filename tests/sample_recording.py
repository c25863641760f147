"""A small recording that is physically consistent, for the tests of readers and writer."""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
from mcap.writer import CompressionType, Writer

from handcal.types import Imu, Recording, Series

START_NS = 1_700_000_000_123_456_789


def sample(
    seed: int = 0, *, n: int = 400, rate_hz: float = 100.0, streams: bool = True
) -> Recording:
    """Rest, then turning about all axes, with a jittering clock; all streams if asked."""
    rng = np.random.default_rng(seed)
    jitter = rng.integers(-500_000, 500_000, n)
    ns = np.arange(n) * round(1e9 / rate_hz) + jitter
    t = (ns - ns[0]) / 1e9
    amplitude, phase = rng.uniform(1.0, 3.0, 3), rng.uniform(0, 6, 3)
    moving = np.clip((t - 0.8) / 0.3, 0, 1)[:, None]
    omega = moving * amplitude * np.sin(t[:, None] * 3.0 + phase)
    up = [(0.0, 0.6, 0.8)]
    for a, b, c in 0.5 * (omega[:-1] + omega[1:]) * np.diff(t)[:, None]:
        x, y, z = up[-1]
        turned = x - b * z + c * y, y - c * x + a * z, z - a * y + b * x
        up.append(tuple(v / math.hypot(*turned) for v in turned))
    gyro = omega + rng.normal(0, 1e-3, (n, 3))
    accel = 9.80665 * np.array(up) + rng.normal(0, 1e-2, (n, 3))
    imu = Imu(t, gyro, accel, np.ones(n, dtype=np.bool_))
    further = {}
    if streams:
        slow = t[::7]
        q = np.array([1.0, 0, 0, 0]) + np.cumsum(rng.normal(0, 0.05, (len(slow), 4)), axis=0)
        q /= np.linalg.norm(q, axis=1)[:, None]
        further = {
            "heading": Series(slow, rng.uniform(-np.pi, np.pi, (len(slow), 1))),
            "mag": Series(slow, rng.normal(0, 3e-5, (len(slow), 3))),
            "temperature": Series(slow, rng.normal(25, 1, (len(slow), 1))),
            "pose": Series(slow, np.hstack([rng.normal(0, 1, (len(slow), 3)), q])),
            "reference": Series(t, np.hstack([gyro, accel]) + rng.normal(0, 1e-3, (n, 6))),
        }
    return Recording("sample", imu, further, START_NS)


def write_channels(
    path: Path,
    channels: list[tuple[str, str, str]],
    messages: list[tuple[int, int, bytes]],
    *,
    compression: CompressionType = CompressionType.ZSTD,
    chunk_size: int = 8192,
    use_chunking: bool = True,
    data_crc: bool = False,
    crcs: bool = True,
) -> Path:
    """An MCAP of (topic, schema, encoding) channels and (channel, log time, data) messages."""
    with path.open("wb") as file:
        writer = Writer(
            file,
            chunk_size=chunk_size,
            compression=compression,
            use_chunking=use_chunking,
            enable_data_crcs=data_crc,
            enable_crcs=crcs,
        )
        writer.start(profile="ros2", library="test")
        ids = []
        for topic, schema, encoding in channels:
            kind = "jsonschema" if encoding == "json" else "ros2msg"
            schema_id = writer.register_schema(schema, kind, b"")
            ids.append(writer.register_channel(topic, encoding, schema_id))
        for channel, log_time, data in messages:
            writer.add_message(ids[channel], log_time, data, log_time)
        writer.finish()
    return path


def edited(path: Path, change: Callable[[bytearray], None]) -> Path:
    """The file with its bytes changed in place."""
    data = bytearray(path.read_bytes())
    change(data)
    path.write_bytes(data)
    return path


IMU, POSE = "sensor_msgs/msg/Imu", "geometry_msgs/msg/PoseStamped"
QUATERNION = "geometry_msgs/msg/QuaternionStamped"
Message = tuple[int, int, bytes]


def cdr(ns: int, floats: list[float], order: str = "<", frame: bytes = b"imu") -> bytes:
    """A stamped message, packed field by field."""
    head = struct.pack(f"{order}iII", ns // 10**9, ns % 10**9, len(frame) + 1) + frame + b"\0"
    head += b"\0" * (-len(head) % 8)
    return bytes([0, order == "<", 0, 0]) + head + struct.pack(f"{order}{len(floats)}d", *floats)


def imu_floats(gyro: np.ndarray, accel: np.ndarray) -> list[float]:
    return [0, 0, 0, 1, -1, *[0] * 8, *gyro.tolist(), *[0] * 9, *accel.tolist(), *[0] * 9]


def imu_messages(
    recording: Recording, channel: int = 0, order: str = "<", frame: bytes = b"imu"
) -> list[Message]:
    stamps = START_NS + np.rint(recording.imu.t * 1e9).astype(np.int64)
    rows = zip(stamps.tolist(), recording.imu.gyro, recording.imu.accel, strict=True)
    return [(channel, ns, cdr(ns, imu_floats(g, f), order, frame)) for ns, g, f in rows]


def imu_json(recording: Recording, stamped: bool = True) -> list[Message]:
    stamps = START_NS + np.rint(recording.imu.t * 1e9).astype(np.int64)
    messages = []
    for ns, g, f in zip(stamps.tolist(), recording.imu.gyro, recording.imu.accel, strict=True):
        tree: dict[str, object] = {
            "angular_velocity": dict(zip("xyz", g.tolist(), strict=True)),
            "linear_acceleration": dict(zip("xyz", f.tolist(), strict=True)),
        }
        if stamped:
            tree["header"] = {"stamp": {"sec": ns // 10**9, "nanosec": ns % 10**9}}
        messages.append((0, ns, json.dumps(tree).encode()))
    return messages
