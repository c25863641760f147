"""How errors change between a device's recordings: known turn-on, ageing, slope, steps."""

from __future__ import annotations

import math

import numpy as np
import pytest

from handcal.population.drift import DAY_S, drift


def world(rng, devices=40, each=8, turn_on=0.0, walk=0.0, slope=0.0, spread=0.0, sigma=0.1,
          step=None):  # fmt: skip
    """Values of recordings, as ``drift`` takes them; walk: per square root of a month."""
    rows = []
    for d in range(devices):
        t = np.sort(rng.uniform(0.0, 360.0, each))
        warm = rng.normal(0.0, 8.0, each)
        wander = np.cumsum(rng.normal(0.0, 1.0, each) * np.sqrt(np.diff(t, prepend=t[0]) / 30.0))
        x = rng.normal(3.0, 5.0) + walk * wander + turn_on * rng.normal(size=each)
        x = x + (slope + spread * rng.normal()) * warm
        if step is not None and d == step[0]:
            x[step[1] :] += step[2]
        rows += [(x[i] + sigma * rng.normal(), sigma, d, DAY_S * t[i], 25 + warm[i])
                 for i in range(each)]  # fmt: skip
    value, sigmas, owner, started, warm = (np.array(c) for c in zip(*rows, strict=True))
    return value, sigmas, owner.astype(np.int64), started, warm, 10.0, [f"d{o}" for o in owner], 30


def test_nothing_but_sigmas_is_nothing():
    shares = [drift(*world(np.random.default_rng(seed))) for seed in range(4)]
    assert [d.steps for d in shares] == [()] * 4
    # (a size is asked for by 30 to 1, so of eight chances two are one in forty)
    assert sum(d.turn_on > 0 for d in shares) + sum(d.ageing > 0 for d in shares) <= 1
    assert all(abs(d.slope) < 4.0 * d.slope_sigma for d in shares)


@pytest.mark.parametrize(
    "true",
    [
        {"turn_on": 1.0},
        {"walk": 0.5},
        {"slope": 0.1, "turn_on": 0.3},
        {"turn_on": 0.7, "walk": 0.7},
    ],
)
def test_each_part_is_found_by_its_size(true):
    seeds = 3
    found = [drift(*world(np.random.default_rng(seed), **true)) for seed in range(seeds)]
    for name, of in (("turn_on", "turn_on"), ("walk", "ageing")):
        size = np.array([getattr(d, of) for d in found])
        # of 40 x 7 differences a size is known to 1 / sqrt(2 x 280) = 4 % alone, twice that beside
        # another; the mean of three and three sigmas
        expected = true.get(name, 0.0)
        assert abs(size.mean() - expected) < 3 * 0.085 * max(expected, 0.1) / math.sqrt(seeds) + (
            0.0 if expected else 0.1
        )
    z = [(d.slope - true.get("slope", 0.0)) / d.slope_sigma for d in found]
    assert max(map(abs, z)) < 4.0
    assert np.mean([d.slope_sigma for d in found]) < 0.05
    assert all(math.isclose(sum(d.shares.values()), 1.0) for d in found)
    assert [d.steps for d in found] == [()] * seeds


def test_a_knock_of_one_device_is_a_step_of_that_device():
    for seed in range(3):
        rng = np.random.default_rng(seed)
        d = drift(*world(rng, turn_on=0.3, step=(7, 4, 3.0)))
        (step,) = d.steps
        assert step.who == "d7"
        assert step.index == 7 * 8 + 4
        assert abs(step.size - 3.0) < 4.0 * step.sigma
        assert abs(d.turn_on - 0.3) < 0.06
        assert d.shares["step"] > 0.1


def test_where_devices_were_seen_once_nothing_is_told():
    assert drift(*world(np.random.default_rng(0), each=1)) is None
    value, sigma, owner, started, warm, usual, names, _ = world(np.random.default_rng(0))
    assert drift(value, sigma, owner, np.full_like(started, np.nan), warm, usual, names) is None
    cold = drift(value, sigma, owner, started, np.full_like(warm, np.nan), usual, names)
    assert math.isnan(cold.slope)
    assert cold.shares["temperature"] == 0.0
