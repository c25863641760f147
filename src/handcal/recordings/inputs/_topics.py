"""Which topic is which stream, and from the topics' messages to a Recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from handcal.recordings.inputs._messages import (
    POSE_LIKE,
    ByteArray,
    Decoded,
    Part,
    Topic,
    decode_cdr,
    decode_json,
    decode_ros1,
    joined,
    read_as,
)
from handcal.recordings.inputs._options import ALONE, HALVES, Options
from handcal.recordings.inputs._repair import Columns, assemble, assemble_alone, columns
from handcal.recordings.inputs._which_topic import by_stream, chosen_topics, imu_topics
from handcal.recordings.streams import STREAMS, Stream, message_of
from handcal.types import Array, BoolArray, InputError, IntArray, Recording

# What Imu.msg calls the two sensors, in the order of ``absent`` of its row.
_SENSORS = (("angular velocity", "angular_velocity"), ("acceleration", "linear_acceleration"))


def readable(topic: Topic) -> bool:
    """Whether a stream could be made of its messages; what a simulator knows is none."""
    return message_of(read_as(topic.schema)) is not None and not topic.name.startswith("/truth/")


def parts_of(
    buffer: ByteArray,
    starts: IntArray,
    lengths: IntArray,
    log_ns: IntArray,
    order: IntArray,
    topic: Topic,
) -> list[Part]:
    """Messages of a topic that lie in a buffer, decoded; order (n,): by which they follow each
    other in the file.

    Empty where nothing reads that schema or encoding. Errors: InputError.
    """
    layout = message_of(read_as(topic.schema))
    if layout is None:
        return []
    if topic.encoding == "json":
        texts = [buffer[s : s + n].tobytes() for s, n in zip(starts, lengths, strict=True)]
        nested = topic.schema in POSE_LIKE
        decoded = joined([decode_json(text, layout, topic.name, nested) for text in texts])
        return [Part(order, log_ns, decoded)]
    if topic.encoding not in ("cdr", "bag"):
        return []
    decode = decode_cdr if topic.encoding == "cdr" else decode_ros1
    parts = []
    for length in np.unique(lengths):
        same = np.flatnonzero(lengths == length)
        block = rows_of(buffer, starts[same], int(length))
        for rows, decoded in decode(block, layout, topic.name, POSE_LIKE.get(topic.schema, 0)):
            of = same[rows]
            parts.append(Part(order[of], log_ns[of], decoded))
    return parts


def rows_of(buffer: ByteArray, starts: IntArray, length: int) -> ByteArray:
    """The bytes (n, length) that begin at ``starts`` (n,), copied message by message."""
    return np.lib.stride_tricks.sliding_window_view(buffer, length)[starts]


def recording_from_topics(
    path: Path, topics: Sequence[Topic], options: Options, warnings: tuple[str, ...]
) -> Recording:
    """Assign the topics to streams and assemble them. Errors: InputError."""
    chosen, said = chosen_topics(path, topics, options)
    messages = {stream: in_order(own) for stream, own in by_stream(chosen, topics).items()}
    imu = messages.pop("imu")
    value = imu.value * _factors(STREAMS["imu"], options)
    where = {**chosen, "imu": " + ".join(imu_topics(chosen))}
    streams = {}
    for stream, raw in messages.items():
        row = STREAMS[stream]
        others = raw.value if row.decode is None else row.decode(raw.value)
        if row.quantities:
            others = others * _factors(row, options)
        streams[stream] = columns(raw.stamp, others, np.logical_not(raw.lacking.any(axis=1)))
    alone = _alone(imu.lacking, options)
    if alone is not None:
        own = columns(imu.stamp, value[:, 3 * alone : 3 * alone + 3], ~imu.lacking[:, alone])
        made = assemble_alone(path, HALVES[alone], own, streams, (*warnings, *said))
    else:
        gyro, accel, flagged = both_sensors(path, where["imu"], imu.stamp, value, imu.lacking)
        made = assemble(path, gyro, accel, streams, (*warnings, *said, *flagged))
    return replace(made, topics={n: where[n] for n in ("imu", *streams) if n in where})


def _alone(lacking: BoolArray, options: Options) -> int | None:
    """Which of gyro and accelerometer there is alone, the other being one that is not needed."""
    none = lacking.all(axis=0)
    if none.sum() != 1 or HALVES[int(np.argmax(none))] in options.needs:
        return None
    return int(np.argmin(none))


def both_sensors(
    path: Path, topic: str, ns: IntArray, value: Array, lacking: BoolArray
) -> tuple[Columns, Columns, tuple[str, ...]]:
    """Gyro and accelerometer of messages (n, 6), and warnings. lacking (n, 2): the message says
    that it holds no reading of that sensor. Errors: InputError where all say so of one."""
    for k, (kind, field) in enumerate(_SENSORS):
        if len(ns) and lacking[:, k].all():
            raise InputError(
                f"{path}: all {len(ns)} messages of {topic} say that they hold no {kind} "
                f"({field}_covariance[0] is -1, or it is zero throughout). Where another topic "
                f"does, choose it with --topic {HALVES[k]}=TOPIC. {ALONE}"
            )
    if len(ns) and lacking.any(axis=1).all():  # (they take turns)
        rate, force = ~lacking.T
        return columns(ns, value[:, :3]).rows(rate), columns(ns, value[:, 3:]).rows(force), ()
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
