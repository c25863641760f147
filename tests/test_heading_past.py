"""A compass that comes late, as an effect that depends on the past (`Effect.seen`): concealed in a
heading, it is estimated, taken off again, and without it the fit is worse."""

import numpy as np
import pytest
from worlds import recording_of

from handcal.compiled.so3 import wrap
from handcal.device.apply import Learnt, apply
from handcal.device.conceal import conceal
from handcal.effects import with_effects
from handcal.estimate.calibration import calibrate
from handcal.laws import grammar
from handcal.laws.drivers import HEADING, YAW, operated
from handcal.laws.law_effect import Law, effect_of
from handcal_sim import simulate

SHARE, TAU_S = 0.15, 1.2
LAW = Law(
    HEADING, (0,), False, operated("lag", YAW, TAU_S), grammar.formula([("line", ())]), (1.0,)
)


@pytest.fixture(scope="module")
def late():
    from dataclasses import replace

    effect = replace(effect_of(LAW), id="late_needle")
    with with_effects([("a test", effect)]):
        yield effect.id


@pytest.fixture(scope="module")
def plain():
    return recording_of(simulate("free-hand", seed=0, duration_s=40.0), "heading")


@pytest.fixture(scope="module")
def concealed(plain, late):
    return conceal(plain, {late: [SHARE]}, np.random.default_rng(0))


def headings(recording):
    return recording.streams["heading"].value[:, 0]


def test_a_needle_lags_behind_the_heading(plain, concealed):
    """A first-order lag of the yaw that the heading itself shows, to within its noise."""
    t, read = plain.streams["heading"].t, np.unwrap(headings(plain))
    follows = np.empty_like(read)
    follows[0] = read[0]
    for i in range(1, len(t)):
        share = 1.0 - np.exp(-(t[i] - t[i - 1]) / TAU_S)
        follows[i] = follows[i - 1] + share * (read[i] - follows[i - 1])
    error = wrap(headings(concealed) - headings(plain))
    noise = np.std(np.diff(read)) / np.sqrt(2.0)
    left = error - SHARE * (follows - read)
    assert np.std(left) < 1.5 * SHARE * noise
    assert np.std(error) > 3.0 * np.std(left)


@pytest.mark.prove
def test_it_is_estimated(concealed, plain, late):
    for recording, share in ((concealed, SHARE), (plain, 0.0)):
        found = calibrate(recording, (late,), only=True).parameter(late, "k")
        assert abs(found.value - share) < 4.0 * found.sigma < 0.2 * SHARE


def test_it_is_taken_off(plain, concealed, late):
    learnt = Learnt("a test", {late: np.array([SHARE])}, (), ())
    found = apply(concealed, learnt)
    assert late in found.taken
    left = wrap(headings(found.recording) - headings(plain))
    error = wrap(headings(concealed) - headings(plain))
    # (of the attitude both times as much is known as the heading tells, once with its error)
    assert np.std(left) < 0.1 * np.std(error)
