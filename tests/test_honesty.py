"""What a motion cannot show stays unknown, in the estimates and in their sigmas.

Each of these once failed: noise posed as motion that excites a parameter.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from proved import proved

import handcal
from handcal.types import Recording, Result
from handcal_sim import simulate, write
from handcal_sim.motion import Start
from handcal_sim.phone import Phone, consumer_magnetometer, consumer_phone

SEEDS = (0, *proved(1, 2, 3))


def _with_magnetometer(rng: np.random.Generator) -> Phone:
    return replace(consumer_phone(rng), heading=None, mag=consumer_magnetometer(rng))


def _recorded(world: object, folder: Path) -> Recording:
    path = folder / "recording.mcap"
    write(world, path)  # type: ignore[arg-type]
    return handcal.load(path)


@pytest.fixture(scope="module", params=SEEDS)
def on_a_table(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Result:
    """A device that never moves, with a magnetometer, scale errors asked for."""
    folder = tmp_path_factory.mktemp("table")
    world = simulate("static", seed=request.param, phone=_with_magnetometer)
    recording = _recorded(world, folder)
    return handcal.calibrate(
        recording,
        ("gyro_scale",),
        observations=("zero_velocity", "zero_rate", "magnetometer"),
    )


def test_a_table_teaches_no_gyro_scale(on_a_table: Result) -> None:
    for axis in "xyz":
        p = on_a_table.parameter("gyro_scale", axis)
        assert not p.shown
        assert p.sigma > 0.9 * p.prior_sigma
        # an estimate of what is not seen stays where it began
        assert abs(p.value) < 0.5 * p.prior_sigma


def test_a_table_does_not_tell_tilt_from_accelerometer_bias(on_a_table: Result) -> None:
    horizontal = [on_a_table.parameter("accel_bias", axis) for axis in "xy"]
    for p in horizontal:
        assert p.sigma > 0.7 * p.prior_sigma
        assert abs(p.value) < p.prior_sigma
    assert on_a_table.parameter("accel_bias", "z").shown


@pytest.mark.prove
@pytest.mark.parametrize("seed", SEEDS)
def test_a_turn_about_the_vertical_hides_the_vertical_gyro_bias(seed: int, tmp_path: Path) -> None:
    """Without a heading; the hand holds still, or its wobble would show a little."""
    recording = _recorded(simulate("z-turn", seed=seed, start=Start(), sway=0.0), tmp_path)
    result = handcal.calibrate(recording, assume="fixed-point", ignore=("heading",))
    p = result.parameter("gyro_bias", "z")
    assert not p.shown
    assert p.sigma > 0.7 * p.prior_sigma
    seen = handcal.calibrate(recording, assume="fixed-point").parameter("gyro_bias", "z")
    assert seen.shown
    assert any("Gravity stays along body z" in w for w in result.warnings)
