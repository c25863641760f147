"""Between its samples a motion bends: straight lines between the readings miss some of it."""

from __future__ import annotations

import numpy as np
import pytest
from worlds import recording_of

from handcal.estimate.calibration import calibrate
from handcal.estimate.sampling import between_samples, knocked, smoothness
from handcal.types import Imu
from handcal_sim import simulate
from handcal_sim.motion_wild import wild
from handcal_sim.phone import Phone, consumer_phone, with_rate

RATE_HZ, TURNS_HZ = 100.0, 3.0


def swinging(t: np.ndarray) -> Imu:
    x = np.cos(2.0 * np.pi * TURNS_HZ * t)[:, None] * np.ones(3)
    return Imu(t, x, x, np.ones(len(t), dtype=np.bool_))


def angles(t: np.ndarray, x: np.ndarray) -> np.ndarray:
    return np.cumsum(0.5 * (x[1:] + x[:-1]) * np.diff(t)[:, None], axis=0)


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_the_integral_loses_as_much_less_as_the_rule_is_cubic(share: float) -> None:
    """Of a sine straight lines lose (omega dt)^2 / 12, to the first order."""
    t = np.arange(0.0, 10.0, 1.0 / RATE_HZ)
    imu = swinging(t)
    omega = 2.0 * np.pi * TURNS_HZ
    true = np.sin(omega * t[1:, None]) / omega
    left = []
    whole = np.full(3, share)
    for x in (imu.gyro, imu.gyro + between_samples(imu, whole, imu.gyro, t)):
        off = angles(t, x)[:-1] - true[:-1]
        left.append(float(np.std(off[5:, 0])))
    lost = (omega / RATE_HZ) ** 2 / 12.0 * float(np.std(true[5:, 0]))
    assert left[0] == pytest.approx(lost, rel=0.02)
    assert left[1] == pytest.approx((1.0 - share) * lost, rel=0.1, abs=0.02 * lost)


def test_beside_a_gap_and_where_nothing_was_measured_readings_stay() -> None:
    t = np.arange(0.0, 1.0, 1.0 / RATE_HZ)
    t[50:] += 0.3
    imu = swinging(t)
    imu.valid[20] = False
    moved = np.flatnonzero(between_samples(imu, np.ones(3), imu.gyro, t).any(axis=1))
    assert not {0, 1, 18, 19, 20, 21, 22, 48, 49, 50, 51, 98, 99} & set(moved.tolist())
    assert {2, 17, 23, 47, 52, 97} <= set(moved.tolist())
    two = Imu(t[:2], np.ones((2, 3)), np.ones((2, 3)), imu.valid[:2])
    assert not between_samples(two, np.ones(3), two.gyro, t[:2]).any()
    assert not smoothness(two).any()


def of(gyro: np.ndarray, accel: np.ndarray) -> tuple[float, float]:
    """What readings of so many samples say of both sensors."""
    t = np.arange(len(gyro)) / RATE_HZ
    found = smoothness(Imu(t, gyro, accel, np.ones(len(t), dtype=np.bool_)))
    assert np.all(found[:3] == found[0])
    assert np.all(found[3:] == found[3])
    return float(found[0]), float(found[3])


@pytest.mark.parametrize("seed", range(5))
def test_readings_say_whether_they_are_smooth_between_the_samples(seed: int) -> None:
    """A sine of a few Hz is; white noise is not, nor is a random walk for the most part; of both
    together that share of the second differences' square that is the sine's."""
    rng = np.random.default_rng(seed)
    n = 20_000
    t = np.arange(n) / RATE_HZ
    sine = np.cos(2.0 * np.pi * TURNS_HZ * t)[:, None] * np.ones(3)
    white, walk = rng.standard_normal((n, 3)), rng.standard_normal((n, 3)).cumsum(axis=0)
    assert of(sine, sine) == (1.0, 1.0)
    noisy, rough = of(white, walk)
    # (twice its own scatter of some 0.02)
    assert noisy < 0.05
    assert 0.1 < rough < 0.3
    # what the rule asks for, x0 - x1 - x2 + x3, has four variances of white noise
    sigma = 0.02
    said = np.mean((sine[3:] + sine[:-3] - sine[1:-2] - sine[2:-1]) ** 2)
    share = said / (said + 4.0 * sigma**2)
    both, other = of(sine + sigma * white, np.sin(7.0 * t)[:, None] + 1e-6 * white)
    assert both == pytest.approx(share, abs=0.1)
    assert other == pytest.approx(1.0, abs=0.01)


def test_each_sensor_is_judged_by_its_own_readings() -> None:
    rng = np.random.default_rng(0)
    t = np.arange(5_000) / RATE_HZ
    sine = np.cos(2.0 * np.pi * TURNS_HZ * t)[:, None] * np.ones(3)
    smooth, rough = of(sine, rng.standard_normal((5_000, 3)))
    assert smooth == 1.0
    assert rough < 0.1
    assert of(np.zeros((50, 3)), sine[:50])[0] == 0.0


@pytest.mark.prove
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_hand_that_shakes_is_no_slow_gyro(seed: int) -> None:
    """What the integral lost was told as a low-pass and two delays that there were not, by 10 and 3
    nats in two of three of these (42 in a wild trial at 190 Hz)."""

    def phone(rng: np.random.Generator) -> Phone:
        return with_rate(consumer_phone(rng), RATE_HZ)

    world = simulate(wild(5.0), seed=seed, duration_s=40.0, phone=phone, sway=0.5)
    recording = recording_of(world, "heading")
    lags = ["gyro_bandwidth", "heading_delay", "accel_delay"]
    plain, slow = (calibrate(recording, e).log_evidence for e in ([], lags))
    assert slow < plain


def knock(at: float, width: float, seed: int) -> Imu:
    """Readings of a device that turns slowly, and is knocked once: there and back within four
    widths (s)."""
    t = np.arange(0.0, 10.0, 1.0 / RATE_HZ)
    x = 1e-3 * np.random.default_rng(seed).standard_normal((len(t), 3)) + np.sin(t)[:, None]
    x[:, 1] += (at - t) / width * np.exp(-0.5 * ((t - at) / width) ** 2)
    return Imu(t, x, 10.0 * x, np.ones(len(t), dtype=np.bool_))


def test_what_a_knock_hides_is_no_more_than_is_said() -> None:
    """Its integral is nothing; of what lies between the samples straight lines make an angle. Over
    all phases: within what is said to be unknown, and not far within it where it is as short as
    the samples are apart."""
    said, off = [], []
    for seed, at in enumerate(5.0 + np.arange(100) / 100.0 / RATE_HZ):
        imu = knock(at, 0.6 / RATE_HZ, seed)
        still = knock(-100.0, 1.0, seed)
        for k, (x, y) in enumerate([(imu.gyro, still.gyro), (imu.accel, still.accel)]):
            scale = (1.0, 10.0)[k]
            said.append(float(np.sqrt((knocked(imu)[:, k] ** 2).sum())) / RATE_HZ / scale)
            off.append(float((angles(imu.t, x)[-1] - angles(imu.t, y)[-1])[1]) / scale)
    assert min(said) > 0.0
    ratio = np.array(off) / np.array(said)
    assert np.abs(ratio).max() < 3.0
    assert np.sqrt(np.mean(ratio**2)) > 0.03


@pytest.mark.parametrize("seed", range(3))
def test_a_hand_that_turns_knocks_nothing(seed: int) -> None:
    world = simulate("free-hand", seed=seed, duration_s=20.0)
    assert not knocked(recording_of(world).imu).any()
    assert not knocked(knock(-100.0, 1.0, seed)).any()


def test_what_lasts_is_no_knock() -> None:
    """A rate that steps up has as large a bend as a knock, and its integral is in the readings."""
    imu = knock(-100.0, 1.0, 0)
    stepped = imu.gyro + np.where(imu.t > 5.0, 10.0, 0.0)[:, None]
    assert not knocked(Imu(imu.t, stepped, imu.accel, imu.valid)).any()
    hit = imu.gyro + np.where(imu.t == imu.t[500], 10.0, 0.0)[:, None]
    assert knocked(Imu(imu.t, hit, imu.accel, imu.valid))[:, 0].any()


def test_where_too_little_follows_each_other_nothing_is_said_of_knocks() -> None:
    imu = swinging(np.array([0.0, 0.01]))
    assert not knocked(imu).any()
