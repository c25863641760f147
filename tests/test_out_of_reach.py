"""A point that is held does not go where no hand goes: then it travels, or something is missing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from worlds import recording_of, slow

from handcal.estimate.baseline import baseline
from handcal.estimate.case import case_of
from handcal.estimate.rest_only import doubt
from handcal_sim import simulate


@pytest.mark.parametrize("sticks", [0.0, 1.5])
def test_what_would_have_the_hand_sway_by_metres_is_doubted(sticks: float) -> None:
    """An accelerometer that sticks by so much, m/s^2, either side of zero, as none does."""
    recording = recording_of(simulate("free-hand", seed=0, duration_s=40.0, phone=slow))
    force = recording.imu.accel
    wrong = sticks * np.tanh(force / 0.4) * [0.0, 0.0, 1.0]
    read = replace(recording, imu=replace(recording.imu, accel=force + wrong))
    (part,) = baseline([case_of(read, "fixed-point")]).parts
    said = doubt(part) or ""
    assert ("more than that of a hand" in said) == (sticks > 0.0)
