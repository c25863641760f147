"""``explain --budget`` ends in time with the best model so far, and says what was left untried."""

from __future__ import annotations

import json
import math
import time
from dataclasses import replace

import numpy as np
import pytest
import schemas
from worlds import recording_of

from handcal.explain import explain
from handcal.search.budget import AFTERWARDS, Budget, after
from handcal.show.explanation.document import explanation_json
from handcal.show.explanation.verdict_text import verdict
from handcal.types import Recording
from handcal_sim import simulate
from handcal_sim.phone import Clocking, Phone, consumer_phone, with_rate


def slow(rng: np.random.Generator) -> Phone:
    phone = with_rate(consumer_phone(rng), 50.0)
    assert phone.heading is not None
    return replace(phone, heading=replace(phone.heading, clocking=Clocking(10.0)))


@pytest.fixture(scope="module")
def recording() -> Recording:
    world = simulate(
        "free-hand",
        seed=0,
        duration_s=20.0,
        phone=slow,
        effects={"gyro_scale": [0.02, -0.02, 0.02]},
    )
    return recording_of(world, "heading")


def test_without_time_nothing_is_claimed(recording: Recording) -> None:
    found = explain([recording], budget=0.0)
    assert (found.verdict, found.missing, found.unnamed) == ("cannot_tell", (), ())
    assert "further effects" in found.untried
    assert any("further effects" in w for w in found.warnings)
    assert verdict(found).headline.startswith("Time ran out")
    document = explanation_json(found)
    schemas.check(document)
    assert document["untried"] == list(found.untried)


def test_with_enough_of_it_nothing_changes(recording: Recording) -> None:
    whole = explanation_json(explain([recording]))
    schemas.check(whole)
    assert "untried" not in whole
    assert [m["effect"] for m in whole["missing"]] == ["gyro_scale"]
    assert json.dumps(whole) == json.dumps(explanation_json(explain([recording], budget=1e4)))


def test_what_was_found_by_then_is_kept(
    recording: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Time ends once an effect is in the model: it is named, and what comes after is not tried."""
    chosen = Budget.spent

    def spent(self: Budget, what: str) -> bool:
        if what == "laws that have no name":
            self.untried.append(what)
            return True
        return chosen(self, what)

    monkeypatch.setattr(Budget, "spent", spent)
    found = explain([recording])
    assert [m.effect for m in found.missing] == ["gyro_scale"]
    assert found.verdict == "explained"
    assert "laws that have no name" in found.untried


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
