"""Between its samples a motion bends: straight lines between the readings miss some of it."""

from __future__ import annotations

import numpy as np
import pytest
from worlds import recording_of

from handcal.estimate.calibration import calibrate
from handcal.estimate.sampling import SMOOTH, between_samples
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


def test_the_integral_loses_as_much_less_as_the_rule_is_cubic() -> None:
    """Of a sine straight lines lose (omega dt)^2 / 12, to the first order."""
    t = np.arange(0.0, 10.0, 1.0 / RATE_HZ)
    imu = swinging(t)
    omega = 2.0 * np.pi * TURNS_HZ
    true = np.sin(omega * t[1:, None]) / omega
    left = []
    for x in (imu.gyro, imu.gyro + between_samples(imu, imu.gyro, t)):
        off = angles(t, x)[:-1] - true[:-1]
        left.append(float(np.std(off[5:, 0])))
    lost = (omega / RATE_HZ) ** 2 / 12.0 * float(np.std(true[5:, 0]))
    assert left[0] == pytest.approx(lost, rel=0.02)
    assert left[1] == pytest.approx((1.0 - SMOOTH) * lost, rel=0.1)


def test_beside_a_gap_and_where_nothing_was_measured_readings_stay() -> None:
    t = np.arange(0.0, 1.0, 1.0 / RATE_HZ)
    t[50:] += 0.3
    imu = swinging(t)
    imu.valid[20] = False
    moved = np.flatnonzero(between_samples(imu, imu.gyro, t).any(axis=1))
    assert not {0, 19, 20, 21, 49, 50, 99} & set(moved.tolist())
    assert {1, 18, 22, 48, 51, 98} <= set(moved.tolist())
    two = Imu(t[:2], np.ones((2, 3)), np.ones((2, 3)), imu.valid[:2])
    assert not between_samples(two, two.gyro, t[:2]).any()


@pytest.mark.parametrize("seed", range(3))
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
