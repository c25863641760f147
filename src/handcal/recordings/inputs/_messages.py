"""ROS messages decoded, from CDR or JSON; ``streams`` says which there are.

A block is all messages of one topic and one length, one message a row, so that decoding
is slicing. CDR aligns to the start of the payload, 4 bytes after the start of the message.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from handcal.recordings.streams import POSE, Message
from handcal.types import Array, BoolArray, InputError, IntArray

ByteArray = NDArray[np.uint8]

# To how many bytes CDR aligns lengths and numbers.
ALIGNED = 4, 8
# Messages that begin as a stamped pose does, but for so many strings behind the header.
POSE_LIKE = {
    "nav_msgs/msg/Odometry": 1,
    "geometry_msgs/msg/TransformStamped": 1,
    "geometry_msgs/msg/PoseWithCovarianceStamped": 0,
}


@dataclass(frozen=True)
class Decoded:
    """stamp (n,) ns of the header; value (n, d) the needed fields; lacking (n, k): of each field
    of ``absent``, whether it says that there is no reading."""

    stamp: IntArray
    value: Array
    lacking: BoolArray


def schema_key(name: str) -> str:
    """``sensor_msgs/Imu`` and ``sensor_msgs::msg::Imu`` are ``sensor_msgs/msg/Imu``."""
    parts = name.replace("::", "/").split("/")
    return "/".join([parts[0], "msg", parts[1]]) if len(parts) == 2 else "/".join(parts)


def body_offset(frame_length: int) -> int:
    """Where the float64 begin, behind encapsulation (4), stamp (8) and frame_id (4 + length)."""
    return 4 + (12 + frame_length + 7) // 8 * 8


def read_as(schema: str) -> str:
    """The schema of whose stream a message can be one: odometry holds a stamped pose."""
    return POSE.schema if schema in POSE_LIKE else schema


def decode_cdr(
    block: ByteArray, layout: Message, topic: str, strings: int = 0
) -> Iterator[tuple[IntArray, Decoded]]:
    """Decode a block (n, length) of messages: which of its rows, and their columns.

    strings: how many there are between header and numbers. Rows that differ in byte order or in
    the length of a string come separately. Errors: InputError for what is not that message.
    """
    if block.shape[1] < 16:
        raise InputError(f"A message on {topic} is too short for its schema.")
    if np.any(block[:, 0] != 0) or np.any(block[:, 1] > 1):
        raise InputError(f"A message on {topic} is not encoded as plain CDR.")
    for marker, order in ((1, "<"), (0, ">")):
        same = np.flatnonzero(block[:, 1] == marker)
        for rows, start in starts(block[same], order, strings, ALIGNED, topic):
            yield same[rows], _decode_same(block[same[rows]], order, start, layout, topic)


def decode_ros1(
    block: ByteArray, layout: Message, topic: str, strings: int = 0
) -> Iterator[tuple[IntArray, Decoded]]:
    """The same of ROS 1: little endian, nothing aligned, a counter where CDR has its own head."""
    if block.shape[1] < 16:
        raise InputError(f"A message on {topic} is too short for its schema.")
    for rows, start in starts(block, "<", strings, (1, 1), topic):
        yield rows, _decode_same(block[rows], "<", start, layout, topic)


def starts(
    block: ByteArray, order: str, strings: int, aligned: tuple[int, int], topic: str
) -> Iterator[tuple[IntArray, int]]:
    """Rows alike in the lengths of their strings, frame_id the first, and where numbers begin.

    aligned: to how many bytes lengths and numbers are, counted behind the first four.
    """
    groups = [(np.arange(len(block)), 12)] if len(block) else []
    for _ in range(1 + strings):
        longer = []
        for rows, end in groups:
            at = 4 + -(-(end - 4) // aligned[0]) * aligned[0]
            if block.shape[1] < at + 4:
                raise InputError(f"A message on {topic} is too short for its schema.")
            lengths = _u32(block[:, at : at + 4][rows], 0, order)
            longer += [(rows[lengths == n], at + 4 + n) for n in np.unique(lengths).tolist()]
        groups = longer
    yield from ((rows, 4 + -(-(end - 4) // aligned[1]) * aligned[1]) for rows, end in groups)


def _decode_same(block: ByteArray, order: str, start: int, layout: Message, topic: str) -> Decoded:
    """Messages whose numbers begin at the same place."""
    end = start + 8 * len(layout.floats)
    if block.shape[1] < end:
        raise InputError(f"A message on {topic} is too short for its schema.")
    body = np.ascontiguousarray(block[:, start:end]).view(f"{order}f8").astype(np.float64)
    seconds = _u32(block, 4, order).astype(np.int32).astype(np.int64)
    stamp = seconds * 1_000_000_000 + _u32(block, 8, order)
    lacking = body[:, layout.index(layout.absent)] == -1
    return Decoded(stamp, body[:, layout.index(layout.needed)], lacking)


def _u32(block: ByteArray, at: int, order: str) -> IntArray:
    word = np.ascontiguousarray(block[:, at : at + 4]).view(f"{order}u4")
    return word[:, 0].astype(np.int64)


def joined(parts: list[Decoded]) -> Decoded:
    return Decoded(
        np.concatenate([p.stamp for p in parts]),
        np.concatenate([p.value for p in parts]),
        np.concatenate([p.lacking for p in parts]),
    )


def decode_json(message: bytes, layout: Message, topic: str, nested: bool = False) -> Decoded:
    """Decode one message of a JSON channel; nested: its pose has another in it, with covariance.
    Errors: InputError, naming the field."""
    try:
        tree = json.loads(message)
    except (ValueError, RecursionError) as error:
        raise InputError(f"A message on {topic} is not JSON.") from error
    if nested and isinstance(tree, dict):
        tree = {"header": tree.get("header"), "pose": _at(tree, "pose.pose")}
    stamp = _at(tree, "header.stamp")
    ns = 0
    if isinstance(stamp, dict):
        fraction = stamp.get("nanosec", stamp.get("nsec", 0))
        ns = _integer(stamp.get("sec", 0), topic) * 1_000_000_000 + _integer(fraction, topic)
    if abs(ns) > 9e18:
        raise InputError(f"A time stamp on {topic} is further away than 280 years.")
    value = [_number(_at(tree, name), name, topic) for name in layout.needed]
    lacking = np.array([[_at(tree, name) == -1 for name in layout.absent]], dtype=np.bool_)
    return Decoded(np.array([ns], dtype=np.int64), np.array([value]), lacking)


def _at(tree: object, path: str) -> object:
    for part in path.split("."):
        if isinstance(tree, dict):
            tree = tree.get(part)
        elif isinstance(tree, list) and part.isdigit() and int(part) < len(tree):
            tree = tree[int(part)]
        else:
            return None
    return tree


def _number(value: object, name: str, topic: str) -> float:
    """JSON has no NaN: some writers put the word."""
    if value == "NaN":
        return math.nan
    if isinstance(value, int | float):
        try:
            return float(value)
        except OverflowError:
            return math.inf
    raise InputError(f"A message on {topic} has no number at {name}.")


def _integer(value: object, topic: str) -> int:
    if isinstance(value, int) and abs(value) < 10**18:
        return value
    raise InputError(f"A message on {topic} has no whole number in header.stamp.")


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
