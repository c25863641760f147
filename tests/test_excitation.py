"""What excites a constant: not the motion that follows a rest, nor a hand's sway; and lags that are
the same to the first order come out of a fit from wherever it begins."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from proved import proved
from scipy.interpolate import CubicSpline
from scipy.ndimage import uniform_filter1d
from worlds import injected, problem_of, recording_of

from handcal.effects import Param, Signals, select
from handcal.estimate.baseline import baseline
from handcal.estimate.case import case_of, creeping
from handcal.estimate.corrected import corrected_readings
from handcal.estimate.derivatives import _calmed, _windows, differentiated
from handcal.estimate.exciting import _wandering
from handcal.estimate.fit import fitted
from handcal.estimate.model import Model
from handcal.estimate.scan import scan
from handcal.estimate.transfer import at_constants
from handcal.explain.pipeline import explain
from handcal.recordings.segment import rests
from handcal.types import Array, Imu, Recording
from handcal_sim import simulate
from handcal_sim.phone import Phone, capture_pose, consumer_phone

RATE_HZ, STARTS_S, SECONDS = 100.0, 5.0, 10.0
LAGS = {"gyro_bandwidth": [0.012], "accel_delay": [0.008], "pose_delay": [0.015]}
BESIDE = {"lever_arm": [0.04, -0.06, 0.03]}


@pytest.mark.parametrize("effect", ["gyro_scale", "gyro_bandwidth"])
def test_a_rest_knows_nothing_of_the_turn_after_it(effect: str) -> None:
    """At rest there is nothing to scale and nothing to filter. (Averaged over two seconds, the last
    second of a rest had a tenth of a turn of one radian a second in it.)"""
    t = np.arange(0.0, SECONDS, 1.0 / RATE_HZ)
    gyro = np.zeros((len(t), 3))
    gyro[:, 2] = np.where(t < STARTS_S, 0.0, np.sin(2.0 * (t - STARTS_S)))
    accel = np.tile([0.0, 0.0, 9.80665], (len(t), 1))
    recording = Recording("rest", Imu(t, gyro, accel, np.ones(len(t), dtype=np.bool_)))
    problem, _ = problem_of(recording, [effect], ("fixed_position",))
    problem = replace(problem, rests=rests(recording))
    zero = np.zeros(3)
    done = corrected_readings(problem, np.zeros(problem.constants), zero, zero)
    slopes = differentiated(done, np.zeros((len(t), 6))).slopes
    assert slopes is not None
    assert len(problem.rests)
    rest = problem.nodes.t < STARTS_S - 0.2
    assert np.abs(slopes.values[rest]).max() == 0.0
    assert np.abs(slopes.values[~rest]).max() > 0.5


@given(st.lists(st.integers(1, 90), min_size=1, max_size=8), st.integers(0, 2**32 - 1))
def test_what_is_averaged_adds_up_to_what_it_did(lengths: list[int], seed: int) -> None:
    """Over each rest and each motion: a mean that weighs some rows more than others makes
    velocities of noise that adds up to nothing, as a delay's derivative does."""
    rng = np.random.default_rng(seed)
    x = rng.standard_normal((sum(lengths), 2))
    quiet = np.repeat(np.arange(len(lengths)) % 2 == 0, lengths)
    means = _calmed(np.ascontiguousarray(x.T), _windows(20.0, quiet)).T
    first = np.r_[0, np.cumsum(lengths)[:-1]]
    whole, found = (np.add.reduceat(y, first, axis=0) for y in (x, means))
    assert np.allclose(found, whole, atol=1e-9)
    assert np.abs(means).max() < np.abs(x).max() + 1e-9


@pytest.mark.prove
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_delay_is_as_sure_as_the_evidence_is_of_it(seed: int) -> None:
    """A gyro whose bias walks, in slow turns: shifted by 20 ms the accelerometer costs as many nats
    as the information matrix says, within a factor of 1.5. (The tremor of the hand, of which the
    slope is large, was up to nine tenths of what the matrix had.)"""
    late, walk = 0.02, select(["gyro_bias_walk", "lever_arm"])
    errors = {"gyro_bias_walk": [1.5e-3], "lever_arm": [0.1, -0.07, 0.07]}
    world = simulate(
        "three-turns", seed=seed, duration_s=90.0, effects=errors, phone=consumer_phone
    )
    recording = recording_of(world, "heading")

    def shifted(by: float, levels: Mapping[str, float]) -> Model:
        imu = recording.imu
        moved = CubicSpline(imu.t, imu.accel)(np.clip(imu.t + by, imu.t[0], imu.t[-1]))
        case = case_of(replace(recording, imu=replace(imu, accel=moved)), fixed=levels)
        return fitted(baseline([case]).parts, walk)

    here = shifted(0.0, {})
    around = [shifted(by, here.parts[0].levels).log_evidence for by in (-late, late)]
    cost = here.log_evidence - 0.5 * sum(around)
    (delay,) = select(["accel_delay"])
    told = scan(here, [delay])
    (at,) = (i for i, (owner, _) in enumerate(told.names) if owner == delay.id)
    (unit,) = (p.prior_sigma for p in delay.parameters)
    others = np.delete(np.arange(len(told.names)), at)
    G = told.G / told.worth
    beside = G[np.ix_(others, others)] + np.eye(len(others))
    sure = G[at, at] - G[at, others] @ np.linalg.solve(beside, G[others, at])
    assert 1.0 / 1.5 < cost / (0.5 * sure * (late / unit) ** 2) < 1.5


def tracked(rng: np.random.Generator) -> Phone:
    return replace(consumer_phone(rng), pose=capture_pose(rng))


@pytest.mark.prove
def test_three_lags_are_the_same_from_wherever_a_fit_begins() -> None:
    """Gyro, accelerometer and pose all late by as much more look the same but for what is of second
    order: the marker's own velocity, beside the IMU's, tells of the pose, and if a fit takes it for
    the IMU's it stays where it began, tens of sigma apart."""
    world = simulate("free-hand", seed=0, duration_s=60.0, phone=tracked, effects=LAGS | BESIDE)
    case, effects = case_of(recording_of(world, "heading", "pose")), select([*LAGS, *BESIDE])
    first = fitted(baseline([case]).parts, effects)
    found, sigma = lags_of(first)
    truth = np.concatenate([injected(world, e) for e in LAGS])
    assert (np.abs(found - truth) / sigma).max() < 4.0
    assert sigma.max() < 0.002
    for later in (-0.008, 0.008):
        names = ((e.id, e.parameters[0].name) for e in effects if e.id in LAGS)
        moved = dict(zip(names, found + later, strict=True))
        again = fitted([at_constants(f, effects, moved) for f in first.parts], effects)
        assert np.abs(lags_of(again)[0] - found).max() < 2.0 * sigma.min()


def lags_of(m: Model) -> tuple[np.ndarray, np.ndarray]:
    """Values and sigmas of the lags, s."""
    sizes = {e.id: e.parameters[0].prior_sigma for e in m.effects if e.id in LAGS}
    at = [next(i for i, n in enumerate(m.quadratic.names) if n[0] == e) for e in LAGS]
    scale = np.array([sizes[e] for e in LAGS])
    return m.u[at] * scale, np.sqrt(np.diag(m.covariance)[at]) * scale


def small_changes(k: Array, s: Signals) -> Array:
    """Of the force what differs from its mean over a second: in a turn about the vertical that is
    the hand's sway, or nearly."""
    width = round(1.0 / float(np.median(np.diff(s.t))))
    mean = uniform_filter1d(s.accel, width, axis=0)
    return np.hstack([np.zeros_like(s.gyro), k * (s.accel - mean)])


@pytest.mark.parametrize("seed", [0, *proved(1, 2)])
def test_what_makes_a_hands_sway_smaller_is_not_favoured_for_that(seed: int) -> None:
    """An accelerometer that felt small changes too little would make the sway of every hand larger
    than it is: nothing says so, for or against."""
    world = simulate("z-turn", seed=seed, duration_s=30.0)
    base = baseline([case_of(recording_of(world, "heading"))])
    felt = replace(select(["accel_scale"])[0], id="small", imu_error=small_changes, features=None,
                   proportional=False, parameters=(Param("k", "1", 0.1),))  # fmt: skip
    assert fitted(base.parts, [felt]).log_evidence < base.log_evidence + 1.0


def test_all_that_a_held_point_does_is_a_hands_wandering_whether_it_sways_or_creeps() -> None:
    """Where most of it was taken for a drift, that was motion: a force that counts by its size as
    well shrank it, and gained a hundred nats in a recording with nothing but a walk."""
    world = simulate("free-hand", seed=0, duration_s=10.0)
    (f,) = baseline([creeping(case_of(recording_of(world, "heading")))]).parts
    states = np.random.default_rng(0).normal(size=f.trajectory.markov.shape)
    moved = _wandering(f.problem, replace(f.trajectory, markov=states))
    # (place and velocity of the sway; place, velocity and acceleration of the drift)
    np.testing.assert_array_equal(moved, states[:, 3:6] + states[:, 9:12])


@pytest.mark.prove
def test_a_filter_that_runs_backwards_is_no_rival_of_a_late_accelerometer() -> None:
    """To the first order it is the same, and fits as well; but there is none."""
    errors = {"gyro_scale": [0.01, 0.0, -0.008], "accel_delay": [0.012]}
    world = simulate("free-hand", seed=2, duration_s=20.0, effects=errors)
    told = explain([recording_of(world, "heading")])
    assert told.verdict == "explained"
    assert sorted((m.effect, m.indistinguishable_from) for m in told.missing) == [
        ("accel_delay", ()), ("gyro_scale", ())
    ]  # fmt: skip
