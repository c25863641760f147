"""A hand that moves: its process, and moves to another place."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm
from worlds import recording_of

from handcal.effects import select
from handcal.estimate.baseline import baseline, dense
from handcal.estimate.case import Case, case_of, creeping
from handcal.estimate.fit import diverged, fitted
from handcal.estimate.hand_sway import sway_of
from handcal.estimate.model import Model
from handcal.estimate.specification import Options, Specification, document_of, seen, view_of
from handcal.explain import explain, model_file
from handcal.observations.fixed_position import CREEP, SWAY, Part, Sway
from handcal.search import drifting_point
from handcal.search.drifting_point import Move
from handcal.show import words
from handcal_sim import simulate
from handcal_sim.motion import free_hand
from handcal_sim.motion_people import changes_hands, people, rides_a_lift

LEVELS = {"sway": 0.004, "sway_per_rate": 0.003, "sway_time": 0.7, "creep": 0.2, "creep_time": 3.0}


def _move(first: float, last: float, far: float) -> Move:
    return Move(first, last, far, np.full((1, 3), far))


@pytest.mark.parametrize("part", [SWAY, CREEP])
@pytest.mark.parametrize("x", [0.005, 0.05, 0.29, 0.31, 1.5])
def test_a_parts_noise_is_that_of_its_dynamics(part: Part, x: float) -> None:
    """Van Loan (IEEE Transactions on Automatic Control 23, 1978): both from one exponential."""
    k, b = part.order, 1.0 / LEVELS[part.time]
    Phi, Q = Sway(part).transition(LEVELS, np.array([x / b]), np.zeros(1))
    drift = np.eye(k, k=1)
    drift[-1] = [-math.comb(k, i) * b ** (k - i) for i in range(k)]
    # a white force of which the displacement comes out as large as it should
    P = Sway(part).start(LEVELS, 0.0)[::3, ::3]
    white = np.zeros((k, k))
    white[-1, -1] = -2.0 * (drift @ P)[-1, -1]
    both = expm(np.block([[-drift, white], [np.zeros((k, k)), drift.T]]) * x / b)
    wanted = both[k:, k:].T @ both[:k, k:]
    scale = np.sqrt(np.outer(np.diag(wanted), np.diag(wanted)))
    assert np.abs((Q[0, ::3, ::3] - wanted) / scale).max() < 1e-5
    assert np.abs(Phi[0, ::3, ::3] - expm(drift * x / b)).max() < 1e-9 * max(1.0, b**k)


def test_what_is_stationary_stays_so() -> None:
    hand = Sway(SWAY, CREEP)
    P = hand.start(LEVELS, 0.4)
    Phi, Q = hand.transition(LEVELS, np.array([0.02, 0.9, 20.0]), np.full(3, 0.4))
    scale = np.sqrt(np.outer(np.diag(P), np.diag(P)))
    for k in range(3):
        assert np.abs((Phi[k] @ P @ Phi[k].T + Q[k] - P) / scale).max() < 1e-6
        assert np.linalg.eigvalsh(Q[k] / scale).min() > -1e-15


def _along(*speeds: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Times and velocities of somebody who goes so fast from then to then, else hardly."""
    t = np.arange(0.0, 60.0, 0.1)
    v = np.zeros((len(t), 3))
    v[:, 0] = 0.01 * np.sin(40.0 * t)
    for first, last, speed in speeds:
        v[(t > first) & (t < last), 1] = speed
    return t, v


def test_fast_is_what_stands_out_and_is_short() -> None:
    # (the same move goes on after a moment; what lasts for twenty seconds is a walk)
    t, v = _along((10.0, 10.75, 0.3), (11.0, 11.5, 0.15), (30.0, 50.0, 0.5))
    ((first, last),) = drifting_point._fast(t, v)
    assert 9.0 <= first < 10.0
    assert 11.5 < last <= 12.5
    assert drifting_point._fast(*_along()) == []


def test_where_half_of_a_recording_drifts_a_move_stands_out() -> None:
    t, v = _along((20.0, 28.0, 0.8))
    v[t > 28.0, 1] = 0.3 * (60.0 - t[t > 28.0]) / 32.0
    v[(t > 14.0) & (t < 19.5), 2] = 0.12
    ((first, last),) = drifting_point._fast(t, v)
    assert 19.0 < first < 20.1
    assert 27.9 < last < 29.1


def test_a_hand_that_sways_does_not_move_on() -> None:
    """However still it is elsewhere, what takes it less far in a stroke than it sways is sway."""
    assert drifting_point._fast(*_along((10.0, 12.0, 0.09))) == []


def test_what_a_look_would_not_tell_of_the_way_costs_nothing() -> None:
    """A lift goes far at one speed: who knows where it was knows where it is; a stroke that leads
    elsewhere is paid for, the more the more a look would have told of it."""
    world = simulate("free-hand", seed=0, duration_s=30.0)
    case = case_of(recording_of(world, "heading"), "fixed-point")

    def constant(strokes: float, worth: float) -> float:
        move = Move(9.95, 15.05, 5.0, np.full((10, 3), strokes))
        return drifting_point._moved(case, [move], worth).constant

    assert constant(0.0, 12.0) > constant(0.05, 12.0) > constant(0.5, 12.0)
    # (of ten times as much, three times ten numbers of log 10 each)
    far, further = constant(5.0, 15.0), constant(50.0, 15.0)
    assert far - further == pytest.approx(30.0 * math.log(10.0), rel=1e-2)


@pytest.mark.prove
@pytest.mark.parametrize("seed", range(3))
def test_who_rides_a_lift_has_no_error_in_his_accelerometer(seed: int) -> None:
    """Of 100 recordings of people ten were in a lift, eight of them with a law of the accelerometer
    that nobody wrote down."""
    world = simulate(people(free_hand, [rides_a_lift]), seed=seed, duration_s=30.0)
    found = explain([recording_of(world, "heading")])
    assert (found.verdict, list(found.missing)) == ("nothing_missing", [])
    assert found.hand.id in ("held", "creeping")
    assert any("moves to another place" in w for w in found.warnings)


@pytest.mark.prove
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_another_hand_is_another_place(seed: int) -> None:
    """A third of a metre within a second: as a held point it swayed by centimetres all along."""
    world = simulate(people(free_hand, [changes_hands]), seed=seed, duration_s=50.0)
    base = baseline([case_of(recording_of(world, "heading"), "fixed-point")])
    (moved,) = drifting_point._hands(base)[1]
    other = baseline([moved])
    assert other.log_evidence > base.log_evidence
    held, new = (sway_of(m.parts[0].linear.problem, m.parts[0].levels) for m in (base, other))
    assert new < held
    (said,) = (w for w in moved.warnings if "moves to another place" in w)
    assert said in other.parts[0].case.warnings


@pytest.mark.prove
def test_another_place_is_found_whatever_the_noise_that_its_fit_begins_with() -> None:
    """At the usual noise the fit of the other place has a thousand nats less than at its own."""
    world = simulate(people(free_hand, [changes_hands]), seed=0, duration_s=50.0)
    base = dense(baseline([case_of(recording_of(world, "heading"), "fixed-point")]))
    weak = fitted(base.parts, [*base.effects, *select(["accel_cross_products"])])
    found = drifting_point.moving(base, weak, {"accel_cross_products": 1.0})
    assert found is not None
    other, nats = found
    assert nats > 0.0
    assert any("moves to another place" in w for w in other.parts[0].case.warnings)


def test_a_move_is_written_and_read_to_the_last_bit() -> None:
    world = simulate(people(free_hand, [changes_hands]), seed=0, duration_s=30.0)
    recording = recording_of(world, "heading")
    case = case_of(recording, "fixed-point")
    case = drifting_point._moved(case, [_move(9.9, 11.1, 0.31), _move(20.0, 20.7, 0.05)], 12.0)
    chosen = Specification((), (view_of(case),), Options())
    (view,) = model_file.chosen_from(document_of(chosen)).views
    again = seen(recording, view, Options())
    assert again.constant == case.constant
    assert view == view_of(again)
    for (_, a, _), (_, b, _) in zip(again.observed, case.observed, strict=True):
        assert np.array_equal(a.t, b.t)
        assert np.array_equal(a.z, b.z)
        assert (a.moved is None) == (b.moved is None)
        assert a.moved is None or b.moved is None or np.array_equal(a.moved, b.moved)


def test_where_it_moves_the_point_is_not_looked_at() -> None:
    world = simulate("free-hand", seed=0, duration_s=30.0)
    case = case_of(recording_of(world, "heading"), "fixed-point")
    k = case.kinds.index(drifting_point.OBSERVED)
    before = case.observed[k][1]
    moved = drifting_point._moved(case, [_move(9.95, 11.05, 0.3), _move(20.05, 20.95, 0.1)])
    after = moved.observed[k][1]
    looked = ~((before.t >= 9.95) & (before.t <= 11.05) | (before.t >= 20.05) & (before.t <= 20.95))
    assert np.array_equal(after.t, before.t[looked])
    assert after.moved is not None
    (first, second) = np.flatnonzero(after.moved)
    assert after.moved[[first, second]].tolist() == [0.3, 0.1]
    assert after.t[first - 1] < 9.95 < 11.05 < after.t[first]
    assert replace(after, moved=None).delay == before.delay


def test_of_a_fit_that_diverged_nobody_knows_how_fast_the_hand_was() -> None:
    """One that did said that a look at the point is worth -7,000 nats, and explain broke off (wild
    trial): e to the power of a third of that is no number."""
    world = simulate(people(free_hand, [changes_hands]), seed=0, duration_s=30.0)
    base = baseline([case_of(recording_of(world, "heading"), "fixed-point")])
    assert len(drifting_point._hands(base)) == 3
    ((creeps,),) = drifting_point._hands(diverged(base.parts, ()))
    assert creeps.creeping
    k = creeps.kinds.index(drifting_point.OBSERVED)
    few, many = (
        drifting_point._moved(base.parts[0].case, [_move(9.9, 11.1, 0.31)], w).constant
        for w in (-7e3, -8e3)
    )
    looks = len(base.parts[0].case.observed[k][1].t)
    assert 0.0 < few - many < 1e3 * looks


def test_the_page_says_what_the_held_point_does() -> None:
    case = case_of(recording_of(simulate("free-hand", seed=0, duration_s=30.0), "heading"))
    moved = drifting_point._moved(case, [_move(9.95, 11.05, 0.3)])
    said = {
        words.assume_sentence("fixed-point", drifts=c.creeping, moves=c.moves)
        for c in (case, creeping(case), moved, creeping(moved))
    }
    assert len(said) == 4
    assert sum("apart from the moves" in s for s in said) == 2
    assert sum("drifts" in s for s in said) == 2


def test_where_no_trajectory_holds_the_point_the_hand_drifts(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A lift and an app that paused: what was left of the baseline was no fit, and four in a
    hundred headings were said to be wrong, at infinitely many nats."""
    world = simulate("free-hand", seed=0, duration_s=20.0)
    case = case_of(recording_of(world, "heading"), "fixed-point")

    def astray(cases: list[Case]) -> Model:
        return baseline(cases) if cases[0].creeping else diverged((), ())

    monkeypatch.setattr(drifting_point, "baseline", astray)
    found = drifting_point.begun([case])
    assert math.isfinite(found.log_evidence)
    assert found.parts[0].case.creeping
