"""What happened at one moment is told about the trajectory that noise in its place has found."""

from __future__ import annotations

import pytest
from worlds import recording_of

from handcal.effects import catalogue
from handcal.estimate.baseline import baseline
from handcal.estimate.case import case_of, name_of
from handcal.estimate.fit import fitted
from handcal.search.climb.candidates import scanned
from handcal.search.climb.noise_steps import name_noise
from handcal.search.climb.state import Climb
from handcal_sim import simulate

STEP = {"gyro_bias_step": [0.009, -0.012, 0.01, 27.35]}
WALK = {"gyro_bias_walk": [1.5e-3]}


@pytest.mark.parametrize(("effects", "named"), [(STEP, ["gyro_bias_step"]), (WALK, None)])
def test_a_step_is_told_in_the_place_of_a_walk_and_a_walk_stays(effects, named):
    world = simulate("free-hand", seed=0, duration_s=40.0, effects=effects)
    base = baseline([case_of(recording_of(world, "heading"))])
    walk = catalogue()["gyro_bias_walk"]
    climb = Climb(fitted(base.parts, [*base.effects, walk]).bare, ())
    climb.kept = frozenset(base.ids)
    climb.where = scanned(climb)
    found = name_noise(climb)
    if named is None:
        assert found is None
        return
    assert found is not None
    assert [name_of(i) for i in found.chosen] == named
    (moment,) = (float(i.partition("@")[2]) for i in found.chosen)
    assert abs(moment - 27.35) < 0.1
    assert name_noise(climb) is None  # (asked once of a model)
