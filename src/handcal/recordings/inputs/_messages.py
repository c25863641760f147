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

from handcal.recordings.streams import Message
from handcal.types import Array, BoolArray, InputError, IntArray

ByteArray = NDArray[np.uint8]


@dataclass(frozen=True)
class Decoded:
    """stamp (n,) ns of the header; value (n, d) the needed fields; valid (n,)."""

    stamp: IntArray
    value: Array
    valid: BoolArray


def schema_key(name: str) -> str:
    """``sensor_msgs/Imu`` and ``sensor_msgs::msg::Imu`` are ``sensor_msgs/msg/Imu``."""
    parts = name.replace("::", "/").split("/")
    return "/".join([parts[0], "msg", parts[1]]) if len(parts) == 2 else "/".join(parts)


def body_offset(frame_length: int) -> int:
    """Where the float64 begin, behind encapsulation (4), stamp (8) and frame_id (4 + length)."""
    return 4 + (12 + frame_length + 7) // 8 * 8


def decode_cdr(block: ByteArray, layout: Message, topic: str) -> Iterator[tuple[IntArray, Decoded]]:
    """Decode a block (n, length) of messages: which of its rows, and their columns.

    Rows that differ in byte order or in the length of frame_id come separately.
    Errors: InputError for what is not that message.
    """
    if block.shape[1] < 16:
        raise InputError(f"A message on {topic} is too short for its schema.")
    if np.any(block[:, 0] != 0) or np.any(block[:, 1] > 1):
        raise InputError(f"A message on {topic} is not encoded as plain CDR.")
    little = block[:, 1] == 1
    lengths = np.where(little, _u32(block, 12, "<"), _u32(block, 12, ">"))
    for is_little, length in set(zip(little.tolist(), lengths.tolist(), strict=True)):
        rows = np.flatnonzero((little == is_little) & (lengths == length))
        yield rows, _decode_same(block[rows], "<" if is_little else ">", length, layout, topic)


def _decode_same(
    block: ByteArray, order: str, frame_length: int, layout: Message, topic: str
) -> Decoded:
    start = body_offset(frame_length)
    end = start + 8 * len(layout.floats)
    if block.shape[1] < end:
        raise InputError(f"A message on {topic} is too short for its schema.")
    body = np.ascontiguousarray(block[:, start:end]).view(f"{order}f8").astype(np.float64)
    seconds = _u32(block, 4, order).astype(np.int32).astype(np.int64)
    stamp = seconds * 1_000_000_000 + _u32(block, 8, order)
    valid = np.all(body[:, layout.index(layout.absent)] != -1, axis=1)
    return Decoded(stamp, body[:, layout.index(layout.needed)], valid)


def _u32(block: ByteArray, at: int, order: str) -> IntArray:
    word = np.ascontiguousarray(block[:, at : at + 4]).view(f"{order}u4")
    return word[:, 0].astype(np.int64)


def joined(parts: list[Decoded]) -> Decoded:
    return Decoded(
        np.concatenate([p.stamp for p in parts]),
        np.concatenate([p.value for p in parts]),
        np.concatenate([p.valid for p in parts]),
    )


def decode_json(message: bytes, layout: Message, topic: str) -> Decoded:
    """Decode one message of a JSON channel. Errors: InputError, naming the field."""
    try:
        tree = json.loads(message)
    except (ValueError, RecursionError) as error:
        raise InputError(f"A message on {topic} is not JSON.") from error
    stamp = _at(tree, "header.stamp")
    ns = 0
    if isinstance(stamp, dict):
        fraction = stamp.get("nanosec", stamp.get("nsec", 0))
        ns = _integer(stamp.get("sec", 0), topic) * 1_000_000_000 + _integer(fraction, topic)
    if abs(ns) > 9e18:
        raise InputError(f"A time stamp on {topic} is further away than 280 years.")
    value = [_number(_at(tree, name), name, topic) for name in layout.needed]
    valid = all(_at(tree, name) != -1 for name in layout.absent)
    return Decoded(
        np.array([ns], dtype=np.int64), np.array([value]), np.array([valid], dtype=np.bool_)
    )


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
