"""`apply` to a ROS 2 bag writes the same bag: but for corrected fields, and the stamps of what was
late, every byte is as rosbags and mcap read it of the original."""

from __future__ import annotations

import json
import sqlite3
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from format_files import messages
from mcap.reader import make_reader
from mcap.writer import Writer as McapWriter
from sample_recording import START_NS, sample
from test_apply import main, written

import handcal
from handcal.device import apply as device
from handcal.recordings.export import write_mcap
from handcal.recordings.inputs import load
from handcal.types import Recording

IMU, SECOND, MAG, FRAME = "/robot/imu/data_raw", "/robot/imu/data", "/mag", "imu_link"
KIND = {IMU: "sensor_msgs/msg/Imu", MAG: "sensor_msgs/msg/MagneticField"}
LATE = 1_500_000  # ns from stamp to log time
DELAY = 0.012

main = main


def parameters(effect: str, names: Sequence[str], values: Sequence[float]) -> list[dict[str, Any]]:
    pairs = zip(names, values, strict=True)
    return [{"effect": effect, "name": name, "value": value} for name, value in pairs]


FOUND = [
    *parameters("gyro_scale", "xyz", [0.01, -0.02, 0.03]),
    *parameters("accel_scale", "xyz", [0.02, 0.01, -0.01]),
    *parameters("accel_delay", ["delay"], [DELAY]),
]
ON_MAG = parameters("mag_hard_iron", "xyz", [1e-5, -2e-5, 3e-5])


def rows(recording: Recording, types: Any) -> list[tuple[str, str, int, object]]:
    """Topic, type, log time and message: an IMU with orientation and covariances filled in, a
    second one, a magnetometer, /tf and text."""
    made = types.types
    quaternion = made["geometry_msgs/msg/Quaternion"](0.1, 0.2, 0.3, 0.927)
    filled = {
        name: np.arange(1.0, 10.0) * scale
        for name, scale in (("orientation_covariance", 0.01),
                            ("angular_velocity_covariance", 1e-6),
                            ("linear_acceleration_covariance", 2e-3))
    }  # fmt: skip
    out: list[tuple[str, str, int, object]] = []
    for topic, kind, ns, message in messages(recording, types):
        header = replace(message.header, frame_id=FRAME)  # type: ignore[attr-defined]
        message = replace(message, header=header)  # type: ignore[type-var]
        if topic == "/phone/imu":
            message = replace(message, orientation=quaternion, **filled)  # type: ignore[type-var]
            out.append((SECOND, kind, ns + LATE + 7, message))
            topic = IMU
        out.append((topic, kind, ns + LATE, message))
    transform = made["geometry_msgs/msg/Transform"](
        made["geometry_msgs/msg/Vector3"](1.0, 2.0, 3.0), quaternion
    )
    for k in range(20):
        ns = START_NS + k * 10**8
        stamp = made["builtin_interfaces/msg/Time"](ns // 10**9, ns % 10**9)
        head = made["std_msgs/msg/Header"](stamp=stamp, frame_id="odom")
        one = made["geometry_msgs/msg/TransformStamped"](head, "base_link", transform)
        text = made["std_msgs/msg/String"](f"hello {k}")
        out.append(("/tf", "tf2_msgs/msg/TFMessage", ns, made["tf2_msgs/msg/TFMessage"]([one])))
        out.append(("/chatter", "std_msgs/msg/String", ns + 1, text))
    return sorted(out, key=lambda row: row[2])


def bag(path: Path, recording: Recording, storage: str) -> Path:
    """A folder, by the package rosbags."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    types, known = get_typestore(Stores.ROS2_HUMBLE), {}
    with Writer(path, version=9, storage_plugin=StoragePlugin[storage]) as writer:
        for topic, kind, ns, message in rows(recording, types):
            if topic not in known:
                known[topic] = writer.add_connection(topic, kind, typestore=types)
            writer.write(known[topic], ns, bytes(types.serialize_cdr(message, kind)))
    return path


@dataclass(frozen=True)
class Held:
    """What a bag holds: messages (log time, data) by topic and type, and the types' definitions."""

    messages: Mapping[tuple[str, str], list[tuple[int, bytes]]]
    definitions: Mapping[str, str]


def held(path: Path) -> Held:
    """As the package rosbags reads it."""
    from rosbags.highlevel import AnyReader

    found: dict[tuple[str, str], list[tuple[int, bytes]]] = {}
    with AnyReader([path]) as reader:
        for connection, ns, data in reader.messages():
            found.setdefault((connection.topic, connection.msgtype), []).append((ns, bytes(data)))
        texts = {c.msgtype: c.msgdef.data for c in reader.connections}
    return Held(found, texts)


def fields(data: bytes, kind: str) -> list[int]:
    """Places of the bytes of the corrected fields in a message, by the layout of CDR."""
    end = 16 + struct.unpack_from("<I", data, 12)[0]
    start = 4 + -(-(end - 4) // 8) * 8
    at = [0, 1, 2] if kind == KIND[MAG] else [13, 14, 15, 25, 26, 27]
    return [start + 8 * k + byte for k in at for byte in range(8)]


def numbers(data: bytes, kind: str) -> np.ndarray:
    return np.frombuffer(bytes(data[k] for k in fields(data, kind)), dtype="<f8")


def without(data: bytes, kind: str) -> bytes:
    """A message with its corrected fields blanked."""
    out = bytearray(data)
    for k in fields(data, kind):
        out[k] = 0
    return bytes(out)


@pytest.fixture(params=["MCAP", "SQLITE3"])
def source(request: Any, tmp_path: Path) -> Path:
    return bag(tmp_path / "bag", sample(n=300), request.param)


@pytest.mark.parametrize("whole", [True, False])
def test_every_byte_but_those_of_corrected_fields(
    source: Path, whole: bool, tmp_path: Path, main: Any
) -> None:
    if not whole:
        (source,) = (p for p in source.iterdir() if p.suffix in (".mcap", ".db3"))
    out, found = tmp_path / "out.mcap", written(tmp_path / "x.json", [*FOUND, *ON_MAG])
    choice = ("--topic", f"imu={IMU}")
    status, _, said = main(source, "--from", found, "-o", out, *choice)
    assert (status, "left out" in said) == (0, False)
    before, after = held(source.parent if not whole else source), held(out)
    assert after.messages.keys() == before.messages.keys()
    assert after.definitions == before.definitions
    for (topic, kind), old in before.messages.items():
        new = after.messages[topic, kind]
        if topic not in (IMU, MAG):
            assert bool(new == old), topic
            continue
        assert [ns for ns, _ in new] == [ns for ns, _ in old]
        pairs = [(a, b) for (_, a), (_, b) in zip(new, old, strict=True)]
        assert all(without(a, kind) == without(b, kind) for a, b in pairs)
        assert all(a != b for a, b in pairs)


def test_the_numbers_are_those_that_apply_gives(source: Path, tmp_path: Path, main: Any) -> None:
    """The same data as a table and in handcal's own layout are corrected to the same."""
    out, found = tmp_path / "out.mcap", written(tmp_path / "x.json", [*FOUND, *ON_MAG])
    main(source, "--from", found, "-o", out, "--topic", f"imu={IMU}")
    given = load(source, topics={"imu": IMU})
    expected = device.apply(given, device.read(found)).recording
    new = held(out).messages
    read = np.array([numbers(data, KIND[IMU]) for _, data in new[IMU, KIND[IMU]]])
    np.testing.assert_array_equal(read, np.hstack([expected.imu.gyro, expected.imu.accel]))
    assert np.abs(read - np.hstack([given.imu.gyro, given.imu.accel])).max() > 0.01
    field = np.array([numbers(data, KIND[MAG]) for _, data in new[MAG, KIND[MAG]]])
    np.testing.assert_array_equal(field, expected.streams["mag"].value)

    table, plain = tmp_path / "table.csv", tmp_path / "plain.mcap"
    columns = np.column_stack([given.imu.t, given.imu.gyro, given.imu.accel])
    text = [",".join(map(repr, row)) for row in columns.tolist()]
    table.write_text("\n".join(["t,gx,gy,gz,ax,ay,az", *text]) + "\n", encoding="utf-8")
    main(table, "--from", written(tmp_path / "y.json", FOUND), "-o", plain)
    again = handcal.load(plain).imu
    np.testing.assert_allclose(read, np.hstack([again.gyro, again.accel]), atol=1e-9)


def test_the_file_written_reads_as_corrected(source: Path, tmp_path: Path, main: Any) -> None:
    out, found = tmp_path / "out.mcap", written(tmp_path / "x.json", FOUND)
    main(source, "--from", found, "-o", out, "--topic", f"imu={IMU}")
    given, read = (load(path, topics={"imu": IMU}) for path in (source, out))
    assert read.start_ns == given.start_ns
    np.testing.assert_array_equal(read.imu.t, given.imu.t)
    np.testing.assert_array_equal(read.streams["mag"].value, given.streams["mag"].value)


def test_a_late_magnetometer_gets_earlier_stamps_and_keeps_its_log_times(
    source: Path, tmp_path: Path, main: Any
) -> None:
    late = parameters("heading_delay", ["delay"], [0.05])
    out, found = tmp_path / "out.mcap", written(tmp_path / "x.json", late)
    _, _, said = main(source, "--from", found, "-o", out, "--topic", f"imu={IMU}")
    assert f"{MAG}: its stamps are 50 ms earlier" in said
    before, after = held(source).messages, held(out).messages
    assert after[IMU, KIND[IMU]] == before[IMU, KIND[IMU]]
    for (a, old), (b, new) in zip(before[MAG, KIND[MAG]], after[MAG, KIND[MAG]], strict=True):
        (s, ns), (s2, ns2) = (struct.unpack_from("<iI", data, 4) for data in (old, new))
        assert a == b
        assert (s - s2) * 10**9 + ns - ns2 == 50_000_000
        assert old[12:] == new[12:]


def test_what_has_no_corrected_reading_is_left_out_and_counted(tmp_path: Path, main: Any) -> None:
    """Three messages with the stamp of the one before, two that are no numbers, and one that says
    that it holds no reading, which stays."""
    source = bag(tmp_path / "bag", sample(n=300), "SQLITE3")
    (file,) = source.glob("*.db3")
    with sqlite3.connect(file) as base:
        (topic,) = base.execute("SELECT id FROM topics WHERE name = ?", (IMU,)).fetchone()
        every = "SELECT id, data FROM messages WHERE topic_id = ? ORDER BY id"
        found = base.execute(every, (topic,)).fetchall()
        put = "UPDATE messages SET data = ? WHERE id = ?"
        for k in (20, 40, 60):
            base.execute(put, (found[k - 1][1][:12] + found[k][1][12:], found[k][0]))
        for k in (70, 80):
            data = bytearray(found[k][1])
            struct.pack_into("<d", data, fields(data, KIND[IMU])[0], np.nan)
            base.execute(put, (bytes(data), found[k][0]))
        none = bytearray(found[90][1])
        at = fields(none, KIND[IMU])
        for place in (at[0] + 24, at[24] + 24):  # (a covariance follows each of the vectors)
            struct.pack_into("<d", none, place, -1.0)
        base.execute(put, (bytes(none), found[90][0]))
    out, result = tmp_path / "out.mcap", written(tmp_path / "x.json", FOUND[:6])
    _, _, said = main(source, "--from", result, "-o", out, "--topic", f"imu={IMU}")
    assert f"{IMU}: 5 of 300 messages have no corrected reading" in said
    new = [data for _, data in held(out).messages[IMU, KIND[IMU]]]
    assert len(new) == 295
    assert bytes(none) in new
    kept = [data for k, (_, data) in enumerate(found) if k not in (20, 40, 60, 70, 80, 90)]
    new.remove(bytes(none))
    for old, data in zip(kept, new, strict=True):
        old = numbers(old, KIND[IMU])
        scale = [1.01, 0.98, 1.03, 1.02, 1.01, 0.99]
        np.testing.assert_allclose(numbers(data, KIND[IMU]) * scale, old, rtol=1e-9, atol=1e-12)


def test_units_and_axes_of_the_file_stay(tmp_path: Path, main: Any) -> None:
    """Where the user says that they are not SI, or turned, corrected readings are as they were."""
    one = sample(n=300)
    accel = one.imu.accel / 9.80665
    turned = one.imu.gyro[:, [1, 0, 2]] * [1.0, -1.0, 1.0]
    source = bag(tmp_path / "bag", replace(one, imu=replace(one.imu, accel=accel, gyro=turned)),
                 "MCAP")  # fmt: skip
    out, found = tmp_path / "out.mcap", written(tmp_path / "x.json", FOUND[:6])
    how = ("--topic", f"imu={IMU}", "--units", "accel=g", "--axes", "gyro=-y,x,z")
    main(source, "--from", found, "-o", out, *how)
    new = [numbers(data, KIND[IMU]) for _, data in held(out).messages[IMU, KIND[IMU]]]
    back = np.array(new) * [0.98, 1.01, 1.03, 1.02, 1.01, 0.99]
    np.testing.assert_allclose(back, np.hstack([turned, accel]), atol=1e-9)


def test_sensors_with_a_topic_each_are_corrected_at_their_own_stamps(
    tmp_path: Path, main: Any
) -> None:
    """The accelerometer, between the gyro's stamps, loses its error; its noise is not smoothed."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    types, known = get_typestore(Stores.ROS2_HUMBLE), {}
    path = tmp_path / "bag"
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for topic, kind, ns, message in messages(sample(n=300), types, apart=("/camera",)):
            if not topic.startswith("/camera"):
                continue
            if topic not in known:
                known[topic] = writer.add_connection(topic, kind, typestore=types)
            if "accel" in topic:
                ns += 4_000_000
                stamp = types.types["builtin_interfaces/msg/Time"](ns // 10**9, ns % 10**9)
                message = replace(message, header=replace(message.header, stamp=stamp))  # type: ignore[type-var,attr-defined]
            writer.write(known[topic], ns, bytes(types.serialize_cdr(message, kind)))
    bias = [*parameters("gyro_bias", "xyz", [0.1, 0.2, 0.3]),
            *parameters("accel_bias", "xyz", [0.3, 0.2, 0.1])]  # fmt: skip
    result = tmp_path / "x.json"
    result.write_text(json.dumps({
        "schema": "handcal/calibration/1", "parameters": bias, "recording": {"path": "bag"}
    }))  # fmt: skip
    out = tmp_path / "out.mcap"
    _, _, said = main(path, "--from", result, "-o", out, "--biases")
    before, after = held(path).messages, held(out).messages
    gyro, accel = ((f"/camera/{s}/sample", KIND[IMU]) for s in ("gyro", "accel"))
    # The first of the gyro is before the accelerometer; of that one the first and the last are
    # outside of the gyro's others.
    for key, off, count in (
        (gyro, [0.1, 0.2, 0.3, 0, 0, 0], 299),
        (accel, [0, 0, 0, 0.3, 0.2, 0.1], 298),
    ):
        old = {ns: numbers(data, KIND[IMU]) for ns, data in before[key]}
        new = {ns: numbers(data, KIND[IMU]) for ns, data in after[key]}
        assert len(new) == count
        for ns, value in new.items():
            np.testing.assert_allclose(old[ns] - value, off, atol=1e-12)
    assert f"{gyro[0]}: 1 of 300 messages have no corrected reading" in said
    assert f"{accel[0]}: 2 of 300 messages have no corrected reading" in said


def test_what_an_mcap_has_beside_its_messages_survives(tmp_path: Path, main: Any) -> None:
    """Sequence numbers, publish times, channels' metadata, metadata records, attachments, channels
    without messages or schema."""
    plain, path, out = (tmp_path / name for name in ("plain.mcap", "a.mcap", "b.mcap"))
    write_mcap(replace(sample(n=300), device="mine"), plain)
    with plain.open("rb") as file, path.open("wb") as to:
        writer = McapWriter(to)
        writer.start(profile="ros2", library="somebody")
        known: dict[int, int] = {}
        for schema, channel, message in make_reader(file).iter_messages():
            assert schema is not None
            if channel.id not in known:
                known[channel.id] = writer.register_channel(
                    channel.topic, "cdr",
                    writer.register_schema(schema.name, schema.encoding, schema.data),
                    {"offered_qos_profiles": "- history: 1"},
                )  # fmt: skip
            ns = message.log_time
            writer.add_message(known[channel.id], ns + LATE, message.data, ns + 3, 1000 - ns % 7)
        for _ in range(2):
            writer.register_channel("/silent", "json", 0, {"a": "b"})
        writer.add_attachment(1, 2, "map.pgm", "image/x-portable-graymap", b"P5")
        writer.add_metadata("device", {"id": "mine", "model": ""})
        writer.add_metadata("session", {"by": "a tripod"})
        writer.finish()  # type: ignore[no-untyped-call]
    found = written(tmp_path / "x.json", FOUND[:3])
    assert main(path, "--from", found, "-o", out)[0] == 0

    def beside(name: Path) -> Any:
        with name.open("rb") as file:
            reader = make_reader(file, validate_crcs=True)
            summary = reader.get_summary()
            assert summary is not None
            channels = [(c.topic, c.message_encoding, dict(c.metadata))
                        for c in summary.channels.values()]  # fmt: skip
            schemas = {(s.name, s.encoding, s.data) for s in summary.schemas.values()}
            times = [(c.topic, m.log_time, m.publish_time, m.sequence)
                     for _, c, m in reader.iter_messages()]  # fmt: skip
            notes = [(m.name, dict(m.metadata)) for m in reader.iter_metadata()
                     if m.name != "corrected"]  # fmt: skip
            attached = [(a.name, a.data, a.create_time, a.log_time, a.media_type)
                        for a in reader.iter_attachments()]  # fmt: skip
            return channels, schemas, times, sorted(notes), attached

    assert beside(out) == beside(path)
    assert handcal.load(out).device == "mine"


def test_a_bag_that_ends_early_is_corrected_as_far_as_it_goes(tmp_path: Path, main: Any) -> None:
    whole, path, out = (tmp_path / name for name in ("w.mcap", "a.mcap", "b.mcap"))
    write_mcap(sample(n=3000, streams=False), whole)
    path.write_bytes(whole.read_bytes()[: int(0.7 * whole.stat().st_size)])
    _, _, said = main(path, "--from", written(tmp_path / "x.json", FOUND[:3]), "-o", out)
    assert "ends early" in said
    assert len(load(out).imu.t) == len(load(path).imu.t) < 3000


def test_a_database_that_defines_nothing(tmp_path: Path, main: Any) -> None:
    """As before ROS 2 Iron: what handcal knows it defines, the rest is said."""
    source = bag(tmp_path / "bag", sample(n=300), "SQLITE3")
    (file,) = source.glob("*.db3")
    with sqlite3.connect(file) as base:
        base.execute("DROP TABLE message_definitions")
    out, found = tmp_path / "out.mcap", written(tmp_path / "x.json", FOUND[:3])
    _, _, said = main(file, "--from", found, "-o", out, "--topic", f"imu={IMU}")
    assert "does not define std_msgs/msg/String, tf2_msgs/msg/TFMessage:" in said
    with out.open("rb") as reading:
        count = {c.topic: 0 for _, c, _ in make_reader(reading).iter_messages()}
    assert count.keys() == {IMU, SECOND, MAG, "/tf", "/chatter", "/vicon/somewhere"}
    assert len(load(out, topics={"imu": IMU}).imu.t) == 300


@pytest.mark.parametrize("seed", range(20))
def test_of_a_damaged_database_there_is_a_bag_or_a_sentence(
    seed: int, tmp_path: Path, main: Any
) -> None:
    source = bag(tmp_path / "bag", sample(n=300), "SQLITE3")
    (file,) = source.glob("*.db3")
    content, rng = bytearray(file.read_bytes()), np.random.default_rng(seed)
    for at in rng.integers(100, len(content), 30):
        content[at] = rng.integers(256)
    file.write_bytes(content)
    out, found = tmp_path / "out.mcap", written(tmp_path / "x.json", FOUND[:3])
    status, _, said = main(file, "--from", found, "-o", out, "--topic", f"imu={IMU}")
    assert status in (0, 1, 2)
    assert out.exists() == (status == 0)
    assert said or not status


def test_the_clock_of_a_bag_stays_and_is_said(source: Path, tmp_path: Path, main: Any) -> None:
    fast = [*parameters("clock_rate", ["ppm"], [100.0]), *FOUND[:3]]
    out, found = tmp_path / "out.mcap", written(tmp_path / "x.json", fast)
    status, shown, said = main(source, "--from", found, "-o", out, "--topic", f"imu={IMU}")
    assert status == 0, (shown, said)
    assert "clock_rate (other topics of the bag go by the same clock)" in said
    assert "clock_rate" not in shown
    np.testing.assert_array_equal(
        load(out, topics={"imu": IMU}).imu.t, load(source, topics={"imu": IMU}).imu.t
    )
