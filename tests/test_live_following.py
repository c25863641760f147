"""The filter of a session: it has taken every sample as soon as it came, with a look or without."""

from __future__ import annotations

from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from turned_in_hand import recorded

from handcal.compiled import so3
from handcal.live.ending import Wanted, with_convention
from handcal.live.following import Following
from handcal.live.looks import Looks, looked
from handcal.live.progress import Live, checks
from handcal.live.recorder import opened
from handcal.live.session import Session
from handcal.live.sources import file
from handcal.live.sources.browser import Convention
from handcal.types import Recording, Standing

EFFECTS = ("gyro_scale",)


@pytest.fixture(scope="module")
def recording(tmp_path_factory) -> Recording:
    return recorded(tmp_path_factory.mktemp("following"))


@pytest.fixture(scope="module")
def look(recording):
    n = int(np.searchsorted(recording.imu.t, 9.0))
    imu = recording.imu
    imu = replace(imu, t=imu.t[:n], gyro=imu.gyro[:n], accel=imu.accel[:n], valid=imu.valid[:n])
    return looked(replace(recording, imu=imu), EFFECTS, None, {})


@pytest.fixture
def session(tmp_path: Path):
    made = Session(opened(tmp_path / "recording.mcap"), source="file")
    yield made
    made.recorder.close()


def same(recording: Recording) -> Recording:
    return recording


def following() -> Following:
    made = Following(EFFECTS)
    assert made.ready.wait(120.0)
    return made


def fed(session: Session, recording: Recording, seconds: float, each: Any) -> None:
    """Batch by batch up to so much; each: called after every one."""
    for at, batch in file.batches(recording, session.next):
        if at > seconds:
            return
        session.take(batch)
        each()


def test_it_has_every_sample_as_soon_as_it_came_and_each_once(session, recording, look):
    """First by the levels of the first rest; then where a look stands, which is older than that."""
    filtered, seen = following(), []

    def each() -> None:
        fresh = filtered.saw(session, same)
        if fresh is not None:
            assert fresh.t_ns == session.recorder.last_ns
            seen.extend(t for i in fresh.innovations.values() for t in i.t)

    fed(session, recording, 11.0, each)
    before = filtered.told(0)
    sigma = filtered.frame.sigma.copy()
    filtered.stands(look.standing, look.noise, look.from_ns, session, same)
    assert filtered.frame.t == pytest.approx(session.recorder.seconds, abs=1e-9)
    after = filtered.told(0)
    apart = so3.matrix_log(np.reshape(after["held"], (3, 3)) @ np.reshape(before["held"], (3, 3)).T)
    assert np.degrees(np.linalg.norm(apart)) < 1.0
    # (first with what the session estimates, then with all that the look does)
    assert len(sigma) == 6 + 3 < len(filtered.frame.sigma) == len(look.parameters)
    assert not np.allclose(filtered.frame.sigma[:6], sigma[:6], rtol=1e-3)
    fed(session, recording, 16.0, each)
    assert len(seen) == len(set(seen)) == pytest.approx(3 * (15.9 - 1.0), abs=4)
    assert max(np.diff(sorted(seen))) < 0.8  # (what the look's catching up has seen is no gap)
    (one,) = filtered.told(0)["innovations"]
    assert 0.3 < one["times"] < 2.0
    assert one["beyond"] <= 2
    assert "times as large as expected" in checks(filtered.told(0))[1]


def test_another_window_has_another_yaw_which_is_not_shown(session, recording, look):
    """The look of the next window counts its yaw from its own beginning: seen from axes that are
    turned, it is shown just as it would be from others."""
    filtered, likewise = following(), following()

    def each() -> None:
        for one in (filtered, likewise):
            one.saw(session, same)

    fed(session, recording, 11.0, each)
    before = held(filtered)
    shift = 2_000_000_000
    later = replace(look.standing, t=look.standing.t - shift / 1e9)
    likewise.stands(later, look.noise, look.from_ns + shift, session, same)
    turn = so3.matrix_exp(np.array([0.0, 0.0, 1.0]))
    filtered.stands(turned(later, turn), look.noise, look.from_ns + shift, session, same)
    # (what the look knows better of the yaw is not shown either)
    sigma = float(np.sqrt(later.P[8, 8]))
    assert abs(likewise.turned) < 3.0 * sigma < 0.1
    assert filtered.turned == pytest.approx(likewise.turned - 1.0, abs=1e-6)
    np.testing.assert_allclose(held(filtered), held(likewise), atol=2e-4)  # (as it is rounded)
    assert np.degrees(np.linalg.norm(so3.matrix_log(held(filtered) @ before.T))) < 1.0


def held(filtered: Following) -> np.ndarray:
    return np.reshape(filtered.told(0)["held"], (3, 3))


def turned(s: Standing, turn: np.ndarray) -> Standing:
    """The same seen from axes that are turned: place, velocity, attitude and the hand's sway."""
    T, constants = np.eye(len(s.P)), 15 + len(s.names)
    for i in (0, 3, 6, *range(constants, len(s.P), 3)):
        T[i : i + 3, i : i + 3] = turn
    seen = {"p": turn @ s.p, "v": turn @ s.v, "C": turn @ s.C, "extras": T[15:, 15:] @ s.extras}
    return replace(s, P=T @ s.P @ T.T, **seen)


def test_what_was_read_wrongly_is_not_gone_on_with(session, recording, look):
    filtered = following()
    fed(session, recording, 5.0, lambda: filtered.saw(session, same))
    filtered.give_up()
    assert filtered.saw(session, same) is None
    assert filtered.told(0) is None
    fed(session, recording, 11.0, lambda: filtered.saw(session, same))

    def turned(some: Recording) -> Recording:
        return with_convention(some, Convention(sign=1))

    filtered.stands(look.standing, look.noise, look.from_ns, session, turned)
    assert filtered.saw(session, turned).t_ns == session.recorder.last_ns


def test_without_it_looks_are_shown(session, recording, look):
    """And the gyro carries the attitude from a look to now."""

    class Now(Busy):
        def submit(self, *_: Any) -> Future[Any]:
            done: Future[Any] = Future()
            done.set_result(replace(look, standing=None))
            return done

    worker: Any = Now()
    live = Live(session, Wanted(), Looks(worker, EFFECTS), None)
    assert live.following.ready.wait(120.0)
    fed(session, recording, 9.0, lambda: None)
    fed(session, recording, 11.0, live.tick)
    assert "filter" not in session.told
    assert live.attitude is not None
    assert live.attitude[0] == session.recorder.last_ns
    (first, *_) = session.told["parameters"]
    p = look.parameters[0]
    assert f"{np.degrees(p.value):+.3f}"[1:4] in first["text"]


class Busy:
    """A process that has not come to the end of its look."""

    def submit(self, *_: Any) -> Future[Any]:
        return Future()


def test_what_is_shown_waits_for_no_look(session, recording):
    """Estimates, attitude and innovations are told and drawn although no look ever ends; of a
    device that is known before they are as sure from the beginning on."""
    drawn: dict[str, list[float]] = {"estimates": [], "updates": [], "readings": []}

    class Board:
        def readings(self, t: np.ndarray, *_: Any) -> None:
            drawn["readings"].append(t[-1])

        def estimates(self, t: float, *_: Any) -> None:
            drawn["estimates"].append(t)

        def updates(self, innovations: Any) -> None:
            drawn["updates"].extend(innovations["fixed_position"].t)

        def guidance(self, *_: Any) -> None: ...
        def hypotheses(self, *_: Any) -> None: ...

    worker: Any = Busy()
    live = Live(session, Wanted(), Looks(worker, EFFECTS), None, Board())
    assert live.following.ready.wait(120.0)
    fed(session, recording, 9.0, live.tick)
    told = session.told
    assert told["filter"]["seconds"] == pytest.approx(session.recorder.seconds, abs=1e-3)
    assert told["parameters"][0]["name"].startswith("Gyro bias")
    assert len(told["parameters"]) == 9
    assert drawn["estimates"][-1] == pytest.approx(drawn["readings"][-1])
    assert len(drawn["estimates"]) > 20
    assert len(drawn["updates"]) == pytest.approx(3 * 7.9, abs=4)
    assert live.attitude is not None
