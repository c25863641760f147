"""ROS bags as the package rosbags writes them, ROS 1 and 2, of every compression: the same numbers
as MCAP gives, from Odometry and TransformStamped too; bombs, lies and bags that end early."""

from __future__ import annotations

import sqlite3
import struct
from pathlib import Path

import numpy as np
import pytest
from format_files import database, messages, ros1_bag, ros2_bag, small
from sample_recording import START_NS, sample
from test_inputs_formats import same, written

from handcal.recordings.inputs import format_of, load
from handcal.types import InputError

ODOMETRY, TRANSFORM = "nav_msgs/msg/Odometry", "geometry_msgs/msg/TransformStamped"


@pytest.mark.parametrize("compression", ["", "BZ2", "LZ4"])
def test_ros1_compressions(tmp_path: Path, compression: str) -> None:
    expected = sample(n=300)
    got = load(written(tmp_path, ".bag", ros1_bag(expected, compression)))
    same(got, expected, atol=1e-12)
    assert (sorted(got.streams), got.start_ns, got.warnings) == (["mag", "pose"], START_NS, ())


@pytest.mark.parametrize("odometry", [ODOMETRY, TRANSFORM])
def test_a_pose_in_another_message(tmp_path: Path, odometry: str) -> None:
    expected = sample(n=300)
    one = load(written(tmp_path, ".bag", ros1_bag(expected, odometry=odometry)))
    two = load(ros2_bag(tmp_path / "a", expected, odometry=odometry))
    three = load(ros2_bag(tmp_path / "b", expected, "MCAP", odometry))
    for got in (one, two, three):
        assert "pose" in got.streams
        same(got, expected, atol=1e-12)


@pytest.mark.parametrize("storage", ["SQLITE3", "MCAP"])
def test_ros2_folders(tmp_path: Path, storage: str) -> None:
    expected = sample(n=300)
    got = load(ros2_bag(tmp_path / "bag", expected, storage))
    same(got, expected, atol=1e-12)
    assert sorted(got.streams) == ["mag", "pose"]
    assert got.start_ns == START_NS


def test_a_bag_in_two_files(tmp_path: Path) -> None:
    """The second half's are in the second file, whose name sorts after by its number."""
    bag, expected = ros2_bag(tmp_path / "bag", sample(n=300)), sample(n=300)
    (whole,) = bag.glob("*.db3")
    first, second = bag / "bag_2.db3", bag / "bag_10.db3"
    for half, keep in ((first, "<="), (second, ">")):
        half.write_bytes(whole.read_bytes())
        with sqlite3.connect(half) as base:
            base.execute(f"DELETE FROM messages WHERE NOT id {keep} 180")
    whole.unlink()
    same(load(bag), expected, atol=1e-12)


def test_compressed_messages_are_read_and_files_refused(tmp_path: Path) -> None:
    expected = sample(n=300)
    same(load(ros2_bag(tmp_path / "a", expected, compression="MESSAGE")), expected, atol=1e-12)
    with pytest.raises(InputError, match=r"compressed as a whole .*unpack it first"):
        load(ros2_bag(tmp_path / "b", expected, compression="FILE"))


def test_a_bag_that_was_never_closed(tmp_path: Path) -> None:
    """No index, and cut in the middle of a chunk: what is before it."""
    whole = ros1_bag(sample(n=9000))
    path = written(tmp_path, ".bag", whole[: int(0.9 * len(whole))])
    got = load(path)
    assert 1000 < len(got.imu.t) < 9000
    assert any("ends early" in warning for warning in got.warnings)


def test_a_chunk_that_lies_is_not_unpacked(tmp_path: Path) -> None:
    whole = ros1_bag(small(), "BZ2")
    at = whole.index(b"size=") + 5
    for size, match in ((5 * 2**20, "lies|unpack"), (2**31, "would unpack"), (100, "lies about")):
        content = whole[:at] + struct.pack("<I", size) + whole[at + 4 :]
        with pytest.raises(InputError, match=match):
            load(written(tmp_path, ".bag", content))


def test_a_database_is_not_believed(tmp_path: Path) -> None:
    """A view that never ends instead of messages; a blob that is made while it is read."""
    path = written(tmp_path, ".db3", database(small()))
    with sqlite3.connect(path) as base:
        base.execute("ALTER TABLE messages RENAME TO other")
        base.execute(
            "CREATE VIEW messages AS WITH RECURSIVE n(id) AS (SELECT 1 UNION ALL SELECT id + 1 "
            "FROM n) SELECT id, 1 AS topic_id, id AS timestamp, x'00' AS data FROM n"
        )
    with pytest.raises(InputError, match="no known format"):
        load(path)
    with sqlite3.connect(path) as base:
        base.execute("DROP VIEW messages")
        base.execute(
            "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, "
            "data BLOB AS (zeroblob(900000000)) VIRTUAL)"
        )
        base.execute("INSERT INTO messages(topic_id, timestamp) SELECT id, 1 FROM topics")
    with pytest.raises(InputError, match="damaged database"):
        load(path)


def test_other_databases_and_folders_of_mcap_are_no_bags(tmp_path: Path) -> None:
    path = tmp_path / "other.db3"
    with sqlite3.connect(path) as base:
        base.execute("CREATE TABLE photos(id INTEGER)")
    with pytest.raises(InputError, match=r"could be a ROS 2 bag .* no SQLite database with"):
        load(path)
    bag = ros2_bag(tmp_path / "bag", sample(n=300, streams=False), "MCAP")
    assert format_of(bag).__name__.endswith("ros2_bag")
    (bag / "metadata.yaml").unlink()
    with pytest.raises(InputError, match="no known format"):
        load(bag)


def test_which_pose_is_taken(tmp_path: Path) -> None:
    """Odometry only where there is no PoseStamped, or where it is chosen."""
    expected = sample(n=300)
    path = ros2_bag(tmp_path / "bag", expected, odometry=ODOMETRY)
    (file,) = path.glob("*.db3")
    with sqlite3.connect(file) as base:
        base.execute(
            "INSERT INTO topics SELECT 99, '/better', 'geometry_msgs/msg/PoseStamped', "
            "serialization_format, offered_qos_profiles, type_description_hash FROM topics LIMIT 1"
        )
        stamp = struct.pack("<BBBBiII", 0, 1, 0, 0, START_NS // 10**9, START_NS % 10**9, 1) + b"\0"
        pose = stamp + b"\0" * (-(len(stamp) - 4) % 8) + struct.pack("<7d", 9, 8, 7, 0, 0, 0, 1)
        base.execute(
            "INSERT INTO messages(topic_id, timestamp, data) VALUES (99, ?, ?)", (START_NS, pose)
        )
    np.testing.assert_array_equal(load(path).streams["pose"].value, [[9, 8, 7, 1, 0, 0, 0]])
    same(load(path, topics={"pose": "/vicon/somewhere"}), expected, atol=1e-12)


def test_a_topic_of_another_type(tmp_path: Path) -> None:
    """All types are named of which a pose is read, and that of the topic; --topic pose=/tf was
    answered with PoseStamped alone."""
    path = ros2_bag(tmp_path / "bag", sample(n=300), odometry=ODOMETRY)
    needed = f"geometry_msgs/msg/PoseStamped or {ODOMETRY} or {TRANSFORM} or "
    with pytest.raises(InputError, match="its messages are sensor_msgs/msg/Imu") as refused:
        load(path, topics={"pose": "/phone/imu"})
    assert needed in str(refused.value)
    with pytest.raises(InputError, match="has no such topic") as refused:
        load(path, topics={"pose": "/phone"})
    assert needed in str(refused.value)
    assert f"/vicon/somewhere ({ODOMETRY}, cdr)" in str(refused.value)


@pytest.mark.parametrize("storage", ["SQLITE3", "MCAP"])
def test_the_file_that_describes_a_bag_names_its_folder(tmp_path: Path, storage: str) -> None:
    bag = ros2_bag(tmp_path / "a bag", sample(n=300), storage)
    with pytest.raises(InputError, match=r"is a part of a ROS 2 bag") as refused:
        load(bag / "metadata.yaml")
    assert str(refused.value).endswith(f"read by its folder: handcal info '{bag}'.")
    alone = tmp_path / "metadata.yaml"
    alone.write_bytes((bag / "metadata.yaml").read_bytes())
    with pytest.raises(InputError, match="of no known format"):
        load(alone)


# --- gyro and accelerometer in topics of their own (issue 75) -----------------------------------


def every_bag(folder: Path, apart: tuple[str, ...]) -> list[Path]:
    """A ROS 1 bag, a ROS 2 bag and one of MCAP."""
    one = sample(n=300)
    return [
        written(folder, ".bag", ros1_bag(one, apart=apart)),
        ros2_bag(folder / "database", one, apart=apart),
        ros2_bag(folder / "mcap", one, "MCAP", apart=apart),
    ]


def test_a_topic_for_each_sensor_is_joined_and_said(tmp_path: Path) -> None:
    for path in every_bag(tmp_path, ("/camera",)):
        got = load(path)
        same(got, sample(n=300), atol=1e-12)
        gyro, accel = (f"/camera/{s}/sample (300 messages)" for s in ("gyro", "accel"))
        said = f"The gyroscope of {gyro} and the accelerometer of {accel} were joined."
        assert got.warnings == (said,)
        assert got.topics["imu"] == "/camera/gyro/sample + /camera/accel/sample"


def test_of_several_the_refusal_has_the_option_filled_in(tmp_path: Path) -> None:
    for path in every_bag(tmp_path, ("/back", "/front")):
        with pytest.raises(InputError) as refused:
            load(path)
        asked = "--topic gyro=/back/gyro/sample --topic accel=/back/accel/sample."
        assert str(refused.value).endswith(f"Choose with {asked}")
        options = {"gyro": "/back/gyro/sample", "accel": "/back/accel/sample"}
        same(load(path, topics=options), sample(n=300), atol=1e-12)


def test_a_topic_with_both_comes_before_halves(tmp_path: Path) -> None:
    """As RealSense's driver publishes where it is asked to unite them."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    types = get_typestore(Stores.ROS2_HUMBLE)
    rows = [
        *messages(sample(1, n=300), types, apart=("/camera",)), *messages(sample(n=300), types)
    ]  # fmt: skip
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        made = {
            topic: writer.add_connection(topic, kind, typestore=types)
            for topic, kind in {row[:2] for row in rows if row[1].endswith("Imu")}
        }
        for topic, kind, ns, message in sorted(rows, key=lambda row: row[2]):
            if topic in made:
                writer.write(made[topic], ns, bytes(types.serialize_cdr(message, kind)))
    same(load(tmp_path / "bag"), sample(n=300), atol=1e-12)


def test_one_sensor_alone_is_refused_and_taken_where_it_is_enough(tmp_path: Path) -> None:
    for k, path in enumerate(every_bag(tmp_path, ("/camera",))):
        left = {"gyro": "/camera/gyro/sample", "accel": ""}
        with pytest.raises(InputError, match="--topic accel=TOPIC"):
            load(path, topics=left)
        got = load(path, topics=left, needs=())
        assert got.sensors == ("gyro",), k
        np.testing.assert_allclose(got.imu.gyro, sample(n=300).imu.gyro, atol=1e-12)
        assert not got.imu.accel.any()


def test_two_topics_of_a_real_layout(cases: Path) -> None:
    two, one = load(cases / "two_topics.bag"), load(cases / "one_topic.bag")
    assert any("were joined" in w for w in two.warnings)
    assert not one.warnings
    assert two.rate_hz == pytest.approx(one.rate_hz, rel=1e-3)
