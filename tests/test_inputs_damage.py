"""The MCAP reader on damaged and hostile files."""

from __future__ import annotations

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
from sample_recording import IMU, edited, imu_json, imu_messages, sample, write_channels

from handcal.recordings.export import write_mcap
from handcal.recordings.inputs import load
from handcal.types import InputError, Recording

MAGIC = b"\x89MCAP0\r\n"


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


def test_chunk_that_says_it_is_longer_than_memory(tmp_path: Path) -> None:
    content = bytes(28) + struct.pack("<IQ", 0, 2**64 - 1) + bytes(50)
    path = tmp_path / "a.mcap"
    path.write_bytes(MAGIC + struct.pack("<BQ", 6, len(content)) + content)
    with pytest.raises(InputError, match="chunk's header"):
        load(path)


def test_record_longer_than_the_file_costs_no_memory(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(MAGIC + struct.pack("<BQ", 6, 2**40) + bytes(100))
    with pytest.raises(InputError, match="no IMU"):
        load(path)


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
