"""Compass drift: the heading's north turns away at a steady rate."""

from __future__ import annotations

import math
from typing import Any

from handcal.compiled.jit import residual_function
from handcal.effects import TIME, Effect, Param
from handcal.effects._field import NORTH


def _heading(nav: Any, rate: Any, z: Any, r: Any) -> int:  # noqa: ARG001
    r[0] -= rate[0] * z[TIME]
    return 0


def _magnetometer(nav: Any, rate: Any, z: Any, r: Any) -> int:
    # a heading that is too large is a north that has turned to the east
    angle = rate[0] * z[TIME]
    east, north = z[NORTH] * math.sin(angle), z[NORTH] * (math.cos(angle) - 1.0)
    for i in range(3):
        r[i] -= nav[6 + i] * east + nav[9 + i] * north
    return 0


EFFECT = Effect(
    id="heading_drift",
    title="Compass drift",
    parameters=(Param("rate", "rad/s", 0.005),),
    story="The heading, or the field by which it is known, creeps away at a steady rate, "
    "as one does that comes from another gyro.",
    source="contract of this project",
    motion="Turns about at least two axes: with the z axis always up, this is a gyro bias.",
    validated="the simulator's injection",
    observation_error={
        "heading": residual_function(_heading),
        "magnetometer": residual_function(_magnetometer),
    },
)
