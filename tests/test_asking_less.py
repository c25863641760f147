"""What a search does not ask twice, nor where the answer would not count."""

from __future__ import annotations

from dataclasses import replace

import pytest
from worlds import recording_of

from handcal.estimate.baseline import baseline
from handcal.estimate.case import case_of
from handcal.estimate.model import Model
from handcal.explain import pipeline
from handcal.search import multistart
from handcal.search.budget import Budget
from handcal_sim import simulate


@pytest.fixture(scope="module")
def base() -> Model:
    world = simulate("free-hand", seed=0, duration_s=15.0, effects={})
    return baseline([case_of(recording_of(world, "heading"))])


def test_no_second_climb_where_the_first_is_superseded(
    base: Model, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun: list[Model] = []

    def end(start: Model, *_: object) -> multistart.Found:
        begun.append(start)
        return multistart.Found(start, None, {}, {})  # type: ignore[arg-type]

    monkeypatch.setattr(multistart, "_end", end)
    monkeypatch.setattr(multistart, "sways_far", lambda _: True)
    monkeypatch.setattr(multistart, "advantage", lambda *_: 0.0)
    monkeypatch.setattr(multistart, "_may_stand_in", lambda _: False)
    multistart.search(base)
    assert len(begun) == 2
    begun.clear()
    assert multistart.search(base, superseded=lambda _: True).model is begun[0]
    assert len(begun) == 1


def test_a_hand_is_asked_about_once_for_each_end(
    base: Model, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[object] = []
    monkeypatch.setattr(pipeline, "moving", lambda _, model, __: asked.append(model))
    monkeypatch.setattr(pipeline, "_gained", lambda _: {})
    hand = pipeline._Hand(base, True, Budget())
    one, other = (
        multistart.Found(replace(base), None, {}, {})  # type: ignore[arg-type]
        for _ in range(2)
    )
    assert not hand.moves(one)
    assert hand.other(one) is None
    assert len(asked) == 1
    assert hand.other(other) is None
    assert len(asked) == 2
    assert not pipeline._Hand(base, False, Budget()).moves(one)
    assert len(asked) == 2
