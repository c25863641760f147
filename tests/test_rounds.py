"""How a fit's evidence goes from round to round: what rests, swings and runs away."""

import math

import numpy as np
import pytest

from handcal.estimate.convergence import FALLEN, FALLS, SHORTEST, Rounds


def after(*evidence, tolerance=0.2):
    way = Rounds(tolerance)
    for value in evidence:
        way.went_on(value)
    return way


def test_it_rests_where_a_round_changes_less_than_the_tolerance():
    way = after(5.0, 9.0)
    assert way.rests(9.1)
    assert not way.rests(9.3)
    assert not Rounds(0.2).rests(0.0)


def test_of_two_between_which_it_swings_the_better_counts():
    assert after(3.0, 7.0, 3.0).swings(7.1)
    assert not after(7.0, 3.0, 7.0).swings(3.1)


def test_steps_become_shorter_where_it_turns_and_longer_where_it_does_not():
    assert after(0.0, 1.0, 2.0).step == 1.0
    turning = after(0.0, 2.0, 0.0, 2.0, 0.0)
    assert turning.step == pytest.approx(max(SHORTEST, 0.5**3))
    turning.went_on(-1.0)
    assert turning.step > SHORTEST


@pytest.mark.parametrize("per_round", [0.9, 1.1])
def test_it_runs_away_where_every_round_is_worse_and_all_is_lost(per_round):
    away = [-per_round * FALLEN / FALLS * n for n in range(FALLS + 1)]
    assert after(*away).runs_away is (per_round > 1.0)
    assert not after(*away, 10.0).runs_away
    assert not after(*away[:-1]).runs_away


@pytest.mark.parametrize(
    ("evidence", "sinks"),
    [
        ((5.0, -50.0, -120.0), True),
        ((5.0, -120.0), False),  # (one worse round is none)
        ((5.0, -50.0, -99.0), False),
        ((-300.0, -200.0, -120.0), False),  # (below, and on its way up)
        ((5.0, -50.0, -120.0, -110.0), False),
        ((5.0, -101.0 - FALLEN), True),  # (one that is lost)
        ((-1e4, -101.0 - FALLEN), False),  # (far down, and on its way up)
        ((-101.0 - FALLEN,), False),  # (where it begins)
    ],
)
def test_it_sinks_where_it_only_becomes_less_below_what_is_of_use(evidence, sinks):
    assert after(*evidence).sinks(-100.0) is sinks
    assert not after(*evidence).sinks(-math.inf)


def rounds_to_reach(share, mix):
    """Rounds after which two constants are where they belong to 1e-3, each round bringing all but a
    ``share`` of what the first lacks."""
    way, x, information = Rounds(0.2), np.array([1.0, 1.0]), np.array([[2.0, mix], [mix, 1.0]])
    for n in range(40):
        if np.abs(x).max() < 1e-3:
            return n
        way.went_on(0.0)
        aim = -np.array([1.0 - share, 1.0]) * x
        way.aims(aim, information)
        x = x + way.reach * aim
    return 40


@pytest.mark.parametrize("mix", [0.0, 0.5])
@pytest.mark.parametrize("share", [0.75, -1.8, -0.9])
def test_steps_along_one_another_are_taken_at_once(share, mix):
    """Undone by hand: shares of 0.75 take 24 rounds, of -0.9 66, and those beyond one never end."""
    assert rounds_to_reach(share, mix) <= 12


def test_steps_across_one_another_are_taken_as_they_are():
    way, information = Rounds(0.2), np.eye(2)
    for aim in ([1.0, 0.0], [0.0, 1.0], [0.7, 0.7]):
        way.aims(np.array(aim), information)
        assert way.reach == way.step
    way.aims(np.zeros(3), np.eye(3))
    assert way.reach == way.step


def test_a_swing_is_over_the_last_rounds_only():
    assert after(-1e6, *range(5)).swing == 4.0
    assert math.isinf(after(1.0, -math.inf).swing)
