"""Which topic is which stream, and from the topics' messages to a Recording."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from handcal.recordings.inputs._messages import (
    POSE_LIKE,
    ByteArray,
    Decoded,
    decode_cdr,
    decode_json,
    decode_ros1,
    joined,
    read_as,
)
from handcal.recordings.inputs._options import Options
from handcal.recordings.inputs._repair import Columns, assemble, columns
from handcal.recordings.streams import STREAMS, TWINS, Stream, message_of
from handcal.types import Array, BoolArray, InputError, IntArray, Recording

# What Imu.msg calls the two sensors, in the order of ``absent`` of its row.
_SENSORS = (("angular velocity", "angular_velocity"), ("acceleration", "linear_acceleration"))
# Of a name that says so: before a driver took anything off.
_RAW = re.compile(r"(^|[/_.-])raw($|[/_.-])")


@dataclass(frozen=True)
class Part:
    """Some messages of a topic. order (n,): where in the file; log_ns (n,)."""

    order: IntArray
    log_ns: IntArray
    decoded: Decoded


@dataclass(frozen=True)
class Topic:
    """A channel of the file. schema as in a row of STREAMS; parts: empty if not decoded."""

    name: str
    schema: str
    encoding: str
    parts: tuple[Part, ...]


def readable(topic: Topic) -> bool:
    """Whether a stream could be made of its messages; what a simulator knows is none."""
    return message_of(read_as(topic.schema)) is not None and not topic.name.startswith("/truth/")


def parts_of(
    buffer: ByteArray,
    starts: IntArray,
    lengths: IntArray,
    log_ns: IntArray,
    base: int,
    topic: Topic,
) -> list[Part]:
    """Messages of a topic that lie in a buffer, decoded; base: where in the file it begins.

    Empty where nothing reads that schema or encoding. Errors: InputError.
    """
    layout = message_of(read_as(topic.schema))
    if layout is None:
        return []
    if topic.encoding == "json":
        texts = [buffer[s : s + n].tobytes() for s, n in zip(starts, lengths, strict=True)]
        nested = topic.schema in POSE_LIKE
        decoded = joined([decode_json(text, layout, topic.name, nested) for text in texts])
        return [Part(base + starts, log_ns, decoded)]
    if topic.encoding not in ("cdr", "bag"):
        return []
    decode = decode_cdr if topic.encoding == "cdr" else decode_ros1
    parts = []
    for length in np.unique(lengths):
        same = np.flatnonzero(lengths == length)
        block = rows_of(buffer, starts[same], int(length))
        for rows, decoded in decode(block, layout, topic.name, POSE_LIKE.get(topic.schema, 0)):
            of = same[rows]
            parts.append(Part(base + starts[of], log_ns[of], decoded))
    return parts


def rows_of(buffer: ByteArray, starts: IntArray, length: int) -> ByteArray:
    """The bytes (n, length) that begin at ``starts`` (n,), copied message by message."""
    return np.lib.stride_tricks.sliding_window_view(buffer, length)[starts]


def recording_from_topics(
    path: Path, topics: Sequence[Topic], options: Options, warnings: tuple[str, ...]
) -> Recording:
    """Assign the topics to streams and assemble them. Errors: InputError."""
    chosen, said = chosen_topics(path, topics, options)
    held = {
        stream: [topic for topic in topics if topic.name == name and topic.parts]
        for stream, name in chosen.items()
    }
    messages = {stream: in_order(channels) for stream, channels in held.items()}
    imu = messages.pop("imu")
    value = imu.value * _factors(STREAMS["imu"], options)
    gyro, accel, flagged = both_sensors(path, chosen["imu"], imu.stamp, value, imu.lacking)
    streams = {}
    for stream, raw in messages.items():
        row = STREAMS[stream]
        value = raw.value if row.decode is None else row.decode(raw.value)
        if row.quantities:
            value = value * _factors(row, options)
        streams[stream] = columns(raw.stamp, value, np.logical_not(raw.lacking.any(axis=1)))
    made = assemble(path, gyro, accel, streams, (*warnings, *said, *flagged))
    return replace(made, topics={n: chosen[n] for n in ("imu", *streams) if n in chosen})


def both_sensors(
    path: Path, topic: str, ns: IntArray, value: Array, lacking: BoolArray
) -> tuple[Columns, Columns, tuple[str, ...]]:
    """Gyro and accelerometer of messages (n, 6), and warnings. lacking (n, 2): the message says
    that it holds no reading of that sensor. Errors: InputError where all say so of one."""
    for k, (kind, field) in enumerate(_SENSORS):
        if len(ns) and lacking[:, k].all():
            raise InputError(
                f"{path}: all {len(ns)} messages of {topic} say that they hold no {kind} "
                f"({field}_covariance[0] is -1)."
            )
    if len(ns) and lacking.any(axis=1).all():  # (they take turns)
        rate, force = ~lacking.T
        gyro, accel = columns(ns[rate], value[rate, :3]), columns(ns[force], value[force, 3:])
        return gyro, accel, ()
    valid = np.logical_not(lacking.any(axis=1))
    parts = [(none, kind) for none, (kind, _) in zip(lacking.T, _SENSORS, strict=True)]
    if np.array_equal(*lacking.T):
        parts = [(lacking[:, 0], "reading")]
    said = tuple(
        f"{int(none.sum())} of {len(ns)} messages of {topic} say that they hold no {kind} "
        "(covariance -1) and are not trusted."
        for none, kind in parts
        if none.any()
    )
    return columns(ns, value[:, :3], valid), columns(ns, value[:, 3:], valid), said


def _factors(row: Stream, options: Options) -> Array:
    """From the file's units to SI, of each column."""
    factors = [options.factor(quantity) for quantity in row.quantities]
    return np.repeat(factors, len(row.columns) // len(factors))


def in_order(channels: Sequence[Topic]) -> Decoded:
    """The messages of one topic in the order of the file. Stamped by header time, else log time."""
    parts = [part for channel in channels for part in channel.parts]
    order = np.argsort(np.concatenate([p.order for p in parts]), kind="stable")
    whole = joined([p.decoded for p in parts])
    stamp = whole.stamp if whole.stamp.any() else np.concatenate([p.log_ns for p in parts])
    return Decoded(stamp[order], whole.value[order], whole.lacking[order])


def chosen_topics(
    path: Path, topics: Sequence[Topic], options: Options
) -> tuple[Mapping[str, str], list[str]]:
    """Topic by stream, and where there was a choice, what was taken. Errors: InputError if there
    is no IMU, or several that fit."""
    said: list[str] = []
    chosen = {s: name for s, name in options.topics.items() if name}
    by_schema: dict[str, list[str]] = {}
    exact = {topic.schema for topic in topics if topic.parts}
    for topic in topics:
        schema = read_as(topic.schema)
        # What only holds a pose is one where there is no better, or where it is chosen.
        if schema != topic.schema and schema in exact and topic.name not in chosen.values():
            continue
        names = by_schema.setdefault(schema, [])
        if topic.parts and topic.name not in names:
            names.append(topic.name)
    for stream, name in chosen.items():
        schema = STREAMS[stream].message.schema
        if name not in by_schema.get(schema, ()):
            raise InputError(
                f"--topic {stream}={name}: {path} has no such topic with messages of "
                f"{schema}; {_listing(topics)}."
            )
    # What models say was read, beside what was read, is taken only where it is chosen.
    apart = tuple(f"{begin}/" for begin in TWINS)
    # Those with a name first: what is left of their schema is then more easily the other.
    for row in sorted(STREAMS.values(), key=lambda row: not row.named):
        if row.name in options.topics:
            continue
        free = [n for n in by_schema.get(row.message.schema, ()) if n not in chosen.values()]
        free = [n for n in free if not n.startswith(apart)]
        fitting = _fitting(free, row, path)
        if fitting is not None:
            chosen[row.name] = fitting
            said += _choice(row, fitting, free, topics)
    if "imu" not in chosen:
        raise InputError(
            f"{path} has no IMU: no messages of sensor_msgs/msg/Imu in cdr or json; "
            f"{_listing(topics)}."
        )
    return chosen, said


def _choice(row: Stream, taken: str, free: list[str], topics: Sequence[Topic]) -> list[str]:
    """Which of several topics was taken for a stream, and why."""
    if row.named or len(free) < 2:
        return []

    def sized(name: str) -> str:
        parts = [part for topic in topics if topic.name == name for part in topic.parts]
        return f"{name} ({sum(len(part.order) for part in parts)} messages)"

    why = "its usual name" if taken.endswith(row.topic) else "the raw one"
    others = sorted(name for name in free if name != taken)
    return [
        f"{row.title}: of {len(free)} topics {sized(taken)} was taken, {why}; there "
        f"{'are' if len(others) > 1 else 'is'} also {', '.join(map(sized, others))}; choose with "
        f"--topic {row.name}={others[0]}."
    ]


def _fitting(free: list[str], row: Stream, path: Path) -> str | None:
    """The one topic for a stream; by its usual name where several have the schema, else raw."""
    usual, spare = row.topic, row.named and row.inertial  # (there must be one for the IMU)
    for named in ([n for n in free if n == usual], [n for n in free if n.endswith(usual)]):
        if len(named) == 1 and (len(free) > 1 or not spare):
            return named[0]
    if row.named or not free:
        return None
    raw = [n for n in free if _RAW.search(n)]
    if len(free) == 1 or len(raw) == 1:
        return (raw or free)[0]
    raise InputError(
        f"{path} has several topics that could be {row.name}: {', '.join(sorted(free))}; "
        f"choose one with --topic {row.name}={sorted(free)[0]}."
    )


def _listing(topics: Sequence[Topic]) -> str:
    if not topics:
        return "it holds no topics"
    held = sorted({f"{t.name} ({t.schema or 'no schema'}, {t.encoding})" for t in topics})
    more = f" and {len(held) - 12} more" if len(held) > 12 else ""
    return f"it holds {', '.join(held[:12])}{more}"
