"""The filter while readings still arrive: each sample counts once, however they come, and where a
batch estimate stands it goes on as if it had been a batch all along."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from turned_in_hand import recorded

import handcal
from handcal.estimate.live import live_frames
from handcal.estimate.online import (
    CONTEXT_S,
    Online,
    begun_at_rest,
    gone_on,
    parameters_of,
    stepped,
)
from handcal.estimate.standing import known_as, places
from handcal.types import HandcalError, Prior, Recording, Series
from handcal_sim import simulate, write

LEVELS = {"gyro_noise": 1e-3, "accel_noise": 5e-3, "sway": 0.004, "sway_per_rate": 0.004,
          "sway_time": 0.5, "position_noise": 3e-4}  # fmt: skip
EFFECTS = ("gyro_scale",)


@pytest.fixture(scope="module")
def recording(tmp_path_factory) -> Recording:
    return recorded(tmp_path_factory.mktemp("online"))


def cut(recording: Recording, begin: float, end: float) -> Recording:
    imu = recording.imu
    own = (imu.t >= begin) & (imu.t <= end)
    return replace(recording, imu=replace(imu, t=imu.t[own], gyro=imu.gyro[own],
                                          accel=imu.accel[own], valid=imu.valid[own]))  # fmt: skip


def calibrated(recording: Recording, only: bool = True):
    return handcal.calibrate(recording, EFFECTS, assume="fixed-point", noise=LEVELS, only=only)


def run(online: Online, recording: Recording, end: float, every: float):
    now, frame, updates = online.t, None, 0
    while now < end:
        now = min(now + every, end)
        piece = cut(recording, max(0.0, online.t - CONTEXT_S), now)
        online, new = stepped(online, piece)
        frame = new or frame
        updates += len(new.observed) if new else 0
    return online, frame, updates


@pytest.fixture(scope="module")
def half(recording):
    return calibrated(cut(recording, 0.0, 9.0))


def test_from_where_a_batch_stands_it_goes_on_as_a_batch_of_all_would(recording, half):
    whole = calibrated(recording)
    online, frame, _ = run(gone_on(half.standing, LEVELS), recording, 20.0, 0.2)
    assert online.t == recording.imu.t[-1]
    pairs = list(zip(whole.parameters, parameters_of(online, frame), strict=True))
    for p, (effect, name, value, sigma) in pairs:
        assert (effect, name) == (p.effect, p.name)
        assert abs(value - p.value) < 0.5 * p.sigma, p
        assert sigma == pytest.approx(p.sigma, rel=0.1), p
    # (it has learnt: of what it began with nothing is so sure)
    better = [p.sigma / half.parameter(p.effect, p.name).sigma for p in whole.parameters]
    assert min(better) < 0.8


def test_so_with_all_that_a_device_has(recording):
    """What is not shown has wider scales of its prior in a batch, which a filter does not, so
    sigmas are no more than alike; but of what it began with it has forgotten nothing."""
    half, whole = (calibrated(cut(recording, 0.0, end), only=False) for end in (9.0, 20.0))
    online, frame, _ = run(gone_on(half.standing, LEVELS), recording, 20.0, 0.2)
    assert len(whole.parameters) > 30
    for p, (effect, name, value, sigma) in zip(
        whole.parameters, parameters_of(online, frame), strict=True
    ):
        assert (effect, name) == (p.effect, p.name)
        assert abs(value - p.value) < 3.0 * p.sigma, p
        assert 0.5 * p.sigma < sigma < 2.0 * p.sigma, p
        assert sigma <= half.parameter(effect, name).sigma * (1.0 + 1e-6), p


def test_biases_stay_those_at_the_temperature_that_they_are_of(recording):
    """A batch tells biases at its mean temperature; what comes later is read as that says."""
    slope, half_s, imu = np.radians([0.05, -0.04, 0.06]), 9.0, recording.imu
    warm = np.interp(imu.t, [0.0, half_s, imu.t[-1]], [36.0, 44.0, 48.0])
    gyro = imu.gyro + (warm - 25.0)[:, None] * slope
    streams = {"temperature": Series(imu.t, warm[:, None])}
    warmed = replace(recording, imu=replace(imu, gyro=gyro), streams=streams)
    own = imu.t <= half_s
    first = replace(
        cut(warmed, 0.0, half_s), streams={"temperature": Series(imu.t[own], warm[own, None])}
    )
    half = handcal.calibrate(
        first, ["gyro_temperature"], assume="fixed-point", noise=LEVELS, only=True
    )
    assert half.standing.bias_temperature == pytest.approx(40.0, abs=0.1)
    online, frame, _ = run(gone_on(half.standing, LEVELS), warmed, 20.0, 0.2)
    told = {(e, n): (v, s) for e, n, v, s in parameters_of(online, frame)}
    for axis, true in zip("xyz", slope, strict=True):
        (bias, _), (value, sigma) = told["gyro_bias", axis], told["gyro_temperature", axis]
        before = half.parameter("gyro_bias", axis)
        assert abs(bias - before.value) < 4.0 * before.sigma, axis
        assert abs(value - true) < 4.0 * sigma, axis
        assert sigma < 0.5 * abs(true), axis


def test_each_sample_counts_once_however_they_arrive(recording, half):
    begun = gone_on(half.standing, LEVELS)
    one, first, seen = run(begun, recording, 14.0, 0.15)
    other, second, also = run(begun, recording, 14.0, 0.7)
    assert seen == also == pytest.approx(3.0 * (14.0 - begun.t), abs=1.5)
    assert one.t == other.t
    np.testing.assert_allclose(first.sigma, second.sigma, rtol=0.01)
    assert np.abs((first.parameters - second.parameters) / first.sigma).max() < 0.1
    again, none = stepped(one, cut(recording, one.t - 1.0, one.t))
    assert none is None
    assert again is one


@pytest.mark.parametrize(("only", "within"), [(True, 0.4), (False, 1.0)])
def test_it_is_the_filter_of_replay(recording, only, within):
    """Begun in the first rest with the same levels it ends where ``replay`` does, with one effect
    and with all that a device has."""
    result = calibrated(recording, only)
    effects = dict.fromkeys(p.effect for p in result.parameters[6:])
    online, _ = begun_at_rest(cut(recording, 0.0, 2.5), [*effects])
    online = replace(online, levels=LEVELS)
    online, frame, _ = run(online, recording, 20.0, 0.25)
    last = list(live_frames(result, rate_hz=5))[-1]
    assert np.abs((frame.parameters - last.parameters) / last.sigma).max() < within
    np.testing.assert_allclose(frame.sigma, last.sigma, rtol=0.1)


def test_its_levels_are_those_of_the_first_rest(recording):
    rest = cut(recording, 0.0, 2.5)
    rng = np.random.default_rng(0)
    noisy = replace(rest.imu, gyro=rng.normal(0.0, 0.02, rest.imu.gyro.shape))
    online, _ = begun_at_rest(replace(rest, imu=noisy), EFFECTS)
    assert online.levels["gyro_noise"] == pytest.approx(0.02 / np.sqrt(recording.rate_hz), rel=0.15)


def test_a_hand_that_has_hardly_turned_sways_no_less_than_is_usual(half):
    """What lay on a table tells nothing of it; later the batch's own levels count."""
    low = {**LEVELS, "sway": 1e-4, "sway_per_rate": 1e-4, "sway_time": 5.0, "gyro_noise": 1e-5}
    early = gone_on(half.standing, low).levels
    assert {n: early[n] for n in LEVELS} == {**LEVELS, "gyro_noise": 1e-5}
    assert gone_on(replace(half.standing, t=30.0), low).levels == low


def test_what_is_known_before_is_where_it_begins(recording):
    known = Prior((("gyro_scale", "x"), ("gyro_bias", "y")), np.array([0.02, 0.001]),
                  np.diag([1e-4**2, 1e-5**2]), {})  # fmt: skip
    online, frame = begun_at_rest(cut(recording, 0.0, 0.8), EFFECTS, known)
    told = {(e, n): (v, s) for e, n, v, s in parameters_of(online, frame)}
    assert told["gyro_scale", "x"] == pytest.approx((0.02, 1e-4), rel=1e-3)
    assert told["gyro_bias", "y"] == pytest.approx((0.001, 1e-5), rel=1e-2)


def test_a_standing_moved_to_what_is_known_of_its_parameters(half):
    """As a Kalman update by a measurement of them would move it: told by what another reading
    says, sigma and mean of all follow."""
    standing = half.standing
    names = [("gyro_scale", "x"), ("accel_bias", "y")]
    at = places(standing, names)
    same = known_as(standing, names, _values(standing)[np.array(at) - 9],
                    standing.P[np.ix_(at, at)])  # fmt: skip
    np.testing.assert_allclose(same.P, standing.P, rtol=1e-6, atol=1e-18)
    H = np.zeros((2, len(standing.P)))
    H[[0, 1], at] = 1.0
    R = np.diag(np.diag(standing.P)[at]) * 0.5
    K = standing.P @ H.T @ np.linalg.inv(H @ standing.P @ H.T + R)
    P = standing.P - K @ H @ standing.P
    innovation = np.sqrt(np.diag(R))
    x = K @ innovation
    mean = _values(standing)[np.array(at) - 9] + x[at]
    moved = known_as(standing, names, mean, P[np.ix_(at, at)])
    scale = np.sqrt(np.diag(P))
    np.testing.assert_allclose(moved.P / np.outer(scale, scale), P / np.outer(scale, scale),
                               atol=1e-6)  # fmt: skip
    assert np.abs((moved.p - standing.p - x[:3]) / scale[:3]).max() < 1e-6
    assert np.abs((moved.bg - standing.bg - x[9:12]) / scale[9:12]).max() < 1e-6


def _values(standing) -> np.ndarray:
    return np.r_[standing.bg, standing.ba, standing.extras]


def test_poses_and_references_are_for_the_batch(recording, half):
    t = recording.imu.t
    pose = Series(t[::10], np.tile([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], (len(t[::10]), 1)))
    with pytest.raises(HandcalError, match="whole"):
        begun_at_rest(replace(cut(recording, 0.0, 2.0), streams={"pose": pose}), EFFECTS)
    with pytest.raises(HandcalError, match="sample by sample"):
        gone_on(replace(half.standing, kinds=("known_input",)), LEVELS)


def test_of_what_it_does_not_observe_nothing_is_assumed(tmp_path):
    """A magnetometer is the batch's: its states are integrated out, the others stay."""
    write(simulate("three-turns", seed=2, duration_s=8.0), tmp_path / "x.mcap")
    recording = handcal.load(tmp_path / "x.mcap")
    if "mag" not in recording.streams:
        t = recording.imu.t[::5]
        rng = np.random.default_rng(0)
        u = rng.normal(size=(len(t), 3))
        field = 5e-5 * u / np.linalg.norm(u, axis=1)[:, None]
        recording = replace(recording, streams={"mag": Series(t, field)})
    result = handcal.calibrate(recording, assume="fixed-point")
    assert "magnetometer" in result.standing.kinds
    assert {"mag_hard_iron", "lever_arm"} <= set(result.standing.effects)
    levels = {n.name: n.value for n in result.noise}
    online = gone_on(result.standing, levels)
    assert online.standing.kinds == ("fixed_position",)
    assert all(owner != "magnetometer" for owner, _ in online.standing.names)
    np.testing.assert_allclose(online.standing.P[:15, :15], result.standing.P[:15, :15])
