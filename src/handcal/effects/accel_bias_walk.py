"""Accelerometer bias walk: the bias wanders as time goes by."""

from __future__ import annotations

from handcal.effects import Effect, Param
from handcal.effects._walk import RandomWalk
from handcal.types import Level

DENSITY = "accel_bias_walk_density"

EFFECT = Effect(
    id="accel_bias_walk",
    title="Accelerometer bias walk",
    parameters=(Param("density", "(m/s^2)/sqrt(s)", 1e-3, positive=True),),
    story="The accelerometer's bias does not stay what it was at the start: it wanders.",
    source="acceleration random walk of IEEE Std 1293-1998",
    motion="A long recording in which the device is turned over again and again.",
    validated="the simulator's injection",
    process=RandomWalk(DENSITY),
    levels=(Level(DENSITY, "(m/s^2)/sqrt(s)", 3e-4, 1e-6, 0.03),),
    walks="accel",
)
