"""What is always felt of a signal, beside how much of it is: part of a law, or a name."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from worlds import recording_of

from handcal.effects import catalogue
from handcal.estimate.baseline import baseline
from handcal.estimate.case import case_of
from handcal.estimate.fit import fitted
from handcal.laws.best_law import Term
from handcal.laws.grammar import formula
from handcal.laws.law_effect import Law, effect_of
from handcal.laws.vocabulary import driver_of
from handcal.search.climb.candidates import scanned
from handcal.search.climb.law_steps import take_in
from handcal.search.climb.state import Climb
from handcal_sim import simulate

LAW = Law(0, (1,), False, driver_of("omega_{i} by f_{i}"), formula([("bump", (0.0, 3.0))]), (0.01,))


@pytest.mark.parametrize("own", [True, False])
def test_a_scale_error_of_one_axis_beside_its_gains_law_is_part_of_that(own: bool) -> None:
    """And one of all three axes is not."""
    scale = np.array([0.0, 0.04, 0.0] if own else [0.03, 0.04, -0.03])
    recording = recording_of(simulate("free-hand", seed=0, duration_s=40.0), "heading")
    gyro, f = recording.imu.gyro.copy(), recording.imu.accel
    gyro *= 1.0 + scale
    gyro[:, 1] += 0.05 * recording.imu.gyro[:, 1] * np.exp(-0.5 * (f[:, 1] / 3.0) ** 2)
    base = baseline([case_of(replace(recording, imu=replace(recording.imu, gyro=gyro)))])
    law = effect_of(LAW)
    # (taken for one that few devices have: what every device has stays)
    model = fitted(base.parts, [*base.effects, replace(catalogue()["gyro_scale"], common=""), law])
    c = Climb(model, [Term(law, 100.0)])
    c.kept = frozenset(base.ids)
    c.where = scanned(c)
    found = take_in(c)
    if not own:
        assert found is None
        return
    assert found is not None
    assert "gyro_scale" not in found.ids
    assert c.unnamed[0].effect.id.endswith("+ k2 * omega_y")
    # (asked once)
    c.model = found
    assert take_in(c) is None
