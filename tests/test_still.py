"""A device that only lies there: how far its biases can be known, and by what they are not."""

from __future__ import annotations

import numpy as np
import pytest
from proved import proved

import handcal
from handcal.laws.with_motion import is_with_motion
from handcal.recordings import segment
from handcal.recordings.inputs import of_arrays

RATE = 50.0
GYRO, ACCEL = 9e-5, 1.5e-3  # white noise, rad/s and m/s^2 per root hertz
AXES = "xyz"


def lying(seed, seconds, gyro_bias, accel_bias, gyro_walk=0.0, accel_walk=0.0):
    """A device flat on a table, and the mean of its biases (6,) over the recording."""
    rng = np.random.default_rng(seed)
    n = int(seconds * RATE)
    t = np.arange(n) / RATE

    def readings(bias, white, walk):
        drift = np.cumsum(rng.normal(size=(n, 3)), axis=0) * walk / np.sqrt(RATE)
        true = np.asarray(bias) + drift - drift[0]
        return true + rng.normal(size=(n, 3)) * white * np.sqrt(RATE), true.mean(axis=0)

    gyro, omega = readings(gyro_bias, GYRO, gyro_walk)
    accel, force = readings(accel_bias, ACCEL, accel_walk)
    up = np.array([0.0, 0.0, 9.80665])
    return of_arrays("lying", t, gyro, accel + up, {}), np.r_[omega, force]


def biases(result):
    """Of gyro and accelerometer, each (6,): value, sigma, and whether it is shown."""
    told = {(p.effect, p.name): p for p in result.parameters}
    mine = [told[sensor, axis] for sensor in ("gyro_bias", "accel_bias") for axis in AXES]
    return tuple(np.array([getattr(p, of) for p in mine]) for of in ("value", "sigma", "shown"))


@pytest.mark.prove
@pytest.mark.parametrize("seed", range(3))
def test_biases_that_drift_are_not_read_as_a_tilt(seed):
    """A walk that no state followed made 60 to 650 mg of accelerometer bias, +- 11 mg."""
    recording, true = lying(
        seed, 120.0, (0.01, -0.02, 0.005), (0.3, 0.1, -0.04), gyro_walk=4e-5, accel_walk=5e-4
    )
    value, sigma, shown = biases(handcal.calibrate(recording))
    assert (np.abs(value - true) / sigma).max() < 4.0
    # gravity along z says nothing of x and y
    assert not shown[3:5].any()
    assert sigma[:3].max() < np.radians(0.2)


def test_a_table_is_known_whatever_a_bias_drifts_in_minutes():
    recording, _ = lying(0, 600.0, (0.01, -0.02, 0.005), (0.0, 0.0, 0.0), gyro_walk=1e-4)
    (rest,) = segment.each_rest(recording)
    assert rest.still


@pytest.mark.parametrize("seed", [0, *proved(1, 2)])
def test_a_large_bias_of_the_gyro_is_a_bias(seed):
    """Not a sensitivity to gravity of thirty times the usual size."""
    recording, true = lying(seed, 10.0, (-0.022, 0.018, 0.083), (0.0, 0.0, 0.0))
    value, sigma, shown = biases(handcal.calibrate(recording))
    assert shown[:3].all()
    assert (np.abs(value - true) / sigma)[:3].max() < 4.0


@pytest.mark.prove
def test_nothing_goes_with_a_motion_that_is_none():
    """A walk of the gyro was called an error that is as large as it turns."""
    recording, true = lying(
        0, 120.0, (0.01, -0.02, 0.005), (0.3, 0.1, -0.04), gyro_walk=4e-5, accel_walk=5e-4
    )
    found = handcal.explain(recording)
    assert not any(is_with_motion(u.formula) for u in found.unnamed)
    assert {m.effect for m in found.missing} & {"gyro_bias_walk", "accel_bias_walk"}
    value, sigma, _ = biases(found)
    assert (np.abs(value - true) / sigma).max() < 4.0
