"""An error of the heading over how fast it turns, or over how the device is tilted: told as the
formula that it is, not as a curve."""

from dataclasses import replace

import numpy as np
import pytest
from worlds import recording_of

from handcal.device.conceal import conceal
from handcal.effects import with_effects
from handcal.estimate.baseline import baseline
from handcal.estimate.case import case_of
from handcal.explain import explain
from handcal.laws import grammar, law_effect
from handcal.laws.curve import drawn
from handcal.laws.drivers import HEADING
from handcal.laws.law_effect import Law, effect_of
from handcal.laws.terms import CURVES
from handcal.laws.vocabulary import CURVED, driver_of
from handcal_sim import simulate

SIZE = 0.15


def law(driver, *parts):
    form = grammar.formula(parts)
    return Law(HEADING, (0,), False, CURVED[driver], form, (1.0,) * form.constants)


# (of how blunt edges are, those few readings tell that are taken on them)
@pytest.mark.prove
@pytest.mark.parametrize(
    ("driver", "part", "off"),
    [
        ("yaw rate", ("limit", (0.6,)), 0.1),
        ("tilt", ("cube", ()), 0.1),
        ("yaw", ("halves", (1.2, 0.15)), 0.4),
    ],
)
def test_a_law_of_the_heading_is_told_as_its_formula(driver, part, off):
    world = simulate("free-hand", seed=0, duration_s=25.0, effects={})
    one = replace(effect_of(law(driver, part)), id="odd_compass")
    with with_effects([("a test", one)]):
        recording = conceal(
            recording_of(world, "heading"), {one.id: [SIZE]}, np.random.default_rng(0)
        )
    said = explain([recording])
    assert said.verdict == "unexplained"
    (found,) = said.unnamed
    assert found.drivers == (driver,)
    (made,) = [law_effect.again(*found.made)]
    assert [name for name, _ in made.form.parts] == [part[0]]
    assert made.form.numbers == pytest.approx(part[1], rel=off)
    assert made.form.numbers[:1] == pytest.approx(part[1][:1], rel=0.1)
    assert found.value == pytest.approx(SIZE, abs=max(4.0 * found.sigma, 0.02 * SIZE))


def test_what_has_a_name_is_no_law():
    assert law_effect.named(law("yaw rate", ("line", ())))  # (a heading that comes late)
    for driver in CURVED:
        assert not law_effect.named(law(driver, ("cube", ())))
    assert not law_effect.named(law("yaw rate", ("line", ()), ("cube", ())))
    assert set(CURVED) == set(CURVES)
    for iron in ("sin 1", "cos 1", "sin 2", "cos 2"):  # (the room's iron and the device's)
        assert law_effect.named(law("yaw", (iron, ())))
    assert not law_effect.named(law("yaw", ("sin 3", ())))
    # (what does not change on the motion on which names are tried has none)
    side = replace(law("tilt", ("line", ())), driver=driver_of("(side(8.49 K) of (T - 25))"))
    assert not law_effect.named(side)


def test_an_angle_is_drawn_as_an_angle_and_a_share_has_no_unit():
    """(The formula is of its sine, from -1 to 1.)"""
    world = simulate("free-hand", seed=0, duration_s=15.0, effects={})
    f = baseline([case_of(recording_of(world, "heading"))]).parts[0]
    for driver, unit in (("pitch of x", "rad"), ("tilt", "rad"), ("yaw rate", "(rad)/(rad/s)^3")):
        effect = effect_of(law(driver, ("cube", ())))
        assert effect.parameters[0].unit == unit
        x = drawn(f, effect, np.ones(1), np.eye(1)).curve
        assert x.x_unit == ("rad/s" if driver == "yaw rate" else "rad")
        assert np.ptp(x.x) > 1.2  # (a sine's course would be two at the most, from -1 to 1)
