"""Axes of gyro and accelerometer that do not agree are told, as the fewest changes that mend them;
axes that a motion does not show are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from handcal.recordings.inputs import load, of_arrays
from handcal.types import InputError
from handcal_sim import simulate

SAID = {
    "gyroscope's x, -y, z": lambda v: v * [1, -1, 1, 1, 1, 1],
    "gyroscope's y, x, z": lambda v: v[:, [1, 0, 2, 3, 4, 5]],
    "gyroscope's -x, -y, -z": lambda v: v * [-1, -1, -1, 1, 1, 1],
    "accelerometer's x, y, -z": lambda v: v * [1, 1, 1, 1, 1, -1],
    "accelerometer's x, z, y": lambda v: v[:, [0, 1, 2, 3, 5, 4]],
}


@pytest.fixture(scope="module")
def turned():
    world = simulate("free-hand", seed=0, duration_s=20.0)
    return world.imu.stamps, world.imu.values


def read(t, values, **streams):
    return of_arrays(
        "axes", t, values[:, :3], values[:, 3:6], {k: (v, 1) for k, v in streams.items()}
    )


@pytest.mark.parametrize("axes", SAID)
def test_the_fewest_changes_are_said(turned, axes):
    t, values = turned
    with pytest.raises(InputError, match=axes):
        read(t, SAID[axes](values))


def test_mended_as_it_says_they_agree(turned):
    t, values = turned
    spoilt = values[:, [2, 0, 1, 3, 4, 5]]
    with pytest.raises(InputError, match=r"gyroscope.s y, z, x|accelerometer.s z, x, y"):
        read(t, spoilt)
    assert len(read(t, spoilt[:, [1, 2, 0, 3, 4, 5]]).imu.t) == len(t)


def test_what_turns_about_up_alone_tells_nothing():
    """Gravity does not move, whatever the axes are called."""
    t = np.arange(0.0, 20.0, 0.01)
    rng = np.random.default_rng(0)
    values = rng.normal([0, 0, 1.5, 0, 0, 9.81], 0.01, (len(t), 6))
    for spoil in SAID.values():
        said = spoil(values) if spoil(values)[:, 5].mean() > 9 else values
        assert len(read(t, said).imu.t) == len(t)


def test_gravity_that_stays_while_the_gyro_turns_is_no_exchange_of_axes():
    """(Any axis along it would fit.)"""
    t = np.arange(0.0, 20.0, 0.01)
    values = np.random.default_rng(0).normal([0, 0.8, 0, 0, 0, 9.81], 0.01, (len(t), 6))
    assert len(read(t, values).imu.t) == len(t)


def test_large_errors_are_no_other_axes(turned):
    """A scale error of 15 %, axes 8 degrees off, and a gyro that is late by 20 ms."""
    t, values = turned
    off = values.copy()
    off[:, :3] = np.roll(values[:, :3] @ (1.15 * np.eye(3) + 0.14 * (np.ones((3, 3)) - np.eye(3))),
                         2, axis=0)  # fmt: skip
    assert len(read(t, off).imu.t) == len(t)
    assert replace(read(t, off), warnings=()).imu.valid.all()


@pytest.mark.parametrize("seed", range(5))
def test_a_heading_that_counts_clockwise_is_said(seed):
    world = simulate("free-hand", seed=seed, duration_s=40.0)
    t, values, heading = world.imu.stamps, world.imu.values, world.streams["heading"]
    assert len(read(t, values, heading=(heading.stamps, heading.values)).streams["heading"].t) > 20
    with pytest.raises(InputError, match="heading=deg-cw"):
        read(t, values, heading=(heading.stamps, -heading.values))


def test_a_clockwise_heading_of_a_table_can_be_named(tmp_path):
    world = simulate("free-hand", seed=0, duration_s=40.0)
    h = world.streams["heading"]
    psi = np.degrees(-np.interp(world.imu.stamps, h.stamps, np.unwrap(h.values.ravel())))
    columns = np.column_stack([world.imu.stamps, world.imu.values[:, :6], psi])
    path = tmp_path / "compass.csv"
    np.savetxt(path, columns, delimiter=",", comments="",
               header="time (s),gx,gy,gz,ax,ay,az,heading (deg-cw)")  # fmt: skip
    assert load(path, units={"heading": "deg-cw"}).streams["heading"].value.shape[1] == 1
    with pytest.raises(InputError, match="turns against the gyroscope"):
        load(path, units={"heading": "deg"})
