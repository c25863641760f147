"""Each rest has the noise it has: on a table, in a hand that trembles, with any sensor."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hand_world import Held, Sensor, Table, Turn, alternating, band, record, turns
from proved import proved
from worlds import recording_of

import handcal
from handcal.compiled import so3
from handcal.effects import catalogue
from handcal.estimate.baseline import started
from handcal.estimate.case import case_of
from handcal.estimate.fit import fitted
from handcal.estimate.trajectory import path
from handcal.recordings import segment
from handcal.show.calibration import summary
from handcal.types import Array, Imu, Recording
from handcal_sim import simulate
from handcal_sim.motion_carried import carried, strolled
from handcal_sim.phone import perfect_phone

RATES = (50.0, 200.0, *proved(100.0, 500.0))


def near(found, true, reach=0.5):
    """Whether the spans found are those, each end within half a second (the window)."""
    return found.shape == true.shape and bool(np.abs(found - true).max() < reach)


# --- poses held by hand -------------------------------------------------------------------------


def ten_poses(seed, rate_hz=100.0):
    """Ten poses of 2 to 6 s; from one to the next tremor and sway differ by up to ten times."""
    rng = np.random.default_rng(seed)
    held = [
        Held(
            rng.uniform(2.0, 6.0),
            tremor_deg=0.1 * 10.0 ** rng.uniform(0.0, 1.0),
            shake=0.05 * 10.0 ** rng.uniform(0.0, 1.0),
            sway_deg=rng.uniform(0.1, 0.4),
        )
        for _ in range(10)
    ]
    return held, *record(alternating(held, turns(9, seed)), seed, rate_hz)


@pytest.mark.parametrize("rate_hz", RATES)
def test_ten_poses_held_by_hand_are_ten_rests(rate_hz):
    """N = 100 poses in 10 recordings: to each belongs one rest, of at least half its length. If one
    in a hundred were torn or lost, four or more would be with probability 0.02. No rest reaches
    half a window into a turn."""
    wrong = 0
    for seed in range(10):
        _, recording, spans = ten_poses(seed, rate_hz)
        found, poses = segment.rests(recording), spans[::2]
        for a, b in poses:
            own = found[(found[:, 1] > a) & (found[:, 0] < b)]
            wrong += len(own) != 1 or own[0, 1] - own[0, 0] < 0.5 * (b - a)
        for a, b in found:
            assert np.any((poses[:, 0] - 0.25 < a) & (b < poses[:, 1] + 0.25))
    assert wrong <= 3


def test_each_rest_has_the_noise_it_has():
    """Of each pose the noise that was put in, to a third: a tremor of few lines beats, and of a
    slow sway two seconds are no fair sample."""
    seen = 0
    for seed in range(5):
        held, recording, spans = ten_poses(seed)
        for rest in segment.each_rest(recording):
            (k,) = np.flatnonzero((spans[::2, 0] < rest.end) & (spans[::2, 1] > rest.start))
            sensor, h = Sensor(), held[k]
            assert rest.accel_noise > math.hypot(sensor.accel, 0.5 * h.shake)
            quick = math.hypot(sensor.gyro, math.radians(h.tremor_deg))
            slow = math.radians(h.sway_deg) * 2.0 * math.pi * 0.8
            assert quick / 1.34 < rest.gyro_noise < 1.34 * math.hypot(quick, slow)
            seen += 1
    assert seen >= 45


def test_a_pose_in_the_hand_beside_the_table_is_found_by_its_own_noise():
    """Twenty times as loud as the table, which lasts ten times as long."""
    stages = alternating([Table(40.0), Held(4.0, tremor_deg=1.0), Table(3.0)], turns(2))
    for seed in range(5):
        recording, spans = record(stages, seed)
        assert near(segment.rests(recording), spans[::2])
        assert [r.still for r in segment.each_rest(recording)] == [True, False, True]


@pytest.mark.parametrize("rate_hz", RATES)
def test_a_table_is_still_and_a_hand_is_not(rate_hz):
    """N = 40 rests of 3 s each. A table's false alarm is far below 1 in 1000 (flicker is allowed
    for), so one of 40 at most; a sway of 0.3 deg turns by ten times the noise of the means."""
    still = {"table": 0, "hand": 0}
    for seed in range(10):
        for name, make in (("table", Table), ("hand", Held)):
            recording, _ = record(alternating([make(3.0)] * 4, turns(3, seed)), seed, rate_hz)
            found = segment.each_rest(recording)
            assert len(found) == 4
            still[name] += sum(r.still for r in found)
    assert still["table"] >= 39
    assert still["hand"] <= 1


# --- tables, and sensors of all kinds -----------------------------------------------------------


@pytest.mark.parametrize("rate_hz", RATES)
@pytest.mark.parametrize(
    "sensor",
    [Sensor(), Sensor(gyro=2e-4, accel=2e-3, gyro_step=1.1e-3, accel_step=0.02),
     Sensor(gyro=6e-3, accel=0.08), Sensor(gyro=0.0, accel=0.0)],
    ids=["usual", "coarse", "noisy", "perfect"],
)  # fmt: skip
def test_rests_on_a_table_with_any_sensor(rate_hz, sensor):
    """Six rests of 1 to 6 s, five recordings; steps of a converter may be larger than the noise."""
    for seed in range(5):
        rests = [Table(s) for s in np.random.default_rng(seed).uniform(1.5, 6.0, 6)]
        recording, spans = record(alternating(rests, turns(5, seed)), seed, rate_hz, sensor)
        assert near(segment.rests(recording), spans[::2])


def test_what_never_rests_has_no_rest():
    """N = 20 recordings of 20 s, turned to and fro at 0.3 to 3 Hz and 60 deg/s; none rests for
    0.8 s within 4 deg/s, and the sensor's noise has no pauses to show."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        t = np.arange(2000) / 100.0
        gyro = band(rng, t, 0.3, 3.0) + 2e-3 * rng.standard_normal((2000, 3))
        accel = [0, 0, 9.8] + 2.0 * band(rng, t, 0.3, 3.0) + 0.02 * rng.standard_normal((2000, 3))
        recording = Recording("never", Imu(t, gyro, accel, np.ones(2000, dtype=bool)))
        assert segment.rests(recording).shape == (0, 2)
        assert segment.with_pauses(recording).shape == (0, 2)


@pytest.mark.parametrize("rate_hz", RATES)
def test_a_recording_at_rest_is_one_rest(rate_hz):
    for seed in range(5):
        recording, _ = record([Table(60.0)], seed, rate_hz)
        np.testing.assert_allclose(segment.rests(recording), recording.imu.t[[0, -1]][None])
        assert segment.at_rest(recording)
        held, _ = record([Held(60.0)], seed, rate_hz)
        assert not segment.at_rest(held)


# --- steady turns -------------------------------------------------------------------------------


def spinning(rate_deg, seconds, seed=0, rest_s=0.0):
    """About the vertical, between two rests if any."""
    rng = np.random.default_rng(seed)
    n = round(100 * (seconds + 2 * rest_s))
    t = np.arange(n) / 100.0
    gyro = np.radians([0.3, -0.4, 0.2]) + 2e-3 * rng.standard_normal((n, 3))
    gyro[(t >= rest_s) & (t < rest_s + seconds), 2] += math.radians(rate_deg)
    accel = [0.1, -0.2, 9.8] + 0.02 * rng.standard_normal((n, 3))
    return Recording("spin", Imu(t, gyro, accel, np.ones(n, dtype=bool)))


def test_a_turn_faster_than_any_offset_is_no_rest():
    assert segment.rests(spinning(30.0, 20.0)).shape == (0, 2)


@pytest.mark.parametrize("rate_deg", [-3.5, 2.5, 10.0])
def test_a_turn_that_contradicts_the_rests_is_none(rate_deg):
    """An offset does not change by that much between two rests, and back."""
    found = segment.rests(spinning(rate_deg, 20.0, rest_s=4.0))
    np.testing.assert_allclose(found, [[0.0, 4.0], [24.0, 28.0]], atol=0.5)


def test_an_offset_that_drifts_a_little_is_still_a_rest():
    found = segment.rests(spinning(0.3, 20.0, rest_s=4.0))
    assert np.diff(found, axis=1).sum() > 26.0


def test_a_turn_as_slow_as_a_drift_is_none_where_gravity_turns():
    """0.9 deg/s about a level axis for 20 s: the gyro alone could not tell, gravity can."""
    n = 2600
    t = np.arange(n) / 100.0
    rate = np.radians(0.9) * ((t > 3.0) & (t < 23.0))
    angle = np.cumsum(rate) / 100.0
    rng = np.random.default_rng(0)
    gyro = np.stack([rate, 0.0 * t, 0.0 * t], axis=1) + 2e-3 * rng.standard_normal((n, 3))
    force = 9.8 * np.stack([0.0 * t, np.sin(angle), np.cos(angle)], axis=1)
    accel = force + 0.02 * rng.standard_normal((n, 3))
    recording = Recording("roll", Imu(t, gyro, accel, np.ones(n, dtype=bool)))
    assert not any(a < 10.0 < b or a < 16.0 < b for a, b in segment.rests(recording))


# --- pauses -------------------------------------------------------------------------------------


def quarter_turns(seed, pause_s, rate_hz=100.0):
    """A rest, four quarter turns about one axis with three pauses, a rest."""
    quarter = Turn(0.5, (90.0, 0.0, 0.0))
    stages = alternating([Table(3.0), *[Table(pause_s)] * 3, Table(3.0)], [quarter] * 4)
    return record(stages, seed, rate_hz)


@pytest.mark.parametrize("rate_hz", RATES)
def test_pauses_between_quarter_turns_are_found(rate_hz):
    """N = 60 pauses of 0.35 s; a few windows in ten thousand are louder than they should be, so
    all but one are found, and nothing else is."""
    found = 0
    for seed in range(20):
        recording, spans = quarter_turns(seed, 0.35, rate_hz)
        assert len(segment.rests(recording)) == 2
        seen = segment.with_pauses(recording)
        middle = seen.mean(axis=1)
        inside = [int(((middle > a) & (middle < b)).sum()) for a, b in spans]
        assert sum(inside[1::2]) == 0
        found += sum(n == 1 for n in inside[2:-1:2])
    assert found >= 59


def test_a_pause_too_short_to_tell_is_none():
    recording, _ = quarter_turns(0, 0.1)
    assert len(segment.with_pauses(recording)) == 2


def test_the_test_has_the_false_alarm_rate_it_names():
    """Of N windows of white noise N times 1e-4 are refused. 50,000 windows of 10 samples, of
    which 5,000 are independent: at 1e-4 half a cluster is expected, four clusters (of up to ten
    windows each) or more with probability 0.002. With a quantile of 1e-2 it would be fifty."""
    recording, _ = record([Table(500.0)])
    rest = segment.each_rest(recording)
    refused = ~segment._like(recording, rest)
    clusters = int((np.diff(refused.astype(int)) == 1).sum())
    assert clusters <= 3 * 10
    assert refused.mean() < 1e-3


# --- what follows of it -------------------------------------------------------------------------


def test_a_board_lying_still_knows_its_gyro_bias():
    """Zero rate for 60 s: the bias is the mean rate, to the noise of the mean. White noise of
    2e-3 rad/s at 100 Hz leaves 2.6e-5 in the mean; three times that is asked for.

    What the gyro reads counts twice, as a rate that is zero and as a turn that gravity does not
    see, so about two axes the sigma is too small by up to the square root of two: the mean
    square of fifteen normalised errors is up to 5/3, with a standard deviation of 0.65 at most.
    """
    z = []
    for seed in range(5):
        recording, _ = record([Table(60.0)], seed)
        result = handcal.calibrate(recording, only=True)
        for axis, true in zip("xyz", Sensor().offset, strict=True):
            p = result.parameter("gyro_bias", axis)
            assert p.sigma < 3.0 * 2.6e-5
            z.append((p.value - true) / p.sigma)
    assert np.mean(np.square(z)) < 5.0 / 3.0 + 3.0 * 0.65


def test_a_board_lying_still_does_not_know_what_gravity_does_to_its_gyro():
    """What it reads is a bias and what gravity adds: 0.1 deg/s/g is usual, so no bias is known
    better than that; were there no g-sensitivity, it would be known as above."""
    usual = 9.80665 * catalogue()["gyro_g_sensitivity"].parameters[0].prior_sigma
    recording, _ = record([Table(60.0)])
    result = handcal.calibrate(recording)
    told = summary.calibration_json(result)["parameters"]
    for (axis, true), row in zip(zip("xyz", Sensor().offset, strict=True), told, strict=False):
        p = result.parameter("gyro_bias", axis)
        assert (row["effect"], row["name"], row["sigma"]) == (p.effect, p.name, p.sigma)
        prior = catalogue()["gyro_bias"].parameters[0].prior_sigma
        assert usual * prior / math.hypot(usual, prior) < p.sigma < prior
        assert abs(p.value - true) < 3.0 * p.sigma
        assert row["given_model"]["sigma"] < 3.0 * 2.6e-5
        assert abs(row["given_model"]["value"] - true) < 5.0 * row["given_model"]["sigma"]
    assert not any(p.shown for p in result.parameters if p.effect == "gyro_g_sensitivity")


# --- real devices -------------------------------------------------------------------------------


def test_all_poses_of_a_real_device_are_found(real_recordings):
    """Xsens: 38 attitudes. Between neighbours the device turns, and nothing is quiet for long."""
    recording = handcal.load(real_recordings / "devices" / "xsens_poses.mcap")
    found = segment.each_rest(recording)
    assert len(found) == 38
    t, gyro = recording.imu.t, recording.imu.gyro
    for a, b in pairwise(found):
        own = (t > a.end) & (t < b.start)
        rate = np.linalg.norm(gyro[own] - a.rate, axis=1)
        angle = math.acos(
            np.clip(a.force @ b.force / np.linalg.norm(a.force) / np.linalg.norm(b.force), -1, 1)
        )
        assert angle > math.radians(3.0) or np.radians(60.0) < rate.mean() * (b.start - a.end)
        slow = segment._runs(rate < math.radians(4.0), t[own], segment.MIN_REST_S)
        assert len(slow) <= 2


def test_sides_turns_and_pauses_of_a_real_device_are_found(real_recordings):
    """NilsPod: six sides, and three turns, each in four quarters with pauses of 0.2 to 0.4 s."""
    recording = handcal.load(real_recordings / "devices" / "nilspod_ferraris.mcap")
    rests, poses = segment.rests(recording), segment.with_pauses(recording)
    force = np.array([r.force for r in segment.each_rest(recording)])
    sides = {(int(np.argmax(np.abs(f))), bool(f[np.argmax(np.abs(f))] > 0)) for f in force}
    assert len(sides) == 6
    assert len(rests) == 13
    inside = [[p for p in poses if a[1] < p[0] and p[1] < b[0]] for a, b in pairwise(rests)]
    several = [len(i) for i in inside if i]
    assert len(several) == 3
    assert min(several) >= 2


def test_between_rests_the_trajectory_follows_the_readings() -> None:
    """Rests are several seconds and more than a turn apart: between them are epochs, and between
    these the readings. (A history made of the mean rate gave biases of hundreds of m/s^2.)"""
    world = simulate("travel", seed=0, phone=lambda _: perfect_phone())
    case = case_of(recording_of(world), "rest-only")
    (part,) = fitted([started(case)], ()).parts
    problem, nominal = part.linear.problem, part.linear.trajectory
    way = path(problem, nominal)
    t = problem.nodes.t
    assert np.diff(t[nominal.node]).max() < 0.51
    at = np.searchsorted(t, case.recording.imu.t)
    true = world.truth.C_nb
    # (the yaw that nothing observes is that of the first epoch)
    turn = nominal.C[0] @ true[0].T
    assert _apart(way.C[at], turn @ true) < np.radians(1.0)


@pytest.mark.parametrize("seed", [0, *proved(1, 2)])
def test_a_walk_that_begins_slowly_tells_nothing_of_a_delay_in_the_rest_before(seed: int) -> None:
    """Without noise and at rest to the last digit: what a delay does to the beginning of a walk,
    averaged into the rest before it, made 20 ms into 10 +- 0.4."""
    rng = np.random.default_rng(seed)
    walk = carried(strolled(40.0, 1.5, rng), 0.25)
    world = simulate(
        walk, seed=seed, phone=replace(perfect_phone(), rate_hz=64.0), sway=0.0, duration_s=40.0,
        effects={"accel_delay": [0.02]},
    )  # fmt: skip
    found = handcal.calibrate(recording_of(world), effects=["accel_delay"], only=True)
    (delay,) = (p for p in found.parameters if p.effect == "accel_delay")
    assert abs(delay.value - 0.02) < 3.0 * delay.sigma
    assert delay.sigma < 0.02


def _apart(A: Array, B: Array) -> float:
    """The largest angle between attitudes (n, 3, 3), rad."""
    return float(np.linalg.norm(so3.matrix_log(A @ B.transpose(0, 2, 1)), axis=1).max())


def test_a_rest_that_nobody_read_to_its_end_is_none_and_no_warning():
    """(A mean of nothing was one of numpy's warnings.)"""
    t = np.arange(1000) / 100.0
    imu = Imu(t, np.zeros((1000, 3)), np.tile([0.0, 0.0, 9.81], (1000, 1)), t < 8.0)
    recording = Recording("x", imu, {}, 0)
    whole, cut = (segment._rest(recording, 1.0, end) for end in (7.0, 9.9))
    assert segment._stays(recording, whole, np.zeros(3))
    assert not segment._stays(recording, cut, np.zeros(3))
