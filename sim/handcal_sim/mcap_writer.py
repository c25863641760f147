"""A simulated world as an MCAP file: ROS 2 messages, and the truth beside them.

The same world gives the same bytes: time starts at a fixed moment, and no clock is read.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from mcap.writer import CompressionType, Writer
from numpy.typing import NDArray

from handcal_sim import ros
from handcal_sim.aiding import quaternion
from handcal_sim.profiles import Array
from handcal_sim.scenario import Stream, World

START_NS = 1_760_000_000 * 1_000_000_000
_CHUNK_BYTES = 64 * 1024

# stream: its topic's schema and frame; all are published under the stream's name.
_STREAMS = {
    "imu": ("sensor_msgs/msg/Imu", "imu"),
    "heading": ("geometry_msgs/msg/QuaternionStamped", "map"),
    "mag": ("sensor_msgs/msg/MagneticField", "imu"),
    "temperature": ("sensor_msgs/msg/Temperature", "imu"),
    "pose": ("geometry_msgs/msg/PoseStamped", "world"),
    "reference": ("sensor_msgs/msg/Imu", "reference"),
    "truth/pose": ("geometry_msgs/msg/PoseStamped", "map"),
    "truth/imu": ("sensor_msgs/msg/Imu", "imu"),
}


def write(world: World, path: str | Path, *, truth: bool = True) -> int:
    """Writes the recording, with its truth unless told; returns the number of messages."""
    messages = sorted(
        (
            (int(stamp), order, name, data)
            for order, (name, stamps, payload) in enumerate(_payloads(world, truth))
            for stamp, data in zip(
                stamps, ros.encode(stamps, _STREAMS[name][1], payload), strict=True
            )
        ),
        key=lambda message: message[:2],
    )
    with Path(path).open("wb") as file:
        writer = Writer(file, chunk_size=_CHUNK_BYTES, compression=CompressionType.ZSTD)
        writer.start(profile="ros2", library="handcal simulate")
        if truth:
            _write_parameters(writer, world)
        channels = _register(writer, {name for _, _, name, _ in messages})
        count = dict.fromkeys(channels, 0)
        for stamp, _, name, data in messages:
            writer.add_message(channels[name], stamp, data, stamp, count[name])
            count[name] += 1
        writer.finish()  # type: ignore[no-untyped-call]
    return len(messages) + int(truth)


def _payloads(world: World, truth: bool) -> Iterator[tuple[str, NDArray[np.int64], Array]]:
    streams = {"imu": world.imu, **world.streams}
    if truth:
        true = world.truth
        true_pose = np.hstack([true.position, quaternion(true.C_nb)])
        streams["truth/pose"] = Stream(world.imu.stamps, true_pose)
        streams["truth/imu"] = Stream(world.imu.stamps, np.hstack([true.omega, true.f]))
    for name, stream in streams.items():
        stamps = START_NS + np.rint(stream.stamps * 1e9).astype(np.int64)
        yield name, stamps, _payload(name, stream.values)


def _payload(name: str, values: Array) -> Array:
    if _STREAMS[name][0] == "sensor_msgs/msg/Imu":
        return ros.imu(values)
    if name == "heading":
        return ros.heading(values)
    with_variances = {"mag": 12, "temperature": 2}
    return ros.padded(values, with_variances[name]) if name in with_variances else values


def _register(writer: Writer, names: set[str]) -> dict[str, int]:
    schemas: dict[str, int] = {}
    channels = {}
    for name, (schema, _) in _STREAMS.items():
        if name not in names:
            continue
        if schema not in schemas:
            schemas[schema] = writer.register_schema(
                schema, "ros2msg", ros.SCHEMAS[schema].encode()
            )
        channels[name] = writer.register_channel(f"/{name}", "cdr", schemas[schema])
    return channels


def _write_parameters(writer: Writer, world: World) -> None:
    schema = writer.register_schema("handcal_sim/Parameters", "jsonschema", b'{"type": "object"}')
    channel = writer.register_channel("/truth/parameters", "json", schema)
    data = json.dumps(dict(world.parameters), allow_nan=False).encode()
    writer.add_message(channel, START_NS, data, START_NS)
