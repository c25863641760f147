"""Hands that are led: what they do, and how it is scored."""

from __future__ import annotations

import numpy as np
import pytest
import schemas

from handcal.live.turns import CHOICE
from handcal_sim.prove.live import Hand, cut, lines, routine, score


def trial(k: int) -> dict:
    errors = [0.5, -1.0, 2.0]
    led = {"worst": 0.5 + 0.01 * k, "errors": errors}
    return {"seed": k, "guided": led | {"names": ["a", "b"], "seen": 2},
            "unguided": {"worst": 1.0 + 0.02 * k, "errors": errors}, "planned": led,
            "soon": {"seconds": 30.0 + k, "enough": k > 0, "names": ["a"], "seen": 0}}  # fmt: skip


def test_a_score_is_of_pairs_and_follows_its_schema():
    trials = [trial(k) for k in range(5)]
    found = score(trials) | {"seed": 0, "took_s": 1.0, "trials": trials}
    schemas.check(found)
    assert found["unguided_to_guided"] == {"median": 2.0, "from": 2.0, "to": 2.0}
    assert found["guided_to_planned"]["median"] == 1.0
    assert (found["enough"], found["seconds_to_enough"]["median"]) == (4, 32.5)
    assert (found["motions_asked"], found["motions_seen_done"]) == (15, 10)
    assert found["errors"]["rms"] == pytest.approx(np.sqrt(5.25 / 3.0))
    assert any("2.00" in line for line in lines(found))


def test_a_hand_turns_as_it_is_asked_in_its_own_way():
    """The angles come out as asked to a tenth; what was done stays when more is asked for; nothing
    is recorded beyond it."""
    turns = [((0.0, 0.0, 1.0), 0.0, 3.0), *CHOICE[2].motion.turns]
    hand = Hand(3, 50.0)
    made = hand.human(turns)
    assert hand.human([*turns, *CHOICE[0].motion.turns])[: len(made)] == made
    world, recording = hand.recorded(turns)
    assert recording.duration_s == pytest.approx(sum(s for _, _, s in made), abs=0.05)
    about_z = recording.imu.gyro[:, 2] - world.parameters["effects"]["gyro_bias"][2]["value"]
    there = float(np.clip(about_z, 0.0, None).sum() / 50.0)
    assert np.degrees(there) == pytest.approx(360.0, rel=0.15)
    assert cut(recording, 2.0).duration_s == pytest.approx(2.0, abs=0.03)
    assert sum(s for _, _, s in routine(60.0)) >= 60.0
