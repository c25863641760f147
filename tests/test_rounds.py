"""How a fit's evidence goes from round to round: what rests, swings and runs away."""

import math

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


def test_a_swing_is_over_the_last_rounds_only():
    assert after(-1e6, *range(5)).swing == 4.0
    assert math.isinf(after(1.0, -math.inf).swing)
