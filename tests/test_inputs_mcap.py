"""The MCAP reader: encodings, topics, damage, hostility."""

from __future__ import annotations

import json
import math
import struct
import tracemalloc
from contextlib import suppress
from io import BytesIO
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
import zstandard
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.data_stream import RecordBuilder
from mcap.records import Chunk, Footer, Header
from mcap.writer import CompressionType
from sample_recording import START_NS, edited, sample, write_channels

from handcal.export import write_mcap
from handcal.inputs import load
from handcal.types import InputError, Recording

IMU, POSE = "sensor_msgs/msg/Imu", "geometry_msgs/msg/PoseStamped"
QUATERNION = "geometry_msgs/msg/QuaternionStamped"
MAGIC = b"\x89MCAP0\r\n"
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
    # body x points down, turned about y by a quarter and about z by 30 degrees: yaw of the tilt
    ns, tilt, turn = messages[50][1], math.radians(40) / 2, math.radians(30) / 2
    q = [-math.sin(tilt) * math.sin(turn), math.sin(tilt) * math.cos(turn)]
    q += [math.cos(tilt) * math.sin(turn), math.cos(tilt) * math.cos(turn)]
    messages.append((1, ns, cdr(ns, q)))
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
    assert any("1 rows with NaN" in w for w in back.warnings)


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
        load(path, topics={"gyro": "/left"})


def test_stream_can_be_left_out(tmp_path: Path) -> None:
    write_mcap(sample(), tmp_path / "a.mcap")
    assert "mag" not in load(tmp_path / "a.mcap", topics={"mag": ""}).streams


def test_truth_is_dropped(tmp_path: Path) -> None:
    back = load(two_imus(tmp_path, "/truth/imu", "/imu"))
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


# --- damage -----------------------------------------------------------------------------


def test_truncated_file_gives_what_it_holds(tmp_path: Path) -> None:
    recording = sample(n=1500, streams=False)
    path = write_channels(tmp_path / "a.mcap", [("/imu", IMU, "cdr")], imu_messages(recording))
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    back = load(path)
    n = len(back.imu.t)
    assert n > 400
    assert any(f"{n} messages were recovered" in w for w in back.warnings)
    np.testing.assert_array_equal(back.imu.gyro, recording.imu.gyro[:n])


@pytest.mark.parametrize("data_crc", [False, True])
def test_flipped_byte_is_found(tmp_path: Path, data_crc: bool) -> None:
    path = write_channels(
        tmp_path / "a.mcap",
        [("/imu", IMU, "cdr")],
        imu_messages(sample()),
        compression=CompressionType.NONE,
        data_crc=data_crc,
    )
    with pytest.raises(InputError, match="flipped"):
        load(edited(path, lambda b: b.__setitem__(5000, b[5000] ^ 4)))


def test_flipped_byte_outside_chunks_is_found(tmp_path: Path) -> None:
    path = write_channels(
        tmp_path / "a.mcap",
        [("/imu", IMU, "cdr")],
        imu_messages(sample()),
        data_crc=True,
    )
    at = path.read_bytes().index(b"test")
    with pytest.raises(InputError, match="data section"):
        load(edited(path, lambda b: b.__setitem__(at, b[at] ^ 4)))


@pytest.mark.parametrize(
    ("content", "match"),
    [
        (b"", "empty"),
        (bytes(100), "not an MCAP"),
        (MAGIC, "no IMU"),
        (b"\x89PNG\r\n\x1a\n" + bytes(50), "not an MCAP"),
    ],
)
def test_file_that_is_no_mcap(tmp_path: Path, content: bytes, match: str) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    with pytest.raises(InputError, match=match):
        load(path)


def chunk_file(path: Path, compression: str, packed: bytes, size: int) -> Path:
    builder = RecordBuilder()
    Header("ros2", "test").write(builder)
    Chunk(compression, packed, 0, 0, 0, size).write(builder)
    Footer(0, 0, 0).write(builder)
    path.write_bytes(MAGIC + builder.end() + MAGIC)
    return path


def unsized_zstd(data: bytes) -> bytes:
    """A frame whose header does not say how much it holds."""
    out = BytesIO()
    with zstandard.ZstdCompressor().stream_writer(out, closefd=False) as writer:
        writer.write(data)
    return out.getvalue()


ZEROS = bytes(200 * 2**20)


@pytest.mark.parametrize("stated", [len(ZEROS), 100, 2**62])
@pytest.mark.parametrize("kind", ["zstd", "zstd unsized", "lz4"])
def test_decompression_bomb_is_not_unpacked(tmp_path: Path, kind: str, stated: int) -> None:
    pack = {"zstd": zstandard.compress, "zstd unsized": unsized_zstd, "lz4": lz4.frame.compress}
    path = chunk_file(tmp_path / "a.mcap", kind.split()[0], pack[kind](ZEROS), stated)
    tracemalloc.start()
    with pytest.raises(InputError):
        load(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 10 * 2**20


def test_unknown_compression_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="brotli"):
        load(chunk_file(tmp_path / "a.mcap", "brotli", b"abc", 3))


def test_record_longer_than_the_file_costs_no_memory(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(MAGIC + struct.pack("<BQ", 6, 2**40) + bytes(100))
    with pytest.raises(InputError, match="no IMU"):
        load(path)


# --- anything at all --------------------------------------------------------------------


@pytest.fixture(scope="module")
def small_files(tmp_path_factory: pytest.TempPathFactory) -> list[bytes]:
    """With checksums, and without, where damage gets as far as the messages."""
    folder = tmp_path_factory.mktemp("small")
    recording = sample(n=210)
    write_mcap(recording, folder / "a.mcap")
    for name, encoding, messages in [
        ("b", "cdr", imu_messages(recording)),
        ("c", "json", imu_json(recording)),
    ]:
        write_channels(
            folder / f"{name}.mcap",
            [("/imu", IMU, encoding)],
            messages,
            compression=CompressionType.NONE,
            crcs=False,
        )
    return [(folder / f"{name}.mcap").read_bytes() for name in "abc"]


@settings(max_examples=250, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_any_damage_gives_a_recording_or_a_sentence(
    small_files: list[bytes], tmp_path: Path, data: st.DataObject
) -> None:
    whole = data.draw(st.sampled_from(small_files))
    end = data.draw(st.one_of(st.just(len(whole)), st.integers(0, len(whole))))
    content = bytearray(whole[:end])
    for _ in range(data.draw(st.integers(0, 3)) if content else 0):
        at = data.draw(st.integers(0, len(content) - 1))
        content[at] ^= 1 << data.draw(st.integers(0, 7))
    _load_or_sentence(tmp_path, bytes(content))


@settings(max_examples=100, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.binary(max_size=300), st.integers(1, 16))
def test_any_record_gives_a_sentence(tmp_path: Path, content: bytes, opcode: int) -> None:
    _load_or_sentence(tmp_path, MAGIC + struct.pack("<BQ", opcode, len(content)) + content)


def _load_or_sentence(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "fuzz.mcap"
    path.write_bytes(content)
    with suppress(InputError):
        assert isinstance(load(path), Recording)


def test_progress_runs_to_one(tmp_path: Path) -> None:
    path = write_channels(tmp_path / "a.mcap", [("/imu", IMU, "cdr")], imu_messages(sample()))
    seen: list[float] = []
    load(path, progress=seen.append)
    assert seen == sorted(seen)
    assert len(seen) > 3
    assert seen[-1] == 1.0
