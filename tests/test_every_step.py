"""Steps of the climb, each in a recording of which ``explain`` says something else without it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from strange_device import phone_of
from worlds import recording_of

from handcal import load
from handcal.explain import explain
from handcal_sim import simulate, strangers
from handcal_sim.mcap_writer import write
from handcal_sim.phone import Phone, capture_pose, consumer_phone
from handcal_sim.prove.draw import draw

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


@pytest.mark.parametrize("seed", range(3))
def test_name_term_a_law_beside_a_name_that_does_more(seed: int) -> None:
    """No climb begins with a law that is so much less than half of it; else noise holds it, or
    another name. (And without `thin` the noise that held it before stays beside it.)"""
    scale = {"gyro_scale": [0.03, -0.02, 0.02]}
    world = simulate(
        "free-hand", seed=seed, duration_s=60.0, phone=lambda _: phone_of(seed), effects=scale
    )
    [(bent, law)] = strangers.of_one_device("accel_quadratic", [world], seed)
    found = explain([recording_of(bent, "heading")])
    assert [m.effect for m in found.missing] == ["gyro_scale"]
    (told,) = found.unnamed
    axis = law.channel[-1]
    assert told.formula == f"accel_{axis} += k * f_{axis}^2"


@pytest.mark.parametrize(
    ("number", "channel", "driver"),
    [(9, "gyro_y", "omega_y"), (29, "gyro_x", "omega_x"), (5, "gyro_x", "alpha_x")],
)
def test_name_term_a_law_in_the_place_of_noise_and_of_names(
    number: int, channel: str, driver: str, tmp_path: Path
) -> None:
    """A diode that begins to conduct was a quadratic error, products, a scale error and a walk; a
    gain that drifts, beside nothing but noise, was an error that goes with the motion; and a lag
    that goes with the temperature had no driver."""
    world, answer = draw("strange", number, 206)
    write(world, tmp_path / "strange.mcap", truth=False)
    found = explain([load(tmp_path / "strange.mcap")])
    assert [m.effect for m in found.missing] == [*answer.effects]
    (told,) = found.unnamed
    assert told.channels == (channel,)
    assert driver in told.formula


@pytest.mark.parametrize(
    ("number", "channels", "formula"),
    [
        (11, {"gyro_x", "gyro_y", "gyro_z"}, "tanh(omega_i * omega_j / "),
        (3, {"heading"}, "(sum of exp(-((t - t_n) / "),
        (24, {"heading"}, " mod "),
    ],
)
def test_name_term_a_law_in_the_place_of_a_weak_name_or_of_noise_alone(
    number: int, channels: set[str], formula: str, tmp_path: Path
) -> None:
    """A product that saturates was cross products of 82 nats, of which evidence was worth a tenth
    without them; bumps that come again were correlated noise; what is switched on and off was a
    swing of a heading."""
    world, answer = draw("strange", number, 207)
    write(world, tmp_path / "strange.mcap", truth=False)
    found = explain([load(tmp_path / "strange.mcap")])
    assert {m.effect for m in found.missing} <= {*answer.effects}
    (told,) = found.unnamed
    assert set(told.channels) == channels
    assert formula in told.formula


@pytest.mark.parametrize("number", range(3))
def test_everything_a_device_with_a_whole_budget(number: int, tmp_path: Path) -> None:
    """Found one by one, what came first held the gyro's scale in one of three."""
    world, answer = draw("budget", number, 0)
    assert "gyro_scale" in answer.effects
    write(world, tmp_path / "budget.mcap", truth=False)
    found = explain([load(tmp_path / "budget.mcap")])
    assert "gyro_scale" in [m.effect for m in found.missing]
