"""``explain --budget`` ends in time with the best model so far, and says what was left untried."""

from __future__ import annotations

import json
import math
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import schemas
from typer.testing import CliRunner
from worlds import recording_of, slow

import handcal.explain
from handcal.commands._app import app
from handcal.explain import Explanation, explain
from handcal.interrupt import ENDING, asked
from handcal.live import run
from handcal.live.ending import Wanted
from handcal.live.recorder import opened
from handcal.live.session import Session
from handcal.search.budget import AFTERWARDS, SO_FAR, after
from handcal.show.explanation.document import explanation_json
from handcal.show.explanation.verdict_text import verdict
from handcal.types import Recording
from handcal_sim import simulate, write


def erring(effect: str, size: float, seconds: float) -> Recording:
    effects = {effect: [size, -size, size]}
    world = simulate("free-hand", seed=0, duration_s=seconds, phone=slow, effects=effects)
    return recording_of(world, "heading")


@pytest.fixture(scope="module")
def recording() -> Recording:
    return erring("gyro_scale", 0.02, 12.0)


@pytest.fixture(scope="module")
def hurried(recording: Recording) -> Explanation:
    return explain([recording], budget=0.0)


def test_without_time_nothing_is_claimed(hurried: Explanation) -> None:
    found = hurried
    assert (found.verdict, found.unnamed) == ("cannot_tell", ())
    assert "further effects" in found.untried
    assert any("further effects" in w for w in found.warnings)
    assert verdict(found).headline.startswith("The search ended before")
    document = explanation_json(found)
    schemas.check(document)
    assert document["untried"] == list(found.untried)


def test_with_enough_of_it_nothing_changes(recording: Recording) -> None:
    whole = explanation_json(explain([recording]))
    schemas.check(whole)
    assert "untried" not in whole
    assert [m["effect"] for m in whole["missing"]] == ["gyro_scale"]
    assert json.dumps(whole) == json.dumps(explanation_json(explain([recording], budget=1e4)))


def test_the_search_leaves_time_for_what_follows_it() -> None:
    began = time.monotonic() - 2.0
    left = after(began, 20.0)
    assert left.until == pytest.approx(began + 20.0 - AFTERWARDS * 2.0, abs=0.1)
    assert not left.spent("this")
    assert left.untried == []
    over = after(began, 1.0)
    assert all(over.spent("this") for _ in range(2))
    assert over.untried == ["this"]
    assert after(began, None).until == math.inf


def test_whoever_stops_has_what_was_found_by_then() -> None:
    """And where a law may be left, which was not looked for, the verdict is open."""
    stages: list[str] = []
    found = explain(
        [erring("gyro_quadratic", 0.01, 20.0)],
        stop=lambda: any(SO_FAR in s for s in stages),
        progress=lambda _, stage: stages.append(stage),
    )
    assert [m.effect for m in found.missing] == ["gyro_quadratic"]
    assert found.verdict == "cannot_tell"
    told = verdict(found)
    assert told.headline.startswith("The search ended before")
    assert told.sentences[0].startswith("Found: the gyro quadratic")
    assert "laws that have no name" in found.untried
    assert f"searching what is missing{SO_FAR}gyro_quadratic" in stages


@pytest.fixture
def heard() -> Iterator[None]:
    """(What a shell begins in the background is deaf to SIGINT.)"""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("heard")
def test_the_first_interrupt_asks_and_the_second_one_ends() -> None:
    told: list[str] = []
    with asked(told.append) as stop:
        assert not stop()
        os.kill(os.getpid(), signal.SIGINT)
        assert stop()
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
    assert told == [ENDING]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


@pytest.mark.usefixtures("heard")
def test_an_interrupt_ends_the_command_with_the_best_so_far(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(simulate("three-turns", seed=0, duration_s=12.0), tmp_path / "x.mcap")

    def pressed(*given: Any, **more: Any) -> Any:
        os.kill(os.getpid(), signal.SIGINT)
        return explain(*given, **more)

    monkeypatch.setattr(handcal.explain, "explain", pressed)
    arguments = ["explain", str(tmp_path / "x.mcap"), "--json", str(tmp_path / "x.json")]
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 0, (done.output, done.exception)
    assert "Ctrl-C again" in done.stderr
    document = json.loads((tmp_path / "x.json").read_text(encoding="utf-8"))
    assert document["verdict"] == "cannot_tell"
    assert "further effects" in document["untried"]


def test_what_was_not_weighed_has_no_probability(hurried: Explanation) -> None:
    """In the terminal it has a dash; JSON said 0.0 of an effect that is there."""
    document = explanation_json(hurried)
    named = {m["effect"] for m in document["missing"]}
    named |= {i for m in document["missing"] for i in m["indistinguishable_from"]}
    left = {h["probability"] for h in document["hypotheses"] if h["effect"] not in named}
    assert left == {None}


@pytest.mark.usefixtures("heard")
def test_an_interrupt_while_a_session_is_explained_ends_that_alone(
    recording: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    said: list[str] = []

    def finish(_session: Any, _out: Any, wanted: Wanted, _progress: Any) -> Any:
        assert wanted.stop is not None
        assert not wanted.stop()
        os.kill(os.getpid(), signal.SIGINT)
        return wanted.stop()

    monkeypatch.setattr(run, "finish", finish)
    monkeypatch.setattr(run.file, "feed", lambda *_, **__: None)
    session = Session(opened(tmp_path / "x.mcap"), source="file")
    assert run.fed(session, recording, 0.0, tmp_path, Wanted(), said.append)
    session.recorder.close()
    assert ENDING in said
