"""Rests found from the readings alone against the rests of the simulated hand."""

import math
from dataclasses import replace

import numpy as np
import pytest
from worlds import recording_of

from handcal.recordings import segment
from handcal.types import Imu, Recording
from handcal_sim import simulate

TURNS = ("z-turn", "three-turns", "free-hand", "travel")


def inside(t, spans):
    mask = np.zeros(len(t), dtype=bool)
    for a, b in spans:
        mask |= (t >= a) & (t <= b)
    return mask


@pytest.mark.parametrize("name", TURNS)
@pytest.mark.parametrize("seed", range(5))
def test_rests_are_those_of_the_hand(name, seed):
    """A calm hand (0.4 of the usual sway and tremor); on a table in ``travel``.

    A turn's ramp begins so gently that the first tenths of a second are a rest to the eye:
    nothing may reach further than half the window of 0.5 s into a motion.
    """
    world = simulate(name, seed=seed, sway=0.4)
    true, found = world.parameters["rests"], segment.rests(recording_of(world))
    assert len(found) == len(true)
    for (a, b), (c, d) in zip(true, found, strict=True):
        assert -0.25 < c - a < 0.5
        assert -0.5 < d - b < 0.25
    t = world.imu.stamps
    covered = inside(t, found) & inside(t, true)
    assert covered.sum() > 0.85 * inside(t, true).sum()


@pytest.mark.parametrize("seed", range(5))
def test_on_a_table_the_whole_recording_is_a_rest(seed):
    world = simulate("static", seed=seed)
    (found,) = segment.rests(recording_of(world))
    np.testing.assert_allclose(found, [world.imu.stamps[0], world.imu.stamps[-1]])


@pytest.mark.parametrize("seed", range(3))
def test_without_a_pause_there_is_no_rest(seed):
    """The free motion without its quiet ends."""
    world = simulate("free-hand", seed=seed)
    t = world.imu.stamps
    a, b = world.parameters["rests"][0][1] + 2.0, world.parameters["rests"][1][0] - 2.0
    keep = (t > a) & (t < b)
    x = world.imu.values[keep]
    cut = Recording("cut", Imu(t[keep], x[:, :3], x[:, 3:], np.ones(keep.sum(), dtype=bool)))
    found = segment.rests(cut)
    assert found.shape == (0, 2)


def turntable(rate_deg, turn_s, rest_s, seed, bias_deg=(0.5, -0.4, 0.6), rate_hz=100.0):
    """Rest, a steady turn about the vertical, rest: gravity does not move, white noise alone."""
    rng = np.random.default_rng(seed)
    duration = 2 * rest_s + turn_s
    t = np.arange(round(duration * rate_hz)) / rate_hz
    turning = np.clip((t - rest_s) / 0.3, 0, 1) * np.clip((duration - rest_s - t) / 0.3, 0, 1)
    gyro = np.radians(bias_deg) + turning[:, None] * np.array([0, 0, math.radians(rate_deg)])
    accel = np.tile([0.1, -0.2, 9.8], (len(t), 1))
    gyro = gyro + rng.normal(0, 2e-3, gyro.shape)
    accel = accel + rng.normal(0, 0.02, accel.shape)
    return Recording("turntable", Imu(t, gyro, accel, np.ones(len(t), dtype=bool)))


@pytest.mark.parametrize("rate_deg", [-60.0, -10.0, 6.0, 15.0, 45.0])
@pytest.mark.parametrize("seed", range(2))
def test_a_slow_steady_turn_is_not_a_rest(rate_deg, seed):
    """Though it is as quiet as one, and here the longest quiet stretch by far."""
    found = segment.rests(turntable(rate_deg, turn_s=20.0, rest_s=3.0, seed=seed))
    assert found.shape == (2, 2)
    np.testing.assert_allclose(found, [[0.0, 3.0], [23.0, 26.0]], atol=0.4)


@pytest.mark.parametrize("bias_deg", [(5.0, -4.0, 3.0), (0.0, 0.0, -8.0)])
def test_a_large_gyro_bias_does_not_hide_a_rest(bias_deg):
    """Rate of a cheap gyro at rest: several degrees a second, many times its prior."""
    recording = turntable(60.0, turn_s=5.0, rest_s=3.0, seed=0, bias_deg=bias_deg)
    found = segment.rests(recording)
    np.testing.assert_allclose(found, [[0.0, 3.0], [8.0, 11.0]], atol=0.4)


@pytest.mark.parametrize("rest_s", [0.4, 0.6])
def test_a_pause_too_short_is_not_a_rest(rest_s):
    """A rest lasts 0.8 s at least."""
    rng = np.random.default_rng(0)
    t = np.arange(1000) * 0.01
    moving = (np.abs(t - 5.0) > rest_s / 2)[:, None]
    shake = moving * np.sin(2 * math.pi * 2.0 * t[:, None] + np.array([0, 1, 2]))
    gyro = 2.0 * shake + rng.normal(0, 2e-3, (1000, 3))
    accel = [0, 0, 9.8] + 3.0 * shake + rng.normal(0, 0.02, (1000, 3))
    recording = Recording("pause", Imu(t, gyro, accel, np.ones(1000, dtype=bool)))
    assert segment.rests(recording).shape == (0, 2)


@pytest.mark.parametrize("rate_hz", [50.0, 100.0, 400.0])
def test_rests_do_not_depend_on_the_rate(rate_hz):
    found = segment.rests(turntable(60.0, turn_s=5.0, rest_s=3.0, seed=0, rate_hz=rate_hz))
    np.testing.assert_allclose(found, [[0.0, 3.0], [8.0, 11.0]], atol=0.4)


def test_masked_samples_are_no_rest():
    recording = turntable(60.0, turn_s=5.0, rest_s=3.0, seed=0)
    imu = recording.imu
    masked = replace(recording, imu=replace(imu, valid=imu.t > 3.0))
    np.testing.assert_allclose(segment.rests(masked), [[8.0, 11.0]], atol=0.4)


def test_a_large_offset_of_the_accelerometer_is_no_motion():
    """What counts is how much readings spread; the variance must not drown in their square."""
    recording = turntable(60.0, turn_s=5.0, rest_s=3.0, seed=0)
    imu = recording.imu
    off = replace(recording, imu=replace(imu, accel=imu.accel + np.array([50.0, -50.0, 80.0])))
    np.testing.assert_allclose(segment.rests(off), segment.rests(recording), atol=0.02)
