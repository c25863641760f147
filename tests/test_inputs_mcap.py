"""The MCAP reader: encodings, and which topic is which stream."""

from __future__ import annotations

import math
import struct
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import CompressionType
from sample_recording import (
    IMU,
    POSE,
    QUATERNION,
    cdr,
    imu_floats,
    imu_json,
    imu_messages,
    sample,
    write_channels,
)

from handcal.recordings.export import write_mcap
from handcal.recordings.inputs import load
from handcal.recordings.overview import overview
from handcal.recordings.streams import STREAMS
from handcal.show.info import Info, info_json, stream_row
from handcal.types import InputError, Recording


def assert_imu(recording: Recording, expected: Recording) -> None:
    np.testing.assert_array_equal(recording.imu.t, expected.imu.t)
    np.testing.assert_array_equal(recording.imu.gyro, expected.imu.gyro)
    np.testing.assert_array_equal(recording.imu.accel, expected.imu.accel)
    assert recording.start_ns == expected.start_ns


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("frame", [b"", b"imu", b"abcdefgh"])
def test_cdr_in_both_byte_orders(
    tmp_path: Path, order: str, compression: CompressionType, frame: bytes
) -> None:
    path = write_channels(
        tmp_path / "a.mcap",
        [("/imu", IMU, "cdr")],
        imu_messages(sample(), order=order, frame=frame),
        compression=compression,
    )
    assert_imu(load(path), sample())


def test_messages_of_different_layout_on_one_topic_keep_their_order(tmp_path: Path) -> None:
    kinds = [
        imu_messages(sample(), order=order, frame=b"x" * k)
        for order, k in (("<", 1), (">", 9), ("<", 30))
    ]
    mixed = [kinds[i % 3][i] for i in range(len(kinds[0]))]
    back = load(write_channels(tmp_path / "a.mcap", [("/imu", IMU, "cdr")], mixed))
    assert back.warnings == ()
    assert_imu(back, sample())


@pytest.mark.parametrize("stamped", [True, False])
def test_json_channels(tmp_path: Path, stamped: bool) -> None:
    messages = imu_json(sample(), stamped)
    assert_imu(load(write_channels(tmp_path / "a.mcap", [("/i", IMU, "json")], messages)), sample())


def test_file_without_chunks(tmp_path: Path) -> None:
    path = write_channels(
        tmp_path / "a.mcap", [("/imu", IMU, "cdr")], imu_messages(sample()), use_chunking=False
    )
    assert_imu(load(path), sample())


def test_zero_stamps_mean_log_time(tmp_path: Path) -> None:
    unstamped = [(c, ns, data[:4] + bytes(8) + data[12:]) for c, ns, data in imu_messages(sample())]
    assert_imu(load(write_channels(tmp_path / "a.mcap", [("/i", IMU, "cdr")], unstamped)), sample())


def test_heading_and_pose_by_hand(tmp_path: Path) -> None:
    """A quarter turn about z, given as a quaternion of length 2 and then negated."""
    half = math.sqrt(0.5)
    messages = imu_messages(sample())
    for k, sign in enumerate((2.0, -1.0, 1.0)):
        ns = messages[10 * k][1]
        messages.append((1, ns, cdr(ns, [0, 0, sign * half, sign * half])))
        messages.append((2, ns, cdr(ns, [1, 2, 3, 0, 0, sign * half, sign * half])))
    # turned about z, then y, then x of the body: yaw of body x is the first angle alone
    ns, (a, b, c) = messages[50][1], np.radians([30, 40, 50]) / 2
    x = np.sin(c) * np.cos(b) * np.cos(a) - np.cos(c) * np.sin(b) * np.sin(a)
    y = np.cos(c) * np.sin(b) * np.cos(a) + np.sin(c) * np.cos(b) * np.sin(a)
    z = np.cos(c) * np.cos(b) * np.sin(a) - np.sin(c) * np.sin(b) * np.cos(a)
    w = np.cos(c) * np.cos(b) * np.cos(a) + np.sin(c) * np.sin(b) * np.sin(a)
    messages.append((1, ns, cdr(ns, [x, y, z, w])))
    channels = [("/imu", IMU, "cdr"), ("/h", QUATERNION, "cdr"), ("/p", POSE, "cdr")]
    back = load(write_channels(tmp_path / "a.mcap", channels, messages))
    yaw = [math.pi / 2] * 3 + [math.radians(30)]
    np.testing.assert_allclose(back.streams["heading"].value[:, 0], yaw, atol=1e-12)
    expected = [1, 2, 3, half, 0, 0, half]
    np.testing.assert_allclose(back.streams["pose"].value, [expected] * 3, atol=1e-12)


def test_nan_rows_are_dropped_and_counted(tmp_path: Path) -> None:
    messages = imu_messages(sample())
    bad = cdr(messages[-1][1], imu_floats(np.full(3, math.nan), np.zeros(3)))
    messages[-1] = (0, messages[-1][1], bad)
    back = load(write_channels(tmp_path / "a.mcap", [("/imu", IMU, "cdr")], messages))
    assert len(back.imu.t) == len(messages) - 1
    assert any("1 row with NaN" in w for w in back.warnings)


# --- which topic is which ---------------------------------------------------------------


def two_imus(path: Path, first: str, second: str) -> Path:
    messages = imu_messages(sample()) + imu_messages(sample(1), 1)
    return write_channels(path / "a.mcap", [(first, IMU, "cdr"), (second, IMU, "cdr")], messages)


def test_usual_names_decide(tmp_path: Path) -> None:
    back = load(two_imus(tmp_path, "/reference", "/imu"))
    assert_imu(back, sample(1))
    np.testing.assert_array_equal(back.streams["reference"].value[:, :3], sample().imu.gyro)


def test_what_is_not_the_reference_is_the_imu(tmp_path: Path) -> None:
    back = load(two_imus(tmp_path, "/phone/reference", "/phone/data"))
    assert_imu(back, sample(1))
    assert set(back.streams) == {"reference"}


def test_a_choice_among_topics_is_said_with_the_others(tmp_path: Path) -> None:
    """The usual name first, else the raw one; who chose himself is told nothing."""
    for name, why in (("/phone/imu", "its usual name"), ("/phone/data_raw", "the raw one")):
        path = two_imus(tmp_path, "/camera/data", name)
        back = load(path)
        assert_imu(back, sample(1))
        assert back.topics == {"imu": name}
        assert back.warnings == (
            f"IMU: of 2 topics {name} (400 messages) was taken, {why}; there is also /camera/data "
            "(400 messages); choose with --topic imu=/camera/data.",
        )
        assert load(path, topics={"imu": name}).warnings == ()
    found = info_json(Info("", "", overview(back), ()))
    assert [s["topic"] for s in found["streams"]] == ["/phone/data_raw"]
    assert "/phone/data_raw" in stream_row(overview(back).streams[0])


def without(message: tuple[int, int, bytes], field: str) -> tuple[int, int, bytes]:
    """The message of an IMU with -1 as the first covariance of a field."""
    names, (channel, ns, body) = STREAMS["imu"].message.floats, message
    at = len(body) - 8 * len(names) + 8 * names.index(f"{field}_covariance.0")
    return channel, ns, body[:at] + struct.pack("<d", -1.0) + body[at + 8 :]


def flagged(path: Path, rows: slice, field: str) -> Path:
    """An IMU whose messages of these rows say that they hold nothing of this sensor."""
    messages = imu_messages(sample())
    for k in range(*rows.indices(len(messages))):
        messages[k] = without(messages[k], field)
    return write_channels(path / "f.mcap", [("/imu", IMU, "cdr")], messages)


@pytest.mark.parametrize(
    ("field", "kind"),
    [("linear_acceleration", "acceleration"), ("angular_velocity", "angular velocity")],
)
def test_messages_that_hold_no_reading_of_a_sensor(tmp_path: Path, field: str, kind: str) -> None:
    """All of them: refused; some: not trusted, and said."""
    said = f"all 400 messages of /imu say that they hold no {kind} \\({field}_covariance"
    with pytest.raises(InputError, match=said):
        load(flagged(tmp_path, slice(None), field))
    some = load(flagged(tmp_path, slice(100, 110), field))
    assert (~some.imu.valid).sum() == 10
    assert any(f"10 of 400 messages of /imu say that they hold no {kind}" in w
               for w in some.warnings)  # fmt: skip


def test_gyro_and_accelerometer_in_turn_are_both_read(tmp_path: Path) -> None:
    whole = sample()
    names = ("angular_velocity", "linear_acceleration")
    messages = [without(one, names[k % 2]) for k, one in enumerate(imu_messages(whole))]
    back = load(write_channels(tmp_path / "t.mcap", [("/imu", IMU, "cdr")], messages))
    np.testing.assert_array_equal(back.imu.gyro, whole.imu.gyro[1:-1:2])
    between = 0.5 * (whole.imu.accel[:-2:2] + whole.imu.accel[2::2])
    assert np.abs(back.imu.accel[: len(between)] - between).max() < 0.5


def test_ambiguous_topics_are_listed_with_the_option_that_chooses(tmp_path: Path) -> None:
    path = two_imus(tmp_path, "/left", "/right")
    with pytest.raises(InputError, match=r"/left, /right; choose one with --topic imu=/left"):
        load(path)
    back = load(path, topics={"imu": "/right", "reference": "/left"})
    assert_imu(back, sample(1))
    assert set(back.streams) == {"reference"}


def test_option_that_names_no_topic(tmp_path: Path) -> None:
    path = two_imus(tmp_path, "/left", "/right")
    with pytest.raises(InputError, match="it holds /left"):
        load(path, topics={"imu": "/nowhere"})
    with pytest.raises(InputError, match="the streams are imu, reference"):
        load(path, topics={"compass": "/left"})
    with pytest.raises(InputError, match=r"name the other's topic too, --topic accel=TOPIC"):
        load(path, topics={"gyro": "/left"})
    with pytest.raises(InputError, match="say the same"):
        load(path, topics={"gyro": "/left", "imu": "/left"})


def test_stream_can_be_left_out(tmp_path: Path) -> None:
    write_mcap(sample(), tmp_path / "a.mcap")
    assert "mag" not in load(tmp_path / "a.mcap", topics={"mag": ""}).streams


def test_truth_is_dropped(tmp_path: Path) -> None:
    back = load(two_imus(tmp_path, "/truth/imu", "/left"))
    assert_imu(back, sample(1))
    assert back.streams == {}


@pytest.mark.parametrize(
    ("schema", "encoding"), [("std_msgs/msg/String", "cdr"), (IMU, "ros1"), ("", "cdr")]
)
def test_no_imu_lists_what_there_is(tmp_path: Path, schema: str, encoding: str) -> None:
    path = write_channels(
        tmp_path / "a.mcap", [("/chat", schema, encoding)], imu_messages(sample())
    )
    with pytest.raises(InputError, match=r"has no IMU.*it holds /chat"):
        load(path)


def test_messages_that_do_not_fit_their_schema(tmp_path: Path) -> None:
    for data, match in [
        (b"", "too short"),
        (cdr(1, [1.0]), "too short"),
        (b"\0\3" + cdr(1, [0.0] * 37)[2:], "plain CDR"),
        (cdr(1, [0.0] * 37)[:12] + b"\xff" * 4 + bytes(320), "too short"),
    ]:
        path = write_channels(tmp_path / "a.mcap", [("/imu", IMU, "cdr")], [(0, 0, data)])
        with pytest.raises(InputError, match=match):
            load(path)


@pytest.mark.parametrize(
    "data",
    [b"", b"{", b"[" * 10**5, b"[]", b"{}", b'{"angular_velocity": {"x": "1"}}', b"\xff\xfe"],
)
def test_json_that_is_no_imu(tmp_path: Path, data: bytes) -> None:
    path = write_channels(tmp_path / "a.mcap", [("/imu", IMU, "json")], [(0, 0, data)])
    with pytest.raises(InputError, match="/imu"):
        load(path)
