"""Hard iron: magnetised parts of the device add a field that turns with it."""

from __future__ import annotations

import math
from typing import Any

from handcal._jit import residual_function
from handcal.effects import Effect, Param


def _magnetometer(nav: Any, iron: Any, z: Any, out: Any) -> int:
    x, y, w = z[0] - iron[0], z[1] - iron[1], z[2] - iron[2]
    east = nav[6] * z[0] + nav[7] * z[1] + nav[8] * z[2]
    north = nav[9] * z[0] + nav[10] * z[1] + nav[11] * z[2]
    clean_east = nav[6] * x + nav[7] * y + nav[8] * w
    clean_north = nav[9] * x + nav[10] * y + nav[11] * w
    d = math.atan2(north, east) - math.atan2(clean_north, clean_east)
    out[0] += d - 2.0 * math.pi * math.floor(d / (2.0 * math.pi) + 0.5)
    return 0


EFFECT = Effect(
    id="mag_hard_iron",
    title="Magnetometer hard iron",
    parameters=tuple(Param(axis, "tesla", 1e-4) for axis in "xyz"),
    story="Magnetised parts near the sensor add a field of their own, which turns with the device.",
    source="contract of this project; Gebre-Egziabher et al., J. Aerospace Eng. 19(2), 2006",
    motion="A full turn about at least two axes.",
    validated="the simulator's injection; motion capture of a hand-held IMU",
    observation_error={"magnetometer": residual_function(_magnetometer)},
)
