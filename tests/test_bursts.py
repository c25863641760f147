"""Stamps of arrival in bursts are put where the readings were taken; other stamps stay; gaps end
rests, and a filter starts again behind them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from handcal.recordings.bridged import BRIDGE_S, bridged
from handcal.recordings.inputs import of_arrays
from handcal.recordings.inputs._bursts import in_bursts
from handcal.recordings.overview import overview
from handcal.recordings.segment import each_rest
from handcal.types import Imu, Recording, Series

HZ = 100.0


def arriving(n, m, rng, ppm=80.0, late=2e-3, within=2e-4, lost=()):
    """True times and stamps (n,), s: m at a time, some bursts lost."""
    t = np.arange(n) / HZ * (1 + 1e-6 * ppm)
    group = np.arange(n) // m
    delay = rng.exponential(late, group[-1] + 1)[group]
    stamps = t[np.minimum((group + 1) * m, n) - 1] + delay + within * (np.arange(n) % m)
    kept = ~np.isin(group, lost)
    return t[kept], np.maximum.accumulate(stamps)[kept]


def ns(t):
    return np.rint(1e9 * t).astype(np.int64) + 10**18


@pytest.mark.parametrize("m", [2, 3, 5, 10, 20, 50])
@pytest.mark.parametrize("within", [0.0, 2e-4])
@pytest.mark.parametrize("seed", range(3))
def test_bursts_are_put_on_the_clock_of_the_sensor(m, within, seed):
    rng = np.random.default_rng(seed)
    late = min(2e-3, 0.05 * m / HZ)
    t, stamps = arriving(6000, m, rng, late=late, within=within * min(1.0, m / 10), lost=(7, 8, 31))
    found = in_bursts(ns(stamps), rng.normal(size=(len(t), 3)), "IMU")
    assert found is not None
    assert f"{m} readings every" in found.text
    off = (found.ns - ns(t)[0]) / 1e9 - (t - t[0])
    assert np.ptp(off) < 2e-3
    assert np.all(np.diff(found.ns) > 0)


@pytest.mark.parametrize("seed", range(5))
def test_other_stamps_stay_as_they_are(seed):
    rng = np.random.default_rng(seed)
    t = np.arange(3000) / HZ
    jitter = np.sort(t + rng.normal(0, 4e-3, len(t)))
    lost = t[rng.random(len(t)) > 0.1]
    slower = np.r_[t[:1500], t[1499] + np.arange(1, 400) / 25.0]
    twice = np.repeat(t[:1500], 2)
    for stamps in (t, jitter, lost, slower, np.round(jitter, 3)):
        assert in_bursts(ns(stamps), rng.normal(size=(len(stamps), 3)), "IMU") is None
    # (read twice as often as it is measured)
    value = np.repeat(rng.normal(size=(1500, 3)), 2, axis=0)
    assert in_bursts(ns(twice), value, "IMU") is None


def test_a_stream_of_the_same_table_goes_with_the_imu():
    rng = np.random.default_rng(0)
    t, stamps = arriving(3000, 10, rng)
    values = rng.normal([0, 0, 0, 0, 0, 9.81], 0.01, (len(t), 6))
    mag = 4e-5 + rng.normal(0, 1e-7, (len(t[::4]), 3))
    back = of_arrays("x", stamps, values[:, :3], values[:, 3:], {"mag": ((stamps[::4], mag), 3)})
    np.testing.assert_allclose(back.streams["mag"].t, back.imu.t[::4], atol=1e-6)


def rest(seconds=20.0, gap=0.0, at=8.0):
    rng = np.random.default_rng(0)
    t = np.arange(round(seconds * HZ)) / HZ
    values = rng.normal([0.01, 0, 0, 0, 0, 9.81], [1e-3] * 3 + [0.01] * 3, (len(t), 6))
    t = np.where(t >= at, t + gap, t)
    mag = Series(np.arange(0.0, t[-1], 0.1), np.zeros((len(np.arange(0.0, t[-1], 0.1)), 3)))
    return Recording("x", Imu(t, values[:, :3], values[:, 3:], np.ones(len(t), bool)), {"mag": mag})


@pytest.mark.parametrize("gap", [1.0, 30.0, 1000.0])
def test_a_rest_ends_at_a_gap_and_another_begins(gap):
    found = each_rest(rest(gap=gap))
    assert len(found) == 2
    assert sum(r.seconds for r in found) < 20.0
    assert found[0].end <= 8.0
    assert found[1].start >= 8.0 + gap
    assert sum(r.seconds for r in overview(rest(gap=gap)).rests) < 20.0


def test_a_lost_sample_ends_no_rest():
    whole = rest()
    keep = np.arange(len(whole.imu.t)) % 50 != 7
    imu = Imu(*(x[keep] for x in (whole.imu.t, whole.imu.gyro, whole.imu.accel, whole.imu.valid)))
    assert len(each_rest(replace(whole, imu=imu))) == 1


def test_a_bridge_takes_the_place_of_a_gap():
    recording = rest(gap=100.0)
    back = bridged(recording)
    assert back.duration_s == pytest.approx(recording.duration_s - 100.0 - 1 / HZ + BRIDGE_S)
    assert np.all(np.diff(back.imu.t) > 0)
    assert back.imu.valid.sum() == len(recording.imu.t)
    assert np.diff(back.streams["mag"].t).max() < BRIDGE_S + 0.2
    assert "starts again behind a gap" in back.warnings[-1]
    assert bridged(rest()) is not None
    assert bridged(rest()).warnings == ()


def test_in_a_bridge_the_device_is_turned_as_gravity_shows():
    recording = rest(gap=100.0)
    imu = recording.imu
    tipped = np.where(imu.t[:, None] > 50.0, imu.accel[:, [2, 1, 0]], imu.accel)
    back = bridged(replace(recording, imu=replace(imu, accel=tipped))).imu
    made = ~back.valid
    angle = (
        back.gyro[made].sum(axis=0) * BRIDGE_S / (made.sum() + 1) * (made.sum() + 1) / made.sum()
    )
    # up goes from z to x: the body turns about -y
    np.testing.assert_allclose(angle, [0.0, -np.pi / 2, 0.0], atol=0.05)
