"""A bias that walks is not called what it happens to look like for a minute: a temperature."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from worlds import recording_of

from handcal.effects import catalogue
from handcal.estimate.baseline import baseline
from handcal.estimate.case import case_of
from handcal.estimate.fit import fitted
from handcal.estimate.model import Model
from handcal.score import better
from handcal.search.climb.candidates import scanned
from handcal.search.climb.noise_steps import noise_instead
from handcal.search.climb.state import Climb
from handcal_sim import simulate
from handcal_sim.phone import Clocking, Phone, Thermometer, consumer_phone, with_rate

TEMPERATURE = "accel_temperature"
# Over a minute a walk of this density wanders by what a coefficient of usual size does in 8 K.
WALK, COEFFICIENT = 2e-3, 2e-3


def warming(rng: np.random.Generator) -> Phone:
    phone = with_rate(consumer_phone(rng), 50.0)
    assert phone.heading is not None
    heading = replace(phone.heading, clocking=Clocking(10.0))
    return replace(phone, heading=heading, thermometer=Thermometer(reported=True))


def climb(effects: dict[str, list[float]], seed: int) -> tuple[Climb, Model]:
    """A climb that has taken the temperature for what is there, and the same without it."""
    world = simulate(
        "free-hand", seed=seed, duration_s=60.0, phone=warming, effects=effects, sway=0.3
    )
    base = baseline([case_of(recording_of(world, "heading", "temperature"), "fixed-point")])
    c = Climb(fitted(base.parts, [*base.effects, catalogue()[TEMPERATURE]]), ())
    c.where, c.kept = scanned(c), frozenset(base.ids)
    return c, base


@pytest.mark.parametrize("seed", range(3))
def test_a_walk_takes_the_place_of_what_it_looks_like(seed: int) -> None:
    c, _ = climb({"accel_bias_walk": [WALK]}, seed)
    other = noise_instead(c)
    assert other is not None
    assert {*other.ids} == {*c.model.ids, "accel_bias_walk"} - {TEMPERATURE}
    assert better(other, c.model, c.worth) > 0.0


@pytest.mark.parametrize("seed", range(2))
def test_what_goes_with_the_temperature_stays(seed: int) -> None:
    c, base = climb({TEMPERATURE: [COEFFICIENT] * 3}, seed)
    assert better(c.model, base, c.worth) > 0.0
    assert noise_instead(c) is None
