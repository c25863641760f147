"""What matters: sizes in the sensors' units, shares, and what unseen data say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from worlds import recording_of, slow

from handcal.explain import explain
from handcal.explanation import Explanation
from handcal.types import Array, Series
from handcal_sim import simulate
from handcal_sim.scenario import World

SCALE = [0.012, -0.012, 0.012]
ARM = [0.08, -0.06, 0.07]
DELAY = [0.12]


def _world(seed: int) -> World:
    effects = {"gyro_scale": SCALE, "lever_arm": ARM, "heading_delay": DELAY}
    return simulate("free-hand", seed=seed, duration_s=30.0, phone=slow, effects=effects)


@pytest.fixture(scope="module")
def world() -> World:
    return _world(0)


@pytest.fixture(scope="module")
def known(world) -> tuple[World, Explanation]:
    return world, explain([recording_of(world, "heading")])


def _rms(x: Array) -> Array:
    return np.sqrt((x**2).mean(axis=0))


@pytest.mark.prove
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


@pytest.mark.prove
def test_shares_order_what_is_missing_and_none_is_more_than_all(known) -> None:
    _, e = known
    shares = [m.share for m in e.missing]
    assert len(shares) == 3
    assert shares == sorted(shares, reverse=True)
    assert all(0.0 < s <= 1.0 for s in shares)


@pytest.mark.prove
def test_unseen_data_agree_with_what_is_there(known) -> None:
    _, e = known
    told = [m.held_out_gain for m in e.missing if m.held_out_gain is not None]
    assert told
    assert all(0.0 < g < m.log_evidence_gain for g, m in zip(told, e.missing, strict=False))


@pytest.mark.prove
def test_the_hand_is_said_and_how_surely(known) -> None:
    _, e = known
    assert e.hand.id == "held"
    assert 0.9 < e.hand.probability < 1.0


def test_what_has_no_name_is_drawn_over_what_drives_it(world) -> None:
    """k omega_y^3: a curve of the cube, in the units of what is measured, with its band."""
    from handcal.estimate.baseline import baseline
    from handcal.estimate.case import case_of
    from handcal.laws import grammar, law_effect, terms, vocabulary
    from handcal.laws.curve import channel_of, drawn, drivers_of

    def effect_of(sensor: int, axis: int, driver: str, form: str):
        shape = grammar.formula([(form, ())])
        law = law_effect.Law(sensor, (axis,), False, vocabulary.driver_of(driver), shape, (0.01,))
        return law_effect.effect_of(law)

    f = baseline([case_of(recording_of(world, "heading"))]).parts[0]
    third = terms.again("heading += k1 * sin(3 yaw) + k2 * cos(3 yaw)", 0.1)
    cases = (
        (effect_of(0, 0, "omega_{j}", "cube"), ("omega_y",), "rad/s", "rad/s", lambda x: x**3),
        (effect_of(1, 2, "omega_{j} * f_{k}", "line"), ("omega_x", "f_y"),
         "rad*m/s^3", "m/s^2", lambda x: x),
        (third, ("yaw",), "rad", "rad", lambda x: np.sin(3.0 * x)),
    )  # fmt: skip
    for effect, names, x_unit, y_unit, law in cases:
        k = np.r_[0.02, np.zeros(len(effect.parameters) - 1)]
        C = 0.004**2 * np.outer(k > 0.0, k > 0.0)
        shown = drawn(f, effect, k, C).curve
        assert drivers_of(effect.id) == names
        assert channel_of(effect.id) == effect.id.split()[0]
        # (means over a range of x are not what the mean of x gives, but nearly)
        assert np.abs(shown.y - 0.02 * law(shown.x)).max() < 0.1 * np.abs(shown.y).max()
        # (nor is the mean of a size that of what has two signs)
        assert (shown.sigma >= 0.2 * np.abs(shown.y) * (1.0 - 1e-9)).all()
        assert shown.sigma.max() == pytest.approx(0.2 * np.abs(shown.y).max(), rel=0.02)
        assert (np.diff(shown.x) >= 0.0).all()
        assert (shown.x_unit, shown.y_unit) == (x_unit, y_unit)


def test_every_term_of_the_heading_can_be_drawn(world) -> None:
    """Whatever drives it; a heading that errs with the temperature broke off where it was found."""
    from handcal.estimate.baseline import baseline
    from handcal.estimate.case import case_of
    from handcal.laws import terms
    from handcal.laws.curve import drawn

    recording = recording_of(world, "heading")
    t = recording.imu.t[::100]
    warm = Series(t, np.linspace(20.0, 40.0, len(t))[:, None])
    recording = replace(recording, streams={**recording.streams, "temperature": warm})
    f = baseline([case_of(recording)]).parts[0]
    effects = terms.heading_terms(recording) + [some[0] for some in terms.heading_curves()]
    assert {"heading += k * (T - 25)", "heading += g(tilt)"} <= {e.id for e in effects}
    for effect in effects:
        k = np.full(len(effect.parameters), 0.02)
        shown = drawn(f, effect, k, 1e-6 * np.eye(len(k)))
        assert np.isfinite(shown.curve.y).all()
        assert shown.size > 0.0


def test_iron_that_every_model_has_is_a_share_of_all_and_the_rest_of_what_lies_beyond() -> None:
    """38,000 nats of iron would leave nothing to a scale error of a thousand."""
    from types import SimpleNamespace

    from handcal.explain.importance import whole_gain

    gains = {"iron": 1000.0, "scale": 40.0, "arm": 60.0}
    where = SimpleNamespace(
        score=lambda ids: sum(gains[i] for i in ids), prior=dict.fromkeys(gains, 0.0)
    )
    effects = [SimpleNamespace(id=i, always=i == "iron") for i in gains]
    model = SimpleNamespace(effects=effects, chosen=frozenset(gains))
    found = SimpleNamespace(space=where, model=model, noise={"walk": 7.0})
    assert whole_gain(found) == 100.0
    assert whole_gain(found, from_nothing=True) == 1100.0
