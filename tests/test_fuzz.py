"""Mutated files of every format end in a value or a sentence: the short form of `make fuzz`."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from format_files import WRITERS
from fuzz import SLOWEST_S, Score, Seed, dictionary, execute, fuzz, seeds
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Chunk, Message
from mcap.stream_reader import breakup_chunk
from sample_recording import IMU, imu_messages, sample, write_channels

from handcal.recordings import inputs
from handcal.types import InputError, Recording

MCAP_MAGIC = b"\x89MCAP0\r\n"
LEAST = 201  # (samples at 100 Hz that make the two seconds which a recording needs)


@pytest.fixture(scope="module")
def all_seeds() -> list[Seed]:
    return seeds(np.random.default_rng(0))


def test_no_mutation_gets_past_the_sentence() -> None:
    scores = fuzz(200, seed=0)
    assert {kind: s.failures for kind, s in scores.items() if s.failures} == {}
    assert sum(s.executions for s in scores.values()) == 200
    assert sum(s.accepted for s in scores.values()) > 20, "mutations reach no further than checks"


def test_every_format_of_the_folder_is_attacked(all_seeds: list[Seed]) -> None:
    formats = {module.__name__.rsplit(".", 1)[-1] for module in inputs.formats()}
    assert formats <= {s.kind for s in all_seeds}
    assert len(dictionary()) > 100


def test_seeds_are_read_before_they_are_mutated(all_seeds: list[Seed], tmp_path: Path) -> None:
    known = {"mcap", "plain_csv", "sensor_logger", "grid TOML", "bench table", *WRITERS,
             "device TOML", "priors TOML", "manifest", "batch of live"}  # fmt: skip
    for n, seed in enumerate(s for s in all_seeds if s.kind in known or "JSON" in s.kind):
        score = Score()
        assert execute(seed, seed.content, tmp_path / f"{n}{seed.suffix}", score) is None
        assert score.accepted == 1, seed.kind


def test_a_failure_would_be_seen(tmp_path: Path) -> None:
    def broken(_: Path) -> None:
        raise KeyError("x")

    def hanging(_: Path) -> None:
        while True:
            pass

    def refusing(_: Path) -> None:
        raise InputError("no")

    def place(read: object) -> str | None:
        seed = Seed("x", ".x", b"x", read)  # type: ignore[arg-type]
        return execute(seed, b"x", tmp_path / "x", Score())

    assert place(refusing) is None
    assert "KeyError" in (place(broken) or "")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("fuzz.SLOWEST_S", 1)
        assert "TooSlow" in (place(hanging) or "")
    assert SLOWEST_S == 10


@pytest.mark.parametrize("kind", ["mcap", "plain_csv", "sensor_logger"])
def test_a_file_cut_at_every_kth_byte_gives_what_it_holds(
    all_seeds: list[Seed], kind: str, tmp_path: Path
) -> None:
    """Never more readings than the whole file, and more as more of it is left."""
    seed = next(s for s in all_seeds if s.kind == kind)
    path = tmp_path / f"x{seed.suffix}"
    held = []
    for end in [*range(7, len(seed.content), len(seed.content) // 40), len(seed.content)]:
        path.write_bytes(seed.content[:end])
        try:
            held.append(len(inputs.load(path).imu.t))
        except InputError:
            held.append(0)
    assert held == sorted(held)
    assert held[-1] > 200


def cut_at(path: Path, content: bytes, whole: Recording, end: int, held: int) -> int:
    """Load the beginning of a recording, of whose messages so many lie in whole chunks; how many
    samples were read. Those are the first, and that others are lost is said."""
    path.write_bytes(content[:end])
    try:
        back = inputs.load(path)
    except InputError:
        assert held < LEAST, f"{held} messages were lost, cut at {end}"
        return 0
    n = len(back.imu.t)
    assert n >= held
    np.testing.assert_array_equal(back.imu.gyro, whole.imu.gyro[:n])
    np.testing.assert_array_equal(back.imu.accel, whole.imu.accel[:n])
    said = f"{n} messages were recovered" in " ".join(back.warnings)
    assert said or n == len(whole.imu.t)
    return n


def chunk_ends(content: bytes) -> dict[int, int]:
    """By where each chunk of an MCAP ends: the messages up to there."""
    ends, at, held = {}, len(MCAP_MAGIC), 0
    while at < len(content) - len(MCAP_MAGIC):
        size = int.from_bytes(content[at + 1 : at + 9], "little")
        if content[at] == Opcode.CHUNK:
            chunk = Chunk.read(ReadDataStream(BytesIO(content[at + 9 : at + 9 + size])))
            held += sum(isinstance(r, Message) for r in breakup_chunk(chunk))
            ends[at + 9 + size] = held
        at += 9 + size
    return ends


@pytest.fixture
def chunks(tmp_path: Path) -> tuple[Recording, bytes, dict[int, int]]:
    """A recording in chunks, its bytes, and where its chunks end."""
    recording = sample(n=450, streams=False)
    path = write_channels(tmp_path / "a.mcap", [("/imu", IMU, "cdr")], imu_messages(recording))
    content = path.read_bytes()
    ends = chunk_ends(content)
    assert len(ends) > 5
    assert max(ends.values()) == len(recording.imu.t)
    return recording, content, ends


def test_every_whole_chunk_is_recovered_and_said(
    chunks: tuple[Recording, bytes, dict[int, int]], tmp_path: Path
) -> None:
    """Cut before, at and behind the end of each chunk."""
    recording, content, ends = chunks
    before = 0
    for end, held in ends.items():
        assert cut_at(tmp_path / "x.mcap", content, recording, end - 1, before) < held
        for further in (0, 1):
            cut_at(tmp_path / "x.mcap", content, recording, end + further, held)
        before = held


@pytest.mark.prove
def test_a_recording_in_chunks_cut_at_every_byte(
    chunks: tuple[Recording, bytes, dict[int, int]], tmp_path: Path
) -> None:
    recording, content, ends = chunks
    held = 0
    for end in range(len(content)):
        held = ends.get(end, held)
        cut_at(tmp_path / "x.mcap", content, recording, end, held)
    print(f"{len(content)} truncations, {len(ends)} chunks")


@pytest.mark.prove
def test_five_files_cut_at_every_byte(all_seeds: list[Seed], tmp_path: Path) -> None:
    score = Score()
    chosen = [s for s in all_seeds if s.kind in ("mcap", "plain_csv", "sensor_logger")]
    for seed in chosen:
        small = seed.content if len(seed.content) < 40_000 else seed.content[:40_000]
        for end in range(len(small)):
            assert execute(seed, small[:end], tmp_path / f"x{seed.suffix}", score) is None, end
    print(f"{score.executions} truncations of {len(chosen)} files, {score.accepted} recovered")
