"""A gyro that stays at the end of its range is told from one that turns steadily, or coarsely."""

from __future__ import annotations

import numpy as np
import pytest

from handcal.recordings.inputs import _checks
from handcal.recordings.inputs._range import at_range_end

LIMIT = 0.5  # rad/s
SAID = "end of its measuring range"


def moved(rate, hz):
    """t (n,), rates and forces (n, 3) of a device that turns about its x and y in turn at
    `rate` (n,), rad/s, beginning with z about up."""
    t = np.arange(len(rate)) / hz
    about_x = (t // 8.0) % 2 == 0
    true = np.c_[np.where(about_x, rate, 0.0), np.where(about_x, 0.0, rate), 0.0 * rate]
    up, ups = np.array([[0.3, 0.2, 0.93]]), []
    for row in true / hz:
        ups.append(up[0])
        up = _checks.turned(up, row[None])
    return t, true, 9.80665 * np.array(ups) / np.linalg.norm(up)


def read(t, true, force, *, noise=2e-3, seed=0):
    """The same as sensors of noise and a bias read it."""
    rng = np.random.default_rng(seed)
    gyro = true + 0.004 + noise * rng.normal(size=true.shape)
    return t, gyro, force + 0.02 * rng.normal(size=true.shape)


def swinging(hz, seconds=32.0, peak=1.2):
    t = np.arange(round(seconds * hz)) / hz
    return peak * np.sin(2 * np.pi * t / 4.0)


@pytest.mark.parametrize("hz", [50.0, 200.0])
@pytest.mark.parametrize(("low", "high"), [(-LIMIT, LIMIT), (-9.0, LIMIT), (-LIMIT, 0.98 * LIMIT)])
def test_the_end_of_the_range_is_found_where_gravity_turns_further(hz, low, high):
    """On both sides, on one, and with a bias that was taken off later."""
    t, gyro, accel = read(*moved(swinging(hz), hz))
    assert at_range_end(t, gyro, accel)[0] == []
    clipped = np.clip(gyro, low, high)
    said, where = at_range_end(t, clipped, accel)
    assert SAID in said[0]
    np.testing.assert_array_equal(where, np.any(clipped != gyro, axis=1))
    assert where.mean() > 0.3


@pytest.mark.parametrize("step", [0.0, 1e-3])
def test_an_extreme_that_repeats_without_its_noise_is_the_end_of_the_range(step):
    """Of a gyro turned about the vertical, where gravity tells nothing, and of an
    accelerometer; with noise of a step and more, or without steps."""
    t, true, _ = moved(swinging(100.0), 100.0)
    force = 9.80665 * np.c_[0.2 + 0.0 * t, np.sin(0.2 * t), np.cos(0.2 * t)]
    _, gyro, accel = read(t, true[:, [2, 2, 0]], force)
    for k, limit in enumerate((LIMIT, 9.0)):
        both = [gyro, accel]
        wanted = np.any(np.abs(both[k]) > limit + 0.01, axis=1)
        both[k] = np.clip(both[k], -limit, limit)
        if step:
            both = [step * np.round(x / step) for x in both]
        said, where = at_range_end(t, *both)
        assert SAID in said[0]
        assert ("gyroscope", "accelerometer")[k] in said[0]
        assert where[wanted].all()
        assert 0.2 < where.mean() < wanted.mean() + 0.02


@pytest.mark.parametrize("hz", [25.0, 100.0])
def test_coarse_and_slow_readings_are_not_taken_for_it(hz):
    """Steps of 0.02 to 6 deg/s: swung in the hand, spun at one rate, and slowly turned; with a
    scale error, which gravity shows as well."""
    t = np.arange(round(32.0 * hz)) / hz
    steady = np.where(t % 8.0 < 6.0, np.where(t % 16.0 < 8.0, 1.0, -1.0), 0.0)
    for rate in (swinging(hz), steady, 0.3 * steady, swinging(hz, peak=0.25)):
        motion = moved(rate, hz)
        for noise in (1e-4, 2e-3, 0.02):
            t, gyro, accel = read(*motion, noise=noise)
            for step in np.radians([0.02, 0.3, 1.0, 6.0]):
                coarse = step * np.round(1.02 * gyro / step)
                for force in (accel, 0.1 * np.round(accel / 0.1)):
                    assert at_range_end(t, coarse, force)[0] == [], (noise, step)


def test_a_hand_that_shakes_is_not_taken_for_it():
    """Other acceleration than gravity, of a whole m/s^2, beside a coarse gyro."""
    motion = moved(swinging(50.0), 50.0)
    for seed in range(8):
        t, gyro, accel = read(*motion, seed=seed)
        rng = np.random.default_rng(seed)
        phase, often = rng.uniform(0, 6, (2, 3))
        accel = accel + np.sin(2 * np.pi * (0.5 + often) * t[:, None] + phase)
        coarse = np.radians(1.0) * np.round(gyro / np.radians(1.0))
        assert at_range_end(t, coarse, accel)[0] == []
