"""A point that is held does not go where no hand goes: then it travels, or something is missing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from worlds import recording_of

from handcal.explain import explain, pipeline
from handcal.search.budget import Budget
from handcal.search.multistart import search
from handcal_sim import simulate

STICKS = 1.5  # m/s^2, either side of zero: as no accelerometer errs


def turned(sticks: float):
    recording = recording_of(simulate("free-hand", seed=0, duration_s=60.0))
    force = recording.imu.accel
    wrong = sticks * np.tanh(force / 0.4) * [0.0, 0.0, 1.0]
    return replace(recording, imu=replace(recording.imu, accel=force + wrong))


@pytest.mark.prove
@pytest.mark.parametrize(("sticks", "doubts"), [(0.0, 0), (STICKS, 1)])
def test_what_would_have_the_hand_sway_by_metres_is_doubted(sticks, doubts, monkeypatch):
    """Of a search that finds nothing."""

    def in_vain(base, *_, **__):
        return search(base, budget=Budget(until=0.0))

    monkeypatch.setattr(pipeline, "search", in_vain)
    monkeypatch.setattr(pipeline, "_by_the_rests", lambda *given: given[1])
    found = explain([turned(sticks)])
    assert len([w for w in found.warnings if "more than that of a hand" in w]) == doubts
