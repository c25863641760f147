"""The suite `people`: what somebody does shows in what is true, and the score can fail."""

import io

import numpy as np
import pytest
import schemas
from prove_help import said, trial
from rich.console import Console

from handcal_sim import motion_people as do
from handcal_sim.aiding import read_heading, read_mag
from handcal_sim.companions import Heading, Magnetometer, Passing
from handcal_sim.motion import evaluate, free_hand, random_start, static
from handcal_sim.phone import HeadingErrors
from handcal_sim.prove import draw, score
from handcal_sim.prove.draw_people import DOINGS
from handcal_sim.prove.show import show

T = np.arange(0.0, 40.0, 0.002)
ACTS = [doing.act for doing in DOINGS.values() if doing.act is not None]


def motion_of(act, base=static, seed=1):
    rng = np.random.default_rng(seed)
    return do.people(base, [act] if act else [])(40.0, random_start(rng), rng)


@pytest.mark.parametrize("act", ACTS)
def test_rates_and_forces_are_derivatives_of_where_the_phone_is(act):
    motion, h = motion_of(act, free_hand), 1e-5
    t = T[::5]
    before, at, after = (evaluate(motion, t + shift) for shift in (-h, 0.0, h))
    np.testing.assert_allclose(
        (after.position - before.position) / (2.0 * h), at.velocity, atol=1e-5
    )
    np.testing.assert_allclose(
        (after.velocity - before.velocity) / (2.0 * h), at.acceleration, atol=1e-3
    )
    step = np.einsum("nji,njk->nik", before.C_nb, after.C_nb) / (2.0 * h)
    turned = np.stack([step[:, 2, 1], step[:, 0, 2], step[:, 1, 0]], axis=1)
    np.testing.assert_allclose(turned, at.omega_nb_b, atol=1e-4)


@pytest.mark.parametrize(
    ("act", "low", "high"),
    [(do.steps_aside, 0.4, 0.9), (do.lifts, 0.2, 0.5), (do.drops_slowly, 0.2, 0.6),
     (do.walks, 2.5, 12.5), (do.rides_a_lift, 3.0, 10.0), (do.changes_hands, 0.2, 0.4),
     (do.bumps, 0.0, 1e-9), (do.puts_down, 0.0, 1e-9)],
)  # fmt: skip
def test_people_end_up_where_they_went(act, low, high):
    end = np.linalg.norm(evaluate(motion_of(act), T).position[-1])
    assert low <= end <= high


def test_a_phone_that_is_put_down_lies_still_and_a_bump_is_short_and_hard():
    down = evaluate(motion_of(do.puts_down, free_hand), T)
    lowest = down.position[:, 2] < 0.98 * down.position[:, 2].min()
    assert np.sum(lowest) > 500
    assert np.median(np.abs(down.omega_nb_b[lowest])) < 1e-6
    hit = np.linalg.norm(evaluate(motion_of(do.bumps), T).acceleration, axis=1)
    assert 2.0 < hit.max() < 60.0
    assert 0.02 < np.sum(hit > 0.1) * 0.002 < 0.4
    early = np.linalg.norm(evaluate(motion_of(do.stops_early, free_hand), T).omega_nb_b, axis=1)
    assert early[T > 24.0].max() < 1e-6 < early.max()


def test_iron_misleads_while_it_passes():
    motion, rng = motion_of(None), np.random.default_rng(0)
    t, errors = np.array([0.0, 20.0]), HeadingErrors()
    field = Passing(20.0, 2.0, np.array([0.0, 2e-5, 0.0]))
    plain, passed = (read_mag(Magnetometer(passing=p), None, motion, np.zeros(3), t, rng)
                     for p in (None, field))  # fmt: skip
    np.testing.assert_allclose(np.linalg.norm(passed - plain, axis=1), [0.0, 2e-5], atol=1e-9)
    angle = Passing(20.0, 2.0, np.array([0.3]))
    one, other = (read_heading(Heading(passing=p), errors, motion, t, rng) for p in (None, angle))
    np.testing.assert_allclose((other - one)[:, 0], [0.0, 0.3], atol=1e-9)


@pytest.mark.parametrize("name", ["pauses", "passes iron", "trembles", "swivels"])
def test_what_is_drawn_has_no_errors_and_pauses_in_all_streams(name):
    world, answer = draw.draw("people", list(DOINGS).index(name), 4)
    assert answer.effects == {}
    assert answer.circumstances["doings"][0] == name
    assert set(world.parameters["effects"]) == {"gyro_bias", "accel_bias"}
    assert answer.circumstances["iron"] is (name == "passes iron")
    first, last = answer.circumstances["pause"]
    for stream in (world.imu, *world.streams.values()):
        gap = np.diff(stream.stamps)
        assert gap.max() >= last - first
        assert gap.max() <= last - first + 3.0 * np.median(gap)
    assert len(world.t) == len(world.truth.omega) == len(world.imu.values)
    if name == "pauses":
        assert 0.3 <= last - first <= 5.0


def test_the_score_allows_names_of_north_where_iron_passed_and_no_others():
    def of(document, iron, *doings):
        return trial("people", {}, document, iron=iron, doings=list(doings))

    trials = [of(said("heading_outliers"), True, "passes iron"), of(said(), False, "walks"),
              of(said(verdict="unexplained"), False, "walks"),
              of(said("heading_outliers"), False, "bumps"),
              of(said("lever_arm"), True, "passes iron", "swivels")]  # fmt: skip
    proof = score.score(trials, 1)
    schemas.check(proof)
    outcomes = [line["outcome"] for line in proof["recordings"]]
    assert outcomes == ["exact", "exact", "exact", "false", "false"]
    assert proof["suites"][0]["met"] is False
    text = io.StringIO()
    show(proof, Console(file=text, width=200))
    assert "swivels 1 of 1 (lever_arm)" in text.getvalue()
    assert score.suites(trials[:3])[0]["met"] is None
    assert score.suites(trials[:3] * 40)[0]["met"] is True
    text = io.StringIO()
    show(score.score(trials[:3], 1), Console(file=text, width=200))
    assert "100.0 % (43.8 to 100.0)" in text.getvalue()
    assert "too few to say" in text.getvalue()
