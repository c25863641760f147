"""What matters: sizes in the sensors' units, shares, and what unseen data say."""

from __future__ import annotations

import numpy as np
import pytest
from test_explain import slow
from worlds import recording_of

from handcal.explain import explain
from handcal.explain.explanation import Explanation
from handcal.types import Array
from handcal_sim import simulate
from handcal_sim.scenario import World

SCALE = [0.012, -0.012, 0.012]
ARM = [0.08, -0.06, 0.07]
DELAY = [0.12]


def _world(seed: int) -> World:
    effects = {"gyro_scale": SCALE, "lever_arm": ARM, "heading_delay": DELAY}
    return simulate("free-hand", seed=seed, duration_s=30.0, phone=slow, effects=effects)


@pytest.fixture(scope="module")
def known() -> tuple[World, Explanation]:
    world = _world(0)
    return world, explain([recording_of(world, "heading")])


def _rms(x: Array) -> Array:
    return np.sqrt((x**2).mean(axis=0))


def test_a_size_is_what_the_effect_adds_to_the_readings(known) -> None:
    world, e = known
    size = {m.effect: m.size for m in e.missing}
    rate = _rms(recording_of(world, "heading").imu.gyro)
    for k, axis in enumerate("xyz"):
        assert size["gyro_scale"][f"gyro_{axis}"] == pytest.approx(0.012 * rate[k], rel=0.25)
    # a heading of 0.12 s ago is wrong by the rate about the vertical: less than all of it
    assert 0.0 < size["heading_delay"]["heading"] < 0.12 * float(np.linalg.norm(rate)) * 1.2
    # the swing of the accelerometer: of the order of rate squared times arm
    assert {c[:-2] for c in size["lever_arm"]} == {"accel"}
    assert set(size["gyro_scale"]) == {"gyro_x", "gyro_y", "gyro_z"}


def test_shares_order_what_is_missing_and_none_is_more_than_all(known) -> None:
    _, e = known
    shares = [m.share for m in e.missing]
    assert len(shares) == 3
    assert shares == sorted(shares, reverse=True)
    assert all(0.0 < s <= 1.0 for s in shares)


def test_unseen_data_agree_with_what_is_there(known) -> None:
    _, e = known
    told = [m.held_out_gain for m in e.missing if m.held_out_gain is not None]
    assert told
    assert all(0.0 < g < m.log_evidence_gain for g, m in zip(told, e.missing, strict=False))


def test_the_hand_is_said_and_how_surely(known) -> None:
    _, e = known
    assert e.hand.id == "held"
    assert 0.9 < e.hand.probability < 1.0


def test_a_term_without_a_name_is_drawn_over_what_drives_it(known) -> None:
    """k omega_y^3: a curve of the cube, in the units of what is measured."""
    from handcal.estimate.case import case_of
    from handcal.estimate.fit import baseline
    from handcal.explain.curve import channel_of, curve_of, drivers_of
    from handcal.explain.terms import again

    world, _ = known
    f = baseline([case_of(recording_of(world, "heading"))]).parts[0]
    for formula, drivers in (
        ("gyro_x += k * omega_y^3", ("omega_y",)),
        ("accel_z += k * omega_x * f_y", ("omega_x", "f_y")),
        ("heading += k * sin(3 yaw)", ("yaw",)),
    ):
        effect = again(formula, 0.01)
        drawn = curve_of(f, effect, 0.02, 0.004)
        assert drivers_of(formula) == drivers
        assert channel_of(formula) == formula.split()[0]
        expected = {"gyro_x": drawn.x**3, "accel_z": drawn.x, "heading": np.sin(3.0 * drawn.x)}
        # (means over a range of x are not what the mean of x gives, but nearly)
        y = 0.02 * expected[formula.split()[0]]
        assert np.abs(drawn.y - y).max() < 0.1 * np.abs(drawn.y).max()
        np.testing.assert_allclose(drawn.sigma, 0.2 * np.abs(drawn.y))
        assert (np.diff(drawn.x) >= 0.0).all()
        units = {"gyro_x": ("rad/s", "rad/s"), "heading": ("rad", "rad")}
        assert (drawn.x_unit, drawn.y_unit) == units.get(
            channel_of(formula), ("rad*m/s^3", "m/s^2")
        )


def test_iron_that_every_model_has_is_a_share_of_all_and_the_rest_of_what_lies_beyond() -> None:
    """38,000 nats of iron would leave nothing to a scale error of a thousand."""
    from types import SimpleNamespace

    from handcal.explain.matter import whole_gain

    gains = {"iron": 1000.0, "scale": 40.0, "arm": 60.0}
    where = SimpleNamespace(
        score=lambda ids: sum(gains[i] for i in ids), prior=dict.fromkeys(gains, 0.0)
    )
    effects = [SimpleNamespace(id=i, always=i == "iron") for i in gains]
    model = SimpleNamespace(effects=effects, chosen=frozenset(gains))
    found = SimpleNamespace(space=where, model=model, noise={"walk": 7.0})
    assert whole_gain(found) == 100.0
    assert whole_gain(found, from_nothing=True) == 1100.0
