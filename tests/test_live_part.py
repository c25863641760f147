"""Of a session of hours the part is explained in which it was turned most; all of it is kept."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from handcal.live import ending, part
from handcal.live.ending import Ended, Wanted
from handcal.live.recorder import opened
from handcal.live.session import Batch, Session
from handcal.recordings import append
from handcal.recordings.inputs import load
from handcal.types import InputError

STEP = 20_000_000  # 50 Hz
BEGIN = 1_760_000_000_000_000_000


def recorded(path: Path, minutes: int, turning: set[int]) -> Session:
    """Half a minute to the batch; turned fast in some of the minutes."""
    session = Session(opened(path), source="page")
    each = 50 * 30
    rng = np.random.default_rng(0)
    for seq in range(2 * minutes):
        ns = BEGIN + STEP * np.arange(seq * each, (seq + 1) * each)
        gyro = rng.normal(0.0, 1e-3, (each, 3))
        gyro[:, 1] += 0.8 if seq // 2 in turning else 0.01
        accel = np.tile([0.0, 0.0, -9.8], (each, 1)) + rng.normal(0.0, 0.01, (each, 3))
        temperature = ns[::500], np.full((3, 1), 20.0 + seq)
        session.take(Batch("one", seq, ns, gyro, accel, {"temperature": temperature}))
    return session


@pytest.fixture
def session(tmp_path) -> Session:
    return recorded(tmp_path / "recording.mcap", 12, {5, 6, 7})


def test_the_part_is_where_it_was_turned_most(session, monkeypatch):
    monkeypatch.setattr(part, "EXPLAINED_S", 180.0)
    begin, end = part.most_turned(session.recorder.path)
    assert ((begin - BEGIN) / 60e9, (end - BEGIN) / 60e9) == (5.0, 8.0)
    monkeypatch.setattr(part, "EXPLAINED_S", 3600.0)
    begin, end = part.most_turned(session.recorder.path)
    assert begin == BEGIN
    assert end > (session.recorder.last_ns or 0)
    session.recorder.close()


def test_all_is_kept_and_a_part_is_explained(tmp_path, session, monkeypatch):
    """With the sign that the beginning has told (gravity upside down), in both files."""
    monkeypatch.setattr(part, "EXPLAINED_S", 180.0)
    told = ending.Convention((0, 1, 2), -1, ("It began upside down.",))
    monkeypatch.setattr(ending, "told", lambda *_: told)
    seen: list[Any] = []

    def explained(recording: Any, *_: Any) -> Any:
        seen.append(recording)
        return Ended("headline", (), ())

    monkeypatch.setattr(ending, "_explained", explained)
    before = append.held(session.recorder.path)
    session.clocks = SimpleNamespace(sentence="")
    ended = ending.finish(session, tmp_path, Wanted(checked=True), lambda *_: None)
    assert "12 minutes" in ended.sentences[0]
    assert "It began upside down." in ended.sentences
    assert "part.mcap" in ended.files
    (recording,) = seen
    assert recording.duration_s == pytest.approx(180.0, abs=0.1)
    assert np.all(recording.imu.gyro[:, 1] > 0.7)
    assert np.median(recording.imu.accel[:, 2]) == pytest.approx(9.8, abs=0.01)
    whole = load(tmp_path / "recording.mcap")
    ns, value = before.streams["imu"]
    assert np.array_equal(whole.start_ns + np.rint(whole.imu.t * 1e9), ns)
    assert np.array_equal(whole.imu.gyro, value[:, :3])
    assert np.array_equal(whole.imu.accel, -value[:, 3:])
    temperature = whole.streams["temperature"].value
    assert np.array_equal(temperature, before.streams["temperature"][1])
    with pytest.raises(InputError, match="ended"):  # (also where it has several streams)
        opened(tmp_path / "recording.mcap")
    assert not [p for p in tmp_path.iterdir() if p.name.startswith(".")]
