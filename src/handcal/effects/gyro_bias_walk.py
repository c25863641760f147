"""Gyro bias walk: the bias wanders as time goes by."""

from __future__ import annotations

from handcal.effects import Effect, Param
from handcal.effects._walk import RandomWalk
from handcal.types import Level

DENSITY = "gyro_bias_walk_density"

EFFECT = Effect(
    id="gyro_bias_walk",
    title="Gyro bias walk",
    parameters=(Param("density", "(rad/s)/sqrt(s)", 1e-3, positive=True),),
    story="The gyro's bias does not stay what it was at the start: it wanders.",
    source="rate random walk of IEEE Std 952-1997",
    motion="A long recording of any motion.",
    validated="the simulator's injection",
    process=RandomWalk(DENSITY),
    levels=(Level(DENSITY, "(rad/s)/sqrt(s)", 3e-4, 1e-6, 0.03),),
    walks="gyro",
)
