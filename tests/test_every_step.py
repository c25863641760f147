"""Steps of the climb, each in a recording of which ``explain`` says something else without it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from worlds import recording_of

from handcal.explain import explain
from handcal_sim import simulate
from handcal_sim.phone import Phone, capture_pose, consumer_phone

pytestmark = pytest.mark.prove


def filmed(rng: np.random.Generator) -> Phone:
    return replace(consumer_phone(rng), heading=None, pose=capture_pose(rng))


@pytest.mark.parametrize("seed", range(3))
def test_add_noise_a_pose_that_drifts(seed: int) -> None:
    """Else nothing is missing, or a metre that is off stands in for it."""
    drift = {"pose_drift": [0.0074, 4.7e-4]}
    world = simulate("free-hand", seed=seed, duration_s=30.0, phone=filmed, effects=drift)
    found = explain([recording_of(world, "pose")])
    assert [m.effect for m in found.missing] == ["pose_drift"]
    assert not found.unnamed
