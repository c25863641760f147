"""Mutated files of every format end in a value or a sentence: the short form of `make fuzz`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from format_files import WRITERS
from fuzz import SLOWEST_S, Score, Seed, dictionary, execute, fuzz, seeds

from handcal.recordings import inputs
from handcal.types import InputError


@pytest.fixture(scope="module")
def all_seeds() -> list[Seed]:
    return seeds(np.random.default_rng(0))


def test_no_mutation_gets_past_the_sentence() -> None:
    scores = fuzz(400, seed=0)
    assert {kind: s.failures for kind, s in scores.items() if s.failures} == {}
    assert sum(s.executions for s in scores.values()) == 400
    assert sum(s.accepted for s in scores.values()) > 40, "mutations reach no further than checks"


def test_every_format_of_the_folder_is_attacked(all_seeds: list[Seed]) -> None:
    formats = {module.__name__.rsplit(".", 1)[-1] for module in inputs.formats()}
    assert formats <= {s.kind for s in all_seeds}
    assert len(dictionary()) > 100


def test_seeds_are_read_before_they_are_mutated(all_seeds: list[Seed], tmp_path: Path) -> None:
    known = {"mcap", "plain_csv", "sensor_logger", "grid TOML", "bench table", *WRITERS}
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


@pytest.mark.prove
def test_five_files_cut_at_every_16th_byte(all_seeds: list[Seed], tmp_path: Path) -> None:
    score = Score()
    chosen = [s for s in all_seeds if s.kind in ("mcap", "plain_csv", "sensor_logger")]
    for seed in chosen:
        small = seed.content if len(seed.content) < 40_000 else seed.content[:40_000]
        for end in range(0, len(small), 16):
            assert execute(seed, small[:end], tmp_path / f"x{seed.suffix}", score) is None, end
    print(f"{score.executions} truncations of {len(chosen)} files, {score.accepted} recovered")
