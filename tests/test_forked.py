"""Work in a copy of the process: the same results, in their order, whatever happens to the copy."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator
from functools import partial

import numpy as np
import pytest
from worlds import recording_of

from handcal.effects import Effect, catalogue, select
from handcal.estimate import forked
from handcal.estimate.assemble import addresses
from handcal.estimate.baseline import started
from handcal.estimate.case import case_of
from handcal.estimate.fit import fitted
from handcal.estimate.forked import in_parallel
from handcal.laws import shapes
from handcal.laws.drivers import DRIVERS
from handcal.laws.grammar import formula
from handcal.laws.law_effect import Law
from handcal_sim import simulate

# Courses over time, as they are written down.
KNOWN = [("bump", (4.0, 1.0)), ("bump", (9.0, 1.5))]

pytestmark = pytest.mark.skipif(
    sys.platform != "linux", reason="elsewhere one thing is done after the other"
)


@pytest.fixture(autouse=True)
def two_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1})


def where(k: int) -> tuple[int, int]:
    return k, os.getpid()


def test_every_other_call_is_done_elsewhere_and_results_keep_their_order() -> None:
    for n in range(7):
        found = list(in_parallel(partial(where, k) for k in range(n)))
        assert [k for k, _ in found] == list(range(n))
        # (which ones follows from how long they take; one alone is no work for two)
        assert {p for _, p in found if p != os.getpid()} or n < 2
        assert n == 0 or found[0][1] == os.getpid()


def test_work_within_such_work_stays_where_it_is() -> None:
    def inner(_: int) -> list[int]:
        own = os.getpid()
        return [p - own for _, p in in_parallel(partial(where, j) for j in range(3))]

    assert list(in_parallel(partial(inner, k) for k in range(2))) == [[0, 0, 0]] * 2


@pytest.mark.parametrize("why", ["one core", "unknown", "one allowed", "a thread", "no waiting"])
def test_one_after_the_other(why: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if why in ("one core", "unknown"):
        monkeypatch.setattr(os, "cpu_count", lambda: 1 if why == "one core" else None)
    if why == "one allowed":
        monkeypatch.setattr(os, "sched_getaffinity", lambda _: {1})
    found: list[tuple[int, int]] = []

    def run() -> None:
        found.extend(in_parallel(partial(where, k) for k in range(4)))

    before = signal.getsignal(signal.SIGCHLD)
    try:
        if why == "no waiting":
            signal.signal(signal.SIGCHLD, signal.SIG_IGN)
        if why == "a thread":
            other = threading.Thread(target=run)
            other.start()
            other.join()
        else:
            run()
    finally:
        signal.signal(signal.SIGCHLD, before)
    assert found == [(k, os.getpid()) for k in range(4)]


def test_a_copy_that_somebody_else_waited_for_loses_nothing() -> None:
    here = os.getpid()

    def call(k: int) -> int:
        if os.getpid() == here and k == 0:
            os.waitpid(-1, 0)
        return k

    assert list(in_parallel(partial(call, k) for k in range(3))) == [0, 1, 2]


@pytest.mark.parametrize("wrong", [1, 2])
def test_what_raises_does_so_in_its_turn(wrong: int) -> None:
    here = os.getpid()

    def call(k: int) -> int:
        if os.getpid() != here:
            time.sleep(0.2)  # (so that the third is done before the second)
        if k == wrong:
            raise ValueError("no fit")
        return k

    ways = in_parallel(partial(call, k) for k in range(3))
    assert [next(ways) for _ in range(wrong)] == list(range(wrong))
    with pytest.raises(ValueError, match="no fit"):
        next(ways)


def test_a_copy_that_is_killed_loses_nothing() -> None:
    here = os.getpid()

    def call(k: int) -> int:
        if os.getpid() != here:
            os.kill(os.getpid(), signal.SIGKILL)
        return k

    assert list(in_parallel(partial(call, k) for k in range(5))) == list(range(5))


@pytest.mark.parametrize("what", ["fork", "memfd_create"])
def test_where_there_is_no_room_for_a_copy_all_is_done_here(
    what: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def none(*_: object) -> int:
        raise OSError("no memory")

    monkeypatch.setattr(forked.os, what, none)
    assert list(in_parallel(partial(where, k) for k in range(4))) == [
        (k, os.getpid()) for k in range(4)
    ]


def test_what_takes_little_time_is_done_elsewhere_several_at_a_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    copies: list[int] = []
    fork = os.fork

    def noted() -> int:
        copies.append(1)
        return fork()

    monkeypatch.setattr(forked.os, "fork", noted)

    def slow(k: int) -> tuple[int, int]:
        time.sleep(0.01)
        return where(k)

    found = list(in_parallel(partial(slow, k) for k in range(60)))
    assert [k for k, _ in found] == list(range(60))
    there = Counter(process for _, process in found)
    assert len(there) == 1 + len(copies)
    assert len(copies) > 1
    assert 1 < max(n for process, n in there.items() if process != os.getpid()) <= forked.MOST


def test_nobody_works_on_when_nobody_asks(monkeypatch: pytest.MonkeyPatch) -> None:
    begun: list[int] = []
    fork = os.fork

    def noted() -> int:
        process = fork()
        begun.append(process)
        return process

    monkeypatch.setattr(forked.os, "fork", noted)
    here = os.getpid()
    ways: Iterator[None] = in_parallel(
        (lambda: None if os.getpid() == here else time.sleep(600.0)) for _ in range(2)
    )
    next(ways)
    ways.close()  # type: ignore[attr-defined]
    assert len(begun) == 1
    with pytest.raises(ProcessLookupError):
        os.kill(begun[0], 0)


def test_nothing_stays_open() -> None:
    def opened() -> int:
        return len(os.listdir("/proc/self/fd"))

    before = opened()
    for asked in range(5):
        ways = in_parallel(partial(where, k) for k in range(4))
        for _ in range(asked):
            next(ways, None)
        ways.close()  # type: ignore[attr-defined]
    assert opened() == before


def test_what_was_given_comes_back_itself_and_new_effects_are_made_here() -> None:
    given, effect = np.arange(5.0), catalogue()["gyro_scale"]
    law = Law(0, (1,), False, DRIVERS["omega_{i}"], formula([("cube", ())]), (1.0,))

    def call(k: int) -> tuple[np.ndarray, np.ndarray, Effect, Law, Effect]:
        other = shapes.again("heading", next(iter(KNOWN)))
        return given, given + k, effect, Law(*vars(law).values()), other

    for k, (same, new, known, again, other) in enumerate(
        in_parallel(partial(call, k) for k in range(3))
    ):
        assert same is given
        assert known is effect
        assert np.array_equal(new, given + k)
        assert again.said == law.said
        assert again is not law
        assert isinstance(other, Effect)


def test_a_fit_is_the_same_to_the_last_bit_and_can_be_gone_on_with() -> None:
    """Also where what acts on an observation is compiled in the copy alone."""
    world = simulate("free-hand", seed=0, duration_s=15.0)
    begin = started(case_of(recording_of(world, "heading")))
    courses = [shapes.again("heading", made) for made in KNOWN]
    ways = [(*select(("gyro_scale", "heading_correlated_noise")), e) for e in courses]
    elsewhere = list(in_parallel(partial(fitted, [begin], effects) for effects in ways))
    for effects, found in zip(ways, elsewhere, strict=True):
        here = fitted([begin], effects)
        assert found.log_evidence == here.log_evidence
        assert np.array_equal(found.covariance, here.covariance)
        assert all(a is b for a, b in zip(found.effects, effects, strict=True))
        (f,) = found.parts
        assert f.case.recording is begin.case.recording
        jacobian, function = addresses(f.problem.observations, f.problem.effects)
        assert np.array_equal(f.problem.tables.function, function)
        assert np.array_equal(f.problem.tables.jacobian, jacobian)
        again = (fitted(m.parts, effects).log_evidence for m in (found, here))
        assert next(again) == next(again)
