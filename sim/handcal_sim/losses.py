"""What never reached the file: readings while an app paused, single samples that got lost."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from handcal_sim.scenario import Stream, World
from handcal_sim.sensors import Truth


def paused(world: World, start: float, end: float) -> World:
    """Without any reading whose stamp lies between start and end, s."""
    streams = {name: _outside(stream, start, end) for name, stream in world.streams.items()}
    stamps = world.imu.stamps
    kept = with_samples(world, (stamps < start) | (stamps >= end))
    return dataclasses.replace(kept, streams=streams)


def losing(world: World, share: float, rng: np.random.Generator) -> World:
    """Without this share of the IMU's samples, each lost for itself."""
    return with_samples(world, rng.random(len(world.t)) >= share)


def with_samples(world: World, kept: NDArray[np.bool_]) -> World:
    """With those of the IMU's samples only, kept (n,)."""
    true = {f.name: getattr(world.truth, f.name)[kept] for f in dataclasses.fields(Truth)}
    imu = Stream(world.imu.stamps[kept], world.imu.values[kept])
    return dataclasses.replace(world, imu=imu, t=world.t[kept], truth=Truth(**true))


def _outside(stream: Stream, start: float, end: float) -> Stream:
    kept = (stream.stamps < start) | (stream.stamps >= end)
    return Stream(stream.stamps[kept], stream.values[kept])
