"""The loop: two engines are one filter, at any node it can stop, and time is taken exactly."""

import math
from dataclasses import fields, replace

import numpy as np
import pytest
from worlds import part_of, problem_of, recording_of, true_levels

from handcal import calibrate, load
from handcal.compiled import so3
from handcal.estimate.filter import (
    ENGINES,
    State,
    empty_track,
    initial_state,
    run_compiled,
    run_filterpy,
)
from handcal.estimate.noise_levels import initial_levels
from handcal.estimate.problem import noise_arrays
from handcal.estimate.trajectory import epochs
from handcal.recordings import segment
from handcal.types import Imu, Series
from handcal_sim import simulate
from handcal_sim.motion import Start
from handcal_sim.phone import Clocking, Heading, consumer_phone, perfect_phone

EFFECTS = ("gyro_scale", "accel_scale", "lever_arm")


def simulated():
    world = simulate(
        "three-turns",
        seed=0,
        duration_s=12.0,
        effects={"gyro_scale": [0.01, -0.01, 0.005], "lever_arm": [0.05, -0.1, 0.02]},
    )
    problem, start = problem_of(recording_of(world, "heading"), EFFECTS)
    # a floor of 0.3 mm, lest round-off (1e-16 of prior over noise squared) reach 1e-9
    return problem, start, true_levels(world) | {"position_noise": 3e-4}


def real(folder):
    """Motion capture of a hand-held IMU: the first 24 s of its motion."""
    recording = load(folder / "broad_06_fast_rotation.mcap")
    moving = segment.rests(recording)[1, 1]
    short = part_of(recording, moving - 1.0, moving + 23.0)
    # every third sample, so that the slow engine stays quick
    imu = Imu(*(getattr(short.imu, f.name)[::3] for f in fields(Imu)))
    problem, start = problem_of(replace(short, imu=imu), EFFECTS, ("pose",))
    return problem, start, initial_levels(problem)


@pytest.fixture(scope="module", params=["simulated", "real"])
def case(request):
    if request.param == "simulated":
        return simulated()
    return real(request.getfixturevalue("real_recordings"))


def run(engine, case, stops=()):
    problem, start, levels = case
    noise = noise_arrays(problem, levels)
    track = empty_track(problem, epochs(problem))
    state = initial_state(problem, start, levels)
    for stop in (*stops, None):
        state = engine(problem, noise, state, track, stop)
    return state, track


@pytest.fixture(scope="module")
def compiled(case):
    return run(run_compiled, case)


@pytest.fixture(scope="module")
def stepwise(case):
    return run(run_filterpy, case)


def test_two_engines_are_one_filter(case, compiled, stepwise):
    """One updates scalar by scalar in compiled loops, the other jointly on matrices."""
    (a, track_a), (b, track_b) = compiled, stepwise
    sigma = np.sqrt(np.diag(a.P))
    for name in ("p", "v", "C", "bg", "ba", "extras"):
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), rtol=0, atol=1e-9)
    np.testing.assert_allclose(
        a.P / np.outer(sigma, sigma), b.P / np.outer(sigma, sigma), atol=1e-9
    )
    for name in ("p", "v", "C", "bg", "ba", "extras", "variance", "residual", "sigma"):
        np.testing.assert_allclose(
            getattr(track_a, name), getattr(track_b, name), rtol=1e-8, atol=1e-9, err_msg=name
        )
    np.testing.assert_array_equal(np.isnan(track_a.nis), np.isnan(track_b.nis))
    np.testing.assert_allclose(track_a.nis, track_b.nis, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(track_a.loglik.sum(), track_b.loglik.sum(), rtol=1e-9)
    assert np.isfinite(track_a.loglik.sum())
    assert (~np.isnan(track_a.nis)).sum() > 200
    assert a.node == b.node == len(case[0].nodes.t) - 1


def equal(a, b):
    for f in fields(a):
        np.testing.assert_array_equal(getattr(a, f.name), getattr(b, f.name), err_msg=f.name)


def test_a_compiled_run_can_stop_and_be_resumed(case, compiled):
    """Exactly: at the first node, in the middle, and before the last."""
    n = len(case[0].nodes.t)
    state, track = run(run_compiled, case, stops=(1, n // 2, n // 2 + 1, n - 1))
    equal(state, compiled[0])
    equal(track, compiled[1])


def test_a_stepwise_run_can_stop_and_be_resumed(case, stepwise):
    state, track = run(run_filterpy, case, stops=(len(case[0].nodes.t) // 2,))
    equal(state, stepwise[0])
    equal(track, stepwise[1])


def test_a_run_begun_by_one_engine_is_ended_by_the_other(case, compiled):
    problem, start, levels = case
    noise, track = noise_arrays(problem, levels), empty_track(problem, epochs(problem))
    middle = len(problem.nodes.t) * 2 // 3
    state = run_compiled(problem, noise, initial_state(problem, start, levels), track, middle)
    assert state.node == middle - 1
    end = run_filterpy(problem, noise, state, track)
    np.testing.assert_allclose(end.bg, compiled[0].bg, atol=1e-9)
    np.testing.assert_allclose(track.loglik.sum(), compiled[1].loglik.sum(), rtol=1e-9)


def test_runs_do_not_change_what_they_are_given(case):
    problem, start, levels = case
    noise, state = noise_arrays(problem, levels), initial_state(problem, start, levels)
    before = State(*(np.copy(getattr(state, f.name)) for f in fields(State)))
    z, gyro = problem.nodes.z.copy(), problem.nodes.gyro.copy()
    for engine in ENGINES.values():
        engine(problem, noise, state, empty_track(problem, epochs(problem)), 60)
        equal(state, before)
        np.testing.assert_array_equal(z, problem.nodes.z)
        np.testing.assert_array_equal(gyro, problem.nodes.gyro)


def test_covariance_stays_symmetric_and_positive_definite(case):
    """At 40 moments, in units of the sigmas: Joseph's form keeps what round-off would lose."""
    problem, start, levels = case
    noise, track = noise_arrays(problem, levels), empty_track(problem, epochs(problem))
    state = initial_state(problem, start, levels)
    for stop in np.linspace(0, len(problem.nodes.t), 41).astype(int)[1:]:
        state = run_compiled(problem, noise, state, track, int(stop))
        sigma = np.sqrt(np.diag(state.P))
        correlation = state.P / np.outer(sigma, sigma)
        np.testing.assert_allclose(correlation, correlation.T, rtol=0, atol=1e-12)
        assert np.linalg.eigvalsh(0.5 * (correlation + correlation.T)).min() > 0


def test_variances_are_those_of_the_track_and_never_grow_for_constants(compiled):
    state, track = compiled
    np.testing.assert_array_equal(track.variance[-1], np.diag(state.P))
    constants = track.variance[:, 9:15]
    assert np.all(np.diff(constants, axis=0) <= 1e-12 * constants[:-1])
    assert np.all(constants[-1] < constants[0])


# --- observations between samples ------------------------------------------------------------


SIGMA = math.radians(0.2)
STILL_HAND = {
    "gyro_noise": math.radians(0.01),
    "accel_noise": 2e-3,
    "position_noise": 1e-3,
    "sway": 1e-3,
    "sway_per_rate": 1e-3,
    "sway_time": 0.4,
    "heading_noise": SIGMA,
}


def fast_turn(phase_s, seed):
    """A level turn of 360 degrees in 3 s (2.5 rad/s); sigma of heading 0.2 degrees."""
    phone = perfect_phone()
    phone = replace(
        phone,
        gyro=replace(phone.gyro, noise=math.radians(0.01), bias=np.array([0.01, -0.02, 0.005])),
        accel=replace(phone.accel, noise=2e-3),
        heading=Heading(SIGMA, Clocking(100.0, phase_s)),
    )
    world = simulate("z-turn", seed=seed, phone=phone, duration_s=9.0, start=Start(), sway=0.0)
    return recording_of(world, "heading")


def turned(recording):
    """NIS of heading as the turn begins and ends; the vertical gyro bias and its sigma."""
    problem, start = problem_of(recording)
    noise, track = noise_arrays(problem, STILL_HAND), empty_track(problem, epochs(problem))
    state = run_compiled(problem, noise, initial_state(problem, start, STILL_HAND), track)
    t = np.repeat(problem.nodes.t, np.diff(problem.nodes.first))
    changing = (np.abs(t - 3.5) < 0.5) | (np.abs(t - 6.0) < 0.5)
    mine = (problem.nodes.kind == 1) & changing
    return track.nis[mine].mean(), state.bg[2], math.sqrt(state.P[11, 11])


@pytest.mark.parametrize("seed", range(3))
def test_observations_between_samples_are_taken_at_their_own_time(seed):
    """Half a sample is 0.7 degrees of this turn, three and a half sigma of the heading.

    NIS of 200 headings: 1 with a sigma of sqrt(2/200) = 0.1. Taken at the sample before, the
    heading jumps by 3.5 sigma as the turn begins and back as it ends: 1 + 3.5^2 at most, and
    less as the filter gives way.
    """
    exact, half = fast_turn(0.0, seed), fast_turn(0.005, seed)
    heading = half.streams["heading"]
    early = replace(half, streams={"heading": Series(heading.t - 0.005, heading.value)})
    nis, bias, sigma = turned(exact)
    nis_half, bias_half, sigma_half = turned(half)
    nis_early, _, _ = turned(early)
    assert abs(nis - 1) < 0.5
    assert abs(nis_half - 1) < 0.5
    assert 2.5 < nis_early < 13.0
    assert sigma_half == pytest.approx(sigma, rel=0.02)
    for estimate in (bias, bias_half):
        assert abs(estimate - 0.005) < 4 * sigma
    # the noise of both worlds is the same draw, applied half a sample apart
    assert abs(bias - bias_half) < sigma


def test_an_observation_adds_a_node_at_its_own_stamp():
    problem, _ = problem_of(fast_turn(0.005, 0), kinds=("heading",))
    t = problem.nodes.t
    np.testing.assert_allclose(t[:4], [0.0, 0.005, 0.01, 0.015], atol=1e-12)
    at = np.repeat(t, np.diff(problem.nodes.first))
    np.testing.assert_allclose(at, problem.recording.streams["heading"].t)
    # readings there lie between those of the neighbours
    middle = 0.5 * (problem.nodes.gyro[0:-2:2] + problem.nodes.gyro[2::2])
    np.testing.assert_allclose(problem.nodes.gyro[1:-1:2], middle, atol=1e-9)


def test_observations_outside_the_recording_are_counted():
    recording = fast_turn(0.0, 0)
    series = recording.streams["heading"]
    outside = Series(np.r_[-1.0, series.t, 100.0], np.vstack([[0.0], series.value, [0.0]]))
    problem, _ = problem_of(replace(recording, streams={"heading": outside}))
    assert problem.dropped == 2
    assert (problem.nodes.kind == 1).sum() == len(series.t)


# --- gaps and masks ----------------------------------------------------------------------------


def in_hand(seed):
    world = simulate("three-turns", seed=seed, phone=consumer_phone)
    return world, recording_of(world, "heading")


def biases(result):
    return np.array([p.value for p in result.parameters[:6]]), np.array(
        [p.sigma for p in result.parameters[:6]]
    )


def fit(world, recording):
    return calibrate(recording, assume="fixed-point", noise=true_levels(world), only=True)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("kind", ["masked", "gap"])
def test_masked_samples_and_gaps_are_bridged(kind, seed):
    """0.4 s without a measurement in the midst of a turn: found, not believed, and survived.

    Masked readings are absurd (half of full scale), so trusting them would show.
    """
    world, recording = in_hand(seed)
    truth = np.r_[
        [p["value"] for p in world.parameters["effects"]["gyro_bias"]],
        [p["value"] for p in world.parameters["effects"]["accel_bias"]],
    ]
    imu = recording.imu
    hole = (imu.t > 6.0) & (imu.t < 6.4)
    if kind == "masked":
        gyro, accel = imu.gyro.copy(), imu.accel.copy()
        gyro[hole] += 10.0
        accel[hole] -= 30.0
        holed = replace(recording, imu=Imu(imu.t, gyro, accel, ~hole))
    else:
        keep = ~hole
        holed = replace(
            recording, imu=Imu(imu.t[keep], imu.gyro[keep], imu.accel[keep], imu.valid[keep])
        )
    whole, less = fit(world, recording), fit(world, holed)
    assert np.isfinite(less.log_evidence)
    value, sigma = biases(less)
    assert np.all(np.abs(value - truth) < 4 * sigma)
    # what was not measured cannot have informed
    assert np.all(sigma > 0.99 * biases(whole)[1])
    assert np.all(sigma < 3 * biases(whole)[1])
    t, spread = less.history.t, less.history.nav_sigma[:, 6:9].max(axis=1)
    before, after = spread[t < 6.0][-1], spread[(t > 6.0) & (t < 6.45)].max()
    assert after > 2 * before


def test_a_mask_says_more_than_its_reading():
    """Unmasked, the same readings ruin the fit: the mask is what saves it."""
    world, recording = in_hand(0)
    imu = recording.imu
    hole = (imu.t > 6.0) & (imu.t < 6.4)
    gyro = imu.gyro.copy()
    gyro[hole] += 10.0
    evidence = [
        fit(world, replace(recording, imu=Imu(imu.t, gyro, imu.accel, ok))).log_evidence
        for ok in (~hole, np.ones(len(imu.t), dtype=bool))
    ]
    assert evidence[0] > evidence[1] + 100.0


def test_attitude_of_the_filter_is_that_of_the_simulator():
    """The simplest end-to-end check of all signs: roll, pitch and yaw follow the truth."""
    world, recording = in_hand(0)
    result = fit(world, recording)
    C = so3.matrix_of(result.smoothed.q_nb)
    at = np.searchsorted(world.t, result.smoothed.t).clip(0, len(world.t) - 1)
    error = so3.matrix_log(C @ world.truth.C_nb[at].transpose(0, 2, 1))
    # tilt: to a degree; yaw includes the heading's offset (prior 6 degrees)
    assert np.abs(error[:, :2]).max() < math.radians(1.5)
    offset = world.parameters["phone"]["heading_errors"]["offset"]
    assert np.abs(error[:, 2] - offset).max() < math.radians(3.0)


@pytest.mark.prove
@pytest.mark.parametrize("seed", [0, 1])
def test_an_app_that_pauses_is_no_swaying_hand(seed):
    """Nobody knows where the device went within a second: as its place was taken to follow from
    the readings before and after, the hand swayed by decimetres, or the gyro erred by a bump."""
    _, recording = in_hand(seed)
    imu = recording.imu
    t = imu.t[0] + 0.5 * recording.duration_s
    keep = (imu.t < t) | (imu.t > t + 1.2)
    heading = recording.streams["heading"]
    seen = (heading.t < t) | (heading.t > t + 1.2)
    paused = replace(
        recording,
        imu=Imu(imu.t[keep], imu.gyro[keep], imu.accel[keep], imu.valid[keep]),
        streams={"heading": Series(heading.t[seen], heading.value[seen])},
    )
    sways = []
    for r in (recording, paused):
        levels = {n.name: n.value for n in calibrate(r, assume="fixed-point").noise}
        sways.append(math.hypot(levels["sway"], levels["sway_per_rate"]))
    assert sways[0] / 1.5 < sways[1] < 1.5 * sways[0]
