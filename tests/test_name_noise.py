"""What happened at one moment is told about the trajectory that noise in its place has found."""

from __future__ import annotations

import pytest
from worlds import climbed_from, recording_of

from handcal.effects import catalogue
from handcal.estimate.baseline import baseline
from handcal.estimate.case import case_of, name_of
from handcal.estimate.fit import fitted
from handcal_sim import simulate

STEP = {"gyro_bias_step": [0.009, -0.012, 0.01, 27.35]}
WALK = {"gyro_bias_walk": [1.5e-3]}


@pytest.mark.prove
@pytest.mark.parametrize("effects", [STEP, WALK])
def test_a_step_is_told_in_the_place_of_a_walk_and_a_walk_stays(effects):
    world = simulate("free-hand", seed=0, duration_s=40.0, effects=effects)
    base = baseline([case_of(recording_of(world, "heading"))])
    walk = catalogue()["gyro_bias_walk"]
    found = climbed_from(fitted(base.parts, [*base.effects, walk]).bare, base.ids)
    assert [name_of(i) for i in found.ids if i not in base.ids] == [*effects]
    moments = [float(i.partition("@")[2]) for i in found.chosen if "@" in i]
    assert moments == pytest.approx([27.35] * (effects is STEP), abs=0.1)
