"""Which topic is which stream, and from the topics' messages to a Recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from handcal.inputs._messages import STREAM_SCHEMAS, TWINS, Decoded
from handcal.inputs._options import Options
from handcal.inputs._repair import Columns, assemble, columns
from handcal.types import Array, InputError, IntArray, Recording


@dataclass(frozen=True)
class Part:
    """Some messages of a topic. order (n,): where in the file; log_ns (n,)."""

    order: IntArray
    log_ns: IntArray
    decoded: Decoded


@dataclass(frozen=True)
class Topic:
    """A channel of the file. schema as in STREAM_SCHEMAS; parts: empty if not decoded."""

    name: str
    schema: str
    encoding: str
    parts: tuple[Part, ...]


def recording_from_topics(
    path: Path, topics: Sequence[Topic], options: Options, warnings: tuple[str, ...]
) -> Recording:
    """Assign the topics to streams and assemble them. Errors: InputError."""
    chosen = _chosen(path, topics, options)
    named = {
        stream: _columns([topic for topic in topics if topic.name == name and topic.parts])
        for stream, name in chosen.items()
    }
    factors = [options.factor(*default) for default in (("gyro", "rad/s"), ("accel", "m/s^2"))]
    imu = named.pop("imu")
    gyro = columns(imu.ns, imu.value[:, :3] * factors[0], imu.valid)
    accel = columns(imu.ns, imu.value[:, 3:] * factors[1], imu.valid)
    streams = {}
    for stream, raw in named.items():
        value = raw.value
        if stream == "reference":
            value = value * np.repeat(factors, 3)
        elif stream == "mag":
            value = value * options.factor("mag", "t")
        elif stream == "heading":
            value = _yaw(value)
        elif stream == "pose":
            value = value[:, [0, 1, 2, 6, 3, 4, 5]]
        streams[stream] = columns(raw.ns, value, raw.valid)
    return assemble(path, gyro, accel, streams, warnings)


def _yaw(q_xyzw: Array) -> Array:
    """Yaw of body x (m, 1), rad, of quaternions (m, 4) in the order of ROS, of any length."""
    x, y, z, w = q_xyzw.T
    # Twice the half angle keeps the last bit for a pure yaw, which atan2 of the matrix loses.
    level = (x == 0) & (y == 0)
    yaw = np.arctan2(2 * (x * y + w * z), w * w + x * x - y * y - z * z)
    yaw = np.where(level, 2 * np.arctan2(z, w), yaw)
    yaw = np.where(np.any(q_xyzw != 0, axis=1), yaw, np.nan)
    return yaw[:, None]


def _columns(channels: Sequence[Topic]) -> Columns:
    """The messages of one topic in the order of the file, stamped. Header time, else log time."""
    parts = [part for channel in channels for part in channel.parts]
    order = np.argsort(np.concatenate([p.order for p in parts]), kind="stable")
    stamp = np.concatenate([p.decoded.stamp for p in parts])[order]
    if not stamp.any():
        stamp = np.concatenate([p.log_ns for p in parts])[order]
    value = np.concatenate([p.decoded.value for p in parts])[order]
    return columns(stamp, value, np.concatenate([p.decoded.valid for p in parts])[order])


def _chosen(path: Path, topics: Sequence[Topic], options: Options) -> Mapping[str, str]:
    """Topic by stream. Errors: InputError if there is no IMU, or several that fit."""
    chosen = {s: name for s, name in options.topics.items() if name}
    by_schema: dict[str, list[str]] = {}
    for topic in topics:
        names = by_schema.setdefault(topic.schema, [])
        if topic.parts and topic.name not in names:
            names.append(topic.name)
    for stream, name in chosen.items():
        if name not in by_schema.get(STREAM_SCHEMAS[stream][0], ()):
            raise InputError(
                f"--topic {stream}={name}: {path} has no such topic with messages of "
                f"{STREAM_SCHEMAS[stream][0]}; {_listing(topics)}."
            )
    # What models say was read, beside what was read, is taken only where it is chosen.
    apart = tuple(f"{begin}/" for begin in TWINS)
    # The reference first: what is left of its schema is then more easily the IMU.
    for stream in ("reference", "imu", "heading", "mag", "temperature", "pose"):
        if stream in options.topics:
            continue
        schema, usual = STREAM_SCHEMAS[stream]
        free = [n for n in by_schema.get(schema, ()) if n not in chosen.values()]
        free = [n for n in free if not n.startswith(apart)]
        fitting = _fitting(free, usual, path, stream)
        if fitting is not None:
            chosen[stream] = fitting
    if "imu" not in chosen:
        raise InputError(
            f"{path} has no IMU: no messages of sensor_msgs/msg/Imu in cdr or json; "
            f"{_listing(topics)}."
        )
    return chosen


def _fitting(free: list[str], usual: str, path: Path, stream: str) -> str | None:
    """The one topic for a stream; by its usual name where several have the schema."""
    for named in ([n for n in free if n == usual], [n for n in free if n.endswith(usual)]):
        if len(named) == 1 and (len(free) > 1 or stream != "reference"):
            return named[0]
    if stream == "reference" or not free:
        return None
    if len(free) == 1:
        return free[0]
    raise InputError(
        f"{path} has several topics that could be {stream}: {', '.join(sorted(free))}; "
        f"choose one with --topic {stream}={sorted(free)[0]}."
    )


def _listing(topics: Sequence[Topic]) -> str:
    if not topics:
        return "it holds no topics"
    held = sorted({f"{t.name} ({t.schema or 'no schema'}, {t.encoding})" for t in topics})
    more = f" and {len(held) - 12} more" if len(held) > 12 else ""
    return f"it holds {', '.join(held[:12])}{more}"
