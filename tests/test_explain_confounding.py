"""A disturbance grown wide hides what bends the compass, until it is taken back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from worlds import recording_of

from handcal.estimate import case
from handcal.estimate.baseline import baseline
from handcal.estimate.fit import fitted
from handcal.estimate.model import Model
from handcal.search.confounding import without_confounding
from handcal_sim import simulate
from handcal_sim.phone import Clocking, Phone, consumer_magnetometer, consumer_phone, with_rate


def compass(rng: np.random.Generator) -> Phone:
    """A consumer's phone that reads fifty times a second, its magnetometer ten times."""
    mag = replace(consumer_magnetometer(rng), clocking=Clocking(10.0))
    return replace(with_rate(consumer_phone(rng), 50.0), heading=None, mag=mag)


def base_of(effects: dict[str, list[float]], seed: int) -> Model:
    world = simulate("three-turns", seed=seed, duration_s=30.0, phone=compass, effects=effects)
    return baseline([case.case_of(recording_of(world, "mag"))])


def wide(model: Model) -> Model:
    """The fit with all that the magnetometer says laid to a disturbance, as if for good."""
    levels = {"mag_disturbance": 3e-5, "mag_noise": 2e-7}
    parts = [replace(f, levels=f.levels | levels) for f in model.parts]
    return fitted(parts, model.effects, noise_rounds=0)


@pytest.mark.parametrize("seed", range(2))
def test_a_wide_disturbance_is_taken_back_for_what_it_hid(seed: int) -> None:
    model = wide(base_of({"mag_soft_iron": [0.1, -0.15, 0.05, 0.1, -0.05, 0.1]}, seed))
    tried = set[str]()
    found = without_confounding(model, 1.0, tried)
    assert found is not None
    assert found.ids == ("mag_hard_iron", "mag_soft_iron")
    assert found.log_evidence > model.log_evidence + 100.0
    assert found.parts[0].levels["mag_disturbance"] < 3e-6
    assert {"mag_soft_iron", "heading_delay"} <= tried
    assert not {"gyro_scale", "accel_scale", "lever_arm"} & tried


def test_a_usual_disturbance_is_not_suspected() -> None:
    tried = set[str]()
    assert without_confounding(base_of({}, 0), 1.0, tried) is None
    assert not tried


def test_nothing_is_tried_twice() -> None:
    model = wide(base_of({"mag_soft_iron": [0.1, -0.15, 0.05, 0.1, -0.05, 0.1]}, 0))
    tried = set[str]()
    first = without_confounding(model, 1.0, tried)
    assert first is not None
    assert without_confounding(model, 1.0, tried) is None


def test_a_level_that_was_given_is_left_alone() -> None:
    model = wide(base_of({"mag_soft_iron": [0.1, -0.15, 0.05, 0.1, -0.05, 0.1]}, 0))
    given = {"mag_disturbance": 3e-5, "mag_noise": 2e-7}
    parts = tuple(replace(f, case=replace(f.case, fixed=given)) for f in model.parts)
    assert without_confounding(replace(model, parts=parts), 1.0, set()) is None
