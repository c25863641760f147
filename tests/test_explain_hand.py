"""Hands that do what a held point does not: they drift, they travel, and strong physics looks as
if they did."""

from __future__ import annotations

import numpy as np
import pytest
from worlds import recording_of

from handcal import calibrate
from handcal.explain import explain
from handcal_sim import simulate

pytestmark = pytest.mark.prove


@pytest.mark.parametrize("seed", range(3))
def test_an_arm_that_tires_is_no_walking_bias(seed: int) -> None:
    """It drifts by 7 cm within tens of seconds: five of five were named a walk of the
    accelerometer's bias."""
    world = simulate("free-hand", seed=seed, duration_s=60.0, creep=0.07)
    found = explain([recording_of(world, "heading")])
    assert (found.verdict, found.missing, found.unnamed) == ("nothing_missing", (), ())


@pytest.mark.parametrize("seed", range(2))
def test_an_effect_is_found_in_an_arm_that_tires(seed: int) -> None:
    scale = np.array([0.008, -0.012, 0.01])
    world = simulate(
        "free-hand", seed=seed, duration_s=60.0, creep=0.05, effects={"gyro_scale": scale}
    )
    found = explain([recording_of(world, "heading")])
    assert [m.effect for m in found.missing] == ["gyro_scale"]
    for p, wanted in zip(found.missing[0].parameters, scale, strict=True):
        assert abs(p.value - wanted) < 4.0 * p.sigma


@pytest.mark.parametrize("seed", [0, 1])
def test_a_device_carried_about_is_judged_by_its_rests(seed: int) -> None:
    """As a held point it would sway by a quarter of a metre, and a walk, a scale or a formula was
    named for it; what was assumed is told."""
    world = simulate("travel", seed=seed)
    found = explain([recording_of(world, "heading")])
    assert [r.assume for r in found.recordings] == ["rest-only"]
    assert any("travels" in w for w in found.warnings)
    assert (found.verdict, found.missing, found.unnamed) == ("nothing_missing", (), ())


@pytest.mark.parametrize("seed", range(3))
def test_a_step_that_looks_like_a_wide_sway(seed: int) -> None:
    """A step of the gyro's bias with a heading whose noise lasts: the first noise levels were
    those of a hand that sways by 8 cm and slowly, which hid all but a tenth of the evidence, and
    the step was found three seconds from where it was."""
    step = [-0.01, 0.007, 0.011, 23.4]
    world = simulate(
        "free-hand", seed=seed, duration_s=60.0,
        effects={"gyro_bias_step": step, "heading_correlated_noise": [0.2, 2.6]},
    )  # fmt: skip
    found = explain([recording_of(world, "heading")])
    assert {m.effect for m in found.missing} == {"gyro_bias_step", "heading_correlated_noise"}
    (at,) = (p for m in found.missing for p in m.parameters if p.name == "at")
    # (two moments a second and a half apart may be as good as each other)
    assert abs(at.value - step[3]) < 2.0


@pytest.mark.parametrize("seed", range(2))
def test_a_scale_error_of_a_fifth(seed: int) -> None:
    """Three rounds of substitution left a hundredth of it, 16 of its sigmas."""
    scale = [0.2, -0.15, 0.1]
    world = simulate("free-hand", seed=seed, duration_s=40.0, effects={"gyro_scale": scale})
    found = calibrate(recording_of(world, "heading"), ["gyro_scale"], assume="fixed-point")
    for axis, wanted in zip("xyz", scale, strict=True):
        got = found.parameter("gyro_scale", axis)
        assert abs(got.value - wanted) < 4.0 * got.sigma


@pytest.mark.parametrize("seed", range(3))
def test_a_whole_error_budget_is_no_travelling_hand(seed: int) -> None:
    """Integrated, ten errors lead away from any point: half of them went unseen where the hand was
    judged before the sensors' errors were in the model."""
    rng = np.random.default_rng(seed)
    size = {"gyro_scale": (0.012, 3), "accel_scale": (0.012, 3), "gyro_misalignment": (0.012, 6),
            "accel_misalignment": (0.012, 3), "gyro_g_sensitivity": (2e-4, 9),
            "gyro_quadratic": (0.006, 3), "gyro_cross_products": (0.006, 9),
            "accel_asymmetry": (0.012, 3), "lever_arm": (0.1, 3)}  # fmt: skip
    effects = {
        k: s * rng.uniform(0.5, 1.2, n) * rng.choice([-1, 1], n) for k, (s, n) in size.items()
    }
    world = simulate("free-hand", seed=seed, duration_s=70.0, effects=effects)
    found = explain([recording_of(world, "heading")])
    assert [r.assume for r in found.recordings] == ["fixed-point"]
    named = {m.effect for m in found.missing}
    assert named <= set(effects)
    assert len(named) >= 8
